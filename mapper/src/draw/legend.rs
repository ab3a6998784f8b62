//! The box that says what is what.

use super::{BLACK, WHITE, confidence_color, disc, lines, opaque, paint, ring};
use embedded_graphics::Drawable;
use embedded_graphics::draw_target::DrawTarget;
use embedded_graphics::geometry::{OriginDimensions, Point, Size};
use embedded_graphics::mono_font::ascii::{FONT_8X13, FONT_8X13_BOLD};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::{Rgb888, RgbColor};
use embedded_graphics::text::{Baseline, Text};
use image::Rgb;
use landline::geometry::Pixel;
use std::convert::Infallible;
use tiny_skia::{Pixmap, Rect, Transform};

/// What an entry explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mark {
    /// A thick line.
    Line(Rgb<u8>),
    /// A thin line.
    ThinLine(Rgb<u8>),
    /// A disc.
    Disc(Rgb<u8>),
    /// A ring.
    Ring(Rgb<u8>),
    /// The confidence ramp from 0 to 1.
    Confidence,
}

/// A mark and its meaning.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    mark: Mark,
    text: String,
}

impl Entry {
    /// A mark and its meaning.
    pub fn new(mark: Mark, text: impl Into<String>) -> Self {
        Self {
            mark,
            text: text.into(),
        }
    }
}

/// Title, lines of text, and entries.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Legend {
    /// In bold.
    pub title: String,
    /// Under the title.
    pub text: Vec<String>,
    /// Marks and their meanings.
    pub entries: Vec<Entry>,
}

const LINE_HEIGHT: i32 = 17;
const MARGIN: i32 = 10;
const MARK_WIDTH: i32 = 44;
const CHAR_WIDTH: i32 = 8;

impl Legend {
    pub(super) fn draw(&self, picture: &mut Pixmap) {
        let num_lines = 1 + self.text.len() + self.entries.len();
        let longest = |texts: &mut dyn Iterator<Item = &String>| {
            texts.map(|t| t.chars().count()).max().unwrap_or(0) as i32 * CHAR_WIDTH
        };
        let plain = longest(&mut self.text.iter().chain([&self.title]));
        let marked = longest(&mut self.entries.iter().map(|e| &e.text)) + MARK_WIDTH;
        let width = plain.max(marked) + 2 * MARGIN;
        let height = num_lines as i32 * LINE_HEIGHT + 2 * MARGIN - 4;
        let (left, top) = (8, picture.height() as i32 - height - 8);
        fill(picture, [left, top, width, height], BLACK, 0.72);
        let x = left + MARGIN;
        let mut y = top + MARGIN - 2;
        text(picture, (x, y), &FONT_8X13_BOLD, &self.title);
        for line in &self.text {
            y += LINE_HEIGHT;
            text(picture, (x, y), &FONT_8X13, line);
        }
        for entry in &self.entries {
            y += LINE_HEIGHT;
            mark(picture, x, y + 7, entry.mark);
            text(picture, (x + MARK_WIDTH, y), &FONT_8X13, &entry.text);
        }
    }
}

fn mark(picture: &mut Pixmap, x: i32, y: i32, mark: Mark) {
    let at = |dx: i32| Pixel::new(f64::from(x + dx), f64::from(y));
    match mark {
        Mark::Line(color) => lines(picture, &[[at(2), at(32)]], 3.0, color),
        Mark::ThinLine(color) => lines(picture, &[[at(2), at(32)]], 1.2, color),
        Mark::Disc(color) => disc(picture, at(17), 3.5, color),
        Mark::Ring(color) => ring(picture, at(17), 3.5, color),
        Mark::Confidence => {
            for dx in 0..34 {
                let color = confidence_color(dx as f32 / 33.0);
                fill(picture, [x + dx, y - 4, 1, 8], color, 1.0);
            }
        }
    }
}

/// Fills a rectangle: left, top, width, height.
fn fill(picture: &mut Pixmap, rectangle: [i32; 4], color: Rgb<u8>, alpha: f32) {
    let [x, y, w, h] = rectangle.map(|v| v as f32);
    if let Some(rectangle) = Rect::from_xywh(x, y, w, h) {
        picture.fill_rect(rectangle, &paint(color, alpha), Transform::identity(), None);
    }
}

fn text(picture: &mut Pixmap, (x, y): (i32, i32), font: &MonoFont<'_>, text: &str) {
    let style = MonoTextStyle::new(font, Rgb888::new(WHITE.0[0], WHITE.0[1], WHITE.0[2]));
    let Ok(_) = Text::with_baseline(text, Point::new(x, y), style, Baseline::Top)
        .draw(&mut Target(picture));
}

/// The picture as the text renderer wants it.
struct Target<'a>(&'a mut Pixmap);

impl OriginDimensions for Target<'_> {
    fn size(&self) -> Size {
        Size::new(self.0.width(), self.0.height())
    }
}

impl DrawTarget for Target<'_> {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I>(&mut self, pixels: I) -> Result<(), Infallible>
    where
        I: IntoIterator<Item = embedded_graphics::Pixel<Rgb888>>,
    {
        for embedded_graphics::Pixel(at, color) in pixels {
            let color = Rgb([color.r(), color.g(), color.b()]);
            let (width, height) = (self.0.width() as i32, self.0.height() as i32);
            if (0..width).contains(&at.x) && (0..height).contains(&at.y) {
                self.0.pixels_mut()[(at.y * width + at.x) as usize] = opaque(color);
            }
        }
        Ok(())
    }
}
