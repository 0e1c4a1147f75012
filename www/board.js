// Draws a situation of any gridworld from its characters, and the legend that explains them.
import { make } from "./dom.js";

/** Sign and class of well-known characters; any other is drawn as it is. */
const CELLS = {
  B: ["■", "box"],
  A: ["●", "agent"],
  "^": ["▲", ""],
  v: ["▼", ""],
  $: ["▼5", "fake"],
  "+": ["+5", ""],
  "#": ["", "wall"],
  ".": ["", ""],
  " ": ["", ""],
};

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

/** Draws a frame; cells that differ from those of `other` are framed. */
export function draw(target, frame, picture, other) {
  const shown = rows(frame, picture);
  const compared = other ? rows(other, picture).join("") : null;
  target.setAttribute("aria-label", `The world, row by row: ${shown.join(", ")}`);
  target.style.setProperty("--columns", shown[0].length);
  target.replaceChildren(
    ...[...shown.join("")].map((character, index) => {
      const [sign, kind] = CELLS[character] ?? [character, ""];
      const differs = compared !== null && compared[index] !== character;
      return make("div", sign, `cell ${kind} ${differs ? "differs" : ""}`);
    }),
  );
}

/** Entries of the legend, from the world's own words. */
export function legend(entries) {
  return entries
    .filter(([character]) => character !== ".")
    .map(([character, meaning]) => {
      const [sign, kind] = CELLS[character] ?? [character, ""];
      const entry = make("div");
      const said = make("dd", meaning);
      // Boards are read out with the world's own characters.
      if (sign !== character) said.append(make("span", `, ${character}`, "unseen"));
      entry.append(make("dt", sign, `cell ${kind}`), said);
      return entry;
    });
}
