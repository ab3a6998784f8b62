// A browser, and a static server that can behave as badly as real ones do.
import { createReadStream, existsSync, mkdirSync, readFileSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { extname, join, normalize } from "node:path";
import { chrome, root, site, tools } from "./support.mjs";

const { chromium } = tools("playwright-core");

const types = {
  ".html": "text/html; charset=utf-8",
  ".js": "text/javascript",
  ".css": "text/css",
  ".svg": "image/svg+xml",
  ".json": "application/json",
  ".wasm": "application/wasm",
  ".webmanifest": "application/manifest+json",
  ".png": "image/png",
  ".jpg": "image/jpeg",
};

/**
 * Serves a folder. `faults` maps a path's ending to what goes wrong with it: `{ status }`, `{ type }` (another MIME
 * type), `{ cutAt }` (the connection breaks after so many bytes), `{ body }` (other content).
 */
export async function serve(test, { dir = site(), base = "/", headers = {}, faults = {} } = {}) {
  const requests = [];
  const state = { faults, down: false };
  const server = createServer((request, response) => {
    const path = decodeURIComponent(new URL(request.url, "http://localhost").pathname);
    requests.push({ method: request.method, path, length: Number(request.headers["content-length"] ?? 0) });
    if (state.down) return void request.socket.destroy();
    const name = path.startsWith(base) ? path.slice(base.length) : undefined;
    const file = name === undefined ? "" : join(dir, normalize(name === "" ? "index.html" : name));
    const fault = Object.entries(state.faults).find(([end]) => path.endsWith(end))?.[1] ?? {};
    if (fault.status || !file.startsWith(dir) || !existsSync(file) || !statSync(file).isFile()) {
      response.writeHead(fault.status ?? 404, { "content-type": "text/html" });
      return void response.end("<!doctype html><title>not here</title>");
    }
    const type = fault.type ?? types[extname(file)] ?? "application/octet-stream";
    if (fault.body !== undefined) {
      response.writeHead(200, { "content-type": type, ...headers });
      return void response.end(fault.body);
    }
    const size = statSync(file).size;
    response.writeHead(200, { "content-type": type, "content-length": size, "cache-control": "no-cache", ...headers });
    if (fault.cutAt === undefined) return void createReadStream(file).pipe(response);
    response.write(readFileSync(file).subarray(0, fault.cutAt), () => setTimeout(() => request.socket.destroy(), 50));
  });
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  test.after(() => {
    server.closeAllConnections();
    server.close();
  });
  // localhost, not the number: browsers give the camera and the caches to this name without HTTPS.
  return { url: `http://localhost:${server.address().port}${base}`, requests, state };
}

/** Flags for a machine without a screen, a graphics card, or a network of its own. */
const flags = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-background-networking", "--disable-component-update", "--disable-sync"];

export async function browser(test, extra = []) {
  const launched = await chromium.launch({ executablePath: chrome(), headless: true, args: [...flags, ...extra] });
  test.after(() => launched.close());
  return launched;
}

/** A page that remembers what its console and its errors said. */
export async function open(launched, address, options = {}) {
  const { init, ...context } = options;
  const made = await launched.newContext({ viewport: { width: 1440, height: 900 }, ...context });
  const page = await made.newPage();
  page.setDefaultTimeout(120_000);
  const said = [];
  page.on("console", (message) => {
    if (["error", "warning"].includes(message.type()) && !/ReadPixels|GPU stall|WebGL|swiftshader|No available adapters/i.test(message.text())) said.push(message.text());
  });
  page.on("pageerror", (error) => said.push(String(error)));
  if (init) await page.addInitScript(init);
  if (address) await page.goto(address);
  return { page, said, context: made };
}

/** Waits until the page shows a result for the n-th time or more. */
export async function located(page, atLeast = 1) {
  await page.waitForFunction((n) => document.querySelectorAll('.thumb[data-result="located"]').length >= n, atLeast);
}

/** Where screenshots are kept. */
export function artefact(name) {
  const dir = join(root, "target/test-artefacts");
  mkdirSync(dir, { recursive: true });
  return join(dir, name);
}

/** True when the sample scene was staged; without it the tests that need a place say so. */
export const haveSample = () => existsSync(join(site(), "scenes/sample/sample.landline"));
