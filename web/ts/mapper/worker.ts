/** Entry of the mapper's worker: answers the messages of `index.ts` one after another, but for `cancel`. */
import { answerInOrder, giveUpNetwork } from "../worker_scope.js";
import { MapperEngine } from "./engine.js";
import type { Request } from "./protocol.js";

giveUpNetwork();

const engine = new MapperEngine((event) => (self as unknown as Worker).postMessage({ event }));
answerInOrder<Request>(
  ({ call, request }) => engine.perform(call, request),
  ({ call }) => call === "cancel",
);
