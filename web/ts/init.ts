/** Loads and compiles the engine's wasm. */
import { load, maxBytes, usualStallMs } from "./assets.js";
import { chooseBuild, packagedWasmUrl } from "./builds.js";
import { LandlineError } from "./errors.js";
import { isNode } from "./support.js";
import type { Build, CreateOptions } from "./types.js";

type InitOptions = { [K in "wasm" | "build" | "onProgress" | "signal" | "fetch" | "stallTimeoutMs"]?: CreateOptions[K] | undefined };

const compiled = new Map<string, Promise<WebAssembly.Module>>();

async function compileBytes(bytes: Uint8Array, from: string): Promise<WebAssembly.Module> {
  const magic = bytes.length >= 4 && bytes[0] === 0 && bytes[1] === 0x61 && bytes[2] === 0x73 && bytes[3] === 0x6d;
  if (!magic) {
    const head = Array.from(bytes.subarray(0, 4), (b) => b.toString(16).padStart(2, "0")).join(" ");
    throw new LandlineError("asset-mime", `the engine from ${from} is not WebAssembly: it begins with ${head || "nothing"} instead of 00 61 73 6d`, "Check that the engine's wasm file is served from this address.");
  }
  try {
    return await WebAssembly.compile(bytes as Uint8Array<ArrayBuffer>);
  } catch (error) {
    throw cannotCompile(error);
  }
}

function cannotCompile(error: unknown): LandlineError {
  const message = String((error as Error).message ?? error);
  if (/unsafe-eval|Content Security Policy|CSP/i.test(message)) {
    return new LandlineError("unsupported", `this page's security policy forbids WebAssembly: ${message}`, "Add 'wasm-unsafe-eval' to script-src.", error);
  }
  return new LandlineError("unsupported", `the engine could not be compiled: ${message}`, "Update the browser.", error);
}

async function compileFromUrl(url: string, options: InitOptions): Promise<WebAssembly.Module> {
  // Streaming compiles while downloading, and lets the browser keep the machine code; it insists on the MIME type.
  if (!isNode() && typeof WebAssembly.compileStreaming === "function") {
    const { stallTimeoutMs = usualStallMs } = options;
    const stop = new AbortController();
    const forward = (): void => stop.abort(options.signal?.reason);
    options.signal?.addEventListener("abort", forward, { once: true });
    let timer: ReturnType<typeof setTimeout> | undefined;
    const giveUp = (problem: string): void => stop.abort(new LandlineError("asset-fetch", `the engine from ${url} ${problem}`, "Check the connection, then try again."));
    /** Called with every arrival. */
    const watch = (loaded: number): void => {
      clearTimeout(timer);
      timer = setTimeout(() => giveUp(`stopped arriving: nothing came for ${stallTimeoutMs / 1000} s`), stallTimeoutMs);
      if (loaded > maxBytes.engine) giveUp(`is larger than ${maxBytes.engine / 2 ** 20} MiB`);
    };
    try {
      watch(0);
      let response: Response | undefined;
      try {
        response = await (options.fetch ?? globalThis.fetch)(url, { signal: stop.signal });
      } catch {
        stop.signal.throwIfAborted();
        response = undefined; // the plain way below has the words for what went wrong
      }
      const mime = response?.headers.get("content-type")?.split(";")[0]?.trim().toLowerCase();
      if (response?.ok && response.body && mime === "application/wasm") {
        const total = response.headers.get("content-encoding") ? 0 : Number(response.headers.get("content-length") ?? 0) || 0;
        const onBytes = (loaded: number): void => {
          watch(loaded);
          options.onProgress?.({ status: "download", file: "engine", url, loaded, total, fromCache: false });
        };
        onBytes(0);
        const counted = response.clone().body;
        const counting = counted ? count(counted, onBytes) : Promise.resolve(0);
        try {
          const module = await WebAssembly.compileStreaming(response);
          options.onProgress?.({ status: "done", file: "engine", bytes: await counting, fromCache: false });
          return module;
        } catch (error) {
          await counting.catch(() => 0);
          stop.signal.throwIfAborted();
          if (error instanceof WebAssembly.CompileError) throw cannotCompile(error);
          throw new LandlineError("asset-fetch", `the connection broke while the engine was loading from ${url}: ${String((error as Error).message ?? error)}`, "Check the connection, then try again.", error);
        }
      }
      await response?.body?.cancel().catch(() => undefined);
    } finally {
      clearTimeout(timer);
      options.signal?.removeEventListener("abort", forward);
    }
  }
  const { bytes } = await load(url, { ...options, file: "engine", cache: "none" });
  return compileBytes(bytes, url);
}

async function count(stream: ReadableStream<Uint8Array>, onBytes: (loaded: number) => void): Promise<number> {
  const reader = stream.getReader();
  let loaded = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return loaded;
    loaded += value.length;
    onBytes(loaded);
  }
}

/** A compiled engine, and why it is this one. */
export interface LoadedEngine {
  module: WebAssembly.Module;
  /** None where the caller gave the engine. */
  build: Build | undefined;
  buildReason: string;
}

/** The compiled engine. Compiled once per address; a failure is not remembered. */
export async function loadEngine(options: InitOptions): Promise<LoadedEngine> {
  const { build, reason: buildReason } = chooseBuild(options.build);
  const given = options.wasm;
  if (given === undefined) return { module: await fromAddress(packagedWasmUrl(build).href, options), build, buildReason };
  return { module: await fromGiven(given, options), build: undefined, buildReason: "the caller gave the engine" };
}

async function fromGiven(given: NonNullable<CreateOptions["wasm"]>, options: InitOptions): Promise<WebAssembly.Module> {
  if (given instanceof WebAssembly.Module) return given;
  if (given instanceof ArrayBuffer) return compileBytes(new Uint8Array(given), "the given bytes");
  if (given instanceof Uint8Array) return compileBytes(given, "the given bytes");
  return fromAddress(given instanceof URL ? given.href : resolve(given), options);
}

function fromAddress(url: string, options: InitOptions): Promise<WebAssembly.Module> {
  let module = compiled.get(url);
  if (!module) {
    // Shared between callers, so no single caller's signal may stop it.
    module = compileFromUrl(url, { ...options, signal: undefined });
    compiled.set(url, module);
    module.catch(() => compiled.delete(url));
  }
  return untilAborted(module, options.signal);
}

/** Rejects with the signal's reason as soon as it fires; the work itself goes on. */
function untilAborted<T>(work: Promise<T>, signal: AbortSignal | undefined): Promise<T> {
  if (!signal) return work;
  signal.throwIfAborted();
  return new Promise<T>((done, fail) => {
    const abort = (): void => fail(signal.reason);
    signal.addEventListener("abort", abort, { once: true });
    work.then(done, fail).finally(() => signal.removeEventListener("abort", abort));
  });
}

function resolve(address: string): string {
  const base = (globalThis as { location?: { href?: string } }).location?.href;
  try {
    return new URL(address, base).href;
  } catch {
    return address; // a path under Node
  }
}
