/** Filming: the picture, what to do better, how much has been seen, and the way out. */
import { camera } from "landline";
import { feed } from "./feed.js";
import { button, el, heading } from "./elements.js";
import { framesOfCamera, framesOfPictures, framesOfVideo } from "./frames.js";
import { loadingWords } from "./loading_words.js";
import { adviceOf, leftOutWords, plural } from "./words.js";

const circumference = 2 * Math.PI * 26;

/** A ring that fills. */
function ring() {
  const make = (attributes) => {
    const circle = document.createElementNS("http://www.w3.org/2000/svg", "circle");
    for (const [name, value] of Object.entries({ cx: 32, cy: 32, r: 26, fill: "none", "stroke-width": 7, ...attributes })) circle.setAttribute(name, value);
    return circle;
  };
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 64 64");
  svg.setAttribute("class", "map-ring");
  svg.setAttribute("aria-hidden", "true");
  const share = make({ class: "map-ring-share", transform: "rotate(-90 32 32)", "stroke-linecap": "round" });
  svg.append(make({ class: "map-ring-ground" }), share);
  const set = (value) => {
    // A round end shows as a dot even where there is no length.
    share.setAttribute("visibility", value > 0 ? "visible" : "hidden");
    share.setAttribute("stroke-dasharray", `${Math.min(1, value) * circumference} ${circumference}`);
  };
  return { svg, set };
}

export async function filmStep(flow, source, files) {
  const stop = new AbortController();
  const isCamera = source === "camera";
  const video = source === "pictures" ? undefined : el("video", { muted: true, playsInline: true, "aria-label": isCamera ? "What the camera sees" : "The video" });
  const canvas = source === "pictures" ? el("canvas", { role: "img", "aria-label": "The picture that is looked at" }) : undefined;
  const advice = el("p", { class: "map-advice", "data-kind": "wait" }, "Loading the mapper…");
  const counter = el("p", { class: "map-count", id: "map-count" });
  const progress = isCamera ? undefined : el("progress", { max: 1, value: 0, "aria-label": "How much has been looked at" });
  const keeps = el("p", { class: "fine", id: "map-keeps", role: "status" });
  const coverage = ring();
  const finish = button(isCamera ? "Stop, make the map" : "Stop here, make the map", () => end(), { kind: "button button-main", id: "map-stop", disabled: true });
  const leftOut = [];
  let opened;
  let mapper;
  let left = false;
  let ends = "";
  flow.show(
    "film",
    [
      heading(isCamera ? "Walk round slowly" : source === "video" ? "Looking through the video" : "Looking at the pictures"),
      el("div", { class: "map-stage" }, video ?? canvas, advice),
      el("div", { class: "map-bar" }, coverage.svg, el("div", { class: "map-seen" }, counter, progress, keeps), finish),
    ].filter(Boolean),
    () => {
      left = true;
      stop.abort();
      opened?.stop();
      video?.remove();
      void wake.then((lock) => lock?.release());
    },
  );
  // A phone that sleeps films nothing; where the browser cannot keep it awake the user has to.
  const wake = navigator.wakeLock?.request("screen").catch(() => undefined) ?? Promise.resolve();

  const count = () => {
    const { length } = flow.film.pictures;
    counter.textContent = `${plural(length, "picture")} kept`;
    // The ring is full when a room of usual size would be known; filming may go on.
    coverage.set(length / (mapper?.coverage.enough ?? Infinity));
    finish.disabled = length === 0 || stop.signal.aborted;
    keeps.textContent = flow.film.unkept ? `These pictures are lost when the page is closed: ${flow.film.unkept.message}.` : "";
  };
  const say = ({ text, kind }) => {
    if (advice.textContent !== text) advice.textContent = text;
    advice.dataset.kind = kind;
    flow.announcer.say(text);
  };
  /** The last frame is still being looked at; that this is the end shows at once. */
  const end = () => {
    finish.disabled = true;
    finish.textContent = "One moment…";
    video?.pause();
    stop.abort();
  };
  const onHidden = () => document.hidden && isCamera && say({ text: "Paused while the page is hidden", kind: "warn" });
  document.addEventListener("visibilitychange", onHidden, { signal: stop.signal });

  try {
    count();
    // Both take time and do not need each other; the camera's question comes from the user's own tap.
    const asking = isCamera ? camera() : undefined;
    asking?.catch(() => undefined);
    mapper = await feed(flow, (event) => say({ text: loadingWords(event), kind: "wait" }), stop.signal);
    if (left) return void asking?.then((late) => late.stop(), () => undefined);
    let frames;
    if (isCamera) {
      opened = await asking;
      if (left) return opened.stop();
      opened.stream.getVideoTracks()[0]?.addEventListener("ended", () => {
        ends = "camera";
        stop.abort();
      });
      video.srcObject = opened.stream;
      await video.play();
      frames = framesOfCamera(video, stop.signal);
    } else {
      frames = source === "video" ? framesOfVideo(video, files[0], stop.signal) : framesOfPictures(files, stop.signal);
    }
    say({ text: isCamera ? "Good. Keep walking" : "Looking for pictures that are worth keeping", kind: "good" });
    count();
    for await (const frame of frames) {
      const { source: image, drawable = image, timestamp, name, share, failed } = frame;
      if (progress) progress.value = share;
      if (failed) {
        leftOut.push([name, failed]);
        continue;
      }
      if (canvas) show(canvas, drawable);
      const verdict = await mapper.addFrame(image, { ...(timestamp === undefined ? {} : { timestamp }), ...(name ? { name } : {}) });
      if (left) return;
      if (verdict.kept) await flow.film.add(verdict.keyframe, timestamp, drawable, name);
      else if (name) leftOut.push([name, leftOutWords(verdict.reason)]);
      say(adviceOf(verdict, isCamera));
      count();
      if (verdict.reason === "full") break;
    }
  } catch (error) {
    if (!left) await flow.toFailure(error);
    return;
  }
  if (left) return;
  flow.film.leftOut = leftOut;
  if (ends === "camera") flow.toHeld({ title: "The camera was taken away", text: "Another program or the system took it.", hint: "Make the map of what is there, or film more." });
  else await flow.toBuild();
}

function show(canvas, drawable) {
  if (canvas.width !== drawable.width || canvas.height !== drawable.height) [canvas.width, canvas.height] = [drawable.width, drawable.height];
  canvas.getContext("2d").drawImage(drawable, 0, 0);
}
