// Computes a run in slices, away from the page: polls, collects what the run says, and reports a few times
// per second. Everything that is decided is decided in the module.

/** A function that returns a vector: browsers without SIMD do not accept it. */
const SIMD_PROBE = new Uint8Array([
  0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11,
]);
/** A slice of work aims at this many milliseconds, and the page hears of it this often. */
const SLICE = 20;
const REPORT = 100;

let current = 0;

onmessage = ({ data }) => {
  current += 1;
  if (data.configuration !== undefined) {
    compute(data.configuration, current).catch((error) => postMessage({ kind: "failed", message: error.message }));
  }
};

const loaded = load();
// A module that cannot be loaded is reported by the run that needs it.
loaded.catch(() => {});

async function load() {
  const name = WebAssembly.validate(SIMD_PROBE) ? "simd" : "scalar";
  const module = await import(`./pkg/${name}.js`);
  await module.default({ module_or_path: new URL(`pkg/${name}_bg.wasm`, import.meta.url) });
  return { name, Run: module.Run };
}

/** Safe training, then both learners side by side from the switch. */
async function compute(configuration, ticket) {
  const { name, Run } = await loaded;
  const start = performance.now();
  const safe = new Run(configuration);
  postMessage({ kind: "ready", module: name, world: JSON.parse(safe.world()), configuration: safe.configuration() });
  if (!(await follow([safe], "switch", ticket))) return;
  const both = [safe.fork("baseline"), safe.fork("mc")];
  if (!(await follow(both, "done", ticket))) return;
  postMessage({ kind: "done", seconds: (performance.now() - start) / 1000 });
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
      postMessage(report(runs));
    }
    await nextTask();
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
        const { step, predicted, reward, margin, verdict, hack } = event;
        const [modified, unmodified] = [event.modified.utility, event.unmodified.utility];
        checks.push({ step, predicted, reward, modified, unmodified, margin, verdict, hack });
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
