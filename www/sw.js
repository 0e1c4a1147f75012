// Keeps the page for visits without a network. With one, the network answers, so that nobody sees an old page. Without
// one, all files are of one build: the name of another one installs this worker anew.

// Without it nothing is kept: the worker from before stays, and the next visit tries again.
importScripts("pkg/build.js");

const home = new URL("./", location.href).pathname;
const KEPT = `mcvl ${home} ${self.build}`;
/** Recordings that were seen, of any build. */
const RECORDINGS = "mcvl recordings";
const module = new URL(location.href).searchParams.get("module");
const FILES = [
  "./",
  "bands.json",
  "board.js",
  "compare.js",
  "computer.js",
  "controls.js",
  "curves.js",
  "dom.js",
  "drive.js",
  "early.js",
  "explain.js",
  "files.js",
  "film.js",
  "hands.js",
  "ledger.js",
  "link.js",
  "module.js",
  "moment.js",
  "page.js",
  "panels.css",
  "record.js",
  "recorded.js",
  "redteam.js",
  "style.css",
  "tape.js",
  "tape.json",
  "trap.js",
  "vote.js",
  "worker.js",
  `pkg/${module}.js`,
  `pkg/${module}_bg.wasm`,
];

addEventListener("install", (event) => {
  // What the browser's own cache has may be of the build before.
  const cache = registration.active ? "no-cache" : "default";
  const files = FILES.map((name) => new Request(name, { cache }));
  event.waitUntil(caches.open(KEPT).then((kept) => kept.addAll(files)).then(() => skipWaiting()));
});

addEventListener("activate", (event) => event.waitUntil(tidy().then(() => clients.claim())));

addEventListener("fetch", (event) => {
  const { request } = event;
  const own = new URL(request.url).origin === location.origin;
  if (request.method === "GET" && own) event.respondWith(answer(request));
});

/** Lets go of earlier builds; another copy of the page on the same host keeps its own. */
async function tidy() {
  for (const name of await caches.keys()) {
    if (name.startsWith(`mcvl ${home} `) && name !== KEPT) await caches.delete(name);
  }
}

async function answer(request) {
  // A link is the same page with another query.
  const { pathname } = new URL(request.url);
  const page = [home, `${home}index.html`].includes(pathname) ? "./" : request;
  // Tapes of a run change and may be large: only the page's own are kept.
  const recording = pathname.startsWith(`${home}tapes/`);
  const kept = await caches.open(recording ? RECORDINGS : KEPT);
  try {
    const response = await fetch(request, { cache: "no-cache" });
    if (recording && response.ok) await kept.put(page, response.clone()).catch(() => {});
    return response;
  } catch (error) {
    const found = await kept.match(page);
    if (found) return found;
    throw error;
  }
}
