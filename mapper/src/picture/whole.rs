//! Is a picture's file whole? Decoders fill what a cut file lacks with grey and say nothing.

use image::{DynamicImage, GenericImageView, ImageFormat};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// So much of the end is looked at first; what cameras append to a picture is rarely longer.
const TAIL_BYTES: u64 = 1 << 16;

/// Whether the file holds the picture's end.
pub(super) fn is_whole(path: &Path, format: ImageFormat) -> io::Result<bool> {
    let mut file = File::open(path)?;
    let len = file.metadata()?.len();
    match format {
        ImageFormat::Jpeg => {
            // Of a small file the end of a thumbnail may lie in the tail.
            if len > 4 * TAIL_BYTES && holds(&tail(&mut file, len)?, &[0xff, 0xd9]) {
                return Ok(true);
            }
            file.seek(SeekFrom::Start(0))?;
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes)?;
            Ok(jpeg_ends(&bytes))
        }
        ImageFormat::Png => Ok(holds(&tail(&mut file, len)?, b"IEND")),
        ImageFormat::WebP => {
            let mut head = [0; 8];
            file.read_exact(&mut head)?;
            let [.., a, b, c, d] = head;
            Ok(u64::from(u32::from_le_bytes([a, b, c, d])) + 8 <= len)
        }
        _ => Ok(true),
    }
}

fn tail(file: &mut File, len: u64) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(len.saturating_sub(TAIL_BYTES)))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn holds(bytes: &[u8], what: &[u8]) -> bool {
    bytes.windows(what.len()).any(|w| w == what)
}

/// Walks a JPEG's segments and scans to its end marker.
fn jpeg_ends(bytes: &[u8]) -> bool {
    let mut at = 2;
    loop {
        // Between segments, and after a scan: the next marker that is no stuffed byte and no restart.
        let Some(marker_at) = bytes.get(at..).and_then(|rest| {
            rest.windows(2)
                .position(|w| w[0] == 0xff && !matches!(w[1], 0 | 0xff | 0xd0..=0xd7))
        }) else {
            return false;
        };
        at += marker_at;
        match bytes.get(at + 1) {
            Some(0xd9) => return true,
            // Without a length.
            Some(0x01 | 0xd8) => at += 2,
            Some(_) => {
                let Some(&[high, low]) = bytes.get(at + 2..).and_then(|r| r.first_chunk::<2>())
                else {
                    return false;
                };
                at += 2 + usize::from(u16::from_be_bytes([high, low])).max(2);
            }
            None => return false,
        }
    }
}

/// Whether the last block of a picture has one colour, as what a decoder fills in has.
pub(super) fn ends_blank(picture: &DynamicImage) -> bool {
    const BLOCK: u32 = 8;
    let (width, height) = picture.dimensions();
    let (x, y) = (width.saturating_sub(BLOCK), height.saturating_sub(BLOCK));
    let last = picture.get_pixel(width - 1, height - 1);
    (y..height).all(|y| (x..width).all(|x| picture.get_pixel(x, y) == last))
}

/// The name of a format that is known and not decoded.
pub(super) fn undecoded_format(path: &Path) -> io::Result<Option<&'static str>> {
    let mut head = Vec::new();
    File::open(path)?.take(64).read_to_end(&mut head)?;
    Ok(undecoded_brand(&head))
}

/// The same of the first bytes of a file.
pub(super) fn undecoded_brand(bytes: &[u8]) -> Option<&'static str> {
    let head = bytes.get(..64).unwrap_or(bytes);
    if head.get(4..8) != Some(b"ftyp") {
        return None;
    }
    let names = |brands: &[&[u8; 4]]| brands.iter().any(|brand| holds(&head[8..], *brand));
    if names(&[b"avif", b"avis"]) {
        Some("AVIF")
    } else if names(&[b"heic", b"heix", b"hevc", b"mif1"]) {
        Some("HEIC")
    } else {
        None
    }
}
