/** Entry of the worker: answers the messages of `relocalizer.ts` one after another. */
import { plainError } from "./errors.js";
import { perform, type Holder } from "./perform.js";
import type { LocateRequest, Reply, Request } from "./protocol.js";

/** The few members of a dedicated worker's scope that are used; the page's library of types has no such scope. */
interface Scope {
  onmessage: ((event: MessageEvent<Request>) => void) | null;
  postMessage(message: Reply, transfer: Transferable[]): void;
}
const scope = self as unknown as Scope;

// A page's policy in a <meta> element does not reach its workers. This one needs no network: everything was loaded by the
// page, and pictures are here. So it gives up what could send before the first picture arrives, on the scope and on the
// prototypes that the scope inherits from. `import()` is syntax and cannot be given up: only a policy that is served with
// this script forbids it (docs/guides/host-the-page.md).
for (const name of [
  ...["fetch", "XMLHttpRequest", "WebSocket", "WebSocketStream", "WebSocketError", "WebTransport", "EventSource", "RTCPeerConnection", "RTCDataChannel"],
  ...["importScripts", "Worker", "SharedWorker", "BroadcastChannel", "FontFace", "fonts", "Notification", "PushManager", "BackgroundFetchManager"],
  ...["caches", "Cache", "CacheStorage", "indexedDB"],
]) {
  for (let owner: object | null = self; owner !== null && owner !== Object.prototype; owner = Object.getPrototypeOf(owner) as object | null) {
    if (owner === self || Object.hasOwn(owner, name)) Object.defineProperty(owner, name, { value: undefined, writable: false, configurable: false });
  }
}

const holder: Holder = {};
// Answered in order; a frame that waits behind another one may be begun while that one's pose is solved.
const waiting: Request[] = [];
let isWorking = false;

function nextFrame(): LocateRequest | undefined {
  const next = waiting[0];
  return next?.call === "locate" ? (next.request as LocateRequest) : undefined;
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
      const reply = await perform(holder, data.call, data.request, nextFrame);
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
