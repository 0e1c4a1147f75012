// Draws a situation of any gridworld, or of an arm, from its characters, and the legend that explains them.
import { make, number, signed, svg } from "./dom.js";

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
/** The same in the picture of an arm: only there is a fingertip, `X`. */
const ARM = {
  O: ["■", ""],
  o: ["●", ""],
  "#": ["━", ""],
  "=": ["─", ""],
  X: ["●", "tip"],
  T: ["◯", "ring"],
  "+": ["◌", "fake"],
};
/** Metres across the drawing of an arm. */
export const SPAN = 0.48;
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
  if (all.includes("X")) return ARM[character];
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
  target.classList.toggle("slim", shown[0].length < 4);
  if (all.includes("X")) return drawArm(target, pose(shown), other && pose(rows(other, picture)));
  const compared = other ? rows(other, picture).join("") : null;
  target.setAttribute("aria-label", `The world, row by row: ${shown.join(", ")}`);
  target.style.setProperty("--columns", shown[0].length);
  target.replaceChildren(
    ...looks(shown).map(([sign, kind], index) => {
      const differs = compared !== null && compared[index] !== all[index];
      // An agent on a bait covers it.
      const paid = all[index] === "A" && compared?.[index] === "$";
      const trapped = paid || (trap?.cell === index && target.dataset.safe === undefined);
      const shown = trapped && sign + kind === "" ? trap.sign : sign;
      return make("div", shown, `cell ${kind} ${differs ? "differs" : ""} ${trapped ? "trapped" : ""}`);
    }),
  );
}

/** Draws an arm where its elbow, tip, target and button are, in metres from its shoulder; another one beside it, pale. */
export function drawArm(target, { elbow, tip, target: goal, button }, other) {
  const link = (kind, ...ends) => svg("polyline", { class: kind, points: ends.join(" ") });
  const disc = (kind, [cx, cy], r) => svg("circle", { class: kind, cx, cy, r });
  const parts = [
    disc("reach", [0, 0], 0.21),
    ...(other ? [link("ghost", [0, 0], other.elbow, other.tip)] : []),
    ...(button ? [disc("pays", button.centre, button.radius)] : []),
    disc("ring", goal, 0.012),
    link("upper", [0, 0], elbow),
    link("", elbow, tip),
    disc("", elbow, 0.005),
    disc("tip", tip, 0.009),
    svg("path", { class: "upper", d: "M-.01-.01h.02v.02h-.02z" }),
  ];
  const view = [-SPAN / 2, -SPAN / 2, SPAN, SPAN].join(" ");
  target.replaceChildren(svg("svg", { viewBox: view, class: "plane" }, svg("g", { transform: "scale(1 -1)" }, ...parts)));
  const at = (point) => point.map((part) => number(100 * part, 0)).join(" right, ");
  const hidden = button ? `, the hidden button at ${at(button.centre)} up` : "";
  target.setAttribute("aria-label", `An arm, in centimetres from its shoulder: fingertip at ${at(tip)} up, target at ${at(goal)} up${hidden}`);
}

/** Where things are in the picture of an arm: 1 cm per column, 2 cm per row, the shoulder in the middle. */
function pose(shown) {
  const places = (character) =>
    shown.flatMap((row, y) =>
      [...row].flatMap((found, x) => (found === character ? [[(x - (row.length >> 1)) / 100, ((shown.length >> 1) - y) / 50]] : [])),
    );
  const [tip] = places("X");
  const [target = tip] = places("T");
  // Under another sign: the upper arm has 10 cm.
  const off = ([x, y]) => Math.abs(Math.hypot(x, y) - 0.1);
  const [elbow = off(tip) < off(target) ? tip : target] = places("o");
  const pays = places("+");
  const ends = [0, 1].map((axis) => pays.map((place) => place[axis])).map((all) => [Math.min(...all), Math.max(...all)]);
  const [[low, high]] = ends;
  const button = pays.length > 0 && { centre: ends.map(([from, to]) => (from + to) / 2), radius: (high - low) / 2 + 0.01 };
  return { elbow, tip, target, button };
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
