/**
 * The map as the page has seen it: predicted 3D points and lines that agreed with a found position.
 *
 * A scene file holds networks, not a list of lines; what they know shows only when they are asked. Things that fall into
 * the same cell are the same thing, and the newest prediction with the higher confidence stays.
 */
const maxLines = 4000;
const maxPoints = 20000;

export class SeenMap {
  #lines = new Map();
  #points = new Map();
  #size;
  /** Grows with every change. */
  version = 0;

  /** `cell` is the size below which two things count as one, in units of the scene. */
  constructor(cell = 0.08) {
    this.#size = cell;
  }

  get numLines() {
    return this.#lines.size;
  }

  get numPoints() {
    return this.#points.size;
  }

  /** All lines: six numbers each. */
  lines() {
    return this.#lines.values();
  }

  points() {
    return this.#points.values();
  }

  clear() {
    this.#lines.clear();
    this.#points.clear();
    this.version += 1;
  }

  /** Takes over what agrees with the position. */
  add(result) {
    if (!result.placement) return;
    const { lines, points } = result;
    if (lines) {
      for (let i = 0; i < lines.isInlier.length; i++) {
        if (lines.isInlier[i]) this.#addLine(lines.world.slice(6 * i, 6 * i + 6));
      }
    }
    if (points) {
      for (let i = 0; i < points.isInlier.length; i++) {
        if (points.isInlier[i]) this.#keep(this.#points, this.#cell(points.world, 3 * i), points.world.slice(3 * i, 3 * i + 3), maxPoints);
      }
    }
    this.version += 1;
  }

  #addLine(line) {
    if (!line.every(Number.isFinite)) return;
    const a = this.#cell(line, 0, 2);
    const b = this.#cell(line, 3, 2);
    this.#keep(this.#lines, a < b ? `${a}/${b}` : `${b}/${a}`, line, maxLines);
  }

  #keep(store, key, value, limit) {
    if (store.size >= limit && !store.has(key)) return;
    store.set(key, value);
  }

  #cell(numbers, at, factor = 1) {
    const s = this.#size * factor;
    return `${Math.round(numbers[at] / s)},${Math.round(numbers[at + 1] / s)},${Math.round(numbers[at + 2] / s)}`;
  }
}
