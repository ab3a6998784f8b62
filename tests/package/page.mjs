// A browser, and a static server that can behave as badly as real ones do.
import { createHash } from "node:crypto";
import { createReadStream, existsSync, mkdirSync, readFileSync, statSync } from "node:fs";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
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
 * type), `{ cutAt }` (the connection breaks after so many bytes), `{ body }` (other content), `{ stallAt }` (nothing comes
 * after so many bytes), `{ endless }` (never stops), `{ announce }` (another length than there is). Files carry an `ETag`.
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
    const content = Buffer.from(fault.body ?? readFileSync(file));
    const etag = `"${createHash("sha256").update(content).digest("hex").slice(0, 16)}"`;
    const version = { etag, "cache-control": "no-cache" };
    if (request.headers["if-none-match"] === etag) {
      response.writeHead(304, { ...version, ...headers });
      return void response.end();
    }
    if (fault.endless) {
      response.writeHead(200, { "content-type": type, ...headers });
      const more = Buffer.alloc(1 << 20);
      const write = () => {
        while (!response.destroyed && response.write(more));
      };
      response.on("drain", write);
      return void write();
    }
    if (fault.body !== undefined) {
      response.writeHead(200, { "content-type": type, ...version, ...headers });
      return void response.end(content);
    }
    response.writeHead(200, { "content-type": type, "content-length": fault.announce ?? content.length, ...version, ...headers });
    if (fault.stallAt !== undefined) return void response.write(content.subarray(0, fault.stallAt));
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

/** Flags for WebGPU on the software adapter. */
export const softwareGpu = ["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader"];

/** An empty page of the site with the package as `landline`, `make(options)` and `failure(promise)` at hand. */
export async function blank(test, flags = []) {
  const server = await serve(test);
  const opened = await open(await browser(test, flags));
  await opened.page.route("**/blank.html", (route) => route.fulfill({ contentType: "text/html", body: "<!doctype html><meta charset=utf-8>" }));
  await opened.page.goto(`${server.url}blank.html`);
  await opened.page.evaluate(async () => {
    globalThis.landline = await import("./vendor/landline/index.js");
    globalThis.make = (options = {}) => globalThis.landline.Relocalizer.create({ scene: "./scenes/sample/sample.landline", device: "cpu", ...options });
    globalThis.sample = await (await fetch("./scenes/sample/sample.json")).json();
    globalThis.picture = async (i) => (await fetch(`./scenes/sample/${globalThis.sample.pictures[i].name}`)).blob();
    // A video of a canvas. A canvas that nobody paints gives no frames, so it is painted over with itself.
    globalThis.playing = async (canvas) => {
      const video = document.createElement("video");
      video.muted = true;
      video.srcObject = canvas.captureStream(10);
      setInterval(() => canvas.getContext("2d").drawImage(canvas, 0, 0), 100);
      await video.play();
      return video;
    };
    globalThis.failure = async (promise) => {
      try {
        await promise;
        return "no error";
      } catch (error) {
        return typeof error.code === "string" ? error.code : error.name;
      }
    };
  });
  return { server, ...opened };
}

/**
 * A camera that shows JPEG files one after another, each for so many frames: flags for the browser. Motion JPEG is
 * nothing but such files in a row.
 */
export async function fakeCamera(test, jpegs, framesEach) {
  const folder = await mkdtemp(join(tmpdir(), "landline-camera-"));
  test.after(() => rm(folder, { recursive: true, force: true }));
  const file = join(folder, "walk.mjpeg");
  const pictures = await Promise.all(jpegs.map((path) => readFile(path)));
  await writeFile(file, Buffer.concat(pictures.flatMap((picture) => Array(framesEach).fill(picture))));
  return ["--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream", `--use-file-for-fake-video-capture=${file}`];
}

/** Paths and camera of the sample pictures. */
export async function sampleFiles() {
  const folder = join(site(), "scenes/sample");
  const { pictures, camera } = JSON.parse(await readFile(join(folder, "sample.json"), "utf8"));
  return { folder, camera, pictures: pictures.map(({ name, ...rest }) => ({ ...rest, name, path: join(folder, name) })) };
}

