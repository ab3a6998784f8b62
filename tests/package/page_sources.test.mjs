// The ways into the page: files that are dropped, a video, an address, a folder with poses.
import assert from "node:assert/strict";
import { cp, mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { artefact, browser, haveSample, located, open, recorded, sampleFiles, serve } from "./page.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

/** Drops paths on the middle of the page, as a file manager would. */
async function drop(page, paths) {
  const session = await page.context().newCDPSession(page);
  const data = { items: [], files: paths, dragOperationsMask: 1 };
  for (const type of ["dragEnter", "dragOver", "drop"]) await session.send("Input.dispatchDragEvent", { type, x: 400, y: 400, data });
}

test("a dropped picture is located", { skip, timeout: 240_000 }, async (t) => {
  const { pictures, camera } = await sampleFiles();
  const server = await serve(t);
  const { page } = await open(await browser(t), server.url);
  await located(page);
  await page.fill("#focal", String(camera.fx));
  await drop(page, [pictures[3].path]);
  await page.waitForFunction((name) => document.querySelector("#stage-tag").textContent === name, pictures[3].name);
  await located(page);
  assert.equal(await page.$$eval(".thumb", (all) => all.length), 1);
  assert.equal(await page.getAttribute("[data-source=open]", "aria-pressed"), "true");
  assert.equal(await page.isVisible("#drop"), false);
});

test("a dropped folder with a scene and poses is evaluated", { skip, timeout: 240_000 }, async (t) => {
  const { pictures, folder: sample } = await sampleFiles();
  const folder = await mkdtemp(join(tmpdir(), "landline-folder-"));
  t.after(() => rm(folder, { recursive: true, force: true }));
  for (const name of ["sample.json", "sample.landline", ...pictures.slice(0, 4).map((picture) => picture.name)]) await cp(join(sample, name), join(folder, name));
  const server = await serve(t);
  const { page, said } = await open(await browser(t), server.url);
  await located(page);
  await drop(page, [folder]);
  await page.waitForFunction(() => document.querySelector("#evaluation").dataset.done === "true");
  assert.match(await page.textContent("#evaluation-note"), /4 of 4 pictures have a pose in sample\.json/);
  const facts = await page.textContent("#evaluation-facts");
  assert.match(facts, /4, 4 located/);
  assert.match(facts, /Within 5 cm, 5°100\.0 %/);
  // It stands above the other cards, and its axes end where the errors do.
  assert.equal(await page.evaluate(() => document.querySelector(".panels").firstElementChild.id), "evaluation");
  assert.deepEqual(await page.evaluate(async () => {
    const { axisEnd } = await import("./evaluate.js");
    return [[0.001, 0.0032], [0.7], [3, 1, 2, 1, 1, 1, 1, 1, 1, 900], [0], []].map((values) => Number(axisEnd(values).toPrecision(9)));
  }), [0.005, 1, 5, 1, 1]);
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("#save-csv")]);
  const rows = (await readFile(await download.path(), "utf8")).trim().split("\n");
  assert.equal(rows.length, 5);
  assert.match(rows[1], /^query-00\.jpg,true,0\.0\d+,/);
  await page.locator("#evaluation").scrollIntoViewIfNeeded();
  await page.screenshot({ path: artefact("evaluation.png"), fullPage: true });
  assert.deepEqual(said, []);
});

test("poses in a list are read by the mapping engine", { skip, timeout: 240_000 }, async (t) => {
  const { pictures, folder: sample } = await sampleFiles();
  const folder = await mkdtemp(join(tmpdir(), "landline-folder-"));
  t.after(() => rm(folder, { recursive: true, force: true }));
  const four = pictures.slice(0, 4);
  for (const { name } of four) await cp(join(sample, name), join(folder, name));
  const { pictures: known } = JSON.parse(await readFile(join(sample, "sample.json"), "utf8"));
  const line = ({ name }) => {
    const m = known.find((picture) => picture.name === name).cam_from_world.flat();
    const rows = [0, 1, 2].flatMap((i) => [m[i], m[4 + i], m[8 + i], -(m[i] * m[3] + m[4 + i] * m[7] + m[8 + i] * m[11])]);
    return `${name} ${[...rows, 0, 0, 0, 1].join(" ")}\n`;
  };
  await writeFile(join(folder, "poses.txt"), `${four.slice(0, 3).map(line).join("")}away.jpg 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n`);
  const server = await serve(t);
  const { page, said } = await open(await browser(t), server.url);
  await located(page);
  await drop(page, [folder]);
  await page.waitForFunction(() => document.querySelector("#evaluation").dataset.done === "true");
  assert.match(await page.textContent("#evaluation-note"), /3 of 4 pictures have a pose in .*poses\.txt\. 1 poses are of pictures that are not here\./);
  assert.match(await page.textContent("#evaluation-facts"), /Within 5 cm, 5°100\.0 %/);
  assert.deepEqual(said, []);
});

test("a video is followed", { skip, timeout: 240_000 }, async (t) => {
  const { pictures, camera } = await sampleFiles();
  const server = await serve(t);
  const { page, said } = await open(await browser(t), server.url);
  await located(page);
  const video = await recorded(page, { picture: `scenes/sample/${pictures[0].name}`, size: [640, 480], ms: 1500, draw: "still" });
  await page.fill("#focal", String(camera.fx));
  await page.setInputFiles("#open-media", { name: "walk.webm", mimeType: "video/webm", buffer: video });
  await page.waitForFunction(() => globalThis.landlinePage.state.result?.state === "tracking");
  // Between two answers the picture that is drawn is the one that was tracked, and the page says how.
  await page.waitForFunction(() => /^walk\.webm · \d+ a second · (tracked( for \d+\.\d s)?|located) · /.test(document.querySelector("#stage-tag").textContent));
  await page.click("#play");
  assert.equal(await page.evaluate(() => globalThis.landlinePage.state.live.video.paused), true);
  // What is no video says what would be one.
  await page.setInputFiles("#open-media", { name: "walk.mp4", mimeType: "video/mp4", buffer: Buffer.from("no video") });
  await page.waitForSelector("#problem[open]");
  assert.match(await page.textContent("#problem-hint"), /MP4/);
  assert.deepEqual(said, []);
});

test("a scene can be named in the address", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?scene=scenes/sample/sample.landline&device=cpu`);
  await page.waitForFunction(() => document.querySelector("#status-word").textContent === "Ready");
  assert.match(await page.textContent("#scene-facts"), /sample\.landline/);
  assert.equal(await page.inputValue("#device"), "cpu");
  const { page: wrong } = await open(await browser(t), `${server.url}?scene=nowhere.landline`);
  await wrong.waitForSelector("#problem[open]");
  assert.equal(await wrong.textContent("#problem-code"), "asset-fetch");
});
