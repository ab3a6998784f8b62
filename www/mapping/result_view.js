/** The 3D view of a finished map: its points and lines, and where the camera stood. */
import * as THREE from "three";
import { MapView } from "../view3d.js";
import { upOf } from "./up.js";

/** `[0, 1, 2, …]` as vectors of so many numbers. */
function* pieces(array, size) {
  for (let i = 0; i + size <= (array?.length ?? 0); i += size) yield array.subarray(i, i + size);
}

/** Where the cameras stood, x y z after x y z. */
const positions = (pictures) => Float32Array.from(pictures.flatMap(({ placement }) => (placement ? Object.values(placement.position) : [])));

export class ResultView {
  #view;
  #cameras;

  /** Throws where WebGL is missing. */
  constructor(frame, report) {
    this.#view = new MapView(frame, upOf(report));
    const { lines } = report.cloud;
    const points = report.cloud.points.length > 0 ? report.cloud.points : positions(report.pictures);
    this.#view.showMap({
      version: 1,
      numLines: Math.floor((lines?.length ?? 0) / 6),
      lines: () => pieces(lines, 6),
      numPoints: Math.floor((points?.length ?? 0) / 3),
      points: () => pieces(points, 3),
    });
    this.#showCameras(report);
    this.#view.reset();
  }

  /** A small pyramid per picture that has a position, and the way between them. */
  #showCameras({ pictures, focal, width, height }) {
    const posed = pictures.filter(({ placement }) => placement).map(({ placement }) => placement.worldFromCamera);
    if (posed.length === 0) return;
    const at = posed.map((m) => new THREE.Vector3(m[3], m[7], m[11]));
    const extent = new THREE.Box3().setFromPoints(at).getSize(new THREE.Vector3()).length();
    const depth = Math.max(1e-6, extent / 30);
    const [x, y] = [(depth * width) / (2 * focal), (depth * height) / (2 * focal)];
    const corners = [[-x, -y], [x, -y], [x, y], [-x, y]];
    const ends = [];
    posed.forEach((m, i) => {
      const world = ([u, v]) => [0, 4, 8].map((row) => m[row] * u + m[row + 1] * v + m[row + 2] * depth + m[row + 3]);
      const tip = at[i].toArray();
      corners.forEach((corner, k) => ends.push(...tip, ...world(corner), ...world(corner), ...world(corners[(k + 1) % 4])));
    });
    const pyramids = new THREE.BufferGeometry();
    pyramids.setAttribute("position", new THREE.Float32BufferAttribute(ends, 3));
    this.#cameras = new THREE.Group();
    this.#cameras.add(new THREE.LineSegments(pyramids, new THREE.LineBasicMaterial({ color: "#e9edf2", transparent: true, opacity: 0.85 })));
    this.#cameras.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints(at), new THREE.LineBasicMaterial({ color: "#4bd58a" })));
    this.#view.add(this.#cameras);
    this.#view.keepInView(at);
  }

  setUp(up) {
    this.#view.setUp(up);
  }

  reset() {
    this.#view.reset();
  }

  dispose() {
    this.#view.dispose();
  }
}
