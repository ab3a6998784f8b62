/**
 * QR codes (ISO/IEC 18004) of short texts: bytes, error correction level M, versions 1 to 15 (412 bytes).
 */

/** For each version: bytes of error correction in a block, and blocks. Table 9 of the standard, level M. */
const correction = [10, 16, 26, 18, 24, 16, 18, 22, 22, 26, 30, 22, 22, 24, 24];
const blocks = [1, 1, 1, 2, 2, 4, 4, 4, 5, 5, 5, 8, 9, 9, 10];

const sideOf = (version) => 4 * version + 17;

/** Rows and columns in which alignment patterns stand. */
function alignments(version) {
  if (version === 1) return [];
  const count = Math.floor(version / 7) + 2;
  const step = 2 * Math.ceil((version * 4 + 4) / (2 * count - 2));
  const last = sideOf(version) - 7;
  return [6, ...Array.from({ length: count - 1 }, (_, i) => last - (count - 2 - i) * step)];
}

/** Bytes that a version holds, correction and all. */
function capacity(version) {
  let modules = (16 * version + 128) * version + 64;
  if (version > 1) {
    const count = Math.floor(version / 7) + 2;
    modules -= (25 * count - 10) * count - 55;
  }
  if (version >= 7) modules -= 36;
  return modules >> 3;
}

const dataBytes = (version) => capacity(version) - correction[version - 1] * blocks[version - 1];

/** Product in the field of 256 elements with the polynomial 0x11D. */
function times(a, b) {
  let product = 0;
  for (let bit = 7; bit >= 0; bit--) product = (product << 1) ^ ((product >> 7) * 0x11d) ^ (((b >> bit) & 1) * a);
  return product;
}

/** Remainder of the data divided by the generator polynomial of a degree. */
function remainder(data, degree) {
  let generator = new Uint8Array(degree);
  generator[degree - 1] = 1;
  for (let i = 0, root = 1; i < degree; i++, root = times(root, 2)) {
    generator = generator.map((factor, k) => times(factor, root) ^ (generator[k + 1] ?? 0));
  }
  const rest = new Uint8Array(degree);
  for (const byte of data) {
    const factor = byte ^ rest[0];
    rest.copyWithin(0, 1);
    rest[degree - 1] = 0;
    generator.forEach((g, k) => (rest[k] ^= times(g, factor)));
  }
  return rest;
}

/** The text's bytes with their header and padding, and the correction, in the order in which they are drawn. */
function codewords(bytes, version) {
  const bits = [];
  const put = (value, length) => {
    for (let i = length - 1; i >= 0; i--) bits.push((value >> i) & 1);
  };
  put(4, 4); // bytes
  put(bytes.length, version < 10 ? 8 : 16);
  for (const byte of bytes) put(byte, 8);
  const room = 8 * dataBytes(version);
  put(0, Math.min(4, room - bits.length));
  put(0, -bits.length & 7);
  for (let pad = 0xec; bits.length < room; pad ^= 0xec ^ 0x11) put(pad, 8);
  const data = Uint8Array.from({ length: room / 8 }, (_, i) => bits.slice(8 * i, 8 * i + 8).reduce((byte, bit) => 2 * byte + bit, 0));
  const [count, degree] = [blocks[version - 1], correction[version - 1]];
  const short = Math.floor(data.length / count);
  const numShort = count - (data.length % count);
  const parts = [];
  for (let i = 0, at = 0; i < count; i++) {
    const length = short + (i < numShort ? 0 : 1);
    parts.push(data.subarray(at, (at += length)));
  }
  const rests = parts.map((part) => remainder(part, degree));
  const out = [];
  for (let i = 0; i <= short; i++) for (const part of parts) if (i < part.length) out.push(part[i]);
  for (let i = 0; i < degree; i++) for (const rest of rests) out.push(rest[i]);
  return out;
}

const masks = [
  (x, y) => (x + y) % 2 === 0,
  (_, y) => y % 2 === 0,
  (x) => x % 3 === 0,
  (x, y) => (x + y) % 3 === 0,
  (x, y) => (Math.floor(x / 3) + Math.floor(y / 2)) % 2 === 0,
  (x, y) => ((x * y) % 2) + ((x * y) % 3) === 0,
  (x, y) => (((x * y) % 2) + ((x * y) % 3)) % 2 === 0,
  (x, y) => (((x + y) % 2) + ((x * y) % 3)) % 2 === 0,
];

