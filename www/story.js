// Slow motion: one check through its named stages, one after the other, without a click.

/** How long each stage stands before the next one comes, milliseconds. The first refusal is told in eight seconds. */
const HOLD = [1600, 1500, 700, 1100, 1700, 900];
/** Speed of the films while they are told. */
const SPEED = 4;

/** Tells checks. `ended` is called when a story was told to its end. */
export function story(moment, film, ended) {
  let timer = 0;
  const tell = (stage) => {
    moment.turn(stage);
    if (stage === moment.acting) film.tell(SPEED);
    if (stage === moment.last) {
      timer = 0;
      ended();
    } else {
      timer = setTimeout(tell, HOLD[stage], stage + 1);
    }
  };
  return {
    /** Begins at a stage; where frames are given, with how it goes on if nothing happens. */
    play(opening, from = 1) {
      clearTimeout(timer);
      film.rewind();
      if (opening) moment.prologue(opening, HOLD[0]);
      tell(opening ? 0 : from);
    },
    get going() {
      return timer !== 0;
    },
    /** Ends it where it is; whether there was one. */
    stop() {
      const going = timer !== 0;
      clearTimeout(timer);
      timer = 0;
      return going;
    },
  };
}
