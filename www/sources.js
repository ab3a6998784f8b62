/** Where pictures come from. A playlist is a list of `{ name, blob(), thumb?, truth?, focal?, intrinsics? }`. */
import { firstFetch } from "./first.js";
import { readPoses } from "./poses.js";

/** Depth images lie beside the pictures in some data sets, and are none. */
const isImage = (file) => !/\.depth\.\w+$/i.test(file.name) && (file.type.startsWith("image/") || /\.(png|jpe?g|webp|avif|bmp)$/i.test(file.name));
const isVideo = (file) => file.type.startsWith("video/") || /\.(mp4|webm|mov|mkv|m4v|y4m)$/i.test(file.name);
const isScene = (file) => /\.(landline|safetensors)$/i.test(file.name);

/** The pictures that come with the page, with their true poses. */
export async function samplePlaylist(base) {
  const response = await firstFetch(new URL("sample.json", base).href);
  if (!response.ok) throw Object.assign(new Error(`the list of sample pictures is not there (${response.status})`), { code: "asset-fetch", hint: "Use your camera or a picture instead." });
  const { camera, pictures } = await response.json();
  return pictures.map((picture) => {
    const url = new URL(picture.name, base).href;
    const download = async () => {
      const answer = await fetch(url);
      if (!answer.ok) throw Object.assign(new Error(`${picture.name} could not be loaded (${answer.status})`), { code: "asset-fetch", hint: "Check the connection, then choose “Sample room” again." });
      return answer.blob();
    };
    let early;
    return {
      name: picture.name,
      thumb: url,
      intrinsics: picture.camera ?? camera,
      truth: Float64Array.from(picture.cam_from_world.flat()),
      /** Begins the download before the picture's turn; a failure is told then, by a new one. */
      fetchEarly: () => {
        early = download();
        early.catch(() => (early = undefined));
      },
      blob: () => {
        const begun = early;
        early = undefined;
        return begun ?? download();
      },
    };
  });
}

/** Sorts dropped or chosen files into what they are. */
export async function sortFiles(files) {
  const byName = (a, b) => a.name.localeCompare(b.name, "en", { numeric: true });
  const images = files.filter(isImage).sort(byName);
  const { poses, source, notes } = await readPoses(images, files);
  const numTruth = poses.filter(Boolean).length;
  // Thumbnails of hundreds of large pictures would take more memory than the engine.
  const withThumbs = images.length <= 60;
  return {
    scene: files.find(isScene),
    video: files.find(isVideo),
    poseSource: numTruth > 0 ? source : "",
    numTruth,
    notes,
    pictures: images.map((file, i) => {
      const pose = poses[i];
      return {
        name: file.name,
        thumb: withThumbs ? URL.createObjectURL(file) : undefined,
        blob: async () => file,
        ...(pose ? { truth: pose.cameraFromWorld } : {}),
        ...(pose?.focal ? { focal: pose.focal } : {}),
        ...(pose?.intrinsics ? { intrinsics: pose.intrinsics } : {}),
      };
    }),
  };
}

/** Frees what `sortFiles` made. */
export function releasePlaylist(playlist) {
  for (const { thumb } of playlist) if (thumb?.startsWith("blob:")) URL.revokeObjectURL(thumb);
}
