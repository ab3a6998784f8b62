/** The manifest as far as the page needs it, and the addresses in it. The engine checks the rest. */
import { LandlineError } from "../errors.js";
import type { PlaceManifest } from "./types.js";

/** Must equal `PLACE_VERSION` of src/place/manifest.rs. */
const version = 1;

/** Parses the text of a manifest. */
export function parseManifest(text: string, from: string): PlaceManifest {
  let json: Partial<PlaceManifest> | null;
  try {
    json = JSON.parse(text) as Partial<PlaceManifest> | null;
  } catch (error) {
    throw new LandlineError("scene-corrupt", `the place from ${from} is no JSON: ${String((error as Error).message ?? error)}`, "Check the address: a place is called NAME.place.json.", error);
  }
  if (json?.landline !== "place") throw new LandlineError("scene-corrupt", `the file from ${from} is no place`, "Check the address: a place is called NAME.place.json.");
  if (json.format !== version) {
    throw new LandlineError("scene-version", `the place from ${from} has format version ${String(json.format)}, this page reads version ${version}`, "Update this page, or build the place with a matching version of the landline tool.");
  }
  const isFile = (file: unknown): boolean => typeof (file as { url?: unknown } | null | undefined)?.url === "string" && typeof (file as { sha256?: unknown }).sha256 === "string";
  if (!isFile(json.index) || !Array.isArray(json.rooms) || !json.rooms.every((room) => isFile(room?.scene))) {
    throw new LandlineError("scene-corrupt", `the place from ${from} lacks its index, its rooms or their scenes`, "Build it anew with `landline place build`.");
  }
  return json as PlaceManifest;
}

/** The whole address of a manifest. */
export function addressOf(place: string | URL): string {
  const page = (globalThis as { location?: { href?: string } }).location?.href;
  try {
    return new URL(place, page).href;
  } catch {
    return String(place); // a path under Node
  }
}

/** The address of a file that a manifest names. */
export function addressBeside(base: string, url: string): string {
  try {
    return new URL(url, base).href;
  } catch {
    return base.replace(/[^/\\]*$/, "") + url;
  }
}
