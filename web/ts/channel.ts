/** Calls the engine: in a worker, or directly on this thread. */
import { Engine } from "./engine.js";
import { asLandlineError, LandlineError } from "./errors.js";
import type { CallName, Calls, Reply } from "./protocol.js";

export interface Channel {
  call<N extends CallName>(name: N, request: Calls[N]["request"], transfer?: Transferable[]): Promise<Calls[N]["reply"]>;
  /** Rejects everything that is under way, and ends the worker. */
  close(): void;
}

const disposed = (): LandlineError => new LandlineError("disposed", "this relocalizer was disposed of");

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
    this.#worker.onmessageerror = () => this.#end(new LandlineError("panicked", "a message from the worker could not be read"));
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
  #engine: Engine | undefined;
  #queue: Promise<unknown> = Promise.resolve();
  #closed = false;

  call<N extends CallName>(name: N, request: Calls[N]["request"]): Promise<Calls[N]["reply"]> {
    const answer = this.#queue.then(() => this.#answer(name, request));
    this.#queue = answer.catch(() => undefined);
    return answer as Promise<Calls[N]["reply"]>;
  }

  close(): void {
    this.#closed = true;
    // A frame that is under way still holds the engine: it goes when that frame is done.
    void this.#queue.then(() => {
      this.#engine?.dispose();
      this.#engine = undefined;
    });
  }

  async #answer(name: CallName, request: unknown): Promise<unknown> {
    if (this.#closed) throw disposed();
    const reply = await this.#perform(name, request);
    if (this.#closed) throw disposed();
    return reply;
  }

  async #perform(name: CallName, request: unknown): Promise<unknown> {
    if (name === "create") {
      const made = await Engine.create(request as Calls["create"]["request"]);
      this.#engine = made.engine;
      return made.created;
    }
    const engine = this.#engine;
    if (!engine) throw disposed();
    switch (name) {
      case "locate":
        return engine.locate(request as Calls["locate"]["request"]);
      case "setOptions":
        return engine.setOptions(request as Calls["setOptions"]["request"]);
      case "recallCamera":
        return engine.recallCamera(request as Calls["recallCamera"]["request"]);
      case "reset":
        return engine.reset();
      case "memory":
        return engine.memory();
      case "dispose":
        return null;
    }
  }
}
