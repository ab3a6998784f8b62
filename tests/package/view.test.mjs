// Where things stand on the screen: cover and contain, pixel ratios, mirrored and turned frames, moved parents, sensors, WebXR.
// Everything is compared with the camera model written out here.
import assert from "node:assert/strict";
import { test } from "node:test";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { installed, root, tools } from "./support.mjs";

const close = (a, b, tolerance, what) => assert.ok(Math.abs(a - b) <= tolerance, `${what}: ${a} is not ${b}`);
const load = (path) => import(pathToFileURL(path));
const three = () => load(join(root, "web/node_modules/three/build/three.module.js"));

/** The parts of Babylon.js that need neither a page nor WebGL. */
async function babylon() {
  const parts = ["Engines/nullEngine.js", "scene.js", "Cameras/freeCamera.js", "Maths/math.vector.js"];
  const all = await Promise.all(parts.map((name) => load(join(root, "web/node_modules/@babylonjs/core", name))));
  return Object.assign({}, ...all);
}

const intrinsics = { fx: 510, fy: 530, cx: 301, cy: 262, width: 640, height: 480 };
const worlds = [[0, 0, 0], [0.5, 0.3, -0.4], [-0.6, 0.2, 0.7], [0.1, -0.9, 0.2]];

/** A turn about an oblique axis by an angle, and a camera away from the origin; row-major. */
function cameraFromWorld(angle = 0.9, translation = [0.4, -0.2, 2.5]) {
  const size = Math.hypot(0.3, -0.8, 0.5);
  const [x, y, z] = [0.3 / size, -0.8 / size, 0.5 / size];
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const k = 1 - c;
  return Float64Array.of(
    c + x * x * k, x * y * k - z * s, x * z * k + y * s, translation[0],
    y * x * k + z * s, c + y * y * k, y * z * k - x * s, translation[1],
    z * x * k - y * s, z * y * k + x * s, c + z * z * k, translation[2],
    0, 0, 0, 1,
  );
}

const seenAt = (m, world, k = intrinsics) => {
  const at = [0, 1, 2].map((i) => m[4 * i] * world[0] + m[4 * i + 1] * world[1] + m[4 * i + 2] * world[2] + m[4 * i + 3]);
  return [(k.fx * at[0]) / at[2] + k.cx, (k.fy * at[1]) / at[2] + k.cy];
};

async function parts(t) {
  const folder = join(await installed(t), "node_modules/landline");
  const all = await Promise.all(["index.js", "adapters/three.js", "adapters/webxr.js", "sensors.js"].map((name) => load(join(folder, name))));
  const inBabylon = await load(join(folder, "adapters/babylon.js"));
  return Object.assign({ applyPlacementInBabylon: inBabylon.applyPlacement, applyViewInBabylon: inBabylon.applyView }, ...all);
}

/** Where a page would put a pixel of a frame by CSS `object-fit`, centred. */
function byCss([x, y], frame, { width, height, fit, mirrored }) {
  const ratio = fit === "cover" ? Math.max(width / frame.width, height / frame.height) : Math.min(width / frame.width, height / frame.height);
  const [sx, sy] = fit === "fill" ? [width / frame.width, height / frame.height] : [ratio, ratio];
  const left = width / 2 + (x - frame.width / 2) * sx;
  return [mirrored ? width - left : left, height / 2 + (y - frame.height / 2) * sy];
}

const views = [
  { width: 640, height: 480, fit: "contain" },
  { width: 390, height: 844, fit: "cover" },
  { width: 390, height: 844, fit: "contain" },
  { width: 1280, height: 300, fit: "cover" },
  { width: 800, height: 800, fit: "fill" },
  { width: 390, height: 844, fit: "cover", mirrored: true },
];

test("plain canvas: world points stand where object-fit shows their pixels, and taps find their way back", async (t) => {
  const { fromView, placementFrom, project, toView, viewMap } = await parts(t);
  const placement = placementFrom(cameraFromWorld());
  // A phone held upright gives a picture that is turned too.
  const portrait = { fx: 530, fy: 510, cx: 218, cy: 301, width: 480, height: 640 };
  for (const k of [intrinsics, portrait]) {
    for (const view of views) {
      const map = viewMap(k, view);
      for (const world of worlds) {
        const pixel = project(placement, k, world);
        const expected = byCss(seenAt(placement.cameraFromWorld, world, k), k, view);
        const found = toView(map, pixel);
        [0, 1].forEach((i) => close(found[i], expected[i], 1e-9, `${view.fit} ${view.width} axis ${i}`));
        const back = fromView(map, found);
        [0, 1].forEach((i) => close(back[i], pixel[i], 1e-9, "back"));
      }
    }
  }
  const { x, y, z } = placement.position;
  const back = [8, 9, 10].map((i) => -placement.cameraFromWorld[i]);
  assert.equal(project(placement, intrinsics, [x + back[0], y + back[1], z + back[2]]), undefined, "behind the camera");
});

