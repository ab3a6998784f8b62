//! Changes of an input that keep most of its structure: numbers become extreme, words are swapped, lengths lie, ends are cut.

use landline::math::Rng;

/// Numbers that break careless code, as texts.
const WORDS: [&str; 16] = [
    "NaN",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "5e-324",
    "0",
    "-0",
    "-1",
    "1e-300",
    "9223372036854775807",
    "18446744073709551615",
    "4294967296",
    "1e11",
    "null",
    "\"\"",
];

/// The same as eight bytes.
const NUMBERS: [u64; 10] = [
    0,
    1,
    u64::MAX,
    1 << 63,
    1 << 32,
    0x7ff8_0000_0000_0000,
    0x7ff0_0000_0000_0000,
    0x7fef_ffff_ffff_ffff,
    0x0000_0000_7fc0_0000,
    100_000_000_000,
];

/// An input with one to four changes.
#[must_use]
pub fn mutated(seed: &[u8], rng: &mut Rng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=rng.below(4) {
        change(&mut bytes, rng);
    }
    bytes
}

fn change(bytes: &mut Vec<u8>, rng: &mut Rng) {
    let len = bytes.len();
    let below = |rng: &mut Rng, n: usize| rng.below(n.clamp(1, u32::MAX as usize) as u32) as usize;
    let at = below(rng, len.max(1));
    match rng.below(8) {
        // A token of text.
        0..=2 if len > 0 => {
            let is_part = |b: &u8| b.is_ascii_alphanumeric() || b"+-._".contains(b);
            let start = bytes[..at]
                .iter()
                .rposition(|b| !is_part(b))
                .map_or(0, |i| i + 1);
            let end = bytes[at..]
                .iter()
                .position(|b| !is_part(b))
                .map_or(len, |i| at + i);
            let word = WORDS[below(rng, WORDS.len())];
            bytes.splice(start.min(end)..end, word.bytes());
        }
        // A number of eight or four bytes, at a place that is aligned or not.
        3 | 4 if len >= 8 => {
            let at = if rng.below(2) == 0 {
                at.min(len - 8)
            } else {
                at.min(len - 8) / 8 * 8
            };
            let number = NUMBERS[below(rng, NUMBERS.len())].to_le_bytes();
            let width = if rng.below(2) == 0 { 8 } else { 4 };
            bytes[at..at + width].copy_from_slice(&number[..width]);
        }
        5 if len > 0 => bytes[at] ^= 1 << rng.below(8),
        6 => bytes.truncate(at),
        _ => {
            // A piece of it once more, somewhere else.
            let end = (at + 1 + below(rng, 32)).min(len);
            let piece = bytes[at.min(end)..end].to_vec();
            let to = below(rng, len + 1);
            bytes.splice(to..to, piece);
        }
    }
}
