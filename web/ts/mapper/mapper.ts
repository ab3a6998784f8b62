/** The public class. */
import { cameraFromWorldOf } from "../arguments.js";
import { load, type Loaded } from "../assets.js";
import { LandlineError } from "../errors.js";
import { intrinsicsForFrame, prepareFrame, sizeOf } from "../frames.js";
import { loadEngine } from "../init.js";
import { placementFrom } from "../placement.js";
import type { MemoryUse } from "../protocol.js";
import { isNode } from "../support.js";
import type { FrameSource, Units } from "../types.js";
import { checkBuildOptions, checkFrameOptions, checkMapperOptions, checkWriteOptions } from "./arguments.js";
import { directChannel, workerChannel, type Channel } from "./channel.js";
import { disposed } from "./engine.js";
import { Eta } from "./eta.js";
import type { StageEvent, Written } from "./protocol.js";
import type { BuildOptions, Coverage, FrameOptions, FrameVerdict, LeftOutReason, MapperEvents, MapperOptions, MapPicture, MapProgress, MapReport, MapResult, NotKeptReason, WriteOptions } from "./types.js";

/** Where the mapping engine lies in this package. */
export function packagedMapperWasmUrl(): URL {
  return new URL("./landline_mapper_bg.wasm", import.meta.url);
}

/** Keyframes that usually do for a room, and the most that there are by default; as in src/mapping/keyframes.rs. */
const enoughKeyframes = 120;
const usualMost = 300;

interface Kept {
  name?: string;
  timestamp?: number;
}

/**
 * Makes a scene of a film, on the device.
 *
 * Frames go in one by one; what helps is kept as features, pictures are not. Raises `verdict` for every frame and `coverage`
 * for every one that was kept.
 */
export class Mapper extends EventTarget {
  readonly #channel: Channel;
  readonly #toThread: boolean;
  readonly #most: number;
  #kept: Kept[] = [];
  /** Whether frames come with poses; unknown before the first. */
  #isPosed: boolean | undefined;
  #frames = 0;
  #notKept: Partial<Record<NotKeptReason, number>> = {};
  #disposed = false;
  #isWorking = false;
  #onStage: ((event: StageEvent) => void) | undefined;
  #buildSeconds = 0;

  private constructor(start: (onStage: (event: StageEvent) => void) => Channel, toThread: boolean, most: number) {
    super();
    this.#channel = start((event) => this.#onStage?.(event));
    this.#toThread = toThread;
    this.#most = most;
  }

  /** Loads the mapping engine and the extractor, side by side, and makes them ready. */
  static async create(options: MapperOptions = {}): Promise<Mapper> {
    checkMapperOptions(options);
    const { signal, onProgress, fetch, cache, integrity, stallTimeoutMs, maxSide, maxKeyframes } = options;
    signal?.throwIfAborted();
    const stop = new AbortController();
    const forward = (): void => stop.abort(signal?.reason);
    signal?.addEventListener("abort", forward, { once: true });
    const common = { onProgress, fetch, stallTimeoutMs, signal: stop.signal };
    const loadExtractor = (): Promise<Loaded> => load(options.extractor ?? new URL("../xfeat.safetensors", import.meta.url), { ...common, cache, file: "extractor", integrity: integrity?.extractor });
    try {
      let [{ module }, extractor] = await Promise.all([loadEngine({ ...common, wasm: options.wasm ?? packagedMapperWasmUrl() }), loadExtractor()]).catch((error: unknown) => {
        stop.abort(error);
        throw error;
      });
      onProgress?.({ status: "prepare" });
      const useWorker = options.worker ?? !isNode();
      const mapper = new Mapper((onStage) => (useWorker ? workerChannel(options.workerUrl, onStage) : directChannel(onStage)), useWorker, maxKeyframes ?? usualMost);
      const abort = (): void => mapper.#channel.close();
      signal?.addEventListener("abort", abort, { once: true });
      const limits = { ...(maxSide === undefined ? {} : { maxSide }), ...(maxKeyframes === undefined ? {} : { maxKeyframes }) };
      const prepare = (again: boolean): Promise<null> => {
        const bytes = again ? extractor.bytes.slice() : extractor.bytes;
        return mapper.#channel.call("create", { module, extractor: bytes, options: limits }, useWorker ? [bytes.buffer as ArrayBuffer] : []);
      };
      try {
        try {
          await prepare(extractor.fromCache);
        } catch (error) {
          if (!(error instanceof LandlineError && error.code === "extractor-corrupt" && extractor.fromCache)) throw error;
          // One that was kept before it could be checked: once more, from its server.
          await extractor.drop();
          extractor = await loadExtractor();
          await prepare(false);
        }
        signal?.throwIfAborted();
        await extractor.keep();
        onProgress?.({ status: "ready", backend: "cpu", backendReason: "the mapper runs on the CPU", build: "plain", buildReason: "the mapper has one build" });
        return mapper;
      } catch (error) {
        await mapper.dispose();
        signal?.throwIfAborted();
        throw error;
      } finally {
        signal?.removeEventListener("abort", abort);
      }
    } finally {
      signal?.removeEventListener("abort", forward);
    }
  }

