// What each learner gets and what we want: the curves of a run, drawn by hand over the steps of both phases, and
// where its learners stand, as rows and in words.
import { element, LEARNERS, make, number, parted, svg } from "./dom.js";

/** Least time between two drawings, milliseconds. */
const PAUSE = 250;
const HEIGHT = 260;
/** Width of a slider's thumb. */
const THUMB = 16;
const EDGE = { left: 46, right: 12, top: 22, bottom: 54 };
const ARMS = Object.keys(LEARNERS);

/** The panel; `open(number)` is called when a verdict mark is chosen with the pointer. */
export function curves(open) {
  let points = [];
  let checks = [];
  let steps = { safe: 0, full: 0 };
  let cursor = null;
  let asked = false;
  let drawn = -PAUSE;
  /** Recorded seeds behind the curves, and the learner's curve of the run before. */
  let [band, kept, past] = [null, [], []];

  let width = 0;
  const end = () => Math.max(1, steps.safe + steps.full);
  const x = (step) => EDGE.left + (step / end()) * (width - EDGE.left - EDGE.right);

  const drawAll = () => {
    asked = false;
    if (points.length > 0) drawn = performance.now();
    // One unit is one pixel, so that the timeline below stands under its steps.
    width = Math.max(200, Math.min(760, element("curves").parentElement.clientWidth));
    element("curves").setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
    element("curves").style.width = `${width}px`;
    const spread = band ? [...band.return, ...band.performance].flat() : [];
    const values = [...points, ...past].flatMap((point) => [point.return, point.performance]).concat(spread);
    const [low, high] = scale(Math.min(0, ...values), Math.max(10, ...values));
    const y = (value) => EDGE.top + ((high - value) / (high - low)) * (HEIGHT - EDGE.top - EDGE.bottom);
    const base = HEIGHT - EDGE.bottom;
    const parts = [];
    for (const tick of ticks(low, high)) {
      parts.push(svg("line", { class: tick === 0 ? "axis" : "rule", x1: EDGE.left, x2: width - EDGE.right, y1: y(tick), y2: y(tick) }));
      parts.push(svg("text", { x: EDGE.left - 6, y: y(tick) + 4, "text-anchor": "end" }, number(tick, 0)));
    }
    if (steps.full > 0 && steps.safe > 0) {
      const at = x(steps.safe);
      parts.push(svg("line", { class: "switch", x1: at, x2: at, y1: 6, y2: base + 24 }));
      const cramped = at + 70 > width;
      const before = svg("text", { x: at - 5, y: 15, "text-anchor": "end" }, cramped ? "the new world begins" : "safe world");
      parts.push(before, ...(cramped ? [] : [svg("text", { x: at + 5, y: 15 }, "new world")]));
    }
    if (band && steps.full > 0) {
      const at = (step) => x(steps.safe + step * (steps.full / band.steps.at(-1))).toFixed(1);
      for (const [key, kind] of [["return", "seen"], ["performance", "wanted"]]) {
        const edge = (side) => band[key].map((interval, index) => `${at(band.steps[index])},${y(interval[side]).toFixed(1)}`);
        parts.push(svg("polygon", { class: `band ${kind}`, points: [...edge(0), ...edge(1).reverse()].join(" ") }));
      }
    }
    if (past.length > 0) {
      const line = past.map((point) => `${x(place(point)).toFixed(1)},${y(point.performance).toFixed(1)}`);
      parts.push(svg("polyline", { class: "past", points: line.join(" ") }));
    }
    for (const arm of ARMS) {
      const own = points.filter((point) => point.arm === arm);
      const line = (key) => own.map((point) => `${x(place(point)).toFixed(1)},${y(point[key]).toFixed(1)}`).join(" ");
      if (own.length === 0) continue;
      parts.push(svg("polyline", { class: `return ${arm}`, points: line("return") }));
      parts.push(svg("polyline", { class: `performance ${arm}`, points: line("performance") }));
    }
    for (const check of checks) parts.push(mark(x(steps.safe + check.step), base + 14, check.refused));
    const chosen = checks.find((check) => check.number === cursor);
    if (chosen) {
      const at = x(steps.safe + chosen.step);
      parts.push(svg("line", { class: "cursor", x1: at, x2: at, y1: EDGE.top, y2: base + 24 }));
    }
    parts.push(svg("text", { x: EDGE.left, y: HEIGHT - 8 }, "0"));
    parts.push(svg("text", { x: width - EDGE.right, y: HEIGHT - 8, "text-anchor": "end" }, `${end()} steps`));
    element("curves").replaceChildren(...parts);
    element("curves").setAttribute("aria-label", describe());
    key();
    follow();
  };
  const place = (point) => point.step + (point.arm === "safe" ? 0 : steps.safe);
  // Reports come faster than a picture is worth drawing; the first one is drawn at once.
  const later = () => {
    if (asked) return;
    asked = true;
    setTimeout(() => requestAnimationFrame(drawAll), Math.max(0, drawn + PAUSE - performance.now()));
  };
  const newest = (arm) => points.findLast((point) => point.arm === arm);
  const describe = () => {
    const ends = ARMS.map(newest).filter(Boolean);
    const words = ends.map((point) => `${LEARNERS[point.arm]}: reward ${number(point.return, 0)}, performance ${number(point.performance, 0)}`);
    return `Reward and performance over the steps. Newest: ${words.join("; ")}`;
  };
  const key = () => {
    const entry = (text, ...shapes) => {
      const made = make("span", "", "key");
      made.append(svg("svg", { viewBox: "0 0 34 20", "aria-hidden": "true" }, ...shapes), text);
      return made;
    };
    const line = (kind, y) => svg("line", { class: kind, x1: 1, x2: 33, y1: y, y2: y });
    const box = (kind) => svg("rect", { class: `band ${kind}`, width: 34, height: 20 });
    const made = ARMS.filter(newest).map((arm) => entry(LEARNERS[arm], line(`return ${arm}`, 5), line(`performance ${arm}`, 15)));
    if (past.length > 0) made.push(entry("Performance in the run before", line("past", 10)));
    if (band) made.push(entry(`Reward, ${band.seeds} seeds: ${band.title}`, box("seen")), entry("their performance", box("wanted")));
    element("curves-key").replaceChildren(...made);
  };

  element("curves").addEventListener("click", (event) => {
    const box = element("curves").getBoundingClientRect();
    const at = ((event.clientX - box.left) / box.width) * width;
    const far = (check) => Math.abs(x(steps.safe + check.step) - at);
    const nearest = checks.toSorted((one, other) => far(one) - far(other))[0];
    if (nearest && far(nearest) < 12) open(nearest.number);
  });

  // The timeline stands on a check; dragging it opens the nearest one.
  const timeline = element("timeline");
  timeline.addEventListener("input", () => {
    const far = (check) => Math.abs(steps.safe + check.step - timeline.value);
    const nearest = checks.toSorted((one, other) => far(one) - far(other))[0];
    if (nearest && nearest.number !== cursor) open(nearest.number);
    follow();
  });
  const follow = () => {
    const chosen = checks.find((check) => check.number === cursor);
    timeline.disabled = checks.length === 0;
    timeline.max = end();
    // The thumb reaches half its width less far than the rail.
    timeline.style.width = `${width - EDGE.left - EDGE.right + THUMB}px`;
    timeline.style.marginLeft = `${EDGE.left - THUMB / 2}px`;
    if (chosen && document.activeElement !== timeline) timeline.value = steps.safe + chosen.step;
    const said = chosen
      ? `Step ${chosen.step} of the new world: check ${chosen.number}, ${chosen.refused ? "refused" : "accepted"}`
      : "No check yet";
    timeline.setAttribute("aria-valuetext", said);
    element("timeline-at").textContent = said;
  };

  addEventListener("resize", later);

  return {
    /** The next run is to be seen beside this one. */
    keep() {
      kept = points.filter((point) => point.arm === "mc");
    },
    /** Draws the intervals of recorded seeds behind the curves; null for none. */
    behind(entry) {
      if (entry === band) return;
      band = entry;
      later();
    },
    clear() {
      [past, kept] = [kept, []];
      [points, checks, steps, cursor] = [[], [], { safe: 0, full: 0 }, null];
      later();
    },
    /** Takes what a report says of the run. */
    add({ legs, evaluations, checks: made }) {
      for (const leg of legs) steps[leg.arm === "safe" ? "safe" : "full"] = leg.steps;
      points.push(...evaluations);
      checks.push(...made);
      if (evaluations.length + made.length > 0) later();
    },
    choose(number) {
      cursor = number;
      later();
    },
  };
}

