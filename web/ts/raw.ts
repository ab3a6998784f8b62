/** The only file that knows the generated bindings. */
import init, { RawRelocalizer } from "./landline.js";

export { RawRelocalizer };

let memory: Promise<WebAssembly.Memory> | undefined;

/** Instantiates the engine once per thread; later calls share the instance. */
export function instantiate(module: WebAssembly.Module): Promise<WebAssembly.Memory> {
  memory ??= init({ module_or_path: module }).then((exports) => exports.memory);
  return memory;
}
