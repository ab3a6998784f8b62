/** Brings the pixels of a frame into the engine's memory. */
import { LandlineError } from "./errors.js";
import { sizeOf } from "./frames.js";
import type { WireFrame } from "./protocol.js";

const formatCode = { luma8: 0, rgba8: 1, rgb8: 2 } as const;

type Canvas = OffscreenCanvas | HTMLCanvasElement;
type Context = OffscreenCanvasRenderingContext2D | CanvasRenderingContext2D;

/** Has room for a frame in its memory. */
interface FrameRoom {
  frameBuffer(length: number): number;
}

export class PixelReader {
  #context: Context | undefined;

  /** Writes a frame into the room that the engine makes, and says how it lies there. */
  write(frame: WireFrame, raw: FrameRoom, memory: WebAssembly.Memory): { width: number; height: number; stride: number; format: number } {
    const { width, height } = sizeOf(frame);
    const { data, stride, format } = this.#pixels(frame, width, height);
    // The address is taken after the engine has made room: growing memory moves nothing, but detaches older views.
    const at = raw.frameBuffer(data.length);
    new Uint8Array(memory.buffer, at, data.length).set(data);
    return { width, height, stride, format: formatCode[format] };
  }

  #pixels(frame: WireFrame, width: number, height: number): { data: Uint8Array | Uint8ClampedArray; stride: number; format: keyof typeof formatCode } {
    if ("data" in frame) return { data: frame.data, stride: frame.stride ?? 0, format: frame.format };
    const context = this.#canvas(width, height);
    // Where a picture is transparent the one before would show through.
    context.globalCompositeOperation = "copy";
    context.drawImage(frame as CanvasImageSource, 0, 0, width, height);
    return { data: context.getImageData(0, 0, width, height).data, stride: 4 * width, format: "rgba8" };
  }

  #canvas(width: number, height: number): Context {
    let context = this.#context;
    if (!context) {
      const canvas: Canvas = typeof OffscreenCanvas === "function" ? new OffscreenCanvas(width, height) : document.createElement("canvas");
      context = (canvas.getContext("2d", { willReadFrequently: true, alpha: false }) as Context | null) ?? undefined;
      if (!context) throw new LandlineError("unsupported", "this browser gives no 2D canvas to read pixels with");
      this.#context = context;
    }
    if (context.canvas.width !== width) context.canvas.width = width;
    if (context.canvas.height !== height) context.canvas.height = height;
    return context;
  }
}
