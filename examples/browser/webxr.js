// A scene in a WebXR session: located once in a while, tracked by the device. `picture(frame)` gives the camera's picture of an
// XRFrame (raw camera access) with its intrinsics; `group` is a three.js group that holds what belongs to the scene.
import { alignSession } from "landline/webxr";

export function join(session, space, relocalizer, group, picture, metresPerUnit = 1) {
  let alignment;
  let asking = false;
  group.matrixAutoUpdate = false;
  session.requestAnimationFrame(function step(_, frame) {
    session.requestAnimationFrame(step);
    const seen = asking ? undefined : picture(frame);
    const viewer = frame.getViewerPose(space);
    if (!seen || !viewer) return;
    asking = true;
    // The frame itself is gone when the answer comes: its viewer is kept.
    const then = { getViewerPose: () => viewer };
    relocalizer
      .locate(seen.source, { intrinsics: seen.intrinsics })
      .then((result) => {
        alignment = alignSession(then, space, result, { before: alignment, metresPerUnit });
        if (alignment) group.matrix.fromArray(alignment.sessionFromScene);
      })
      .finally(() => (asking = false));
  });
}
