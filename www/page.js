// Holds the panels together: what the worker reports goes to them, what a person does goes into the link.
import { board, draw, legend } from "./board.js";
import { curves } from "./curves.js";
import { element, LEARNERS, make, number, say } from "./dom.js";
import { player } from "./film.js";
import { ledger } from "./ledger.js";
import * as link from "./link.js";
import { momentPanel } from "./moment.js";

/** Settings that `mcvl train` has flags for. */
const FLAGS = ["preset", "seed"];
/** Verdicts are spoken at most this often, milliseconds. */
const SPEAK = 2000;

const motion = matchMedia("(prefers-reduced-motion: reduce)");
const worker = new Worker("worker.js", { type: "module" });
/** What the link asks for. */
let view = {};
/** The run on show. */
let run = {};
/** Runs asked for so far: what the worker says of an older one comes too late. */
let ticket = 0;

const moment = momentPanel(() => motion.matches);
const film = player((frame) => put({ frame }));
const table = ledger(choose);
const chart = curves(choose);

/** Changes the view and the link. */
function put(changes) {
  for (const [key, value] of Object.entries(changes)) view[key] = value === null ? null : String(value);
  if (changes.frame !== undefined && view.check === null && run.shown) view.check = String(run.shown.number);
  link.write({ ...changes, check: view.check });
}

/** Begins the run of the link, or of the default page where the link is malformed. */
function begin(complaint = "") {
  const found = link.read();
  const text = complaint || found.complaint;
  const stop = text.endsWith("?") ? "" : ".";
  say("error", text && `${text}${stop} This is the default page instead; correct the link and reload, or go on here.`);
  view = found.view;
  element("seed").value = found.seed;
  for (const key of ["speed", "filter", "film"]) document.querySelector(`input[name=${key}][value="${view[key]}"]`).checked = true;
  element("picture").checked = view.picture === "true";
  film.speed = Number(view.speed);
  film.picture = view.picture;
  table.filter = view.filter;
  clear();
  if (motion.matches && !run.begun) ended("Nothing starts by itself: press Run.");
  else compute(found.configuration);
}

/** Forgets the last run. */
function clear() {
  run = { begun: run.begun, world: null, legs: new Map(), scores: new Map(), checks: [], spoken: 0 };
  for (const id of ["legs", "legend", "scores"]) element(id).replaceChildren();
  table.clear();
  chart.clear();
  film.halt();
  const what = view.check === null ? "The first refusal" : `Check ${view.check}`;
  moment.wait(`${what} appears here. The agent trains in the safe world first, which takes a few seconds.`);
}

function compute(configuration) {
  ticket += 1;
  run.begun = true;
  element("status").textContent = "Computing.";
  element("stop").disabled = false;
  element("stop").textContent = "Pause run";
  worker.postMessage({ kind: "start", configuration });
}

function ended(text) {
  element("status").textContent = text;
  element("stop").disabled = true;
}

/** Opens a moment because a person chose it. */
function choose(number) {
  if (number === null) return;
  put({ check: number, frame: null });
  ask(number);
}

function ask(number) {
  run.asked = number;
  worker.postMessage({ kind: "moment", number });
}

/** Shows the moment whose films have come; with `frame` in the link it stands there, else it plays. */
function open(check) {
  run.shown = check;
  moment.open(check, run.world, run.configuration, view.picture);
  element("starts").hidden = check.modified.films.length < 2;
  film.open(check, view.film, Number(view.frame ?? 0), run.world);
  if (view.frame === null && !motion.matches) film.play();
  table.choose(check.number);
  chart.choose(check.number);
}

/** The drawing of a leg, made when it is first heard of. */
function leg(arm) {
  if (!run.legs.has(arm)) {
    const figure = make("figure", "", "leg");
    const drawing = board();
    const figures = make("p");
    figure.append(make("figcaption", LEARNERS[arm]), drawing, figures);
    element("legs").append(figure);
    run.legs.set(arm, { drawing, figures });
  }
  return run.legs.get(arm);
}

function showScore(point) {
  run.scores.set(point.arm, point);
  const rows = [...run.scores.values()].map(({ arm, step, return: observed, performance }) => {
    const parted = observed > performance + 1;
    const row = make("tr");
    const name = make("th", LEARNERS[arm]);
    name.scope = "row";
    row.append(name, make("td", step), make("td", number(observed, 1)), make("td", number(performance, 1)));
    row.append(make("td", parted ? "✕ gets more than it earns: hacked" : "✓ gets what it earns", parted ? "word refuse" : "word accept"));
    return row;
  });
  element("scores").replaceChildren(...rows);
}

/** Says the newest verdict, not every one. */
function speak(check) {
  const now = performance.now();
  if (now - run.spoken < SPEAK) return;
  run.spoken = now;
  const got = `expected ${number(check.predicted / run.world.reward_scale, 1)}, got ${number(check.reward_raw, 1)}`;
  element("latest").textContent = `Step ${check.step}: ${got}: ${check.refused ? "refused" : "accepted"}.`;
}

