// The page with a place of many rooms: the floor plan, the dot in it, which room it is, and links to rooms.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { test } from "node:test";
import { hang, museum, skip } from "./museum.mjs";
import { artefact, browser, located, open, sampleFiles, serve, violations } from "./page.mjs";

const text = (page, selector) => page.textContent(selector);

test("the page shows in which room a picture was taken, and where on the plan", { skip, timeout: 300_000 }, async (t) => {
  const { manifest, files } = await museum(t);
  const { pictures } = await sampleFiles();
  const server = await serve(t);
  const launched = await browser(t);
  for (const [name, options] of [["desktop", {}], ["phone", { viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true }]]) {
    const { page, said } = await open(launched, undefined, options);
    const place = await hang(page);
    place.now(manifest, files);
    await page.goto(`${server.url}?no-offline&dwell=100000&place=museum/museum.place.json&room=hall`);
    await page.waitForSelector("#plan");
    assert.equal(await text(page, ".plan-where"), "Probably in Great hall.");
    await page.setInputFiles("#open-media", pictures[3].path);
    await located(page);
    assert.equal(await text(page, ".plan-where"), "In Great hall.");
    assert.equal(await text(page, "#status-word"), "Located in Great hall");
    const plan = await page.evaluate(() => {
      const drawing = document.querySelector(".plan-drawing");
      const states = Object.fromEntries([...drawing.querySelectorAll(".plan-room")].map(({ dataset }) => [dataset.room, dataset.state]));
      const [, x, y] = /translate\((\S+) (\S+)\)/.exec(drawing.querySelector(".plan-camera").getAttribute("transform")).map(Number);
      const at = Object.assign(drawing.createSVGPoint(), { x, y });
      const holds = (room) => drawing.querySelector(`[data-room="${room}"] polygon`).isPointInFill(at);
      return { states, inside: [holds("hall"), holds("cellar")], link: document.querySelector(".plan-link").href, facts: document.querySelector("#facts").textContent };
    });
    // The attic is on another floor.
    assert.deepEqual(plan.states, { cellar: "", hall: "here" });
    assert.deepEqual(plan.inside, [true, false]);
    assert.match(plan.facts, /RoomGreat hallIn the place/);
    assert.deepEqual([...new URL(plan.link).searchParams], [["place", "museum/museum.place.json"], ["room", "hall"]]);
    assert.deepEqual(place.asked.filter((file) => file.endsWith(".landline"))[0], "hall.landline");
    await page.click("#plan summary");
    await page.locator("#plan").screenshot({ path: artefact(`place-${name}-plan.png`) });
    assert.deepEqual(await violations(page), []);
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok(wide <= 0, `${wide} px wider than the screen`);
    await page.screenshot({ path: artefact(`place-${name}.png`), fullPage: true });
    assert.deepEqual(said, []);
    if (name === "phone") continue;
    // Something else in its place takes the plan away.
    await page.click('[data-source="sample"]');
    await page.waitForFunction(() => document.querySelector("#plan") === null);
  }
});

test("what is wrong with a place is said in words", { skip, timeout: 120_000 }, async (t) => {
  const { manifest, files } = await museum(t);
  const server = await serve(t);
  const { page } = await open(await browser(t));
  const place = await hang(page);
  const address = `${server.url}?no-offline&place=museum/museum.place.json`;
  place.now({ ...manifest, format: 2 }, files);
  await page.goto(address);
  await page.waitForFunction(() => document.querySelector("#status-word").textContent === "Not loaded");
  assert.match(await text(page, "#empty-note"), /format version 2/);
  place.now(manifest, { ...files, "hall.landline": undefined });
  await page.goto(`${address}&room=gone`);
  await page.waitForSelector("#plan");
  assert.match(await text(page, "#plan"), /names the room “gone”, which this place does not have/);
  await page.setInputFiles("#open-media", (await sampleFiles()).pictures[3].path);
  await page.waitForFunction(() => document.querySelector("#status-word").textContent === "A room is missing");
  assert.match(await text(page, "#plan"), /Great hall could not be loaded\. .*404/);
  // SHA-256 of the rows that the Python library qrcode 8.2 makes with masks 0, 2 and 4 (`add_data(QRData(..., mode=MODE_8BIT_BYTE))`).
  for (const [words, mask, golden] of [
    ["A", 0, "2bae48594b7325872d655a95d8814f09f3825eba52faa8c8b4e3c6dd453105e5"],
    ["https://example.org/?place=museum.place.json&room=hall", 2, "cbeaac7e726291da0ea0fe49d783a46af7becf5db7947fd526c7a84efb3c9200"],
    ["q".repeat(412), 4, "d5502e159e8eca6de257fedbf698179eb4ac74a05f8a42b75c538d607d6dd738"],
  ]) {
    const rows = await page.evaluate(async (words) => (await import("./place/qr.js")).qrCode(words).map((row) => row.map(Number).join("")), words);
    assert.equal(createHash("sha256").update(rows.join("\n")).digest("hex"), golden, `${words.slice(0, 30)}, mask ${mask}`);
  }
  assert.equal(await page.evaluate(async () => (await import("./place/qr.js")).qrCode("q".repeat(413))), undefined);
});
