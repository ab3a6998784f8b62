/**
 * Focal length from a JPEG's EXIF block.
 *
 * Source: the EXIF 2.3 standard, tags 0xA405 (FocalLengthIn35mmFilm) and 0x8769 (pointer to the EXIF directory).
 * The 35 mm frame has a diagonal of 43.27 mm, so the focal length in pixels is f35 / 43.27 of the picture's diagonal.
 */

/** EXIF stands in the first segments; more than this is never needed. */
export const exifBytes = 128 * 1024;
const frameDiagonalMm = 43.2666;

/** 35 mm equivalent focal length in millimetres, or `null` when the bytes do not say. */
export function focalLength35mm(bytes: Uint8Array): number | null {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (view.byteLength < 4 || view.getUint16(0) !== 0xffd8) return null;
  let at = 2;
  while (at + 4 <= view.byteLength) {
    if (view.getUint8(at) !== 0xff) return null;
    const marker = view.getUint8(at + 1);
    const length = view.getUint16(at + 2);
    if (marker === 0xda || length < 2) return null;
    const isExif =
      marker === 0xe1 && length >= 16 && at + 10 <= view.byteLength && view.getUint32(at + 4) === 0x45786966 && view.getUint16(at + 8) === 0;
    if (isExif) {
      const end = Math.min(at + 2 + length, view.byteLength);
      return fromTiff(new DataView(bytes.buffer, bytes.byteOffset + at + 10, end - at - 10));
    }
    at += 2 + length;
  }
  return null;
}

function fromTiff(tiff: DataView): number | null {
  if (tiff.byteLength < 8) return null;
  const order = tiff.getUint16(0);
  if (order !== 0x4949 && order !== 0x4d4d) return null;
  const little = order === 0x4949;
  const exif = entry(tiff, tiff.getUint32(4, little), 0x8769, little);
  if (exif === null) return null;
  const focal = entry(tiff, exif, 0xa405, little);
  return focal !== null && focal > 0 && focal < 2000 ? focal : null;
}

/** Value of a tag of type SHORT or LONG in the directory at `at`. */
function entry(tiff: DataView, at: number, tag: number, little: boolean): number | null {
  if (at + 2 > tiff.byteLength) return null;
  const count = tiff.getUint16(at, little);
  for (let i = 0; i < count; i++) {
    const e = at + 2 + 12 * i;
    if (e + 12 > tiff.byteLength) return null;
    if (tiff.getUint16(e, little) !== tag) continue;
    const type = tiff.getUint16(e + 2, little);
    if (type === 3) return tiff.getUint16(e + 8, little);
    if (type === 4) return tiff.getUint32(e + 8, little);
    return null;
  }
  return null;
}

/** Focal length in pixels of a picture of the given size. */
export function focalPxFrom35mm(focal35mm: number, width: number, height: number): number {
  return (focal35mm / frameDiagonalMm) * Math.hypot(width, height);
}
