// The live camera, played from a file of sample pictures.
import assert from "node:assert/strict";
import { test } from "node:test";
import { artefact, browser, fakeCamera, haveSample, located, open, sampleFiles, sceneOfUnknownCamera, serve } from "./page.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

test("locates the camera's frames and tracks", { skip, timeout: 240_000 }, async (t) => {
  const { pictures, camera } = await sampleFiles();
  // Each picture stays for a second so that slow machines see it too.
  const flags = await fakeCamera(t, pictures.slice(0, 5).map(({ path }) => path), 30);
  const server = await serve(t);
  const { page, said } = await open(await browser(t, flags), server.url, { permissions: ["camera"] });
  await located(page);
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

test("learns the camera's focal length and knows it at the next visit", { skip, timeout: 240_000 }, async (t) => {
  const { pictures, camera } = await sampleFiles();
  const flags = await fakeCamera(t, pictures.slice(0, 8).map(({ path }) => path), 20);
  const server = await serve(t);
  const { page } = await open(await browser(t, flags), server.url, { permissions: ["camera"] });
  // A scene that does not know its camera: otherwise this one is it, and there is nothing to learn.
  const openScene = async () => {
    await located(page);
    await page.setInputFiles("#open-scene", { name: "room.landline", mimeType: "application/octet-stream", buffer: await sceneOfUnknownCamera() });
    await page.waitForFunction(() => globalThis.landlinePage.state.scene?.isSample === false && !globalThis.landlinePage.state.loading && globalThis.landlinePage.state.relocalizer);
  };
  await openScene();
  await page.click("[data-source=camera]");
  await page.waitForFunction(() => Object.keys(JSON.parse(localStorage.getItem("landline-cameras") ?? "{}")).length === 1);
  await page.reload();
  await openScene();
  await page.click("[data-source=camera]");
  await page.waitForFunction(() => globalThis.landlinePage.state.live && globalThis.landlinePage.state.result);
  const { intrinsics } = await page.evaluate(() => globalThis.landlinePage.state.result);
  t.diagnostic(`${intrinsics.source}: ${intrinsics.fx.toFixed(1)} of ${camera.fx}`);
  assert.equal(intrinsics.source, "remembered");
  assert.ok(Math.abs(intrinsics.fx / camera.fx - 1) < 0.03);
  // And forgets it when asked to, for as long as this visit lasts: the camera goes on, and has what would be kept.
  await page.click("#privacy");
  await page.click("#forget");
  await page.waitForFunction(() => document.querySelector("#forget").textContent === "Removed");
  const later = await page.evaluate(async () => {
    const { following } = globalThis.landlinePage.state.live;
    const learned = ({ located, intrinsics }) => located && intrinsics?.source === "remembered" && intrinsics.relativeSigma === undefined;
    let seen = 0;
    await new Promise((done) => following.addEventListener("result", ({ detail }) => learned(detail) && (seen += 1) === 2 && done()));
    return localStorage.getItem("landline-cameras");
  });
  assert.equal(later, null);
});

test("the status is of the frame that is shown", { skip, timeout: 240_000 }, async (t) => {
  const { pictures, camera } = await sampleFiles();
  // From one place to another without a way between: each time the position is lost until the next answer.
  const flags = await fakeCamera(t, pictures.slice(0, 6).map(({ path }) => path), 25);
  const server = await serve(t);
  const { page } = await open(await browser(t, flags), server.url, { permissions: ["camera"] });
  await located(page);
  await page.fill("#focal", String(camera.fx));
  await page.click("[data-source=camera]");
  await page.waitForFunction(() => globalThis.landlinePage.state.live && globalThis.landlinePage.state.result?.located);
  const seen = await page.evaluate(async () => {
    const { state } = globalThis.landlinePage;
    const counts = { lost: 0, found: 0, contradictions: [] };
    state.live.following.addEventListener("result", ({ detail }) => {
      const [word, tag] = ["#status-word", "#stage-tag"].map((what) => document.querySelector(what).textContent);
      counts[detail.located ? "found" : "lost"] += 1;
      if (!detail.located && (/Located/.test(word) || !/no position/.test(tag))) counts.contradictions.push(`${word}, ${tag}`);
    });
    const started = performance.now();
    while ((counts.lost < 5 || counts.found < 5) && performance.now() - started < 120_000) await new Promise((done) => setTimeout(done, 50));
    return counts;
  });
  assert.ok(seen.lost >= 5 && seen.found >= 5, JSON.stringify(seen));
  assert.deepEqual(seen.contradictions, []);
  assert.doesNotMatch(await page.textContent("#status"), /-features|excessive|frozen/);
});

test("offers the other cameras by name, and goes back to the sample", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const flags = ["--use-fake-device-for-media-stream=device-count=2", "--use-fake-ui-for-media-stream"];
  const { page } = await open(await browser(t, flags), server.url, { permissions: ["camera"] });
  await located(page);
  await page.click("[data-source=camera]");
  await page.waitForSelector("#camera-choice:not([hidden])");
  const names = await page.$$eval("#camera-select option", (all) => all.map((option) => option.textContent));
  assert.equal(names.length, 2);
  assert.notEqual(names[0], names[1]);
  const used = () => page.evaluate(() => globalThis.landlinePage.state.live?.camera.stream.getVideoTracks()[0].label);
  const before = await used();
  await page.selectOption("#camera-select", { label: names.find((name) => name !== before) });
  await page.waitForFunction((was) => {
    const label = globalThis.landlinePage.state.live?.camera.stream.getVideoTracks()[0].label;
    return label !== undefined && label !== was;
  }, before);
  await page.click("[data-source=sample]");
  await located(page);
  assert.equal(await used(), undefined, "the camera is off");
});

test("a camera that is refused", { skip, timeout: 240_000 }, async (t) => {
  // A camera is there, and the browser has no permission to give it: headless Chromium refuses by itself.
  const server = await serve(t);
  const { page } = await open(await browser(t, ["--use-fake-device-for-media-stream"]), server.url);
  await located(page);
  await page.click("[data-source=camera]");
  await page.waitForSelector("#problem[open]");
  assert.equal(await page.textContent("#problem-code"), "camera-denied");
  assert.match(await page.textContent("#problem-hint"), /Allow it/);
  await page.keyboard.press("Escape");
  assert.equal(await page.isVisible("#retry-load"), true, "it can be tried again");
  await page.click("[data-source=sample]");
  await located(page);
});
