// node locate.mjs my-room.landline picture.jpg [focal length in pixels]
// Needs: npm install landline jpeg-js
import { readFile } from "node:fs/promises";
import jpeg from "jpeg-js";
import { Relocalizer } from "landline";

const [scene, picture, focal] = process.argv.slice(2);
const relocalizer = await Relocalizer.create({ scene });
const { data, width, height } = jpeg.decode(await readFile(picture), { useTArray: true });
const f = Number(focal);
const intrinsics = f > 0 ? { fx: f, fy: f, cx: width / 2, cy: height / 2, width, height } : undefined;

const result = await relocalizer.locate({ data, width, height, format: "rgba8" }, { intrinsics });
if (result.located) {
  const { position, rotation } = result.placement;
  console.log(JSON.stringify({ position, rotation, focal: result.intrinsics.fx, inliers: result.quality.pointInliers + result.quality.lineInliers }));
} else {
  console.log(`not located: ${result.reason}`);
}
await relocalizer.dispose();
