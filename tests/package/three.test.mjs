// The adapter for three.js: what three draws lies where the engine's own camera model puts it.
import assert from "node:assert/strict";
import { test } from "node:test";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { installed, root } from "./support.mjs";

const close = (a, b, tolerance, what) => assert.ok(Math.abs(a - b) <= tolerance, `${what}: ${a} is not ${b}`);

test("a world point is drawn on its pixel, with an off-centre principal point", async (t) => {
  const folder = join(await installed(t), "node_modules/landline");
  const load = (path) => import(pathToFileURL(path));
  const { applyIntrinsics, applyPlacement } = await load(join(folder, "adapters/three.js"));
  const { placementFrom } = await load(join(folder, "placement.js"));
  const THREE = await load(join(root, "web/node_modules/three/build/three.module.js"));

  const intrinsics = { fx: 510, fy: 530, cx: 301, cy: 262, width: 640, height: 480 };
  // A turn about an oblique axis, and a camera away from the origin.
  const rotation = new THREE.Matrix4().makeRotationAxis(new THREE.Vector3(0.3, -0.8, 0.5).normalize(), 0.9);
  const [r, translation] = [rotation.elements, [0.4, -0.2, 2.5]];
  const cameraFromWorld = Float64Array.of(r[0], r[4], r[8], translation[0], r[1], r[5], r[9], translation[1], r[2], r[6], r[10], translation[2], 0, 0, 0, 1);
  const placement = placementFrom(cameraFromWorld);

  const camera = new THREE.PerspectiveCamera(50, 1, 0.1, 50);
  applyIntrinsics(camera, intrinsics);
  applyPlacement(camera, placement);
  // What a renderer does before it draws.
  camera.updateMatrixWorld();

  for (const [axis, value] of Object.entries(placement.position)) close(camera.position[axis], value, 1e-6, `position ${axis}`);
  for (const world of [[0, 0, 0], [0.5, 0.3, -0.4], [-0.6, 0.2, 0.7], [0.1, -0.9, 0.2]]) {
    const at = [0, 1, 2].map((i) => [0, 1, 2].reduce((sum, k) => sum + cameraFromWorld[4 * i + k] * world[k], cameraFromWorld[4 * i + 3]));
    assert.ok(at[2] > 0, "before the camera");
    const expected = [(intrinsics.fx * at[0]) / at[2] + intrinsics.cx, (intrinsics.fy * at[1]) / at[2] + intrinsics.cy];
    const drawn = new THREE.Vector3(...world).project(camera);
    close(((drawn.x + 1) / 2) * intrinsics.width, expected[0], 1e-3, "x");
    close(((1 - drawn.y) / 2) * intrinsics.height, expected[1], 1e-3, "y");
  }
  const ahead = camera.getWorldDirection(new THREE.Vector3());
  [8, 9, 10].forEach((at, i) => close(ahead.getComponent(i), cameraFromWorld[at], 1e-6, "viewing direction"));
});
