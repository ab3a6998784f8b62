/**
 * Joins a scene with a WebXR session: one localisation says where the scene lies in the session's space, the device's own
 * tracking does the rest. Optional entry `landline/webxr`.
 */
import { LandlineError, invertRigid, placementFrom, type Placement } from "../index.js";

/** What is needed of an `XRFrame`; the one of the picture that was located. */
interface FrameLike {
  getViewerPose(space: XRSpaceLike): { readonly transform: { readonly matrix: Float32Array } } | undefined;
}

/** What is needed of an `XRReferenceSpace`: nothing. */
type XRSpaceLike = object;

export interface Alignment {
  /** Scene to session space, column-major, metres: the matrix of a group that holds all content of the scene. */
  readonly sessionFromScene: Float32Array;
  /** Answers that went into it. */
  readonly count: number;
}

export interface AlignOptions {
  /** Metres for a unit of the scene; 1 by default. */
  metresPerUnit?: number;
  /** An earlier alignment that is refined: answers are averaged. */
  before?: Alignment;
  /** An answer further than this from the alignment before starts a new one, in metres; 0.5 by default. */
  maxShift?: number;
}

type Quaternion = [number, number, number, number];

/** Product of column-major 4x4 matrices. */
function multiply(a: ArrayLike<number>, b: ArrayLike<number>): Float64Array {
  return Float64Array.from({ length: 16 }, (_, i) => {
    const [column, row] = [i >> 2, i % 4];
    return [0, 1, 2, 3].reduce((sum, k) => sum + (a[4 * k + row] as number) * (b[4 * column + k] as number), 0);
  });
}

function transposed(m: ArrayLike<number>): Float64Array {
  return Float64Array.from({ length: 16 }, (_, i) => m[4 * (i % 4) + (i >> 2)] as number);
}

function quaternionOf(m: ArrayLike<number>): Quaternion {
  // A placement tells the turn of the inverse of what it is made of.
  const { w, x, y, z } = placementFrom(invertRigid(transposed(m))).rotation;
  return [w, x, y, z];
}

function matrixOf([w, x, y, z]: Quaternion, position: readonly [number, number, number]): Float64Array {
  // prettier-ignore
  return Float64Array.of(
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), 0,
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), 0,
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), 0,
    ...position, 1,
  );
}

/**
 * Where the scene lies in the session's space. `frame` must be the `XRFrame` of the picture that was located, `result` its
 * answer; the viewer of a phone is its camera. `undefined` while the device does not know its own pose.
 */
export function alignSession(frame: FrameLike, space: XRSpaceLike, result: { located: boolean; placement?: Placement }, options: AlignOptions = {}): Alignment | undefined {
  const { metresPerUnit = 1, before, maxShift = 0.5 } = options;
  if (!(metresPerUnit > 0)) throw new LandlineError("bad-input", `metresPerUnit is ${metresPerUnit}`, "Say how many metres a unit of the scene is.");
  if (!result.located || !result.placement) return before;
  const pose = frame.getViewerPose(space);
  if (!pose) return before;
  // three's axes are WebXR's. The camera's own place is in units of the scene.
  const cameraFromScene = Float64Array.from(result.placement.three.cameraFromWorld);
  for (const i of [12, 13, 14]) cameraFromScene[i] = (cameraFromScene[i] as number) * metresPerUnit;
  const rigid = multiply(pose.transform.matrix, cameraFromScene);
  let [turn, position] = [quaternionOf(rigid), [rigid[12], rigid[13], rigid[14]] as [number, number, number]];
  let count = 1;
  if (before) {
    const old = unscaled(before.sessionFromScene, metresPerUnit);
    // Compared at the camera: that is where a difference is seen, not at the scene's origin.
    const here = multiply(multiply(old, transposed(invertRigid(transposed(rigid)))), pose.transform.matrix);
    const shift = Math.hypot(...[12, 13, 14].map((i) => (here[i] as number) - (pose.transform.matrix[i] as number)));
    if (shift <= maxShift) {
      count = before.count + 1;
      const gain = Math.max(1 / count, 0.1);
      [turn, position] = averaged(old, turn, position, gain);
    }
  }
  const matrix = matrixOf(turn, position);
  // Scale by columns: content stays in units of the scene.
  const sessionFromScene = Float32Array.from(matrix, (v, i) => (i < 12 ? v * metresPerUnit : v));
  return { sessionFromScene, count };
}

function unscaled(m: Float32Array, metresPerUnit: number): Float64Array {
  return Float64Array.from(m, (v, i) => (i < 12 ? v / metresPerUnit : v));
}

function averaged(old: Float64Array, turn: Quaternion, position: [number, number, number], gain: number): [Quaternion, [number, number, number]] {
  const from = quaternionOf(old);
  const sign = from.reduce((sum, v, i) => sum + v * (turn[i] as number), 0) < 0 ? -1 : 1;
  const mean = from.map((v, i) => (1 - gain) * v + gain * sign * (turn[i] as number));
  const size = Math.hypot(...mean);
  const place = position.map((v, i) => (1 - gain) * (old[12 + i] as number) + gain * v);
  return [mean.map((v) => v / size) as Quaternion, place as [number, number, number]];
}