/** A value with the remainder that corrects it. */
function corrected(value, generator, length) {
  let rest = value;
  for (let i = 0; i < length; i++) rest = (rest << 1) ^ ((rest >> (length - 1)) * generator);
  return (value << length) | rest;
}

/** Everything but the data: `undefined` where data goes. */
function frame(version) {
  const side = sideOf(version);
  const grid = Array.from({ length: side }, () => Array(side).fill(undefined));
  const set = (x, y, dark) => {
    if (x >= 0 && y >= 0 && x < side && y < side) grid[y][x] = dark;
  };
  for (let i = 0; i < side; i++) {
    set(6, i, i % 2 === 0);
    set(i, 6, i % 2 === 0);
  }
  for (const [cx, cy] of [[3, 3], [side - 4, 3], [3, side - 4]]) {
    for (let dy = -4; dy <= 4; dy++) for (let dx = -4; dx <= 4; dx++) set(cx + dx, cy + dy, ![2, 4].includes(Math.max(Math.abs(dx), Math.abs(dy))));
  }
  const places = alignments(version);
  const last = places.length - 1;
  places.forEach((cx, i) =>
    places.forEach((cy, k) => {
      if ((i === 0 && (k === 0 || k === last)) || (i === last && k === 0)) return;
      for (let dy = -2; dy <= 2; dy++) for (let dx = -2; dx <= 2; dx++) set(cx + dx, cy + dy, Math.max(Math.abs(dx), Math.abs(dy)) !== 1);
    }),
  );
  drawFormat(set, side, 0);
  if (version >= 7) {
    const bits = corrected(version, 0x1f25, 12);
    for (let i = 0; i < 18; i++) {
      const [a, b] = [side - 11 + (i % 3), Math.floor(i / 3)];
      set(a, b, ((bits >> i) & 1) === 1);
      set(b, a, ((bits >> i) & 1) === 1);
    }
  }
  return { grid, set, side };
}

/** Level M and the mask, twice. */
function drawFormat(set, side, mask) {
  const bits = corrected(mask, 0x537, 10) ^ 0x5412;
  const bit = (i) => ((bits >> i) & 1) === 1;
  for (let i = 0; i < 15; i++) {
    const along = i < 6 ? i : i < 8 ? i + 1 : 14 - i;
    if (i < 8) set(8, along, bit(i));
    else set(i === 8 ? 7 : along, 8, bit(i));
    if (i < 8) set(side - 1 - i, 8, bit(i));
    else set(8, side - 15 + i, bit(i));
  }
  set(8, side - 8, true);
}

/** How hard to read: long runs, and squares of one colour. */
function penalty(grid) {
  const side = grid.length;
  let sum = 0;
  for (const at of [(i, k) => grid[i][k], (i, k) => grid[k][i]]) {
    for (let i = 0; i < side; i++) {
      for (let k = 1, run = 1; k <= side; k++) {
        if (k < side && at(i, k) === at(i, k - 1)) run += 1;
        else {
          if (run >= 5) sum += run - 2;
          run = 1;
        }
      }
    }
  }
  for (let y = 1; y < side; y++) for (let x = 1; x < side; x++) if (grid[y][x] === grid[y - 1][x] && grid[y][x] === grid[y][x - 1] && grid[y][x] === grid[y - 1][x - 1]) sum += 3;
  return sum;
}

/** Rows of dark (`true`) and light modules, without the margin; `undefined` for a text that is too long. */
export function qrCode(text) {
  const bytes = new TextEncoder().encode(text);
  const version = correction.findIndex((_, i) => bytes.length + (i + 1 < 10 ? 2 : 3) <= dataBytes(i + 1)) + 1;
  if (version === 0) return undefined;
  const words = codewords(bytes, version);
  const { grid: free } = frame(version);
  const candidates = masks.map((isMasked, mask) => {
    const { grid, set, side } = frame(version);
    let at = 0;
    for (let right = side - 1; right >= 1; right -= 2) {
      if (right === 6) right = 5;
      const isUp = ((right + 1) & 2) === 0;
      for (let i = 0; i < side; i++) {
        const y = isUp ? side - 1 - i : i;
        for (const x of [right, right - 1]) {
          if (free[y][x] !== undefined) continue;
          const bit = at < 8 * words.length && ((words[at >> 3] >> (7 - (at & 7))) & 1) === 1;
          at += 1;
          grid[y][x] = bit !== isMasked(x, y);
        }
      }
    }
    drawFormat(set, side, mask);
    return grid;
  });
  return candidates.map((grid) => [penalty(grid), grid]).reduce((best, next) => (next[0] < best[0] ? next : best))[1];
}
