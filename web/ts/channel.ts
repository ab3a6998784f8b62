/** Calls the engine: in a worker, or directly on this thread. */
import { asLandlineError, LandlineError } from "./errors.js";
import { disposed, perform, type Holder } from "./perform.js";
import type { CallName, Calls, Reply } from "./protocol.js";

export interface Channel {
  call<N extends CallName>(name: N, request: Calls[N]["request"], transfer?: Transferable[]): Promise<Calls[N]["reply"]>;
  /** Rejects everything that is under way, and ends the worker. */
  close(): void;
}

interface Waiting {
  done: (reply: never) => void;
  fail: (error: LandlineError) => void;
}

export class WorkerChannel implements Channel {
  readonly #worker: Worker;
  readonly #waiting = new Map<number, Waiting>();
  #next = 0;
  #dead: LandlineError | undefined;

  constructor(url: string | URL | undefined) {
    try {
      // Bundlers look for exactly this form of words.
      this.#worker = url === undefined ? new Worker(new URL("./worker.js", import.meta.url), { type: "module", name: "landline" }) : new Worker(url, { type: "module", name: "landline" });
    } catch (error) {
      throw new LandlineError("unsupported", `the worker cannot start: ${String((error as Error).message ?? error)}`, "Serve the package from the page's own origin, or pass `worker: false`.", error);
    }
    this.#worker.onmessage = ({ data }: MessageEvent<Reply>) => {
      const waiting = this.#waiting.get(data.id);
      this.#waiting.delete(data.id);
      if (!waiting) return;
      if (data.ok) waiting.done(data.reply as never);
      else waiting.fail(asLandlineError(data.error));
    };
    this.#worker.onerror = (event) => {
      event.preventDefault();
      this.#end(new LandlineError("asset-fetch", `the worker's script failed${event.message ? `: ${event.message}` : " to load"}`, "Check that worker.js and its neighbours are served from the same folder as index.js."));
    };
    this.#worker.onmessageerror = () => this.#end(new LandlineError("engine-defect", "a message from the worker could not be read"));
  }

  call<N extends CallName>(name: N, request: Calls[N]["request"], transfer: Transferable[] = []): Promise<Calls[N]["reply"]> {
    if (this.#dead) return Promise.reject(this.#dead);
    const id = this.#next++;
    return new Promise((done, fail) => {
      this.#waiting.set(id, { done, fail });
      try {
        this.#worker.postMessage({ id, call: name, request }, transfer);
      } catch (error) {
        this.#waiting.delete(id);
        fail(new LandlineError("bad-input", `the frame cannot be handed over: ${String((error as Error).message ?? error)}`, "It may have been closed or transferred before.", error));
      }
    });
  }

  close(): void {
    this.#end(disposed());
  }

  #end(reason: LandlineError): void {
    this.#dead ??= reason;
    this.#worker.terminate();
    for (const { fail } of this.#waiting.values()) fail(reason);
    this.#waiting.clear();
  }
}

export class DirectChannel implements Channel {
  readonly #holder: Holder = {};
  #queue: Promise<unknown> = Promise.resolve();
  #closed = false;

  call<N extends CallName>(name: N, request: Calls[N]["request"]): Promise<Calls[N]["reply"]> {
    const answer = this.#queue.then(() => this.#answer(name, request));
    this.#queue = answer.catch(() => undefined);
    return answer;
  }

  close(): void {
    this.#closed = true;
    // A frame that is under way still holds the engine: it goes when that frame is done.
    void this.#queue.then(() => perform(this.#holder, "dispose", null));
  }

  async #answer<N extends CallName>(name: N, request: Calls[N]["request"]): Promise<Calls[N]["reply"]> {
    if (this.#closed) throw disposed();
    const reply = await perform(this.#holder, name, request);
    if (this.#closed) throw disposed();
    return reply;
  }
}
