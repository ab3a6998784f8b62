//! Rooms that look alike: the sample room's furniture, moved a little, in other colours, under other pictures.

use super::color::{Rgb, shade};
use super::noise::{Dice, hash};
use super::prints::STYLES;
use super::texture::Texture;

/// Share of the hung pictures that a room goes without.
const BARE: f64 = 0.25;

/// How a room departs from the sample room's furnishing.
#[derive(Debug)]
pub(super) struct Vary {
    dice: Dice,
    seed: u64,
}

impl Vary {
    pub(super) fn new(seed: u64) -> Self {
        Self {
            dice: Dice::new(seed ^ 0x5641_5259),
            seed,
        }
    }

    /// Whether something that hangs is left out.
    pub(super) fn is_bare(&mut self) -> bool {
        self.dice.unit() < BARE
    }

    /// Uniform in plus or minus `most`.
    pub(super) fn offset(&mut self, most: f64) -> f64 {
        self.dice.range(-most, most)
    }

    /// True for half of the rooms.
    pub(super) fn is_swapped(&mut self) -> bool {
        self.dice.unit() < 0.5
    }

    /// The same kind of surface, lighter or darker; another picture.
    pub(super) fn texture(&mut self, texture: Texture) -> Texture {
        match texture {
            Texture::Paint(c) => Texture::Paint(self.tint(c)),
            Texture::Plaster(c) => Texture::Plaster(self.tint(c)),
            Texture::WoodAlong(c) => Texture::WoodAlong(self.tint(c)),
            Texture::WoodUp(c) => Texture::WoodUp(self.tint(c)),
            Texture::Fabric(c) => Texture::Fabric(self.tint(c)),
            Texture::Print(_) => Texture::Print(self.dice.index(usize::from(STYLES)) as u8),
            other => other,
        }
    }

    /// Half to one and a half times as light, the same for everything of a colour.
    fn tint(&self, color: Rgb) -> Rgb {
        let key = color
            .iter()
            .fold(0_i64, |key, c| key.wrapping_mul(31) ^ (c * 4096.0) as i64);
        let unit = (hash(key, 5, self.seed) >> 40) as f64 / f64::from(1 << 24);
        shade(color, 0.5 + unit).map(|c| c.min(0.9))
    }
}
