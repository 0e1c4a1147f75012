// The worker that computes: hired when there is something to compute, so that the page is drawn first.
import * as files from "./files.js";

let worker = null;
let receive = {};
let judged = () => {};
let driven = () => {};
let calibrated = () => {};
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
  if (lack()) return "";
  worker ??= hire();
  return new Promise((resolve) => {
    judged = resolve;
    tell({ kind: "judge", configuration });
  });
}

/** Seconds that an update of such a run takes here; 0 where nothing can measure it. */
export async function calibrate(configuration) {
  if (lack()) return 0;
  worker ??= hire();
  return new Promise((resolve) => {
    calibrated = resolve;
    tell({ kind: "calibrate", configuration });
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
    if (data.kind === "judged") judged(data.complaint);
    else if (data.kind === "calibrated") calibrated(data.pace);
    else if (data.kind === "driven") driven(data);
    else if (data.ticket === ticket) receive[data.kind](data);
  };
  hired.onerror = () => {
    worker = null;
    judged("");
    calibrated(0);
    driven({ message: "Nobody answers." });
    const message = "The worker could not be loaded, so nothing can be computed here. Reload the page; recorded runs still play: open a tape.";
    receive.failed({ message });
  };
  return hired;
}
