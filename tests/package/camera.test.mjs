// The live camera, played from a file of sample pictures.
import assert from "node:assert/strict";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { artefact, browser, haveSample, open, serve } from "./page.mjs";
import { site } from "./support.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

test("locates the camera's frames and tracks", { skip }, async (t) => {
  const sample = join(site(), "scenes/sample");
  const { pictures, camera } = JSON.parse(await readFile(join(sample, "sample.json"), "utf8"));
  const folder = await mkdtemp(join(tmpdir(), "landline-camera-"));
  t.after(() => rm(folder, { recursive: true, force: true }));
  // Motion JPEG is JPEG files one after another; each stays for a second so that slow machines see it too.
  const frames = await Promise.all(pictures.slice(0, 5).map(({ name }) => readFile(join(sample, name))));
  await writeFile(join(folder, "walk.mjpeg"), Buffer.concat(frames.flatMap((frame) => Array(30).fill(frame))));
  const server = await serve(t);
  const launched = await browser(t, ["--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream", `--use-file-for-fake-video-capture=${join(folder, "walk.mjpeg")}`]);
  const { page, said } = await open(launched, server.url, { permissions: ["camera"] });
  await page.waitForSelector(".thumb[data-result=located]");
  await page.fill("#focal", String(camera.fx));
  await page.click("[data-source=camera]");
  const seen = await page.evaluate(async () => {
    const { relocalizer } = globalThis.landlinePage.state;
    const results = [];
    await new Promise((done) => {
      relocalizer.addEventListener("result", ({ detail }) => {
        results.push({ located: detail.located, state: detail.state, width: detail.frame.width });
        if (results.length >= 12) done();
      });
      setTimeout(done, 90_000);
    });
    return results;
  });
  t.diagnostic(`${seen.filter((r) => r.located).length} of ${seen.length} camera frames located`);
  assert.ok(seen.length >= 12, "frames arrive");
  assert.ok(seen.some(({ located }) => located), "some are located");
  assert.ok(seen.some(({ state }) => state === "tracking"), "and tracked");
  await page.screenshot({ path: artefact("camera.png") });
  assert.deepEqual(said, []);
});
