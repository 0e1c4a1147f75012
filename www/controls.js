// The form with every setting of a run, made from the module's own table.
import { element, make } from "./dom.js";
import { FIRST, given, untouched } from "./link.js";

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
      Object.assign(input, { id: `set-${name}`, name, defaultValue: value, autocomplete: "off" });
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

/** What the form asks for beyond an untouched run; null where it has the standard. Of another world than the one `shown`
 * it is what was typed. */
export function wanted(shown) {
  const env = element("env").value;
  const other = env !== (shown || given("env") || FIRST);
  const changes = other ? untouched() : {};
  for (const input of element("fields").querySelectorAll("input")) {
    const value = input.value.trim();
    if (other && value === input.defaultValue) continue;
    changes[input.name] = value === "" || (!other && value === input.dataset.standard) ? null : value;
  }
  return { ...changes, env, seed: element("seed").value || "0" };
}
