/** Where in the world a tap in a picture is: on the ray through it, as far away as what the map has around it. */

/** Share of the picture's width within which something of the map has to be seen. */
const reach = 0.06;
/** The nearest so many decide. */
const voters = 3;

/**
 * World point of a tap at shares `u`, `v` of a picture's width and height, or `undefined` where the map has nothing near.
 * `pose` is camera to world, row-major. Lines count by the point of theirs that is nearest to the tap.
 */
export function point({ map, intrinsics: k }, pose, u, v) {
  const tap = [u * k.width, v * k.height];
  const near = [];
  const limit = reach * k.width;
  const take = (p) => {
    const pixel = p[2] > 0 ? [(k.fx * p[0]) / p[2] + k.cx, (k.fy * p[1]) / p[2] + k.cy] : undefined;
    if (!pixel) return;
    const distance = Math.hypot(pixel[0] - tap[0], pixel[1] - tap[1]);
    if (distance < limit) near.push([distance, p[2]]);
  };
  for (let i = 0; i + 2 < map.points.length; i += 3) take(toCamera(pose, map.points, i));
  for (let i = 0; i + 5 < (map.lines?.length ?? 0); i += 6) {
    const [a, b] = [toCamera(pose, map.lines, i), toCamera(pose, map.lines, i + 3)];
    // Enough steps that one of them is within a few pixels of the nearest.
    for (let j = 0; j <= 32; j++) take(a.map((value, axis) => value + (j / 32) * (b[axis] - value)));
  }
  if (near.length === 0) return undefined;
  near.sort(([a], [b]) => a - b);
  // What is seen near the tap may lie before or behind it: the middle one of the nearest decides.
  const depths = near.slice(0, voters).map(([, depth]) => depth).sort((a, b) => a - b);
  const depth = depths[depths.length >> 1];
  const camera = [((tap[0] - k.cx) / k.fx) * depth, ((tap[1] - k.cy) / k.fy) * depth, depth];
  return [0, 4, 8].map((row) => pose[row] * camera[0] + pose[row + 1] * camera[1] + pose[row + 2] * camera[2] + pose[row + 3]);
}

/** World point in camera space: the inverse of camera to world. */
function toCamera(m, numbers, at) {
  const d = [numbers[at] - m[3], numbers[at + 1] - m[7], numbers[at + 2] - m[11]];
  return [0, 1, 2].map((column) => m[column] * d[0] + m[4 + column] * d[1] + m[8 + column] * d[2]);
}

export const length = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
