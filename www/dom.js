// Makes and finds elements, and writes numbers and the words that every panel shares.

/** Every leg that a run can have, in the order in which they are told. */
export const LEARNERS = {
  safe: "Safe training",
  baseline: "Ordinary learner",
  mc: "Modification-considering learner",
  oracle: "Oracle: its reward is what we want",
  frozen: "Frozen learner: no updates any more",
  "frozen-reward": "Learner with a frozen reward model",
};

/** The learner with a check is called by what it does. */
export const callChecked = (on) => (LEARNERS.mc = on ? "Modification-considering learner" : "The same learner, its check off");

/** Whether drawings have the width of a phone. */
export const narrow = matchMedia("(max-width: 40rem)");
export const element = (id) => document.getElementById(id);
export const number = (value, digits = 2) => {
  const text = value.toFixed(digits);
  // A rounded zero has no sign.
  return /^-[0.]*$/.test(text) ? text.slice(1) : text.replace("-", "−");
};
export const signed = (value, digits = 2) => {
  const text = number(value, digits);
  return /[1-9]/.test(text) && value > 0 ? `+${text}` : text;
};

/** Decimals with which rewards of a world of this scale are told apart. */
export const decimals = (scale) => Math.max(1, 1 + Math.ceil(Math.log10(scale)));

/** An action in words: what an agent does, or the torques of an arm. */
export const deed = ({ actions }, action, verb = "") =>
  Array.isArray(action)
    ? action.map((torque, index) => `${actions.continuous?.names[index] ?? "torque"} ${signed(torque)}`).join(", ")
    : verb + (actions.discrete?.[action] ?? `action ${action}`);

/** Whether a learner gets more than it earns, by more than returns of equal policies differ. */
export const parted = (score, tolerance = 1) => score.return > score.performance + tolerance;

/** An element with text. */
export function make(name, text = "", className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

/** A button that does something when it is pressed. */
export function button(text, pressed) {
  const made = make("button", text);
  made.type = "button";
  made.addEventListener("click", pressed);
  return made;
}

/** An SVG element with attributes and children. */
export function svg(name, attributes = {}, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** Shows one text, with what stands in backquotes as code, or hides the element that has none. */
export function say(id, text) {
  const parts = text.split("`").map((part, index) => (index % 2 === 1 ? make("code", part) : part));
  element(id).replaceChildren(...parts);
  element(id).hidden = text === "";
}
