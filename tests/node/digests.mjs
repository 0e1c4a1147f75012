// Prints the digests that a module computes.
import { load } from "./module.mjs";

const { digests } = await load();
console.log(digests());
