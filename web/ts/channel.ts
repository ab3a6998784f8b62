/** Calls the engine: in a worker, or directly on this thread. */
import { disposed, perform, type Holder } from "./perform.js";
import type { Calls } from "./protocol.js";
import { DirectChannel, WorkerChannel, type Channel as AnyChannel } from "./rpc.js";

export type Channel = AnyChannel<Calls>;

export function workerChannel(url: string | URL | undefined): Channel {
  const options = { type: "module", name: "landline" } as const;
  // Bundlers look for exactly this form of words.
  const start = (): Worker => (url === undefined ? new Worker(new URL("./worker.js", import.meta.url), { type: "module", name: "landline" }) : new Worker(url, options));
  return new WorkerChannel(start, disposed);
}

export function directChannel(): Channel {
  const holder: Holder = {};
  return new DirectChannel<Calls>((name, request) => perform(holder, name, request), () => perform(holder, "dispose", null), disposed);
}
