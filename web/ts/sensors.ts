/** The device's motion sensors: turns between frames, and the direction of gravity, in the axes of the rear camera. */
import { LandlineError } from "./errors.js";

/** Gravity as `locate` takes it. */
export interface CameraGravity {
  /** Unit vector downwards in camera axes: x right, y down, z forward. */
  x: number;
  y: number;
  z: number;
  /** Standard deviation in radians. */
  sigmaRad: number;
}

export interface MotionSensors {
  /** Turn since the last call, row by row (camera now from camera before); `undefined` while no sensor speaks. */
  turnSinceLastFrame(now: number): Float64Array | undefined;
  /** `undefined` while no sensor speaks. */
  gravity(): CameraGravity | undefined;
  stop(): void;
}

type Permitted = { requestPermission?: () => Promise<"granted" | "denied"> };

/** Readings older than this say nothing any more, in milliseconds. */
const staleMs = 250;
const radians = Math.PI / 180;

/**
 * Listens to the motion sensors. Call it from a tap: iOS asks the user then, and only then. Without sensors nothing is wrong: all
 * readings are `undefined`, and tracking goes by the picture alone.
 */
export async function motionSensors(): Promise<MotionSensors> {
  for (const name of ["DeviceMotionEvent", "DeviceOrientationEvent"] as const) {
    const asks = (globalThis as unknown as Record<string, Permitted | undefined>)[name];
    if (typeof asks?.requestPermission !== "function") continue;
    let answer: "granted" | "denied";
    try {
      answer = await asks.requestPermission();
    } catch (error) {
      throw new LandlineError("unsupported", `the motion sensors cannot be asked for: ${String((error as Error).message ?? error)}`, "Call motionSensors() from a click or a tap.", error);
    }
    if (answer !== "granted") throw new LandlineError("unsupported", "the motion sensors are not allowed on this page", "Allow them in the settings of the browser, or go on without.");
  }
  return new Sensors();
}

/** Angle of the screen against the device's natural one, in degrees. */
function screenAngle(): number {
  return globalThis.screen?.orientation?.angle ?? 0;
}

/** A vector of the device (x right, y up, z out of the screen, held naturally) in the axes of the rear camera. */
export function cameraFromDevice([x, y, z]: readonly [number, number, number], angleDeg: number): [number, number, number] {
  const [c, s] = [Math.cos(angleDeg * radians), Math.sin(angleDeg * radians)];
  // Onto the axes of the screen, then y downwards and z away from the user.
  return [c * x - s * y, -(s * x + c * y), -z];
}

/** Downwards in device axes, from the angles of a DeviceOrientationEvent in degrees. */
export function gravityFromAngles(beta: number, gamma: number): [number, number, number] {
  const [cb, sb, cg, sg] = [Math.cos(beta * radians), Math.sin(beta * radians), Math.cos(gamma * radians), Math.sin(gamma * radians)];
  return [cb * sg, -sb, -cb * cg];
}

/** Rotation matrix of a rotation vector, row by row (Rodrigues). */
export function rotationFromVector([x, y, z]: readonly [number, number, number]): Float64Array {
  const angle = Math.hypot(x, y, z);
  const [s, c] = angle < 1e-9 ? [1, 0.5] : [Math.sin(angle) / angle, (1 - Math.cos(angle)) / (angle * angle)];
  const cross = [0, -z, y, z, 0, -x, -y, x, 0];
  const square = [-(y * y + z * z), x * y, x * z, x * y, -(x * x + z * z), y * z, x * z, y * z, -(x * x + y * y)];
  return Float64Array.from(cross, (v, i) => (i % 4 === 0 ? 1 : 0) + s * v + c * (square[i] as number));
}

class Sensors implements MotionSensors {
  /** Turn of the camera since the last frame as a vector: enough for angles between two frames. */
  #turn: [number, number, number] = [0, 0, 0];
  #lastMotion = -Infinity;
  #angles: { beta: number; gamma: number; at: number } | undefined;

  constructor() {
    globalThis.addEventListener?.("devicemotion", this.#moved);
    globalThis.addEventListener?.("deviceorientation", this.#turned);
  }

  turnSinceLastFrame(now: number): Float64Array | undefined {
    const turn = this.#turn;
    this.#turn = [0, 0, 0];
    if (!(now - this.#lastMotion < staleMs)) return undefined;
    // The camera turns by so much; what it sees turns the other way.
    return rotationFromVector([-turn[0], -turn[1], -turn[2]]);
  }

  gravity(): CameraGravity | undefined {
    const angles = this.#angles;
    if (!angles || performance.now() - angles.at > staleMs) return undefined;
    const [x, y, z] = cameraFromDevice(gravityFromAngles(angles.beta, angles.gamma), screenAngle());
    return { x, y, z, sigmaRad: 2 * radians };
  }

  stop(): void {
    globalThis.removeEventListener?.("devicemotion", this.#moved);
    globalThis.removeEventListener?.("deviceorientation", this.#turned);
    this.#angles = undefined;
    this.#lastMotion = -Infinity;
  }

  #moved = (event: DeviceMotionEvent): void => {
    const rate = event.rotationRate;
    // beta turns about x, gamma about y, alpha about z.
    if (!rate || rate.beta === null || rate.gamma === null || rate.alpha === null) return;
    const seconds = Math.min(Math.max(event.interval > 1 ? event.interval / 1000 : event.interval, 0), 0.1);
    const device = [rate.beta, rate.gamma, rate.alpha].map((v) => v * radians * seconds) as [number, number, number];
    if (!device.every(Number.isFinite)) return;
    const step = cameraFromDevice(device, screenAngle());
    this.#turn = this.#turn.map((v, i) => v + (step[i] as number)) as [number, number, number];
    this.#lastMotion = performance.now();
  };

  #turned = ({ beta, gamma }: DeviceOrientationEvent): void => {
    if (beta !== null && gamma !== null && Number.isFinite(beta + gamma)) this.#angles = { beta, gamma, at: performance.now() };
  };
}
