/** Reads the flat numbers that the engine writes. The layout is defined in web/src/result.rs. */
import { LandlineError } from "./errors.js";
import { placementFrom } from "./placement.js";
import type { Backend, Build, Include, IntrinsicsSource, LimitedReason, LocateResult, NotLocatedReason, ResultCommon, TrackingState, Units } from "./types.js";

/** Must equal `LAYOUT_VERSION` in web/src/result.rs. */
const layoutVersion = 2;
const headerLength = 102;

const reasons: readonly NotLocatedReason[] = ["few-features", "few-correspondences", "few-inliers", "degenerate", "ambiguous", "timeout", "other-place", "mirrored", "focal-mismatch", "turned"];
const states: readonly TrackingState[] = ["searching", "tracking", "limited"];
const limits: readonly LimitedReason[] = ["lost", "jump", "focal-uncertain"];
const sources: readonly IntrinsicsSource[] = ["given", "track", "exif", "remembered", "estimated", "assumed", "scene"];
const backends: readonly Backend[] = ["cpu", "webgpu"];

interface Context {
  timestampMs: number;
  transferMs: number;
  include: readonly Include[];
  backendReason: string;
  build: Build;
  buildReason: string;
  units: Units;
}

function named<T>(list: readonly T[], code: number, what: string): T {
  const value = list[code];
  if (value === undefined) throw new LandlineError("engine-defect", `the engine answered with ${what} ${code}, which does not exist`);
  return value;
}

/** Copies everything out: the numbers lie in the engine's memory and are overwritten by the next frame. */
export function decodeResult(n: Float64Array, context: Context): LocateResult {
  const at = (i: number): number => {
    const value = n[i];
    if (value === undefined) throw new LandlineError("engine-defect", `the engine's answer ends at ${n.length}, before ${i}`);
    return value;
  };
  if (at(0) !== layoutVersion) {
    throw new LandlineError("engine-version", `the engine speaks layout ${at(0)}, this script layout ${layoutVersion}`);
  }
  const result: ResultCommon = {
    units: context.units,
    frame: { width: at(41), height: at(42) },
    timestampMs: context.timestampMs,
    intrinsics: { fx: at(37), fy: at(38), cx: at(39), cy: at(40), width: at(41), height: at(42), source: named(sources, at(43), "intrinsics source") },
    quality: {
      keypoints: at(45),
      segments: at(46),
      pointCorrespondences: at(47),
      lineCorrespondences: at(48),
      pointInliers: at(49),
      lineInliers: at(50),
      medianErrorPx: at(51),
      confidence: at(52),
    },
    state: named(states, at(3), "state"),
    timingsMs: {
      transfer: context.transferMs,
      preprocess: at(90),
      features: at(91),
      lines: at(92),
      regress: at(93),
      solve: at(94),
      total: context.transferMs + at(95),
    },
    backend: named(backends, at(96), "backend"),
    backendReason: context.backendReason,
    build: context.build,
    buildReason: context.buildReason,
  };
  if (result.state === "limited") result.limited = named(limits, at(4), "limited reason");
  if (!Number.isNaN(at(44))) result.intrinsics.relativeSigma = at(44);
  const located = at(1) === 1;
  if (located) {
    if (at(53) === 1) {
      const covariance = n.slice(54, 90);
      result.quality.covariance = covariance;
      const trace = (from: number): number => [0, 1, 2].reduce((sum, i) => sum + (covariance[7 * (from + i)] as number), 0);
      result.quality.sigmaRotationRad = Math.sqrt(trace(0));
      result.quality.sigmaPosition = Math.sqrt(trace(3));
    }
  }
  let from = headerLength;
  const numPoints = at(97);
  const numLines = at(98);
  const numSegments = at(99);
  if (context.include.includes("points")) {
    const points = { pixels: new Float32Array(2 * numPoints), world: new Float32Array(3 * numPoints), confidence: new Float32Array(numPoints), isInlier: new Uint8Array(numPoints) };
    for (let i = 0; i < numPoints; i++, from += 7) {
      points.pixels.set(n.subarray(from, from + 2), 2 * i);
      points.world.set(n.subarray(from + 2, from + 5), 3 * i);
      points.confidence[i] = at(from + 5);
      points.isInlier[i] = at(from + 6);
    }
    result.points = points;
  }
  if (context.include.includes("lines")) {
    const lines = { pixels: new Float32Array(4 * numLines), world: new Float32Array(6 * numLines), confidence: new Float32Array(numLines), isInlier: new Uint8Array(numLines) };
    for (let i = 0; i < numLines; i++, from += 12) {
      lines.pixels.set(n.subarray(from, from + 4), 4 * i);
      lines.world.set(n.subarray(from + 4, from + 10), 6 * i);
      lines.confidence[i] = at(from + 10);
      lines.isInlier[i] = at(from + 11);
    }
    result.lines = lines;
  }
  if (context.include.includes("segments")) result.segments = Float32Array.from(n.subarray(from, from + 4 * numSegments));
  if (!located) {
    const reason = named(reasons, at(2), "reason");
    return { ...result, located, reason, ...(reason === "turned" ? { turnClockwiseDeg: at(101) as 90 | 180 | 270 } : {}) };
  }
  const unsmoothed = Number.isNaN(at(21)) ? {} : { unsmoothed: placementFrom(n.slice(21, 37)) };
  const warning = at(100) === 1 ? { warning: "focal-mismatch" as const } : {};
  return { ...result, located, placement: placementFrom(n.slice(5, 21)), ...unsmoothed, ...warning };
}
