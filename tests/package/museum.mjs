// A place of three rooms that the native tool makes of the sample scene: `hall` is the sample, `attic` and `cellar` are of the same
// shape and look like nothing in it.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { existsSync } from "node:fs";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { haveSample } from "./page.mjs";
import { root, run, site } from "./support.mjs";

const native = process.env.LANDLINE_NATIVE ?? join(root, "target/debug/landline");
export const skip = !haveSample() ? "the sample scene is not there: run `cargo xtask sample`" : !existsSync(native) ? "the native tool is not built: run `cargo xtask demo --no-serve`" : false;

export const hash = (bytes) => createHash("sha256").update(bytes).digest("hex");

/** The scene with descriptors and codes turned into their opposites. */
function otherwise(scene) {
  const bytes = Buffer.from(scene);
  const length = Number(bytes.readBigUInt64LE(0));
  const header = JSON.parse(bytes.subarray(8, 8 + length));
  for (const [name, tensor] of Object.entries(header)) {
    if (name === "__metadata__") continue;
    const [from, to] = tensor.data_offsets.map((offset) => 8 + length + offset);
    const change = name.endsWith(".anchor.keys") ? (value) => -value : name.endsWith(".codes") ? (value) => ~value : undefined;
    for (let i = from; change && i < to; i++) bytes[i] = change(bytes[i]);
  }
  return bytes;
}

/** Builds a place of scenes, by their rooms' ids: its manifest, and all files by their names. */
export async function placeOf(t, rooms) {
  const folder = await mkdtemp(join(tmpdir(), "landline-museum-"));
  t.after(() => rm(folder, { recursive: true, force: true }));
  for (const [id, bytes] of Object.entries(rooms)) await writeFile(join(folder, `${id}.landline`), bytes);
  const path = join(folder, "museum.place.json");
  const { status, stderr } = await run(native, ["place", "build", folder, "--out", path, "--name", "Museum"], root);
  assert.equal(status, 0, stderr);
  const manifest = JSON.parse(await readFile(path, "utf8"));
  const files = { "museum.place.index": await readFile(join(folder, "museum.place.index")), ...Object.fromEntries(Object.entries(rooms).map(([id, bytes]) => [`${id}.landline`, bytes])) };
  return { manifest, files };
}

/** A quarter turn about z, twice as large, shifted. */
const placed = { qwxyz: [Math.SQRT1_2, 0, 0, Math.SQRT1_2], t: [10, 20, 30], scale: 2 };
/** Where a point of the hall is in the place. */
export const inPlace = ([x, y, z]) => [10 - 2 * y, 20 + 2 * x, 30 + 2 * z];

/** The three rooms; the cellar is beside the hall, the attic above it. */
export async function museum(t) {
  const scene = await readFile(join(site(), "scenes/sample/sample.landline"));
  const { manifest, files } = await placeOf(t, { attic: otherwise(scene), cellar: otherwise(scene), hall: scene });
  const [attic, cellar, hall] = manifest.rooms;
  Object.assign(hall, { name: "Great hall", floor: 0, neighbours: ["attic", "cellar"], place_from_room: placed });
  Object.assign(cellar, { floor: 0, place_from_room: { ...placed, t: [placed.t[0] + 14, placed.t[1], placed.t[2]] } });
  Object.assign(attic, { floor: 1, place_from_room: { ...placed, t: [placed.t[0], placed.t[1], placed.t[2] + 8] } });
  return { scene, manifest, files };
}

/** Serves a place at `museum/` beside a page. `now(manifest, changes)` says what is there; `asked` lists what was asked for since. */
export async function hang(page) {
  const state = { asked: [], isOffline: false, files: {} };
  state.now = (manifest, files) => {
    state.asked = [];
    state.files = { "museum.place.json": typeof manifest === "string" ? manifest : JSON.stringify(manifest), ...files };
  };
  await page.route("**/museum/*", async (route) => {
    const name = new URL(route.request().url()).pathname.split("/").pop();
    state.asked.push(name);
    if (state.isOffline) return route.abort("internetdisconnected");
    const body = state.files[name];
    await (body === undefined ? route.fulfill({ status: 404, body: "not here" }) : route.fulfill({ body }));
  });
  return state;
}
