// Puts the panels together: what the worker or a tape says goes to them, what a person does goes into the link.
import { board, draw, legend, readTrap } from "./board.js";
import * as computer from "./computer.js";
import { curves, scoreRows, tellGate } from "./curves.js";
import { callChecked, element, LEARNERS, make, number, parted, say } from "./dom.js";
import * as files from "./files.js";
import { player, story } from "./film.js";
import { ledger } from "./ledger.js";
import * as link from "./link.js";
import { MODULE } from "./module.js";
import { momentPanel, origin } from "./moment.js";
import { summarise } from "./record.js";
import * as tapes from "./tape.js";

/** Panels that an embedded page leaves out. */
const UNEMBEDDED = ["compare", "drive", "trap", "red-team", "explain", "limits", "footer"];
/** What a recorded run has no place for. */
const LIVE = "This run is recorded: run a world live first, with the button Run.";
/** Verdicts are spoken at most this often, milliseconds. */
const SPEAK = 2000;
/** How long a verdict stands before the next check is told, milliseconds. */
const REST = 2500;
/** Frames with which the first story opens: how it goes on if nothing happens. */
const OPENING = 5;
/** What happened to the agent, in a word: the bait of the first world is large, those of others less so. */
const [HUGE, STRANGE] = ["It just got a huge reward.", "A reward it did not expect."];
/** What deriving a recorded run again is called; its price follows. */
const AGAIN = "Derive it again here";

/** What the first frame does without. */
const controls = () => import("./controls.js");
const recordings = () => import("./recorded.js");
import("./explain.js").then(({ lightUp }) => lightUp());
import("./hands.js").then(({ listen }) => listen({ open: openFile, play }));

const motion = matchMedia("(prefers-reduced-motion: reduce)");
/** What the link asks for. */
let view = {};
/** The run on show: `shown` is its check in the panel, `asked` the number of the one that is to come. */
let run = {};
/** Whether a person asked for a run: with reduced motion nothing starts by itself. */
let begun = false;
/** Whether the next check is told after every verdict. */
let watching = false;
/** Where the visitor votes before the verdict, else null. */
let ballot = null;
/** The episode that the visitor drives, once there was one. */
let wheel = null;
/** The desk of those who try to fool it, once there was one. */
let team = null;
/** What the run before got, where this one differs in the check alone. */
let switched = "";
let rest = 0;

const moment = momentPanel((stage) => {
  stopStory();
  put({ stage: stage === moment.last ? null : stage });
  announce(`Stage ${stage} of ${moment.last}: ${moment.name(stage)}.`);
});
const film = player(stopStory, (frame) => put({ frame }));
const table = ledger(choose);
const chart = curves(choose);
const tale = story(moment, film, told);
/** The training, seen large until there is a check. */
const meanwhile = board();

/** Changes the view and the link. */
function put(changes) {
  for (const [key, value] of Object.entries(changes)) view[key] = value === null ? null : String(value);
  const standing = (changes.frame ?? changes.stage ?? null) !== null;
  if (standing && view.check === null && run.shown) view.check = String(run.shown.number);
  link.write({ ...changes, check: view.check });
  share();
}

/** Begins what the link asks for, or the default page where the link is malformed. */
async function begin(complaint = "", first = false) {
  const found = link.read();
  const text = complaint || found.complaint;
  const stop = /[.?]$/.test(text) ? "" : ".";
  say("error", text && `${text}${stop} This is the default page instead; correct the link and reload, or go on here.`);
  view = found.view;
  element("seed").value = found.seed;
  for (const key of ["speed", "filter", "film", "pace", "depth"]) {
    document.querySelector(`input[name=${key}][value="${view[key]}"]`).checked = true;
  }
  element("picture").checked = view.picture === "true";
  film.speed = Number(view.speed);
  film.picture = view.picture;
  table.filter = view.filter;
  const hidden = [...(view.hide ?? "").split(","), ...(view.embed === "1" ? UNEMBEDDED : [])];
  for (const panel of link.PANELS) element(panel).hidden = hidden.includes(panel);
  // The heading is there for those who do not see the page around it.
  element("header").classList.toggle("unseen", view.embed === "1");
  clear();
  const mine = run;
  if (first) files.keepOffline(MODULE);
  const recording = first && !text ? (link.RECORDED.get(found.plain) ?? null) : null;
  if (recording === link.OPENING) await introduce();
  else if (recording) put({ tape: recording });
  // Something else may have been opened meanwhile.
  if (run !== mine) return;
  if (view.tape) return fetchTape(view.tape);
  compute(found.configuration, view.token);
}