  /** Frames that were kept. */
  get keyframes(): number {
    return this.#kept.length;
  }

  get coverage(): Coverage {
    return { keyframes: this.#kept.length, enough: Math.min(enoughKeyframes, this.#most), most: this.#most, frames: this.#frames, notKept: { ...this.#notKept } };
  }

  /** Looks at a frame, and keeps what it shows if it helps; a map that was made before is out of date then. Frames are answered in the order of the calls; while a map is made they are refused. */
  async addFrame(source: FrameSource, options: FrameOptions = {}): Promise<FrameVerdict> {
    this.#checkIdle();
    checkFrameOptions(options);
    const pose = cameraFromWorldOf(options.pose, "pose");
    if (this.#isPosed !== undefined && this.#isPosed !== pose.length > 0) {
      throw new LandlineError("bad-input", `this frame has ${this.#isPosed ? "no" : "a"} pose, those before it have ${this.#isPosed ? "one" : "none"}`, "Give all frames poses, or none; clear() begins anew.");
    }
    const { gravity: g, timestamp, name } = options;
    const prepared = await prepareFrame(source, options.transfer ?? false, this.#toThread);
    const { frame } = prepared;
    let verdict: FrameVerdict;
    try {
      this.#checkIdle();
      const { width, height } = sizeOf(frame);
      const given = options.intrinsics ?? prepared.exif;
      const k = given && intrinsicsForFrame(given, width, height);
      verdict = await this.#channel.call(
        "add",
        { frame, intrinsics: k ? [k.fx, k.fy, k.cx, k.cy] : [], areExact: options.intrinsics !== undefined, pose, gravity: g ? [g.x, g.y, g.z] : [], name: name ?? "", keep: options.keep ?? false },
        prepared.transfer,
      );
    } catch (error) {
      if (!("data" in frame)) frame.close();
      throw error;
    }
    this.#frames += 1;
    this.#isPosed = pose.length > 0;
    if (verdict.kept) this.#kept.push({ ...(name === undefined ? {} : { name }), ...(timestamp === undefined ? {} : { timestamp }) });
    else this.#notKept[verdict.reason] = (this.#notKept[verdict.reason] ?? 0) + 1;
    this.#raise("verdict", verdict);
    if (verdict.kept) this.#raise("coverage", this.coverage);
    return verdict;
  }

  /** Makes a scene of the keyframes. They stay, so that after an error or a cancel more can be filmed. */
  async build(options: BuildOptions = {}): Promise<MapResult> {
    checkBuildOptions(options);
    const eta = new Eta();
    const written = await this.#work(options, eta, async () => {
      await this.#channel.call("build", null);
      this.#buildSeconds = eta.seconds;
      return this.#channel.call("write", sceneRequest(options));
    });
    this.#buildSeconds = eta.seconds;
    return { scene: written.scene, report: this.#report(written) };
  }

