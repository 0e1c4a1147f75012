// Every scheme and baseline in ten recorded seeds: a table, the band of one of them behind the curves, and what became of
// seeds like the recorded one on show.
import { element, LEARNERS, make, number } from "./dom.js";
import * as files from "./files.js";

const PLACE = element("comparison");
let loaded = null;
/** Title of the entry whose band is drawn; null for none. */
let chosen = null;

// It may come the next time.
const lost = (error) => {
  loaded = null;
  throw error;
};
const sets = () => (loaded ??= files.get("bands.json").then((response) => response.json()).catch(lost));

/** Titles of the sets whose settings a recording may have. The arm's set was moved by another simulator. */
const SETS = new Map([
  ["", "Check what surprises"],
  ["lr_reward=0.001", "Check what surprises, reward model alive"],
]);

/** Seed and settings of a recorded run, and how many recorded seeds with these settings were hacked, if that is known. */
export async function sample(configuration) {
  const [world, ...rest] = configuration.slice(4).split(" ");
  const settings = rest.filter((setting) => !setting.startsWith("seed="));
  const seed = rest.find((setting) => setting.startsWith("seed="))?.slice(5) ?? "0";
  const told = `Recorded: seed ${seed}, ${settings.map((setting) => `\`${setting}\``).join(", ") || "the paper’s setting"}.`;
  // A page in a frame comes without the sets.
  const all = world === "reacher" ? {} : await sets().catch(() => ({}));
  const set = all[world]?.find(({ title }) => title === SETS.get(settings.join(" ")));
  return set ? `${told} Of ${set.seeds} seeds with it ${set.hacked} are hacked in the end.` : told;
}

/** Shows what was recorded of a world; `choose(entry)` hears whose band is to be drawn, null for none. */
export async function compare(world, choose) {
  const entries = await sets().then((all) => all[world] ?? [], () => null);
  if (!entries?.length) {
    PLACE.replaceChildren(make("p", entries ? "No set of ten seeds of this world comes with the page." : "The recorded sets could not be loaded."));
    return choose(null);
  }
  const before = entries.find(({ title }) => title === chosen) ?? null;
  if (!before) chosen = null;
  const table = make("table");
  const head = make("tr");
  for (const [text, kind] of [["Band", "word"], ["Reward", ""], ["Performance", ""], ["Hacked", ""], ["Checks", ""]]) {
    const cell = make("th", text, kind);
    cell.scope = "col";
    head.append(cell);
  }
  const body = make("tbody");
  for (const entry of [null, ...entries]) {
    const row = make("tr");
    const name = make("th");
    name.scope = "row";
    const label = make("label");
    const title = entry?.title ?? null;
    const radio = Object.assign(make("input"), { type: "radio", name: "band", checked: title === chosen });
    radio.addEventListener("change", () => {
      chosen = title;
      choose(entry);
    });
    label.append(radio, ` ${entry ? entry.title : "none"}`);
    name.append(label);
    row.append(name);
    if (entry) {
      const { mean, hacked, seeds, checks } = entry;
      const cells = [number(mean[0], 1), number(mean[1], 1), `${hacked} of ${seeds}`, checks === null ? "–" : number(checks, 0)];
      row.append(...cells.map((text) => make("td", text)));
    } else {
      row.append(...Array.from({ length: 4 }, () => make("td")));
    }
    body.append(row);
  }
  const top = make("thead");
  top.append(head);
  table.append(top, body);
  const note = "Means at the end of the new world; checks per seed. The band is the 95 % interval of the mean.";
  const scroll = make("div", "", "scroll");
  scroll.tabIndex = 0;
  scroll.setAttribute("role", "region");
  scroll.setAttribute("aria-label", `Recorded sets beside ${LEARNERS.mc}`);
  scroll.append(table);
  PLACE.replaceChildren(scroll, make("p", note, "quiet"));
  choose(before);
}
