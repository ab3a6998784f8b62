/** Turns every kind of picture into something that can be handed to the engine's thread. */
import { shown } from "./arguments.js";
import { LandlineError } from "./errors.js";
import { exifBytes, focalLength35mm, focalPxFrom35mm } from "./exif.js";
import type { WireFrame } from "./protocol.js";
import type { FrameSource, Intrinsics, RawFrame } from "./types.js";

/** Larger pictures are refused: they would need gigabytes on their way through a canvas. */
const maxPixels = 64 * 1024 * 1024;

export interface PreparedFrame {
  frame: WireFrame;
  transfer: Transferable[];
  /** Present where it came as a file, so alone. */
  isFile?: true;
  /** From the picture's own EXIF block. */
  exif?: Intrinsics;
}

function is<T>(value: unknown, name: string): value is T {
  const type = (globalThis as Record<string, unknown>)[name];
  return typeof type === "function" && value instanceof (type as new () => object);
}

const bytesPerPixel = { luma8: 1, rgb8: 3, rgba8: 4 } as const;

function checkSize(width: number, height: number): void {
  if (!Number.isInteger(width) || !Number.isInteger(height) || width < 1 || height < 1) {
    throw new LandlineError("bad-input", `the frame is ${width} x ${height} pixels`, "Wait until the picture or video has loaded (a video has no size before its metadata are there).");
  }
  if (width * height > maxPixels) {
    throw new LandlineError("bad-input", `the frame is ${width} x ${height} pixels, more than ${maxPixels / 1024 / 1024} million`, "Make the picture smaller first; 640 pixels on the long side are enough.");
  }
}

function rawFrame(source: RawFrame | ImageData): RawFrame {
  const { data, width, height } = source;
  checkSize(width, height);
  const format = "format" in source ? source.format : "rgba8";
  const pixelBytes = bytesPerPixel[format as keyof typeof bytesPerPixel];
  if (pixelBytes === undefined) {
    throw new LandlineError("bad-input", `frame format ${JSON.stringify(format)} is unknown`, "Use luma8, rgb8 or rgba8.");
  }
  if (!ArrayBuffer.isView(data) || (data as Uint8Array).BYTES_PER_ELEMENT !== 1) {
    throw new LandlineError("bad-input", "the frame's data must be a Uint8Array or Uint8ClampedArray");
  }
  const tight = width * pixelBytes;
  const stride = ("stride" in source ? source.stride : undefined) ?? tight;
  if (!Number.isInteger(stride) || stride < tight) {
    throw new LandlineError("bad-input", `the frame's stride is ${stride} bytes; a row of ${width} pixels in ${format} needs ${tight}`);
  }
  const needed = stride * (height - 1) + tight;
  if (data.length < needed) {
    throw new LandlineError("bad-input", `the frame has ${data.length} bytes; ${width} x ${height} pixels in ${format} with stride ${stride} need ${needed}`);
  }
  return { data: data as Uint8Array, width, height, stride, format };
}