/** Forgets the last run; what it still says comes too late. */
function clear() {
  computer.leave();
  stopStory();
  // A verdict of the old run that waits to be spoken is of no interest in the new one.
  clearTimeout(run.speaking);
  wheel?.leaveWheel();
  team?.leave();
  switched = "";
  callChecked(true);
  for (const id of ["gate-status", "sample"]) say(id, "");
  for (const id of ["drive-start", "trap-start", "trap-end", "trap-cells", "red-team-start"]) element(id).hidden = true;
  for (const id of ["drive-status", "trap-status", "driven"]) element(id).replaceChildren();
  if (!team?.isOpen()) element("red-team-status").replaceChildren();
  meanwhile.remove();
  run = { world: null, legs: new Map(), scores: new Map(), tempted: new Map(), rows: new Map(), spoken: -SPEAK };
  for (const id of ["legs", "legend", "scores"]) element(id).replaceChildren();
  for (const id of ["pictures", "again"]) element(id).hidden = true;
  table.clear();
  chart.clear();
  film.halt();
  waiting("");
}

/** Says what will stand in the panel; the price is that of the world. */
function waiting(cost) {
  const what = view.check === null ? "The first refusal" : `Check ${view.check}`;
  const price = cost ? ` A whole run of this world takes ${cost} natively, and longer here.` : "";
  moment.wait(`${what} appears here. The agent trains in the safe world first.${price}`);
}

function compute(configuration, token = null) {
  run.token = token;
  element("run-title").textContent = "The run, live";
  const lack = computer.lack();
  if (lack) return receive.failed({ message: lack });
  run.held = motion.matches && !begun;
  element("start").hidden = !run.held;
  if (run.held) ended("Nothing starts by itself: press Run.");
  else going();
  computer.start(configuration, token, view.pace, run.held, receive);
}

/** The run is computed. */
function going() {
  begun = true;
  run.held = false;
  run.paused = false;
  element("start").hidden = true;
  element("status").textContent = "Computing.";
  element("stop").disabled = false;
  element("stop").textContent = "Pause run";
}

/** Lets a run that was held go. */
function release() {
  // What was recorded makes room for what comes.
  for (const past of [run.rows, run.scores]) past.clear();
  table.clear();
  chart.clear();
  chart.choose(run.shown?.number ?? null);
  going();
  computer.tell({ kind: "resume" });
}

function ended(text) {
  element("status").textContent = text;
  element("stop").disabled = true;
}

/** The first seconds: a recorded refusal is told before anything is computed. */
async function introduce() {
  const mine = run;
  try {
    const opening = await files.get(link.OPENING);
    run.intro = tapes.read(await opening.text(), link.OPENING);
  } catch {
    return;
  }
  if (run !== mine) return;
  const [check] = run.intro.checks;
  enter(run.intro.world);
  run.configuration = run.intro.configuration;
  readTrap(run.configuration);
  run.asked = check.number;
  show(check);
  if (motion.matches) playTape(run.intro);
  else tell(check);
  await painted();
  performance.mark("first-frame");
}

/** Tells a check from before it came to it, once somebody looks. */
function tell(check) {
  if (!document.hidden) return tale.play(check.unmodified.films[0].frames.slice(0, OPENING));
  const still = () => run.shown === check && tell(check);
  document.addEventListener("visibilitychange", still, { once: true });
}

/** Resolves when what was drawn is on the screen. */
function painted() {
  return new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve)));
}

/** Gives the curves and decisions of a tape to their panels. */
function playTape({ legs, evaluations, checks }) {
  receive.report({ legs, evaluations, checks: checks.map(summarise) });
}

/** Ends the story on show, because a person does something else. */
function stopStory() {
  clearTimeout(rest);
  rest = 0;
  watching = false;
  element("follow").textContent = "Keep watching";
  const going = tale.stop();
  if (going || ballot) moment.turn(moment.last);
  ballot?.close();
  ballot = null;
}

/** Starts or halts the films of the check on show; false where there is none. */
function play() {
  if (!run.shown) return false;
  stopStory();
  film.toggle();
  return true;
}

