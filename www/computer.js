// The worker that computes: hired when there is something to compute, so that the page is drawn first.
import * as files from "./files.js";

let worker = null;
let receive = {};
let driven = () => {};
/** What waits for an answer of the worker, by the number of the question. */
const waiting = new Map();
let asked = 0;
/** Runs asked for so far: what the worker says of an older one comes too late. */
let ticket = 0;

/** What keeps this browser from computing, as a message for people; empty where nothing does. */
export function lack() {
  if (files.lack) return files.lack;
  const missing = [
    ["WebAssembly", typeof WebAssembly],
    ["web workers", typeof Worker],
  ].find(([, type]) => type === "undefined");
  return missing ? `This browser has no ${missing[0]}, so nothing can be computed here. Recorded runs still play: open a tape.` : "";
}

/** Starts a run; `to` has a function for every kind of message. Held, it waits for `resume` before its first step. */
export function start(configuration, token, pace, held, to) {
  receive = to;
  ticket += 1;
  worker ??= hire();
  tell({ kind: "pace", pace });
  tell({ kind: "start", ticket, configuration, token, held, cores: navigator.hardwareConcurrency });
}

/** What is wrong with a configuration; empty where nothing is, or where nothing can judge it. */
export async function judge(configuration) {
  return (await answer({ kind: "judge", configuration })).complaint ?? "";
}

/**
 * The experiments there are, the settings of a run, and `pace`, the seconds that one of its updates takes here: 0 where
 * nothing can measure it. Nothing at all where nobody answers.
 */
export function describe(configuration) {
  return answer({ kind: "describe", configuration });
}

/** What the worker answers to a question; empty where it cannot. */
async function answer(question) {
  if (lack()) return {};
  worker ??= hire();
  return new Promise((resolve) => {
    waiting.set((asked += 1), resolve);
    tell({ ...question, id: asked });
  });
}

/** Ends the run; nothing more is heard of it. */
export function leave() {
  ticket += 1;
  tell({ kind: "leave", ticket });
}

/** Begins an episode, makes a step in it, or ends it, as the request says; `to` hears where it stands then. */
export function drive(request, to) {
  driven = to;
  worker ??= hire();
  tell({ kind: "drive", request });
}

/** Asks for a check with its films. */
export function ask(number) {
  tell({ kind: "moment", number });
}

/** Says something to the worker, if there is one. */
export function tell(message) {
  worker?.postMessage(message);
}

function hire() {
  const hired = files.hire("worker.js");
  hired.onmessage = ({ data }) => {
    if (data.kind === "answer") {
      waiting.get(data.id)(data);
      waiting.delete(data.id);
    } else if (data.kind === "driven") driven(data);
    else if (data.ticket === ticket) receive[data.kind](data);
  };
  hired.onerror = () => {
    worker = null;
    for (const resolve of waiting.values()) resolve({});
    waiting.clear();
    driven({ message: "Nobody answers." });
    const message = "The worker could not be loaded, so nothing can be computed here. Reload the page; recorded runs still play: open a tape.";
    // Where only a tape was opened, nothing is missed.
    receive.failed?.({ message });
  };
  return hired;
}
