// What the measurements in a browser share: headless Chromium with an empty page, and files beside it by their path.
import { spawn } from "node:child_process";
import { createReadStream, existsSync, mkdtempSync, readdirSync, readFileSync, rmSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { extname, join } from "node:path";
import { fileURLToPath } from "node:url";

export const root = fileURLToPath(new URL("../", import.meta.url));

const types = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".wasm": "application/wasm" };
const chromium = process.env.CHROME ?? "/usr/bin/chromium";

async function serve(find) {
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
  return { server, blank: `http://localhost:${server.address().port}/blank.html` };
}

/** `find(path)` names the file of a path, or gives its bytes, or nothing. `flags` go to the browser, which CHROME names. */
export async function blankPage(find, timeoutMs, flags = []) {
  const { server, blank } = await serve(find);
  const playwright = createRequire(join(root, "web/package.json"))("playwright-core");
  const browser = await playwright.chromium.launch({ executablePath: chromium, headless: true, args: ["--no-sandbox", ...flags] });
  const page = await browser.newPage();
  page.setDefaultTimeout(timeoutMs);
  await page.goto(blank);
  const close = async () => {
    await browser.close();
    server.close();
  };
  return { page, browser, close };
}

/**
 * The same page for measurements of memory. Playwright has DevTools record the network, and the record keeps, in the page's own process,
 * what the page reads as a stream: here nothing of DevTools is switched on but the runtime and the list of workers.
 */
export async function unwatchedPage(find, flags = []) {
  const { server, blank } = await serve(find);
  const folder = mkdtempSync(join(tmpdir(), "landline-chromium-"));
  const quiet = ["--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-renderer-backgrounding", "--disable-background-timer-throttling"];
  const browser = spawn(chromium, ["--headless", "--no-sandbox", "--remote-debugging-pipe", `--user-data-dir=${folder}`, ...quiet, ...flags, "about:blank"], { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
  const ended = new Promise((done) => browser.once("exit", done));
  const [, , , ask, answers] = browser.stdio;
  const waiting = new Map();
  const workers = new Set();
  /** Errors that nothing in the page caught. */
  const errors = [];
  let rest = "";
  answers.setEncoding("utf8").on("data", (text) => {
    const messages = (rest + text).split("\0");
    rest = messages.pop();
    for (const { id, method, params, result, error } of messages.map((message) => JSON.parse(message))) {
      if (method === "Target.attachedToTarget" && params.targetInfo.type === "worker") workers.add(params.sessionId);
      if (method === "Target.detachedFromTarget") workers.delete(params.sessionId);
      if (method === "Runtime.exceptionThrown") errors.push(params.exceptionDetails.exception?.description ?? params.exceptionDetails.text);
      const call = waiting.get(id);
      waiting.delete(id);
      if (error) call?.fail(new Error(error.message));
      else call?.done(result);
    }
  });
  void ended.then(() => waiting.forEach(({ fail }) => fail(new Error("the browser has ended"))));
  let calls = 0;
  const call = (method, params, sessionId) =>
    new Promise((done, fail) => {
      calls += 1;
      waiting.set(calls, { done, fail });
      ask.write(`${JSON.stringify({ id: calls, method, params, sessionId })}\0`);
    });
  const { targetId } = await call("Target.createTarget", { url: blank });
  const { sessionId } = await call("Target.attachToTarget", { targetId, flatten: true });
  const send = (method, params = {}) => call(method, params, sessionId);
  await send("Runtime.enable");
  await send("Target.setAutoAttach", { autoAttach: true, waitForDebuggerOnStart: false, flatten: true });
  /** Runs a function in the page and returns what it answers. */
  const evaluate = async (run, argument) => {
    const { result, exceptionDetails } = await send("Runtime.evaluate", { expression: `(${run})(${JSON.stringify(argument)})`, awaitPromise: true, returnByValue: true });
    if (exceptionDetails) throw new Error(exceptionDetails.exception?.description ?? exceptionDetails.text);
    return result.value;
  };
  // The page may still be the one that a tab begins with.
  while (!(await evaluate((address) => location.href === address && document.readyState === "complete", blank))) await new Promise((done) => setTimeout(done, 20));
  const { product } = await call("Browser.getVersion");
  const close = async () => {
    browser.kill();
    await ended;
    server.close();
    server.closeAllConnections();
    rmSync(folder, { recursive: true, force: true });
  };
  return { evaluate, send, workers, errors, product, close };
}

/** Megabytes of each of the browser's renderers, where the system tells: its own, and the most that it ever held. They descend from this process. */
export function renderers() {
  if (process.platform !== "linux") return [];
  const processes = new Map();
  for (const pid of readdirSync("/proc").filter((name) => /^\d+$/.test(name))) {
    try {
      const status = readFileSync(`/proc/${pid}/status`, "utf8");
      const number = (key) => Number(new RegExp(`${key}:\\s+(\\d+)`).exec(status)?.[1] ?? 0);
      const command = readFileSync(`/proc/${pid}/cmdline`, "utf8");
      processes.set(Number(pid), { parent: number("PPid"), own: number("RssAnon") / 1024, peak: number("VmHWM") / 1024, isRenderer: command.includes("--type=renderer") });
    } catch {
      // It has ended meanwhile.
    }
  }
  const descends = (pid) => pid === process.pid || (processes.has(pid) && descends(processes.get(pid).parent));
  return [...processes].filter(([pid, { isRenderer }]) => isRenderer && descends(pid)).map(([, { own, peak }]) => ({ own, peak }));
}

/** Megabytes of their own that the browser's renderers hold together; not a number where the system does not tell. */
export function renderersMb() {
  return process.platform === "linux" ? renderers().reduce((sum, { own }) => sum + own, 0) : NaN;
}
