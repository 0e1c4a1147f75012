// Plays the films of two futures synchronously: same start, same length, one scrubber. In slow motion a check goes
// through its named stages, one after the other, without a click.
import { board, draw } from "./board.js";
import { deed, element, signed } from "./dom.js";

/** Time of a step at speed 1, milliseconds. */
const BEAT = 420;
const SIDES = ["modified", "unmodified"];

/** A player; `touched()` hears that a person took it, and `stopped(frame)` where it stands then, null where it plays. */
export function player(touched, stopped) {
  const boards = SIDES.map((side) => {
    const made = board();
    element(`${side}-board`).append(made);
    return made;
  });
  const scrubber = element("scrubber");
  let films = null;
  let world = null;
  let picture = "seen";
  let frame = 0;
  let last = 0;
  let speed = 1;
  let told = null;
  let timer = 0;

  const show = () => {
    if (!films) return;
    const frames = films.map((film) => film.frames[Math.min(frame, film.actions.length)]);
    boards.forEach((target, index) => draw(target, frames[index], picture, frames[1 - index]));
    SIDES.forEach((side, index) => {
      const film = films[index];
      element(`${side}-step`).textContent = caption(film, frame, world);
    });
    scrubber.value = frame;
    scrubber.setAttribute("aria-valuetext", `step ${frame} of ${last}`);
    element("frame").textContent = `step ${frame} of ${last}`;
    element("play").textContent = timer ? "Pause" : frame === last ? "Play again" : "Play";
  };
  const halt = () => {
    clearTimeout(timer);
    timer = 0;
  };
  const next = () => {
    timer = 0;
    if (frame < last) frame += 1;
    if (frame < last) timer = setTimeout(next, BEAT / (told ?? speed));
    show();
  };
  const go = (to) => {
    halt();
    frame = Math.max(0, Math.min(last, to));
    show();
    stopped(frame);
  };

  const control = {
    /** Shows the films with this start of a check, from a frame on; a ledger has none. */
    open(check, start, from, facts) {
      halt();
      told = null;
      world = facts;
      const pick = (future) => future.films.find((film) => film.start === start) ?? future.films[0];
      films = check.modified?.films?.length ? [pick(check.modified), pick(check.unmodified)] : null;
      element("films").hidden = !films;
      for (const target of boards) target.hidden = !films;
      if (!films) {
        for (const side of SIDES) element(`${side}-step`).textContent = "A ledger has no films: drop the tape to see them.";
        return;
      }
      last = Math.max(...films.map((film) => film.actions.length));
      frame = Math.min(from, last);
      scrubber.max = last;
      show();
    },
    play() {
      halt();
      if (!films) return;
      told = null;
      if (frame === last) frame = 0;
      timer = setTimeout(next, BEAT / speed);
      show();
    },
    /** Back to the start, still. */
    rewind() {
      halt();
      frame = 0;
      show();
    },
    /** Plays at a speed of its own, as part of a story. */
    tell(pace) {
      halt();
      if (!films) return;
      told = pace;
      timer = setTimeout(next, BEAT / told);
      show();
    },
    toggle() {
      const playing = timer !== 0;
      touched();
      if (playing) return go(frame);
      stopped(null);
      control.play();
    },
    halt() {
      halt();
      show();
    },
    get last() {
      return films ? last : 0;
    },
    set speed(value) {
      speed = value;
      told = null;
    },
    set picture(value) {
      picture = value;
      show();
    },
  };
  element("play").addEventListener("click", control.toggle);
  scrubber.addEventListener("input", () => {
    touched();
    halt();
    frame = Number(scrubber.value);
    show();
  });
  scrubber.addEventListener("change", () => go(Number(scrubber.value)));
  return control;
}

/** What happened in the step before this frame. */
function caption(film, frame, world) {
  if (frame === 0) return film.start === "reset" ? "a fresh episode" : "right after the step";
  if (frame > film.actions.length) return "the episode is over";
  const predicted = film.predicted[frame - 1] / world.reward_scale;
  return `${deed(world, film.actions[frame - 1], "goes ")}, today’s model expects ${signed(predicted, 1)}`;
}

/** How long each stage stands before the next one comes, milliseconds. The first refusal is told in eight seconds. */
const HOLD = [1600, 1500, 700, 1100, 1700, 900];
/** Speed of the films while they are told. */
const STORY_SPEED = 4;

/** Tells checks. `ended` is called when a story was told to its end. */
export function story(moment, film, ended) {
  let timer = 0;
  const tell = (stage) => {
    moment.turn(stage);
    if (stage === moment.acting) film.tell(STORY_SPEED);
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
