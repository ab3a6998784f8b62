// “Map this place”: from filming to a place that is kept and located in. The mapper is a stand-in that is quick and fails
// when it is told to; what the real one makes of a film is tested with the mapper.
import assert from "node:assert/strict";
import { readFile, readdir } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { brotliCompressSync } from "node:zlib";
import { artefact, browser, fakeCamera, haveSample, hide, keptOffline, located, open, recorded, sampleFiles, serve, violations } from "./page.mjs";
import { root, site } from "./support.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";
const phone = { viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true };

/** The page with the stand-in, its camera showing the sample's pictures. `told` is what the stand-in is told. */
async function mapping(test, { told = {}, options = {}, camera = false } = {}) {
  const { pictures } = await sampleFiles();
  const flags = camera ? await fakeCamera(test, pictures.slice(0, 12).map(({ path }) => path), 6) : [];
  const server = await serve(test);
  const launched = await browser(test, flags);
  const opened = await open(launched, undefined, { permissions: ["camera"], init: `globalThis.fakeMapper ??= ${JSON.stringify(told)}`, ...options });
  const fake = await readFile(join(root, "tests/package/fake_mapper.js"), "utf8");
  await opened.page.route("**/vendor/landline/mapper/index.js", (route) => route.fulfill({ contentType: "text/javascript", body: fake }));
  await opened.page.goto(`${server.url}?no-offline&dwell=100000`);
  await ready(opened.page);
  return { ...opened, server, pictures };
}

/** The page is there; what it opens with may still be loading. */
const ready = (page) => page.waitForFunction(() => globalThis.landlinePage);

const heading = (page, text) => page.waitForFunction((wanted) => document.querySelector("#mapping-title")?.textContent === wanted, text);
const keptPictures = (page, atLeast) => page.waitForFunction((n) => parseInt(document.querySelector("#map-count")?.textContent) >= n, atLeast);
/** Names of the files of a folder of the origin's private file system. */
const stored = (page, folder) =>
  page.evaluate(async (name) => {
    const names = [];
    const directory = await (await navigator.storage.getDirectory()).getDirectoryHandle(name).catch(() => undefined);
    if (directory) for await (const key of directory.keys()) names.push(key);
    return names;
  }, folder);

const axe = async (page, where) => assert.deepEqual(await violations(page), [], where);

