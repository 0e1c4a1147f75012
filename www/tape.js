// Reads what the native program writes: the tape of a run, the ledger of a seed, or the tape of one check.
// Whatever else is dropped on the page gets a message that says what, where and what to do.
import { LEARNERS } from "./dom.js";

const FORMAT = "mcvl tape";
const VERSION = 1;
const WAY_OUT = "Write it again with `mcvl export RUN --to tape`, or take the `ledger.jsonl` of a run.";

/**
 * The content of a file: `world`, `legs`, `evaluations`, `checks`, and the `configuration` where the file has it.
 * Throws an error with a message for people.
 */
export function read(text, name) {
  const fail = (why) => {
    throw new Unreadable(`${name}: ${why} ${WAY_OUT}`);
  };
  try {
    return content(text, fail);
  } catch (error) {
    if (error instanceof Unreadable) throw error;
    // Something is of another kind than every tape has it.
    return fail("the file is damaged.");
  }
}

class Unreadable extends Error {}

function content(text, fail) {
  const lines = text.split("\n").filter((line) => line.trim() !== "");
  if (lines.length === 0) fail("the file is empty.");
  let values;
  try {
    values = [JSON.parse(text)];
  } catch {
    values = lines.map((line, index) => {
      try {
        return JSON.parse(line);
      } catch {
        const cut = index === lines.length - 1 && /^\s*\{/.test(line);
        const place = lines.length > 1 ? `line ${index + 1}` : "the file";
        return fail(cut ? `${place} is cut off: it ends in the middle of a value.` : `${place} is no JSON.`);
      }
    });
  }
  const [first] = values;
  if (first?.format === FORMAT) return tape(first, fail);
  if (first?.verdict === undefined) fail("this is neither a tape nor a ledger of mcvl.");
  values.forEach((check, index) => sound(check, `line ${index + 1}`, fail));
  return { configuration: null, world: guess(values), legs: legs(values), evaluations: [], checks: values };
}

function tape(value, fail) {
  if (value.version !== VERSION) {
    fail(`the tape has version ${value.version}, this page reads version ${VERSION}.`);
  }
  const { configuration, world, legs, evaluations, checks, tolerance, updates } = value;
  const whole =
    /^env=\S+( \S+=\S+)*$/.test(configuration) &&
    Array.isArray(world?.actions?.discrete ?? world?.actions?.continuous?.names) &&
    world.legend.every((entry) => entry.length === 2 && entry.every((part) => typeof part === "string")) &&
    world.reward_scale > 0 &&
    // Older tapes have neither.
    (tolerance === undefined || tolerance >= 0) &&
    (updates === undefined || updates >= 0) &&
    [legs, evaluations, checks].every(Array.isArray) &&
    legs.every(({ arm, steps }) => Object.hasOwn(LEARNERS, arm) && Number.isInteger(steps)) &&
    evaluations.every((point) => Object.hasOwn(LEARNERS, point.arm) && numbers(point, ["step", "return", "performance"]));
  if (!whole) fail("the tape is damaged: its world, legs or evaluations are not what they should be.");
  checks.forEach((check, index) => sound(check, `entry ${index + 1} of its checks`, fail));
  return { configuration, world, legs, evaluations, checks, tolerance, updates };
}

const numbers = (value, keys) => keys.every((key) => Number.isFinite(value[key]));
const isFrame = ({ seen, truth }) => typeof seen === "string" && (typeof truth === "string" || truth == null);

/** Fails where a check has not what the panels show. */
function sound(check, place, fail) {
  const whole =
    numbers(check ?? {}, ["number", "step", "predicted", "reward", "reward_raw", "threshold", "cost", "performance"]) &&
    ["refuse", "accept"].includes(check.verdict) &&
    [check.before, check.after].every(isFrame) &&
    // What is discarded without a forecast has neither futures nor a margin.
    (check.modified === undefined && check.unmodified === undefined
      ? check.verdict === "refuse" && check.margin === undefined
      : Number.isFinite(check.margin) &&
        [check.modified, check.unmodified].every(isFuture) &&
        !check.modified.films === !check.unmodified.films);
  if (!whole) fail(`${place} is no check.`);
}

function isFuture(future) {
  if (!future || !Number.isFinite(future.utility) || !Array.isArray(future.rollouts)) return false;
  const films = future.films === undefined || (future.films.length > 0 && future.films.every(isFilm));
  return films && future.rollouts.every(Number.isFinite);
}

function isFilm(film) {
  const { frames, actions, predicted } = film;
  if (![frames, actions, predicted].every(Array.isArray)) return false;
  return frames.length === actions.length + 1 && predicted.length === actions.length && frames.every(isFrame);
}

/** A ledger says nothing of its world: the unit of its rewards is found in them. */
function guess(checks) {
  const telling = checks.find((check) => check.reward_raw !== 0 && check.reward !== 0);
  const reward_scale = telling ? telling.reward / telling.reward_raw : 1;
  return { name: "", actions: { discrete: [] }, legend: [], reward_scale };
}

function legs(checks) {
  return [
    { arm: "safe", steps: 0 },
    { arm: "mc", steps: Math.max(...checks.map((check) => check.step)) },
  ];
}
