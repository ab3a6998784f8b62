/** The mapper's side of the calls: owns the wasm instance. Runs in a worker or on the caller's thread. */
import { asLandlineError, LandlineError } from "../errors.js";
import { PixelReader } from "../pixels.js";
import type { MemoryUse } from "../protocol.js";
import type { AddRequest, CallName, Calls, CreateRequest, PosesRequest, RawReport, SceneRequest, StageEvent, Written } from "./protocol.js";
import { instantiate, RawMapper, readPoses } from "./raw.js";
import type { FrameVerdict, KnownPoses, MapStage } from "./types.js";

export const disposed = (): LandlineError => new LandlineError("disposed", "this mapper was disposed of", "Create a new mapper.");

/** Other work of the thread gets its turn after so many milliseconds. */
const turnMs = 30;

/** Lets the thread take its messages, once in a while. */
function turns(): () => Promise<void> | undefined {
  let last = performance.now();
  return () => {
    if (performance.now() - last < turnMs) return undefined;
    return new Promise((done) =>
      setTimeout(() => {
        last = performance.now();
        done();
      }, 0),
    );
  };
}

export class MapperEngine {
  readonly #tell: (event: StageEvent) => void;
  readonly #pixels = new PixelReader();
  #raw: RawMapper | undefined;
  #memory: WebAssembly.Memory | undefined;
  #broken: LandlineError | undefined;
  #isCancelled = false;
  #isWorking = false;

  /** `tell` hears of every step of `build` and `write`. */
  constructor(tell: (event: StageEvent) => void) {
    this.#tell = tell;
  }

  /** Answers one call. Calls have to be awaited one after another, but for `cancel`. */
  async perform<N extends CallName>(name: N, request: Calls[N]["request"]): Promise<Calls[N]["reply"]> {
    // A message from another thread may name anything.
    if (!Object.hasOwn(this.#handlers, name)) throw new LandlineError("bad-input", `unknown call ${String(name)}`);
    try {
      return await this.#handlers[name](request);
    } catch (error) {
      throw this.#note(error);
    }
  }

  readonly #handlers: { readonly [N in CallName]: (request: Calls[N]["request"]) => Calls[N]["reply"] | Promise<Calls[N]["reply"]> } = {
    create: (request) => this.#create(request),
    add: (request) => this.#add(request),
    build: () => this.#work((raw, tell, pause) => raw.build(tell, pause)).then(() => null),
    write: (request) => this.#write(request),
    labels: () => this.#alive().labels(),
    clear: () => {
      this.#alive().clear();
      return null;
    },
    cancel: () => {
      this.#isCancelled = this.#isWorking;
      return null;
    },
    poses: (request) => this.#poses(request),
    memory: (): MemoryUse => ({ wasmBytes: this.#memory?.buffer.byteLength ?? 0 }),
    dispose: () => {
      const raw = this.#raw;
      this.#raw = undefined;
      if (!this.#broken) raw?.free();
      return null;
    },
  };

  async #create(request: CreateRequest): Promise<null> {
    this.#memory = await instantiate(request.module);
    this.#raw = RawMapper.create(request.extractor, JSON.stringify(request.options));
    return null;
  }

  async #poses({ module, pictures, files }: PosesRequest): Promise<KnownPoses> {
    this.#memory = await instantiate(module);
    const bytes = new Uint8Array(files.reduce((sum, file) => sum + file.bytes.length, 0));
    let at = 0;
    for (const file of files) {
      bytes.set(file.bytes, at);
      at += file.bytes.length;
    }
    const heads = files.map((file) => ({ path: file.path, len: file.bytes.length }));
    const { source, notes, poses } = JSON.parse(readPoses(JSON.stringify({ pictures, files: heads }), bytes)) as KnownPoses;
    return { source, notes, poses: poses.map((pose) => pose && { ...pose, cameraFromWorld: Float64Array.from(pose.cameraFromWorld) }) };
  }

  #add({ frame, intrinsics, areExact, pose, gravity, name, keep }: AddRequest): FrameVerdict {
    try {
      const raw = this.#alive();
      const { width, height, stride, format } = this.#pixels.write(frame, raw, this.#memory as WebAssembly.Memory);
      return JSON.parse(raw.addFrame(width, height, stride, format, Float64Array.from(intrinsics), areExact, Float64Array.from(pose), Float64Array.from(gravity), name, keep)) as FrameVerdict;
    } finally {
      if (!("data" in frame)) frame.close();
    }
  }

  async #write(request: SceneRequest): Promise<Written> {
    const scene = await this.#work((raw, tell, pause) => raw.write(JSON.stringify(request), tell, pause));
    const raw = this.#alive();
    return { scene, report: JSON.parse(raw.report()) as RawReport, poses: raw.poses(), points: raw.points(), lines: raw.lines() };
  }

  async #work<T>(run: (raw: RawMapper, tell: (stage: MapStage, done: number, total: number) => boolean, pause: () => Promise<void> | undefined) => Promise<T>): Promise<T> {
    const raw = this.#alive();
    this.#isCancelled = false;
    this.#isWorking = true;
    const tell = (stage: MapStage, done: number, total: number): boolean => {
      if (!this.#isCancelled) this.#tell({ stage, done, total });
      return this.#isCancelled;
    };
    try {
      return await run(raw, tell, turns());
    } finally {
      this.#isWorking = false;
    }
  }

  #alive(): RawMapper {
    if (this.#broken) throw this.#broken;
    if (!this.#raw) throw disposed();
    return this.#raw;
  }

  #note(error: unknown): LandlineError {
    let landline = asLandlineError(error);
    if (landline.code === "engine-defect" && error instanceof WebAssembly.RuntimeError && !this.#canGrow()) {
      // Rust ends where it gets no memory; all that tells is that there is none.
      landline = new LandlineError("out-of-memory", "the map needs more memory than this device gives", "Close other tabs, or make the map of fewer pictures.", error);
    }
    if (landline.code === "engine-defect" || landline.code === "out-of-memory") this.#broken = landline;
    return landline;
  }

  /** Whether there are 100 MiB more: the largest single piece of a map takes less. This instance is of no use any more. */
  #canGrow(): boolean {
    try {
      this.#memory?.grow(1600);
      return true;
    } catch {
      return false;
    }
  }
}