/** A story came to its verdict. */
function told() {
  performance.mark("verdict");
  if (ballot) return ballot.reveal();
  speak(summarise(run.shown));
  if (!watching) return;
  rest = setTimeout(() => {
    rest = 0;
    goOn();
  }, REST);
}

/** Tells the check after this one; where there is none yet, the run's next report calls again. */
function goOn() {
  const next = table.beside(run.shown.number, 1);
  if (next === null) {
    if (run.over) stopStory();
    return;
  }
  put({ check: next, frame: null, stage: null });
  ask(next);
}

/** The visitor votes on checks, the next one first. */
function decide({ ballot: make }) {
  stopStory();
  // A filter would tell.
  document.querySelector("input[name=filter][value=all]").click();
  ballot = make({ cast, next: voteOn, leave: stopStory });
  if (run.held) release();
  voteOn();
}

/** Opens the check to vote on, from the first one again after the last; a report with a new one calls again. */
function voteOn() {
  const shown = run.shown?.number ?? null;
  const next = table.beside(shown, 1) ?? (run.over ? table.beside(null, 1) : null);
  if (next === null || next === shown) {
    return ballot.wait(run.over ? "There is no other check to vote on." : "The next check is not there yet.");
  }
  put({ check: next, frame: null, stage: null });
  ask(next);
}

/** The vote is cast: the futures play. */
function cast() {
  if (!motion.matches) return tale.play(null, 2);
  moment.turn(moment.last);
  told();
}

/** Opens a moment because a person chose it. */
function choose(number) {
  if (number === null) return;
  stopStory();
  put({ check: number, frame: null, stage: null });
  run.spoken = -SPEAK;
  ask(number);
}

function ask(number) {
  run.asked = number;
  if (run.recorded) open(run.recorded.checks.get(number));
  else computer.ask(number);
}

/** Fills the panel with a check, told up to a stage where one is given. */
function show(check, until) {
  const another = run.shown?.number !== check.number;
  run.shown = check;
  const stage = until ?? (view.stage ? Number(view.stage) : !another ? moment.stage : motion.matches ? 1 : moment.last);
  moment.open(check, run.world, view.picture, stage);
  if (check.before.truth || check.after.truth) element("pictures").hidden = false;
  // Of an update there is no truth to vote on.
  element("decide").hidden = check.subject === "update";
  element("starts").hidden = (check.modified?.films?.length ?? 0) < 2;
  film.open(check, view.film, Number(view.frame ?? 0), run.world);
  if (Number(view.frame ?? 0) > film.last) {
    say("error", `frame: these films have ${film.last} steps; the last one is shown instead of ${view.frame}.`);
    put({ frame: film.last });
  }
  table.choose(check.number);
  chart.choose(check.number);
  element("origin").textContent = origin(check, run);
  share();
}

/** Opens the moment that has come; with `frame` in the link it stands there, else it plays. */
function open(check) {
  if (ballot) {
    show(check, 1);
    return ballot.ask(check);
  }
  show(check);
  if (watching) return tale.play();
  speak(summarise(check));
  if (view.frame === null && !motion.matches) film.play();
}

/** The link and the token of the moment on show. */
function share() {
  const address = link.address();
  if (run.shown) address.searchParams.set("check", run.shown.number);
  // A ledger does not name its run, so no link leads back to it.
  element("links").hidden = Boolean(run.recorded) && !run.configuration;
  element("share-link").value = address.href;
  const token = run.rows.get(run.shown?.number)?.token;
  element("tokens").hidden = !token;
  element("share-token").value = token ?? "";
  element("copied").textContent = "";
}

/** The drawing of a leg, made when it is first heard of. */
function leg(arm) {
  if (!run.legs.has(arm)) {
    const figure = make("figure", "", "leg");
    const drawing = board();
    const figures = make("p");
    if (arm === "safe") drawing.dataset.safe = "";
    figure.append(make("figcaption", LEARNERS[arm]), drawing, figures);
    element("legs").append(figure);
    run.legs.set(arm, { drawing, figures });
  }
  return run.legs.get(arm);
}

function showScores(points) {
  for (const point of points) {
    run.scores.set(point.arm, point);
    if (parted(point)) run.tempted.set(point.arm, point.step);
  }
  element("scores").replaceChildren(...scoreRows(run.scores, run.recorded?.tolerance, run.over));
}

