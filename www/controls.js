// The form with every setting of a run, made from the module's own table.
import { element, make } from "./dom.js";

/** Settings with a place of their own, or none on a page that always shows both learners. */
const ELSEWHERE = ["seed", "agent"];

/** The form describes a run, of one of the experiments there are, and stands beside what its world is about. */
export function fill(experiments, settings, configuration) {
  const options = experiments.map(({ name, title }) => Object.assign(make("option", title), { value: name }));
  element("env").replaceChildren(...options);
  element("env").value = configuration.split(" ")[0].split("=")[1];
  const { task, hack } = experiments.find(({ name }) => name === element("env").value);
  element("about").replaceChildren(make("strong", "Task: "), `${task}. `, make("strong", "The catch: "), `${hack}.`);
  element("about").classList.remove("later");
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
