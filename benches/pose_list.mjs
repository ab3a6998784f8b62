// Lists of `NAME QW QX QY QZ TX TY TZ [more]`, camera from world.
import { readFile } from "node:fs/promises";
import { basename } from "node:path";

/** A line's seven numbers as 16, row-major. */
function poseOf([w, x, y, z, ...t]) {
  const n = Math.hypot(w, x, y, z);
  [w, x, y, z] = [w / n, x / n, y / n, z / n];
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), t[0]],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), t[1]],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), t[2]],
    [0, 0, 0, 1],
  ].flat();
}

/** The `cameraFromWorld` of each name without its folders, 16 numbers, row-major. */
export async function readPoses(file) {
  const lines = (await readFile(file, "utf8")).split("\n").map((line) => line.trim().split(/\s+/));
  return new Map(lines.filter((parts) => parts.length >= 8).map(([name, ...rest]) => [basename(name), poseOf(rest.slice(0, 7).map(Number))]));
}
