//! `landline lines`: detects the line segments of pictures.

use crate::files::{names_apart, write_bytes};
use crate::picture;
use anyhow::{Context, Result, bail};
use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use cpu_time::ThreadTime;
use image::{ImageFormat, Rgb, RgbImage};
use landline::geometry::Segment2;
use landline::image::GrayImage;
use landline::lsd::post::{self, Direction, PostParams, Rank};
use landline::lsd::{LsdParams, LsdScratch, LsdVersion, MergeParams, detect};
use serde::Serialize;
use std::fmt::Write as _;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Detects line segments (LSD) and prints them, in corner-based pixels of the upright picture.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Pictures (JPEG or PNG)
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Print one JSON object a line and picture: `image`, `width`, `height`, and `segments` as
    /// [x1, y1, x2, y2, width, -log10(NFA)]
    #[arg(long)]
    json: bool,
    /// Draw the segments on the picture; SVG, or PNG when OUT ends in `.png`. With several pictures OUT is a folder
    #[arg(long, value_name = "OUT")]
    svg: Option<PathBuf>,
    /// Detect N times and give the median and least processor time in milliseconds (of detection and
    /// post-processing, without decoding)
    #[arg(long, value_name = "N")]
    repeat: Option<usize>,
    /// Size of the working image relative to the picture
    #[arg(long, default_value_t = 0.8)]
    scale: f64,
    /// Keep segments whose -log10(NFA) is greater
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    min_nfa: f64,
    /// Reproduce LSD 1.5 instead of 1.6
    #[arg(long)]
    lsd15: bool,
    /// Join fragments of one line
    #[arg(long)]
    merge: bool,
    /// Drop segments shorter than this, in pixels
    #[arg(long, default_value_t = 0.0, value_name = "PX")]
    min_length: f64,
    /// Keep the best K segments
    #[arg(long, default_value_t = post::DEFAULT_MAX_COUNT, value_name = "K")]
    top: usize,
    /// What `--top` ranks by
    #[arg(long, value_enum, default_value_t = RankArg::Length)]
    rank: RankArg,
    /// Which end of a segment comes first
    #[arg(long, value_enum, default_value_t = DirectionArg::DarkAtRight)]
    direction: DirectionArg,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum RankArg {
    Length,
    Nfa,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum DirectionArg {
    /// Dark side at the right hand from start to end, as detected
    DarkAtRight,
    /// The other way round
    DarkAtLeft,
    /// Smaller x first
    LeftToRight,
}

/// One line of the JSON output.
#[derive(Serialize)]
struct Record<'a> {
    image: &'a str,
    width: usize,
    height: usize,
    segments: Vec<[f64; 6]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    median_ms: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    min_ms: Option<f64>,
}

/// Processor time of the repetitions.
#[derive(Debug, Clone, Copy)]
struct Timing {
    median_ms: f64,
    min_ms: f64,
}

