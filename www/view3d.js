/** The 3D view: seen lines and points, the camera as a frustum with its picture, the path it took. */
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { colors } from "./overlay.js";

/** Positions kept in the path. */
const maxPath = 2000;

export class MapView {
  #frame;
  #renderer;
  #scene = new THREE.Scene();
  #camera = new THREE.PerspectiveCamera(50, 1, 0.02, 500);
  #controls;
  #lines;
  #lineMaterial;
  #points;
  #frustum;
  #picture;
  #pictureCanvas = document.createElement("canvas");
  #texture;
  #path = [];
  #pathLine;
  #truth = new THREE.Group();
  #mapVersion = -1;
  /** Ends of the map's lines, x y z after x y z. */
  #ends = new Float32Array(0);
  #asked = false;
  #observer;
  /** Until the user takes hold of the view it is framed anew as the map grows. */
  #touched = false;
  #framedRadius = 0;
  #grid;
  /** Corners of the camera's pyramid in the world. */
  #pyramid = [];
  following = false;

  /** Throws where WebGL is missing. `up` is the scene's up direction. */
  constructor(frame, up) {
    this.#frame = frame;
    this.#renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, powerPreference: "low-power" });
    this.#renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    const { domElement } = this.#renderer;
    domElement.tabIndex = 0;
    domElement.setAttribute("role", "img");
    domElement.setAttribute("aria-label", "3D view of the map with the camera in it. Drag to turn, scroll to zoom; arrow keys move it, with Shift they turn it");
    frame.append(domElement);
    this.#camera.up.copy(up ? new THREE.Vector3(up.x, up.y, up.z).normalize() : new THREE.Vector3(0, -1, 0));
    this.#controls = new OrbitControls(this.#camera, domElement);
    this.#controls.enableDamping = false;
    this.#controls.listenToKeyEvents(domElement);
    domElement.addEventListener("keydown", ({ key }) => {
      if (key.startsWith("Arrow")) this.#touched = true;
    });
    this.#controls.addEventListener("change", () => this.draw());
    this.#controls.addEventListener("start", () => {
      this.#touched = true;
      this.following = false;
      this.onFollowEnd?.();
    });
    this.#lineMaterial = new LineMaterial({ color: colors.line, linewidth: 1.7, transparent: true, opacity: 0.9 });
    this.#lines = new LineSegments2(new LineSegmentsGeometry(), this.#lineMaterial);
    this.#lines.frustumCulled = false;
    this.#points = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ color: colors.point, size: 2.2, sizeAttenuation: false, transparent: true, opacity: 0.75 }));
    this.#points.frustumCulled = false;
    this.#frustum = new LineSegments2(new LineSegmentsGeometry(), new LineMaterial({ color: "#ffffff", linewidth: 2 }));
    this.#frustum.matrixAutoUpdate = false;
    this.#frustum.visible = false;
    this.#frustum.frustumCulled = false;
    this.#texture = new THREE.CanvasTexture(this.#pictureCanvas);
    this.#texture.colorSpace = THREE.SRGBColorSpace;
    this.#picture = new THREE.Mesh(new THREE.BufferGeometry(), new THREE.MeshBasicMaterial({ map: this.#texture, side: THREE.DoubleSide, transparent: true, opacity: 0.85 }));
    this.#picture.matrixAutoUpdate = false;
    this.#picture.visible = false;
    this.#picture.frustumCulled = false;
    this.#pathLine = new LineSegments2(new LineSegmentsGeometry(), new LineMaterial({ color: "#4bd58a", linewidth: 2 }));
    this.#pathLine.frustumCulled = false;
    this.#scene.add(this.#lines, this.#points, this.#frustum, this.#picture, this.#pathLine, this.#truth);
    this.#observer = new ResizeObserver(() => this.#resize());
    this.#observer.observe(frame);
    this.#resize();
  }

  /** Shows known camera positions, for comparison. */
  setTruth(placements) {
    this.#truth.clear();
    if (placements.length === 0) return;
    const at = new Float32Array(3 * placements.length);
    placements.forEach((p, i) => at.set([p.x, p.y, p.z], 3 * i));
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(at, 3));
    this.#truth.add(new THREE.Points(geometry, new THREE.PointsMaterial({ color: "#8795a6", size: 4, sizeAttenuation: false })));
    this.draw();
  }

  /** Adds something of one's own, or takes it away again. */
  add(object) {
    this.#scene.add(object);
    this.draw();
  }

  remove(object) {
    this.#scene.remove(object);
    this.draw();
  }

  /** World points that `reset` frames beside the map. */
  keepInView(points) {
    this.#pyramid = points;
  }

  /** Which way is up from now on; the floor goes with it. */
  setUp({ x, y, z }) {
    this.#camera.up.set(x, y, z).normalize();
    this.reset();
  }

  /** Frees the graphics card's memory and leaves the page. */
  dispose() {
    this.#observer.disconnect();
    this.#controls.dispose();
    this.#asked = true;
    this.#renderer.dispose();
    this.#renderer.forceContextLoss();
    this.#renderer.domElement.remove();
  }

  clear() {
    this.#path = [];
    this.#pathLine.visible = false;
    this.#frustum.visible = false;
    this.#picture.visible = false;
    this.#touched = false;
    this.#framedRadius = 0;
    this.#pyramid = [];
    if (this.#grid) this.#grid.visible = false;
    this.draw();
  }

  /** Shows a located frame. `picture` is a canvas with its pixels. */
  show(result, map, picture, continuous) {
    if (map.version !== this.#mapVersion) this.showMap(map);
    const { placement, intrinsics } = result;
    if (placement) {
      const matrix = new THREE.Matrix4().fromArray(placement.three.worldFromCamera);
      const depth = 0.18 * Math.max(1, Math.min(3, this.#radius() / 2));
      this.#pyramid = this.#setFrustum(intrinsics, depth, picture).map((corner) => corner.applyMatrix4(matrix));
      for (const object of [this.#frustum, this.#picture]) {
        object.matrix.copy(matrix);
        object.matrixWorldNeedsUpdate = true;
        object.visible = true;
      }
      const { x, y, z } = placement.position;
      if (!continuous && this.#path.length > 0 && new THREE.Vector3(x, y, z).distanceTo(new THREE.Vector3(...this.#path.at(-1))) > 1.5) this.#path = [];
      this.#path.push([x, y, z]);
      if (this.#path.length > maxPath) this.#path.shift();
      this.#showPath();
      if (!this.#touched && !this.following && (this.#radius() > 1.03 * this.#framedRadius || !this.#inView(this.#pyramid))) this.reset();
      if (this.following) this.#follow(matrix);
    }
    this.draw();
  }

  /** Frames the map and the camera, and lays the floor below them. */
  reset() {
    this.following = false;
    const box = this.#box();
    if (box.isEmpty()) return;
    this.#framedRadius = this.#radius();
    for (const corner of this.#pyramid) box.expandByPoint(corner);
    const center = box.getCenter(new THREE.Vector3());
    const up = this.#camera.up;
    const side = Math.abs(up.x) < 0.8 ? new THREE.Vector3(1, 0, 0) : new THREE.Vector3(0, 0, 1);
    const across = side.addScaledVector(up, -side.dot(up)).normalize();
    const back = new THREE.Vector3().crossVectors(across, up).normalize();
    const toViewer = new THREE.Vector3().addScaledVector(up, 0.62).addScaledVector(back, 0.7).addScaledVector(across, 0.35).normalize();
    this.#camera.position.copy(center).addScaledVector(toViewer, this.#distanceFor(box, center, toViewer));
    this.#controls.target.copy(center);
    this.#controls.update();
    this.#layFloor(center);
    this.draw();
  }

  /** How far away the viewer has to stand to see every corner of a box. */
  #distanceFor(box, center, toViewer) {
    const right = new THREE.Vector3().crossVectors(this.#camera.up, toViewer).normalize();
    const top = new THREE.Vector3().crossVectors(toViewer, right);
    const vertical = Math.tan((Math.PI * this.#camera.fov) / 360);
    const horizontal = vertical * this.#camera.aspect;
    let distance = 0.5;
    for (let i = 0; i < 8; i++) {
      const corner = new THREE.Vector3(i & 1 ? box.max.x : box.min.x, i & 2 ? box.max.y : box.min.y, i & 4 ? box.max.z : box.min.z).sub(center);
      distance = Math.max(distance, corner.dot(toViewer) + 1.06 * Math.max(Math.abs(corner.dot(right)) / horizontal, Math.abs(corner.dot(top)) / vertical));
    }
    return distance;
  }

  #inView(corners) {
    this.#camera.updateMatrixWorld();
    return corners.every((corner) => {
      const { x, y, z } = corner.clone().project(this.#camera);
      return Math.abs(x) < 1 && Math.abs(y) < 1 && z < 1;
    });
  }

  /** A grid under the map, so that the eye finds the ground; its cells are a round number of the scene's units. */
  #layFloor(center) {
    const up = this.#camera.up;
    const heights = [];
    const take = (array) => {
      for (let i = 0; i + 2 < array.length; i += 3) heights.push(array[i] * up.x + array[i + 1] * up.y + array[i + 2] * up.z);
    };
    take(this.#points.geometry.getAttribute("position")?.array ?? []);
    take(this.#ends);
    if (heights.length === 0) return;
    heights.sort((a, b) => a - b);
    const floor = heights[Math.floor(0.03 * (heights.length - 1))];
    const wanted = this.#framedRadius / 3;
    const decade = 10 ** Math.floor(Math.log10(wanted));
    const cell = decade * ([5, 2, 1].find((n) => n * decade <= wanted) ?? 1);
    const cells = 2 * Math.ceil((1.1 * this.#framedRadius) / cell);
    if (this.#grid) {
      this.#scene.remove(this.#grid);
      this.#grid.dispose();
    }
    this.#grid = new THREE.GridHelper(cells * cell, cells, "#6d7c8d", "#465260");
    this.#grid.material.transparent = true;
    this.#grid.material.opacity = 0.55;
    this.#grid.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), up);
    this.#grid.position.copy(center).addScaledVector(up, floor - center.dot(up));
    this.#scene.add(this.#grid);
  }

  draw() {
    if (this.#asked) return;
    this.#asked = true;
    requestAnimationFrame(() => {
      this.#asked = false;
      this.#renderer.render(this.#scene, this.#camera);
    });
  }

  #follow(matrix) {
    const from = new THREE.Vector3(0, 0.25, 1.1).applyMatrix4(matrix);
    const to = new THREE.Vector3(0, 0, -1.5).applyMatrix4(matrix);
    this.#camera.position.copy(from);
    this.#controls.target.copy(to);
    this.#controls.update();
  }

  #showPath() {
    const path = this.#path;
    this.#pathLine.visible = path.length > 1;
    if (path.length < 2) return;
    this.#pathLine.geometry.dispose();
    this.#pathLine.geometry = new LineSegmentsGeometry().setPositions(path.slice(1).flatMap((p, i) => [...path[i], ...p]));
  }

  /** Shows lines and points: `{ version, numLines, lines(), numPoints, points() }`. */
  showMap(map) {
    this.#mapVersion = map.version;
    const lines = new Float32Array(6 * map.numLines);
    let at = 0;
    for (const line of map.lines()) {
      lines.set(line, at);
      at += 6;
    }
    this.#ends = lines;
    this.#lines.geometry.dispose();
    this.#lines.geometry = new LineSegmentsGeometry();
    if (lines.length > 0) this.#lines.geometry.setPositions(lines);
    this.#lines.visible = lines.length > 0;
    const points = new Float32Array(3 * map.numPoints);
    at = 0;
    for (const point of map.points()) {
      points.set(point, at);
      at += 3;
    }
    this.#points.geometry.dispose();
    this.#points.geometry = new THREE.BufferGeometry();
    this.#points.geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
  }

  /** The camera's pyramid in its own axes; answers with its tip and corners. */
  #setFrustum(k, depth, picture) {
    const left = (-k.cx / k.fx) * depth;
    const right = ((k.width - k.cx) / k.fx) * depth;
    const top = (k.cy / k.fy) * depth;
    const bottom = (-(k.height - k.cy) / k.fy) * depth;
    const corners = [[left, top, -depth], [right, top, -depth], [right, bottom, -depth], [left, bottom, -depth]].map((c) => new THREE.Vector3(...c));
    const eye = new THREE.Vector3();
    const edges = corners.flatMap((c, i) => [eye, c, c, corners[(i + 1) % 4]]);
    this.#frustum.geometry.dispose();
    this.#frustum.geometry = new LineSegmentsGeometry().setPositions(edges.flatMap((p) => p.toArray()));
    if (!picture) return [eye, ...corners];
    const width = 256;
    const height = Math.max(1, Math.round((width * k.height) / k.width));
    if (this.#pictureCanvas.width !== width || this.#pictureCanvas.height !== height) {
      this.#pictureCanvas.width = width;
      this.#pictureCanvas.height = height;
      this.#texture.dispose();
    }
    this.#pictureCanvas.getContext("2d").drawImage(picture, 0, 0, width, height);
    this.#texture.needsUpdate = true;
    const geometry = new THREE.BufferGeometry();
    const [a, b, c, d] = corners;
    geometry.setFromPoints([a, b, c, a, c, d]);
    geometry.setAttribute("uv", new THREE.Float32BufferAttribute([0, 1, 1, 1, 1, 0, 0, 1, 1, 0, 0, 0], 2));
    this.#picture.geometry.dispose();
    this.#picture.geometry = geometry;
    return [eye, ...corners];
  }

  /** Where most of the map lies: far-off mistakes must not shrink the rest. */
  #box() {
    const axes = [[], [], []];
    const take = (array) => {
      for (let i = 0; i < array.length; i++) axes[i % 3].push(array[i]);
    };
    const points = this.#points.geometry.getAttribute("position");
    if (points) take(points.array);
    take(this.#ends);
    for (const p of this.#path) take(p);
    const box = new THREE.Box3();
    if (axes[0].length === 0) return box;
    const bounds = axes.map((values) => {
      values.sort((a, b) => a - b);
      return [values[Math.floor(0.01 * (values.length - 1))], values[Math.ceil(0.99 * (values.length - 1))]];
    });
    box.min.set(bounds[0][0], bounds[1][0], bounds[2][0]);
    box.max.set(bounds[0][1], bounds[1][1], bounds[2][1]);
    return box;
  }

  #radius() {
    const box = this.#box();
    return box.isEmpty() ? 1 : box.getSize(new THREE.Vector3()).length() / 2;
  }

  #resize() {
    const { clientWidth: w, clientHeight: h } = this.#frame;
    if (w === 0 || h === 0) return;
    this.#renderer.setSize(w, h);
    this.#camera.aspect = w / h;
    this.#camera.updateProjectionMatrix();
    this.draw();
  }
}
