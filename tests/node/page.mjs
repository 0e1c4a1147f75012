// Drives Chromium through the page. Reads commands, a JSON array of texts, and prints, as another, what came of each:
//
//   ADDRESS or go:ADDRESS   visits it and waits until the page is done; `go:` does not wait
//   do:SCRIPT               runs it in the page and waits until the page is done
//   eval:SCRIPT             runs it, waits for a promise, and gives its value
//   until:SCRIPT            runs it until its value is true, and gives the milliseconds since the last visit
//   keys:NAME,NAME,...      types keys: Tab, Enter, Space, Comma and the others in KEYS, or a character
//   cdp:COMMAND JSON        a command of the DevTools protocol
//   shot:FILE               writes what is visible, as its ending says (png, webp); full:FILE the whole page
//   frame:SELECTOR          goes on in this frame of the page; without one, in the page again
//   axe:                    runs axe on the page standing still and gives its violations
//   kill:PID                ends a process
//   write:FILE TEXT         writes a text file
//   patience:MILLISECONDS   waits so long for things from now on
//   hurry:TIMES             timers of pages visited from now on run so many times as fast: stories, not trainings
//
// After a visit or a `do:` the result is what stands on the page; the browser's log comes last.
import { spawn, spawnSync } from "node:child_process";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { extname, join } from "node:path";
import { text } from "node:stream/consumers";

const SWITCHES = [
  "--headless=new",
  "--no-sandbox",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
  "--hide-scrollbars",
  "--window-size=1440,900",
];
/** Longest wait for a run, milliseconds, unless told otherwise. */
const PATIENCE = 120_000;
/** How often the page is looked at, milliseconds. */
const LOOK = 50;
/** What keys send. */
const KEYS = {
  Backspace: "\ue003", Tab: "\ue004", Enter: "\ue007", Space: " ", Comma: ",", Period: ".",
  ArrowLeft: "\ue012", ArrowUp: "\ue013", ArrowRight: "\ue014", ArrowDown: "\ue015",
};

/** What is read from the page, in the page. */
const READ = `
  const text = (id) => document.getElementById(id).textContent;
  return {
    status: text("status"),
    error: text("error"),
    tally: text("tally"),
    module: text("module"),
    verdicts: [...document.querySelectorAll("#verdicts tr")].map((row) => row.innerText.split("\\t")),
    scores: [...document.querySelectorAll("#scores tr")].map((row) => row.innerText.split("\\t")),
    moment: document.getElementById("moment").hidden ? "" : text("moment-name"),
    stamp: text("stamp"),
    origin: text("origin"),
    token: document.getElementById("share-token").value,
    share: document.getElementById("share-link").value,
    ratings: [text("modified-utility"), text("unmodified-utility")],
    boards: [...document.querySelectorAll(".future .board")].map((board) => board.ariaLabel ?? ""),
    step: text("frame"),
    play: text("play"),
    stage: text("stage"),
    hidden: document.querySelectorAll("#verdicts tr[hidden]").length,
    link: location.search,
    requests: performance.getEntriesByType("resource").map((entry) => new URL(entry.name).origin),
  };`;

const profile = await mkdtemp(join(tmpdir(), "mcvl-chromium-"));
const driver = spawn("chromedriver", ["--port=0"], { stdio: ["ignore", "pipe", "inherit"] });
try {
  console.log(JSON.stringify(await drive(await port(driver), JSON.parse(await text(process.stdin)))));
} finally {
  driver.kill("SIGKILL");
  spawnSync("pkill", ["-KILL", "-f", profile]);
  await rm(profile, { recursive: true, force: true, maxRetries: 5 });
}

/** The port on which the driver listens, once it does. Its output is read on: a closed pipe could stop it. */
function port(driver) {
  return new Promise((resolve, reject) => {
    let said = "";
    driver.stdout.on("data", (chunk) => {
      said += chunk;
      const found = said.match(/started successfully on port (\d+)/);
      if (found) resolve(found[1]);
    });
    driver.on("exit", () => reject(new Error(`chromedriver did not start: ${said}`)));
  });
}

/** Whether the run is over and the check of the link, or else some check, is on show. */
function settled(page) {
  if (page.status.startsWith("Nothing")) return true;
  if (!page.status.startsWith("Done") && !page.status.includes(" are kept here,")) return false;
  // What a malformed link asks for is not what comes.
  const check = page.error ? null : new URLSearchParams(page.link).get("check");
  return page.verdicts.length === 0 || page.moment.startsWith(check ? `Check ${check},` : "Check ");
}

