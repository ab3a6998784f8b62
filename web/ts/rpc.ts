/** Calls to another thread, or to this one in the same manner. What the calls are is the caller's. */
import { asLandlineError, LandlineError, type PlainError } from "./errors.js";

/** Name of a call → what goes there and what comes back. */
export type CallTable<C> = { [N in keyof C]: { request: unknown; reply: unknown } };

export interface CallRequest<C extends CallTable<C>, N extends keyof C = keyof C> {
  id: number;
  call: N;
  request: C[N]["request"];
}

export type CallReply = { id: number; ok: true; reply: unknown } | { id: number; ok: false; error: PlainError };

export interface Channel<C extends CallTable<C>> {
  call<N extends keyof C & string>(name: N, request: C[N]["request"], transfer?: Transferable[]): Promise<C[N]["reply"]>;
  /** Rejects everything that is under way, and ends the worker. */
  close(): void;
}

interface Waiting {
  done: (reply: never) => void;
  fail: (error: LandlineError) => void;
}

export class WorkerChannel<C extends CallTable<C>> implements Channel<C> {
  readonly #worker: Worker;
  readonly #disposed: () => LandlineError;
  readonly #waiting = new Map<number, Waiting>();
  #next = 0;
  #dead: LandlineError | undefined;

  /** `onEvent` gets what the worker tells without being asked. */
  constructor(start: () => Worker, disposed: () => LandlineError, onEvent: (event: unknown) => void = () => undefined) {
    this.#disposed = disposed;
    try {
      this.#worker = start();
    } catch (error) {
      throw new LandlineError("unsupported", `the worker cannot start: ${String((error as Error).message ?? error)}`, "Serve the package from the page's own origin, or pass `worker: false`.", error);
    }
    this.#worker.onmessage = ({ data }: MessageEvent<CallReply | { event: unknown }>) => {
      if ("event" in data) return onEvent(data.event);
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

  call<N extends keyof C & string>(name: N, request: C[N]["request"], transfer: Transferable[] = []): Promise<C[N]["reply"]> {
    if (this.#dead) return Promise.reject(this.#dead);
    const id = this.#next++;
    return new Promise((done, fail) => {
      this.#waiting.set(id, { done, fail });
      try {
        this.#worker.postMessage({ id, call: name, request }, transfer);
      } catch (error) {
        this.#waiting.delete(id);
        fail(new LandlineError("bad-input", `the frame cannot be handed over: ${String((error as Error).message ?? error)}`, "It may have been closed or transferred before, or show a picture of another origin: that needs its crossorigin attribute, and its server's leave (CORS).", error));
      }
    });
  }

  close(): void {
    this.#end(this.#disposed());
  }

  #end(reason: LandlineError): void {
    this.#dead ??= reason;
    this.#worker.terminate();
    for (const { fail } of this.#waiting.values()) fail(reason);
    this.#waiting.clear();
  }
}

/** Answers one call. */
type Perform<C extends CallTable<C>> = <N extends keyof C & string>(name: N, request: C[N]["request"]) => Promise<C[N]["reply"]>;

/** Calls are performed one after another, but for the `urgent` ones, which do not wait. */
export class DirectChannel<C extends CallTable<C>> implements Channel<C> {
  readonly #perform: Perform<C>;
  readonly #dispose: () => unknown;
  readonly #disposed: () => LandlineError;
  readonly #urgent: readonly string[];
  #queue: Promise<unknown> = Promise.resolve();
  #closed = false;

  constructor(perform: Perform<C>, dispose: () => unknown, disposed: () => LandlineError, urgent: readonly string[] = []) {
    this.#perform = perform;
    this.#dispose = dispose;
    this.#disposed = disposed;
    this.#urgent = urgent;
  }

  call<N extends keyof C & string>(name: N, request: C[N]["request"]): Promise<C[N]["reply"]> {
    if (this.#urgent.includes(name)) return this.#answer(name, request);
    const answer = this.#queue.then(() => this.#answer(name, request));
    this.#queue = answer.catch(() => undefined);
    return answer;
  }

  close(): void {
    this.#closed = true;
    // A frame that is under way still holds the engine: it goes when that frame is done.
    void this.#queue.then(() => this.#dispose());
  }

  async #answer<N extends keyof C & string>(name: N, request: C[N]["request"]): Promise<C[N]["reply"]> {
    if (this.#closed) throw this.#disposed();
    const reply = await this.#perform(name, request);
    if (this.#closed) throw this.#disposed();
    return reply;
  }
}

/** An answer, until the signal says that nobody wants it. */
export function unless<T>(signal: AbortSignal | undefined, answer: Promise<T>): Promise<T> {
  if (!signal) return answer;
  return new Promise((done, fail) => {
    const stop = (): void => fail(signal.reason as Error);
    signal.addEventListener("abort", stop, { once: true });
    answer.then(done, fail).finally(() => signal.removeEventListener("abort", stop));
    if (signal.aborted) stop();
  });
}

/** Keeps the order of calls whose preparation takes more or less time, as decoding does. */
export class InOrder {
  #before: Promise<unknown> = Promise.resolve();

  /** Calls `hand` when `ready` is, and all from before are handed over. */
  async next<R, A>(ready: Promise<R>, hand: (ready: R) => Promise<A>): Promise<A> {
    // In an object, or what follows would wait for the answer too.
    const handed = this.#before.then(() => ready).then((value) => ({ answer: hand(value) }));
    this.#before = handed.then(
      () => undefined,
      () => undefined,
    );
    // One that fails early fails at once.
    await ready;
    return (await handed).answer;
  }
}
