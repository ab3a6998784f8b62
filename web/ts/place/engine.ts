/** The engine's side of a place: owns the wasm instance. Runs in a worker or on the caller's thread. */
import { decodeResult } from "../decode.js";
import { includeBits, runningBuild, sourceCode } from "../engine.js";
import { asLandlineError, LandlineError } from "../errors.js";
import { PixelReader } from "../pixels.js";
import { instantiate, RawPlace } from "../raw.js";
import type { Answer, CallName, Calls, Created, CreateRequest, RawRooms } from "./protocol.js";

export const disposed = (): LandlineError => new LandlineError("disposed", "this place was disposed of", "Create a new place.");

type Located = Calls["locate"]["request"];

export class PlaceEngine {
  readonly #pixels = new PixelReader();
  #raw: RawPlace | undefined;
  #memory: WebAssembly.Memory | undefined;
  #created: Created = { build: "plain", buildReason: "" };
  #broken: LandlineError | undefined;
  /** The frame that was located last. */
  #last: { request: Located; transferMs: number } | undefined;

  /** Answers one call. Calls have to be awaited one after another. */
  async perform<N extends CallName>(name: N, request: Calls[N]["request"]): Promise<Calls[N]["reply"]> {
    // A message from another thread may name anything.
    if (!Object.hasOwn(this.#handlers, name)) throw new LandlineError("bad-input", `unknown call ${String(name)}`);
    try {
      return await this.#handlers[name](request);
    } catch (error) {
      const landline = asLandlineError(error);
      if (landline.code === "engine-defect") this.#broken = landline;
      throw landline;
    }
  }

  readonly #handlers: { readonly [N in CallName]: (request: Calls[N]["request"]) => Calls[N]["reply"] | Promise<Calls[N]["reply"]> } = {
    create: (request) => this.#create(request),
    locate: (request) => this.#locate(request),
    resume: () => {
      const last = this.#last;
      if (!last) throw new LandlineError("bad-input", "no frame was located before");
      return this.#answer(this.#alive().resume(includeBits(last.request.include)), last);
    },
    putRoom: ({ id, scene }) => {
      this.#alive().putRoom(id, scene);
      return null;
    },
    setOptions: (options) => {
      this.#alive().setOptions(JSON.stringify(options));
      return null;
    },
    recallCamera: ({ camera, focalPerWidth }) => {
      this.#alive().recallCamera(camera, focalPerWidth);
      return null;
    },
    reset: () => {
      this.#alive().reset();
      return null;
    },
    memory: () => ({ wasmBytes: this.#memory?.buffer.byteLength ?? 0, sceneBytes: this.#alive().heldBytes() }),
    dispose: () => {
      const raw = this.#raw;
      this.#raw = undefined;
      // An instance that panicked may hold its own borrow for ever.
      if (!this.#broken) raw?.free();
      return null;
    },
  };

  async #create(request: CreateRequest): Promise<Created> {
    const { extractor, manifest, index, maxBytes, options } = request;
    this.#memory = await instantiate(request.module);
    this.#raw = RawPlace.create(extractor, manifest, index, maxBytes, JSON.stringify(options));
    this.#created = runningBuild(request);
    return this.#created;
  }

  #locate(request: Located): Answer {
    const { frame } = request;
    try {
      const raw = this.#alive();
      const include = includeBits(request.include);
      const pixels = this.#pixels.write(frame, raw, this.#memory as WebAssembly.Memory);
      const k = request.intrinsics;
      const last = { request, transferMs: performance.timeOrigin + performance.now() - request.calledAt };
      this.#last = undefined;
      const rooms = raw.locate(
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
        include,
      );
      this.#last = last;
      return this.#answer(rooms, last);
    } finally {
      if (!("data" in frame)) frame.close();
    }
  }

  #answer(text: string, { request, transferMs }: { request: Located; transferMs: number }): Answer {
    const raw = this.#alive();
    const rooms = JSON.parse(text) as RawRooms;
    const numbers = new Float64Array((this.#memory as WebAssembly.Memory).buffer, raw.resultAddress(), raw.resultLength());
    const { timestampMs, include } = request;
    return { rooms, result: decodeResult(numbers, { timestampMs, transferMs, include, backendReason: onCpu, units: rooms.units, ...this.#created }) };
  }

  #alive(): RawPlace {
    if (this.#broken) throw this.#broken;
    if (!this.#raw) throw disposed();
    return this.#raw;
  }
}

/** Why not something faster. */
export const onCpu = "places run on the CPU";
