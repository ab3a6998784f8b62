/** The only file that knows the generated bindings. */
import { LandlineError } from "./errors.js";
import init, { build, RawFollower, RawPlace, RawRelocalizer } from "./landline.js";

export { build, RawFollower, RawPlace, RawRelocalizer };

let memory: Promise<WebAssembly.Memory> | undefined;

/** Instantiates the engine once per thread; later calls share the instance. A failure is not remembered. */
export function instantiate(module: WebAssembly.Module): Promise<WebAssembly.Memory> {
  memory ??= start(module).catch((error: unknown) => {
    memory = undefined;
    throw error;
  });
  return memory;
}

async function start(module: WebAssembly.Module): Promise<WebAssembly.Memory> {
  // The bindings keep whatever instance they get first, also one that turns out to be another program's.
  const names = new Set(WebAssembly.Module.exports(module).map(({ name }) => name));
  for (const name of ["memory", "__wbindgen_start", "build", "rawrelocalizer_create"]) {
    if (!names.has(name)) throw new LandlineError("engine-version", `the engine's wasm file has no ${name}`);
  }
  return (await init({ module_or_path: module })).memory;
}
