/** The public class of places. */
import { checkLiveOptions, checkOptions, checkRecall, kind, live, loading, locate, number, someBuild, type Check } from "../arguments.js";
import { load, type Loaded } from "../assets.js";
import { LandlineError } from "../errors.js";
import { Follower, type FollowerOptions } from "../follower.js";
import { prepareFrame } from "../frames.js";
import { loadEngine } from "../init.js";
import { placementFrom } from "../placement.js";
import { packagedExtractorUrl } from "../relocalizer.js";
import { gravityOf, intrinsicsOf, liveOptions } from "../requests.js";
import { unless } from "../rpc.js";
import { isNode } from "../support.js";
import type { Backend, Build, FrameSource, LiveOptions } from "../types.js";
import { directChannel, workerChannel, type Channel } from "./channel.js";
import { disposed, onCpu } from "./engine.js";
import { addressOf, addressBeside, parseManifest } from "./manifest.js";
import type { Answer, Created } from "./protocol.js";
import type { PlaceLocateOptions, PlaceManifest, PlaceMemory, PlaceOptions, PlaceResult, PlaceRoom } from "./types.js";

const anyAddress: Check = (value) => (typeof value === "string" || value instanceof URL ? undefined : "the address of a .place.json file");
const { integrity: _integrity, ...ofPlaces } = loading;
const create: Record<keyof PlaceOptions, Check> = { ...live, ...ofPlaces, place: anyAddress, build: someBuild, maxBytes: number(1, 2 ** 31, "bytes from 1 to 2147483648"), prefetch: kind("boolean") };
const { prior: _prior, explain: _explain, ...locateInPlace } = locate;

/** A room whose scene could not be had is asked for again after so many milliseconds. */
const retryMs = 10_000;

/** What listeners get. */
export interface PlaceEvents {
  /** The camera has come into another room; before the `result` that says so. */
  room: CustomEvent<{ room: PlaceRoom; result: PlaceResult }>;
  /** Every frame. */
  result: CustomEvent<PlaceResult>;
  /** A room whose scene could not be loaded or used. The others go on. */
  refused: CustomEvent<{ room: PlaceRoom; error: LandlineError }>;
}

/**
 * Finds the camera in a place of many rooms. Scenes are loaded as they are needed, checked against the manifest, and kept.
 *
 * Raises `room` when the camera has come into another room, `result` for every frame, and `refused` for a room whose scene
 * could not be had.
 */
export class Place extends EventTarget {
  readonly #channel: Channel;
  readonly #toThread: boolean;
  readonly #options: PlaceOptions;
  readonly #base: string;
  readonly #module: WebAssembly.Module;
  readonly manifest: PlaceManifest;
  readonly #rooms: ReadonlyMap<string, PlaceRoom>;
  /** The build of the engine. */
  readonly build: Build;
  /** Why this one. */
  readonly buildReason: string;
  readonly backend: Backend = "cpu";
  /** Why not something faster. */
  readonly backendReason = onCpu;
  /** Rooms on their way to the engine; true when they have come. */
  readonly #coming = new Map<string, Promise<boolean>>();
  /** When rooms were refused. */
  readonly #refusedAt = new Map<string, number>();
  readonly #stop = new AbortController();
  #queue: Promise<unknown> = Promise.resolve();
  #inFlight = 0;
  #room: PlaceRoom | undefined;
  #disposed = false;

  private constructor(channel: Channel, module: WebAssembly.Module, toThread: boolean, options: PlaceOptions, base: string, manifest: PlaceManifest, created: Created) {
    super();
    this.#channel = channel;
    this.#module = module;
    this.#toThread = toThread;
    this.#options = options;
    this.#base = base;
    this.manifest = manifest;
    this.#rooms = new Map(manifest.rooms.map((room) => [room.id, room]));
    this.build = created.build;
    this.buildReason = created.buildReason;
  }

