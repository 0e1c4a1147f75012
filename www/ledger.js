// The table of every verdict: the accessible twin of the page. A row opens its moment.
import { decimals, element, make, number, signed } from "./dom.js";

const SHOWN = {
  all: () => true,
  refused: (check) => check.refused,
  accepted: (check) => !check.refused,
  wrong: (check) => check.wrong,
};

/** A ledger; `open(number)` is called when a row is chosen. */
export function ledger(open) {
  const body = element("verdicts");
  const rows = new Map();
  let filter = "all";
  let chosen = null;

  body.addEventListener("click", (event) => {
    const row = event.target.closest("tr");
    if (row) open(Number(row.dataset.check));
  });

  const tally = () => {
    const checks = [...rows.values()].map(({ check }) => check);
    const count = (name) => checks.filter(SHOWN[name]).length;
    const hidden = filter === "all" ? "" : ` Shown: ${count(filter)} (${filter}).`;
    element("tally").textContent =
      checks.length === 0
        ? "No verdict yet."
        : `${count("refused")} refused, ${count("accepted")} accepted; ${count("wrong")} of them wrong in truth.${hidden}`;
  };

  const shown = () => [...rows.values()].filter(({ row }) => !row.hidden).map(({ check }) => check.number);

  return {
    clear() {
      rows.clear();
      body.replaceChildren();
      chosen = null;
      tally();
    },
    /** Adds checks, oldest first; the table has the newest on top. */
    add(checks, scale) {
      const made = checks.map((check) => {
        const row = line(check, scale);
        row.hidden = !SHOWN[filter](check);
        rows.set(check.number, { check, row });
        return row;
      });
      body.prepend(...made.reverse());
      tally();
    },
    set filter(name) {
      filter = name;
      for (const { check, row } of rows.values()) row.hidden = !SHOWN[filter](check);
      tally();
    },
    /** Marks the row of the moment on show. */
    choose(number) {
      rows.get(chosen)?.row.removeAttribute("aria-current");
      chosen = number;
      rows.get(chosen)?.row.setAttribute("aria-current", "true");
    },
    /** The neighbour of a check among those shown: 1 for the next, −1 for the one before. */
    beside(number, direction) {
      const found = shown().filter((other) => (number === null ? true : (other - number) * direction > 0));
      return found.at(direction > 0 ? 0 : -1) ?? null;
    },
    /** The newest check of those shown. */
    newest() {
      return shown().at(-1) ?? null;
    },
  };
}

function line(check, scale) {
  const row = make("tr");
  row.dataset.check = check.number;
  // How long the decision took here; a recorded one says nothing of that.
  if (check.seconds) row.dataset.seconds = check.seconds;
  const button = make("button", `#${check.number}`);
  button.type = "button";
  button.setAttribute("aria-label", `Show check ${check.number}`);
  const first = make("td");
  first.append(button);
  const numbers = [
    number(check.predicted / scale, decimals(scale)),
    number(check.reward_raw, decimals(scale)),
    ...(check.modified === undefined
      ? ["–", "–", "–"]
      : [number(check.modified, 3), number(check.unmodified, 3), signed(check.margin, 3)]),
  ];
  const word = `${check.refused ? "✕ refused" : "✓ accepted"}${check.wrong ? ", wrongly" : ""}`;
  const verdict = make("td", word, check.refused || check.wrong ? "word refuse" : "word accept");
  row.append(first, verdict, make("td", check.step), ...numbers.map((text) => make("td", text)));
  row.append(make("td", check.hack ? "fake" : "honest", "word"));
  return row;
}
