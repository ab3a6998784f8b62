/** The calls of `protocol.ts`, answered by an engine: the same in a worker and on the caller's thread. */
import { Engine } from "./engine.js";
import { LandlineError } from "./errors.js";
import type { CallName, Calls, LocateRequest } from "./protocol.js";

/** Where the engine of one relocalizer is kept; empty before `create` and after `dispose`. */
export interface Holder {
  engine?: Engine | undefined;
}

/** The frame that waits behind the present one, if there is one. */
export type NextFrame = () => LocateRequest | undefined;

type Handler<N extends CallName> = (holder: Holder, request: Calls[N]["request"], next: NextFrame) => Calls[N]["reply"] | Promise<Calls[N]["reply"]>;

export const disposed = (): LandlineError => new LandlineError("disposed", "this relocalizer was disposed of");

function alive(holder: Holder): Engine {
  if (!holder.engine) throw disposed();
  return holder.engine;
}

const handlers: { readonly [N in CallName]: Handler<N> } = {
  create: async (holder, request) => {
    const { engine, created } = await Engine.create(request);
    holder.engine = engine;
    return created;
  },
  locate: (holder, request, next) => alive(holder).locate(request, next),
  setOptions: (holder, request) => alive(holder).setOptions(request),
  recallCamera: (holder, request) => alive(holder).recallCamera(request),
  reset: (holder) => alive(holder).reset(),
  memory: (holder) => alive(holder).memory(),
  dispose: (holder) => {
    holder.engine?.dispose();
    holder.engine = undefined;
    return null;
  },
};

/** Answers one call. Calls of one holder have to be awaited one after another. */
export async function perform<N extends CallName>(holder: Holder, name: N, request: Calls[N]["request"], next: NextFrame = () => undefined): Promise<Calls[N]["reply"]> {
  // A message from another thread may name anything.
  if (!Object.hasOwn(handlers, name)) throw new LandlineError("bad-input", `unknown call ${String(name)}`);
  return handlers[name](holder, request, next);
}
