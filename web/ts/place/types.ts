/** What pages see of places of many rooms. */
import type { CreateOptions, LiveOptions, LocateOptions, LocateResult, Placement } from "../types.js";

/** A file of a place, and what it has to be. */
export interface PlaceFile {
  /** Relative to the manifest, or absolute. */
  url: string;
  bytes: number;
  /** Of its bytes, in lower-case hexadecimal. */
  sha256: string;
}

/** A room as `NAME.place.json` has it. */
export interface PlaceRoom {
  id: string;
  /** What people call it. */
  name?: string;
  scene: PlaceFile;
  /** From the room to the place: unit quaternion w, x, y, z, shift and scale. */
  place_from_room?: { qwxyz: readonly number[]; t: readonly number[]; scale?: number };
  floor?: number;
  /** Rooms that one can walk to. */
  neighbours?: readonly string[];
  /** Corners of its floor plan in the room's world, counter-clockwise seen from above. */
  outline?: readonly (readonly number[])[];
}

/** `NAME.place.json`, as `landline place` writes it. */
export interface PlaceManifest {
  landline: "place";
  format: number;
  name?: string;
  extractor: string;
  extractor_sha256: string;
  working_max_side: number;
  index: PlaceFile;
  rooms: readonly PlaceRoom[];
}

/** What every answer of a place has besides. */
export interface InPlace {
  /** The room that the camera is in; absent where that is not known. */
  room?: PlaceRoom;
  /** Ids of two rooms that look alike from there: which of them it is stays open, and the frame is not located. */
  rivals?: readonly [string, string];
  /** Ids of rooms that it may be, but whose scenes could not be had; `refused` told why. */
  missing?: readonly string[];
  /** Where the camera is in the place; present where the room's transform is known. */
  placementInPlace?: Placement;
}

/** What `Place.locate` answers: `placement` is in the room. */
export type PlaceResult = LocateResult & InPlace;

/** Options of `Place.create`. Places run on the CPU. */
export interface PlaceOptions extends LiveOptions, Pick<CreateOptions, "extractor" | "build" | "onProgress" | "signal" | "wasm" | "worker" | "workerUrl" | "cache" | "stallTimeoutMs" | "fetch"> {
  /** A `.place.json` file. */
  place: string | URL;
  /** Bytes that the engine may hold of scenes; 128 MiB by default. The rooms that were not needed for longest go. */
  maxBytes?: number;
  /** Load the rooms beside one that is entered; yes by default. */
  prefetch?: boolean;
}

/** Options of one `locate` call. */
export type PlaceLocateOptions = Omit<LocateOptions, "prior" | "explain">;

/** What the engine of a place holds, in bytes. */
export interface PlaceMemory {
  wasmBytes: number;
  /** Of these, scenes. */
  sceneBytes: number;
}
