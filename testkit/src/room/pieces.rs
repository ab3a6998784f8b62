//! What furniture is made of, and pieces that stand in several places: everything is a box or a sheet in a local basis with x
//! to the right, y up and n towards the viewer.

use super::Edge;
use super::alike::Vary;
use super::color::{Rgb, srgb};
use super::noise::Dice;
use super::texture::Texture;
use super::trace::Quad;
use nalgebra::Vector3;

/// Local right-handed basis: x right, y up, n out.
#[derive(Debug, Clone, Copy)]
pub(super) struct Basis {
    pub(super) origin: Vector3<f64>,
    pub(super) x: Vector3<f64>,
    pub(super) y: Vector3<f64>,
    pub(super) n: Vector3<f64>,
}

impl Basis {
    pub(super) fn at(&self, x: f64, y: f64, n: f64) -> Vector3<f64> {
        self.origin + x * self.x + y * self.y + n * self.n
    }

    /// On the floor, turned about the vertical.
    pub(super) fn standing(x: f64, y: f64, yaw_deg: f64) -> Self {
        let (s, c) = yaw_deg.to_radians().sin_cos();
        Self {
            origin: Vector3::new(x, y, 0.0),
            x: Vector3::new(c, s, 0.0),
            y: Vector3::z(),
            n: Vector3::new(s, -c, 0.0),
        }
    }

    pub(super) fn moved(&self, x: f64, y: f64, n: f64) -> Self {
        Self {
            origin: self.at(x, y, n),
            ..*self
        }
    }

    /// Turned about its own y.
    pub(super) fn turned(&self, yaw_deg: f64) -> Self {
        let (s, c) = yaw_deg.to_radians().sin_cos();
        Self {
            x: c * self.x - s * self.n,
            n: c * self.n + s * self.x,
            ..*self
        }
    }
}

/// Textures of a box: towards n, the other upright sides, top and bottom.
#[derive(Debug, Clone, Copy)]
pub(super) struct Skin {
    pub(super) front: Texture,
    pub(super) side: Texture,
    pub(super) top: Texture,
}

impl From<Texture> for Skin {
    fn from(t: Texture) -> Self {
        Self {
            front: t,
            side: t,
            top: t,
        }
    }
}

pub(super) type Span = [f64; 2];

pub(super) struct Builder {
    pub(super) quads: Vec<Quad>,
    pub(super) textures: Vec<Texture>,
    pub(super) edges: Vec<Edge>,
    pub(super) dice: Dice,
    /// None in the sample room.
    pub(super) vary: Option<Vary>,
}

impl Builder {
    /// A place for a piece of furniture: in a room that is not the sample's, up to so many metres along x from there, and turned.
    pub(super) fn placed(&mut self, b: Basis, along_m: f64, turn_deg: f64) -> Basis {
        match &mut self.vary {
            None => b,
            Some(vary) => b
                .moved(vary.offset(along_m), 0.0, 0.0)
                .turned(vary.offset(turn_deg)),
        }
    }

    pub(super) fn texture(&mut self, texture: Texture) -> usize {
        let texture = match &mut self.vary {
            None => texture,
            Some(vary) => vary.texture(texture),
        };
        if let Some(i) = self.textures.iter().position(|t| *t == texture) {
            return i;
        }
        self.textures.push(texture);
        self.textures.len() - 1
    }

    pub(super) fn quad(
        &mut self,
        origin: Vector3<f64>,
        u: Vector3<f64>,
        v: Vector3<f64>,
        texture: Texture,
    ) {
        let texture = self.texture(texture);
        let seed = self.dice.bits();
        self.quads.push(Quad::new(origin, u, v, texture, seed));
    }

    pub(super) fn edge(&mut self, start_in_world: Vector3<f64>, end_in_world: Vector3<f64>) {
        self.edges.push(Edge {
            start_in_world,
            end_in_world,
        });
    }

