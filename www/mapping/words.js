/** What the flow says. */
import { sentence } from "../panels.js";

/** What to do, while filming. */
const adviceWords = {
  "move-sideways": "Step sideways: turning alone shows no depth",
  slower: "Slower",
  "more-light": "More light, please",
  enough: "Enough seen. Stop whenever you like",
};

/** Why a picture was not kept; what says nothing new needs no words. */
const notKeptWords = {
  "too-similar": "Walk on",
  "too-dark": "Too dark to see anything",
  blurred: "Blurred: move more slowly",
  "too-few-features": "Too little to see: show shelves, pictures, edges",
  "size-changed": "The picture turned: hold the device as at the beginning",
  full: "No room for more pictures. Stop, and make the map",
};

/** What to say of one frame, and how urgent that is. Of files, which nobody can film better any more, only what became of them. */
export function adviceOf(verdict, isCamera = true) {
  const kind = verdict.advice ?? (verdict.kept || verdict.reason === "too-similar" ? "" : "warn");
  if (!isCamera) return { text: verdict.kept ? "Kept" : `Left out: ${leftOutWords(verdict.reason)}`, kind: verdict.kept || verdict.reason === "too-similar" ? "good" : "warn" };
  const text = verdict.kept ? (adviceWords[verdict.advice] ?? "Good. Keep walking") : (adviceWords[verdict.advice] ?? notKeptWords[verdict.reason] ?? "Not kept");
  return { text, kind: kind === "enough" || kind === "" ? "good" : "warn" };
}

/** Of the files of a folder: why one was left out. */
export const leftOutWords = (reason) => ({ "too-similar": "shows what another one shows", "too-dark": "too dark", blurred: "blurred", "too-few-features": "too little to see", "size-changed": "another size than the first", full: "no room for more" })[reason] ?? reason;

export const stages = [
  ["pairs", "Which pictures show the same"],
  ["matching", "What they have in common"],
  ["poses", "Where the camera stood"],
  ["refine", "Making it exact"],
  ["points", "Points in space"],
  ["lines", "Lines in space"],
  ["landmarks", "What is worth remembering"],
  ["write", "Writing the place"],
];

/** How long it takes, in words that do not promise more than is known. */
export const toGo = (seconds) => (seconds < 8 ? "A few seconds to go" : `About ${duration(seconds)} to go`);

/** Seconds in words. */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return "";
  if (seconds < 8) return "a few seconds";
  if (seconds < 90) return `${5 * Math.round(seconds / 5)} seconds`;
  return `${Math.round(seconds / 60)} minutes`;
}

export const plural = (n, one, many = `${one}s`) => `${n} ${n === 1 ? one : many}`;

const failures = {
  "not-enough-pictures": ["Too few pictures", "Film longer: walk round the place for a minute or two."],
  "no-model": ["No map came of it", "Film again, stepping sideways, slowly and with light."],
  "out-of-memory": ["This device ran out of memory", "Close other tabs and apps, then try again, or make a shorter film. Your pictures are kept."],
  "storage-full": ["No storage left", "Delete places that you no longer need, or free space on this device."],
  "engine-defect": ["The mapper stopped", "Try again: the pictures are kept."],
  "asset-fetch": ["The mapper could not be loaded", "It is loaded once, when it is used for the first time: connect to the network, then try again."],
  "bad-input": ["This cannot be used", ""],
  "camera-denied": ["The camera is not allowed", ""],
  "camera-unavailable": ["No camera", ""],
  "camera-busy": ["The camera is busy", ""],
  "camera-insecure": ["The camera needs a secure page", ""],
};

/** Title, text and hint of something that went wrong; `films` where only more pictures help. */
export function failure(error) {
  const [title, hint] = failures[error?.code] ?? ["That did not work", "Try again; the pictures so far are kept."];
  return { title, text: sentence(String(error?.message ?? error)), hint: error?.hint || hint, films: ["not-enough-pictures", "no-model"].includes(error?.code) };
}

/** `Place of 29 November, 12:40`. */
export const defaultName = (at = new Date()) => `Place of ${at.toLocaleDateString("en-GB", { day: "numeric", month: "long" })}, ${at.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" })}`;
