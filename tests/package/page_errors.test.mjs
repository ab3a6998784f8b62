// What goes wrong on real machines, and what the page says then.
import assert from "node:assert/strict";
import { test } from "node:test";
import { browser, haveSample, located, open, serve } from "./page.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

/** Title, text and code of the dialog that is open. */
async function problem(page) {
  await page.waitForSelector("#problem[open]");
  const read = (id) => page.textContent(`#problem-${id}`);
  return { title: await read("title"), text: await read("text"), hint: await read("hint"), code: await read("code") };
}

test("no camera", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), server.url, { permissions: ["camera"] });
  await located(page);
  await page.click("[data-source=camera]");
  const shown = await problem(page);
  assert.equal(shown.code, "camera-unavailable");
  assert.match(shown.hint, /picture or a video/);
  await page.keyboard.press("Escape");
  await page.click("[data-source=sample]");
  await located(page);
});

test("a scene file that is none", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), server.url);
  await located(page);
  await page.setInputFiles("#open-scene", { name: "holiday.landline", mimeType: "application/octet-stream", buffer: Buffer.from("this is not a scene file at all") });
  const shown = await problem(page);
  assert.equal(shown.code, "scene-corrupt");
  assert.match(shown.text, /header|file/i);
  await page.keyboard.press("Escape");
  // The scene from before is still in use.
  const result = await page.evaluate(async () => {
    const { relocalizer } = globalThis.landlinePage.state;
    return (await relocalizer.locate({ data: new Uint8Array(64 * 64), width: 64, height: 64, format: "luma8" })).reason;
  });
  assert.equal(typeof result, "string");
});

test("network cut while the weights load, then back", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t, { faults: { ".landline": { cutAt: 20_000 } } });
  const { page } = await open(await browser(t), server.url);
  const shown = await problem(page);
  assert.equal(shown.code, "asset-fetch");
  assert.match(shown.text, /connection broke|ended after/);
  server.state.faults = {};
  await page.keyboard.press("Escape");
  await page.click("#retry-load");
  await located(page);
});

test("the server sends its start page instead of the weights", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t, { faults: { ".safetensors": { body: "<!doctype html><title>Home</title>", type: "text/html" } } });
  const { page } = await open(await browser(t), server.url);
  const shown = await problem(page);
  assert.equal(shown.code, "asset-fetch");
  assert.match(shown.text, /web page/);
});

test("wasm with a wrong MIME type still runs", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t, { faults: { ".wasm": { type: "text/plain" } } });
  const { page } = await open(await browser(t), server.url);
  await located(page);
});

test("something else instead of the wasm", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t, { faults: { ".wasm": { body: "404: but with status 200", type: "application/octet-stream" } } });
  const { page } = await open(await browser(t), server.url);
  const shown = await problem(page);
  assert.equal(shown.code, "asset-mime");
  assert.match(shown.text, /34 30 34 3a/);
});

test("the backend can be chosen, and the page says what it got", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?dwell=0`);
  await located(page);
  await page.selectOption("#device", "cpu");
  await page.waitForFunction(() => /asked for/.test(document.querySelector("#device-note").textContent));
  await located(page);
  assert.equal(await page.textContent("#backend"), "CPU");
});

test("pictures that cannot be decoded leave the page usable", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), server.url);
  await located(page);
  await page.setInputFiles("#open-media", { name: "broken.jpg", mimeType: "image/jpeg", buffer: Buffer.from("not a picture") });
  await page.waitForFunction(() => /decoded/.test(document.querySelector("#status-detail").textContent));
  await page.click("[data-source=sample]");
  await located(page);
});

test("empty files are called empty, and the words are of the last thing that was tried", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), server.url);
  await located(page);
  const said = () => page.textContent("#status-detail");
  await page.setInputFiles("#open-media", { name: "empty.jpg", mimeType: "image/jpeg", buffer: Buffer.alloc(0) });
  await page.waitForFunction(() => /empty\.jpg/.test(document.querySelector("#status-detail").textContent));
  assert.equal(await said(), "“empty.jpg” is empty. Copy or download it again.");
  await page.setInputFiles("#open-media", { name: "walk.mp4", mimeType: "video/mp4", buffer: Buffer.alloc(0) });
  const shown = await problem(page);
  assert.equal(shown.text, "“walk.mp4” is empty.");
  assert.equal(await said(), "“walk.mp4” is empty. Copy or download it again.");
  await page.keyboard.press("Escape");
  // A scene that is cut off: nothing of how such a file is built.
  const whole = await (await fetch(new URL("scenes/sample/sample.landline", server.url))).arrayBuffer();
  await page.setInputFiles("#open-scene", { name: "cut.landline", mimeType: "application/octet-stream", buffer: Buffer.from(whole.slice(0, 200_000)) });
  const cut = await problem(page);
  assert.deepEqual([cut.text, cut.code], ["The file is cut off or damaged.", "scene-corrupt"]);
});
