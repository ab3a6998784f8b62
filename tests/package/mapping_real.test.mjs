// The page's mapping with the real mapper: pictures of the sample room become a place, and the page is located in it.
import assert from "node:assert/strict";
import { existsSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { artefact, browser, haveSample, keptOffline, open, sampleFiles, serve } from "./page.mjs";
import { site } from "./support.mjs";

const skip = !haveSample() ? "the sample scene is not there: run `cargo xtask sample`" : existsSync(join(site(), "vendor/landline/mapper/index.js")) ? false : "the package has no mapper";

const heading = (page, text) => page.waitForFunction((wanted) => new RegExp(wanted).test(document.querySelector("#mapping-title")?.textContent), text);
const distance = (a, b) => Math.hypot(...a.map((value, axis) => value - b[axis]));

/** The camera's position of a row-major matrix from world to camera. */
function positionOf(m) {
  const [r, t] = [m.map((row) => row.slice(0, 3)), m.map((row) => row[3])];
  return [0, 1, 2].map((axis) => -(r[0][axis] * t[0] + r[1][axis] * t[1] + r[2][axis] * t[2]));
}

test("pictures become a place, the place is located in, and it works without a network", { skip, timeout: 240_000 }, async (t) => {
  // The sample's pictures are test pictures, far apart; these ten show enough of the same.
  const { camera, ...sample } = await sampleFiles();
  const pictures = sample.pictures.slice(6, 16);
  const server = await serve(t);
  const { page, said, context } = await open(await browser(t), `${server.url}?dwell=100000`);
  await page.waitForFunction(() => globalThis.landlinePage?.state.relocalizer);
  await keptOffline(page);
  await page.click("[data-source=map]");
  await page.setInputFiles("#map-pictures", pictures.map(({ path }) => path));
  await heading(page, "of your place is mapped|Your place is mapped");
  await page.waitForSelector("#map-result-view canvas");
  await page.waitForFunction(() => /^Kept in My places/.test(document.querySelector("#map-kept").textContent));
  const summary = await page.textContent("#map-summary");
  t.diagnostic(summary);
  await page.screenshot({ path: artefact("map-real.png") });
  const left = await page.$$eval("#map-problems li p", (all) => all.flatMap((row) => row.textContent.split(", ")));
  const placed = pictures.filter(({ name }) => !left.includes(name));
  assert.ok(placed.length >= 4, `${placed.length} pictures have a place`);
  await page.click("#map-try");
  await page.waitForFunction(() => document.querySelector("#empty-title").textContent === "The scene is loaded");
  await page.fill("#focal", String(camera.fx));
  const seen = [];
  for (const { name, path, cam_from_world } of placed.slice(0, 6)) {
    await page.setInputFiles("#open-media", path);
    await page.waitForFunction((wanted) => document.querySelector("#stage-tag").textContent === wanted && globalThis.landlinePage.state.result, name);
    const { position, units } = await page.evaluate(() => ({ position: globalThis.landlinePage.state.result.placement?.position, units: globalThis.landlinePage.state.result.units }));
    assert.equal(units, "scene-units", "nobody said how large it is");
    if (position) seen.push({ at: Object.values(position), truth: positionOf(cam_from_world) });
  }
  t.diagnostic(`placed: ${placed.map(({ name }) => name).join(" ")}; ${seen.length} of ${Math.min(6, placed.length)} are located`);
  assert.ok(seen.length >= 3);
  // One scale between the map and the room: the same for every two pictures that stand well apart.
  const ratios = seen.flatMap((a, i) => seen.slice(i + 1).filter((b) => distance(a.truth, b.truth) > 0.5).map((b) => distance(a.at, b.at) / distance(a.truth, b.truth))).sort((a, b) => a - b);
  const middle = ratios[ratios.length >> 1];
  t.diagnostic(`units a metre: ${ratios.map((ratio) => ratio.toFixed(3)).join(" ")}`);
  assert.ok(ratios.filter((ratio) => Math.abs(ratio / middle - 1) < 0.05).length >= 0.6 * ratios.length && ratios.length >= 3, "the map has the room's shape");

  // All of it once more with the server gone: the page, the mapper and the place are on this device.
  await page.close();
  server.state.down = true;
  const offline = await context.newPage();
  offline.setDefaultTimeout(60_000);
  await offline.goto(`${server.url}?dwell=100000`);
  await offline.waitForFunction(() => globalThis.landlinePage);
  await offline.click("[data-source=map]");
  await offline.waitForSelector(".map-list li");
  await offline.setInputFiles("#map-pictures", placed.slice(0, 2).map(({ path }) => path));
  await heading(offline, "Too few pictures|No map came of it|place is mapped");
  assert.match(await offline.textContent("#bytes-sent"), /^0 bytes sent$/);
  assert.deepEqual(said, []);
});
