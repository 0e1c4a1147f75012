// Opens addresses of the page in Chromium, or runs scripts in the page that is open, waits after each until
// the page is done, and prints what stands there, as a JSON array. Arguments: (ADDRESS | do:SCRIPT)...
import { spawn, spawnSync } from "node:child_process";
import { mkdtemp, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";

const SWITCHES = [
  "--headless=new",
  "--no-sandbox",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
];
/** Longest wait for a run, milliseconds. */
const PATIENCE = 120_000;

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
    ratings: [text("modified-utility"), text("unmodified-utility")],
    boards: [...document.querySelectorAll(".future .board")].map((board) => board.ariaLabel ?? ""),
    step: text("frame"),
    play: text("play"),
    stage: document.getElementById("storyboard").hidden ? "" : text("stage"),
    hidden: document.querySelectorAll("#verdicts tr[hidden]").length,
    link: location.search,
    requests: performance.getEntriesByType("resource").map((entry) => new URL(entry.name).origin),
  };`;

const profile = await mkdtemp(join(tmpdir(), "mcvl-chromium-"));
const driver = spawn("chromedriver", ["--port=0"], { stdio: ["ignore", "pipe", "inherit"] });
try {
  console.log(JSON.stringify(await visit(await port(driver), profile, process.argv.slice(2))));
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
  if (page.error || page.status.startsWith("Nothing")) return true;
  if (!page.status.startsWith("Done")) return false;
  const check = new URLSearchParams(page.link).get("check");
  return page.verdicts.length === 0 || page.moment.startsWith(check ? `Check ${check},` : "Check ");
}

async function visit(port, profile, addresses) {
  const call = async (path, method = "GET", body) => {
    const options = { method, body: body && JSON.stringify(body) };
    const response = await fetch(`http://127.0.0.1:${port}/session${path}`, options);
    const { value } = await response.json();
    if (!response.ok) throw new Error(`${method} ${path}: ${value.message}`);
    return value;
  };
  const { sessionId } = await call("", "POST", {
    capabilities: {
      alwaysMatch: {
        "goog:chromeOptions": { args: [...SWITCHES, `--user-data-dir=${profile}`] },
        "goog:loggingPrefs": { browser: "ALL" },
      },
    },
  });
  const read = () => call(`/${sessionId}/execute/sync`, "POST", { script: READ, args: [] });
  const seen = [];
  for (const what of addresses) {
    const script = what.startsWith("do:") && what.slice(3);
    if (script) await call(`/${sessionId}/execute/sync`, "POST", { script, args: [] });
    else await call(`/${sessionId}/url`, "POST", { url: what });
    const start = Date.now();
    let page;
    do {
      await new Promise((resolve) => setTimeout(resolve, 200));
      page = await read();
    } while (!settled(page) && Date.now() - start < PATIENCE);
    const log = await call(`/${sessionId}/se/log`, "POST", { type: "browser" });
    seen.push({ ...page, log: log.map((entry) => entry.message) });
  }
  return seen;
}