test("three.js: a cover view, and a camera inside a moved and scaled rig", async (t) => {
  const { applyPlacement, applyView, placementFrom } = await parts(t);
  const THREE = await three();
  const placement = placementFrom(cameraFromWorld());
  for (const view of views.filter(({ mirrored }) => !mirrored)) {
    const [scene, rig, camera] = [new THREE.Scene(), new THREE.Group(), new THREE.PerspectiveCamera(50, 1, 0.1, 50)];
    rig.position.set(3, -1, 2);
    rig.rotation.set(0.4, 1.1, -0.3);
    rig.scale.setScalar(2);
    scene.add(rig);
    rig.add(camera);
    applyView(camera, intrinsics, view);
    applyPlacement(camera, placement);
    // What a renderer does before it draws.
    scene.updateMatrixWorld();
    camera.updateMatrixWorld();
    for (const world of worlds) {
      const expected = byCss(seenAt(placement.cameraFromWorld, world), intrinsics, view);
      const drawn = new THREE.Vector3(...world).project(camera);
      close(((drawn.x + 1) / 2) * view.width, expected[0], 0.01, `${view.fit} x`);
      close(((1 - drawn.y) / 2) * view.height, expected[1], 0.01, `${view.fit} y`);
    }
  }
});

test("three.js: the camera view follows the canvas, its pixel ratio and its mirror", async (t) => {
  const { CameraView, placementFrom } = await parts(t);
  const THREE = await three();
  const sizes = [];
  const canvas = { clientWidth: 390, clientHeight: 844, width: 1, height: 1, style: {} };
  let ratio = 1;
  const renderer = {
    domElement: canvas,
    getPixelRatio: () => ratio,
    setPixelRatio: (value) => (ratio = value),
    setSize: (width, height, style) => {
      sizes.push([width, height, style]);
      [canvas.width, canvas.height] = [Math.floor(width * ratio), Math.floor(height * ratio)];
    },
  };
  globalThis.devicePixelRatio = 3;
  t.after(() => delete globalThis.devicePixelRatio);
  const camera = new THREE.PerspectiveCamera(50, 1, 0.1, 50);
  const view = new CameraView(renderer, camera, { mirrored: true });
  const located = { located: true, placement: placementFrom(cameraFromWorld()), intrinsics };
  assert.equal(view.update(located), true);
  assert.equal(view.update(located), true);
  assert.deepEqual([sizes, ratio, canvas.style.transform], [[[390, 844, false]], 3, "scaleX(-1)"]);
  [canvas.clientWidth, canvas.clientHeight] = [844, 390];
  view.update(located);
  assert.equal(sizes.length, 2, "a turned phone resizes once");
  camera.updateMatrixWorld();
  const drawn = new THREE.Vector3(...worlds[1]).project(camera);
  const expected = byCss(seenAt(located.placement.cameraFromWorld, worlds[1]), intrinsics, { width: 844, height: 390, fit: "cover" });
  close(((drawn.x + 1) / 2) * 844, expected[0], 0.01, "x");
  assert.equal(view.update({ located: false }), false);
});

test("Babylon.js: a world point is drawn on its pixel, in a view that covers a phone", async (t) => {
  const { applyPlacementInBabylon, applyViewInBabylon, placementFrom } = await parts(t);
  const { NullEngine, Scene, FreeCamera, Vector3, Quaternion, Matrix } = await babylon();
  const scene = new Scene(new NullEngine({ renderWidth: 390, renderHeight: 844, textureSize: 256, deterministicLockstep: false, lockstepMaxSteps: 1 }));
  scene.useRightHandedSystem = true;
  const camera = new FreeCamera("real", Vector3.Zero(), scene);
  camera.rotationQuaternion = Quaternion.Identity();
  [camera.minZ, camera.maxZ] = [0.1, 50];
  const placement = placementFrom(cameraFromWorld());
  const view = { width: 390, height: 844, fit: "cover" };
  applyViewInBabylon(camera, intrinsics, view, (m) => Matrix.FromArray(m));
  applyPlacementInBabylon(camera, placement);
  const seen = camera.getViewMatrix(true).multiply(camera.getProjectionMatrix());
  for (const world of worlds) {
    const drawn = Vector3.TransformCoordinates(new Vector3(...world), seen);
    const expected = byCss(seenAt(placement.cameraFromWorld, world), intrinsics, view);
    close(((drawn.x + 1) / 2) * view.width, expected[0], 0.05, "x");
    close(((1 - drawn.y) / 2) * view.height, expected[1], 0.05, "y");
  }
});

