/** A pose for every frame, from answers of a relocalizer that come late and seldom. No page, no video: the same under Node. */
import { asLandlineError, LandlineError } from "./errors.js";
import { loadEngine } from "./init.js";
import { placementFrom } from "./placement.js";
import { instantiate, RawFollower } from "./raw.js";
import type { CreateOptions, LocateResult, Placement } from "./types.js";

/** Must equal `LAYOUT_VERSION` in web/src/follow.rs. */
const layoutVersion = 1;

export type FollowState = "searching" | "tracking" | "limited";

/** Why following is limited. */
export type FollowLimit =
  /** The camera moves too fast. */
  | "excessive-motion"
  /** Too little to see, or something is in front of the camera. */
  | "insufficient-features"
  /** What was to be seen has left the picture. */
  | "out-of-view"
  /** Lost; an answer of the relocalizer is waited for. */
  | "relocalizing"
  /** The last answer is far from the tracked position; the next one has to confirm it. */
  | "jump"
  /** No answer for a while: the position may have drifted. */
  | "unconfirmed"
  /** The camera gives the same picture again and again. */
  | "frozen"
  /** The time of the frame is not after that of the one before. */
  | "clock"
  /** The size of the picture has changed. */
  | "resized";

/** Why a frame could not be tracked. */
export type TrackLoss = "no-reference" | "no-frame" | "resized" | "out-of-view" | "few-found" | "disagreement";

const states: readonly FollowState[] = ["searching", "tracking", "limited"];
const limits: readonly FollowLimit[] = ["excessive-motion", "insufficient-features", "out-of-view", "relocalizing", "jump", "unconfirmed", "frozen", "clock", "resized"];
const losses: readonly TrackLoss[] = ["no-reference", "no-frame", "resized", "out-of-view", "few-found", "disagreement"];

/** What an answer since the frame before has changed. */
export interface Correction {
  /** How far the picture of the world moves for it, root mean square in pixels of the frame. */
  distancePx: number;
  /** Whether it is made at once, in place of fading in. */
  isJump: boolean;
}

interface TrackedCommon {
  /** Number of the frame, counted from 0. */
  index: number;
  timestampMs: number;
  state: FollowState;
  /** Present when the state is `limited`. */
  limited?: FollowLimit;
  correction?: Correction;
}

/** A frame with a position. */
export interface TrackedFrame extends TrackedCommon {
  located: true;
  /** `localization` in the very frame that the relocalizer answered for, `tracking` in all others. */
  by: "localization" | "tracking";
  /** For display: corrections fade in. */
  placement: Placement;
  /** What is believed, without fading. */
  believed: Placement;
  /** 6x6 row-major: rotation (rad, camera axes) then translation (scene units); of `believed`. */
  covariance: Float64Array;
  /** Frames and milliseconds since the one that was localised last. */
  age: { frames: number; ms: number };
  /** Looked for, found, agreeing. */
  points: [number, number, number];
  lines: [number, number, number];
  medianErrorPx: number;
}

/** A frame without one. */
export interface LostFrame extends TrackedCommon {
  located: false;
  /** Why the tracker found nothing; absent while there is nothing to track yet. */
  loss?: TrackLoss;
}

export type FollowerResult = TrackedFrame | LostFrame;

export interface FollowerOptions {
  /** Milliseconds over which a correction fades in; 150 by default. */
  blendMs?: number;
}

/** Pixels in memory, four bytes each. */
export interface RgbaFrame {
  data: Uint8Array | Uint8ClampedArray;
  width: number;
  height: number;
}

/** What became of an answer: followed, waiting for the next one to confirm it, or why it is of no use. */
export type AnswerUse = "followed" | "unconfirmed" | TrackLoss;

/** Turn of the camera since the frame before, row by row (camera now from camera before, OpenCV axes). */
export type Turn = readonly number[] | Float64Array;

/**
 * Follows one camera. Hand in every frame with `track`, and for some of them what `locate` found, however late, with
 * `localized`. `follow` does both for a playing video.
 */
export class Follower {
  #raw: RawFollower | undefined;
  readonly #memory: WebAssembly.Memory;

  private constructor(raw: RawFollower, memory: WebAssembly.Memory) {
    this.#raw = raw;
    this.#memory = memory;
  }

  /** Makes one on this thread. The engine is compiled once for a page and its workers' scripts alike. */
  static async create(options: FollowerOptions & Pick<CreateOptions, "wasm" | "fetch" | "signal"> = {}): Promise<Follower> {
    const { wasm, fetch, signal, blendMs = 150 } = options;
    const memory = await instantiate((await loadEngine({ wasm, fetch, signal })).module);
    try {
      return new Follower(new RawFollower(blendMs), memory);
    } catch (error) {
      throw asLandlineError(error);
    }
  }

