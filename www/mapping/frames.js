/** Frames of a camera, a video file, pictures: one at a time, the next when the last was dealt with. */

/** Longer side of frames that go to the mapper, which works on smaller ones still. */
const maxSide = 1280;
/** Seconds between the frames of a video file, and the most frames of one. */
const step = 0.2;
const maxVideoFrames = 900;

const aborted = (signal) => new Promise((done) => signal.addEventListener("abort", done, { once: true }));

/** Draws a source into a canvas that is used again and again. */
function grab(canvas, source, width, height) {
  const scale = Math.min(1, maxSide / Math.max(width, height));
  const [w, h] = [Math.round(scale * width), Math.round(scale * height)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  canvas.getContext("2d", { willReadFrequently: true }).drawImage(source, 0, 0, w, h);
  return canvas;
}

/** The newest picture of a playing video, again and again until `stop`; a hidden page shows none and so rests. */
export async function* framesOfCamera(video, stop) {
  const canvas = new OffscreenCanvas(1, 1);
  const stopped = aborted(stop);
  const next = () => new Promise((done) => (video.requestVideoFrameCallback ? video.requestVideoFrameCallback(done) : setTimeout(done, 60)));
  while (!stop.aborted) {
    await Promise.race([next(), stopped]);
    if (stop.aborted) return;
    if (video.videoWidth === 0 || document.hidden) {
      await Promise.race([new Promise((done) => setTimeout(done, 100)), stopped]);
      continue;
    }
    const timestamp = performance.now();
    yield { source: grab(canvas, video, video.videoWidth, video.videoHeight), timestamp };
  }
}

function event(target, name, failure, stop) {
  return new Promise((done, fail) => {
    target.addEventListener(name, done, { once: true, signal: stop });
    target.addEventListener("error", () => fail(failure()), { once: true, signal: stop });
    stop.addEventListener("abort", done, { once: true });
  });
}

/** A video file, from its beginning to its end in even steps, however long each takes. `share` is how much of it is done. */
export async function* framesOfVideo(video, file, stop) {
  const failure = () =>
    file.size === 0
      ? Object.assign(new Error(`“${file.name}” is empty`), { code: "bad-input", hint: "Copy or download it again." })
      : Object.assign(new Error(`“${file.name}” cannot be played here`), { code: "bad-input", hint: "Use an MP4 (H.264) or WebM video." });
  const url = URL.createObjectURL(file);
  const canvas = new OffscreenCanvas(1, 1);
  try {
    const ready = event(video, "loadeddata", failure, stop);
    video.preload = "auto";
    video.src = url;
    await ready;
    if (!stop.aborted && !Number.isFinite(video.duration)) {
      // Recordings of browsers do not say how long they are until one has been at their end.
      const known = event(video, "durationchange", failure, stop);
      video.currentTime = 1e9;
      await known;
    }
    const { duration } = video;
    const count = Math.max(1, Math.min(maxVideoFrames, Math.floor(duration / step)));
    for (let i = 0; i < count && !stop.aborted; i++) {
      const at = (duration * i) / count;
      const there = event(video, "seeked", failure, stop);
      video.currentTime = at;
      await there;
      if (stop.aborted) return;
      yield { source: grab(canvas, video, video.videoWidth, video.videoHeight), timestamp: 1000 * at, share: (i + 1) / count };
    }
  } finally {
    video.removeAttribute("src");
    video.load();
    URL.revokeObjectURL(url);
  }
}

/** Pictures by name. The engine gets the file itself, for what it says of its lens; `drawable` is for looking at. */
export async function* framesOfPictures(files, stop) {
  const sorted = [...files].sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));
  for (const [i, file] of sorted.entries()) {
    if (stop.aborted) return;
    const share = (i + 1) / sorted.length;
    let drawable;
    try {
      drawable = await createImageBitmap(file);
    } catch {
      yield { name: file.name, share, failed: file.size === 0 ? "empty file" : "cannot be decoded: use JPEG, PNG or WebP" };
      continue;
    }
    yield { source: file, drawable, name: file.name, share };
    drawable.close();
  }
}