/** A refusal is a cross, an acceptance a ring. */
function mark(x, y, refused) {
  return refused
    ? svg("path", { class: "mark refused", d: `M${x - 4} ${y - 4}l8 8m0-8l-8 8` })
    : svg("circle", { class: "mark accepted", cx: x, cy: y, r: 4 });
}

function unit(span) {
  const power = 10 ** Math.floor(Math.log10(span / 4));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => span / step <= 6);
}

function scale(low, high) {
  const step = unit(high - low);
  return [Math.floor(low / step) * step, Math.ceil(high / step) * step];
}

function ticks(low, high) {
  const step = unit(high - low);
  return Array.from({ length: Math.round((high - low) / step) + 1 }, (_, index) => low + index * step);
}

/** A row for every learner, by its last evaluation, which is its end once the run is `over`; returns within `tolerance`
 * count as equal. */
export function scoreRows(scores, tolerance, over) {
  return [...scores.values()].map((score) => {
    const { arm, return: observed, performance } = score;
    const hacked = parted(score, tolerance);
    const row = make("tr");
    const name = make("th", LEARNERS[arm]);
    name.scope = "row";
    const honest = over || arm === "safe" ? "✓ gets what it earns" : "gets what it earns so far";
    name.append(make("small", hacked ? "✕ gets more than it earns: hacked" : honest, hacked ? "refuse" : over ? "accept" : "quiet"));
    row.append(name, make("td", number(observed, 1)), make("td", number(performance, 1)));
    return row;
  });
}

/** What a learner stands at. */
export const told = (score) => `reward ${number(score.return, 1)}, performance ${number(score.performance, 1)}`;

/** What the learner got with its check, or without. */
export function tellGate(scores, settings) {
  return `With the check ${settings.get("scheme") === "none" ? "off" : "on"}: ${told(scores.get("mc"))}.`;
}
