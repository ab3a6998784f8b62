/** A camera's position in all the forms that are handed out: where a result's axes are flipped. */
import { LandlineError } from "./errors.js";
import type { Placement } from "./types.js";

/**
 * Inverse of a rigid transform, a row-major 4x4 matrix: of `cameraFromWorld` the `worldFromCamera`, and the other way round.
 * @throws LandlineError `bad-input` for what is no 16 finite numbers.
 */
export function invertRigid(m: ArrayLike<number>): Float64Array {
  if (m?.length !== 16 || !Array.prototype.every.call(m, Number.isFinite)) {
    throw new LandlineError("bad-input", `the matrix has ${m?.length ?? "no"} numbers or some that are none`, "Pass the 16 numbers of a row-major 4x4 matrix, such as a placement's cameraFromWorld.");
  }
  const at = (i: number): number => m[i] as number;
  const inverse = new Float64Array(16);
  for (let r = 0; r < 3; r++) {
    for (let c = 0; c < 3; c++) inverse[4 * r + c] = at(4 * c + r);
    inverse[4 * r + 3] = -(at(r) * at(3) + at(4 + r) * at(7) + at(8 + r) * at(11));
  }
  inverse[15] = 1;
  return inverse;
}

/** Unit quaternion of the rotation part of a row-major 4x4 matrix; w is not negative. */
function quaternion(m: ArrayLike<number>): Placement["rotation"] {
  const at = (r: number, c: number): number => m[4 * r + c] as number;
  // Shepperd's method: divide by the largest of the four components, which is at least 1/2.
  const traces = [at(0, 0) + at(1, 1) + at(2, 2), at(0, 0), at(1, 1), at(2, 2)];
  const largest = traces.indexOf(Math.max(...traces));
  let w: number, x: number, y: number, z: number;
  if (largest === 0) {
    [w, x, y, z] = [1 + (traces[0] as number), at(2, 1) - at(1, 2), at(0, 2) - at(2, 0), at(1, 0) - at(0, 1)];
  } else if (largest === 1) {
    [w, x, y, z] = [at(2, 1) - at(1, 2), 1 + at(0, 0) - at(1, 1) - at(2, 2), at(0, 1) + at(1, 0), at(0, 2) + at(2, 0)];
  } else if (largest === 2) {
    [w, x, y, z] = [at(0, 2) - at(2, 0), at(0, 1) + at(1, 0), 1 - at(0, 0) + at(1, 1) - at(2, 2), at(1, 2) + at(2, 1)];
  } else {
    [w, x, y, z] = [at(1, 0) - at(0, 1), at(0, 2) + at(2, 0), at(1, 2) + at(2, 1), 1 - at(0, 0) - at(1, 1) + at(2, 2)];
  }
  const scale = (w < 0 ? -1 : 1) / Math.hypot(w, x, y, z);
  return { w: w * scale, x: x * scale, y: y * scale, z: z * scale };
}

/** OpenCV camera axes to those of WebGL, y and z with the other sign, as column-major matrices. */
function threeForms(cameraFromWorld: Float64Array, worldFromCamera: Float64Array): Placement["three"] {
  const world = new Float32Array(16);
  const camera = new Float32Array(16);
  for (let r = 0; r < 4; r++) {
    for (let c = 0; c < 4; c++) {
      world[4 * c + r] = (worldFromCamera[4 * r + c] as number) * (c === 1 || c === 2 ? -1 : 1);
      camera[4 * c + r] = (cameraFromWorld[4 * r + c] as number) * (r === 1 || r === 2 ? -1 : 1);
    }
  }
  return { worldFromCamera: world, cameraFromWorld: camera };
}

/** All forms of a placement from its row-major `cameraFromWorld`; throws as `invertRigid`. */
export function placementFrom(cameraFromWorld: Float64Array): Placement {
  const worldFromCamera = invertRigid(cameraFromWorld);
  return {
    cameraFromWorld,
    worldFromCamera,
    position: { x: worldFromCamera[3] as number, y: worldFromCamera[7] as number, z: worldFromCamera[11] as number },
    rotation: quaternion(worldFromCamera),
    three: threeForms(cameraFromWorld, worldFromCamera),
  };
}
