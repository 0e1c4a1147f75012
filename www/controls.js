// The form with every setting of a run, made from the module's own table.
import { element, make } from "./dom.js";

/** Settings with a place of their own, or none on a page that always shows both learners. */
const ELSEWHERE = ["seed", "agent"];

/** Fills the form with the settings of the run that begins. */
export function fill(settings) {
  const fields = settings
    .filter(({ name }) => !ELSEWHERE.includes(name))
    .map(({ name, value, standard, help, range, source }) => {
      const field = make("div", "", "field");
      const label = make("label", name.replaceAll("_", " "));
      const input = make("input");
      Object.assign(input, { id: `set-${name}`, name, value, autocomplete: "off" });
      input.dataset.standard = standard;
      label.htmlFor = input.id;
      const about = make("small", `${help} ${range}; standard for this world and preset: ${standard} (${source}).`);
      about.id = `about-${name}`;
      input.setAttribute("aria-describedby", about.id);
      field.append(label, input, about);
      return field;
    });
  element("fields").replaceChildren(...fields);
}

/** What the form asks for beyond an untouched run; null where it has the standard. */
export function changed() {
  const changes = {};
  for (const input of element("fields").querySelectorAll("input")) {
    const value = input.value.trim();
    changes[input.name] = value === "" || value === input.dataset.standard ? null : value;
  }
  return changes;
}
