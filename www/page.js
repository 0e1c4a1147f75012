// Shows what the worker reports. The configuration of the run is the page's link.

const LEARNERS = {
  safe: "Safe training",
  baseline: "Ordinary learner",
  mc: "Modification-considering learner",
};
/** How characters of a frame are drawn: sign and class. */
const CELLS = {
  B: ["■", "box"],
  A: ["●", "agent"],
  "^": ["▲", ""],
  v: ["▼", ""],
  $: ["▼5", "fake"],
  "+": ["+5", ""],
  ".": ["", ""],
};
/** Settings that `mcvl train` has flags for. */
const FLAGS = ["preset", "seed"];
/** Verdicts are spoken at most this often, milliseconds. */
const SPEAK = 2000;

const element = (id) => document.getElementById(id);
const number = (value, digits = 2) => value.toFixed(digits).replace("-", "−");
const signed = (value, digits = 2) => (value > 0 ? "+" : "") + number(value, digits);
const still = matchMedia("(prefers-reduced-motion: reduce)");

const worker = new Worker("worker.js", { type: "module" });
let view;

/** Forgets the last run. */
function clear() {
  view = { world: null, legs: new Map(), scores: new Map(), refused: 0, accepted: 0, wrong: 0, spoken: 0 };
  for (const id of ["legs", "legend", "scores", "verdicts"]) element(id).replaceChildren();
  element("tally").textContent = "No verdict yet.";
  element("error").hidden = true;
}

function start(configuration) {
  clear();
  element("status").textContent = "Computing.";
  element("stop").disabled = false;
  worker.postMessage({ configuration });
}

function stop(text) {
  element("status").textContent = text;
  element("stop").disabled = true;
}

/** An element with text. */
function make(name, text = "", className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  made.className = className;
  return made;
}

/** The drawing of a leg, made when it is first heard of. */
function leg(arm) {
  if (!view.legs.has(arm)) {
    const figure = make("figure", "", "leg");
    const board = make("div", "", "board");
    const figures = make("p");
    board.setAttribute("role", "img");
    figure.append(make("figcaption", LEARNERS[arm]), board, figures);
    element("legs").append(figure);
    view.legs.set(arm, { board, figures });
  }
  return view.legs.get(arm);
}

function draw(board, frame) {
  const rows = frame.seen.split("\n");
  board.setAttribute("aria-label", `The world, row by row: ${rows.join(", ")}`);
  board.replaceChildren(
    ...[...rows.join("")].map((character) => {
      const [sign, kind] = CELLS[character] ?? [character, ""];
      return make("div", sign, `cell ${kind}`);
    }),
  );
}

function showLegend(legend) {
  const entries = Object.entries(legend).filter(([character]) => character !== ".");
  element("legend").replaceChildren(
    ...entries.map(([character, meaning]) => {
      const entry = make("div");
      entry.append(make("dt", CELLS[character]?.[0] ?? character), make("dd", meaning));
      return entry;
    }),
  );
}

function showScore(point) {
  view.scores.set(point.arm, point);
  const rows = [...view.scores.values()].map(({ arm, step, return: observed, performance }) => {
    const parted = observed > performance + 1;
    const words = parted ? "gets more than it earns: hacked" : "gets what it earns";
    const row = make("tr");
    const name = make("th", LEARNERS[arm]);
    name.scope = "row";
    row.append(name, make("td", step), make("td", number(observed, 1)), make("td", number(performance, 1)));
    row.append(make("td", words, parted ? "refuse" : "accept"));
    return row;
  });
  element("scores").replaceChildren(...rows);
}

function showCheck(check) {
  const refused = check.verdict === "refuse";
  view.refused += refused;
  view.accepted += !refused;
  view.wrong += refused !== check.hack;
  const row = make("tr");
  const numbers = [number(check.predicted), number(check.reward), number(check.modified, 3), number(check.unmodified, 3)];
  row.append(make("td", check.step), ...numbers.map((text) => make("td", text)), make("td", signed(check.margin, 3)));
  row.append(make("td", refused ? "✕ refused" : "✓ accepted", refused ? "word refuse" : "word accept"));
  row.append(make("td", check.hack ? "fake" : "honest"));
  element("verdicts").prepend(row);
}

/** Says the newest verdict, not every one. */
function speak(check) {
  const now = performance.now();
  if (now - view.spoken < SPEAK) return;
  view.spoken = now;
  const verdict = check.verdict === "refuse" ? "refused" : "accepted";
  element("latest").textContent =
    `Step ${check.step}: expected ${number(check.predicted)}, got ${number(check.reward)}: ${verdict}.`;
}

const receive = {
  ready({ module, world, configuration }) {
    view.world = world;
    showLegend(world.legend);
    element("module").textContent = module === "simd" ? "module with SIMD" : "module without SIMD";
    const settings = configuration.split(" ").slice(1).map((setting) => {
      const [key, value] = setting.split("=");
      return FLAGS.includes(key) ? ` --${key} ${value}` : ` --set ${setting}`;
    });
    element("command").textContent = `mcvl train ${world.name}${settings.join("")}`;
  },

  report({ legs, checks, evaluations }) {
    for (const { arm, frame, step, steps, checks, refusals } of legs) {
      const { board, figures } = leg(arm);
      // Moving pictures only for those who want them: the last one always stays.
      if (!still.matches || step === steps || board.childElementCount === 0) draw(board, frame);
      const decided = arm === "mc" ? `, ${checks} checks, ${refusals} refused` : "";
      figures.textContent = `step ${step} of ${steps}${decided}`;
    }
    evaluations.forEach(showScore);
    checks.forEach(showCheck);
    if (checks.length > 0) {
      const { refused, accepted, wrong } = view;
      element("tally").textContent = `${refused} refused, ${accepted} accepted; ${wrong} of them wrong in truth.`;
      speak(checks.at(-1));
    }
  },

  done({ seconds }) {
    stop(`Done in ${number(seconds, 1)} seconds.`);
  },

  failed({ message }) {
    element("error").textContent = message;
    element("error").hidden = false;
    stop("Nothing is running.");
  },
};

worker.onmessage = ({ data }) => receive[data.kind](data);
worker.onerror = () => receive.failed({ message: "The module could not be loaded: `cargo xtask web` builds it." });

element("controls").addEventListener("submit", (event) => {
  event.preventDefault();
  const query = new URLSearchParams(location.search);
  query.set("seed", element("seed").value || "0");
  history.replaceState(null, "", `?${query}`);
  start(configuration());
});

element("stop").addEventListener("click", () => {
  worker.postMessage({});
  stop("Stopped.");
});

/** The configuration text of the link; the module says what is wrong with it, if something is. */
function configuration() {
  const pairs = [...new URLSearchParams(location.search)];
  if (!pairs.some(([key]) => key === "env")) pairs.unshift(["env", "box-moving"]);
  return pairs.map(([key, value]) => `${key}=${value}`).join(" ");
}

clear();
element("seed").value = new URLSearchParams(location.search).get("seed") ?? "0";
if (still.matches) stop("Nothing starts by itself: press Run.");
else start(configuration());
