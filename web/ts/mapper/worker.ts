/** Entry of the mapper's worker: answers the messages of `index.ts` one after another, but for `cancel`. */
import { plainError } from "../errors.js";
import type { CallReply } from "../rpc.js";
import { buffersOf, giveUpNetwork } from "../worker_scope.js";
import { MapperEngine } from "./engine.js";
import type { Request, StageEvent } from "./protocol.js";

interface Scope {
  onmessage: ((event: MessageEvent<Request>) => void) | null;
  postMessage(message: CallReply | { event: StageEvent }, transfer: Transferable[]): void;
}
const scope = self as unknown as Scope;

giveUpNetwork();

const engine = new MapperEngine((event) => scope.postMessage({ event }, []));
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
  if (data.call === "cancel") void answer(data);
  else queue = queue.then(() => answer(data));
};