test("a place is filmed, mapped, named, kept, tried, exported and deleted, on a phone, and nothing is sent", { skip, timeout: 240_000 }, async (t) => {
  const { page, said, server } = await mapping(t, { camera: true, options: phone });
  await page.tap("[data-source=map]");
  await heading(page, "Map this place");
  await axe(page, "begin");
  await page.screenshot({ path: artefact("map-begin.png") });
  await page.tap("#map-camera");
  await keptPictures(page, 10);
  assert.match(await page.textContent(".map-advice"), /Keep walking/);
  await axe(page, "film");
  await page.screenshot({ path: artefact("map-film.png") });
  await page.evaluate(() => (globalThis.fakeMapper = { stepMs: 40 }));
  await page.tap("#map-stop");
  await page.waitForSelector('.map-stages [aria-current="step"]');
  await axe(page, "build");
  await page.screenshot({ path: artefact("map-build.png") });
  await heading(page, "Your place is mapped");
  await page.waitForFunction(() => /^Kept in My places/.test(document.querySelector("#map-kept").textContent));
  await page.waitForSelector("#map-result-view canvas");
  assert.match(await page.textContent("#map-summary"), /^\d+ of \d+ pictures found their place · 2304 points · 192 lines/);
  assert.match(await page.textContent("#map-problems"), /nothing in common with another picture/);
  await axe(page, "result");
  await page.screenshot({ path: artefact("map-result.png") });
  const overflow = await page.evaluate(() => document.querySelector(".mapping-body").scrollWidth - document.querySelector(".mapping-body").clientWidth);
  assert.ok(overflow <= 0, `the step is ${overflow} px wider than the screen`);
  await page.fill("#map-name", "The kitchen / upstairs");
  await page.locator("#map-name").blur();
  await page.waitForFunction(() => /as “The kitchen \/ upstairs”/.test(document.querySelector("#map-kept").textContent));
  assert.deepEqual(await stored(page, "landline-film"), [], "the film has served its purpose");
  // Tried at once: the page locates in it, with the camera.
  await page.tap("#map-try");
  await page.waitForFunction(() => globalThis.landlinePage.state.scene?.name === "The kitchen / upstairs" && globalThis.landlinePage.state.live?.camera && globalThis.landlinePage.state.result);
  // And it is there at the next visit.
  await page.reload();
  await ready(page);
  await page.tap("[data-source=map]");
  await page.waitForSelector(".map-list li");
  assert.equal(await page.$("#map-unfinished"), null);
  const row = page.locator(".map-list li");
  const [download] = await Promise.all([page.waitForEvent("download"), row.getByRole("button", { name: /^Export/ }).tap()]);
  assert.equal(download.suggestedFilename(), "The-kitchen-upstairs.landline");
  assert.deepEqual(await readFile(await download.path()), await readFile(join(site(), "scenes/sample/sample.landline")), "the same bytes");
  await row.getByRole("button", { name: /^Rename/ }).tap();
  await page.keyboard.type("Kitchen");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => document.querySelector(".map-place strong").textContent === "Kitchen");
  await page.screenshot({ path: artefact("map-places.png") });
  await axe(page, "places");
  await row.getByRole("button", { name: /^Delete/ }).tap();
  await row.getByRole("button", { name: /^Delete for good/ }).tap();
  await page.waitForFunction(() => document.querySelectorAll(".map-list li").length === 0);
  assert.deepEqual(await stored(page, "landline-places"), []);
  assert.match(await page.textContent("#bytes-sent"), /^0 bytes sent$/);
  assert.ok(server.requests.every(({ method, length }) => method === "GET" && length === 0), "nothing but downloads");
  assert.deepEqual(said, []);
});

test("a page that is reloaded while filming goes on with what it has, by keyboard alone", { skip, timeout: 240_000 }, async (t) => {
  const { page, said } = await mapping(t, { camera: true });
  await page.focus("[data-source=map]");
  await page.keyboard.press("Enter");
  await heading(page, "Map this place");
  assert.equal(await page.evaluate(() => document.activeElement.id), "mapping-title");
  await page.focus("#map-camera");
  await page.keyboard.press("Enter");
  await keptPictures(page, 6);
  // Hidden, it rests and says so.
  await hide(page, true);
  await page.waitForFunction(() => /Paused/.test(document.querySelector(".map-advice").textContent));
  const rested = await stored(page, "landline-film");
  await page.waitForTimeout(700);
  assert.ok((await stored(page, "landline-film")).length <= rested.length + 1, "but for the frame that was under way");
  await hide(page, false);
  await keptPictures(page, rested.length + 2);
  await page.reload();
  await ready(page);
  await page.focus("[data-source=map]");
  await page.keyboard.press("Enter");
  await page.waitForSelector("#map-unfinished");
  const left = parseInt(await page.textContent("#map-unfinished p"));
  assert.ok(left >= 6, `${left} pictures`);
  // More is filmed on top of it.
  await page.focus("#map-film-more");
  await page.keyboard.press("Enter");
  await keptPictures(page, left + 3);
  assert.ok(await page.evaluate((n) => globalThis.mappers.at(-1).keyframes >= n, left), "a new mapper was shown the pictures again");
  // Escape closes; the film waits. Then the map is made of all.
  await page.keyboard.press("Escape");
  assert.equal(await page.evaluate(() => document.querySelector("#mapping").open), false);
  await page.focus("[data-source=map]");
  await page.keyboard.press("Enter");
  await page.waitForSelector("#map-go-on");
  await page.focus("#map-go-on");
  await page.keyboard.press("Enter");
  await heading(page, "Your place is mapped");
  const [, all] = /of (\d+) pictures/.exec(await page.textContent("#map-summary"));
  assert.ok(Number(all) >= left + 3);
  assert.deepEqual(said, []);
});

