/**
 * Puts a result into Babylon.js. Optional entry `landline/babylon`; nothing of Babylon is imported.
 *
 * The scene must be right-handed (`scene.useRightHandedSystem = true`): the world is.
 */
import { intrinsicsInView, projectionMatrix, type Intrinsics, type Placement, type View } from "../index.js";

/** What is needed of a `Matrix`. */
interface MatrixLike {
  copyFromFloats?: unknown;
}

/** What is needed of a `TargetCamera` (free and universal cameras are some). */
interface CameraLike<M extends MatrixLike> {
  minZ: number;
  maxZ: number;
  position: { set(x: number, y: number, z: number): unknown };
  updateUpVectorFromRotation: boolean;
  rotationQuaternion: { set(x: number, y: number, z: number, w: number): unknown } | null;
  freezeProjectionMatrix(projection?: M): void;
}

/** Moves a camera to where the real one is. Give it a `rotationQuaternion` before. */
export function applyPlacement<M extends MatrixLike>(camera: CameraLike<M>, { position, rotation }: Placement): void {
  camera.position.set(position.x, position.y, position.z);
  // A right-handed Babylon's camera looks along -z with y up; ours along z with y down: half a turn about x.
  const { w, x, y, z } = rotation;
  // Without this a camera never rolls.
  camera.updateUpVectorFromRotation = true;
  camera.rotationQuaternion?.set(w, z, -y, -x);
}

/** Gives a camera the real one's field of view in a canvas of any shape. `fromArray` is `Matrix.FromArray`. */
export function applyView<M extends MatrixLike>(camera: CameraLike<M>, intrinsics: Intrinsics, view: View, fromArray: (numbers: number[]) => M): void {
  camera.freezeProjectionMatrix(fromArray([...projectionMatrix(intrinsicsInView(intrinsics, view), camera.minZ, camera.maxZ)]));
}