/** The page is about this world. */
function enter(world) {
  run.world = world;
  element("question").textContent = `${world.name === "box-moving" ? HUGE : STRANGE} Should it learn from that?`;
  element("legend").replaceChildren(...legend(world.legend));
  // Until the form is this world's, the words that stand there are another's.
  element("about").classList.toggle("later", world.name !== element("env").value);
}

/** Says the newest verdict, not every one. */
function speak(check) {
  clearTimeout(run.speaking);
  const wait = run.spoken + SPEAK - performance.now();
  if (wait > 0) {
    run.speaking = setTimeout(speak, wait, check);
    return;
  }
  run.spoken = performance.now();
  const got = `expected ${number(check.predicted / run.world.reward_scale, 1)}, got ${number(check.reward_raw, 1)}`;
  announce(`Step ${check.step}: ${got}: ${check.refused ? "refused" : "accepted"}.`);
}

/** Says something to those who do not see it. */
function announce(text) {
  element("latest").textContent = text;
}

/** Asks for the moment that the link names, else for the first refusal. */
function find(checks) {
  if (run.asked) return;
  const wanted = checks.find((check) => (view.check === null ? check.refused : check.number === Number(view.check)));
  if (wanted) ask(wanted.number);
}

/** Nothing more will come: shows something where what the link asks for is not there. */
function settle() {
  if (run.asked) return;
  const checks = [...run.rows.values()];
  if (checks.length === 0) {
    if (run.settings?.get("scheme") === "none") return moment.wait("The check is off: it learns from everything, and nobody asks what will become of it.");
    const judged = !run.recorded || run.recorded.legs.some(({ arm }) => arm === "mc");
    const why = judged ? "No reward surprised this run" : "This run has no modification-considering learner";
    return moment.wait(`${why}, so there was nothing to decide.`);
  }
  if (view.check !== null) {
    say("error", `check: ${view.check} is not here, the last is ${checks.at(-1).number}. Another one is shown.`);
    put({ check: null, frame: null });
    find(checks);
  }
  if (!run.asked) ask(checks.at(-1).number);
}

/** Where the trap is, and what came of it so far; without a phase, in the end. */
async function tellTrap(phase) {
  const mine = run;
  const { account } = await import("./trap.js");
  if (run === mine) element("trap-status").textContent = account(run, run.shown?.before ?? frameNow(), phase);
}

/** The same seed with the check switched on or off; switched on again, it is the check that it was. */
async function switchGate(on) {
  const before = run.over && run.scores.has("mc") && run.settings ? tellGate(run.scores, run.settings) : "The dotted line is the run before.";
  const { check = { scheme: null } } = run;
  const was = on ? check : { scheme: link.given("scheme"), punishment: link.given("punishment") };
  if (!(await change(on ? check : { scheme: "none", punishment: null }, chart.keep))) return showGate();
  // The run that begins forgets the one before.
  switched = before;
  run.check = was;
}

function showGate() {
  const state = run.settings?.get("scheme") === "none" ? "off" : "on";
  document.querySelector(`input[name=gate][value=${state}]`).checked = true;
}

/** Says how many recorded decisions came out again. */
async function compareAgain() {
  const { rows, intro } = run;
  const { rederived } = await recordings();
  if (run.intro === intro) element("status").append(rederived(rows, intro.checks));
}

/** Ten recorded seeds behind the curves, where somebody looks at them. */
async function besides() {
  if (!element("sets").open) return chart.behind(null);
  const { compare } = await import("./compare.js");
  if (run.world) compare(run.world.name, (entry) => chart.behind(entry));
}

/** A situation of the new world, or of the safe one before it. */
function frameNow() {
  return run.legs.get("mc")?.frame ?? run.shown?.before ?? run.legs.get("safe")?.frame;
}

/** A module that shows the world to set a trap in, and the cells where one can be. */
async function withPlaces(loading) {
  const module = await loading;
  return [module, await module.places(frameNow())];
}

