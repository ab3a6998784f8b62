// Real pictures through the page: the test frames of RedKitchen with a scene that was trained on its other frames.
//
// The scene is made by hand (minutes of training) and read from target/redkitchen.landline:
//   landline labels ../shared/data/redkitchen --train 0..800 -o target/redkitchen.labels
//   landline train target/redkitchen.labels --out target/redkitchen.landline
import assert from "node:assert/strict";
import { existsSync, readdirSync } from "node:fs";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { artefact, browser, fakeCamera, open, serve } from "./page.mjs";
import { root } from "./support.mjs";

const data = join(root, "../shared/data/redkitchen");
const scene = process.env.LANDLINE_REDKITCHEN ?? join(root, "target/redkitchen.landline");
const skip = !existsSync(data) ? "../shared/data/redkitchen is not there" : !existsSync(scene) ? `${scene} is not there; see the head of this file` : false;
const pictures = () => readdirSync(join(data, "rgb")).sort().slice(800, 900).map((name) => join(data, "rgb", name));
const focal = async () => Number((await readFile(join(data, "poses_sfm.txt"), "utf8")).split("\n").find((line) => line && !line.startsWith("#")).trim().split(/\s+/)[8]);

const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

test("recall of a dropped folder with ground truth", { skip, timeout: 900_000 }, async (t) => {
  const server = await serve(t);
  const { page, said } = await open(await browser(t), server.url);
  page.setDefaultTimeout(800_000);
  await page.waitForFunction(() => globalThis.landlinePage?.state.relocalizer);
  await page.selectOption("#device", "cpu");
  const names = new Set(pictures().map((path) => path.split("/").pop()));
  const poses = (await readFile(join(data, "poses_sfm.txt"), "utf8")).split("\n").filter((line) => names.has(line.split(/\s+/)[0].split("/").pop()));
  const folder = await mkdtemp(join(tmpdir(), "landline-redkitchen-"));
  t.after(() => rm(folder, { recursive: true, force: true }));
  await writeFile(join(folder, "poses_sfm.txt"), poses.join("\n"));
  await page.setInputFiles("#open-scene", scene);
  await page.waitForFunction(() => globalThis.landlinePage.state.scene?.isSample === false && !globalThis.landlinePage.state.loading && globalThis.landlinePage.state.relocalizer);
  // A folder input takes folders only; pictures and the list of poses also go the other way in.
  await page.setInputFiles("#open-media", [...pictures(), join(folder, "poses_sfm.txt")]);
  await page.waitForFunction(() => document.querySelector("#evaluation").dataset.done === "true");
  const rows = await page.evaluate(() => globalThis.landlinePage.state.rows.map(({ located, distance, degrees, timings, pointInliers, lineInliers }) => ({ located, distance, degrees, timings, pointInliers, lineInliers })));
  assert.equal(rows.length, 100);
  const good = (d, a) => rows.filter((row) => row.located && row.distance <= d && row.degrees <= a).length;
  const all = (key) => rows.map((row) => (row.located ? row[key] : Infinity));
  t.diagnostic(`${rows.filter((row) => row.located).length} located, ${good(0.05, 5)} within 5 cm and 5 degrees, ${good(0.02, 2)} within 2 cm and 2 degrees`);
  t.diagnostic(`median error ${(100 * median(all("distance"))).toFixed(2)} cm, ${median(all("degrees")).toFixed(2)} degrees; median inliers ${median(rows.map((r) => r.pointInliers))} points, ${median(rows.map((r) => r.lineInliers))} lines`);
  const stages = Object.keys(rows[0].timings).map((key) => `${key} ${median(rows.map((row) => row.timings[key])).toFixed(1)}`);
  t.diagnostic(`median milliseconds: ${stages.join(", ")}`);
  await page.screenshot({ path: artefact("redkitchen.png"), fullPage: true });
  assert.ok(good(0.05, 5) >= 80, "most frames within 5 cm and 5 degrees");
  assert.deepEqual(said, []);
});

test("a camera that shows RedKitchen, its focal length unknown", { skip, timeout: 400_000 }, async (t) => {
  const flags = await fakeCamera(t, pictures().filter((_, i) => i % 5 === 0), 15);
  const server = await serve(t);
  const { page } = await open(await browser(t, flags), server.url, { permissions: ["camera"] });
  await page.waitForFunction(() => globalThis.landlinePage?.state.relocalizer);
  await page.setInputFiles("#open-scene", scene);
  await page.waitForFunction(() => globalThis.landlinePage.state.scene?.isSample === false && !globalThis.landlinePage.state.loading);
  await page.click("[data-source=camera]");
  const seen = await page.evaluate(async () => {
    const results = [];
    const { relocalizer } = globalThis.landlinePage.state;
    await new Promise((done) => {
      relocalizer.addEventListener("result", ({ detail }) => {
        results.push({ located: detail.located, f: detail.intrinsics.fx / detail.frame.width, source: detail.intrinsics.source });
        if (results.length >= 60) done();
      });
      setTimeout(done, 200_000);
    });
    return results;
  });
  const truth = (await focal()) / 640;
  const last = seen.filter(({ located }) => located).at(-1);
  t.diagnostic(`${seen.filter(({ located }) => located).length} of ${seen.length} located; focal length ${(100 * (last?.f / truth - 1)).toFixed(1)} % off at the end (${last?.source})`);
  await page.screenshot({ path: artefact("redkitchen-camera.png") });
  assert.ok(seen.filter(({ located }) => located).length > seen.length / 2);
});
