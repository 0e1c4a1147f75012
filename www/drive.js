// Drive it yourself: the visitor acts in the world of the run, step by step. The worker holds the world and the
// score; what the steps were worth is told at the end.
import { board, draw, drawArm, SPAN } from "./board.js";
import { drive } from "./computer.js";
import { button, deed, element, LEARNERS, make, signed } from "./dom.js";

/** What keys mean, where the world has such an action. */
const KEYS = {
  ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right",
  w: "up", s: "down", a: "left", d: "right", " ": "rest",
};
const SIGNS = { up: "↑", down: "↓", left: "←", right: "→" };
/** What the same keys mean to an arm: torques of shoulder and elbow, of 1 at most, for one step. */
const TORQUES = { left: [0.5, 0], right: [-0.5, 0], up: [0, 0.5], down: [0, -0.5], rest: [0, 0] };
const JOINTS = { left: "shoulder ↺", right: "shoulder ↻", up: "elbow ↺", down: "elbow ↻" };
/** Torque per square metre between pointer and fingertip, and per radian that the joint turned in the last step. */
const [PULL, BRAKE] = [40, 3];
/** Time of a step while an arm is dragged, milliseconds: a quarter of its real speed. */
const BEAT = 80;
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
/** The arm as drawn, and one step before; null in other worlds. */
let [pose, before] = [null, null];
/** Where a pointer drags the fingertip, in metres; null where none does. */
let aim = null;
let timer = 0;
const still = matchMedia("(prefers-reduced-motion: reduce)");

helm.tabIndex = 0;
helm.setAttribute("role", "group");
helm.append(drawing);
pad.setAttribute("role", "group");
pad.setAttribute("aria-label", "Actions");
const hint = make("p", "", "quiet");
const cockpit = make("div", "", "cockpit");
cockpit.append(helm, pad, truth);
const choices = make("p");
choices.append(stop, again);
place.append(cockpit, hint, choices, result);

place.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const action = KEYS[event.key];
  // On a button the space bar presses it.
  if (!world || !names().includes(action) || (action === "rest" && event.target !== helm)) return;
  // The page would scroll.
  event.preventDefault();
  act(action);
});

let from = null;
helm.addEventListener("pointerdown", (event) => {
  from = event;
  if (!pose) return;
  helm.setPointerCapture(event.pointerId);
  point(event);
  pull();
});
helm.addEventListener("pointermove", (event) => aim && point(event));
helm.addEventListener("pointerup", (event) => {
  if (!from) return;
  const [x, y] = [event.clientX - from.clientX, event.clientY - from.clientY];
  letGo();
  if (pose || Math.max(Math.abs(x), Math.abs(y)) < SWIPE) return;
  act(Math.abs(x) > Math.abs(y) ? (x < 0 ? "left" : "right") : y < 0 ? "up" : "down");
});
helm.addEventListener("pointercancel", letGo);

function letGo() {
  from = aim = null;
  // What was not read out on the way.
  status.ariaLive = "polite";
  if (pose) status.textContent += " ";
}

/** Takes the pointer's place for where the fingertip is to go. */
function point({ clientX, clientY }) {
  const { left, top, width } = drawing.firstChild.getBoundingClientRect();
  aim = [SPAN * ((clientX - left) / width - 0.5), SPAN * (0.5 - (clientY - top) / width)];
}

/** Makes a step towards the pointer, and others as long as it is held; one only where nothing may move. */
function pull() {
  if (aim) step(torques());
}

/**
 * A driving aid: the way to the pointer, by the transposed Jacobian of the drawn arm, less a brake for each joint.
 */
function torques() {
  const minus = (a, b) => [a[0] - b[0], a[1] - b[1]];
  const cross = (a, b) => a[0] * b[1] - a[1] * b[0];
  const turned = (a, b) => Math.atan2(cross(a, b), a[0] * b[0] + a[1] * b[1]);
  const [way, fore] = [minus(aim, pose.tip), minus(pose.tip, pose.elbow)];
  const shoulder = turned(before.elbow, pose.elbow);
  const elbow = turned(minus(before.tip, before.elbow), fore) - shoulder;
  return [PULL * cross(pose.tip, way) - BRAKE * shoulder, PULL * cross(fore, way) - BRAKE * elbow].map((torque) =>
    Math.max(-1, Math.min(1, torque)),
  );
}

/** Puts a person into the world of a run; `scores` are those of its learners so far. */
export function takeWheel(text, scores) {
  configuration = text;
  others = scores;
  begin();
}

/** Ends the episode, because the page turns to another run. */
export function leaveWheel() {
  over = true;
  aim = null;
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

/** What the visitor can do in one step. */
function names() {
  return world.actions.discrete ?? Object.keys(TORQUES);
}

function act(name) {
  const { discrete } = world.actions;
  if (names().includes(name)) step(discrete ? discrete.indexOf(name) : TORQUES[name]);
}

function step(action) {
  if (!over && !waiting) send({ action });
}

function send(request) {
  waiting = true;
  drive(request, (said) => {
    waiting = false;
    if (!place.hidden) show(said, request);
    clearTimeout(timer);
    if (aim && !still.matches) timer = setTimeout(pull, BEAT);
  });
}

function show(said, { action, end }) {
  if (said.message) {
    status.textContent = said.message;
    return;
  }
  if (said.world) {
    world = said.world;
    pad.replaceChildren(...names().map(padButton));
    pad.classList.toggle("joints", Boolean(said.pose));
    helm.setAttribute("aria-label", `The world. Arrow keys act${said.pose ? ", Space rests" : ""}.`);
    hint.textContent = said.pose
      ? "Left and right turn the shoulder, up and down the elbow, Space rests. Or drag: torques pull the fingertip towards the pointer (transposed Jacobian, with a brake)."
      : "";
  }
  over = said.result !== null;
  [before, pose] = [said.world ? said.pose : pose, said.pose];
  if (pose) drawArm(drawing, pose);
  else draw(drawing, said.frame, "seen");
  if (over) aim = null;
  // A drag is many steps a second: it is read out when it ends.
  status.ariaLive = aim ? "off" : "polite";
  stop.hidden = over;
  again.hidden = !over;
  for (const key of pad.children) key.ariaDisabled = over;
  const sum = `Observed return ${amount(said.return)} after ${said.step} of ${said.steps} steps.`;
  const last = action === undefined ? "" : `${deed(world, action)}: ${amount(said.observed)}. `;
  const ended = `${end ? "You stopped" : "The episode is over"} after ${said.step} of ${said.steps} steps.`;
  status.textContent = over ? `${ended} ${verdict(said.result)}` : last + sum;
  if (!over) return;
  compare(said.result);
  if (said.frame?.truth) {
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
  const joint = world.actions.discrete ? null : JOINTS[name];
  const made = button(joint ?? SIGNS[name] ?? name, () => act(name));
  if (!joint) made.setAttribute("aria-label", name);
  made.className = name;
  return made;
}