test("sensors: turns and gravity in the axes of the rear camera", async (t) => {
  const { cameraFromDevice, gravityFromAngles, rotationFromVector } = await parts(t);
  const near = (found, expected, what) => expected.forEach((v, i) => close(found[i], v, 1e-9, `${what} ${i}`));
  // Held upright the screen's right, up and towards the user are the camera's right, up and backwards.
  near(cameraFromDevice([1, 0, 0], 0), [1, 0, 0], "right");
  near(cameraFromDevice([0, 1, 0], 0), [0, -1, 0], "up");
  near(cameraFromDevice([0, 0, 1], 0), [0, 0, -1], "out of the screen");
  // Turned on its left side: the device's right points up.
  near(cameraFromDevice([1, 0, 0], 90), [0, -1, 0], "right, turned");
  near(cameraFromDevice([0, 1, 0], 90), [-1, 0, 0], "top, turned");
  // Flat on a table gravity goes into the screen; upright it goes out of the lower edge.
  near(gravityFromAngles(0, 0), [0, 0, -1], "flat");
  near(gravityFromAngles(90, 0), [0, -1, 0], "upright");
  near(cameraFromDevice(gravityFromAngles(90, 0), 0), [0, 1, 0], "upright, in the camera");
  // A quarter turn about y takes z to x.
  const turn = rotationFromVector([0, Math.PI / 2, 0]);
  near([turn[2], turn[5], turn[8]], [1, 0, 0], "z after the turn");
});

test("sensors: what is integrated between frames is the turn of the picture", async (t) => {
  const { motionSensors } = await parts(t);
  const listeners = {};
  Object.assign(globalThis, {
    addEventListener: (name, listener) => (listeners[name] = listener),
    removeEventListener: (name) => delete listeners[name],
    DeviceMotionEvent: { requestPermission: async () => "granted" },
  });
  t.after(() => ["addEventListener", "removeEventListener", "DeviceMotionEvent"].forEach((name) => delete globalThis[name]));
  const sensors = await motionSensors();
  assert.equal(sensors.turnSinceLastFrame(performance.now()), undefined, "no sensor speaks");
  assert.equal(sensors.gravity(), undefined);
  // 30 degrees a second to the left (about the device's upward axis) for 100 ms, in steps of 10 ms.
  for (let i = 0; i < 10; i++) listeners.devicemotion({ rotationRate: { alpha: 0, beta: 0, gamma: 30 }, interval: 10 });
  const turn = sensors.turnSinceLastFrame(performance.now());
  // A point straight ahead moves to the right of the picture.
  const angle = (3 * Math.PI) / 180;
  close(turn[2], Math.sin(angle), 1e-9, "x of what was ahead");
  close(turn[8], Math.cos(angle), 1e-9, "z of what was ahead");
  close(sensors.turnSinceLastFrame(performance.now())[0], 1, 1e-12, "taken once");
  // What is no number is not heard.
  listeners.devicemotion({ rotationRate: { alpha: null, beta: 0, gamma: 0 }, interval: 10 });
  listeners.devicemotion({ rotationRate: { alpha: NaN, beta: 0, gamma: 0 }, interval: 10 });
  listeners.deviceorientation({ beta: 90, gamma: 0 });
  close(sensors.gravity().y, 1, 1e-9, "down");
  sensors.stop();
  assert.deepEqual([sensors.gravity(), Object.keys(listeners)], [undefined, []]);
  globalThis.DeviceMotionEvent.requestPermission = async () => "denied";
  await assert.rejects(motionSensors(), { code: "unsupported" });
});

