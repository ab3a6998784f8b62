/** landline: finds the camera of a picture in a taught place, on the device. */
export { Relocalizer, packagedExtractorUrl, type RelocalizerEvents, type StateEvent } from "./relocalizer.js";
export { packagedWasmUrl } from "./builds.js";
export { LandlineError, type LandlineErrorCode } from "./errors.js";
export { camera, cameras, intrinsicsFromTrack, type Camera, type CameraDevice, type CameraOptions, type Facing } from "./camera.js";
export { follow, type FollowedAnswer, type FollowedFrame, type FollowEvents, type FollowOptions, type FollowResult, type Following, type Locator } from "./follow.js";
export { Follower, type AnswerUse, type Correction, type FollowLimit, type FollowState, type FollowerOptions, type FollowerResult, type LostFrame, type RgbaFrame, type TrackLoss, type TrackedFrame, type Turn } from "./follower.js";
export { motionSensors, type MotionSensors } from "./sensors.js";
export { drawInView, fromView, intrinsicsInView, project, projectionMatrix, toView, viewMap, type Fit, type View, type ViewMap } from "./view.js";
export { checkSupport } from "./support.js";
export { clearCache, isCached } from "./assets.js";
export { invertRigid, placementFrom } from "./placement.js";
export { focalLength35mm, focalPxFrom35mm } from "./exif.js";
export type * from "./types.js";
