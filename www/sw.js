// Keeps the page for visits without a network. With one, the network answers first, so that nobody sees an
// old page; what it answers is kept.

const KEPT = "mcvl";
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
  event.waitUntil(caches.open(KEPT).then((kept) => kept.addAll(FILES)).then(() => skipWaiting()));
});

addEventListener("activate", (event) => event.waitUntil(clients.claim()));

addEventListener("fetch", (event) => {
  const { request } = event;
  const own = new URL(request.url).origin === location.origin;
  if (request.method === "GET" && own) event.respondWith(answer(request));
});

async function answer(request) {
  const kept = await caches.open(KEPT);
  // A link is the same page with another query.
  const { pathname } = new URL(request.url);
  const home = new URL("./", location.href).pathname;
  const page = [home, `${home}index.html`].includes(pathname) ? "./" : request;
  try {
    const response = await fetch(request);
    // Tapes of a run change and may be large: only the page's own files are kept, and its recordings once they were seen.
    const recording = pathname.startsWith(`${home}tapes/`);
    if (response.ok && (recording || (await kept.match(page)))) await kept.put(page, response.clone());
    return response;
  } catch (error) {
    const found = await kept.match(page);
    if (found) return found;
    throw error;
  }
}