/** The sample scene as a file that does not say which camera took its pictures: the focal length has to be found. */
export async function sceneOfUnknownCamera() {
  const bytes = await readFile(join(site(), "scenes/sample/sample.landline"));
  const end = 8 + Number(bytes.readBigUInt64LE(0));
  const header = JSON.parse(bytes.subarray(8, end).toString());
  delete header.__metadata__.camera;
  const text = Buffer.from(JSON.stringify(header));
  const length = Buffer.alloc(8);
  length.writeBigUInt64LE(BigInt(text.length));
  return Buffer.concat([length, text, bytes.subarray(end)]);
}

/** Waits until the page shows a result for the n-th time or more. */
export async function located(page, atLeast = 1) {
  await page.waitForFunction((n) => document.querySelectorAll('.thumb[data-result="located"]').length >= n, atLeast);
}

/** Hides the page, as another tab or a locked phone does, or shows it again. */
export const hide = (page, hidden) =>
  page.evaluate((value) => {
    Object.defineProperty(document, "hidden", { value, configurable: true });
    document.dispatchEvent(new Event("visibilitychange"));
  }, hidden);

/** Waits until the page is kept for use without a network. */
export const keptOffline = (page) =>
  page.evaluate(async () => {
    const { active } = await navigator.serviceWorker.ready;
    if (active.state !== "activated") await new Promise((done) => active.addEventListener("statechange", done, { once: true }));
  });

/** What axe finds against WCAG 2.2 A and AA, as sentences. */
export async function violations(page) {
  await page.evaluate(readFileSync(join(root, "web/node_modules/axe-core/axe.min.js"), "utf8"));
  return page.evaluate(async () => {
    const { violations: found } = await globalThis.axe.run(document, { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"] });
    return found.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.target.join(" ")).join(", ")}`);
  });
}

/** A video as browsers record them, without a word on how long it is: the picture stands `still`, or a `pan` goes over it. */
export async function recorded(page, { picture, size: [width, height], ms, draw }) {
  const text = await page.evaluate(
    async ([url, w, h, length, code]) => {
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = [w, h];
      const context = canvas.getContext("2d");
      const bitmap = await createImageBitmap(await (await fetch(url)).blob());
      const paint = { still: () => context.drawImage(bitmap, 0, 0, w, h), pan: (n) => context.drawImage(bitmap, -4 * n, 0, 1.5 * w, h) }[code];
      const recorder = new MediaRecorder(canvas.captureStream(15), { mimeType: "video/webm;codecs=vp8", videoBitsPerSecond: 8e6 });
      const parts = [];
      recorder.ondataavailable = ({ data }) => parts.push(data);
      recorder.start(250);
      let n = 0;
      const painting = setInterval(() => paint(n++), 50);
      // A machine that is busy brings no frames for a while: it takes as long as it takes.
      const started = performance.now();
      const bytesSoFar = () => parts.reduce((sum, part) => sum + part.size, 0);
      while (performance.now() - started < length || (bytesSoFar() < 8000 && performance.now() - started < 60_000)) await new Promise((done) => setTimeout(done, 100));
      const stopped = new Promise((done) => (recorder.onstop = done));
      recorder.stop();
      clearInterval(painting);
      await stopped;
      const bytes = new Uint8Array(await new Blob(parts).arrayBuffer());
      return btoa(Array.from(bytes, (b) => String.fromCharCode(b)).join(""));
    },
    [picture, width, height, ms, draw],
  );
  return Buffer.from(text, "base64");
}

/** Where screenshots are kept. */
export function artefact(name) {
  const dir = join(root, "target/test-artefacts");
  mkdirSync(dir, { recursive: true });
  return join(dir, name);
}

/** True when the sample scene was staged; without it the tests that need a place say so. */
export const haveSample = () => existsSync(join(site(), "scenes/sample/sample.landline"));
