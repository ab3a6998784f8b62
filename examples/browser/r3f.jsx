// React Three Fiber: <Canvas gl={{ alpha: true }}><Follow scene="/my-room.landline" /><mesh .../></Canvas> over the video.
import { useFrame } from "@react-three/fiber";
import { useEffect, useRef } from "react";
import { Relocalizer, camera, follow } from "landline";
import { applyPlacement, applyView } from "landline/three";

export function Follow({ scene, onVideo }) {
  const seen = useRef(null);
  useEffect(() => {
    const parts = [];
    const start = async () => {
      const relocalizer = await Relocalizer.create({ scene });
      parts.push(() => relocalizer.dispose());
      const opened = await camera();
      onVideo?.(opened.video);
      const following = follow(relocalizer, opened.video, { camera: opened.key, onResult: (result) => (seen.current = result) });
      parts.push(() => following.stop(), () => opened.stop());
    };
    const started = start();
    return () => void started.finally(() => parts.reverse().forEach((end) => end()));
  }, [scene]);
  useFrame(({ camera: eye, size }) => {
    if (!seen.current?.located) return;
    applyView(eye, seen.current.intrinsics, size);
    applyPlacement(eye, seen.current.placement);
  });
}
