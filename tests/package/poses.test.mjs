// Files of known poses, as the page's evaluation reads them.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { pathToFileURL } from "node:url";
import { root } from "./support.mjs";

// The page's scripts are modules without a package.json of their own, so Node gets the text; the page's import map, which
// says where the package is, is for browsers.
const packageUrl = pathToFileURL(join(root, "dist/npm/landline/index.js")).href;
const script = (await readFile(join(root, "www/poses.js"), "utf8")).replace('from "landline"', `from "${packageUrl}"`);
const { parseCameras, parseColmap, parseList, parseMatrix, readPoses } = await import(`data:text/javascript,${encodeURIComponent(script)}`);

const s = Math.SQRT1_2;
/** A quarter turn about z, then one metre along x: world to camera. */
const turned = [0, -1, 0, 1, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
/** The same as camera to world. */
const inverse = "0 1 0 0\n-1 0 0 1\n0 0 1 0\n0 0 0 1";
const same = (a, b) => assert.ok(a.every((v, i) => Math.abs(v - b[i]) < 1e-12), `${[...a]}`);
const file = (name, text) => new File([text], name);

test("a list with focal lengths, one with matrices, and lines that are neither", () => {
  const { poses, skipped } = parseList(`# comment\nrgb/a.jpg ${s} 0 0 ${s} 1 0 0 585\nb.jpg ${inverse.replaceAll("\n", " ")}\nc.jpg 1 2 3\nd.jpg 0 0 0 0 1 2 3\ne.jpg 1 0 0 x 0 0 0\n`);
  same(poses.get("a.jpg").cameraFromWorld, turned);
  assert.equal(poses.get("a.jpg").focal, 585);
  same(poses.get("b.jpg").cameraFromWorld, turned);
  assert.equal(skipped, 3);
  assert.equal(poses.size, 2);
});

test("COLMAP's text model, with an empty second line and a name with a space", () => {
  const { cameras, ignored } = parseCameras("# list\n1 SIMPLE_PINHOLE 640 480 585 320 240\n2 OPENCV 640 480 500 501 320 240 0.1 0 0 0\n3 FISHEYE 1 1 1\n");
  assert.deepEqual(cameras.get("2"), { fx: 500, fy: 501, cx: 320, cy: 240, width: 640, height: 480 });
  assert.equal(ignored, 2);
  const { poses, skipped } = parseColmap(`# two lines each\n7 ${s} 0 0 ${s} 1 0 0 1 left/a b.jpg\n\n8 1 0 0 0 0 0 0 2 c.jpg\n10 20 -1 30 40 5\n`, cameras);
  same(poses.get("a b.jpg").cameraFromWorld, turned);
  assert.equal(poses.get("a b.jpg").intrinsics.fx, 585);
  assert.equal(poses.get("c.jpg").intrinsics.fy, 501);
  assert.equal(skipped, 0);
});

test("a matrix beside each picture, as 7-Scenes has", async () => {
  same(parseMatrix(inverse).cameraFromWorld, turned);
  assert.equal(parseMatrix("1 2 3"), undefined);
  const known = await readPoses([file("frame-000001.pose.txt", inverse), file("frame-000002.pose.txt", "nan"), file("frame-000001.color.png", "")]);
  same(known.find("frame-000001.color.png").cameraFromWorld, turned);
  assert.equal(known.find("frame-000002.color.png"), undefined);
  assert.match(known.notes.join(" "), /1 of the \.pose\.txt files/);
});

test("the page's own list, and nothing at all", async () => {
  const list = { camera: { fx: 1 }, pictures: [{ name: "q.jpg", cam_from_world: [0, 1, 2, 3].map((r) => turned.slice(4 * r, 4 * r + 4)) }] };
  const known = await readPoses([file("sample.json", JSON.stringify(list))]);
  same(known.find("q.jpg").cameraFromWorld, turned);
  assert.equal(known.find("q.jpg").intrinsics.fx, 1);
  assert.equal((await readPoses([file("other.json", "{")])).find("q.jpg"), undefined);
});
