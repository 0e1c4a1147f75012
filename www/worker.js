// Computes a run in slices, away from the page: polls, collects what the run says, and reports a few times
// per second. Checks are kept whole, with their films, for the page to ask for one. Everything that is
// decided is decided in the module.
import * as files from "./files.js";
import { MODULE } from "./module.js";
import { summarise } from "./record.js";

/** A slice of work aims at this many milliseconds, and the page hears of it this often. */
const SLICE = 20;
const REPORT = 100;
/** A calibration takes this long, milliseconds, and is given up after so many times that without an update. */
const [MEASURED, PATIENCE] = [300, 10];
/** A helper that says nothing for so long is lost. */
const SILENCE = 5000;
/** Environment steps per second at speed 1. */
const STEPS = 8;

/** Number of the run that is computed; what an older one says goes nowhere. */
let current = 0;
/** The checks of the current run as JSON text, by number. */
let moments = new Map();
/** What is still to be reported. */
let [evaluations, checks] = [[], []];
/** The episode that a person drives. */
let episode = null;
/** Resolves when the run may go on; `goOn` resolves it. */
let gate = Promise.resolve();
let goOn = () => {};
/** Environment steps per second of each learner; Infinity for as fast as it goes. */
let rate = Infinity;
/** Further workers of this file, which train the futures of a check, one each; what to do when one answers or fails. */
let helpers = [];
let receive = () => {};

const requests = {
  /** Starts a run; held, it is judged and waits for `resume` before its first step. */
  start({ ticket, configuration, token, held, cores }) {
    requests.leave({ ticket });
    moments = new Map();
    [evaluations, checks] = [[], []];
    if (held) requests.pause();
    compute(configuration, token, ticket, cores).catch((error) => postMessage({ kind: "failed", ticket, message: error.message }));
  },
  pause() {
    tell({ kind: "pause" });
    gate = new Promise((resolve) => (goOn = resolve));
  },
  resume() {
    tell({ kind: "resume" });
    goOn();
    gate = Promise.resolve();
  },
  /** Says what is wrong with a configuration, if anything is. */
  async judge({ id, configuration }) {
    let complaint = "";
    try {
      (await open(configuration)).free();
    } catch (error) {
      complaint = error.message;
    }
    postMessage({ kind: "answer", id, complaint });
  },
  /** Says what a run is, and measures how many seconds an update takes here, beside its share of everything else. */
  async describe({ id, configuration }) {
    const found = { pace: 0 };
    try {
      const run = await open(configuration);
      Object.assign(found, { experiments: (await loaded).experiments, settings: JSON.parse(run.settings()) });
      if (!(await loaded).untrained(configuration)) found.pace = measure(run);
      run.free();
    } catch {
      // A configuration that cannot be run here is not described.
    }
    postMessage({ kind: "answer", id, ...found });
  },
  /** Begins an episode with a `configuration`, makes a step with an `action`, ends it with `end`. */
  async drive({ request: { configuration, action, end } }) {
    try {
      const { Drive } = await loaded;
      if (configuration) {
        episode?.free();
        episode = new Drive(configuration);
      }
      const act = () => (action.length ? episode.turn(...action) : episode.act(action));
      const observed = action === undefined ? null : act();
      const state = JSON.parse(episode.state(Boolean(end)));
      const result = end || state.over ? JSON.parse(episode.result()) : null;
      const world = configuration ? JSON.parse(episode.world()) : null;
      postMessage({ kind: "driven", ...state, observed, result, world });
    } catch (error) {
      postMessage({ kind: "driven", message: error.message });
    }
  },
  /** Ends the run; nothing more is heard of it. */
  leave({ ticket }) {
    current = ticket;
    tell({ kind: "leave", ticket });
    requests.resume();
  },
  /** Trains a future for the worker that has its run. */
  forecast(request) {
    current = request.ticket;
    // Whoever hired this worker hears of errors.
    forecast(request).catch(reportError);
  },
  pace({ pace }) {
    rate = pace === "max" ? Infinity : STEPS * Number(pace);
  },
  moment({ number }) {
    if (moments.has(number)) postMessage({ kind: "moment", ticket: current, check: JSON.parse(moments.get(number)) });
  },
};

