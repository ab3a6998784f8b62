// A film of a small room that needs nothing but arithmetic: walls and boxes with patterns, rendered by casting rays. Poses are
// exact, and Node and browsers get the same bytes.

/** Numbers that look random and are the same everywhere. */
function dice(seed) {
  let state = seed >>> 0;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
}

const textureSide = 512;

/** Rectangles upon rectangles, from large to small: corners and edges at every distance. */
function texture(seed) {
  const next = dice(seed);
  const levels = new Uint8Array(textureSide * textureSide).fill(128);
  for (let i = 0; i < 500; i++) {
    const size = textureSide / (3 + i / 8);
    const [x0, y0] = [Math.floor(next() * textureSide), Math.floor(next() * textureSide)];
    const [x1, y1] = [Math.min(textureSide, x0 + 4 + Math.floor(next() * size)), Math.min(textureSide, y0 + 4 + Math.floor(next() * size))];
    const level = 30 + Math.floor(next() * 200);
    for (let y = y0; y < y1; y++) levels.fill(level, y * textureSide + x0, y * textureSide + x1);
  }
  return levels;
}

/** The room itself is seen from inside, the others from outside: lower and upper corner, y downwards, metres. */
const boxes = [
  { low: [-3, -1.4, -2], high: [3, 1.2, 3.5], inside: true },
  { low: [-1.6, 0.1, 1.9], high: [-0.8, 1.2, 2.5] },
  { low: [0.5, 0.4, 1.4], high: [1.2, 1.2, 2.0] },
  { low: [-0.3, -0.9, 2.6], high: [0.4, -0.2, 3.0] },
];
const textures = boxes.flatMap((_, b) => [0, 1, 2].map((axis) => texture(17 + 3 * b + axis)));

/** Grey value that a ray sees. */
function seen(eye, ray) {
  let [nearest, level] = [Infinity, 0];
  boxes.forEach(({ low, high, inside }, b) => {
    let [enter, leave, enterAxis, leaveAxis] = [-Infinity, Infinity, 0, 0];
    for (let axis = 0; axis < 3; axis++) {
      const [a, c] = [(low[axis] - eye[axis]) / ray[axis], (high[axis] - eye[axis]) / ray[axis]];
      if (Math.min(a, c) > enter) [enter, enterAxis] = [Math.min(a, c), axis];
      if (Math.max(a, c) < leave) [leave, leaveAxis] = [Math.max(a, c), axis];
    }
    const [t, axis] = inside ? [leave, leaveAxis] : [enter, enterAxis];
    if (enter > leave || t <= 0 || t >= nearest) return;
    const at = [0, 1, 2].filter((other) => other !== axis).map((other) => ((eye[other] + t * ray[other] + 10) * 0.4 * textureSide) % textureSide);
    nearest = t;
    level = textures[3 * b + axis][Math.floor(at[1]) * textureSide + Math.floor(at[0])];
  });
  return level;
}

export const camera = { fx: 270, fy: 270, cx: 160, cy: 120, width: 320, height: 240 };

/** `cameraFromWorld` of a camera at a place that is turned about the vertical axis. */
export function pose([x, y, z], yaw) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return [c, 0, -s, -(c * x - s * z), 0, 1, 0, -y, s, 0, c, -(s * x + c * z), 0, 0, 0, 1];
}

/** A grey frame; four rays a pixel. `light` darkens it. */
export function render(eye, yaw, light = 1) {
  const { width, height, fx, fy, cx, cy } = camera;
  const data = new Uint8Array(width * height);
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      let sum = 0;
      for (const [dx, dy] of [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]]) {
        const [u, v] = [(x + dx - cx) / fx, (y + dy - cy) / fy];
        sum += seen(eye, [c * u + s, v, c - s * u]);
      }
      data[y * width + x] = Math.round((light * sum) / 4);
    }
  }
  return { data, width, height, format: "luma8" };
}

/** A walk sideways that sways: place and direction of each frame. */
export function walk(count) {
  return Array.from({ length: count }, (_, i) => {
    const t = count > 1 ? i / (count - 1) : 0;
    return { eye: [-1.1 + 2.2 * t, 0.12 * Math.sin(7 * t), 0.25 * Math.sin(4 * t)], yaw: -0.15 + 0.3 * t };
  });
}

/** Place of a camera, from `cameraFromWorld`. */
export const centre = (m) => [0, 1, 2].map((i) => -(m[i] * m[3] + m[4 + i] * m[7] + m[8 + i] * m[11]));

export const distance = (a, b) => Math.hypot(...a.map((v, i) => v - b[i]));