/** What the worker says; a tape says the same. */
const receive = {
  ready({ experiments, world, cost, configuration, settings, wanted, driven }) {
    enter(world);
    run.configuration = configuration;
    if (run.token) {
      run.promised = wanted;
      link.turnTo(configuration, { check: wanted, frame: view.frame, stage: view.stage });
      view.check = String(wanted);
      element("seed").value = settings.find(({ name }) => name === "seed").value;
    }
    if (!run.shown) waiting(cost);
    controls().then(({ fill }) => fill(experiments, settings, configuration));
    element("drive-start").hidden = false;
    run.trap = readTrap(configuration);
    // Traps are set on boards.
    element("trap-start").hidden = Boolean(driven);
    element("red-team-start").hidden = Boolean(driven) || Boolean(team?.isOpen());
    run.settings = new Map(settings.map(({ name, value }) => [name, value]));
    callChecked(run.settings.get("scheme") !== "none");
    element("gate").hidden = Boolean(driven);
    showGate();
    if (switched) say("gate-status", switched);
    besides();
    element("trap-end").hidden = !run.trap;
    element("module").textContent = MODULE === "simd" ? "module with SIMD" : "module without SIMD";
    element("command").textContent = link.command(configuration);
    if (!driven) return;
    run.over = true;
    run.held = false;
    element("start").hidden = true;
    ended("Nothing is trained here.");
    moment.wait(driven);
    say("driven", driven);
  },

  report(report) {
    for (const { arm, frame, step, steps, checks, refusals } of report.legs) {
      // A tape has no live worlds.
      if (!frame) continue;
      const { drawing, figures } = leg(arm);
      run.legs.get(arm).frame = frame;
      if (frame.truth) element("pictures").hidden = false;
      // Moving pictures only for those who want them: the last one always stays.
      if (!motion.matches || step === steps || drawing.childElementCount === 0) draw(drawing, frame, view.picture);
      if (!run.shown && !motion.matches) {
        if (arm === "safe") meanwhile.dataset.safe = "";
        else delete meanwhile.dataset.safe;
        draw(meanwhile, frame, view.picture);
        element("meanwhile").append(meanwhile);
      }
      figures.textContent = `step ${step} of ${steps}${arm === "mc" ? `, ${checks} ${checks === 1 ? "check" : "checks"}, ${refusals} refused` : ""}`;
    }
    showScores(report.evaluations);
    chart.add(report);
    const phase = run.legs.has("mc") ? "Now both learners meet it." : "Safe training first, without it.";
    if (run.trap && !run.over && phase !== run.phase) tellTrap((run.phase = phase));
    if (report.checks.length === 0) return;
    for (const row of report.checks) run.rows.set(row.number, row);
    if (report.checks.some(({ number }) => number === run.intro?.checks.at(-1)?.number)) compareAgain();
    team?.judge(report.checks);
    table.add(report.checks, run.world.reward_scale);
    if (run.shown) {
      table.choose(run.shown.number);
      element("origin").textContent = origin(run.shown, run);
      share();
    }
    // A story says its own verdict.
    if (!tale.going && !ballot) speak(report.checks.at(-1));
    if (ballot?.waits) return voteOn();
    find(report.checks);
    const shows = run.asked === run.shown?.number;
    if (watching && shows && !tale.going && !rest) goOn();
  },

  moment({ check }) {
    if (check.number === run.asked) open(check);
  },

  done({ seconds }) {
    run.over = true;
    showScores([]);
    ended(`Done in ${number(seconds, 1)} seconds.`);
    if (run.intro) compareAgain();
    if (ballot?.waits) voteOn();
    if (run.trap) tellTrap();
    if (switched) say("gate-status", `${switched} ${tellGate(run.scores, run.settings)}`);
    team?.done(run.scores);
    settle();
  },

  malformed({ message }) {
    link.forget();
    begin(message);
  },

  failed({ message }) {
    say("error", message);
    ended("Nothing is running.");
    if (run.intro?.legs && run.rows.size === 0) playTape(run.intro);
  },
};

