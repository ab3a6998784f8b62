/** landline: finds the camera of a picture in a taught place, on the device. */
export { Relocalizer, packagedExtractorUrl, type StateEvent } from "./relocalizer.js";
export { packagedWasmUrl } from "./init.js";
export { LandlineError, type LandlineErrorCode } from "./errors.js";
export { camera, follow, intrinsicsFromTrack, type Camera, type CameraOptions, type FollowOptions, type Following } from "./camera.js";
export { checkSupport } from "./support.js";
export { clearCache, isCached } from "./assets.js";
export { invertRigid } from "./placement.js";
export { focalLength35mm, focalPxFrom35mm } from "./exif.js";
export type * from "./types.js";
