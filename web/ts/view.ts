/** From pixels of a frame to where they stand on the screen: cover, contain, mirrored, any canvas. */
import { shown } from "./arguments.js";
import { LandlineError } from "./errors.js";
import type { Intrinsics, Placement } from "./types.js";

/** How a frame fills its place; as CSS `object-fit`, centred. */
export type Fit = "cover" | "contain" | "fill";

/** Where a frame is shown. Sizes are in whatever unit positions are wanted in: CSS pixels, or those of the canvas. */
export interface View {
  width: number;
  height: number;
  /** `cover` by default. */
  fit?: Fit;
  /** Left and right change places, as for a camera that faces the user. */
  mirrored?: boolean;
}

/** `x * scaleX + offsetX`, likewise y. */
export interface ViewMap {
  scaleX: number;
  scaleY: number;
  offsetX: number;
  offsetY: number;
}

interface Size {
  width: number;
  height: number;
}

/** The map from pixels of a frame to positions in a view. */
export function viewMap(frame: Size, view: View): ViewMap {
  const across = view.width / frame.width;
  const down = view.height / frame.height;
  const fit = view.fit ?? "cover";
  const scaleX = fit === "fill" ? across : fit === "cover" ? Math.max(across, down) : Math.min(across, down);
  const scaleY = fit === "fill" ? down : scaleX;
  const offsetX = (view.width - scaleX * frame.width) / 2;
  const offsetY = (view.height - scaleY * frame.height) / 2;
  return view.mirrored ? { scaleX: -scaleX, scaleY, offsetX: view.width - offsetX, offsetY } : { scaleX, scaleY, offsetX, offsetY };
}

/** Where a pixel of the frame stands in the view. */
export function toView(map: ViewMap, [x, y]: readonly [number, number]): [number, number] {
  return [map.scaleX * x + map.offsetX, map.scaleY * y + map.offsetY];
}

/** Which pixel of the frame stands at a position of the view: for taps. */
export function fromView(map: ViewMap, [x, y]: readonly [number, number]): [number, number] {
  return [(x - map.offsetX) / map.scaleX, (y - map.offsetY) / map.scaleY];
}

/** The pixel of the frame at which a world point is seen; `undefined` behind the camera. */
export function project(placement: Placement, intrinsics: Intrinsics, world: ArrayLike<number>): [number, number] | undefined {
  const m = (placement as Placement | null | undefined)?.cameraFromWorld;
  if (!m) throw new LandlineError("bad-input", `the placement is ${shown(placement)}`, "Only a result that is `located` has one.");
  const row = (r: number): number => (m[4 * r] as number) * (world[0] as number) + (m[4 * r + 1] as number) * (world[1] as number) + (m[4 * r + 2] as number) * (world[2] as number) + (m[4 * r + 3] as number);
  const depth = row(2);
  if (!(depth > 0)) return undefined;
  return [(intrinsics.fx * row(0)) / depth + intrinsics.cx, (intrinsics.fy * row(1)) / depth + intrinsics.cy];
}

/** Draws a frame into a view; what a canvas shows then is the picture that the positions belong to. */
export function drawInView(context: CanvasRenderingContext2D | OffscreenCanvasRenderingContext2D, frame: Size & { source: CanvasImageSource }, view: View): ViewMap {
  const map = viewMap(frame, view);
  context.save();
  context.setTransform(map.scaleX, 0, 0, map.scaleY, map.offsetX, map.offsetY);
  context.drawImage(frame.source, 0, 0, frame.width, frame.height);
  context.restore();
  return map;
}

/** Intrinsics of the view as a picture of its own; for one that is not mirrored. */
export function intrinsicsInView(intrinsics: Intrinsics, view: View): Intrinsics {
  const { scaleX, scaleY, offsetX, offsetY } = viewMap(intrinsics, { ...view, mirrored: false });
  return {
    fx: intrinsics.fx * scaleX,
    fy: intrinsics.fy * scaleY,
    cx: intrinsics.cx * scaleX + offsetX,
    cy: intrinsics.cy * scaleY + offsetY,
    width: view.width,
    height: view.height,
  };
}

/** Column-major projection for WebGL whose picture covers exactly the frame, off-centre principal point included. */
export function projectionMatrix(intrinsics: Intrinsics, near: number, far: number): Float64Array {
  const { fx, fy, cx, cy, width: w, height: h } = intrinsics;
  const m = new Float64Array(16);
  m[0] = (2 * fx) / w;
  m[5] = (2 * fy) / h;
  m[8] = 1 - (2 * cx) / w;
  m[9] = (2 * cy) / h - 1;
  m[10] = -(far + near) / (far - near);
  m[11] = -1;
  m[14] = (-2 * far * near) / (far - near);
  return m;
}
