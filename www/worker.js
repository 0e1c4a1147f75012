// Computes a run in slices, away from the page: polls, collects what the run says, and reports a few times
// per second. Checks are kept whole, with their films, for the page to ask for one. Everything that is
// decided is decided in the module.

/** A function that returns a vector: browsers without SIMD do not accept it. */
const SIMD_PROBE = new Uint8Array([
  0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11,
]);
/** A slice of work aims at this many milliseconds, and the page hears of it this often. */
const SLICE = 20;
const REPORT = 100;

let current = 0;
/** The checks of the current run as JSON text, by number. */
let moments = new Map();
/** Resolves when the run may go on; `goOn` resolves it. */
let gate = Promise.resolve();
let goOn = () => {};

const requests = {
  start({ configuration }) {
    current += 1;
    moments = new Map();
    requests.resume();
    const ticket = current;
    compute(configuration, ticket).catch((error) => postMessage({ kind: "failed", ticket, message: error.message }));
  },
  pause() {
    gate = new Promise((resolve) => (goOn = resolve));
  },
  resume() {
    goOn();
    gate = Promise.resolve();
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
  const name = WebAssembly.validate(SIMD_PROBE) ? "simd" : "scalar";
  const module = await import(`./pkg/${name}.js`);
  await module.default({ module_or_path: new URL(`pkg/${name}_bg.wasm`, import.meta.url) });
  return { name, Run: module.Run, experiments: JSON.parse(module.experiments()) };
}

/** Safe training, then both learners side by side from the switch. */
async function compute(configuration, ticket) {
  const { name, Run, experiments } = await loaded;
  if (ticket !== current) return;
  const start = performance.now();
  let safe;
  try {
    safe = new Run(configuration);
  } catch (error) {
    postMessage({ kind: "malformed", ticket, message: error.message });
    return;
  }
  const world = JSON.parse(safe.world());
  postMessage({ kind: "ready", ticket, module: name, experiments, world, configuration: safe.configuration() });
  if (!(await follow([safe], "switch", ticket))) return;
  const both = [safe.fork("baseline"), safe.fork("mc")];
  if (!(await follow(both, "done", ticket))) return;
  postMessage({ kind: "done", ticket, seconds: (performance.now() - start) / 1000 });
}

/** Polls runs in turn until all have the status `end`; false where another run was asked for meanwhile. */
async function follow(runs, end, ticket) {
  const pending = new Set(runs);
  let budget = 16;
  let reported = performance.now();
  while (pending.size > 0) {
    for (const run of pending) {
      const before = performance.now();
      if (run.poll(budget) === end) pending.delete(run);
      const spent = performance.now() - before;
      budget = Math.max(1, Math.min(4096, Math.round(budget * Math.min(2, SLICE / Math.max(spent, 0.1)))));
    }
    if (pending.size === 0 || performance.now() - reported > REPORT) {
      reported = performance.now();
      postMessage({ ticket, ...report(runs) });
    }
    await nextTask();
    await gate;
    if (ticket !== current) return false;
  }
  return true;
}

/** What happened since the last report, without the films of the checks. */
function report(runs) {
  const legs = [];
  const checks = [];
  const evaluations = [];
  for (const run of runs) {
    legs.push({ ...JSON.parse(run.progress()), frame: JSON.parse(run.frame()) });
    for (const event of JSON.parse(run.events())) {
      if (event.kind === "evaluation") evaluations.push(event);
      if (event.kind === "check") {
        moments.set(event.number, JSON.stringify(event));
        const { number, step, predicted, reward_raw, margin, hack } = event;
        const [modified, unmodified] = [event.modified.utility, event.unmodified.utility];
        const refused = event.verdict === "refuse";
        checks.push({ number, step, predicted, reward_raw, modified, unmodified, margin, refused, hack });
      }
    }
  }
  return { kind: "report", legs, checks, evaluations };
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
