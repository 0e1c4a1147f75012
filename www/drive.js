// Drive it yourself: the visitor acts in the world of the run, step by step. The worker holds the world and the
// score; what the steps were worth is told at the end.
import { board, draw } from "./board.js";
import { drive } from "./computer.js";
import { element, LEARNERS, make, signed } from "./dom.js";

/** What keys mean, where the world has such an action. */
const KEYS = {
  ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right",
  w: "up", s: "down", a: "left", d: "right",
};
const SIGNS = { up: "↑", down: "↓", left: "←", right: "→" };
/** Shortest swipe, pixels. */
const SWIPE = 24;
/** Sums of rewards like 0.02 end a little beside their decimal value. */
const ROUND = 0.005;

const amount = (value) => signed(value, 2).replace(/\.?0+$/, "");
const place = element("wheel");
const status = element("drive-status");
const drawing = board();
const helm = make("div", "", "helm");
const pad = make("div", "", "pad");
const truth = make("figure", "", "truth");
const result = make("div");
const stop = button("Stop here, show the hidden score", () => send({ end: true }));
const again = button("Drive again", () => begin());

let world = null;
let configuration = "";
/** Scores of the run's learners, to compare with. */
let others = new Map();
/** Whether the last request is not answered yet: a held key does not outrun the world. */
let waiting = false;
let over = true;

helm.tabIndex = 0;
helm.setAttribute("role", "group");
helm.setAttribute("aria-label", "The world. Arrow keys act.");
helm.append(drawing);
pad.setAttribute("role", "group");
pad.setAttribute("aria-label", "Actions");
const cockpit = make("div", "", "cockpit");
cockpit.append(helm, pad, truth);
const choices = make("p");
choices.append(stop, again);
place.append(cockpit, choices, result);

place.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const action = KEYS[event.key];
  if (!world?.actions.discrete.includes(action)) return;
  // The page would scroll.
  event.preventDefault();
  act(action);
});

let from = null;
helm.addEventListener("pointerdown", (event) => (from = event));
helm.addEventListener("pointerup", (event) => {
  if (!from) return;
  const [x, y] = [event.clientX - from.clientX, event.clientY - from.clientY];
  from = null;
  if (Math.max(Math.abs(x), Math.abs(y)) < SWIPE) return;
  act(Math.abs(x) > Math.abs(y) ? (x < 0 ? "left" : "right") : y < 0 ? "up" : "down");
});
helm.addEventListener("pointercancel", () => (from = null));

/** Puts a person into the world of a run; `scores` are those of its learners so far. */
export function takeWheel(text, scores) {
  configuration = text;
  others = scores;
  begin();
}

/** Ends the episode, because the page turns to another run. */
export function leaveWheel() {
  over = true;
  place.hidden = true;
  status.textContent = "";
}

function begin() {
  place.hidden = false;
  result.replaceChildren();
  truth.replaceChildren();
  over = false;
  send({ configuration });
  helm.focus();
}

function act(name) {
  const action = world.actions.discrete.indexOf(name);
  if (over || waiting || action < 0) return;
  send({ action });
}

function send(request) {
  waiting = true;
  drive(request, (said) => {
    waiting = false;
    if (!place.hidden) show(said, request);
  });
}

function show(said, { action, end }) {
  if (said.message) {
    status.textContent = said.message;
    return;
  }
  if (said.world) {
    world = said.world;
    pad.replaceChildren(...world.actions.discrete.map(padButton));
  }
  over = said.result !== null;
  draw(drawing, said.frame, "seen");
  stop.hidden = over;
  again.hidden = !over;
  for (const key of pad.children) key.ariaDisabled = over;
  const sum = `Observed return ${amount(said.return)} after ${said.step} of ${said.steps} steps.`;
  const last = action === undefined ? "" : `${world.actions.discrete[action]}: ${amount(said.observed)}. `;
  const ended = `${end ? "You stopped" : "The episode is over"} after ${said.step} of ${said.steps} steps.`;
  status.textContent = over ? `${ended} ${verdict(said.result)}` : last + sum;
  if (!over) return;
  compare(said.result);
  if (said.frame.truth) {
    const real = board();
    draw(real, said.frame, "true");
    truth.replaceChildren(make("figcaption", "In truth"), real);
  }
  // What it says stands above.
  again.focus({ preventScroll: true });
}

/** What became of the driver's reward, in words. */
function verdict({ driver: [observed, performance] }) {
  const fake = observed - performance;
  const both = `You were paid ${amount(observed)}, and it was worth ${amount(performance)}.`;
  if (Math.abs(fake) < ROUND) return `${both} No reward was fake.`;
  return fake > 0
    ? `${both} The rest was fake. An ordinary learner takes such a reward at its word and learns to do it again.`
    : `${both} It was worth more than it paid.`;
}

/** The hidden score, beside the best routes and what the learners of this run get. */
function compare({ driver, intended, hack, hackable, deterministic }) {
  const rows = [["You", driver]];
  for (const arm of ["baseline", "mc"]) {
    const point = others.get(arm);
    if (point) rows.push([`${LEARNERS[arm]}, so far`, [point.return, point.performance]]);
  }
  if (intended) rows.push(["Intended, at best", intended]);
  if (hack) rows.push(["The hack, at best", hack]);
  const table = make("table");
  const head = make("tr");
  for (const [index, text] of ["Who", "Reward", "Performance"].entries()) {
    const cell = make("th", text, index ? "" : "word");
    cell.scope = "col";
    head.append(cell);
  }
  const body = make("tbody");
  for (const [name, pair] of rows) {
    const row = make("tr");
    const label = make("th", name);
    label.scope = "row";
    row.append(label, ...pair.map((value) => make("td", amount(value))));
    body.append(row);
  }
  const top = make("thead");
  top.append(head);
  table.append(top, body);
  result.replaceChildren(table);
  const notes = [];
  if (!hackable) notes.push("In this world there is nothing to hack.");
  if (!deterministic) notes.push("Routes and learners on average: this world has chance in it.");
  if (notes.length > 0) result.append(make("p", notes.join(" "), "quiet"));
}

function padButton(name) {
  const made = button(SIGNS[name] ?? name, () => act(name));
  made.setAttribute("aria-label", name);
  made.className = name;
  return made;
}

function button(text, pressed) {
  const made = make("button", text);
  made.type = "button";
  made.addEventListener("click", pressed);
  return made;
}
