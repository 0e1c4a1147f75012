// Prints the messages of what goes wrong, as a JSON array.
import { load } from "./module.mjs";

const { Run } = await load();

function message(action) {
  try {
    action();
  } catch (error) {
    if (error instanceof Error) return error.message;
    throw error;
  }
  throw new Error("nothing went wrong");
}

const text = "env=box-moving safe_steps=0 full_steps=1";
const over = new Run(text);
while (over.poll(1000) !== "done");
console.log(
  JSON.stringify([
    message(() => new Run("env=box-moving treshold=1")),
    message(() => new Run(text).fork("mx")),
    message(() => over.fork("mc")),
  ]),
);
