// What it takes to derive a recorded run again here, and whether it came out.
import { same } from "./record.js";

/** What is over in less than two of one unit is told in the one before. */
const UNITS = [["s", 1], ["min", 60], ["h", 3600]];

/** What deriving so many updates again takes here, where one takes `pace` seconds: empty where that is not known. */
export function price(updates, pace) {
  if (!updates || !pace) return "";
  const seconds = updates * pace;
  const [unit, size] = UNITS.findLast(([, size]) => seconds >= 2 * size) ?? UNITS[0];
  return ` (about ${Math.ceil(seconds / size)} ${unit})`;
}

/** How many recorded checks came out again, of those that the run made by now; what it made has a token. */
export function rederived(rows, checks = []) {
  const made = checks.filter(({ number }) => rows.get(number)?.token);
  if (made.length === 0) return "";
  const equal = made.filter((check) => same(rows.get(check.number), check));
  return ` ${equal.length} of ${checks.length} recorded decisions came out again, to the last bit.`;
}
