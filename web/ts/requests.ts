/** What callers pass with a frame, as the engine takes it. */
import { LandlineError } from "./errors.js";
import { intrinsicsForFrame, sizeOf } from "./frames.js";
import type { LocateRequest, WireFrame } from "./protocol.js";
import type { Intrinsics, LiveOptions, LocateOptions } from "./types.js";

/** As the engine takes it. */
export function gravityOf(gravity: LocateOptions["gravity"]): number[] {
  if (!gravity) return [];
  const { x, y, z, sigmaRad = 0.035 } = gravity;
  if (!(Math.hypot(x, y, z) > 1e-6) || !(sigmaRad > 0) || ![x, y, z, sigmaRad].every(Number.isFinite)) {
    throw new LandlineError("bad-input", `gravity is (${x}, ${y}, ${z}) with a deviation of ${sigmaRad}`, "Pass a direction in camera axes and a positive deviation in radians.");
  }
  return [x, y, z, sigmaRad];
}

/** Intrinsics for the frame at hand: those passed, else those of its EXIF block, else none. */
export function intrinsicsOf(frame: WireFrame, options: LocateOptions, exif: Intrinsics | undefined): Pick<LocateRequest, "intrinsics" | "intrinsicsSource"> {
  const given = options.intrinsics ?? exif;
  if (!given) return { intrinsicsSource: "given" };
  const { width, height } = sizeOf(frame);
  const intrinsicsSource = options.intrinsics ? (options.intrinsicsSource ?? "given") : "exif";
  return { intrinsics: intrinsicsForFrame(given, width, height), intrinsicsSource };
}

/** The live options among others, without those that are not set. */
export function liveOptions(options: LiveOptions): LiveOptions {
  const live: LiveOptions = {};
  const copy = <K extends keyof LiveOptions>(key: K): void => {
    if (options[key] !== undefined) live[key] = options[key];
  };
  (["smoothing", "maxSide", "timeBudgetMs", "seed", "maxPointErrorPx", "maxLineErrorPx"] as const).forEach(copy);
  return live;
}
