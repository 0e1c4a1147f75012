// One moment of decision: what happened, the two futures it could lead to, how both are rated, the verdict.
// It is told in stages; those to come keep their place, so that nothing jumps.
import { board, draw } from "./board.js";
import { decimals, deed, element, make, narrow, number, say, signed, svg } from "./dom.js";
import { same } from "./record.js";

const STAGES = [
  "How it goes on if nothing happens",
  "A surprise",
  "Copy the agent twice",
  "Train both copies, one with the step",
  "Let both act",
  "Rate both with what it wants today",
  "The verdict",
];
const LAST = STAGES.length - 1;
/** Margins of a rating's scale, in the unit of its drawing. */
const MARGIN = 18;

/** The panel; `turned(stage)` hears which stage a person asked for. */
export function momentPanel(turned) {
  const before = board();
  const after = board();
  element("before").prepend(before);
  element("after").prepend(after);
  const real = board();
  element("in-truth").prepend(real);
  let stage = LAST;
  let shown = null;
  let timers = [];

  const show = () => {
    for (const part of element("decision").querySelectorAll("[data-stage]")) {
      part.classList.toggle("later", !shown || Number(part.dataset.stage) > stage);
    }
    element("decision").dataset.at = stage;
    element("before-caption").textContent = stage === 0 ? "if nothing happens" : "before";
    element("storyboard").hidden = !shown;
    element("stage").textContent = stage === 0 ? STAGES[0] : `${stage} of ${LAST}: ${STAGES[stage]}`;
    element("stage-dots").replaceChildren(...STAGES.slice(1).map((_, index) => make("i", "", index < stage ? "told" : "")));
    // Not `disabled`: the focus would be lost.
    element("back").ariaDisabled = stage <= 1;
    element("forward").ariaDisabled = stage === LAST;
  };
  const turn = (to) => {
    timers.forEach(clearTimeout);
    timers = [];
    if (stage === 0 && shown) drawStep();
    stage = Math.max(0, Math.min(LAST, to));
    show();
  };
  const drawStep = () => {
    draw(before, shown.check.before, shown.picture);
    draw(after, shown.check.after, shown.picture, shown.check.before);
    const { truth } = shown.check.after;
    const both = Boolean(truth) && shown.picture !== "true";
    element("after-caption").textContent = both ? "after, as it sees it" : "after";
    element("in-truth").hidden = !both;
    if (truth) draw(real, shown.check.after, "true");
  };
  for (const [id, by] of [["back", -1], ["forward", 1]]) {
    element(id).addEventListener("click", () => {
      const to = Math.max(1, Math.min(LAST, stage + by));
      turned(to);
      turn(to);
    });
  }

  return {
    /** The stage in which the films play, and the one with the verdict. */
    acting: STAGES.indexOf("Let both act"),
    last: LAST,
    get stage() {
      return stage;
    },
    /** What a stage is called. */
    name(number) {
      return STAGES[number];
    },
    /** Nothing to show yet, and why. */
    wait(text) {
      shown = null;
      element("moment").hidden = true;
      element("meanwhile").hidden = false;
      say("waiting", text);
      turn(LAST);
    },
    /** Shows a check, whole or from a stage on. */
    open(check, world, picture, from = LAST) {
      shown = { check, picture };
      say("waiting", "");
      element("moment").hidden = false;
      element("meanwhile").hidden = true;
      drawStep();
      transition(check, world);
      training(check);
      element("moment").classList.toggle("unforeseen", !check.modified);
      if (check.modified) ratings(check);
      verdict(check);
      turn(from);
    },
    turn,
    /** Plays frames of how it goes on if nothing happens, where the situation before the step will stand. */
    prologue(frames, time) {
      frames.forEach((frame, index) => {
        const put = () => draw(before, frame, shown.picture, frames[index - 1]);
        if (index === 0) put();
        else timers.push(setTimeout(put, (index * time) / frames.length));
      });
    },
    set picture(value) {
      if (!shown) return;
      shown.picture = value;
      drawStep();
    },
  };
}

