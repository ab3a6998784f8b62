/** The engine's side: owns the wasm instance, feeds it pixels, reads its numbers. Runs in a worker or on the caller's thread. */
import { asLandlineError, LandlineError } from "./errors.js";
import { decodeResult } from "./decode.js";
import { PixelReader } from "./pixels.js";
import type { Created, CreateRequest, LocateRequest, MemoryUse } from "./protocol.js";
import { build, instantiate, RawRelocalizer } from "./raw.js";
import type { Build, Include, KnownIntrinsicsSource, LiveOptions, LocateResult, SceneInfo, Units } from "./types.js";

const includeBit: Record<Include, number> = { points: 1, lines: 2, segments: 4 };
export const sourceCode: Record<KnownIntrinsicsSource, number> = { given: 0, track: 1, exif: 2 };

export function includeBits(names: readonly Include[]): number {
  return names.reduce((bits, name) => {
    const bit: number | undefined = includeBit[name];
    if (bit === undefined) throw new LandlineError("bad-input", `include ${JSON.stringify(name)} is unknown`, "Use points, lines or segments.");
    return bits | bit;
  }, 0);
}

/** The build that this thread runs: it has one instance, whatever is asked for later. */
export function runningBuild(asked: Pick<CreateRequest, "build" | "buildReason">): Pick<Created, "build" | "buildReason"> {
  const running = build() as Build;
  return { build: running, buildReason: asked.build && asked.build !== running ? `this thread runs the ${running} build already` : asked.buildReason };
}

interface Begun {
  request: LocateRequest;
  transferMs: number;
  error?: LandlineError;
}

export class Engine {
  #raw: RawRelocalizer | undefined;
  readonly #memory: WebAssembly.Memory;
  readonly #units: Units;
  readonly #build: Pick<Created, "build" | "buildReason">;
  readonly #pixels = new PixelReader();
  #broken: LandlineError | undefined;
  /** A frame that was handed over before its turn. */
  #begun: Begun | undefined;

  private constructor(raw: RawRelocalizer, memory: WebAssembly.Memory, units: Units, build: Pick<Created, "build" | "buildReason">) {
    this.#raw = raw;
    this.#memory = memory;
    this.#units = units;
    this.#build = build;
  }

  static async create(request: CreateRequest): Promise<{ engine: Engine; created: Created }> {
    const memory = await instantiate(request.module);
    try {
      const raw = await RawRelocalizer.create(request.extractor, request.scene, request.device, JSON.stringify(request.options));
      const scene = JSON.parse(raw.sceneInfo()) as SceneInfo;
      const built = runningBuild(request);
      return {
        engine: new Engine(raw, memory, scene.units, built),
        created: { scene, backend: raw.backend() as Created["backend"], backendReason: raw.backendReason(), ...built },
      };
    } catch (error) {
      throw asLandlineError(error);
    }
  }

  /**
   * Finds the camera of a frame. `next` is asked once, before the pose is solved: the frame that it returns is begun then, so
   * that the GPU works on it meanwhile, and must be the next one to be located.
   */
  async locate(request: LocateRequest, next: () => LocateRequest | undefined = () => undefined): Promise<LocateResult> {
    const begun = this.#begun?.request === request ? this.#begun : await this.#begin(request);
    this.#begun = undefined;
    if (begun.error) throw begun.error;
    const raw = this.#alive();
    try {
      await raw.observe();
      // What is looked into later must still be the last frame.
      const following = raw.backend() === "webgpu" && !request.explain ? next() : undefined;
      if (following) this.#begun = await this.#begin(following);
      raw.solve(includeBits(request.include), request.explain);
      const numbers = new Float64Array(this.#memory.buffer, raw.resultAddress(), raw.resultLength());
      const { transferMs } = begun;
      return decodeResult(numbers, { timestampMs: request.timestampMs, transferMs, include: request.include, backendReason: raw.backendReason(), ...this.#build, units: this.#units });
    } catch (error) {
      throw this.#note(error);
    }
  }

  /** Hands the pixels over. What goes wrong is told when the frame's own turn comes. */
  async #begin(request: LocateRequest): Promise<Begun> {
    const { frame } = request;
    try {
      const raw = this.#alive();
      includeBits(request.include);
      const pixels = this.#pixels.write(frame, raw, this.#memory);
      const k = request.intrinsics;
      const transferMs = performance.timeOrigin + performance.now() - request.calledAt;
      await raw.begin(
        pixels.width,
        pixels.height,
        pixels.stride,
        pixels.format,
        k ? Float64Array.of(k.fx, k.fy, k.cx, k.cy) : new Float64Array(0),
        sourceCode[request.intrinsicsSource],
        request.timestampMs,
        request.camera,
        request.tracking,
        Float64Array.from(request.gravity),
        Float64Array.from(request.prior),
      );
      return { request, transferMs };
    } catch (error) {
      return { request, transferMs: 0, error: this.#note(error) };
    } finally {
      if (!("data" in frame)) frame.close();
    }
  }

  setOptions(options: LiveOptions): null {
    try {
      this.#alive().setOptions(JSON.stringify(options));
      return null;
    } catch (error) {
      throw this.#note(error);
    }
  }

  /** Takes over a focal length that was learned before. */
  recallCamera({ camera, focalPerWidth }: { camera: string; focalPerWidth: number }): null {
    try {
      this.#alive().recallCamera(camera, focalPerWidth);
      return null;
    } catch (error) {
      throw this.#note(error);
    }
  }

  /** Forgets the track: the next frame is located from nothing. */
  reset(): null {
    this.#alive().reset();
    return null;
  }

  memory(): MemoryUse {
    return { wasmBytes: this.#memory.buffer.byteLength };
  }

  dispose(): void {
    const raw = this.#raw;
    this.#raw = undefined;
    // An instance that panicked may hold its own borrow for ever; freeing it would throw, and it is lost anyway.
    if (!this.#broken) raw?.free();
  }

  #alive(): RawRelocalizer {
    if (this.#broken) throw this.#broken;
    if (!this.#raw) throw new LandlineError("disposed", "this relocalizer was disposed of");
    return this.#raw;
  }

  #note(error: unknown): LandlineError {
    const landline = asLandlineError(error);
    if (landline.code === "engine-defect") this.#broken = landline;
    return landline;
  }
}
