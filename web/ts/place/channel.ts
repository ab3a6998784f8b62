/** Calls the engine of a place: in a worker, or directly on this thread. */
import { DirectChannel, WorkerChannel, type Channel as AnyChannel } from "../rpc.js";
import { disposed, PlaceEngine } from "./engine.js";
import type { Calls } from "./protocol.js";

export type Channel = AnyChannel<Calls>;

export function workerChannel(url: string | URL | undefined): Channel {
  const options = { type: "module", name: "landline-place" } as const;
  // Bundlers look for exactly this form of words.
  const start = (): Worker => (url === undefined ? new Worker(new URL("./worker.js", import.meta.url), { type: "module", name: "landline-place" }) : new Worker(url, options));
  return new WorkerChannel<Calls>(start, disposed);
}

export function directChannel(): Channel {
  const engine = new PlaceEngine();
  return new DirectChannel<Calls>((name, request) => engine.perform(name, request), () => engine.perform("dispose", null), disposed);
}