/** Shows what a file has instead of a live run; false, with a message, where it is nothing to show. */
function openTape(text, name) {
  let tape;
  try {
    tape = tapes.read(text, name);
  } catch (error) {
    say("error", error.message);
    return false;
  }
  say("error", "");
  clear();
  run.over = true;
  element("start").hidden = true;
  enter(tape.world);
  run.configuration = tape.configuration ?? "";
  readTrap(run.configuration);
  run.recorded = { ...tape, checks: new Map(tape.checks.map((check) => [check.number, check])) };
  element("run-title").textContent = "A recorded run";
  element("gate").hidden = true;
  if (run.configuration) element("seed").value = run.configuration.match(/ seed=(\d+)/)?.[1] ?? "0";
  for (const id of ["trap-status", "red-team-status"]) say(id, LIVE);
  const refused = tape.checks.filter((check) => check.verdict === "refuse").length;
  ended(`${name}: ${tape.checks.length} checks are kept here, ${refused} refused. ${tape.configuration ?? "A ledger does not name its run."}`);
  element("again").hidden = tape.configuration === null || !tape.world.actions.discrete || computer.lack();
  if (tape.configuration && !tape.world.actions.discrete) say("driven", `Recorded natively: an arm is not trained here. \`${link.command(tape.configuration)}\` trains the run again, \`mcvl verify RUN\` derives its decisions.`);
  if (tape.configuration) element("command").textContent = link.command(tape.configuration);
  element("drive-start").hidden = tape.configuration === null || computer.lack();
  if (tape.configuration === null) say("drive-status", "A ledger does not name its run, so there is no world to drive.");
  playTape(tape);
  settle();
  besides();
  const story = [view.check, view.frame, view.stage].every((key) => key === null);
  if (story && run.shown?.modified?.films && !motion.matches) tell(run.shown);
  if (tape.configuration) run.filled = describe(tape.updates);
  else element("about").replaceChildren();
  return true;
}

/** Says which run the recorded one on show is, fills the form for it, and says what so many updates of it take here. */
async function describe(updates) {
  const [mine, { configuration }] = [run, run];
  element("again").textContent = AGAIN;
  const telling = import("./compare.js").then(({ sample }) => sample(configuration));
  telling.then((text) => run === mine && say("sample", text));
  const [found, { fill }, { price }] = await Promise.all([computer.describe(configuration), controls(), recordings()]);
  if (run !== mine || !found.experiments) return;
  fill(found.experiments, found.settings, configuration);
  element("again").textContent = AGAIN + price(updates, found.pace);
}

async function fetchTape(address) {
  const mine = run;
  element("status").textContent = "Loading the tape.";
  const got = await files.get(address)
    .then(async (response) => (response.ok ? { text: await response.text() } : { why: `this site answers ${response.status}` }))
    .catch((error) => ({ why: error.message }));
  // Something else may have been opened meanwhile.
  if (run !== mine) return;
  if (got.text !== undefined && openTape(got.text, address)) {
    await painted();
    return performance.mark("first-frame");
  }
  link.forget();
  begin(got.why ? `tape: ${address} cannot be loaded, ${got.why}.` : element("error").textContent);
}

/** Shows a file that a person chose or dropped; the link then leads to its run, if the file names it. */
async function openFile(file) {
  if (!file) return;
  const text = await file.text().catch((error) => say("error", `${file.name}: it cannot be read: ${error.message}`));
  if (text === undefined) return;
  const before = { ...view };
  Object.assign(view, { check: null, frame: null, stage: null, tape: null, token: null });
  if (!openTape(text, file.name)) return void (view = before);
  begun = true;
  if (run.configuration) link.turnTo(run.configuration);
  else link.write({ check: null, frame: null, stage: null, tape: null, token: null });
  share();
}

/** Begins the run that the form describes; where it describes none, that is said and everything stays. */
async function submit() {
  if (run.held && !run.edited) return release();
  return change((await controls()).wanted(run.world?.name));
}

/** Begins the run with these settings changed, after `before`; where there is no such run, that is said, everything stays,
 * and it is false. */
async function change(settings, before = () => {}) {
  const mine = run;
  const changes = { check: null, frame: null, stage: null, tape: null, token: null, ...settings };
  const complaint = computer.lack() || (await computer.judge(link.preview(changes)));
  if (run !== mine) return false;
  if (complaint) {
    say("error", `${complaint}${/[.?]$/.test(complaint) ? "" : "."} Nothing was changed.`);
    return false;
  }
  before();
  link.write(changes);
  begun = true;
  begin();
  // A check that is switched off outlasts other changes in its world.
  if ((settings.env ?? mine.world?.name) === mine.world?.name) run.check = mine.check;
  return true;
}

/** Does `then` with what a click takes to load, unless something else was opened meanwhile. */
function onClick(id, load, then) {
  element(id).addEventListener("click", async () => {
    const mine = run;
    const loaded = await load();
    if (run === mine) then(loaded);
  });
}