async function drive(port, commands) {
  const call = async (path, body) => {
    const options = body && { method: "POST", body: JSON.stringify(body) };
    const response = await fetch(`http://127.0.0.1:${port}/session${path}`, options);
    const { value } = await response.json();
    if (!response.ok) throw new Error(`${path}: ${value.message}`);
    return value;
  };
  const { sessionId } = await call("", {
    capabilities: {
      alwaysMatch: {
        "goog:chromeOptions": { args: [...SWITCHES, `--user-data-dir=${profile}`] },
        "goog:loggingPrefs": { browser: "ALL" },
      },
    },
  });
  const session = (path, body) => call(`/${sessionId}/${path}`, body);
  const run = (script) => session("execute/sync", { script: `return (async () => { ${script} })()`, args: [] });
  const cdp = (cmd, params = {}) => session("goog/cdp/execute", { cmd, params });
  let visited = Date.now();
  let patience = PATIENCE;

  /** Looks until `good` is true of what `look` gives. */
  const wait = async (look, good, what) => {
    for (const start = Date.now(); ; ) {
      const seen = await look();
      if (good(seen)) return seen;
      if (Date.now() - start > patience) throw new Error(`not in ${patience} ms: ${what}; the page: ${JSON.stringify(await run(READ))}`);
      await new Promise((resolve) => setTimeout(resolve, LOOK));
    }
  };
  const read = () => wait(() => run(READ), settled, "the page is done");
  const visit = async (url) => {
    visited = Date.now();
    await session("url", { url });
  };
  const shoot = async (file, whole) => {
    const format = extname(file).slice(1);
    const { data } = await cdp("Page.captureScreenshot", { format, captureBeyondViewport: whole });
    await writeFile(file, Buffer.from(data, "base64"));
  };
  const verbs = {
    go: visit,
    do: async (script) => (await run(script), read()),
    eval: run,
    until: async (script) => {
      await wait(() => run(script), Boolean, script);
      return Date.now() - visited;
    },
    keys: async (names) => {
      const actions = names.split(",").flatMap((name) => {
        const value = KEYS[name] ?? name;
        return [{ type: "keyDown", value }, { type: "keyUp", value }];
      });
      await session("actions", { actions: [{ type: "key", id: "keys", actions }] });
    },
    cdp: async (text) => {
      const [, command, parameters] = text.match(/^(\S+)\s*(.*)$/s);
      return cdp(command, parameters ? JSON.parse(parameters) : {});
    },
    shot: (file) => shoot(file, false),
    full: (file) => shoot(file, true),
    frame: async (selector) => {
      const found = selector && (await session("element", { using: "css selector", value: selector }));
      await session("frame", { id: found || null });
    },
    axe: async () => {
      const axe = await readFile(new URL("node_modules/axe-core/axe.min.js", import.meta.url), "utf8");
      await session("execute/sync", { script: axe, args: [] });
      // What fades in has not its own colours yet: nothing moves while axe looks.
      return run(`
        const still = new CSSStyleSheet();
        still.replaceSync("* { transition: none !important }");
        document.adoptedStyleSheets.push(still);
        for (const animation of document.getAnimations()) animation.finish();
        const { violations } = await axe.run();
        document.adoptedStyleSheets.pop();
        return violations.map(({ id, help, nodes }) => ({ id, help, where: nodes.map((node) => node.html) }));`);
    },
    hurry: async (times) => {
      const source = `{ const real = setTimeout; window.setTimeout = (then, wait, ...rest) => real(then, wait / ${times}, ...rest); }`;
      await cdp("Page.addScriptToEvaluateOnNewDocument", { source });
    },
    patience: (milliseconds) => void (patience = Number(milliseconds)),
    kill: (pid) => void process.kill(Number(pid), "SIGKILL"),
    write: (what) => {
      const [, file, content] = what.match(/^(\S+) (.*)$/s);
      return writeFile(file, content);
    },
    http: async (rest) => (await visit(`http:${rest}`), read()),
  };

  const seen = [];
  for (const command of commands) {
    const [, verb, rest] = command.match(/^(\w+):(.*)$/s);
    seen.push((await verbs[verb](rest)) ?? null);
  }
  const log = await session("se/log", { type: "browser" });
  return [...seen, log.map((entry) => entry.message)];
}
