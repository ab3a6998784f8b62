/**
 * The pictures of a film that became keyframes. They are kept in the origin's private file system as they come, so that a
 * page which is reloaded or thrown out of memory goes on where it was.
 */
import { canKeep, folder, names, read, removeFolder, write } from "./files.js";

const where = "landline-film";
/** Longer side of kept pictures: enough to look at and to go on with. */
const maxSide = 1280;
const quality = 0.92;

let claimed;

/** Only one tab keeps a film, from here on until it is closed; true when that is this one. */
async function claim() {
  if (!navigator.locks) return true;
  claimed ??= new Promise((done) => {
    void navigator.locks.request(where, { ifAvailable: true }, (lock) => {
      done(lock !== null);
      return lock && new Promise(() => {});
    });
  });
  const mine = await claimed;
  if (!mine) claimed = undefined;
  return mine;
}

export class Film {
  /** `camera`, `video` or `pictures`. */
  source;
  started;
  /** `{ keyframe, timestamp, name, blob }`, in the order of filming; `keyframe` is the mapper's number, once it has one. */
  pictures = [];
  /** Why the pictures are no longer kept, if so. They stay in memory. */
  unkept;
  #directory;
  /** Number of the next file: names are in the order of filming. */
  #next = 0;

  constructor(source, started) {
    this.source = source;
    this.started = started;
  }

  /** A new film in place of the one that was kept. */
  static async begin(source) {
    const film = new Film(source, new Date().toISOString());
    try {
      if (!(await claim())) throw new Error("another tab of this page keeps a film");
      await removeFolder(where);
      film.#directory = await folder(where);
      await write(film.#directory, "film.json", JSON.stringify({ source, started: film.started }));
    } catch (error) {
      film.#directory = undefined;
      film.unkept = error;
    }
    return film;
  }

  /** The film that an earlier visit left unfinished, if there is one. */
  static async left() {
    if (!canKeep() || !(await claim())) return undefined;
    try {
      const directory = await folder(where);
      const all = await names(directory);
      const files = all.filter((name) => name.endsWith(".jpg"));
      if (files.length === 0 || !all.includes("film.json")) return undefined;
      const { source, started } = JSON.parse(await (await read(directory, "film.json")).text());
      const film = new Film(source, started);
      film.#directory = directory;
      for (const name of files) {
        const [number, timestamp] = name.replace(".jpg", "").split("-").map(Number);
        film.#next = number + 1;
        film.pictures.push({ keyframe: undefined, timestamp, name, blob: await read(directory, name) });
      }
      return film;
    } catch {
      // What cannot be read is not offered.
      return undefined;
    }
  }

  /** Keeps a picture; `source` is anything that can be drawn. Storage that is full is remembered, not thrown. */
  async add(keyframe, timestamp, source, name) {
    const blob = await jpegOf(source);
    const at = Math.round(timestamp ?? 0);
    this.pictures.push({ keyframe, timestamp: at, name: name ?? `${this.pictures.length + 1}`, blob });
    if (!this.#directory || this.unkept) return;
    try {
      await write(this.#directory, `${String(this.#next++).padStart(5, "0")}-${at}.jpg`, blob);
    } catch (error) {
      this.unkept = error;
    }
  }

  /** Numbers that the mapper gave anew. */
  renumber(keyframes) {
    this.pictures = this.pictures.flatMap((picture, i) => (keyframes[i] === undefined ? [] : [{ ...picture, keyframe: keyframes[i] }]));
  }

  picture(keyframe) {
    return this.pictures.find((picture) => picture.keyframe === keyframe);
  }

  get bytes() {
    return this.pictures.reduce((sum, { blob }) => sum + blob.size, 0);
  }

  /** Forgets what was kept; the pictures in memory go with the object. */
  async discard() {
    this.#directory = undefined;
    await removeFolder(where).catch(() => undefined);
  }
}

async function jpegOf(source) {
  const [width, height] = [source.videoWidth ?? source.width, source.videoHeight ?? source.height];
  const scale = Math.min(1, maxSide / Math.max(width, height));
  const canvas = new OffscreenCanvas(Math.max(1, Math.round(scale * width)), Math.max(1, Math.round(scale * height)));
  canvas.getContext("2d").drawImage(source, 0, 0, canvas.width, canvas.height);
  return canvas.convertToBlob({ type: "image/jpeg", quality });
}
