// Can everybody use the page, and does it keep its promise about what it sends?
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { brotliCompressSync, constants } from "node:zlib";
import { browser, haveSample, located, open, serve, violations } from "./page.mjs";
import { root, site } from "./support.mjs";

/** As static hosts compress on the way: the strongest setting takes seconds a file. */
const brotli = (bytes) => brotliCompressSync(bytes, { params: { [constants.BROTLI_PARAM_QUALITY]: 9 } }).length;

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

test("axe finds nothing against WCAG 2.2 A and AA", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), server.url);
  await located(page, 2);
  await page.evaluate(() => (document.querySelector("#evaluation").hidden = false));
  const check = async (where) => assert.deepEqual(await violations(page), [], where);
  await check("page");
  for (const id of ["help", "privacy-details"]) {
    await page.evaluate((name) => document.getElementById(name).showModal(), id);
    await check(id);
    await page.keyboard.press("Escape");
  }
});

test("every control is reached with the Tab key and shows it", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), server.url);
  await located(page);
  await page.keyboard.press(" ");
  await page.evaluate(() => document.activeElement.blur());
  const wanted = await page.$$eval("button, input, select, [tabindex='0']", (all) =>
    all.filter((e) => e.checkVisibility() && !e.disabled && e.tabIndex >= 0 && !e.closest("dialog")).length,
  );
  const reached = new Set();
  for (let i = 0; i < 2 * wanted; i++) {
    await page.keyboard.press("Tab");
    const seen = await page.evaluate(() => {
      const e = document.activeElement;
      if (!e || e === document.body) return undefined;
      e.dataset.seen ??= String(document.querySelectorAll("[data-seen]").length);
      const { outlineStyle, outlineWidth } = getComputedStyle(e);
      return { key: e.dataset.seen, name: e.id || e.textContent.trim(), outlined: outlineStyle !== "none" && outlineWidth !== "0px" };
    });
    if (!seen) continue;
    assert.ok(seen.outlined, `${seen.name} shows no focus`);
    reached.add(seen.key);
  }
  // The link to the picture, which only shows when it has the focus, comes on top.
  assert.ok(reached.size >= wanted, `${reached.size} of ${wanted} controls are reached`);
});