test("making the map can be cancelled, and what fails says why and what helps", { skip, timeout: 240_000 }, async (t) => {
  const { page, pictures, said } = await mapping(t, { told: { stepMs: 60 } });
  await page.click("[data-source=map]");
  const files = await Promise.all(pictures.slice(0, 4).map(async ({ name, path }) => ({ name, mimeType: "image/jpeg", buffer: await readFile(path) })));
  await page.setInputFiles("#map-pictures", [...files, { name: "notes.jpg", mimeType: "image/jpeg", buffer: Buffer.from("no picture") }, { name: "night.bmp", mimeType: "image/bmp", buffer: blackBitmap() }]);
  await page.waitForFunction(() => document.querySelector(".map-advice")?.textContent === "Kept");
  await page.waitForSelector('.map-stages [data-state="now"]');
  await page.click("#map-cancel");
  await heading(page, "Cancelled");
  assert.equal((await stored(page, "landline-film")).filter((name) => name.endsWith(".jpg")).length, 4);
  await page.evaluate(() => (globalThis.fakeMapper = { stepMs: 1, failAt: "poses", error: { code: "no-model", message: "the camera only turned on the spot", hint: "Film again, stepping sideways." } }));
  await page.click("#map-again");
  await heading(page, "No map came of it");
  assert.equal(await page.textContent("#map-held-text"), "The camera only turned on the spot.");
  assert.equal(await page.textContent("#map-held-hint"), "Film again, stepping sideways.");
  // A mapper that broke is replaced by one that is shown the pictures again.
  await page.evaluate(() => (globalThis.fakeMapper = { stepMs: 1, failAt: "refine", error: { code: "out-of-memory", message: "memory could not be had", hint: "" } }));
  await page.click("#map-again");
  await heading(page, "This device ran out of memory");
  assert.equal(await page.evaluate(() => globalThis.disposed), 1);
  // A film with a cut: the larger piece is the map, and that is said.
  const cut = "The film falls into 2 pieces that could not be joined; this is the largest. Film the way from one to the other.";
  await page.evaluate((words) => (globalThis.fakeMapper = { stepMs: 1, registeredShare: 0.6, warnings: [words] }), cut);
  await page.click("#map-again");
  await heading(page, "Your place is mapped");
  assert.equal(await page.textContent("#mapping .problem-hint"), cut);
  // Each reason once, the commonest first, with the pictures that it is of.
  const reasons = await page.$$eval("#map-problems li", (all) => all.map((row) => [...row.querySelectorAll("summary, p")].map((part) => part.textContent)));
  assert.equal(new Set(reasons.map(([reason]) => reason)).size, reasons.length);
  const counts = reasons.map(([reason, names]) => [Number(reason.split(" ")[0]), names.split(", ").length]);
  assert.ok(counts.every(([said, named], i) => said === named && (i === 0 || said <= counts[i - 1][0])), JSON.stringify(reasons));
  const of = (words) => reasons.find(([reason]) => words.test(reason))?.[1];
  assert.match(of(/^1 picture: cannot be decoded/), /^notes\.jpg$/);
  assert.match(of(/^1 picture: too dark/), /^night\.bmp$/);
  assert.equal(await page.evaluate(() => globalThis.mappers.length), 2);
  // The metre stick: two marks in a picture, by keyboard, and a distance.
  await page.click("#map-metre summary");
  await page.waitForFunction(() => /first point/.test(document.querySelector("#map-metre-said").textContent));
  await page.focus("#map-metre-picture");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => /second point/.test(document.querySelector("#map-metre-said").textContent));
  for (let i = 0; i < 4; i++) await page.keyboard.press("Shift+ArrowRight");
  await page.keyboard.press("Enter");
  await page.fill("#map-metre-distance", "1.5");
  await page.click("#map-metre-set");
  await page.waitForFunction(() => /Lengths are in metres now/.test(document.querySelector("#map-metre-said").textContent));
  const [{ scale }] = await page.evaluate(() => globalThis.written);
  assert.equal(scale.metres, 1.5);
  assert.deepEqual([scale.from.x, scale.from.y, scale.to.y], [320, 240, 240], "pixels of the frames");
  assert.ok(Math.abs(scale.to.x - 0.7 * 640) < 1e-6);
  await page.click("#map-training summary");
  const [labels] = await Promise.all([page.waitForEvent("download"), page.click("#map-labels")]);
  assert.match(labels.suggestedFilename(), /^Place-of-.*\.labels$/);
  assert.match(await page.textContent("#map-labels-said"), /\.labels, 19 B\.$/);
  await page.screenshot({ path: artefact("map-training.png") });
  await page.click("#map-up summary");
  await page.waitForSelector("#map-up canvas", { state: "visible" });
  await page.fill("#map-tilt-forward", "12");
  await page.click("#map-set-up");
  const { up } = await page.waitForFunction(() => globalThis.written.find((what) => what.up)).then((handle) => handle.jsonValue());
  assert.ok(Math.abs(Math.hypot(up.x, up.y, up.z) - 1) < 1e-9);
  assert.deepEqual(said, []);
});

