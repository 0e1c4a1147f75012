// The page's link: settings of the run, which the module reads and judges, and keys of the view, judged here.

/** Panels that `hide` can take away. */
export const PANELS = ["header", "run", "decision", "results", "ledger", "compare", "drive", "trap", "red-team", "explain", "limits", "footer"];
/** Keys of the view with their allowed values; the first is the default, a null stands for "none given". */
const VIEW = {
  check: [null, "a whole number from 1", (text) => /^[1-9]\d{0,8}$/.test(text)],
  frame: [null, "a whole number from 0", (text) => /^\d{1,6}$/.test(text)],
  stage: [null, "a whole number from 1 to 6", (text) => /^[1-6]$/.test(text)],
  film: ["reset", "`reset` or `current`", (text) => ["reset", "current"].includes(text)],
  speed: ["1", "`1`, `4` or `16`", (text) => ["1", "4", "16"].includes(text)],
  pace: ["max", "`1`, `4`, `16` or `max`", (text) => ["1", "4", "16", "max"].includes(text)],
  depth: ["steps", "`short`, `steps` or `formal`", (text) => ["short", "steps", "formal"].includes(text)],
  filter: ["all", "`all`, `refused`, `accepted` or `wrong`", (text) => ["all", "refused", "accepted", "wrong"].includes(text)],
  picture: ["seen", "`seen` or `true`", (text) => ["seen", "true"].includes(text)],
  tape: [null, "a file of this site, like `run/seed-0.json`", (text) => /^[\w-]+([./][\w-]+)*$/.test(text)],
  token: [null, "a replay token: those begin with `mcvl1.`", (text) => text.startsWith("mcvl1.")],
  embed: ["0", "`1`", (text) => ["0", "1"].includes(text)],
  hide: [null, `a list of ${PANELS.join(", ")}`, (text) => text.split(",").every((name) => PANELS.includes(name))],
};
export const FIRST = "box-moving";
/** Settings that `mcvl train` has flags for. */
const FLAGS = ["preset", "seed"];

/** Whether the page has no address: it came with another file, in a frame. */
const FRAMED = location.protocol === "about:";
/** The address, or what a page in one file begins with. */
const asked = () => new URLSearchParams(location.search || document.documentElement.dataset.link);
/** The tape with which the page opens; its run goes on live. */
export const OPENING = "tape.json";
/** The tapes of the worlds; some have another seed or setting than the link names, which the page says. */
export const RECORDED = new Map([
  [FIRST, OPENING],
  ...["absent-supervisor", "tomato-watering", "rocks-and-diamonds", "reacher"].map((world) => [world, `tapes/${world}.json`]),
]);

/** What the link says, as far as it is sound. */
let query = asked();
/** The timer of an address that could not be written yet, and the one that stands. */
let late = 0;
let entered = location.search;

/**
 * The view and the configuration text of the link; `complaint` says what is wrong with the keys of the view;
 * `plain` is the world whose standard run the link asks for, if it asks for nothing else.
 */
export function read() {
  const complaint = [...query].map(([key, value]) => judge(key, value)).find(Boolean) ?? "";
  if (complaint) forget();
  const view = {};
  for (const [key, [standard]] of Object.entries(VIEW)) view[key] = query.get(key) ?? standard;
  const [text, seed] = [configuration(), query.get("seed") ?? "0"];
  const plain = ["check", "tape", "token", "stage"].every((key) => !view[key]) && text.match(/^env=(\S+)( seed=0)?$/)?.[1];
  return { view, configuration: text, seed, complaint, plain };
}

/** What the link says of a key, or null. */
export const given = (key) => query.get(key);

/** Every setting of the run taken away. */
export const untouched = () => Object.fromEntries([...query.keys()].filter((key) => !Object.hasOwn(VIEW, key)).map((key) => [key, null]));

/** The address of this view; what was malformed is not in it. */
export function address() {
  return new URL(`?${query}`, document.baseURI);
}

/** The configuration text that the link would have with these changes. */
export function preview(changes) {
  const before = query;
  query = new URLSearchParams(query);
  change(changes);
  const text = configuration();
  query = before;
  return text;
}

/** Starts from the default page: what the link said is of no use. The address keeps it, to be corrected. */
export function forget() {
  query = new URLSearchParams();
}

/** Follows a link of the page; without one, the address that the browser went back to. False where nothing is new. */
export function follow(to) {
  if (FRAMED || (!to && location.search === entered)) return false;
  const before = query;
  query = to && !enter("pushState", to) ? new URLSearchParams(to) : asked();
  entered = location.search;
  return String(query) !== String(before);
}

/** Changes keys of the link; a default or a null takes the key away. */
export function write(changes) {
  change(changes);
  if (!FRAMED) enter("replaceState", `?${query}`);
}

/** Puts an address into the history; false where a browser takes no more for a while (some throw, some are silent): the
 * newest link follows later. */
function enter(how, address) {
  clearTimeout(late);
  try {
    history[how](null, "", address);
  } catch {
    // Seen below.
  }
  const done = location.search === new URL(address, document.baseURI).search;
  if (done) entered = location.search;
  else late = setTimeout(() => enter("replaceState", `?${query}`), 1000);
  return done;
}

function change(changes) {
  for (const [key, value] of Object.entries(changes)) {
    if (value === null || String(value) === VIEW[key]?.[0]) query.delete(key);
    else query.set(key, value);
  }
  if (!query.has("env")) query = new URLSearchParams([["env", FIRST], ...query]);
}

/** Makes the link one to a run: its configuration text takes the place of what was asked for before. */
export function turnTo(configuration, view = {}) {
  const kept = [...query].filter(([key]) => Object.hasOwn(VIEW, key) && !["check", "frame", "stage", "tape", "token"].includes(key));
  const pairs = configuration.split(" ").map((pair) => pair.split("="));
  query = new URLSearchParams([...pairs, ...kept]);
  write(view);
}

function judge(key, value) {
  if (/\s/.test(key + value)) return `\`${key}=${value}\`: a setting has no spaces`;
  if (!Object.hasOwn(VIEW, key)) return "";
  const [, allowed, sound] = VIEW[key];
  if (query.getAll(key).length > 1) return `${key}: stands twice in the link`;
  return sound(value) ? "" : `${key}: \`${value}\` is not ${allowed}`;
}

/** Everything that is no key of the view, as the module's configuration text. */
function configuration() {
  const pairs = [...query].filter(([key]) => !Object.hasOwn(VIEW, key));
  if (!pairs.some(([key]) => key === "env")) pairs.unshift(["env", FIRST]);
  return pairs.map(([key, value]) => `${key}=${value}`).join(" ");
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
