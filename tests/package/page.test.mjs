// The demo page as a visitor meets it.
import assert from "node:assert/strict";
import { test } from "node:test";
import { artefact, browser, haveSample, hide, keptOffline, located, open, serve } from "./page.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

test("opens, locates the sample pictures, and sends nothing", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page, said } = await open(await browser(t), `${server.url}?dwell=0`);
  await located(page, 3);
  assert.match(await page.textContent("#bytes-sent"), /^0 bytes sent$/);
  assert.match(await page.textContent("#status-word"), /Located|Not|Too|No|Two/);
  const result = await page.evaluate(() => {
    const { result } = globalThis.landlinePage.state;
    return { total: result.timingsMs.total, backend: result.backend, reason: result.backendReason };
  });
  assert.ok(result.total > 0);
  assert.equal(result.backend, "cpu");
  assert.notEqual(result.reason, "", "the page says why it is not something faster");
  assert.ok((await page.$$eval("#stages meter", (rows) => rows.length)) === 6, "one row per stage");
  assert.ok(server.requests.every(({ method, length }) => method === "GET" && length === 0), "nothing but downloads");
  assert.deepEqual(said, []);
  await page.waitForTimeout(1500);
  await page.screenshot({ path: artefact("desktop.png"), fullPage: true });
});

test("fits a phone", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page, said } = await open(await browser(t), `${server.url}?dwell=0`, { viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, isMobile: true, hasTouch: true });
  await located(page, 2);
  const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  assert.ok(overflow <= 0, `the page is ${overflow} px wider than the screen`);
  const small = await page.$$eval("button:not([hidden]), select", (all) =>
    all.filter((e) => e.offsetParent && !e.matches(".link, .badge, .thumb")).map((e) => [e.id || e.textContent.trim(), e.getBoundingClientRect().height]).filter(([, h]) => h < 40),
  );
  assert.deepEqual(small, [], "everything that is tapped is large enough");
  assert.deepEqual(said, []);
  await page.screenshot({ path: artefact("phone.png") });
  await page.screenshot({ path: artefact("phone-full.png"), fullPage: true });
});

test("runs under a strict policy, from a sub-path, without cross-origin isolation", { skip, timeout: 240_000 }, async (t) => {
  const policy = "default-src 'self'; script-src 'self' 'wasm-unsafe-eval' HASH; connect-src 'self'; img-src 'self' blob: data:; style-src 'self'; worker-src 'self'; object-src 'none'; base-uri 'none'; frame-ancestors 'none'";
  const plain = await serve(t);
  const hash = /'sha256-[^']+'/.exec(await (await fetch(plain.url)).text())?.[0];
  assert.ok(hash, "the page's own policy names its import map");
  const server = await serve(t, { base: "/some/where/", headers: { "content-security-policy": policy.replace("HASH", hash) } });
  const { page, said } = await open(await browser(t), `${server.url}?dwell=0`);
  await located(page);
  assert.equal(await page.evaluate(() => crossOriginIsolated), false);
  // In a timer, because what the test's own connection evaluates is exempt from the policy.
  const evaluated = await page.evaluate(() => new Promise((done) => setTimeout(() => {
    try {
      done(eval("1"));
    } catch (error) {
      done(error.name);
    }
  })));
  assert.equal(evaluated, "EvalError");
  assert.deepEqual(said.filter((line) => !/unsafe-eval/.test(line)), []);
});

test("asks its server for nothing once it is ready", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?dwell=0`);
  const count = await page.$$eval(".thumb", (all) => all.length).catch(() => 0);
  await located(page, 2);
  await page.waitForFunction(() => [...document.querySelectorAll(".thumb")].every((thumb) => thumb.dataset.result));
  await page.waitForTimeout(500);
  const before = server.requests.length;
  await page.click("#next");
  await page.evaluate(async () => {
    const canvas = new OffscreenCanvas(320, 240);
    canvas.getContext("2d").fillRect(0, 0, 10, 10);
    await globalThis.landlinePage.state.relocalizer.locate(canvas);
  });
  // The browser itself asks for the service worker's script again, some seconds after a visit began.
  const after = server.requests.slice(before).filter(({ path }) => !/\.(jpg|png)$/.test(path) && path !== "/sw.js");
  assert.deepEqual(after, [], `asked for more (${count})`);
});

test("works again without a network", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const launched = await browser(t);
  const { page, context } = await open(launched, `${server.url}?dwell=0`);
  await located(page, 1);
  await keptOffline(page);
  await page.close();
  server.state.down = true;
  const second = await context.newPage();
  second.setDefaultTimeout(60_000);
  await second.goto(`${server.url}?dwell=0`);
  await located(second, 1);
});

test("can be used with the keyboard", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), server.url);
  await located(page, 1);
  await page.keyboard.press(" ");
  assert.equal(await page.getAttribute("#play", "aria-label"), "Play");
  const chosen = () => page.$$eval(".thumb", (all) => all.findIndex((thumb) => thumb.ariaSelected === "true"));
  const before = await chosen();
  await page.keyboard.press("ArrowRight");
  await page.waitForFunction((was) => [...document.querySelectorAll(".thumb")].findIndex((thumb) => thumb.ariaSelected === "true") !== was, before);
  const segments = page.locator("[data-layer=segments]");
  assert.equal(await segments.isChecked(), false);
  await page.keyboard.press("3");
  assert.equal(await segments.isChecked(), true);
  await page.keyboard.press("?");
  assert.equal(await page.evaluate(() => document.querySelector("#help").open), true);
  await page.keyboard.press("Escape");
  await page.keyboard.press("Tab");
  assert.notEqual(await page.evaluate(() => document.activeElement.tagName), "BODY");
});

test("rests while its tab is hidden", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?dwell=0`);
  await located(page, 1);
  const frames = () =>
    page.evaluate(async () => {
      let count = 0;
      const { relocalizer } = globalThis.landlinePage.state;
      relocalizer.addEventListener("result", () => (count += 1));
      await new Promise((done) => setTimeout(done, 3000));
      return count;
    });
  await hide(page, true);
  // The frame that is under way may still answer, on a slow machine after a while; a page that does not rest goes on.
  let count = await frames();
  for (let tries = 0; count > 0 && tries < 5; tries++) count = await frames();
  assert.equal(count, 0);
  await hide(page, false);
  assert.ok((await frames()) > 0);
});
