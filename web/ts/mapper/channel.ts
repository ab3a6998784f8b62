/** Calls the mapping engine: in a worker, or directly on this thread. */
import { DirectChannel, WorkerChannel, type Channel as AnyChannel } from "../rpc.js";
import { disposed, MapperEngine } from "./engine.js";
import type { Calls, StageEvent } from "./protocol.js";

export type Channel = AnyChannel<Calls>;

/** `onStage` hears of every step of `build` and `write`. */
export function workerChannel(url: string | URL | undefined, onStage: (event: StageEvent) => void): Channel {
  const options = { type: "module", name: "landline-mapper" } as const;
  // Bundlers look for exactly this form of words.
  const start = (): Worker => (url === undefined ? new Worker(new URL("./worker.js", import.meta.url), { type: "module", name: "landline-mapper" }) : new Worker(url, options));
  return new WorkerChannel<Calls>(start, disposed, (event) => onStage(event as StageEvent));
}

export function directChannel(onStage: (event: StageEvent) => void): Channel {
  const engine = new MapperEngine(onStage);
  return new DirectChannel<Calls>((name, request) => engine.perform(name, request), () => engine.perform("dispose", null), disposed, ["cancel"]);
}
