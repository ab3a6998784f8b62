/** The only file of the mapper that knows the generated bindings. */
import { LandlineError } from "../errors.js";
import init, { RawMapper, readPoses } from "./landline_mapper.js";

export { RawMapper, readPoses };

let memory: Promise<WebAssembly.Memory> | undefined;

/** Instantiates the mapping engine once per thread; later calls share the instance. A failure is not remembered. */
export function instantiate(module: WebAssembly.Module): Promise<WebAssembly.Memory> {
  memory ??= start(module).catch((error: unknown) => {
    memory = undefined;
    throw error;
  });
  return memory;
}

async function start(module: WebAssembly.Module): Promise<WebAssembly.Memory> {
  if (!WebAssembly.Module.exports(module).some(({ name }) => name === "rawmapper_create")) {
    throw new LandlineError("engine-version", "the mapper's wasm file has no rawmapper_create", "Pass landline_mapper_bg.wasm of the same version of the package.");
  }
  return (await init({ module_or_path: module })).memory;
}