test("who asked for less motion is shown one picture until the next is asked for", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?dwell=0`, { reducedMotion: "reduce" });
  await located(page);
  assert.equal(await page.getAttribute("#play", "aria-label"), "Play");
  await page.waitForTimeout(1500);
  assert.equal(await page.$$eval(".thumb[data-result]", (all) => all.length), 1);
  await page.click("#play");
  await located(page, 3);
});

/** What code in the worker could try to send by. */
async function channels(address) {
  const inherited = (name) => {
    for (let owner = self; owner; owner = Object.getPrototypeOf(owner)) {
      const value = Object.getOwnPropertyDescriptor(owner, name)?.value ?? Object.getOwnPropertyDescriptor(owner, name)?.get?.call(self);
      if (value !== undefined) return value;
    }
    throw new TypeError(`${name} is gone`);
  };
  const ways = {
    fetch: () => inherited("fetch").call(self, address),
    XMLHttpRequest: () => new (inherited("XMLHttpRequest"))(),
    WebSocket: () => new (inherited("WebSocket"))(address.replace("http", "ws")),
    EventSource: () => new (inherited("EventSource"))(address),
    WebTransport: () => new (inherited("WebTransport"))(address.replace("http", "https")),
    RTCPeerConnection: () => new (inherited("RTCPeerConnection"))(),
    importScripts: () => inherited("importScripts").call(self, address),
    Worker: () => new (inherited("Worker"))(address),
    BroadcastChannel: () => new (inherited("BroadcastChannel"))("a"),
    FontFace: () => new (inherited("FontFace"))("x", `url(${address})`).load(),
    caches: () => inherited("caches").open("a").then((cache) => cache.add(address)),
    import: () => import(`${address}imported.js?data=1`),
  };
  const outcomes = {};
  for (const [name, way] of Object.entries(ways)) {
    outcomes[name] = await Promise.resolve()
      .then(way)
      .then(
        () => "sent",
        (error) => error.name,
      );
  }
  return outcomes;
}

test("with a policy of its own the worker cannot even import", { skip, timeout: 240_000 }, async (t) => {
  const other = await serve(t, { headers: { "access-control-allow-origin": "*" } });
  const server = await serve(t, { headers: { "content-security-policy": "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'; connect-src 'self'; img-src 'self' blob: data:; style-src 'self'; manifest-src 'self'" } });
  const { page } = await open(await browser(t), `${server.url}vendor/landline/index.js`);
  await page.route("**/blank.html", (route) => route.fulfill({ contentType: "text/html", body: "<!doctype html><meta charset=utf-8>" }));
  await page.goto(`${server.url}blank.html`);
  const made = await page.evaluate(async () => {
    const { Relocalizer } = await import("./vendor/landline/index.js");
    globalThis.kept = await Relocalizer.create({ scene: "./scenes/sample/sample.landline", device: "cpu" });
    return globalThis.kept.backend;
  });
  assert.equal(made, "cpu");
  const tried = await page.workers()[0].evaluate(channels, other.url);
  for (const [channel, outcome] of Object.entries(tried)) t.diagnostic(`worker with a policy, ${channel}: ${outcome}`);
  t.diagnostic(`worker with a policy: the other server was asked ${other.requests.length} times`);
  assert.deepEqual([...new Set(Object.values(tried))], ["TypeError"]);
  assert.equal(other.requests.length, 0);
});

test("neither the page nor its worker can talk to another server", { skip, timeout: 240_000 }, async (t) => {
  const other = await serve(t);
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?dwell=0`);
  await located(page);
  const outcome = await page.evaluate(async (address) => {
    const refused = new Promise((done) => document.addEventListener("securitypolicyviolation", ({ effectiveDirective }) => done(effectiveDirective), { once: true }));
    const error = await fetch(address, { method: "POST", body: "a picture", mode: "no-cors" }).then(() => "sent", (e) => e.name);
    return { error, directive: await refused, beacon: navigator.sendBeacon(address, "a picture") };
  }, other.url);
  assert.deepEqual({ error: outcome.error, directive: outcome.directive }, { error: "TypeError", directive: "connect-src" });
  const [worker] = page.workers();
  // Every channel, on the scope and on what it inherits from; each answers with its error.
  const tried = await worker.evaluate(channels, other.url);
  for (const [channel, outcome] of Object.entries(tried)) t.diagnostic(`worker, ${channel}: ${outcome}`);
  t.diagnostic(`worker: the other server was asked for ${JSON.stringify(other.requests.map(({ path }) => path))}`);
  const { import: imported, ...rest } = tried;
  assert.deepEqual([...new Set(Object.values(rest))], ["TypeError"], "the worker has given up the network");
  // Syntax cannot be given up. Without a policy that comes with the worker's script it reaches any server.
  assert.equal(other.requests.filter(({ path }) => path !== "/imported.js").length, 0);
  assert.ok(["sent", "TypeError"].includes(imported));
  // What was tried is counted, whether or not it went anywhere.
  assert.match(await page.textContent("#bytes-sent"), /^18 bytes sent$/);
  const query = await page.evaluate(async (address) => {
    await fetch(`${address}?data=0123456789`, { mode: "no-cors" }).catch(() => undefined);
    return [document.querySelector("#bytes-sent").textContent, ...["RTCPeerConnection", "EventSource", "WebTransport"].map((name) => typeof globalThis[name])];
  }, other.url);
  assert.deepEqual(query, ["33 bytes sent", "undefined", "undefined", "undefined"]);
});

test("the first load, in bytes", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}?dwell=100000&no-offline`);
  await located(page);
  await page.waitForSelector("#map-frame canvas");
  const files = [...new Set(server.requests.map(({ path }) => (path === "/" ? "/index.html" : path)))];
  const groups = { page: 0, engine: 0, extractor: 0, three: 0, scene: 0, pictures: 0 };
  for (const path of files) {
    const bytes = readFileSync(join(site(), path));
    const group = path.includes("/three/") ? "three" : path.endsWith(".safetensors") ? "extractor" : path.endsWith(".landline") ? "scene" : path.endsWith(".jpg") ? "pictures" : path.includes("/vendor/landline/") ? "engine" : "page";
    groups[group] += group === "pictures" ? bytes.length : brotli(bytes);
  }
  const { scene, pictures, ...code } = groups;
  const total = Object.values(code).reduce((sum, n) => sum + n, 0);
  t.diagnostic(`first load without scene and pictures: ${total} bytes as brotli in ${files.length} files (${Object.entries(code).map(([name, n]) => `${name} ${n}`).join(", ")}); scene ${scene}, pictures ${pictures}`);
  assert.ok(total < 2_500_000, "a page that one waits for");
  const engines = files.filter((path) => /landline(_\w+)?_bg\.wasm$/.test(path));
  assert.equal(engines.length, 1, "one build of the engine");
  const engine = brotli(readFileSync(join(site(), engines[0])));
  t.diagnostic(`engine: ${engine} bytes as brotli`);
  assert.ok(engine <= 1_000_000);
});
