/**
 * Arguments of the public calls, checked where they enter: names that nobody knows, types and ranges. What would become
 * `null` on its way to the engine, as NaN does in JSON, or end it, is refused here by the argument's name.
 */
import { LandlineError } from "./errors.js";
import type { CreateOptions, LiveOptions, LocateOptions, Placement } from "./types.js";

/** Tells what was expected, or nothing where the value is right. */
export type Check = (value: unknown) => string | undefined;

export const number =
  (low: number, high: number, expected: string): Check =>
  (value) =>
    typeof value === "number" && value >= low && value <= high ? undefined : expected;
export const whole =
  (low: number, high: number, expected: string): Check =>
  (value) =>
    Number.isInteger(value) && (value as number) >= low && (value as number) <= high ? undefined : expected;
export const kind =
  (name: "string" | "boolean" | "function"): Check =>
  (value) =>
    typeof value === name ? undefined : `a ${name}`;
export const oneOf =
  (...words: string[]): Check =>
  (value) =>
    words.includes(value as string) ? undefined : words.join(", ").replace(/, ([^,]*)$/, " or $1");
export const object: Check = (value) => (typeof value === "object" && value !== null ? undefined : "an object");
/** An object of these fields, each optional here: their own place checks what they hold. */
export const fields =
  (...names: string[]): Check =>
  (value) =>
    !object(value) && Object.keys(value as object).every((name) => names.includes(name)) ? undefined : `{ ${names.join(", ")} }`;
export const abortSignal: Check = (value) => (typeof (value as AbortSignal | null)?.addEventListener === "function" && "aborted" in (value as AbortSignal) ? undefined : "an AbortSignal");
/** Those of a result have two more. */
export const intrinsics = fields("fx", "fy", "cx", "cy", "width", "height", "source", "relativeSigma");
export const anything: Check = () => undefined; // its own place checks it
const part = oneOf("points", "lines", "segments");
export const included: Check = (value) => (Array.isArray(value) && value.every((name) => !part(name)) ? undefined : "a list of points, lines or segments");

const largest = Number.MAX_VALUE;

export const live: Record<keyof LiveOptions, Check> = {
  smoothing: oneOf("off", "steady", "responsive"),
  maxSide: whole(1, 2048, "a whole number of pixels from 1 to 2048"),
  timeBudgetMs: number(0, largest, "a finite number of milliseconds that is not negative"),
  seed: whole(0, Number.MAX_SAFE_INTEGER, "a whole number that is not negative"),
  maxPointErrorPx: number(Number.MIN_VALUE, largest, "a finite number of pixels above 0"),
  maxLineErrorPx: number(Number.MIN_VALUE, largest, "a finite number of pixels above 0"),
};

/** Of what every engine takes: where its files and its worker come from, and how they are loaded. */
export const loading = {
  extractor: anything,
  onProgress: kind("function"),
  signal: abortSignal,
  wasm: anything,
  worker: kind("boolean"),
  workerUrl: (value) => (typeof value === "string" || value instanceof URL ? undefined : "an address"),
  cache: oneOf("default", "none"),
  stallTimeoutMs: number(1, 2 ** 31 - 1, "milliseconds from 1 to 2147483647"),
  integrity: fields("scene", "extractor"),
  fetch: kind("function"),
} satisfies Partial<Record<keyof CreateOptions, Check>>;

export const someBuild = oneOf("auto", "plain", "relaxed");

const create: Record<keyof CreateOptions, Check> = {
  ...live,
  ...loading,
  scene: anything,
  device: oneOf("auto", "webgpu", "cpu"),
  build: someBuild,
};

export const locate: Record<keyof LocateOptions, Check> = {
  intrinsics,
  intrinsicsSource: oneOf("given", "track", "exif"),
  timestamp: number(-largest, largest, "a finite number of milliseconds"),
  include: included,
  camera: kind("string"),
  tracking: kind("boolean"),
  prior: object,
  gravity: fields("x", "y", "z", "sigmaRad"),
  explain: kind("boolean"),
  transfer: kind("boolean"),
  signal: abortSignal,
};

/** A value as an error may show it: short, and on one line; what is no plain object by its kind. */
export function shown(value: unknown): string {
  const made = (value as object | null | undefined)?.constructor?.name;
  if (typeof value === "object" && made && !["Object", "Array"].includes(made)) return `a ${made}${made === "Promise" ? " (an await is missing)" : ""}`;
  if (typeof value === "bigint") return `${value}n`;
  if (typeof value === "number" || typeof value === "undefined" || typeof value === "symbol") return String(value);
  let text: string | undefined;
  try {
    // A picture's pixels would be megabytes of digits.
    text = JSON.stringify(value, (_, part: unknown) => (ArrayBuffer.isView(part) ? part.constructor.name : part));
  } catch {
    text = undefined; // circles
  }
  text ??= typeof value;
  return text.length > 60 ? `${text.slice(0, 57)}...` : text;
}

/** @throws LandlineError `bad-input`: names the argument, its value, and what was expected. */
export function checkArgument(name: string, value: unknown, check: Check): void {
  const expected = check(value);
  if (expected !== undefined) throw new LandlineError("bad-input", `${name} is ${shown(value)}, expected ${expected}`);
}

export function checkOptions(call: string, options: unknown, table: Record<string, Check>): void {
  checkArgument(`the argument of ${call}()`, options, object);
  for (const [name, value] of Object.entries(options as object)) {
    if (!Object.hasOwn(table, name)) {
      throw new LandlineError("bad-input", `${call}() has no option ${shown(name)}`, `Its options are ${Object.keys(table).join(", ")}.`);
    }
    const check = table[name];
    if (value !== undefined && check) checkArgument(`option ${name}`, value, check);
  }
}

export const checkCreateOptions = (options: unknown): void => checkOptions("create", options, create);
export const checkLocateOptions = (options: unknown): void => checkOptions("locate", options, locate);
export const checkLiveOptions = (options: unknown): void => checkOptions("setOptions", options, live);

/** What `recallCamera` takes. */
export function checkRecall(camera: unknown, focalPerWidth: unknown): void {
  checkArgument("camera", camera, kind("string"));
  checkArgument("focalPerWidth", focalPerWidth, number(Number.MIN_VALUE, largest, "a finite number above 0"));
}

/** The numbers of a placement, or of its `cameraFromWorld`; none where there is none. */
export function cameraFromWorldOf(pose: Placement | ArrayLike<number> | undefined, name: string): ArrayLike<number> {
  if (!pose) return [];
  const m = "cameraFromWorld" in pose ? pose.cameraFromWorld : pose;
  if (m.length !== 16) throw new LandlineError("bad-input", `the ${name} has ${m.length} numbers`, "Pass a placement, or the 16 numbers of its cameraFromWorld.");
  return m;
}