onmessage = ({ data }) => requests[data.kind](data);

const loaded = load();
// A module that cannot be loaded is reported by the run that needs it.
loaded.catch(() => {});

async function load() {
  const module = await files.load(`pkg/${MODULE}.js`);
  await module.default({ module_or_path: files.get(`pkg/${MODULE}_bg.wasm`) });
  const { Run, Drive, Forecast, readToken, untrained } = module;
  return { Run, Drive, Forecast, readToken, untrained, experiments: JSON.parse(module.experiments()) };
}

/** Seconds that an update of a run takes, live or in a forecast; 0 where it makes none. */
function measure(run) {
  const updates = () => {
    const { updates, forecast_updates } = JSON.parse(run.progress());
    return updates + forecast_updates;
  };
  const until = (enough) => {
    const began = performance.now();
    do run.poll(1);
    while (!enough(performance.now() - began) && performance.now() - began < PATIENCE * MEASURED);
    return performance.now() - began;
  };
  // Not what comes before learning.
  until(() => updates() > 0);
  const before = updates();
  // The updates of a check are counted at its end.
  const spent = until((time) => time > MEASURED && updates() > before);
  return updates() > before ? spent / 1000 / (updates() - before) : 0;
}

/** The run of a configuration; where it is not trained here, an episode in its world, which says the same of it. */
async function open(configuration) {
  const { Run, Drive, untrained } = await loaded;
  return new (untrained(configuration) ? Drive : Run)(configuration);
}

/** Safe training, then both learners side by side from the switch, and the one that the configuration names. */
async function compute(configuration, token, ticket, cores) {
  const { readToken, untrained, experiments } = await loaded;
  if (ticket !== current) return;
  const start = performance.now();
  let safe;
  let number = null;
  try {
    if (token) ({ configuration, number } = JSON.parse(readToken(token)));
    safe = await open(configuration);
  } catch (error) {
    postMessage({ kind: "malformed", ticket, message: error.message });
    return;
  }
  const world = JSON.parse(safe.world());
  const settings = JSON.parse(safe.settings());
  configuration = safe.configuration();
  const driven = untrained(configuration);
  postMessage({ kind: "ready", ticket, experiments, world, cost: safe.cost(), configuration, settings, wanted: number, driven });
  if (driven) return safe.free();
  // The worker that has the run and the page keep a core.
  if (cores > 2 && helpers.length === 0) hire();
  if (!(await follow([safe], "switch", ticket))) return;
  const named = settings.find(({ name }) => name === "agent").value;
  const learners = [...new Set(["baseline", "mc", named])].map((name) => safe.fork(name));
  if (helpers.length > 0) learners.forEach((run) => run.forecastElsewhere());
  if (!(await follow(learners, "done", ticket))) return;
  postMessage({ kind: "done", ticket, seconds: (performance.now() - start) / 1000 });
}

/** Polls runs in turn until all have the status `end`; false where another run was asked for meanwhile. */
async function follow(runs, end, ticket) {
  const pending = new Set(runs);
  const states = new Map(runs.map((run) => [run, { budget: 16, due: 0, step: 0, began: 0, out: 0, heard: 0 }]));
  let reported = performance.now();
  let wake = () => {};
  receive = (came) => {
    if (came.ticket === ticket) takeBack(runs[came.index], states.get(runs[came.index]), came.future);
    wake();
  };
  while (pending.size > 0) {
    await gate;
    if (ticket !== current) return false;
    let wait = Infinity;
    // A decision that is under way comes first: somebody may be waiting for it.
    const deciding = [...pending].filter((run) => states.get(run).began && !states.get(run).out);
    for (const run of deciding.length > 0 ? deciding : pending) {
      const state = states.get(run);
      if (state.out > 0) {
        if (helpers.length > 0 && performance.now() - state.heard < SILENCE) continue;
        dismiss();
        forecastHere(run, state);
      }
      const before = performance.now();
      if (before < state.due) {
        wait = Math.min(wait, state.due - before);
        continue;
      }
      wait = 0;
      // Slowed down, a slice is one step at most; forecasts are not slowed down.
      const budget = rate === Infinity || state.began ? state.budget : 1;
      if (run.poll(budget) === end) pending.delete(run);
      handOut(run, state, { ticket, index: runs.indexOf(run) });
      const now = performance.now();
      if (budget === state.budget) state.budget = adapt(budget, now - before);
      const { step, check } = JSON.parse(run.progress());
      // A check began with the slice in which it was first seen, or with the end of the one before it.
      const decided = keep(run, now - (state.began || before));
      state.began = check === null ? 0 : decided ? now : state.began || before;
      if (step > state.step && rate !== Infinity) state.due = now + (1000 * (step - state.step)) / rate;
      state.step = step;
    }
    if (pending.size === 0 || performance.now() - reported > REPORT) {
      reported = performance.now();
      postMessage({ ticket, ...report(runs) });
    }
    if (wait === 0) await nextTask();
    else await new Promise((resolve) => setTimeout((wake = resolve), Math.min(wait, REPORT)));
  }
  return true;
}

