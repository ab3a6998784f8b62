/** Which way is up in a map. */

const unit = ({ x, y, z }) => {
  const length = Math.hypot(x, y, z);
  return length > 1e-9 ? { x: x / length, y: y / length, z: z / length } : undefined;
};

/** Up in a map; where it is not known, the average of the cameras' own: people hold their devices more or less upright. */
export function upOf({ up, pictures }) {
  if (up) return up;
  const sum = { x: 0, y: 0, z: 0 };
  for (const { placement } of pictures) {
    if (!placement) continue;
    sum.x -= placement.worldFromCamera[1];
    sum.y -= placement.worldFromCamera[5];
    sum.z -= placement.worldFromCamera[9];
  }
  return unit(sum) ?? { x: 0, y: -1, z: 0 };
}

/** `up` tilted by two angles in degrees, about two axes across it. */
export function tilted(up, forwardDeg, sidewaysDeg) {
  const helper = Math.abs(up.x) < 0.8 ? { x: 1, y: 0, z: 0 } : { x: 0, y: 0, z: 1 };
  const cross = (a, b) => ({ x: a.y * b.z - a.z * b.y, y: a.z * b.x - a.x * b.z, z: a.x * b.y - a.y * b.x });
  const across = unit(cross(helper, up));
  const along = cross(up, across);
  const [f, s] = [forwardDeg, sidewaysDeg].map((degrees) => Math.tan((degrees * Math.PI) / 180));
  return unit({ x: up.x + f * along.x + s * across.x, y: up.y + f * along.y + s * across.y, z: up.z + f * along.z + s * across.z });
}
