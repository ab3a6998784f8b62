/** The public class. */
import { cameraFromWorldOf, checkCreateOptions, checkLiveOptions, checkLocateOptions, checkRecall } from "./arguments.js";
import { load, type Loaded } from "./assets.js";
import { directChannel, workerChannel, type Channel } from "./channel.js";
import { LandlineError } from "./errors.js";
import { Follower, type FollowerOptions } from "./follower.js";
import { prepareFrame } from "./frames.js";
import { loadEngine } from "./init.js";
import type { Created, MemoryUse } from "./protocol.js";
import { gravityOf, intrinsicsOf, liveOptions } from "./requests.js";
import { InOrder, unless } from "./rpc.js";
import { isNode } from "./support.js";
import type { Backend, Build, CreateOptions, FrameSource, LiveOptions, LocateOptions, LocateResult, SceneInfo } from "./types.js";

/** Where the extractor's weights lie in this package. */
export function packagedExtractorUrl(): URL {
  return new URL("./xfeat.safetensors", import.meta.url);
}

/** What `searching`, `tracking` and `limited` listeners get; `detail` is the result that led there. */
export type StateEvent = CustomEvent<LocateResult>;

/** Events of a relocalizer: every result, and the changes of the state over several frames. */
export interface RelocalizerEvents {
  result: StateEvent;
  searching: StateEvent;
  tracking: StateEvent;
  limited: StateEvent;
}

/** Types of the events; the methods are those of `EventTarget`. */
export interface Relocalizer {
  addEventListener<K extends keyof RelocalizerEvents>(type: K, listener: (event: RelocalizerEvents[K]) => void, options?: boolean | AddEventListenerOptions): void;
  addEventListener(type: string, listener: EventListenerOrEventListenerObject | null, options?: boolean | AddEventListenerOptions): void;
  removeEventListener<K extends keyof RelocalizerEvents>(type: K, listener: (event: RelocalizerEvents[K]) => void, options?: boolean | EventListenerOptions): void;
  removeEventListener(type: string, listener: EventListenerOrEventListenerObject | null, options?: boolean | EventListenerOptions): void;
}

/**
 * Finds the camera in one taught place.
 *
 * Raises the events `searching`, `tracking` and `limited` (`CustomEvent` with the result as `detail`) whenever the
 * state over several frames changes, and `result` for every frame.
 */
export class Relocalizer extends EventTarget {
  readonly #channel: Channel;
  readonly #toThread: boolean;
  /** What the scene file says about itself. */
  readonly scene: SceneInfo;
  #backend: Backend;
  #backendReason: string;
  /** The build of the engine. */
  readonly build: Build;
  /** Why this one. */
  readonly buildReason: string;
  #state: LocateResult["state"] = "searching";
  #disposed = false;
  readonly #module: WebAssembly.Module;
  #inFlight = 0;
  readonly #order = new InOrder();

  private constructor(channel: Channel, module: WebAssembly.Module, toThread: boolean, created: Created) {
    super();
    this.#channel = channel;
    this.#module = module;
    this.#toThread = toThread;
    this.scene = created.scene;
    this.#backend = created.backend;
    this.#backendReason = created.backendReason;
    this.build = created.build;
    this.buildReason = created.buildReason;
  }

  /** Loads the engine, the extractor and the scene, side by side, and makes them ready. */
  static async create(options: CreateOptions): Promise<Relocalizer> {
    if (options === null || typeof options !== "object" || options.scene === undefined) {
      throw new LandlineError("bad-input", "create() needs { scene }", "Pass the address or the bytes of a .landline file.");
    }
    checkCreateOptions(options);
    const { signal, onProgress, fetch, cache, integrity, wasm, build, stallTimeoutMs, device = "auto" } = options;
    signal?.throwIfAborted();
    // When one of the three fails the others are of no use any more.
    const stop = new AbortController();
    const forward = (): void => stop.abort(signal?.reason);
    signal?.addEventListener("abort", forward, { once: true });
    const common = { onProgress, cache, fetch, stallTimeoutMs, signal: stop.signal };
    const loadExtractor = (): Promise<Loaded> => load(options.extractor ?? packagedExtractorUrl(), { ...common, file: "extractor", integrity: integrity?.extractor });
    const loadScene = (): Promise<Loaded> => load(options.scene, { ...common, file: "scene", integrity: integrity?.scene });
    try {
      let [engine, extractor, scene] = await Promise.all([loadEngine({ wasm, build, onProgress, fetch, stallTimeoutMs, signal: stop.signal }), loadExtractor(), loadScene()]).catch((error: unknown) => {
        stop.abort(error);
        throw error;
      });
      onProgress?.({ status: "prepare" });
      const useWorker = options.worker ?? !isNode();
      const channel: Channel = useWorker ? workerChannel(options.workerUrl) : directChannel();
      const abort = (): void => channel.close();
      signal?.addEventListener("abort", abort, { once: true });
      const prepare = async (again: boolean): Promise<Created> => {
        // Kept bytes may prove to be wrong, and the others are needed once more then.
        const [e, s] = again ? [extractor.bytes.slice(), scene.bytes.slice()] : [extractor.bytes, scene.bytes];
        return channel.call("create", { ...engine, extractor: e, scene: s, device, options: liveOptions(options) }, useWorker ? [e.buffer as ArrayBuffer, s.buffer as ArrayBuffer] : []);
      };
      try {
        let created: Created;
        try {
          created = await prepare(extractor.fromCache || scene.fromCache);
        } catch (error) {
          const code = error instanceof LandlineError ? error.code : undefined;
          const isScene = code === "scene-corrupt" || code === "scene-version" || code === "scene-extractor";
          const suspect = isScene ? scene : code === "extractor-corrupt" ? extractor : undefined;
          if (!suspect?.fromCache) throw error;
          // One that was kept before it could be checked, or while the server was out of order: once more, from there.
          await suspect.drop();
          if (isScene) scene = await loadScene();
          else extractor = await loadExtractor();
          created = await prepare(false);
        }
        signal?.throwIfAborted();
        await Promise.all([extractor.keep(), scene.keep()]);
        const { scene: _, ...ready } = created;
        onProgress?.({ status: "ready", ...ready });
        return new Relocalizer(channel, engine.module, useWorker, created);
      } catch (error) {
        channel.close();
        signal?.throwIfAborted();
        throw error;
      } finally {
        signal?.removeEventListener("abort", abort);
      }
    } finally {
      signal?.removeEventListener("abort", forward);
    }
  }