/// Runs the command.
///
/// # Errors
/// When a picture cannot be read, a parameter is out of range, or a drawing cannot be written.
pub fn run(args: Args) -> Result<()> {
    if args.repeat == Some(0) {
        bail!("--repeat must be at least 1");
    }
    if !(args.min_length >= 0.0) {
        bail!("--min-length is {}; it must be 0 or more", args.min_length);
    }
    if let (Some(out), [_]) = (&args.svg, &args.images[..]) {
        drawing_format(out)?;
    }
    let params = LsdParams {
        scale: args.scale,
        min_neg_log10_nfa: args.min_nfa,
        version: if args.lsd15 {
            LsdVersion::V1_5
        } else {
            LsdVersion::V1_6
        },
        ..LsdParams::default()
    };
    params.check()?;
    let steps = PostParams {
        merge: args.merge.then(MergeParams::default),
        min_length_px: args.min_length,
        max_count: args.top,
        rank: match args.rank {
            RankArg::Length => Rank::Length,
            RankArg::Nfa => Rank::Significance,
        },
        direction: match args.direction {
            DirectionArg::DarkAtRight => Direction::DarkAtRight,
            DirectionArg::DarkAtLeft => Direction::DarkAtLeft,
            DirectionArg::LeftToRight => Direction::LeftToRight,
        },
    };
    let mut scratch = LsdScratch::default();
    let names = names_apart(&args.images, Path::file_name);
    for (path, name) in args.images.iter().zip(&names) {
        let gray = picture::read_gray(path)?;
        let mut segments = Vec::new();
        let mut times = Vec::new();
        for _ in 0..args.repeat.unwrap_or(1) {
            let start = ThreadTime::now();
            segments.clear();
            segments.extend_from_slice(
                detect(&gray.view(), &params, &mut scratch)
                    .with_context(|| format!("picture {}", path.display()))?,
            );
            post::apply(&mut segments, &steps);
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        times.sort_by(f64::total_cmp);
        let timing = args.repeat.map(|_| Timing {
            median_ms: times[times.len() / 2],
            min_ms: times[0],
        });
        print(path, &gray, &segments, timing, args.json)?;
        if let Some(out) = &args.svg {
            // With several pictures `out` is a folder that gets one SVG for each.
            let out = match args.images.len() {
                1 => out.clone(),
                _ => out.join(format!("{name}.svg")),
            };
            write_bytes(&out, &drawing(&out, path, &gray, &segments)?)?;
        }
    }
    Ok(())
}

fn print(
    path: &Path,
    gray: &GrayImage,
    segments: &[Segment2],
    timing: Option<Timing>,
    as_json: bool,
) -> Result<()> {
    let name = path.to_string_lossy();
    if as_json {
        let record = Record {
            image: &name,
            width: gray.width,
            height: gray.height,
            segments: segments.iter().map(row).collect(),
            median_ms: timing.map(|t| t.median_ms),
            min_ms: timing.map(|t| t.min_ms),
        };
        println!("{}", serde_json::to_string(&record)?);
        return Ok(());
    }
    print!(
        "# {name}: {}x{}, {} segments",
        gray.width,
        gray.height,
        segments.len()
    );
    if let Some(t) = timing {
        print!(", median {:.2} ms, least {:.2} ms", t.median_ms, t.min_ms);
    }
    println!("\n# x1 y1 x2 y2 width -log10(NFA)");
    for segment in segments {
        let [x1, y1, x2, y2, width, nfa] = row(segment);
        println!("{x1:.3} {y1:.3} {x2:.3} {y2:.3} {width:.3} {nfa:.3}");
    }
    Ok(())
}

fn row(s: &Segment2) -> [f64; 6] {
    [
        s.start.x,
        s.start.y,
        s.end.x,
        s.end.y,
        s.width_px,
        s.neg_log10_nfa,
    ]
}

#[derive(Debug, Clone, Copy)]
enum DrawingFormat {
    Svg,
    Png,
}

fn drawing_format(out: &Path) -> Result<DrawingFormat> {
    let extension = out.extension().map(|e| e.to_ascii_lowercase());
    match extension.as_ref().and_then(|e| e.to_str()) {
        Some("png") => Ok(DrawingFormat::Png),
        Some("svg") => Ok(DrawingFormat::Svg),
        _ => bail!("--svg {}: the name must end in .svg or .png", out.display()),
    }
}

fn drawing(out: &Path, picture: &Path, gray: &GrayImage, segments: &[Segment2]) -> Result<Vec<u8>> {
    match drawing_format(out)? {
        DrawingFormat::Svg => svg(gray, segments),
        DrawingFormat::Png => png(picture, segments),
    }
}

/// The grey picture as the detector saw it, with the segments as lines; start points are dots.
fn svg(gray: &GrayImage, segments: &[Segment2]) -> Result<Vec<u8>> {
    let mut grey_png = Vec::new();
    image::write_buffer_with_format(
        &mut Cursor::new(&mut grey_png),
        &gray.data,
        u32::try_from(gray.width)?,
        u32::try_from(gray.height)?,
        image::ExtendedColorType::L8,
        ImageFormat::Png,
    )?;
    let (w, h) = (gray.width, gray.height);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\">\n\
         <image width=\"{w}\" height=\"{h}\" href=\"data:image/png;base64,{}\"/>\n\
         <g stroke=\"#ff2d55\" stroke-width=\"1.2\" stroke-linecap=\"round\" fill=\"#ffd60a\">\n",
        BASE64_STANDARD.encode(&grey_png)
    );
    for s in segments {
        writeln!(
            text,
            "<path d=\"M{:.3} {:.3}L{:.3} {:.3}\"><title>{:.1} px, -log10(NFA) {:.1}</title></path>\
             <circle cx=\"{:.3}\" cy=\"{:.3}\" r=\"1\" stroke=\"none\"/>",
            s.start.x,
            s.start.y,
            s.end.x,
            s.end.y,
            s.length_px(),
            s.neg_log10_nfa,
            s.start.x,
            s.start.y
        )?;
    }
    text.push_str("</g>\n</svg>\n");
    Ok(text.into_bytes())
}

/// The coloured picture with the segments painted in.
fn png(path: &Path, segments: &[Segment2]) -> Result<Vec<u8>> {
    let mut picture: RgbImage = picture::read(path)?.into_rgb8();
    for s in segments {
        let steps = (2.0 * s.length_px()).ceil().max(1.0) as u32;
        for i in 0..=steps {
            let t = f64::from(i) / f64::from(steps);
            let (x, y) = (
                s.start.x + t * (s.end.x - s.start.x),
                s.start.y + t * (s.end.y - s.start.y),
            );
            // Corner-based: pixel (0, 0) covers 0..1.
            if x >= 0.0
                && y >= 0.0
                && let Some(pixel) = picture.get_pixel_mut_checked(x as u32, y as u32)
            {
                *pixel = Rgb([255, 45, 85]);
            }
        }
    }
    let mut bytes = Vec::new();
    picture.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawings_hold_every_segment() -> Result<()> {
        let gray = GrayImage {
            data: vec![0; 12],
            width: 4,
            height: 3,
        };
        let segment = Segment2 {
            start: landline::geometry::Pixel::new(0.5, 0.5),
            end: landline::geometry::Pixel::new(3.5, 2.5),
            width_px: 1.0,
            precision: 0.125,
            neg_log10_nfa: 2.0,
        };
        let text = String::from_utf8(svg(&gray, &[segment, segment])?)?;
        assert_eq!(
            text.matches("<path d=\"M0.500 0.500L3.500 2.500\">")
                .count(),
            2
        );
        assert!(text.contains("viewBox=\"0 0 4 3\""));
        assert!(drawing(Path::new("x.gif"), Path::new("p"), &gray, &[]).is_err());
        Ok(())
    }
}