  /** Loads the engine, the extractor, the manifest and its index, and no scene yet. */
  static async create(options: PlaceOptions): Promise<Place> {
    checkOptions("create", options, create);
    if (options.place === undefined) throw new LandlineError("bad-input", "create() needs { place }", "Pass the address of a .place.json file.");
    const { signal, onProgress, fetch, cache, wasm, build, stallTimeoutMs } = options;
    signal?.throwIfAborted();
    // When one of them fails the others are of no use any more.
    const stop = new AbortController();
    const forward = (): void => stop.abort(signal?.reason);
    signal?.addEventListener("abort", forward, { once: true });
    const common = { onProgress, cache, fetch, stallTimeoutMs, signal: stop.signal };
    const base = addressOf(options.place);
    const loadPlace = async (): Promise<{ text: string; manifest: PlaceManifest; file: Loaded; index: Loaded }> => {
      const file = await load(options.place, { ...common, file: "place" });
      const text = new TextDecoder().decode(file.bytes);
      const manifest = parseManifest(text, base);
      const index = await load(addressBeside(base, manifest.index.url), { ...common, file: "index", integrity: manifest.index.sha256 });
      return { text, manifest, file, index };
    };
    const loadExtractor = (): Promise<Loaded> => load(options.extractor ?? packagedExtractorUrl(), { ...common, file: "extractor" });
    try {
      let [engine, extractor, { text, manifest, file, index }] = await Promise.all([loadEngine({ wasm, build, onProgress, fetch, stallTimeoutMs, signal: stop.signal }), loadExtractor(), loadPlace()]).catch((error: unknown) => {
        stop.abort(error);
        throw error;
      });
      onProgress?.({ status: "prepare" });
      const useWorker = options.worker ?? !isNode();
      const channel = useWorker ? workerChannel(options.workerUrl) : directChannel();
      const abort = (): void => channel.close();
      signal?.addEventListener("abort", abort, { once: true });
      const prepare = (again: boolean): Promise<Created> => {
        const bytes = again ? extractor.bytes.slice() : extractor.bytes;
        return channel.call("create", { ...engine, extractor: bytes, manifest: text, index: index.bytes, maxBytes: options.maxBytes ?? 0, options: liveOptions(options) }, useWorker ? [bytes.buffer as ArrayBuffer] : []);
      };
      try {
        let created: Created;
        try {
          created = await prepare(extractor.fromCache);
        } catch (error) {
          if (!(error instanceof LandlineError && error.code === "extractor-corrupt" && extractor.fromCache)) throw error;
          // One that was kept before it could be checked: once more, from its server.
          await extractor.drop();
          extractor = await loadExtractor();
          created = await prepare(false);
        }
        signal?.throwIfAborted();
        await Promise.all([extractor.keep(), index.keep(), file.keep()]);
        onProgress?.({ status: "ready", backend: "cpu", backendReason: onCpu, ...created });
        return new Place(channel, engine.module, useWorker, options, base, manifest, created);
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

  /** The room that the camera was in last. */
  get room(): PlaceRoom | undefined {
    return this.#room;
  }

  /** True while no frame is under way: the moment to hand in the newest one. */
  get idle(): boolean {
    return this.#inFlight === 0 && !this.#disposed;
  }

  /**
   * Finds the camera of one frame, in whatever room; scenes that are needed for that are loaded first. Frames are answered in
   * the order of the calls; an aborted one rejects at once.
   */
  async locate(source: FrameSource, options: PlaceLocateOptions = {}): Promise<PlaceResult> {
    this.#check();
    checkOptions("locate", options, locateInPlace);
    options.signal?.throwIfAborted();
    this.#inFlight += 1;
    const calledAt = performance.timeOrigin + performance.now();
    const ready = prepareFrame(source, options.transfer ?? false, this.#toThread);
    ready.catch(() => undefined); // told in its turn
    const ask = async (): Promise<Answer> => {
      const { frame, exif, transfer } = await ready;
      try {
        this.#check();
        options.signal?.throwIfAborted();
        return await this.#channel.call(
          "locate",
          {
            frame,
            ...intrinsicsOf(frame, options, exif),
            timestampMs: options.timestamp ?? calledAt,
            include: options.include ?? [],
            camera: options.camera ?? "",
            tracking: options.tracking ?? false,
            gravity: gravityOf(options.gravity),
            calledAt,
          },
          transfer,
        );
      } catch (error) {
        if (!("data" in frame)) frame.close();
        throw error;
      }
    };
    // The engine remembers one frame: the next must wait until this one has its scenes.
    const answered = this.#queue.then(async () => this.#completed(await ask())).finally(() => (this.#inFlight -= 1));
    this.#queue = answered.catch(() => undefined);
    return this.#publish(await unless(options.signal, answered));
  }

  /** Loads a room's scene before it is needed, by its id; false when it cannot be had, which `refused` tells. */
  async load(room: string): Promise<boolean> {
    this.#check();
    if (!this.#rooms.has(room)) throw new LandlineError("bad-input", `there is no room ${JSON.stringify(room)} in this place`);
    return this.#bring(room);
  }

  /** Follows one camera on the caller's thread, with the engine that was loaded already; `follow` asks for it. */
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

  /** Takes over the focal length that an earlier session learned of a camera, as `Relocalizer.recallCamera` does. */
  async recallCamera(camera: string, focalPerWidth: number): Promise<void> {
    this.#check();
    checkRecall(camera, focalPerWidth);
    await this.#channel.call("recallCamera", { camera, focalPerWidth });
  }

  /** Calls a listener with what an event tells; the answer takes it away again. */
  on<K extends keyof PlaceEvents>(type: K, listener: (detail: PlaceEvents[K]["detail"]) => void): () => void {
    const call = (event: Event): void => listener((event as PlaceEvents[K]).detail);
    this.addEventListener(type, call);
    return () => this.removeEventListener(type, call);
  }

  /** Forgets which room the camera is in: the next frame is located from nothing. Scenes at hand stay. */
  async reset(): Promise<void> {
    this.#check();
    await this.#channel.call("reset", null);
    this.#room = undefined;
  }

  /** Bytes that the engine holds, and how many of them are scenes. */
  async memory(): Promise<PlaceMemory> {
    this.#check();
    return this.#channel.call("memory", null);
  }

  /** Ends the worker and frees everything. Frames under way reject with `disposed`. Calling it twice is fine. */
  async dispose(): Promise<void> {
    if (this.#disposed) return;
    this.#disposed = true;
    this.#stop.abort(disposed());
    this.#channel.close();
  }

  async [Symbol.asyncDispose](): Promise<void> {
    await this.dispose();
  }

  #check(): void {
    if (this.#disposed) throw disposed();
  }

  /** An answer with the scenes that it wants, as far as they can be had. One room may rule out others, and these want others. */
  async #completed(first: Answer): Promise<Answer> {
    let answer = first;
    while (answer.rooms.wanted.length > 0) {
      const come = await Promise.all(answer.rooms.wanted.map((id) => this.#bring(id)));
      this.#check();
      if (!come.includes(true)) break;
      const next = await this.#channel.call("resume", null);
      next.rooms.hasEntered ||= answer.rooms.hasEntered;
      answer = next;
    }
    return answer;
  }

  #publish({ result: located, rooms }: Answer): PlaceResult {
    const room = rooms.room === null ? undefined : this.#rooms.get(rooms.room);
    const result: PlaceResult = {
      ...located,
      ...(room ? { room } : {}),
      ...(rooms.rivals ? { rivals: rooms.rivals } : {}),
      ...(!located.located && rooms.wanted.length > 0 ? { missing: rooms.wanted } : {}),
      ...(rooms.cameraFromPlace ? { placementInPlace: placementFrom(Float64Array.from(rooms.cameraFromPlace)) } : {}),
    };
    if (rooms.hasEntered && room) {
      this.#room = room;
      this.dispatchEvent(new CustomEvent("room", { detail: { room, result } }));
      if (this.#options.prefetch !== false) for (const id of rooms.prefetch) void this.#bring(id).catch(() => undefined);
    }
    this.dispatchEvent(new CustomEvent("result", { detail: result }));
    return result;
  }

  /** Loads a room's scene into the engine; false when it cannot be had, which `refused` tells. */
  #bring(id: string): Promise<boolean> {
    const under = this.#coming.get(id);
    if (under) return under;
    const room = this.#rooms.get(id);
    if (!room || performance.now() - (this.#refusedAt.get(id) ?? Number.NEGATIVE_INFINITY) < retryMs) return Promise.resolve(false);
    const work = this.#load(room).finally(() => this.#coming.delete(id));
    this.#coming.set(id, work);
    return work;
  }

  async #load(room: PlaceRoom): Promise<boolean> {
    const { id, scene } = room;
    const { onProgress, cache, fetch, stallTimeoutMs } = this.#options;
    try {
      const { bytes, keep } = await load(addressBeside(this.#base, scene.url), { file: "scene", integrity: scene.sha256, onProgress, cache, fetch, stallTimeoutMs, signal: this.#stop.signal });
      await this.#channel.call("putRoom", { id, scene: bytes }, this.#toThread ? [bytes.buffer as ArrayBuffer] : []);
      await keep();
      this.#refusedAt.delete(id);
      return true;
    } catch (thrown) {
      this.#check();
      const error = thrown instanceof LandlineError ? thrown : new LandlineError("asset-fetch", `the scene of room ${JSON.stringify(id)}: ${String(thrown)}`, "", thrown);
      // A broken engine is nobody's scene.
      if (error.code === "engine-defect") throw error;
      this.#refusedAt.set(id, performance.now());
      this.dispatchEvent(new CustomEvent("refused", { detail: { room, error } }));
      return false;
    }
  }
}
