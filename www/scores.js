// Where the learners of a run stand, as rows and in words, and the command that trains it natively.
import { LEARNERS, make, number, parted } from "./dom.js";

/** Settings that `mcvl train` has flags for. */
const FLAGS = ["preset", "seed"];

/** A row for every learner, by its last evaluation; returns within `tolerance` count as equal. */
export function scoreRows(scores, tolerance) {
  return [...scores.values()].map((score) => {
    const { arm, return: observed, performance } = score;
    const hacked = parted(score, tolerance);
    const row = make("tr");
    const name = make("th", LEARNERS[arm]);
    name.scope = "row";
    name.append(make("small", hacked ? "✕ gets more than it earns: hacked" : "✓ gets what it earns", hacked ? "refuse" : "accept"));
    row.append(name, make("td", number(observed, 1)), make("td", number(performance, 1)));
    return row;
  });
}

const told = (score) => `reward ${number(score.return, 1)}, performance ${number(score.performance, 1)}`;

/** Who took the bait. */
export function tellAll(scores) {
  const judged = [...scores.values()].filter(({ arm }) => arm !== "safe");
  return judged.map((score) => `${LEARNERS[score.arm]}: ${told(score)}, ${parted(score) ? "hacked" : "not hacked"}.`).join(" ");
}

/** What the learner got with its check, or without. */
export function tellGate(scores, settings) {
  return `With the check ${settings.get("scheme") === "none" ? "off" : "on"}: ${told(scores.get("mc"))}.`;
}

/** The command that trains this run natively. */
export function command(configuration) {
  const [name, ...rest] = configuration.split(" ");
  const settings = rest.map((setting) => {
    const [key, value] = setting.split("=");
    return FLAGS.includes(key) ? ` --${key} ${value}` : ` --set ${setting}`;
  });
  return `mcvl train ${name.slice(4)}${settings.join("")}`;
}