/** Hires both helpers, where workers can have workers. Where one fails, both go: the run then forecasts itself. */
function hire() {
  try {
    for (let i = 0; i < 2; i += 1) {
      const helper = files.hire("worker.js");
      helpers.push(helper);
      helper.onmessage = ({ data }) => helpers.includes(helper) && receive(data);
      helper.onerror = (event) => {
        event.preventDefault();
        dismiss();
        receive({});
      };
    }
  } catch {
    dismiss();
  }
}

function dismiss() {
  for (const helper of helpers) helper.terminate();
  helpers = [];
}

function tell(message) {
  for (const helper of helpers) helper.postMessage(message);
}

/** Gives the futures that a run wants now, if any, to helpers. */
function handOut(run, state, request) {
  for (let job; (job = run.takeJob()); ) {
    state.heard = performance.now();
    if (helpers.length > 0) helpers[state.out++].postMessage({ kind: "forecast", ...request, job }, [job.buffer]);
    else forecastHere(run, state);
  }
}

/** Hears from a helper, mostly that it is there. */
function takeBack(run, state, future) {
  state.heard = performance.now();
  if (!future) return;
  try {
    run.handBack(future);
    state.out -= 1;
  } catch {
    // Whoever sends something else is not asked again.
    dismiss();
  }
}

/** Begins the forecast under way again, to the same end. */
function forecastHere(run, state) {
  run.forecastHere();
  state.out = 0;
}

/** Trains a future in slices and sends it back, unless something else was asked for meanwhile. */
async function forecast({ ticket, index, job }) {
  const beat = setInterval(() => postMessage({ ticket, index }), SILENCE / 10);
  const { Forecast } = await loaded;
  const task = new Forecast(job);
  let [budget, future] = [16];
  while (!future) {
    await gate;
    if (ticket !== current) break;
    const before = performance.now();
    future = task.poll(budget);
    budget = adapt(budget, performance.now() - before);
    await nextTask();
  }
  clearInterval(beat);
  task.free();
  if (future) postMessage({ ticket, index, future }, [future.buffer]);
}

/** The budget of the next slice, from what this one took. */
function adapt(budget, spent) {
  return Math.max(1, Math.min(4096, Math.round(budget * Math.min(2, SLICE / Math.max(spent, 0.1)))));
}

/** Takes over what a run says, and whether it decided; that took so many milliseconds. */
function keep(run, spent) {
  const known = checks.length;
  for (const event of JSON.parse(run.events())) {
    if (event.kind === "evaluation") evaluations.push(event);
    if (event.kind === "check") {
      moments.set(event.number, JSON.stringify(event));
      checks.push({ ...summarise(event), seconds: spent / 1000, token: run.token(event.number) });
    }
  }
  return checks.length > known;
}

/** What happened since the last report, without the films of the checks. */
function report(runs) {
  const legs = runs.map((run) => ({ ...JSON.parse(run.progress()), frame: JSON.parse(run.frame()) }));
  const said = { kind: "report", legs, checks, evaluations };
  [evaluations, checks] = [[], []];
  return said;
}

/** Lets messages in; unlike a timer, it does not wait. */
function nextTask() {
  return new Promise((resolve) => {
    const channel = new MessageChannel();
    channel.port1.onmessage = () => {
      channel.port1.close();
      resolve();
    };
    channel.port2.postMessage(null);
  });
}
