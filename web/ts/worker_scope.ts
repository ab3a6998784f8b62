/** What the workers of this package have in common. */
import { plainError } from "./errors.js";
import type { CallReply } from "./rpc.js";

/**
 * A page's policy in a <meta> element does not reach its workers. This one needs no network: everything was loaded by the
 * page, and pictures are here. So it gives up what could send before the first picture arrives, on the scope and on the
 * prototypes that the scope inherits from. `import()` is syntax and cannot be given up: only a policy that is served with
 * this script forbids it (docs/guides/host-the-page.md).
 */
export function giveUpNetwork(): void {
  for (const name of [
    ...["fetch", "XMLHttpRequest", "WebSocket", "WebSocketStream", "WebSocketError", "WebTransport", "EventSource", "RTCPeerConnection", "RTCDataChannel"],
    ...["importScripts", "Worker", "SharedWorker", "BroadcastChannel", "FontFace", "fonts", "Notification", "PushManager", "BackgroundFetchManager"],
    ...["caches", "Cache", "CacheStorage", "indexedDB"],
  ]) {
    for (let owner: object | null = self; owner !== null && owner !== Object.prototype; owner = Object.getPrototypeOf(owner) as object | null) {
      if (owner === self || Object.hasOwn(owner, name)) Object.defineProperty(owner, name, { value: undefined, writable: false, configurable: false });
    }
  }
}

/** Buffers of a result, so that they move to the page instead of being copied. */
export function buffersOf(reply: unknown): ArrayBuffer[] {
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

/** The few members of a dedicated worker's scope that are used; the page's library of types has no such scope. */
interface Scope<Message> {
  onmessage: ((event: MessageEvent<Message>) => void) | null;
  postMessage(message: CallReply, transfer: Transferable[]): void;
}

/** Answers messages one after another, but for those that cannot wait. */
export function answerInOrder<Message extends { id: number }>(perform: (message: Message) => Promise<unknown>, isUrgent: (message: Message) => boolean = () => false): void {
  const scope = self as unknown as Scope<Message>;
  let queue: Promise<void> = Promise.resolve();
  const answer = async (message: Message): Promise<void> => {
    const { id } = message;
    try {
      const reply = await perform(message);
      scope.postMessage({ id, ok: true, reply }, buffersOf(reply));
    } catch (error) {
      scope.postMessage({ id, ok: false, error: plainError(error) }, []);
    }
  };
  scope.onmessage = ({ data }) => {
    if (isUrgent(data)) void answer(data);
    else queue = queue.then(() => answer(data));
  };
}
