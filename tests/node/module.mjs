// Loads one of the page's modules in Node: the arguments of a script are FOLDER NAME and then its own.
import { readFile } from "node:fs/promises";
import { join } from "node:path";

const [folder, name, ...own] = process.argv.slice(2);

/** Arguments after folder and name. */
export const rest = own;

/** The module's exports, ready to be called. */
export async function load() {
  // Through a data address, since Node reads a plain `.js` file as something else than a module.
  const glue = await readFile(join(folder, `${name}.js`), "base64");
  const module = await import(`data:text/javascript;base64,${glue}`);
  await module.default({ module_or_path: await readFile(join(folder, `${name}_bg.wasm`)) });
  return module;
}