test("files of which none is a picture are named, with what is wrong with them", { skip, timeout: 240_000 }, async (t) => {
  const error = { code: "not-enough-pictures", message: "too few pictures (0)", hint: "" };
  const { page } = await mapping(t, { told: { stepMs: 1, failAt: "pairs", error } });
  await page.click("[data-source=map]");
  await page.waitForSelector("#map-pictures", { state: "attached" });
  await page.setInputFiles("#map-pictures", [{ name: "notes.jpg", mimeType: "image/jpeg", buffer: Buffer.from("text") }, { name: "empty.jpg", mimeType: "image/jpeg", buffer: Buffer.alloc(0) }]);
  await heading(page, "Too few pictures");
  const reasons = await page.$$eval("#map-problems li summary", (all) => all.map((row) => row.textContent));
  assert.deepEqual(reasons.sort(), ["1 picture: cannot be decoded: use JPEG, PNG or WebP", "1 picture: empty file"]);
  await axe(page, "held");
  await page.click("text=Back");
  await heading(page, "Map this place");
  await page.setInputFiles("#map-video", { name: "walk.mp4", mimeType: "video/mp4", buffer: Buffer.alloc(0) });
  await heading(page, "This cannot be used");
  assert.equal(await page.textContent("#map-held-text"), "“walk.mp4” is empty.");
});

test("a place gets its metres where there is no 3D view", { skip, timeout: 240_000 }, async (t) => {
  const { page, pictures, said } = await mapping(t, { told: { stepMs: 1 } });
  await page.route("**/result_view.js", (route) => route.fulfill({ contentType: "text/javascript", body: "export class ResultView { constructor() { throw new Error('no WebGL'); } }" }));
  await page.click("[data-source=map]");
  await page.setInputFiles("#map-pictures", await Promise.all(pictures.slice(0, 4).map(async ({ name, path }) => ({ name, mimeType: "image/jpeg", buffer: await readFile(path) }))));
  await heading(page, "Your place is mapped");
  await page.waitForFunction(() => /no WebGL.*The map itself is not affected/.test(document.querySelector("#map-result-view").textContent));
  await page.click("#map-metre summary");
  await page.waitForFunction(() => /first point/.test(document.querySelector("#map-metre-said").textContent));
  await page.focus("#map-metre-picture");
  for (const key of ["Enter", "ArrowRight", "Enter"]) await page.keyboard.press(key);
  await page.fill("#map-metre-distance", "0.1");
  await page.click("#map-metre-set");
  await page.waitForFunction(() => /Lengths are in metres now/.test(document.querySelector("#map-metre-said").textContent));
  assert.equal((await page.evaluate(() => globalThis.written))[0].scale.metres, 0.1);
  assert.deepEqual(said, []);
});

/** A black picture of 8 x 8 pixels. */
function blackBitmap() {
  const bytes = Buffer.alloc(54 + 8 * 24);
  bytes.write("BM");
  for (const [at, value] of [[2, bytes.length], [10, 54], [14, 40], [18, 8], [22, 8]]) bytes.writeUInt32LE(value, at);
  bytes.writeUInt16LE(1, 26);
  bytes.writeUInt16LE(24, 28);
  return bytes;
}

