/** Entry of a place's worker: answers the messages of `place.ts` one after another. */
import { answerInOrder, giveUpNetwork } from "../worker_scope.js";
import { PlaceEngine } from "./engine.js";
import type { Request } from "./protocol.js";

giveUpNetwork();

const engine = new PlaceEngine();
answerInOrder<Request>(({ call, request }) => engine.perform(call, request));
