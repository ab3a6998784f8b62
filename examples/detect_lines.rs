//! Detects the line segments of a picture and prints them: `cargo run --release --example detect_lines -- PICTURE`.

use landline::image::GrayView;
use landline::lsd::{LsdParams, LsdScratch, detect};
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args()
        .nth(1)
        .ok_or("give the path of a picture")?;
    let picture = image::open(&path)?.into_luma8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let gray = GrayView::tight(picture.as_raw(), width, height);

    // The scratch memory is worth keeping: with it, the next picture of this size allocates nothing.
    let mut scratch = LsdScratch::default();
    let segments = detect(&gray, &LsdParams::default(), &mut scratch)?;

    println!("x1\ty1\tx2\ty2\twidth\t-log10(NFA)");
    for s in segments {
        println!(
            "{:.2}\t{:.2}\t{:.2}\t{:.2}\t{:.2}\t{:.1}",
            s.start.x, s.start.y, s.end.x, s.end.y, s.width_px, s.neg_log10_nfa
        );
    }
    Ok(())
}