test("WebXR: one localisation joins the scene with the session, and the device's tracking does the rest", async (t) => {
  const { alignSession, placementFrom } = await parts(t);
  const THREE = await three();
  const { XRDevice, XRWebGLLayer, metaQuest3 } = await load(tools.resolve("iwer"));
  // The emulator wants a page with WebGL; what it draws does not matter here.
  const anything = () =>
    new Proxy(() => undefined, { get: (kept, key) => (key === Symbol.toPrimitive ? () => 0 : key in kept ? kept[key] : anything()), apply: () => anything() });
  Object.assign(globalThis, {
    document: anything(),
    window: anything(),
    WebGL2RenderingContext: class {},
    DOMPointReadOnly: class {
      constructor(x = 0, y = 0, z = 0, w = 1) {
        Object.assign(this, { x, y, z, w });
      }
    },
    localStorage: { getItem: () => null, setItem: () => undefined },
    requestAnimationFrame: (callback) => setTimeout(() => callback(performance.now()), 5),
    cancelAnimationFrame: clearTimeout,
  });
  if (!globalThis.navigator) Object.defineProperty(globalThis, "navigator", { value: {}, configurable: true });
  t.after(() => ["document", "window", "WebGL2RenderingContext", "DOMPointReadOnly", "localStorage", "requestAnimationFrame", "cancelAnimationFrame"].forEach((name) => delete globalThis[name]));
  const device = new XRDevice(metaQuest3);
  device.installRuntime();
  const session = await globalThis.navigator.xr.requestSession("immersive-ar");
  session.updateRenderState({ baseLayer: new XRWebGLLayer(session, anything()) });
  const space = await session.requestReferenceSpace("local");
  /** Does something in the next frame: a frame is of no use after its callback. */
  const inFrame = (work) =>
    new Promise((done, fail) =>
      session.requestAnimationFrame((_, frame) => {
        try {
          done(work(frame));
        } catch (error) {
          fail(error);
        }
      }),
    );

  // Truth: where the scene lies in the session, in metres of a scene whose unit is 20 cm.
  const metresPerUnit = 0.2;
  const truth = new THREE.Matrix4().compose(new THREE.Vector3(1, -0.5, 2), new THREE.Quaternion().setFromEuler(new THREE.Euler(0.1, 2, -0.2)), new THREE.Vector3(1, 1, 1).multiplyScalar(metresPerUnit));
  const move = (x, y, z, yaw) => {
    device.position.set(x, y, z);
    const q = new THREE.Quaternion().setFromEuler(new THREE.Euler(-0.1, yaw, 0));
    device.quaternion.set(q.x, q.y, q.z, q.w);
  };
  /** What the relocalizer says for a viewer, off by so many units. */
  const answer = (viewer, off = 0) => {
    const sceneFromViewer = truth.clone().invert().multiply(viewer);
    const [position, turn] = [new THREE.Vector3(), new THREE.Quaternion()];
    sceneFromViewer.decompose(position, turn, new THREE.Vector3());
    position.x += off;
    const glFromScene = new THREE.Matrix4().compose(position, turn, new THREE.Vector3(1, 1, 1)).invert();
    // Row-major, and axes of OpenCV.
    const m = glFromScene.transpose().elements.map((v, i) => (i >= 4 && i < 12 ? -v : v));
    return { located: true, placement: placementFrom(Float64Array.from(m)) };
  };
  const viewerOf = (frame) => new THREE.Matrix4().fromArray(frame.getViewerPose(space).transform.matrix);
  const offBy = (alignment, point) => {
    const group = new THREE.Matrix4().fromArray(alignment.sessionFromScene);
    return new THREE.Vector3(...point).applyMatrix4(group).distanceTo(new THREE.Vector3(...point).applyMatrix4(truth));
  };

  move(0.3, 1.6, 0.2, 0.4);
  await inFrame(() => undefined);
  let alignment = await inFrame((frame) => alignSession(frame, space, answer(viewerOf(frame)), { metresPerUnit }));
  assert.equal(alignment.count, 1);
  for (const point of worlds) close(offBy(alignment, point), 0, 1e-5, "metres");

  // From elsewhere the same group is still right, without another answer; a wrong one of 10 cm is averaged away.
  move(-1, 1.2, 0.8, -0.7);
  await inFrame(() => undefined);
  assert.equal(await inFrame((frame) => alignSession(frame, space, { located: false }, { metresPerUnit, before: alignment })), alignment);
  alignment = await inFrame((frame) => alignSession(frame, space, answer(viewerOf(frame), 0.5), { metresPerUnit, before: alignment }));
  assert.equal(alignment.count, 2);
  close(offBy(alignment, worlds[1]), 0.05, 1e-4, "half of ten centimetres");
  // One that is two metres off starts anew.
  const far = await inFrame((frame) => alignSession(frame, space, answer(viewerOf(frame), 10), { metresPerUnit, before: alignment }));
  assert.equal(far.count, 1);
  await session.end();
});