element("controls").addEventListener("submit", (event) => {
  event.preventDefault();
  Promise.resolve(run.filled).then(submit);
});
element("controls").addEventListener("input", () => (run.edited = true));
element("start").addEventListener("click", release);
// The button is gone, and the focus with it.
element("start").addEventListener("click", () => element("stop").focus());
element("stop").addEventListener("click", () => {
  run.paused = !run.paused;
  computer.tell({ kind: run.paused ? "pause" : "resume" });
  element("stop").textContent = run.paused ? "Resume run" : "Pause run";
  element("status").textContent = run.paused ? "Paused." : "Computing.";
});

element("again").addEventListener("click", () => {
  const { checks } = run.recorded;
  link.turnTo(run.configuration, { check: run.shown?.number ?? null });
  begun = true;
  begin();
  // To be compared with.
  run.intro = { checks: [...checks.values()] };
});

element("another").addEventListener("click", async () => {
  await run.filled;
  if (!element("seed").reportValidity()) return;
  run.edited = true;
  element("seed").value = String(BigInt.asUintN(64, BigInt(element("seed").value || "0") + 1n));
  if (await submit()) element("moment-title").focus();
});

element("slow").addEventListener("click", () => {
  stopStory();
  put({ stage: null });
  if (run.shown) tale.play();
});

element("follow").addEventListener("click", () => {
  if (watching) return stopStory();
  stopStory();
  if (run.held) release();
  watching = true;
  element("follow").textContent = "Stop watching";
  goOn();
});

onClick("decide", () => import("./vote.js"), decide);

onClick("drive-start", () => import("./drive.js"), (drive) => {
  wheel = drive;
  element("drive-start").hidden = true;
  wheel.takeWheel(run.configuration, run.scores);
});

onClick("trap-start", () => withPlaces(import("./trap.js")), ([{ offer }, choice]) => {
  const frame = frameNow();
  if (!frame) return say("trap-status", "The world is not there yet: let the run begin.");
  offer(frame, run.world.legend, choice, async (cell, reward) => {
    await change({ trap: `${cell}:${reward}` });
    // The cells are gone with the run before.
    if (element("trap-cells").hidden) element("trap-title").focus();
  });
});

onClick("red-team-start", () => withPlaces(import("./redteam.js")), ([desk, choice]) => {
  team = desk;
  const frame = frameNow();
  if (!frame) return say("red-team-status", "The world is not there yet: let the run begin.");
  element("red-team-start").hidden = true;
  team.open(frame, run.world.legend, choice, run.settings, async (settings) => ((await change(settings)) ? link.address().search : ""));
});
element("sets").addEventListener("toggle", besides);
element("trap-end").addEventListener("click", () => change({ trap: null }));

element("previous").addEventListener("click", () => choose(table.beside(run.asked ?? null, -1)));
element("next").addEventListener("click", () => choose(table.beside(run.asked ?? null, 1)));
element("oldest").addEventListener("click", () => choose([...run.rows.values()].find((check) => check.refused)?.number ?? null));
element("newest").addEventListener("click", () => choose(table.newest()));

// Links to other runs are followed in place, and back again.
document.addEventListener("click", (event) => {
  const way = event.target.closest?.("a[href^='?']");
  if (!way || event.ctrlKey || event.metaKey || event.shiftKey || event.altKey) return;
  event.preventDefault();
  link.follow(way.getAttribute("href"));
  begin("", true);
  element("moment-title").focus();
});
// A way to another part of the page is none to another run.
addEventListener("popstate", () => link.follow() && begin("", true));

document.addEventListener("change", ({ target }) => {
  const { name, value } = target;
  if (["speed", "pace", "depth", "filter"].includes(name)) put({ [name]: value });
  if (name === "speed") film.speed = Number(value);
  if (name === "pace") computer.tell({ kind: "pace", pace: value });
  if (name === "filter") table.filter = value;
  if (name === "gate") switchGate(value === "on");
  if (name === "film") {
    stopStory();
    put({ film: value, frame: null });
    if (run.shown) open(run.shown);
  }
  if (target.id === "picture") {
    put({ picture: target.checked ? "true" : "seen" });
    film.picture = view.picture;
    for (const { drawing, frame } of run.legs.values()) draw(drawing, frame, view.picture);
    moment.picture = view.picture;
  }
});

begin("", true);