async function bitmapOf(source: ImageBitmapSource): Promise<ImageBitmap> {
  if (typeof createImageBitmap !== "function") {
    throw new LandlineError("unsupported", "pictures cannot be decoded here", "Under Node, decode with a package such as sharp and pass { data, width, height, format }.");
  }
  try {
    return await createImageBitmap(source, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch (error) {
    const message = String((error as Error).message ?? error);
    throw new LandlineError("bad-input", `the picture cannot be decoded: ${message}`, "Use a JPEG, PNG or WebP picture.", error);
  }
}

/** Prepares a frame. With `toThread` false the pixels are only looked at, never copied. */
export async function prepareFrame(source: FrameSource, transfer: boolean, toThread: boolean): Promise<PreparedFrame> {
  if (source === null || typeof source !== "object") {
    throw new LandlineError("bad-input", `the frame is ${shown(source)}`, "Pass an image, a video, a canvas, ImageData, or { data, width, height, format }.");
  }
  if (is<Blob>(source, "Blob")) {
    const bitmap = await bitmapOf(source);
    checkSize(bitmap.width, bitmap.height);
    const prepared: PreparedFrame = { frame: bitmap, transfer: [bitmap], isFile: true };
    const focal = focalLength35mm(new Uint8Array(await source.slice(0, exifBytes).arrayBuffer()));
    if (focal !== null) {
      const { width, height } = bitmap;
      const f = focalPxFrom35mm(focal, width, height);
      prepared.exif = { fx: f, fy: f, cx: width / 2, cy: height / 2, width, height };
    }
    return prepared;
  }
  if (is<ImageBitmap>(source, "ImageBitmap")) {
    checkSize(source.width, source.height);
    const frame = transfer ? source : await createImageBitmap(source);
    return { frame, transfer: [frame] };
  }
  if (is<VideoFrame>(source, "VideoFrame")) {
    checkSize(source.displayWidth, source.displayHeight);
    const frame = transfer ? source : source.clone();
    return { frame, transfer: [frame] };
  }
  if (is<HTMLVideoElement>(source, "HTMLVideoElement")) {
    checkSize(source.videoWidth, source.videoHeight);
    const frame = await bitmapOf(source);
    return { frame, transfer: [frame] };
  }
  if (is<HTMLImageElement>(source, "HTMLImageElement")) {
    checkSize(source.naturalWidth, source.naturalHeight);
    const frame = await bitmapOf(source);
    return { frame, transfer: [frame] };
  }
  if (is<HTMLCanvasElement>(source, "HTMLCanvasElement") || is<OffscreenCanvas>(source, "OffscreenCanvas")) {
    checkSize(source.width, source.height);
    const frame = await bitmapOf(source);
    return { frame, transfer: [frame] };
  }
  if ("data" in source && "width" in source && "height" in source) {
    const frame = rawFrame(source as RawFrame | ImageData);
    if (!toThread) return { frame, transfer: [] };
    if (transfer && frame.data.buffer instanceof ArrayBuffer) return { frame, transfer: [frame.data.buffer] };
    // Structured cloning copies the whole underlying buffer, so cut out what belongs to the frame first.
    frame.data = Uint8Array.from(frame.data);
    return { frame, transfer: [frame.data.buffer as ArrayBuffer] };
  }
  throw new LandlineError("bad-input", `the frame is ${shown(source)}`, "Pass an image, a video, a canvas, ImageData, or { data, width, height, format }.");
}

/** Checks intrinsics against the frame and scales them to it where only the size differs. */
export function intrinsicsForFrame(given: Intrinsics, width: number, height: number): Intrinsics {
  for (const key of ["fx", "fy", "cx", "cy"] as const) {
    if (typeof given[key] !== "number" || !Number.isFinite(given[key])) {
      throw new LandlineError("bad-input", `intrinsics.${key} is ${String(given[key])}`);
    }
  }
  if (given.fx <= 0 || given.fy <= 0) {
    throw new LandlineError("bad-input", `the focal length (${given.fx}, ${given.fy}) must be positive`);
  }
  const fromWidth = given.width ?? width;
  const fromHeight = given.height ?? height;
  if (!(fromWidth > 0) || !(fromHeight > 0)) {
    throw new LandlineError("bad-input", `intrinsics are for a picture of ${fromWidth} x ${fromHeight} pixels`);
  }
  const sx = width / fromWidth;
  const sy = height / fromHeight;
  // Half a percent allows for rounding to whole pixels; more means a crop or a rotation, which scaling cannot undo.
  if (Math.abs(sx / sy - 1) > 0.005) {
    throw new LandlineError("bad-input", `intrinsics are for ${fromWidth} x ${fromHeight}, the frame is ${width} x ${height}: the shapes differ`, "Pass the intrinsics of the frame itself; a turned phone swaps width and height.");
  }
  return { fx: given.fx * sx, fy: given.fy * sy, cx: given.cx * sx, cy: given.cy * sy, width, height };
}

/** Size of a frame that is on its way to the engine. */
export function sizeOf(frame: WireFrame): { width: number; height: number } {
  return "displayWidth" in frame ? { width: frame.displayWidth, height: frame.displayHeight } : { width: frame.width, height: frame.height };
}
