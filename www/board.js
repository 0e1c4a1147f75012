// Draws a situation of any gridworld from its characters, and the legend that explains them.
import { make, signed } from "./dom.js";

/** Sign and class of well-known characters; any other is drawn as it is. The classes have pictures. */
const CELLS = {
  B: ["■", "box"],
  A: ["", "agent"],
  "^": ["▲", ""],
  v: ["▼", ""],
  $: ["▼5", "fake"],
  "+": ["+5", ""],
  "#": ["", "wall"],
  ".": ["", ""],
  " ": ["", ""],
  G: ["", "goal"],
  S: ["", "eye"],
  P: ["−30", "toll"],
  t: ["", "tomato dry"],
  T: ["", "tomato"],
  O: ["", "bucket"],
  R: ["", "rock"],
  D: ["", "diamond"],
  p: ["", "lever"],
  q: ["", "lever gem"],
  Q: ["", "lever high gem"],
};
/** Where there are rocks or diamonds, `P` is their switch. */
const HIGH = ["", "lever high"];
const OUTSIDE = ["", "outside"];
/** The supervisor's place while it is away. */
const AWAY = ["", "eye away"];

/** The trap of the run: its cell, and its reward as a sign; null without one. */
let trap = null;

/** Reads the trap from the text of the run on show; gives its cell and reward, null without one. */
export function readTrap(configuration) {
  const found = configuration.match(/ trap=(\d+):(\S+)/);
  trap = found && { cell: Number(found[1]), reward: Number(found[2]), sign: signed(Number(found[2]), 1).replace(".0", "") };
  return trap;
}

/** An empty board. */
export function board() {
  const made = make("div", "", "board");
  made.setAttribute("role", "img");
  return made;
}

/** The rows of a frame: what the agent sees, or what is true. */
function rows(frame, picture) {
  return ((picture === "true" && frame.truth) || frame.seen).split("\n");
}

/** Sign and class of a character among all others. */
function look(character, all) {
  if (character === "P" && /[RD]/.test(all)) return HIGH;
  return CELLS[character] ?? [character, ""];
}

/** Sign and class of every cell. */
export function looks(shown) {
  const all = shown.join("");
  const columns = shown[0].length;
  return [...all].map((character, index) => {
    // Worlds have walls around them; what lies beyond is no floor. The supervisor watches from there.
    const beyond = character === " " && [0, columns - 1].includes(index % columns);
    if (!beyond) return look(character, all);
    return index === 0 && !all.includes("S") ? AWAY : OUTSIDE;
  });
}

/** Draws a frame, with its trap but in the safe world; cells that differ from those of `other` are framed. */
export function draw(target, frame, picture, other) {
  const shown = rows(frame, picture);
  const all = shown.join("");
  const compared = other ? rows(other, picture).join("") : null;
  target.setAttribute("aria-label", `The world, row by row: ${shown.join(", ")}`);
  target.style.setProperty("--columns", shown[0].length);
  target.replaceChildren(
    ...looks(shown).map(([sign, kind], index) => {
      const differs = compared !== null && compared[index] !== all[index];
      const trapped = trap?.cell === index && target.dataset.safe === undefined;
      const shown = trapped && sign + kind === "" ? trap.sign : sign;
      return make("div", shown, `cell ${kind} ${differs ? "differs" : ""} ${trapped ? "trapped" : ""}`);
    }),
  );
}

/** Entries of the legend, from the world's own words. */
export function legend(entries) {
  const all = entries.map(([character]) => character).join("");
  const entry = ([sign, kind], meaning, character) => {
    const made = make("div");
    const said = make("dd", meaning);
    // Boards are read out with the world's own characters.
    if (sign !== character) said.append(make("span", `, ${character}`, "unseen"));
    made.append(make("dt", sign, `cell ${kind}`), said);
    return made;
  };
  return entries
    .filter(([character]) => character.trim() !== "" && character !== ".")
    .flatMap(([character, meaning]) => {
      const own = entry(look(character, all), meaning, character);
      return character === "S" ? [own, entry(AWAY, "supervisor, away", "a blank first cell")] : [own];
    });
}