  /** Writes the scene of the map that `build` made once more: with its lengths in metres, upright, or under another name. */
  async write(options: WriteOptions = {}): Promise<MapResult> {
    checkWriteOptions(options);
    const written = await this.#work(options, new Eta(), () => this.#channel.call("write", sceneRequest(options)));
    return { scene: written.scene, report: this.#report(written) };
  }

  /** Features and tracks of the map that `build` made, as the label file that `landline train` takes. Some hundred kilobytes a picture. */
  async labels(): Promise<Uint8Array> {
    this.#check();
    return this.#channel.call("labels", null);
  }

  /** Forgets the film. */
  async clear(): Promise<void> {
    this.#checkIdle();
    await this.#channel.call("clear", null);
    this.#kept = [];
    this.#isPosed = undefined;
    this.#frames = 0;
    this.#notKept = {};
  }

  /** Calls a listener with what an event tells; the answer takes it away again. */
  on<K extends keyof MapperEvents>(type: K, listener: (detail: MapperEvents[K]["detail"]) => void): () => void {
    const call = (event: Event): void => listener((event as MapperEvents[K]).detail);
    this.addEventListener(type, call);
    return () => this.removeEventListener(type, call);
  }

  /** Bytes that the engine holds. */
  async memory(): Promise<MemoryUse> {
    this.#check();
    return this.#channel.call("memory", null);
  }

  /** Ends the worker and frees everything. Calls under way reject with `disposed`. Calling it twice is fine. */
  async dispose(): Promise<void> {
    if (this.#disposed) return;
    this.#disposed = true;
    this.#channel.close();
  }

  async [Symbol.asyncDispose](): Promise<void> {
    await this.dispose();
  }

  #check(): void {
    if (this.#disposed) throw disposed();
  }

  /** A frame that came in the middle of a map would undo it. */
  #checkIdle(): void {
    this.#check();
    if (this.#isWorking) throw new LandlineError("bad-input", "a map is being made already", "Wait for it, or cancel it by its signal.");
  }

  #raise<K extends keyof MapperEvents>(type: K, detail: MapperEvents[K]["detail"]): void {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  /** One piece of long work, with its progress and its cancelling. */
  async #work<T>({ signal, onProgress }: { signal?: AbortSignal; onProgress?: (progress: MapProgress) => void }, eta: Eta, run: () => Promise<T>): Promise<T> {
    this.#checkIdle();
    signal?.throwIfAborted();
    this.#isWorking = true;
    const cancel = (): void => void this.#channel.call("cancel", null).catch(() => undefined);
    signal?.addEventListener("abort", cancel, { once: true });
    let thrown: { by: unknown } | undefined;
    this.#onStage = (event) => {
      try {
        onProgress?.(eta.progress(event));
      } catch (error) {
        // What the page's own function throws ends the work, here and in a worker.
        thrown ??= { by: error };
        cancel();
      }
    };
    const check = (): void => {
      if (thrown) throw thrown.by;
      signal?.throwIfAborted();
    };
    try {
      const result = await run();
      check();
      return result;
    } catch (error) {
      check();
      throw error;
    } finally {
      this.#onStage = undefined;
      this.#isWorking = false;
      signal?.removeEventListener("abort", cancel);
    }
  }

  #report({ report: raw, poses, points, lines }: Written): MapReport {
    const pictures = raw.pictures.map(({ keyframe, registered, reason, advice }): MapPicture => {
      const picture: MapPicture = { keyframe, registered, ...this.#kept[keyframe] };
      if (reason !== undefined) picture.reason = reason as LeftOutReason;
      if (advice !== undefined) picture.advice = advice;
      if (registered) picture.placement = placementFrom(poses.slice(16 * keyframe, 16 * keyframe + 16));
      return picture;
    });
    const { poses: origin, components, focal, width, height, points: numPoints, lines: numLines, medianReprojection } = raw;
    const report: MapReport = {
      pictures,
      poses: origin,
      components,
      focal,
      width,
      height,
      units: raw.units as Units,
      points: numPoints,
      lines: numLines,
      medianReprojection,
      seconds: this.#buildSeconds,
      warnings: raw.warnings,
      cloud: { points, lines },
    };
    if (raw.up) report.up = { x: raw.up[0], y: raw.up[1], z: raw.up[2] };
    return report;
  }
}

function sceneRequest({ name = "", licence = "", scale, up }: WriteOptions): { name: string; licence: string; created: string; scale?: NonNullable<WriteOptions["scale"]>; up?: [number, number, number] } {
  // Whole seconds, as scene files have them.
  const created = `${new Date().toISOString().slice(0, 19)}Z`;
  return { name, licence, created, ...(scale ? { scale } : {}), ...(up ? { up: [up.x, up.y, up.z] as [number, number, number] } : {}) };
}
