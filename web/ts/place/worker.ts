/** Entry of a place's worker: answers the messages of `place.ts` one after another. */
import { plainError } from "../errors.js";
import type { CallReply } from "../rpc.js";
import { buffersOf, giveUpNetwork } from "../worker_scope.js";
import { PlaceEngine } from "./engine.js";
import type { Request } from "./protocol.js";

interface Scope {
  onmessage: ((event: MessageEvent<Request>) => void) | null;
  postMessage(message: CallReply, transfer: Transferable[]): void;
}
const scope = self as unknown as Scope;

giveUpNetwork();

const engine = new PlaceEngine();
let queue: Promise<void> = Promise.resolve();

async function answer({ id, call, request }: Request): Promise<void> {
  try {
    const reply = await engine.perform(call, request);
    scope.postMessage({ id, ok: true, reply }, buffersOf(reply));
  } catch (error) {
    scope.postMessage({ id, ok: false, error: plainError(error) }, []);
  }
}

scope.onmessage = ({ data }) => {
  queue = queue.then(() => answer(data));
};
