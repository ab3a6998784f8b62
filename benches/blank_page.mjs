// What the measurements in a browser share: headless Chromium with an empty page, and files beside it by their path.
import { createReadStream, existsSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { extname, join } from "node:path";
import { fileURLToPath } from "node:url";

export const root = fileURLToPath(new URL("../", import.meta.url));

const types = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".wasm": "application/wasm" };

/** `find(path)` names the file of a path, or gives its bytes, or nothing. `flags` go to the browser, which CHROME names. */
export async function blankPage(find, timeoutMs, flags = []) {
  const server = createServer((request, response) => {
    const path = decodeURIComponent(new URL(request.url, "http://localhost").pathname);
    if (path === "/blank.html") return void response.writeHead(200, { "content-type": "text/html" }).end("<!doctype html>");
    const file = find(path);
    if (file instanceof Uint8Array) return void response.writeHead(200).end(file);
    if (!file || !existsSync(file) || !statSync(file).isFile()) return void response.writeHead(404).end();
    response.writeHead(200, { "content-type": types[extname(file)] ?? "application/octet-stream" });
    createReadStream(file).pipe(response);
  });
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  const { chromium } = createRequire(join(root, "web/package.json"))("playwright-core");
  const browser = await chromium.launch({ executablePath: process.env.CHROME ?? "/usr/bin/chromium", headless: true, args: ["--no-sandbox", ...flags] });
  const page = await browser.newPage();
  page.setDefaultTimeout(timeoutMs);
  await page.goto(`http://localhost:${server.address().port}/blank.html`);
  const close = async () => {
    await browser.close();
    server.close();
  };
  return { page, browser, close };
}
