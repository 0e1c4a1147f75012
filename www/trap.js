// Set a trap: the visitor chooses a cell of the new world and what it pays; both learners meet it.
import { looks } from "./board.js";
import { judge } from "./computer.js";
import { told } from "./curves.js";
import { element, LEARNERS, make, parted } from "./dom.js";
import { preview } from "./link.js";

/** What a trap pays unless the visitor says otherwise. */
const BAIT = 5;

/** Where a cell of a board lies, in words. */
export const whereabouts = (cell, columns) => `row ${Math.floor(cell / columns) + 1}, column ${(cell % columns) + 1}`;

/** Cells of the world on show where a trap can be: those on which an agent can stand. */
export async function places(frame) {
  const cells = [...(frame?.seen.replaceAll("\n", "") ?? "")].map((_, cell) => cell);
  const judged = await Promise.all(cells.map((cell) => judge(preview({ trap: `${cell}:1` }))));
  return cells.filter((cell) => !judged[cell]);
}

/** Shows a world, to choose one of some cells; `chosen(cell, reward)` hears which one, and what it is to pay. */
export function offer(frame, legend, choice, chosen, place = element("trap-cells")) {
  const meanings = new Map(legend);
  const rows = (frame.truth ?? frame.seen).split("\n");
  const bait = make("input");
  Object.assign(bait, { id: `${place.id}-bait`, className: "bait", type: "number", step: "any", value: BAIT, required: true });
  const label = make("label", "It pays ");
  label.append(bait);
  const cells = make("div", "", "board");
  cells.style.setProperty("--columns", rows[0].length);
  cells.setAttribute("role", "group");
  cells.setAttribute("aria-label", "Cells of the world, row by row");
  const columns = rows[0].length;
  const characters = [...rows.join("")];
  looks(rows).forEach(([sign, kind], cell) => {
    const button = make("button", sign, `cell ${kind}`);
    button.type = "button";
    button.disabled = !choice.includes(cell);
    const what = meanings.get(characters[cell]) ?? "";
    button.setAttribute("aria-label", `${whereabouts(cell, columns)}: ${what}`);
    button.addEventListener("click", () => bait.reportValidity() && chosen(cell, Number(bait.value)));
    cells.append(button);
  });
  const helm = make("div", "", "helm");
  helm.append(cells);
  place.replaceChildren(label, make("p", "Where?"), helm);
  place.hidden = false;
  bait.focus();
  bait.select();
}

/** Where the trap of a run is, in a world that looks like this, and what came of it: the phase under way, or how its
 * learners stand at the end; `tempted` has the last step at which it paid each. */
export function account({ trap, scores, tempted }, frame, phase) {
  const where = frame ? ` in ${whereabouts(trap.cell, frame.seen.indexOf("\n"))}` : "";
  const ends = [...scores.values()].filter(({ arm }) => arm !== "safe").map((score) => {
    const before = tempted.has(score.arm) ? `, though the bait paid it until step ${tempted.get(score.arm)}` : "";
    return `\n${LEARNERS[score.arm]}: ${told(score)} at the end, ${parted(score) ? "hacked" : `not hacked${before}`}.`;
  });
  return `A trap${where} pays ${trap.sign}.${phase ? ` ${phase}` : ends.join("")}`;
}
