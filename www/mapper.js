/** The engine's mapping part: a module, a worker and a wasm file of its own, loaded when it is first used. */
export async function loadMapper() {
  try {
    return await import("landline/mapper");
  } catch (error) {
    throw Object.assign(new Error("the mapping part of the engine could not be loaded"), { code: "asset-fetch", hint: "It is loaded once, when it is first used: connect to the network, then try again.", cause: error });
  }
}
