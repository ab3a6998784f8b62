// What the page shows before, between and instead of results: it must not promise, hide or mix up anything.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join, posix } from "node:path";
import { test } from "node:test";
import { artefact, browser, haveSample, located, open, sampleFiles, serve, violations } from "./page.mjs";
import { root, site } from "./support.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";
const phone = { viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true };

test("every module of the page is asked for at once", () => {
  const html = readFileSync(join(site(), "index.html"), "utf8");
  const listed = [...html.matchAll(/rel="modulepreload" href="\.\/([^"]+)"/g)].map(([, path]) => path);
  const { imports } = JSON.parse(/<script type="importmap">(.*?)<\/script>/s.exec(html)[1]);
  const reached = new Set();
  const visit = (path) => {
    if (reached.has(path)) return;
    reached.add(path);
    for (const [, name] of readFileSync(join(site(), path), "utf8").matchAll(/^(?:import|export)\s(?:[^;"]*\sfrom\s)?"([^"]+)";/gm)) {
      visit(posix.join(posix.dirname(path), name.startsWith(".") ? name : posix.relative(posix.dirname(path), imports[name])));
    }
  };
  visit("main.js");
  reached.delete("main.js");
  assert.deepEqual(listed, [...reached].sort());
});

test("a focal length that was solved is not said to be EXIF's", async () => {
  const source = readFileSync(join(root, "www/focal.js"), "utf8");
  const { focalWords } = await import(`data:text/javascript,${encodeURIComponent(source)}`);
  assert.equal(focalWords({ fx: 510, source: "exif", relativeSigma: 0.001 }), "510.0 px, solved from this picture, EXIF as a start (± 0.1 %)");
  assert.equal(focalWords({ fx: 510, source: "exif" }), "510.0 px, from the picture’s EXIF");
  assert.equal(focalWords({ fx: 525.5, source: "given" }), "525.5 px, given");
});

test("while nothing has arrived the page shows that it loads, and on a phone nothing is cut off", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t, { faults: { "main.js": { stallAt: 10 }, ".wasm": { stallAt: 2000 } } });
  const launched = await browser(t);
  const { page } = await open(launched, undefined, phone);
  await page.goto(server.url, { waitUntil: "commit" });
  await page.waitForSelector("#bars progress");
  assert.equal(await page.isVisible("#cancel-load"), false, "a Cancel that does nothing is none");
  server.state.faults = { ".wasm": { stallAt: 2000 } };
  const { page: loading } = await open(launched, undefined, phone);
  await loading.goto(server.url);
  await loading.waitForSelector("#cancel-load", { state: "visible" });
  await loading.waitForFunction(() => document.querySelectorAll("#bars .bar").length === 3);
  const inside = await loading.evaluate(() => {
    const frame = document.querySelector("#stage-frame").getBoundingClientRect();
    return ["#empty", "#cancel-load"].map((what) => {
      const box = document.querySelector(what).getBoundingClientRect();
      return box.top >= frame.top && box.bottom <= frame.bottom && box.bottom <= innerHeight;
    });
  });
  assert.deepEqual(inside, [true, true]);
  assert.equal(await loading.isVisible(".tagline"), true);
  const chips = await loading.$$eval(".chip:not([hidden])", (all) => all.map((chip) => chip.getBoundingClientRect()).filter(({ left, right }) => left < 0 || right > innerWidth).length);
  assert.equal(chips, 0, "every source is on the screen");
  await loading.screenshot({ path: artefact("phone-loading.png") });
  await loading.click("#cancel-load");
  await loading.waitForFunction(() => document.querySelector("#empty-title").textContent === "Cancelled");
});

test("while it loads nothing on the page moves", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const launched = await browser(t);
  const init = "globalThis.shifts = []; new PerformanceObserver((list) => list.getEntries().forEach((entry) => entry.hadRecentInput || globalThis.shifts.push(entry.value))).observe({ type: 'layout-shift', buffered: true });";
  for (const [name, options] of [["phone", phone], ["desktop", {}]]) {
    const { page } = await open(launched, `${server.url}?dwell=100000`, { ...options, init });
    await located(page);
    await page.waitForSelector("#map-frame canvas");
    const moved = (await page.evaluate(() => globalThis.shifts)).reduce((sum, one) => sum + one, 0);
    t.diagnostic(`${name}: ${moved.toFixed(3)}`);
    // What Web Vitals call good. Words and small pictures that come with the first position move the map down a little.
    assert.ok(moved < 0.1, `${name}: ${moved}`);
  }
});

test("an earlier picture never stays under another name", { skip, timeout: 240_000 }, async (t) => {
  const { pictures } = await sampleFiles();
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?no-offline&dwell=100000`);
  await located(page);
  const shown = () => page.evaluate(() => {
    const canvas = document.querySelector("#picture");
    return { drawn: canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some((value) => value > 0), facts: document.querySelector("#facts").childElementCount };
  });
  assert.deepEqual((await shown()).drawn, true);
  await page.setInputFiles("#open-media", { name: "pic.heic", mimeType: "image/heic", buffer: Buffer.from("not a picture") });
  await page.waitForFunction(() => document.querySelector("#stage-tag").textContent === "pic.heic");
  assert.deepEqual(await shown(), { drawn: false, facts: 0 });
  assert.match(await page.textContent("#empty-note"), /^“pic\.heic” cannot be decoded/);
  await page.setInputFiles("#open-media", pictures[3].path);
  await located(page);
  await page.setInputFiles("#open-scene", join(site(), "scenes/sample/sample.landline"));
  await page.waitForFunction(() => document.querySelector("#empty-title").textContent === "The scene is loaded");
  assert.deepEqual(await shown(), { drawn: false, facts: 0 });
});

test("single keys can be switched off, and stay so", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?no-offline&dwell=100000`);
  await located(page);
  const segments = page.locator("[data-layer=segments]");
  await page.click("#show-help");
  await page.click("#shortcuts");
  await page.keyboard.press("Escape");
  await page.keyboard.press("3");
  assert.equal(await segments.isChecked(), false);
  await page.reload();
  await located(page);
  await page.keyboard.press("3");
  assert.equal(await segments.isChecked(), false);
  // A list that has the focus keeps its own keys.
  await page.focus("#strip");
  await page.keyboard.press("End");
  await page.waitForFunction(() => document.querySelector("#strip").lastChild.getAttribute("aria-selected") === "true");
  await page.click("#show-help");
  await page.click("#shortcuts");
  await page.keyboard.press("Escape");
  await page.keyboard.press("3");
  assert.equal(await segments.isChecked(), true);
});

