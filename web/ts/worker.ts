/** Entry of the worker: answers the messages of `relocalizer.ts` one after another. */
import { Engine } from "./engine.js";
import { LandlineError, plainError } from "./errors.js";
import type { CallName, Calls, LocateRequest, Reply, Request } from "./protocol.js";

/** The few members of a dedicated worker's scope that are used; the page's library of types has no such scope. */
interface Scope {
  onmessage: ((event: MessageEvent<Request>) => void) | null;
  postMessage(message: Reply, transfer: Transferable[]): void;
}
const scope = self as unknown as Scope;

// A page's policy in a <meta> element does not reach its workers. This one needs no network: everything was loaded by the
// page, and pictures are here. So it gives up what could send before the first picture arrives.
for (const name of ["fetch", "XMLHttpRequest", "WebSocket", "WebSocketStream", "WebTransport", "EventSource", "importScripts", "Worker", "caches"]) {
  Object.defineProperty(self, name, { value: undefined, writable: false, configurable: false });
}

let engine: Engine | undefined;
// Answered in order; a frame that waits behind another one may be begun while that one's pose is solved.
const waiting: Request[] = [];
let isWorking = false;

function nextFrame(): LocateRequest | undefined {
  const next = waiting[0];
  return next?.call === "locate" ? (next.request as LocateRequest) : undefined;
}

function alive(): Engine {
  if (!engine) throw new LandlineError("disposed", "this relocalizer was disposed of");
  return engine;
}

async function answer<N extends CallName>(call: N, request: Calls[N]["request"]): Promise<unknown> {
  switch (call) {
    case "create": {
      const made = await Engine.create(request as Calls["create"]["request"]);
      engine = made.engine;
      return made.created;
    }
    case "locate":
      return alive().locate(request as LocateRequest, nextFrame);
    case "setOptions":
      alive().setOptions(request as Calls["setOptions"]["request"]);
      return null;
    case "recallCamera":
      return alive().recallCamera(request as Calls["recallCamera"]["request"]);
    case "reset":
      alive().reset();
      return null;
    case "memory":
      return alive().memory();
    case "dispose":
      engine?.dispose();
      engine = undefined;
      return null;
    default:
      throw new LandlineError("bad-input", `unknown call ${String(call)}`);
  }
}

/** Buffers of a result, so that they move to the page instead of being copied. */
function buffers(reply: unknown): ArrayBuffer[] {
  const found = new Set<ArrayBuffer>();
  const visit = (value: unknown): void => {
    if (ArrayBuffer.isView(value)) {
      if (value.buffer instanceof ArrayBuffer) found.add(value.buffer);
    } else if (value !== null && typeof value === "object") {
      Object.values(value).forEach(visit);
    }
  };
  visit(reply);
  return [...found];
}

async function work(): Promise<void> {
  isWorking = true;
  for (let data = waiting.shift(); data; data = waiting.shift()) {
    try {
      const reply = await answer(data.call, data.request);
      scope.postMessage({ id: data.id, ok: true, reply }, buffers(reply));
    } catch (error) {
      scope.postMessage({ id: data.id, ok: false, error: plainError(error) }, []);
    }
  }
  isWorking = false;
}

scope.onmessage = ({ data }) => {
  waiting.push(data);
  if (!isWorking) void work();
};
