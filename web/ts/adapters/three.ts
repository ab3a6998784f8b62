/**
 * Puts a result into three.js. Optional entry `landline/three`; three itself is only needed for its types.
 *
 * three's cameras look along -z with y up, the engine's along +z with y down. The result already carries both forms;
 * this applies them.
 */
import type { Camera as ThreeCamera, PerspectiveCamera, WebGLRenderer } from "three";
import { intrinsicsInView, projectionMatrix, type Fit, type Intrinsics, type Placement, type View } from "../index.js";

export { projectionMatrix };

/**
 * Moves a camera to where the real one is, wherever in the scene graph it hangs. Its matrix is set as a whole:
 * `matrixAutoUpdate` is turned off, and stays right when the renderer updates it.
 */
export function applyPlacement(camera: ThreeCamera, placement: Placement): void {
  camera.matrixAutoUpdate = false;
  camera.matrix.fromArray(placement.three.worldFromCamera);
  if (camera.parent) {
    camera.parent.updateWorldMatrix(true, false);
    // Multiplied by the parent's again it is the camera's own place.
    camera.matrix.premultiply(camera.parent.matrixWorld.clone().invert());
  }
  camera.matrix.decompose(camera.position, camera.quaternion, camera.scale);
  camera.matrixWorld.fromArray(placement.three.worldFromCamera);
  camera.matrixWorldInverse.fromArray(placement.three.cameraFromWorld);
  camera.matrixWorldNeedsUpdate = true;
}

/** Gives a camera the real one's field of view. Draw into a viewport with the frame's aspect ratio, or see `applyView`. */
export function applyIntrinsics(camera: PerspectiveCamera, intrinsics: Intrinsics, near = camera.near, far = camera.far): void {
  camera.near = near;
  camera.far = far;
  camera.fov = (2 * Math.atan(intrinsics.height / 2 / intrinsics.fy) * 180) / Math.PI;
  camera.aspect = intrinsics.width / intrinsics.height;
  camera.projectionMatrix.fromArray(projectionMatrix(intrinsics, near, far));
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
}

/** As `applyIntrinsics`, for a canvas of any shape in which the frame is shown by `view.fit`. */
export function applyView(camera: PerspectiveCamera, intrinsics: Intrinsics, view: View, near = camera.near, far = camera.far): void {
  applyIntrinsics(camera, intrinsicsInView(intrinsics, view), near, far);
}

export interface CameraViewOptions {
  /** How the frame fills the canvas; `cover` by default. */
  fit?: Fit;
  /** For a camera that faces the user: the canvas is mirrored by CSS, as the video should be. */
  mirrored?: boolean;
}

/** What a camera view takes: any result with or without a position. */
interface Seen {
  located: boolean;
  placement?: Placement;
  intrinsics?: Intrinsics;
}

/** Keeps a renderer's size and a camera in step with the results: resized canvas, device pixel ratio, turned phone. */
export class CameraView {
  readonly #renderer: WebGLRenderer;
  readonly #camera: PerspectiveCamera;
  readonly #options: CameraViewOptions;

  constructor(renderer: WebGLRenderer, camera: PerspectiveCamera, options: CameraViewOptions = {}) {
    this.#renderer = renderer;
    this.#camera = camera;
    this.#options = options;
  }

  /** Call with every result before drawing. False when there is no position: draw nothing then. */
  update({ located, placement, intrinsics }: Seen): boolean {
    const canvas = this.#renderer.domElement;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (width === 0 || height === 0) return false;
    const ratio = globalThis.devicePixelRatio || 1;
    if (this.#renderer.getPixelRatio() !== ratio) this.#renderer.setPixelRatio(ratio);
    if (canvas.width !== Math.floor(width * ratio) || canvas.height !== Math.floor(height * ratio)) this.#renderer.setSize(width, height, false);
    canvas.style.transform = this.#options.mirrored ? "scaleX(-1)" : "";
    if (!located || !placement || !intrinsics) return false;
    applyView(this.#camera, intrinsics, { width, height, fit: this.#options.fit ?? "cover" });
    applyPlacement(this.#camera, placement);
    return true;
  }
}