test("nothing is read aloud with every frame", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?no-offline&dwell=0`);
  await located(page, 2);
  const changes = await page.evaluate(async () => {
    let count = 0;
    const watch = new MutationObserver((list) => (count += list.length));
    for (const live of document.querySelectorAll('[aria-live]:not([aria-live="off"]), [role="status"], [role="alert"], output')) watch.observe(live, { childList: true, characterData: true, subtree: true });
    await new Promise((done) => setTimeout(done, 3000));
    return count;
  });
  assert.ok(changes <= 2, `${changes} changes in three seconds`);
});

test("light and dark: borders of fields stand out three to one, and text is read", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const launched = await browser(t);
  for (const colorScheme of ["dark", "light"]) {
    const { page } = await open(launched, `${server.url}?no-offline&dwell=100000`, { colorScheme });
    await located(page);
    const ratios = await page.$$eval("select, input[type=number]", (fields) => {
      const channel = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
      const luminance = (color) => {
        const [r, g, b] = color.match(/[\d.]+/g).map((v) => channel(v / 255));
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
      };
      const ratio = (a, b) => (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      return fields.filter((field) => field.checkVisibility()).map((field) => {
        const style = getComputedStyle(field);
        return Math.min(ratio(luminance(style.borderTopColor), luminance(style.backgroundColor)), ratio(luminance(style.borderTopColor), luminance(getComputedStyle(field.closest(".panel")).backgroundColor)));
      });
    });
    assert.ok(ratios.length >= 4 && ratios.every((r) => r >= 3), `${colorScheme}: ${ratios}`);
    assert.deepEqual(await violations(page), [], colorScheme);
    await page.screenshot({ path: artefact(`${colorScheme}.png`), fullPage: true });
    await page.close();
  }
});