test("a video file is looked through from its beginning to its end", { skip, timeout: 240_000 }, async (t) => {
  const { page, pictures, said } = await mapping(t, { told: { stepMs: 1 } });
  const video = await recorded(page, { picture: `scenes/sample/${pictures[0].name}`, size: [320, 240], ms: 2000, draw: "pan" });
  await page.click("[data-source=map]");
  await page.setInputFiles("#map-video", { name: "walk.webm", mimeType: "video/webm", buffer: video });
  await heading(page, "Your place is mapped");
  const [, all] = /of (\d+) pictures/.exec(await page.textContent("#map-summary"));
  t.diagnostic(`${all} frames, one every fifth of a second`);
  assert.ok(all >= 3, `${all} frames`);
  await page.click("#map-done");
  await page.setInputFiles("#map-video", { name: "walk.mp4", mimeType: "video/mp4", buffer: Buffer.from("no video") });
  await page.waitForSelector("#map-held-hint");
  assert.match(await page.textContent("#map-held-hint"), /MP4/);
  assert.deepEqual(said, []);
});

test("storage that is full is said, and nothing is left half-written", { skip, timeout: 240_000 }, async (t) => {
  const { page, server, context } = await mapping(t, { camera: true });
  const session = await context.newCDPSession(page);
  const origin = new URL(server.url).origin;
  const { usage } = await session.send("Storage.getUsageAndQuota", { origin });
  await session.send("Storage.overrideQuotaForOrigin", { origin, quotaSize: usage + 120_000 });
  await page.click("[data-source=map]");
  await page.click("#map-camera");
  await page.waitForFunction(() => /closed: there is no storage left/.test(document.querySelector("#map-keeps")?.textContent));
  await keptPictures(page, 8);
  await page.click("#map-stop");
  await heading(page, "Your place is mapped");
  await page.waitForFunction(() => /^Not kept: there is no storage left/.test(document.querySelector("#map-kept").textContent));
  assert.deepEqual(await stored(page, "landline-places"), []);
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("#map-save")]);
  assert.match(download.suggestedFilename(), /^Place-of-.*\.landline$/);
  // With room again it is kept.
  await session.send("Storage.overrideQuotaForOrigin", { origin });
  await page.click("#map-keep");
  await page.waitForFunction(() => /^Kept in My places/.test(document.querySelector("#map-kept").textContent));
  assert.equal((await stored(page, "landline-places")).length, 2);
});

test("a camera that is taken away keeps what it filmed", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await mapping(t, { camera: true });
  await page.click("[data-source=map]");
  await page.click("#map-camera");
  await keptPictures(page, 3);
  await page.evaluate(() => document.querySelector(".map-stage video").srcObject.getVideoTracks()[0].dispatchEvent(new Event("ended")));
  await heading(page, "The camera was taken away");
  assert.match(await page.textContent("#mapping .fine"), /pictures kept on this device/);
  await page.click("#map-throw");
  await heading(page, "Map this place");
  assert.deepEqual(await stored(page, "landline-film"), []);
});

test("who only locates loads nothing of it; its own size is bounded", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?dwell=0`);
  await located(page, 2);
  await keptOffline(page);
  // Not even for offline use: what maps is kept from the first time on that it is used.
  const asked = server.requests.filter(({ path }) => /\/(mapping|mapper)\/|mapper.*\.wasm$/.test(path));
  assert.deepEqual(asked, []);
  // Nor does its engine carry any of it: places of panics name the sources that are in a wasm file.
  const engine = (name) => readFile(join(site(), "vendor/landline", name), "latin1");
  const [locates, maps] = await Promise.all([engine("landline_bg.wasm"), engine("mapper/landline_mapper_bg.wasm")]);
  for (const part of ["src/mapping/", "src/reconstruction/"]) assert.deepEqual([locates.includes(part), maps.includes(part)], [false, true], part);
  const folder = join(site(), "mapping");
  let total = 0;
  for (const name of await readdir(folder)) total += brotliCompressSync(await readFile(join(folder, name))).length;
  t.diagnostic(`the flow's scripts and styles: ${total} bytes as brotli`);
  assert.ok(total <= 30_000, `${total} bytes`);
});
