/** Which of the engine's builds runs here. */
import { LandlineError } from "./errors.js";
import { hasRelaxedSimd, hasSimd, isNode } from "./support.js";
import type { Build, CreateOptions } from "./types.js";

const host = (): string => (isNode() ? "this Node" : "this browser");

export interface Choice {
  build: Build;
  /** Why this one, as results tell it. */
  reason: string;
}

/** The build that was asked for, or the fastest that runs here. */
export function chooseBuild(asked: CreateOptions["build"] = "auto"): Choice {
  if (!hasSimd()) {
    throw new LandlineError("unsupported", "this browser has no WebAssembly SIMD", "Update the browser: Chrome 91, Firefox 89 and Safari 16.4 were the first to have it.");
  }
  if (asked === "plain") return { build: "plain", reason: "the plain build was asked for" };
  if (hasRelaxedSimd()) return { build: "relaxed", reason: `${host()} has relaxed SIMD` };
  if (asked === "relaxed") {
    throw new LandlineError("unsupported", `${host()} has no relaxed SIMD, which the build that was asked for needs`, "Leave the option build out: the plain build computes the same, only slower.");
  }
  return { build: "plain", reason: `${host()} has no relaxed SIMD` };
}

/** Where a build of the engine lies in this package; by default the one that is taken here. */
export function packagedWasmUrl(build: Build = chooseBuild().build): URL {
  // Written out: bundlers look for such addresses.
  return build === "relaxed" ? new URL("./landline_relaxed_bg.wasm", import.meta.url) : new URL("./landline_bg.wasm", import.meta.url);
}