/** Asks for the moment that the link names, else for the first refusal. */
function find(checks) {
  if (run.asked) return;
  const wanted = view.check === null ? checks.find((check) => check.refused) : checks.find((check) => check.number === Number(view.check));
  if (wanted) ask(wanted.number);
}

const receive = {
  ready({ module, experiments, world, configuration }) {
    run.world = world;
    element("env").replaceChildren(...experiments.map((name) => make("option", name)));
    element("env").value = configuration.split(" ")[0].split("=")[1];
    run.configuration = configuration;
    element("legend").replaceChildren(...legend(world.legend));
    element("module").textContent = module === "simd" ? "module with SIMD" : "module without SIMD";
    const [name, ...rest] = configuration.split(" ");
    const settings = rest.map((setting) => {
      const [key, value] = setting.split("=");
      return FLAGS.includes(key) ? ` --${key} ${value}` : ` --set ${setting}`;
    });
    element("command").textContent = `mcvl train ${name.slice(4)}${settings.join("")}`;
  },

  report(report) {
    for (const { arm, frame, step, steps, checks, refusals } of report.legs) {
      const { drawing, figures } = leg(arm);
      run.legs.get(arm).frame = frame;
      if (frame.truth) element("pictures").hidden = false;
      // Moving pictures only for those who want them: the last one always stays.
      if (!motion.matches || step === steps || drawing.childElementCount === 0) draw(drawing, frame, view.picture);
      figures.textContent = `step ${step} of ${steps}${arm === "mc" ? `, ${checks} checks, ${refusals} refused` : ""}`;
    }
    report.evaluations.forEach(showScore);
    chart.add(report);
    if (report.checks.length === 0) return;
    run.checks.push(...report.checks);
    table.add(report.checks, run.world.reward_scale);
    speak(report.checks.at(-1));
    find(report.checks);
  },

  moment({ check }) {
    if (check.number === run.asked) open(check);
  },

  done({ seconds }) {
    ended(`Done in ${number(seconds, 1)} seconds.`);
    if (run.asked) return;
    const count = run.checks.length;
    if (view.check !== null && count > 0) {
      say("error", `check: this run has no check ${view.check}, its last is ${count}. The first refusal is shown instead.`);
      link.write({ check: null, frame: null });
      Object.assign(view, { check: null, frame: null });
      find(run.checks);
    }
    if (!run.asked && count > 0) ask(run.checks.at(-1).number);
    if (count === 0) moment.wait("No reward surprised this run, so there was nothing to decide.");
  },

  malformed({ message }) {
    link.forget();
    begin(message);
  },

  failed({ message }) {
    say("error", message);
    ended("Nothing is running.");
  },
};

worker.onmessage = ({ data }) => {
  if (data.ticket === ticket) receive[data.kind](data);
};
worker.onerror = () => receive.failed({ message: "The module could not be loaded: `cargo xtask web` builds it." });

element("controls").addEventListener("submit", (event) => {
  event.preventDefault();
  link.write({ env: element("env").value, seed: element("seed").value || "0", check: null, frame: null });
  run.begun = true;
  begin();
});

element("stop").addEventListener("click", () => {
  const going = element("stop").textContent.startsWith("Pause");
  worker.postMessage({ kind: going ? "pause" : "resume" });
  element("stop").textContent = going ? "Resume run" : "Pause run";
  element("status").textContent = going ? "Paused." : "Computing.";
});

element("previous").addEventListener("click", () => choose(table.beside(run.asked ?? null, -1)));
element("next").addEventListener("click", () => choose(table.beside(run.asked ?? null, 1)));
element("oldest").addEventListener("click", () => choose(run.checks.find((check) => check.refused)?.number ?? null));
element("newest").addEventListener("click", () => choose(table.newest()));

document.addEventListener("change", ({ target }) => {
  if (target.name === "speed") {
    put({ speed: target.value });
    film.speed = Number(view.speed);
  }
  if (target.name === "filter") {
    put({ filter: target.value });
    table.filter = view.filter;
  }
  if (target.name === "film") {
    put({ film: target.value, frame: null });
    if (run.shown) open(run.shown);
  }
  if (target.id === "picture") {
    put({ picture: target.checked ? "true" : "seen" });
    film.picture = view.picture;
    for (const { drawing, frame } of run.legs.values()) draw(drawing, frame, view.picture);
    if (run.shown) moment.open(run.shown, run.world, run.configuration, view.picture);
  }
});

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input:not([type=radio]), textarea")) return;
  if (event.key === ".") element("next").click();
  if (event.key === ",") element("previous").click();
  if (event.key === " " && run.shown && !event.target.closest("button, input, summary, a, [tabindex]")) {
    event.preventDefault();
    film.toggle();
  }
});

begin();
