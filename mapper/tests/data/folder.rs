//! A temporary folder with pictures and text files.

use image::{GrayImage, ImageFormat, Luma};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

static NEXT: AtomicU32 = AtomicU32::new(0);

/// Removed when dropped.
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    pub(crate) fn new() -> Self {
        let path = std::env::temp_dir().join(format!(
            "landline-data-{}-{}",
            std::process::id(),
            NEXT.fetch_add(1, Ordering::Relaxed)
        ));
        std::fs::create_dir_all(&path).expect("the temporary folder is writable");
        Self(path)
    }

    pub(crate) fn text(&self, name: &str, content: &str) -> PathBuf {
        let path = self.0.join(name);
        std::fs::create_dir_all(path.parent().expect("has a parent")).expect("writable");
        std::fs::write(&path, content).expect("writable");
        path
    }

    pub(crate) fn picture(&self, name: &str, width: u32, height: u32) -> PathBuf {
        let path = self.text(name, "");
        let format = if name.ends_with(".png") {
            ImageFormat::Png
        } else {
            ImageFormat::Jpeg
        };
        GrayImage::from_fn(width, height, |x, y| Luma([(x * 3 + y * 5) as u8]))
            .save_with_format(&path, format)
            .expect("writable");
        path
    }

    pub(crate) fn copy(&self, from: &Path, name: &str) {
        let to = self.0.join(name);
        std::fs::create_dir_all(to.parent().expect("has a parent")).expect("writable");
        std::fs::copy(from, to).expect("the fixture exists");
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        drop(std::fs::remove_dir_all(&self.0));
    }
}

/// Writes a JPEG whose EXIF says that it has to be turned clockwise to stand upright (orientation 6).
pub(crate) fn write_turned_jpeg(picture: &image::DynamicImage, path: &Path) {
    let mut plain = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut plain, 95)
        .encode_image(&picture.to_rgb8())
        .expect("encodes");
    // One entry: tag 0x0112, short, one value, 6.
    let mut exif = b"Exif\0\0MM\0\x2a\0\0\0\x08\0\x01".to_vec();
    exif.extend(b"\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0");
    let length = u16::try_from(exif.len() + 2).expect("short").to_be_bytes();
    let bytes = [&plain[..2], &[0xff, 0xe1], &length, &exif, &plain[2..]].concat();
    std::fs::write(path, bytes).expect("writable");
}
