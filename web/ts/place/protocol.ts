/** Messages between the page and the worker of a place. */
import type { CreateRequest as OneScene, LocateRequest } from "../protocol.js";
import type { CallRequest } from "../rpc.js";
import type { Build, LiveOptions, LocateResult, Units } from "../types.js";
import type { PlaceMemory } from "./types.js";

export interface CreateRequest extends Omit<OneScene, "scene" | "device"> {
  manifest: string;
  index: Uint8Array;
  /** 0 for the usual. */
  maxBytes: number;
}

export interface Created {
  build: Build;
  buildReason: string;
}

/** What the engine says of rooms, by their ids. */
export interface RawRooms {
  room: string | null;
  rivals: [string, string] | null;
  hasEntered: boolean;
  wanted: string[];
  prefetch: string[];
  cameraFromPlace: number[] | null;
  units: Units;
}

export interface Answer {
  result: LocateResult;
  rooms: RawRooms;
}

export interface Calls {
  create: { request: CreateRequest; reply: Created };
  locate: { request: Omit<LocateRequest, "prior" | "explain">; reply: Answer };
  /** The last frame once more, with the scenes that have come since. */
  resume: { request: null; reply: Answer };
  putRoom: { request: { id: string; scene: Uint8Array }; reply: null };
  setOptions: { request: LiveOptions; reply: null };
  recallCamera: { request: { camera: string; focalPerWidth: number }; reply: null };
  reset: { request: null; reply: null };
  memory: { request: null; reply: PlaceMemory };
  dispose: { request: null; reply: null };
}

export type CallName = keyof Calls;

export type Request<N extends CallName = CallName> = CallRequest<Calls, N>;