  /** Takes the next frame. A frame that cannot be tracked is a result, not an error. */
  track(frame: RgbaFrame, timestampMs: number, turned?: Turn): FollowerResult {
    const raw = this.#alive();
    const { data, width, height } = frame;
    if (data.length !== 4 * width * height) {
      throw new LandlineError("bad-input", `the frame has ${data.length} bytes; ${width} x ${height} pixels of four need ${4 * width * height}`);
    }
    try {
      const at = raw.frameBuffer(data.length);
      new Uint8Array(this.#memory.buffer, at, data.length).set(data);
      raw.track(width, height, timestampMs, Float64Array.from(turned ?? []));
      return decode(new Float64Array(this.#memory.buffer, raw.resultAddress(), raw.resultLength()), timestampMs);
    } catch (error) {
      throw asLandlineError(error);
    }
  }

  /** Keeps a frame's picture, because it goes to the relocalizer. False when it is gone already. */
  hold(index: number): boolean {
    return this.#alive().hold(index);
  }

  /**
   * Takes what the relocalizer found in a frame; it needs `include: ["points", "lines"]`. `width` and `height` are those of the
   * tracked frame, when another size was located.
   */
  localized(index: number, result: LocateResult, width = result.frame.width, height = result.frame.height): AnswerUse {
    const raw = this.#alive();
    if (!result.located || !result.placement) {
      raw.notLocated(index);
      return "no-reference";
    }
    if (!result.points || !result.lines) {
      throw new LandlineError("bad-input", "the result carries no points and lines to follow", 'Call locate with include: ["points", "lines"].');
    }
    const scale = [width / result.frame.width, height / result.frame.height] as const;
    const { fx, fy, cx, cy } = result.intrinsics;
    const points = agreeing(result.points, 2, 3, scale);
    const lines = agreeing(result.lines, 4, 6, scale);
    const { unsmoothed, placement, quality } = result;
    try {
      const code = raw.localized(
        index,
        Float64Array.of(width, height, fx * scale[0], fy * scale[1], cx * scale[0], cy * scale[1]),
        (unsmoothed ?? placement).cameraFromWorld,
        quality.covariance ?? new Float64Array(0),
        points.pixels,
        points.world,
        lines.pixels,
        lines.world,
      );
      return code === 0 ? "followed" : code === 1 ? "unconfirmed" : (losses[code - 2] ?? "disagreement");
    } catch (error) {
      throw asLandlineError(error);
    }
  }

  /** `cameraFromWorld` near that of the newest frame, for `prior` of `locate`. */
  prior(): Float64Array | undefined {
    const prior = this.#alive().prior();
    return prior.length === 16 ? prior : undefined;
  }

  /** Forgets where the camera was, as for another scene. */
  reset(): void {
    this.#alive().reset();
  }

  dispose(): void {
    const raw = this.#raw;
    this.#raw = undefined;
    raw?.free();
  }

  #alive(): RawFollower {
    if (!this.#raw) throw new LandlineError("disposed", "this follower was disposed of");
    return this.#raw;
  }
}

interface Agreeing {
  pixels: Float32Array;
  world: Float32Array;
  isInlier: Uint8Array;
}

/** What agrees with the pose, its pixels scaled. */
function agreeing(all: Agreeing, perPixel: number, perWorld: number, scale: readonly [number, number]): Agreeing {
  const num = all.isInlier.reduce((sum, is) => sum + is, 0);
  const out = { pixels: new Float32Array(num * perPixel), world: new Float32Array(num * perWorld), isInlier: all.isInlier };
  let to = 0;
  all.isInlier.forEach((is, from) => {
    if (!is) return;
    for (let k = 0; k < perPixel; k++) out.pixels[to * perPixel + k] = (all.pixels[from * perPixel + k] as number) * (scale[k % 2] as number);
    out.world.set(all.world.subarray(from * perWorld, (from + 1) * perWorld), to * perWorld);
    to += 1;
  });
  return out;
}

/** Copies a report out of the engine's memory. The layout is defined in web/src/follow.rs. */
function decode(n: Float64Array, timestampMs: number): FollowerResult {
  const at = (i: number): number => n[i] as number;
  if (at(0) !== layoutVersion) {
    throw new LandlineError("engine-version", `the engine speaks follow layout ${at(0)}, this script ${layoutVersion}`);
  }
  const state = states[at(2)] ?? "searching";
  const limit = state === "limited" ? limits[at(3)] : undefined;
  const common: TrackedCommon = {
    index: at(1),
    timestampMs,
    state,
    ...(limit ? { limited: limit } : {}),
    ...(Number.isNaN(at(5)) ? {} : { correction: { distancePx: at(5), isJump: at(6) === 1 } }),
  };
  if (at(7) !== 1) {
    const loss = losses[at(4)];
    return { ...common, located: false, ...(loss ? { loss } : {}) };
  }
  return {
    ...common,
    located: true,
    by: at(76) === 1 ? "localization" : "tracking",
    placement: placementFrom(n.slice(8, 24)),
    believed: placementFrom(n.slice(24, 40)),
    covariance: n.slice(40, 76),
    age: { frames: at(77), ms: at(78) },
    points: [at(79), at(80), at(81)],
    lines: [at(82), at(83), at(84)],
    medianErrorPx: at(85),
  };
}
