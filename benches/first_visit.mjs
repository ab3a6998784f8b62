// A first visit to the demo page on a slow line: when its first progress and its first position are there, and how many
// bytes that took. Two built pages take turns, so that the machine's state is the same for both.
//
//   cargo xtask web
//   node benches/first_visit.mjs SITE [OTHER_SITE] [rounds]
//
// Files are served with brotli at its strongest, from memory, by HTTP/1.1; Chromium takes 300 ms for every answer and
// 1.6 Mbit/s for all (CHROME names it, LINE="latency_ms,kbit" another line). Times count from the navigation.
import { existsSync, readFileSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { extname, join, normalize, resolve } from "node:path";
import { loadavg } from "node:os";
import { fileURLToPath } from "node:url";
import { brotliCompressSync } from "node:zlib";

const root = fileURLToPath(new URL("../", import.meta.url));
const args = process.argv.slice(2);
const rounds = /^\d+$/.test(args.at(-1) ?? "") ? Number(args.pop()) : 3;
const sites = args.map((folder) => resolve(folder));
if (sites.length === 0) throw new Error("usage: node benches/first_visit.mjs SITE [OTHER_SITE] [rounds]");
const [latency, kbit] = (process.env.LINE ?? "300,1600").split(",").map(Number);
const types = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".json": "application/json", ".wasm": "application/wasm", ".webmanifest": "application/manifest+json", ".jpg": "image/jpeg" };

const compressed = new Map();
function answer(file) {
  if (!compressed.has(file)) compressed.set(file, extname(file) === ".jpg" ? readFileSync(file) : brotliCompressSync(readFileSync(file)));
  return compressed.get(file);
}

function serve(dir) {
  const sent = [];
  const server = createServer((request, response) => {
    const path = decodeURIComponent(new URL(request.url, "http://localhost").pathname);
    const file = join(dir, normalize(path === "/" ? "index.html" : path));
    if (!file.startsWith(dir) || !existsSync(file) || !statSync(file).isFile()) return void response.writeHead(404).end();
    const body = answer(file);
    sent.push({ path, bytes: body.length, at: performance.now() });
    response.writeHead(200, { "content-type": types[extname(file)] ?? "application/octet-stream", "content-length": body.length, ...(extname(file) === ".jpg" ? {} : { "content-encoding": "br" }) }).end(body);
  });
  return new Promise((done) => server.listen(0, "127.0.0.1", () => done({ sent, server, url: `http://localhost:${server.address().port}/` })));
}

const { chromium } = createRequire(join(root, "web/package.json"))("playwright-core");
const browser = await chromium.launch({ executablePath: process.env.CHROME ?? "/usr/bin/chromium", headless: true, args: ["--no-sandbox"] });

/** Seconds until the first progress and the first position, and bytes by kind that were asked for until then. */
async function visit(dir) {
  const { sent, server, url } = await serve(dir);
  const context = await browser.newContext({ viewport: { width: 1280, height: 900 } });
  const page = await context.newPage();
  page.setDefaultTimeout(180_000);
  const line = await context.newCDPSession(page);
  await line.send("Network.enable");
  await line.send("Network.emulateNetworkConditions", { offline: false, latency, downloadThroughput: (kbit * 1000) / 8, uploadThroughput: (kbit * 1000) / 8 });
  await page.addInitScript(() => {
    globalThis.seen = {};
    const note = (name) => (globalThis.seen[name] ??= performance.now());
    const look = () => {
      if ([...document.querySelectorAll("#bars progress")].some((bar) => bar.hasAttribute("value") && bar.value > 0)) note("progress");
      if (document.querySelector("#bars progress")) note("bar");
      if (globalThis.landlinePage?.state.result?.located) note("position");
      requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
  });
  await page.goto(`${url}?no-offline&dwell=100000&device=cpu`, { waitUntil: "commit" });
  await page.waitForFunction(() => globalThis.seen.position);
  const seen = await page.evaluate(() => ({ ...globalThis.seen, start: performance.timeOrigin }));
  const until = seen.start + seen.position - performance.timeOrigin;
  const bytes = { scene: 0, pictures: 0, other: 0 };
  for (const { path, bytes: count, at } of sent) if (at < until) bytes[path.endsWith(".landline") ? "scene" : path.endsWith(".jpg") ? "pictures" : "other"] += count;
  await context.close();
  server.closeAllConnections();
  server.close();
  return { bar: seen.bar / 1000, progress: (seen.progress ?? NaN) / 1000, position: seen.position / 1000, ...bytes };
}

for (const dir of sites) await visit(dir); // compresses, and warms the machine
const rows = new Map(sites.map((dir) => [dir, []]));
for (let round = 0; round < rounds; round++) for (const dir of sites) rows.get(dir).push(await visit(dir));
const version = browser.version();
await browser.close();

const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];
console.log(`Chromium ${version}, ${latency} ms, ${kbit} kbit/s, ${rounds} visits each, load ${loadavg()[0].toFixed(1)}`);
console.log("a bar s, progress s, position s; bytes until the position without scene and pictures, scene, pictures");
sites.forEach((dir, i) => {
  const of = (key) => median(rows.get(dir).map((row) => row[key]));
  console.log(`${"AB"[i] ?? i}  ${of("bar").toFixed(1)}  ${of("progress").toFixed(1)}  ${of("position").toFixed(1)}   ${of("other")}  ${of("scene")}  ${of("pictures")}`);
});
