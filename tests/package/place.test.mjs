// landline/place in a browser: a place that the native tool makes of the sample scene and of one that looks otherwise. Which room
// a picture is of and where that is in the place; twins; rooms whose files are not as they should be; without a network.
import assert from "node:assert/strict";
import { test } from "node:test";
import { hang, hash, inPlace, museum, placeOf, skip } from "./museum.mjs";
import { blank } from "./page.mjs";

/** The scene as if it were taught with another extractor. */
function foreign(scene) {
  const bytes = Buffer.from(scene);
  const length = Number(bytes.readBigUInt64LE(0));
  const { extractor_sha256: own } = JSON.parse(bytes.subarray(8, 8 + length)).__metadata__;
  bytes.write("0".repeat(own.length), bytes.indexOf(own));
  return bytes;
}

test("a place of many rooms", { skip, timeout: 300_000 }, async (t) => {
  const { scene, manifest, files } = await museum(t);
  assert.ok(manifest.rooms[2].outline.length >= 4, "the tool draws a floor plan");
  const { page } = await blank(t);
  const server = await hang(page);
  const serveNow = (changes = {}, place = manifest) => server.now(place, { ...files, ...changes });
  await page.evaluate(async () => {
    const { Place } = await import("./vendor/landline/place/index.js");
    globalThis.enter = async (options = {}) => {
      const place = await Place.create({ place: "./museum/museum.place.json", prefetch: false, ...options });
      const told = { rooms: [], refused: [] };
      place.on("room", ({ room }) => told.rooms.push(room.id));
      place.on("refused", ({ room, error }) => told.refused.push([room.id, error.code]));
      return { place, told };
    };
    /** What a new place makes of a picture. */
    globalThis.ask = async (options) => {
      const { place, told } = await globalThis.enter(options);
      const { located, reason, room, rivals, missing } = await place.locate(await globalThis.picture(3), { intrinsics: globalThis.sample.camera });
      await place.dispose();
      return { located, reason, room: room?.id, rivals: rivals?.toSorted(), missing: missing?.toSorted(), ...told };
    };
  });
  const ask = (options) => page.evaluate((options) => globalThis.ask(options), options);
  const right = { located: true, reason: undefined, room: "hall", rivals: undefined, missing: undefined, rooms: ["hall"], refused: [] };

  await t.test("a picture is found in its room and in the place, and only scenes that are needed are loaded", async () => {
    serveNow();
    const seen = await page.evaluate(async () => {
      const { camera, pictures } = globalThis.sample;
      const events = new Set();
      const { place, told } = await globalThis.enter({ onProgress: (event) => events.add(`${event.status} ${event.file ?? ""}`.trim()) });
      const before = place.room;
      const blobs = [await globalThis.picture(3), await globalThis.picture(4)];
      // Handed in together: each gets its own answer.
      const results = await Promise.all(blobs.map((blob) => place.locate(blob, { intrinsics: camera })));
      const answers = results.map((result, i) => {
        const truth = globalThis.landline.invertRigid(pictures[3 + i].cam_from_world.flat());
        return { room: result.room.id, at: Object.values(result.placement.position), inPlace: Object.values(result.placementInPlace.position), truth: [truth[3], truth[7], truth[11]] };
      });
      const memory = await place.memory();
      const after = place.room.id;
      await place.dispose();
      return { before, after, answers, told, memory, events: [...events], disposed: await globalThis.failure(place.locate(blobs[0])) };
    });
    assert.equal(seen.before, undefined);
    const off = (a, b) => Math.hypot(...a.map((v, i) => v - b[i]));
    for (const { room, at, inPlace: there, truth } of seen.answers) {
      assert.equal(room, "hall");
      assert.ok(off(at, truth) < 0.05, `${off(at, truth)} m off`);
      assert.ok(off(there, inPlace(at)) < 1e-9, `${there} in the place for ${at} in the room`);
    }
    assert.deepEqual(seen.told, { rooms: ["hall"], refused: [] });
    assert.equal(seen.after, "hall");
    assert.ok(seen.memory.sceneBytes > 100_000 && seen.memory.sceneBytes < seen.memory.wasmBytes);
    assert.equal(seen.disposed, "disposed");
    for (const event of ["done place", "done index", "done scene", "ready"]) assert.ok(seen.events.includes(event), event);
    assert.deepEqual(server.asked, ["museum.place.json", "museum.place.index", "hall.landline"]);
  });

  await t.test("rooms beside the present one come early, and go where memory is short", async () => {
    const seen = await page.evaluate(async () => {
      const locate = async (place) => place.locate(await globalThis.picture(3), { intrinsics: globalThis.sample.camera });
      const held = async (place) => (await place.memory()).sceneBytes;
      const { place: tight } = await globalThis.enter({ maxBytes: 1 });
      const sizes = [];
      for (const next of [() => locate(tight), () => locate(tight), () => tight.load("attic"), () => tight.load("cellar")]) {
        await next();
        sizes.push(await held(tight));
      }
      const { room } = await locate(tight);
      await tight.dispose();
      const { place: roomy } = await globalThis.enter({ prefetch: true });
      await locate(roomy);
      let all = 0;
      // The neighbours come while nobody waits.
      for (let i = 0; i < 500 && all < 3 * sizes[0]; i++) {
        await new Promise((done) => setTimeout(done, 20));
        all = await held(roomy);
      }
      await roomy.dispose();
      return { all, sizes, room: room.id };
    });
    const [one, , two, three] = seen.sizes;
    assert.deepEqual([two / one, three / one, seen.all / one], [2, 2, 3]);
    assert.equal(seen.room, "hall");
  });

  await t.test("without a network what was kept serves, and what was not is told", async () => {
    server.isOffline = true;
    assert.deepEqual(await ask(), right);
    await page.evaluate(async () => {
      const cache = await caches.open("landline-v1");
      for (const request of await cache.keys()) if (request.url.endsWith("hall.landline")) await cache.delete(request);
    });
    const lost = await ask();
    server.isOffline = false;
    assert.deepEqual(lost, { ...right, located: false, reason: lost.reason, room: undefined, rooms: [], missing: ["hall"], refused: [["hall", "asset-fetch"]] });
  });

  await t.test("a scene that is gone, damaged or of another extractor is refused, and the others go on", async () => {
    const refusal = async (code, changes, place) => {
      serveNow(changes, place);
      const { located, room, refused } = await ask({ cache: "none" });
      assert.deepEqual([located, room, refused], [false, undefined, [["hall", code]]], code);
    };
    const damaged = Buffer.from(scene);
    damaged[damaged.length - 1] ^= 1;
    await refusal("asset-fetch", { "hall.landline": undefined });
    await refusal("asset-integrity", { "hall.landline": damaged });
    const other = foreign(scene);
    const told = structuredClone(manifest);
    told.rooms[2].scene.sha256 = hash(other);
    await refusal("scene-extractor", { "hall.landline": other }, told);
    // Another room's scene is another room's trouble.
    serveNow({ "attic.landline": undefined });
    const seen = await page.evaluate(async () => {
      const { place, told } = await globalThis.enter({ cache: "none" });
      const loaded = [await place.load("attic"), await place.load("cellar"), await globalThis.failure(place.load("tower"))];
      const { room } = await place.locate(await globalThis.picture(3), { intrinsics: globalThis.sample.camera });
      await place.dispose();
      return { loaded, room: room?.id, ...told };
    });
    assert.deepEqual(seen, { loaded: [false, true, "bad-input"], room: "hall", rooms: ["hall"], refused: [["attic", "asset-fetch"]] });
  });

  await t.test("twins leave it open which of them it is", async () => {
    // As if somebody had copied a file: the index knows two rooms that are one.
    const twins = await placeOf(t, { east: scene, west: scene });
    server.now(twins.manifest, twins.files);
    assert.deepEqual(await ask({ cache: "none" }), { ...right, located: false, reason: "ambiguous", room: undefined, rivals: ["east", "west"], rooms: [] });
  });

  await t.test("a place that is none, of a later version, with impossible rooms or without its index is a typed error", async () => {
    const failing = async (body, changes = {}) => {
      serveNow(changes, body);
      return page.evaluate(() => globalThis.failure(globalThis.enter({ cache: "none" })));
    };
    assert.equal(await failing("{}"), "scene-corrupt");
    assert.equal(await failing("{"), "scene-corrupt");
    assert.equal(await failing({ ...manifest, format: 2 }), "scene-version");
    assert.equal(await failing({ ...manifest, rooms: manifest.rooms.map((room) => ({ ...room, neighbours: [room.id] })) }), "scene-corrupt");
    assert.equal(await failing({ ...manifest, extractor_sha256: "0".repeat(64) }), "scene-extractor");
    assert.equal(await failing(manifest, { "museum.place.index": undefined }), "asset-fetch");
    assert.equal(await failing(manifest, { "museum.place.index": "not the index" }), "asset-integrity");
    assert.equal(await page.evaluate(() => globalThis.failure(globalThis.enter({ plaice: 1 }))), "bad-input");
    assert.equal(await page.evaluate(() => globalThis.failure(globalThis.enter({ maxBytes: -1 }))), "bad-input");
  });
});
