/** Entry of the worker: answers the messages of `relocalizer.ts` one after another. */
import { plainError } from "./errors.js";
import { perform, type Holder } from "./perform.js";
import type { LocateRequest, Reply, Request } from "./protocol.js";
import { buffersOf, giveUpNetwork } from "./worker_scope.js";

/** The few members of a dedicated worker's scope that are used; the page's library of types has no such scope. */
interface Scope {
  onmessage: ((event: MessageEvent<Request>) => void) | null;
  postMessage(message: Reply, transfer: Transferable[]): void;
}
const scope = self as unknown as Scope;

giveUpNetwork();

const holder: Holder = {};
// Answered in order; a frame that waits behind another one may be begun while that one's pose is solved.
const waiting: Request[] = [];
let isWorking = false;

function nextFrame(): LocateRequest | undefined {
  const next = waiting[0];
  return next?.call === "locate" ? (next.request as LocateRequest) : undefined;
}

async function work(): Promise<void> {
  isWorking = true;
  for (let data = waiting.shift(); data; data = waiting.shift()) {
    try {
      const reply = await perform(holder, data.call, data.request, nextFrame);
      scope.postMessage({ id: data.id, ok: true, reply }, buffersOf(reply));
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