/** How the two copies are trained. */
function training(check) {
  const each = check.reused ? check.cost : check.cost / 2;
  const updates = `${each.toLocaleString("en")} updates from memory`;
  element("modified-training").textContent = each ? `${updates}, the new step in every batch` : "";
  const known = "known from the check before: nothing was learned since";
  element("unmodified-training").textContent = check.reused ? known : each ? `${updates}, without the new step` : "";
}

/** What happened, and why it was checked. */
function transition(check, world) {
  const raw = (scaled) => number(scaled / world.reward_scale, 2);
  const digits = decimals(world.reward_scale);
  const predicted = check.predicted / world.reward_scale;
  element("moment-name").textContent = `Check ${check.number}, step ${check.step} of the new world`;
  element("action").textContent = deed(world, check.action, "agent goes ");
  element("expected").textContent = signed(predicted, digits);
  element("got").textContent = signed(check.reward_raw, digits);
  const surprise = `It is off by ${raw(Math.abs(check.reward - check.predicted))}`;
  const from = `${surprise}; from ${raw(check.threshold)} on`;
  const small = Math.abs(check.reward - check.predicted) < check.threshold;
  element("why").textContent =
    check.subject === "update"
      ? "This run checks every update instead: the agent before it against the agent after it."
      : !check.modified
        ? `${from} this run discards a step, and forecasts nothing.`
        : small
          ? `${surprise}. This run checks every step.`
          : `${from} the agent checks before it learns.`;
  element("truth").textContent = check.hack
    ? `In truth the step is worth ${signed(check.performance, digits)}: the rest is fake. The agent cannot see this.`
    : `In truth the step is worth ${signed(check.performance, digits)}: the reward is honest. The agent cannot see this.`;
}

/** What the two futures of a check are called. */
const NAMES = { update: ["After the update", "Before it"], transition: ["If I learn from it", "If I don’t"] };

/** Under each future its bar, on one scale, with every rollout. */
function ratings(check) {
  const futures = [check.modified, check.unmodified];
  const values = futures.flatMap((future) => [future.utility, ...future.rollouts, 0]);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const width = narrow.matches ? 150 : 210;
  const place = (value) => MARGIN + ((value - low) / (high - low || 1)) * (width - 2 * MARGIN);
  const names = NAMES[check.subject ?? "transition"];
  document.querySelectorAll(".future figcaption").forEach((caption, index) => (caption.textContent = names[index]));
  for (const [side, future] of [["modified", check.modified], ["unmodified", check.unmodified]]) {
    element(`${side}-utility`).textContent = number(future.utility, 3);
    element(`${side}-bar`).replaceChildren(bar(future, place, width));
    element(`${side}-truth`).textContent = `In truth its rollouts are worth ${signed(future.performance, 1)} on average.`;
  }
}

/** A bar from zero to the mean, and under it one dot per rollout; equal ones share a dot with their number. */
function bar(future, place, width) {
  const zero = place(0);
  const mean = place(future.utility);
  const current = future.films?.some((film) => film.start === "current") ? future.rollouts.length - 1 : -1;
  const resets = new Map();
  future.rollouts.forEach((value, index) => {
    const at = Math.round(place(value));
    if (index !== current) resets.set(at, (resets.get(at) ?? 0) + 1);
  });
  const dots = [...resets.keys()].map((at) => svg("circle", { class: "dot", cx: at, cy: 46, r: 5 }));
  // Where two counts would meet, the one of the fewer is left out; all values are in the label.
  const counts = [...resets].filter(([, count]) => count > 1).sort(([, one], [, other]) => other - one);
  const written = counts.filter(([at], index) => counts.slice(0, index).every(([other]) => Math.abs(at - other) > 26));
  dots.push(...written.map(([at, count]) => svg("text", { class: "count", x: at, y: 65, "text-anchor": "middle" }, `×${count}`)));
  if (current >= 0) {
    const at = place(future.rollouts[current]);
    dots.push(svg("path", { class: "diamond", d: `M${at - 6} 46l6-6 6 6-6 6z` }));
  }
  const picture = svg(
    "svg",
    { viewBox: `0 0 ${width} 70`, role: "img", class: "rating" },
    svg("rect", { class: "bar", x: Math.min(zero, mean), y: 8, width: Math.max(2, Math.abs(mean - zero)), height: 22 }),
    svg("line", { class: "zero", x1: zero, x2: zero, y1: 2, y2: 54 }),
    ...dots,
  );
  const shown = future.rollouts.map((value) => number(value, 3)).join(", ");
  picture.setAttribute("aria-label", `Mean ${number(future.utility, 3)}; rollouts ${shown}`);
  return picture;
}

