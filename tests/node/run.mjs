// Runs a configuration to the switch, forks both learners, runs them to the end, and prints the events of
// every poll as it hands them over. Arguments: FOLDER NAME CONFIGURATION BUDGET
import { load, rest } from "./module.mjs";

const { Run } = await load();
const [configuration, budget] = rest;

function follow(run, stop) {
  let status;
  do {
    status = run.poll(Number(budget));
    const events = run.events();
    if (events !== "[]") console.log(events);
  } while (status !== stop);
}

const safe = new Run(configuration);
follow(safe, "switch");
for (const learner of ["baseline", "mc"]) follow(safe.fork(learner), "done");
