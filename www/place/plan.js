/** The floor plan: rooms' outlines from above, the camera as a dot that looks somewhere. */
import { roomName } from "../panels.js";

const svg = (tag, attributes = {}, ...children) => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.append(...children);
  return element;
};

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => {
  const norm = Math.hypot(...a);
  return norm > 0 ? a.map((v) => v / norm) : [0, 0, 1];
};

/** A point of a room in the place; of a room whose place is not known, as it is. */
export function pointInPlace({ place_from_room: placed }, p) {
  if (!placed) return [...p];
  const [w, ...v] = placed.qwxyz;
  const t = cross(v, p).map((c) => 2 * c);
  const turned = cross(v, t).map((c, i) => p[i] + w * t[i] + c);
  return turned.map((c, i) => (placed.scale ?? 1) * c + placed.t[i]);
}

/** Twice the area of a polygon times the direction from which it goes round counter-clockwise: up. */
function normalOf(corners) {
  const sum = [0, 0, 0];
  corners.forEach((corner, i) => cross(corner, corners[(i + 1) % corners.length]).forEach((c, k) => (sum[k] += c)));
  return sum;
}

/**
 * What is drawn together: the rooms whose place is known and that are on the floor of `room`; a room whose place is not known
 * stands alone. `to2d` has x to the right and y downwards, as on paper.
 */
export function layout(manifest, room) {
  const placed = manifest.rooms.filter((other) => other.place_from_room);
  const first = room ?? placed[0] ?? manifest.rooms[0];
  const rooms = first.place_from_room ? placed.filter((other) => other.floor === first.floor) : [first];
  const shapes = rooms.map((other) => ({ room: other, corners: (other.outline ?? []).map((corner) => pointInPlace(other, corner)) }));
  const up = unit(shapes.reduce((sum, { corners }) => normalOf(corners).map((c, i) => sum[i] + c), [0, 0, 0]));
  const right = unit(Math.abs(up[0]) < 0.9 ? [1, 0, 0].map((v, i) => v - up[0] * up[i]) : [0, 1, 0].map((v, i) => v - up[1] * up[i]));
  const ahead = cross(up, right);
  const to2d = (p) => [dot(right, p), -dot(ahead, p)];
  return {
    floor: first.floor,
    isAlone: !first.place_from_room,
    to2d,
    shapes: shapes.map(({ room: other, corners }) => ({ room: other, corners: corners.map(to2d), middle: to2d(corners.length > 0 ? mean(corners) : pointInPlace(other, [0, 0, 0])) })),
    others: manifest.rooms.filter((other) => !rooms.includes(other)),
  };
}

function mean(points) {
  return points.reduce((sum, p) => sum.map((v, i) => v + p[i] / points.length), [0, 0, 0]);
}

/** Draws into an `<svg>`. */
export class FloorPlan {
  #svg;
  #manifest;
  #drawn;
  /** Left, top, right and bottom of what is shown. */
  #box;
  /** Last known position and direction on paper. */
  #last;

  constructor(manifest) {
    this.#manifest = manifest;
    this.#svg = svg("svg", { class: "plan-drawing", role: "img", "aria-label": "Floor plan" });
    this.show(undefined);
  }

  get element() {
    return this.#svg;
  }

  /** The rooms of the floor of `room`. */
  show(room) {
    const drawn = layout(this.#manifest, room);
    this.#drawn = drawn;
    this.#last = undefined;
    const points = drawn.shapes.flatMap(({ corners, middle }) => [...corners, middle]);
    const [xs, ys] = [0, 1].map((k) => points.map((p) => p[k]));
    this.#box = [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
    this.#frame();
    const size = this.#size();
    const rooms = drawn.shapes.map(({ room: other, corners, middle: [x, y] }) => {
      const shape = corners.length > 2 ? svg("polygon", { points: corners.map((c) => c.join(",")).join(" ") }) : svg("circle", { cx: x, cy: y, r: 0.04 * size });
      return svg("g", { class: "plan-room", "data-room": other.id }, shape, svg("text", { x, y, "font-size": 0.045 * size, "text-anchor": "middle", "dominant-baseline": "middle" }, roomName(other)));
    });
    // Twice as long as it is wide, so that one sees where it looks.
    const r = 0.022 * size;
    const camera = svg("g", { class: "plan-camera", hidden: "" }, svg("path", { class: "plan-view", d: `M0 0L${7 * r} ${-4 * r}A${8 * r} ${8 * r} 0 0 1 ${7 * r} ${4 * r}Z` }), svg("circle", { r }));
    this.#svg.replaceChildren(...rooms, camera);
    return drawn;
  }

  #size() {
    const [left, top, right, bottom] = this.#box;
    return Math.max(right - left, bottom - top, 1e-9);
  }

  /** Shows the box, with a margin. */
  #frame() {
    const [left, top, right, bottom] = this.#box;
    const margin = 0.08 * this.#size();
    this.#svg.setAttribute("viewBox", [left - margin, top - margin, right - left + 2 * margin, bottom - top + 2 * margin].join(" "));
  }

  /** Marks rooms by their ids as where the camera is, or may be. */
  mark(here, maybe = []) {
    for (const group of this.#svg.querySelectorAll(".plan-room")) {
      const { room } = group.dataset;
      group.dataset.state = room === here ? "here" : maybe.includes(room) ? "maybe" : "";
    }
  }

  /** Puts the dot where a camera stands; without one it stays, paler, where it was. */
  point(placement) {
    const camera = this.#svg.querySelector(".plan-camera");
    camera.classList.toggle("plan-stale", !placement);
    if (placement) {
      const m = placement.worldFromCamera;
      const { x, y, z } = placement.position;
      const at = this.#drawn.to2d([x, y, z]);
      const ahead = this.#drawn.to2d([m[2], m[6], m[10]]);
      // A camera may stand where no outline reaches.
      const [left, top, right, bottom] = this.#box;
      this.#box = [Math.min(left, at[0]), Math.min(top, at[1]), Math.max(right, at[0]), Math.max(bottom, at[1])];
      this.#frame();
      this.#last = { at, turn: (180 / Math.PI) * Math.atan2(ahead[1], ahead[0]) };
    }
    if (!this.#last) return camera.setAttribute("hidden", "");
    const { at, turn } = this.#last;
    camera.removeAttribute("hidden");
    camera.setAttribute("transform", `translate(${at[0]} ${at[1]}) rotate(${turn})`);
  }
}
