/**
 * A room to try the package with: optional entry `landline/sample`. Its files lie in the package and are loaded where they are
 * asked for; a page that does not import this entry never loads them.
 *
 * The room is a rendered one, and its lengths are metres.
 */
import type { Intrinsics } from "./types.js";

/** The scene file. */
export const scene: URL = new URL("./sample/sample.landline", import.meta.url);

/** A picture of the room that was not among those that taught the scene. */
export const picture: URL = new URL("./sample/picture.jpg", import.meta.url);

/** The picture's camera. */
export const intrinsics: Intrinsics = { width: 640, height: 480, fx: 524.8, fy: 524.8, cx: 320, cy: 240 };

/** Where the picture was taken, in the scene's coordinates. */
export const position: { x: number; y: number; z: number } = { x: 4.3485, y: 2.4862, z: 1.7009 };