    pub(super) fn solid(&mut self, b: &Basis, x: Span, y: Span, n: Span, skin: impl Into<Skin>) {
        let skin = skin.into();
        let (dx, dy, dn) = (
            (x[1] - x[0]) * b.x,
            (y[1] - y[0]) * b.y,
            (n[1] - n[0]) * b.n,
        );
        self.quad(b.at(x[0], y[0], n[1]), dx, dy, skin.front);
        self.quad(b.at(x[1], y[0], n[0]), -dx, dy, skin.side);
        self.quad(b.at(x[1], y[0], n[1]), -dn, dy, skin.side);
        self.quad(b.at(x[0], y[0], n[0]), dn, dy, skin.side);
        self.quad(b.at(x[0], y[1], n[1]), dx, -dn, skin.top);
        self.quad(b.at(x[0], y[0], n[0]), dx, dn, skin.top);
        let corner = |i: usize| b.at(x[i & 1], y[(i >> 1) & 1], n[(i >> 2) & 1]);
        for i in 0..8usize {
            for bit in [1, 2, 4] {
                if i & bit == 0 {
                    self.edge(corner(i), corner(i | bit));
                }
            }
        }
    }

    /// A sheet parallel to x and y, with its outline.
    pub(super) fn sheet(&mut self, b: &Basis, x: Span, y: Span, n: f64, texture: Texture) {
        self.quad(
            b.at(x[0], y[0], n),
            (x[1] - x[0]) * b.x,
            (y[1] - y[0]) * b.y,
            texture,
        );
        let corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| b.at(x[i], y[j], n));
        for i in 0..4 {
            self.edge(corners[i], corners[(i + 1) % 4]);
        }
    }

    /// A picture behind a frame of four bars.
    pub(super) fn framed(
        &mut self,
        wall: &Basis,
        x: Span,
        y: Span,
        bar: f64,
        frame: Texture,
        inside: Texture,
    ) {
        let is_picture = matches!(inside, Texture::Print(_));
        if is_picture && self.vary.as_mut().is_some_and(Vary::is_bare) {
            return;
        }
        let wall = &match is_picture {
            true => self.placed(*wall, 0.06, 0.0),
            false => *wall,
        };
        self.sheet(
            wall,
            [x[0] + bar, x[1] - bar],
            [y[0] + bar, y[1] - bar],
            0.012,
            inside,
        );
        let depth = [0.0, 0.028];
        self.solid(wall, x, [y[0], y[0] + bar], depth, frame);
        self.solid(wall, x, [y[1] - bar, y[1]], depth, frame);
        let middle = [y[0] + bar, y[1] - bar];
        self.solid(wall, [x[0], x[0] + bar], middle, depth, frame);
        self.solid(wall, [x[1] - bar, x[1]], middle, depth, frame);
    }

    /// Upright books from `x[0]` to at most `x[1]` on a board at height `y`.
    pub(super) fn books(&mut self, b: &Basis, x: Span, y: f64, max_height: f64, depth: f64) {
        let mut at = x[0];
        loop {
            let gap = if self.dice.unit() > 0.93 { 0.05 } else { 0.001 };
            let width = self.dice.range(0.018, 0.052);
            if at + gap + width > x[1] {
                return;
            }
            let height = max_height * self.dice.range(0.62, 0.97);
            let front = depth - self.dice.range(0.02, 0.06);
            at += gap;
            let skin = Skin {
                front: Texture::Spine,
                side: Texture::Paint(srgb([0x5A3B32, 0x3B4A57, 0xC9BFA8][self.dice.index(3)])),
                top: Texture::Pages,
            };
            self.solid(b, [at, at + width], [y, y + height], [0.03, front], skin);
            at += width;
        }
    }

    pub(super) fn legs(
        &mut self,
        b: &Basis,
        w: f64,
        d: f64,
        height: f64,
        thick: f64,
        texture: Texture,
    ) {
        for x in [0.0, w - thick] {
            for n in [0.0, d - thick] {
                self.solid(b, [x, x + thick], [0.0, height], [n, n + thick], texture);
            }
        }
    }

    /// Table with its corner at the basis.
    pub(super) fn table(&mut self, b: &Basis, w: f64, d: f64, height: f64, color: Rgb) {
        let (leg, top) = (Texture::WoodUp(color), Texture::WoodAlong(color));
        self.solid(b, [0.0, w], [height - 0.035, height], [0.0, d], top);
        let inset = b.moved(0.05, 0.0, 0.05);
        self.legs(&inset, w - 0.1, d - 0.1, height - 0.035, 0.055, leg);
        let apron = [height - 0.12, height - 0.035];
        self.solid(b, [0.1, w - 0.1], apron, [0.06, 0.085], top);
        self.solid(b, [0.1, w - 0.1], apron, [d - 0.085, d - 0.06], top);
    }

    /// Chair with its back at n = 0, seat towards n.
    pub(super) fn chair(&mut self, b: &Basis, color: Rgb, seat: Rgb) {
        let wood = Texture::WoodUp(color);
        self.legs(b, 0.42, 0.42, 0.44, 0.036, wood);
        self.solid(
            b,
            [0.0, 0.42],
            [0.44, 0.475],
            [0.0, 0.42],
            Texture::WoodAlong(color),
        );
        self.solid(
            b,
            [0.02, 0.40],
            [0.475, 0.50],
            [0.03, 0.41],
            Texture::Fabric(seat),
        );
        for x in [0.0, 0.384] {
            self.solid(b, [x, x + 0.036], [0.475, 0.92], [0.0, 0.03], wood);
        }
        for y in [0.60, 0.71, 0.82] {
            self.solid(
                b,
                [0.036, 0.384],
                [y, y + 0.07],
                [0.004, 0.024],
                Texture::WoodAlong(color),
            );
        }
    }

    /// Cabinet with its back at n = 0: doors or drawers with handles.
    pub(super) fn cabinet(
        &mut self,
        b: &Basis,
        w: f64,
        y: Span,
        d: f64,
        grid: (usize, usize),
        color: Texture,
    ) {
        self.solid(b, [0.0, w], y, [0.0, d], color);
        let (columns, rows) = grid;
        let (cw, rh) = (w / columns as f64, (y[1] - y[0]) / rows as f64);
        for i in 0..columns {
            for j in 0..rows {
                let (x0, y0) = (i as f64 * cw, y[0] + j as f64 * rh);
                let (x1, y1) = (x0 + cw, y0 + rh);
                self.solid(
                    b,
                    [x0 + 0.012, x1 - 0.012],
                    [y0 + 0.012, y1 - 0.012],
                    [d, d + 0.018],
                    color,
                );
                let (mx, my) = (0.5 * (x0 + x1), 0.5 * (y0 + y1));
                self.solid(
                    b,
                    [mx - 0.06, mx + 0.06],
                    [my - 0.008, my + 0.008],
                    [d + 0.018, d + 0.042],
                    Texture::Paint(srgb(0x2E2E31)),
                );
            }
        }
    }

    pub(super) fn window(&mut self, wall: &Basis, x: Span, y: Span) {
        let white = Texture::Paint(srgb(0xE9E6DD));
        self.framed(wall, x, y, 0.06, white, Texture::Outside);
        let (mx, my) = (0.5 * (x[0] + x[1]), y[0] + 0.66 * (y[1] - y[0]));
        let (ix, iy) = ([x[0] + 0.06, x[1] - 0.06], [y[0] + 0.06, y[1] - 0.06]);
        self.solid(wall, [mx - 0.025, mx + 0.025], iy, [0.012, 0.026], white);
        self.solid(
            wall,
            [ix[0], mx - 0.025],
            [my - 0.02, my + 0.02],
            [0.012, 0.024],
            white,
        );
        self.solid(
            wall,
            [mx + 0.025, ix[1]],
            [my - 0.02, my + 0.02],
            [0.012, 0.024],
            white,
        );
        self.solid(
            wall,
            [x[0] - 0.06, x[1] + 0.06],
            [y[0] - 0.04, y[0]],
            [0.0, 0.16],
            white,
        );
    }
}