  /** What executes the networks. */
  get backend(): Backend {
    return this.#backend;
  }

  /** Why not something faster. */
  get backendReason(): string {
    return this.#backendReason;
  }

  get state(): LocateResult["state"] {
    return this.#state;
  }

  /** True while no frame is under way: the moment to hand in the newest one. */
  get idle(): boolean {
    return this.#inFlight === 0 && !this.#disposed;
  }

  /** Finds the camera of one frame. Frames are answered in the order of the calls; an aborted one rejects at once. */
  async locate(source: FrameSource, options: LocateOptions = {}): Promise<LocateResult> {
    this.#check();
    checkLocateOptions(options);
    options.signal?.throwIfAborted();
    this.#inFlight += 1;
    const answer = this.#locate(source, options).finally(() => (this.#inFlight -= 1));
    const result = await unless(options.signal, answer);
    this.#publish(result);
    return result;
  }

  /** A frame that the engine has is computed all the same when it is aborted: its effect on tracking stays. */
  #locate(source: FrameSource, options: LocateOptions): Promise<LocateResult> {
    const calledAt = performance.timeOrigin + performance.now();
    const { signal } = options;
    return this.#order.next(prepareFrame(source, options.transfer ?? false, this.#toThread), async ({ frame, transfer, exif, isFile }) => {
      try {
        this.#check();
        signal?.throwIfAborted();
        return await this.#channel.call(
          "locate",
          {
            frame,
            ...intrinsicsOf(frame, options, exif),
            timestampMs: options.timestamp ?? calledAt,
            include: options.include ?? [],
            camera: options.camera ?? "",
            tracking: options.tracking ?? false,
            explain: options.explain ?? (isFile === true && !options.tracking),
            gravity: gravityOf(options.gravity),
            prior: cameraFromWorldOf(options.prior, "prior"),
            calledAt,
          },
          transfer,
        );
      } catch (error) {
        // What was not handed over would keep its memory until the next collection.
        if (!("data" in frame)) frame.close();
        throw error;
      }
    });
  }

  /** Follows one camera on the caller's thread, with the engine that was loaded already. */
  follower(options: FollowerOptions = {}): Promise<Follower> {
    this.#check();
    return Follower.create({ ...options, wasm: this.#module });
  }

  /** Changes options; those left out stay. */
  async setOptions(options: LiveOptions): Promise<void> {
    this.#check();
    checkLiveOptions(options);
    await this.#channel.call("setOptions", liveOptions(options));
  }

  /**
   * Takes over the focal length that an earlier session learned of a camera, as a start that frames of this session
   * correct. What a session has learned stands in results whose `intrinsics.source` is `remembered`: `fx / width`.
   */
  async recallCamera(camera: string, focalPerWidth: number): Promise<void> {
    this.#check();
    checkRecall(camera, focalPerWidth);
    await this.#channel.call("recallCamera", { camera, focalPerWidth });
  }

  /** Forgets where the camera was: the next frame is located from nothing. */
  async reset(): Promise<void> {
    this.#check();
    await this.#channel.call("reset", null);
    this.#state = "searching";
  }

  /** Bytes that the engine holds. */
  async memory(): Promise<MemoryUse> {
    this.#check();
    return this.#channel.call("memory", null);
  }

  /** Ends the worker and frees everything. Frames under way reject with `disposed`. Calling it twice is fine. */
  async dispose(): Promise<void> {
    if (this.#disposed) return;
    this.#disposed = true;
    this.#channel.close();
  }

  async [Symbol.asyncDispose](): Promise<void> {
    await this.dispose();
  }

  #check(): void {
    if (this.#disposed) throw new LandlineError("disposed", "this relocalizer was disposed of");
  }

  #publish(result: LocateResult): void {
    this.#backend = result.backend;
    this.#backendReason = result.backendReason;
    this.dispatchEvent(new CustomEvent("result", { detail: result }));
    if (result.state !== this.#state) {
      this.#state = result.state;
      this.dispatchEvent(new CustomEvent(result.state, { detail: result }));
    }
  }
}
