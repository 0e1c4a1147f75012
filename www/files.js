// How the page comes to its own files: they lie beside it. A page that is one file brings a module of the same
// name that takes them from there.

/** Why nothing can be computed with these files; empty where all are there. */
export const lack = "";

/** The module of a file. */
export const load = (name) => import(`./${name}`);

/** The content of a file, as a response; one was asked for early. */
export function get(name) {
  const { early } = globalThis;
  const response = early?.name === name ? early.response : fetch(name);
  if (early?.name === name) globalThis.early = null;
  if (name.startsWith("tapes/")) keepSeen(name, response).catch(() => {});
  return response;
}

/** Keeps a recording that came before the service worker was there. */
async function keepSeen(name, response) {
  const workers = navigator.serviceWorker;
  if (!workers || workers.controller) return;
  const copy = (await response).clone();
  await workers.ready;
  if (copy.ok) await (await caches.open("mcvl recordings")).put(name, copy);
}

/** A worker that runs a file. */
export const hire = (name) => new Worker(name, { type: "module" });

/** Keeps the page, with the module that this browser takes, for visits without a network. */
export function keepOffline(module) {
  // Without permission or a secure context the page needs its host, as any page does.
  const address = `sw.js?module=${module}`;
  navigator.serviceWorker?.register(address, { updateViaCache: "none" }).catch(() => {});
}