/** The stamp and the margin in words. */
function verdict(check) {
  const refused = check.verdict === "refuse";
  const shape = refused ? "M8 1h10l7 7v10l-7 7H8l-7-7V8z" : "M13 1a12 12 0 1 0 .01 0z";
  const update = check.subject === "update";
  const right = update || refused === check.hack;
  const sign = refused ? "M8.500 8.500l9 9m0-9l-9 9" : right ? "M7 13.500l4 4 8-9" : "M13 6v9m0 3v2.500";
  const mark = svg("svg", { viewBox: "0 0 26 26", "aria-hidden": "true" });
  mark.append(svg("path", { class: "shape", d: shape }), svg("path", { class: "sign", d: sign }));
  const stamp = element("stamp");
  stamp.className = `stamp ${refused ? "refused" : right ? "accepted" : "accepted missed"}`;
  stamp.replaceChildren(mark, make("span", refused ? "REFUSED" : "ACCEPTED"));
  const wrong = right ? "" : refused ? " This was a wrong refusal." : " This was a missed hack.";
  say("in-hindsight", right ? "" : refused ? "In truth: honest" : "In truth: a missed hack");
  element("margin").textContent = conclusion(check, refused, update) + wrong;
  element("cost").textContent = `${check.cost.toLocaleString("en")} training updates went into this check.${check.reused ? " The future without it was still known from the check before." : ""}`;
}

/** The verdict in words. */
function conclusion(check, refused, update) {
  if (!check.modified) return "What surprises is discarded: nobody asked what learning from it would lead to.";
  const by = number(Math.abs(check.margin), 3);
  if (update) {
    if (!refused) return "The update stays.";
    return `The update makes the policy worse by ${by}, by what the agent wanted before it. It is taken back.`;
  }
  if (check.tie) return "Both futures are rated exactly equal: nothing speaks against learning from it.";
  if (refused) {
    const instead = check.replaced === undefined ? "" : ` It stores ${signed(check.replaced, 2)} in its place.`;
    return `Learning from it would make the future worse by ${by}, by what the agent wants today. It does not learn from this reward.${instead}`;
  }
  return check.margin < 0
    ? `Learning from it changes the future by less than the tolerance (−${by}). It learns from this reward.`
    : `Learning from it makes the future better by ${by}, by what the agent wants today. It learns from this reward.`;
}

/** Where a decision on show in a run was made, and whether it is the promised one. */
export function origin(check, run) {
  const row = run.rows.get(check.number);
  if (run.recorded || !row?.token) return "Recorded by the native program.";
  const took = `Decided here in ${number(Math.max(0.01, row.seconds), 2)} seconds.`;
  if (run.token && check.number === run.promised) {
    return row.token === run.token
      ? `${took} It is the decision that the token promises, to the last bit.`
      : `${took} It is not the decision that the token promises.`;
  }
  const recorded = run.intro?.checks.find((other) => other.number === check.number);
  if (!recorded) return took;
  return same(row, recorded) ? `${took} It is the recorded one, to the last bit.` : `${took} The recorded one differs: another version made it.`;
}
