// Poses of the same pixels natively, under Node and in Chromium. `cargo xtask demo` prints how far they agree, and
// tests/package/parity.test.mjs holds them to it.
//
// As a program: node poses.mjs FOLDER LIST SCENE PACKAGE SITE [CHROMIUM]
// FOLDER holds what `landline demo --save` wrote: poses.json and the pixels of each picture. SITE is an address.
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const root = fileURLToPath(new URL("../../", import.meta.url));

/** Frames as the engine takes them, from the files beside poses.json. */
export async function readFrames(folder, list) {
  const { width, height } = list.camera;
  return Promise.all(list.pictures.map(async ({ name }) => ({ data: new Uint8Array(await readFile(join(folder, `${name}.rgb`))), width, height, format: "rgb8" })));
}

/** `cameraFromWorld` of each frame by the package in this folder, `null` where it is not located. */
export async function posesUnderNode(packageFolder, scene, frames, camera) {
  const { Relocalizer } = await import(pathToFileURL(join(packageFolder, "index.js")));
  const relocalizer = await Relocalizer.create({ scene, device: "cpu", build: "plain" });
  const poses = [];
  for (const frame of frames) {
    const { placement } = await relocalizer.locate(frame, { intrinsics: camera });
    poses.push(placement ? [...placement.cameraFromWorld] : null);
  }
  await relocalizer.dispose();
  return poses;
}

/** The same in a page of the staged site, by a build of the engine; `scene` is the scene's path on that site. */
export async function posesInChromium(page, scene, frames, camera, build = "plain") {
  await page.evaluate(async ({ scene, build }) => {
    const { Relocalizer } = await import("/vendor/landline/index.js");
    globalThis.relocalizer = await Relocalizer.create({ scene, device: "cpu", build });
  }, { scene, build });
  const poses = [];
  for (const { data, ...frame } of frames) {
    const pose = await page.evaluate(
      async ({ base64, frame, camera }) => {
        const data = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
        const { placement } = await globalThis.relocalizer.locate({ ...frame, data }, { intrinsics: camera });
        return placement ? [...placement.cameraFromWorld] : null;
      },
      { base64: Buffer.from(data).toString("base64"), frame, camera },
    );
    poses.push(pose);
  }
  return poses;
}

const median = (values) => {
  const sorted = [...values].sort((a, b) => a - b);
  return (sorted[Math.floor((sorted.length - 1) / 2)] + sorted[Math.ceil((sorted.length - 1) / 2)]) / 2;
};
const center = (m) => [0, 1, 2].map((c) => -(m[c] * m[3] + m[4 + c] * m[7] + m[8 + c] * m[11]));

/** Located pictures, and the median distance of the camera from where it was; not located counts as infinitely far. */
export function accuracy(poses, list) {
  const errors = poses.map((pose, i) => {
    const truth = center(list.pictures[i].cam_from_world.flat());
    return pose ? Math.hypot(...center(pose).map((v, k) => v - truth[k])) : Infinity;
  });
  return { located: poses.filter(Boolean).length, medianMm: 1000 * median(errors) };
}

/** Largest distance of the camera in millimetres and largest angle in degrees between poses of the same pictures. */
export function apart(a, b) {
  const each = a.map((pose, i) => {
    if (!pose || !b[i]) return pose === b[i] ? [0, 0] : [Infinity, Infinity];
    const [p, q] = [center(pose), center(b[i])];
    // The angle by the length of the difference of rotations, which small angles do not drown in rounding.
    const squares = [0, 1, 2].flatMap((r) => [0, 1, 2].map((c) => (pose[4 * r + c] - b[i][4 * r + c]) ** 2));
    const angle = 2 * Math.asin(Math.min(1, Math.sqrt(squares.reduce((sum, v) => sum + v, 0) / 8)));
    return [1000 * Math.hypot(...p.map((v, k) => v - q[k])), (180 / Math.PI) * angle];
  });
  return { mm: Math.max(...each.map(([mm]) => mm)), deg: Math.max(...each.map(([, deg]) => deg)) };
}

/** Largest difference between entries of two poses of one picture; infinite where only one of them is there. */
export function difference(a, b) {
  return Math.max(...a.map((pose, i) => (pose && b[i] ? Math.max(...pose.map((v, k) => Math.abs(v - b[i][k]))) : pose === b[i] ? 0 : Infinity)));
}

async function main([folder, listFile, scene, packageFolder, site, chromium]) {
  const list = JSON.parse(await readFile(listFile, "utf8"));
  const frames = await readFrames(folder, list);
  const rows = { native: JSON.parse(await readFile(join(folder, "poses.json"), "utf8")).map((row) => row.cam_from_world) };
  rows.Node = await posesUnderNode(packageFolder, scene, frames, list.camera);
  if (chromium) {
    const { chromium: launcher } = createRequire(join(root, "web/package.json"))("playwright-core");
    const browser = await launcher.launch({ executablePath: chromium, headless: true, args: ["--no-sandbox"] });
    try {
      const page = await browser.newPage();
      page.setDefaultTimeout(600_000);
      await page.goto(new URL("files.json", site).href);
      rows.Chromium = await posesInChromium(page, "/scenes/sample/sample.landline", frames, list.camera);
    } finally {
      await browser.close();
    }
  }
  for (const [where, poses] of Object.entries(rows)) {
    const { located, medianMm } = accuracy(poses, list);
    const against = where === "native" ? "" : `, entries of poses within ${difference(poses, rows.native).toExponential(1)} of native`;
    console.log(`${where.padEnd(9)} ${located} of ${poses.length} located, median error ${medianMm.toFixed(3)} mm${against}`);
  }
  if (!chromium) console.log("Chromium  none on this machine; name one in CHROME, or see the page");
}

if (process.argv[1] === fileURLToPath(import.meta.url)) await main(process.argv.slice(2));
