/**
 * What the page certainly needs is asked for at once, while most of its scripts still arrive: the engine, the weights, the
 * sample scene and the list of its pictures. Only what is not kept on this device from an earlier visit.
 */
import "./privacy.js";
import { query } from "./dom.js";
// These modules alone: the package as a whole would have to arrive first.
import { isCached } from "./vendor/landline/assets.js";
import { packagedWasmUrl } from "./vendor/landline/builds.js";

export const sampleBase = new URL("./scenes/sample/", document.baseURI);

/** Address → the answer that is on its way, and how to give it up. */
const started = new Map();

function start(url) {
  const stop = new AbortController();
  const answer = fetch(url, { signal: stop.signal });
  answer.catch(() => undefined); // whoever takes it hears of it
  started.set(url, { answer, stop });
}

async function startUnlessKept(url) {
  if (!(await isCached(url).catch(() => false))) start(url);
}

/** `fetch`, with the answer that was asked for at the page's start where there is one. */
export function firstFetch(input, init = {}) {
  const url = String(input?.url ?? input);
  const { answer, stop } = started.get(url) ?? {};
  // What asks with conditions of its own needs an answer of its own.
  if (!answer || init.cache !== undefined) return fetch(input, init);
  started.delete(url);
  const { signal } = init;
  if (signal?.aborted) stop.abort(signal.reason);
  signal?.addEventListener("abort", () => stop.abort(signal.reason), { once: true });
  return answer.catch((error) => {
    if (signal?.aborted) throw error;
    return fetch(input, init);
  });
}

try {
  start(packagedWasmUrl().href);
} catch {
  // Too old a browser: the page says so when all of it is there.
}
void startUnlessKept(new URL("./vendor/landline/xfeat.safetensors", document.baseURI).href);
if (!query.has("scene") && !query.has("place")) {
  start(new URL("sample.json", sampleBase).href);
  void startUnlessKept(new URL("sample.landline", sampleBase).href);
}
