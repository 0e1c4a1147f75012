// What it takes to derive a recorded run again here, and whether it came out.
import { calibrate } from "./computer.js";
import { same } from "./record.js";

/** What is over in less than two of one unit is told in the one before. */
const UNITS = [["s", 1], ["min", 60], ["h", 3600]];

/** Says what deriving a tape again takes here, once that was measured: the time of its updates on this machine. */
export async function price({ configuration, updates }, said) {
  said("Derive it again here");
  const pace = updates && (await calibrate(configuration));
  if (!pace) return;
  const seconds = updates * pace;
  const [unit, size] = UNITS.findLast(([, size]) => seconds >= 2 * size) ?? UNITS[0];
  said(`Derive it again here (about ${Math.ceil(seconds / size)} ${unit})`);
}

/** How many recorded checks came out again, of those that the run made by now; `rows` are its own. */
export function rederived(rows, checks = []) {
  const made = checks.filter(({ number }) => rows.has(number));
  if (made.length === 0) return "";
  const equal = made.filter((check) => same(rows.get(check.number), check));
  return ` ${equal.length} of ${checks.length} recorded decisions came out again, to the last bit.`;
}
