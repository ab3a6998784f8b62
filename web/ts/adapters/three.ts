/**
 * Puts a result into three.js. Optional entry `landline/three`; three itself is only needed for its types.
 *
 * three's cameras look along -z with y up, the engine's along +z with y down. The result already carries both forms;
 * this applies them.
 */
import type { Camera as ThreeCamera, PerspectiveCamera } from "three";
import type { Intrinsics, Placement } from "../index.js";

/** Moves a camera to where the real one is. Its matrix is set as a whole: `matrixAutoUpdate` is turned off. */
export function applyPlacement(camera: ThreeCamera, placement: Placement): void {
  camera.matrixAutoUpdate = false;
  camera.matrix.fromArray(placement.three.worldFromCamera);
  camera.matrix.decompose(camera.position, camera.quaternion, camera.scale);
  camera.matrixWorld.copy(camera.matrix);
  camera.matrixWorldInverse.fromArray(placement.three.cameraFromWorld);
  camera.matrixWorldNeedsUpdate = true;
}

/** Column-major projection whose picture covers exactly the frame, off-centre principal point included. */
export function projectionMatrix(intrinsics: Intrinsics, near: number, far: number): Float64Array {
  const { fx, fy, cx, cy, width: w, height: h } = intrinsics;
  const m = new Float64Array(16);
  m[0] = (2 * fx) / w;
  m[5] = (2 * fy) / h;
  m[8] = 1 - (2 * cx) / w;
  m[9] = (2 * cy) / h - 1;
  m[10] = -(far + near) / (far - near);
  m[11] = -1;
  m[14] = (-2 * far * near) / (far - near);
  return m;
}

/** Gives a camera the real one's field of view. Draw into a viewport with the frame's aspect ratio. */
export function applyIntrinsics(camera: PerspectiveCamera, intrinsics: Intrinsics, near = camera.near, far = camera.far): void {
  camera.near = near;
  camera.far = far;
  camera.fov = (2 * Math.atan(intrinsics.height / 2 / intrinsics.fy) * 180) / Math.PI;
  camera.aspect = intrinsics.width / intrinsics.height;
  camera.projectionMatrix.fromArray(projectionMatrix(intrinsics, near, far));
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
}
