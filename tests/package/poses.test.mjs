// Poses from the files that data sets come with: the package's reader under Node, and what the page gives to it.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { pathToFileURL } from "node:url";
import { root } from "./support.mjs";

const { readPoses } = await import(pathToFileURL(join(root, "dist/npm/landline/mapper/index.js")).href);
// The page's scripts are modules without a package.json of their own, so Node gets the text.
const script = (await readFile(join(root, "www/poses.js"), "utf8")).replace('import { loadMapper } from "./mapper.js";', "const loadMapper = undefined;");
const page = await import(`data:text/javascript,${encodeURIComponent(script)}`);

const s = Math.SQRT1_2;
/** A quarter turn about z, then one metre along x: world to camera. */
const turned = [0, -1, 0, 1, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
/** The same as camera to world. */
const inverse = "0 1 0 0\n-1 0 0 1\n0 0 1 0\n0 0 0 1";
const same = (pose, b) => assert.ok(pose.cameraFromWorld instanceof Float64Array && pose.cameraFromWorld.every((v, i) => Math.abs(v - b[i]) < 1e-12), JSON.stringify(pose));
const bytes = (text) => new TextEncoder().encode(text);
const read = (pictures, files) => readPoses(pictures, Object.entries(files).map(([path, text]) => ({ path, bytes: bytes(text) })));

test("a list with focal lengths, and one of matrices", async () => {
  const list = await read(["x/rgb/a.jpg", "x/c.jpg"], { "x/poses.txt": `# comment\nrgb/a.jpg ${s} 0 0 ${s} 1 0 0 585\n` });
  same(list.poses[0], turned);
  assert.equal(list.poses[0].focal, 585);
  assert.equal(list.poses[1], null);
  assert.equal(list.source, "x/poses.txt");
  const matrices = await read(["b.jpg"], { "poses.txt": `b.jpg ${inverse.replaceAll("\n", " ")}\n` });
  same(matrices.poses[0], turned);
});

test("a line that is broken names itself, and a scaled matrix is no pose", async () => {
  const broken = await read(["a.jpg", "e.jpg"], { "poses.txt": "a.jpg 1 0 0 0 0 0 0\ne.jpg 1 0 0 x 0 0 0\n" });
  assert.deepEqual(broken.poses, [null, null]);
  assert.match(broken.notes.join(" "), /poses\.txt, line 2/);
  const scaled = await read(["a.png"], { "poses.txt": "a.png 2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1\n" });
  assert.deepEqual(scaled.poses, [null]);
  assert.match(scaled.notes.join(" "), /similarity/);
});

test("COLMAP's text model: an empty second line, a name with a space, a distorted camera", async () => {
  const cameras = "# list\n1 SIMPLE_PINHOLE 640 480 585 320 240\n2 OPENCV 640 480 500 501 320 240 0.1 0 0 0\n";
  const images = `# two lines each\n7 ${s} 0 0 ${s} 1 0 0 1 left/a b.jpg\n\n8 1 0 0 0 0 0 0 2 c.jpg\n10 20 -1 30 40 5\n`;
  const { poses, notes, source } = await read(["r/left/a b.jpg", "r/c.jpg"], { "sparse/0/images.txt": images, "sparse/0/cameras.txt": cameras });
  same(poses[0], turned);
  assert.equal(poses[0].intrinsics.fx, 585);
  assert.deepEqual(poses[1].intrinsics, { fx: 500, fy: 501, cx: 320, cy: 240, width: 640, height: 480 });
  assert.match(notes.join(" "), /distortion of 1 camera/);
  assert.match(source, /COLMAP/);
});

test("a matrix beside each picture; pictures of one name in two folders keep their own", async () => {
  const other = inverse.replace("-1 0 0 1", "-1 0 0 2");
  const { poses, notes } = await read(["one/f-1.color.png", "two/f-1.color.png", "two/f-2.color.png"], { "one/f-1.pose.txt": inverse, "two/f-1.pose.txt": other, "two/f-2.pose.txt": "nan ".repeat(16) });
  same(poses[0], turned);
  same(poses[1], turned.with(3, 2));
  assert.equal(poses[2], null);
  assert.equal(notes.length, 1);
});

test("arguments are checked by name", async () => {
  await assert.rejects(readPoses("a.jpg", []), /pictures is .*a list of paths/);
  await assert.rejects(readPoses([], [{ path: "poses.txt", bytes: "text" }]), /files is .*Uint8Array/);
  await assert.rejects(readPoses([], [], { extractor: "x" }), /no option "extractor"/);
});

test("the page gives paths where it knows them, reads its own list, and says what could not be read", async () => {
  const file = (name, text, droppedPath) => Object.assign(new File([text], name), droppedPath ? { droppedPath } : {});
  const asked = [];
  const load = async () => ({
    readPoses: async (pictures, files) => {
      asked.push([pictures, files.map(({ path }) => path)]);
      return readPoses(pictures, files);
    },
  });
  const pictures = [file("f-1.png", "", "r/one/f-1.png"), file("f-1.png", "", "r/two/f-1.png")];
  const files = [...pictures, file("f-1.pose.txt", inverse, "r/two/f-1.pose.txt"), file("points3D.txt", "1"), file("scene.landline", "")];
  const known = await page.readPoses(pictures, files, load);
  assert.deepEqual(asked, [[["r/one/f-1.png", "r/two/f-1.png"], ["r/two/f-1.pose.txt"]]]);
  assert.equal(known.poses[0], null);
  same(known.poses[1], turned);

  const list = { camera: { fx: 1 }, pictures: [{ name: "q.jpg", cam_from_world: [0, 1, 2, 3].map((r) => turned.slice(4 * r, 4 * r + 4)) }] };
  const own = await page.readPoses([file("q.jpg", "")], [file("sample.json", JSON.stringify(list))], load);
  same(own.poses[0], turned);
  assert.equal(own.poses[0].intrinsics.fx, 1);
  assert.deepEqual((await page.readPoses([file("q.jpg", "")], [file("other.json", "{")], load)).poses, [null]);

  const away = async () => Promise.reject(Object.assign(new Error("the mapping part of the engine could not be loaded"), { hint: "Connect." }));
  const unread = await page.readPoses([file("q.jpg", "")], [file("poses.txt", "q.jpg 1 0 0 0 0 0 0")], away);
  assert.deepEqual(unread.poses, [null]);
  assert.match(unread.notes[0], /could not be loaded\. Connect\./);
});
