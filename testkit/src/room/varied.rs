//! Rooms that differ as rooms do: in size, in what stands where and how much of it, in walls, floor, ceiling and pictures.
//! The rooms of a house share its doors, windows, skirting and height.

use super::build::{Built, bookcase};
use super::color::{Rgb, shade, srgb};
use super::noise::{Dice, hash};
use super::pieces::{Basis, Builder, Skin, Span};
use super::prints::STYLES;
use super::texture::{PATTERNS, Texture};
use nalgebra::Vector3;

/// So many seeds in a row are rooms of one house.
const ROOMS_OF_A_HOUSE: u64 = 10;
/// Kinds of pieces that a room has; a room is a study or a kitchen, not everything at once.
const KINDS_OF_A_ROOM: usize = 7;

/// What stands or hangs at a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Bookcase,
    Shelves,
    Sideboard,
    Wardrobe,
    Desk,
    Kitchen,
    Sofa,
    Bed,
    Gallery,
    Poster,
    Board,
    Radiator,
    Crates,
    Fireplace,
    Chairs,
}

/// All kinds, with least and greatest width in metres.
const KINDS: [(Kind, Span); 15] = [
    (Kind::Bookcase, [0.6, 2.4]),
    (Kind::Shelves, [0.7, 1.6]),
    (Kind::Sideboard, [0.8, 2.2]),
    (Kind::Wardrobe, [0.8, 2.4]),
    (Kind::Desk, [1.0, 1.9]),
    (Kind::Kitchen, [1.5, 3.2]),
    (Kind::Sofa, [1.2, 2.6]),
    (Kind::Bed, [1.4, 2.1]),
    (Kind::Gallery, [0.9, 2.6]),
    (Kind::Poster, [0.6, 1.8]),
    (Kind::Board, [0.8, 2.0]),
    (Kind::Radiator, [0.6, 1.4]),
    (Kind::Crates, [0.5, 0.6]),
    (Kind::Fireplace, [1.1, 1.6]),
    (Kind::Chairs, [0.6, 1.6]),
];

/// What the rooms of a house have in common.
struct House {
    height: f64,
    /// Columns and rows of a door's panels.
    panels: (usize, usize),
    door: Texture,
    trim: Texture,
    /// Width, sill and top of a window.
    window: [f64; 3],
}

impl House {
    fn of(seed: u64) -> Self {
        let mut dice = Dice::new(hash((seed / ROOMS_OF_A_HOUSE) as i64, 3, 0x484F_5553));
        let height = dice.range(2.4, 3.3);
        let door = color(&mut dice);
        Self {
            height,
            panels: (1 + dice.index(2), 1 + dice.index(4)),
            door: match dice.index(2) {
                0 => Texture::Paint(door),
                _ => Texture::WoodUp(door),
            },
            trim: Texture::Paint(shade(srgb(0xEDE8DC), dice.range(0.5, 1.0))),
            window: [
                dice.range(0.8, 1.8),
                dice.range(0.4, 1.1),
                height - dice.range(0.25, 0.5),
            ],
        }
    }
}

fn color(dice: &mut Dice) -> Rgb {
    let light = dice.range(0.15, 0.75);
    core::array::from_fn(|_| (light * dice.range(0.45, 1.25)).min(0.85))
}

fn wood(dice: &mut Dice) -> Rgb {
    const WOODS: [u32; 7] = [
        0x8A5A34, 0xA9713F, 0xC79B66, 0x6E4A2E, 0x3B2A20, 0xD9C29A, 0xE8E4DA,
    ];
    let light = dice.range(0.8, 1.1);
    shade(srgb(WOODS[dice.index(WOODS.len())]), light)
}

fn pattern(dice: &mut Dice) -> Texture {
    Texture::Pattern {
        kind: dice.index(usize::from(PATTERNS)) as u8,
        side_m: dice.range(0.07, 0.32),
        ground: color(dice),
        ink: color(dice),
    }
}

fn wall_texture(dice: &mut Dice) -> Texture {
    match dice.index(10) {
        0..=4 => Texture::Plaster(shade(color(dice), 1.15)),
        5 | 6 => pattern(dice),
        7 => Texture::Brick,
        8 => Texture::Paint(color(dice)),
        _ => Texture::WoodUp(wood(dice)),
    }
}

/// A room of its own, and its width, depth and height in metres.
pub(super) fn furnish(seed: u64) -> (Built, [f64; 3]) {
    let house = House::of(seed);
    let mut dice = Dice::new(seed ^ 0x524F_4F4D);
    let [w, d, h] = [dice.range(4.2, 8.5), dice.range(3.6, 6.5), house.height];
    let mut b = Builder {
        quads: Vec::new(),
        textures: Vec::new(),
        edges: Vec::new(),
        dice: Dice::new(seed ^ 0x4C41_4E44),
        vary: None,
    };
    let wall = |x: f64, y: f64, dx: f64, dy: f64| Basis {
        origin: Vector3::new(x, y, 0.0),
        x: Vector3::new(dx, dy, 0.0),
        y: Vector3::z(),
        n: Vector3::new(dy, -dx, 0.0),
    };
    let walls = [
        (wall(0.0, d, 1.0, 0.0), w),
        (wall(w, d, 0.0, -1.0), d),
        (wall(w, 0.0, -1.0, 0.0), w),
        (wall(0.0, 0.0, 0.0, 1.0), d),
    ];
    floor_and_ceiling(&mut b, &mut dice, [w, d, h]);
    let usual = wall_texture(&mut dice);
    let mut kinds: Vec<(Kind, Span)> = KINDS.to_vec();
    for i in 0..KINDS_OF_A_ROOM {
        let other = i + dice.index(kinds.len() - i);
        kinds.swap(i, other);
    }
    kinds.truncate(KINDS_OF_A_ROOM);
    let door = dice.index(4);
    let windows = (door + 1 + dice.index(3)) % 4;
    for (i, (basis, length)) in walls.iter().enumerate() {
        let texture = match dice.index(3) {
            0 => wall_texture(&mut dice),
            _ => usual,
        };
        b.sheet(basis, [0.0, *length], [0.0, h], 0.0, texture);
        b.solid(basis, [0.0, *length], [0.0, 0.09], [0.0, 0.016], house.trim);
        let has_windows = i == windows || i != door && dice.unit() < 0.25;
        let mut door_at = (i == door).then(|| dice.range(0.2, length - 1.2));
        let mut at = dice.range(0.05, 0.5);
        loop {
            if let Some(x) = door_at.filter(|x| at + 0.5 > *x) {
                self::door(&mut b, &basis.moved(x.max(at), 0.0, 0.0), &house);
                at = x.max(at) + 1.0 + dice.range(0.05, 0.4);
                door_at = None;
            }
            let is_window = has_windows && dice.unit() < 0.6;
            let (kind, [least, most]) = kinds[dice.index(kinds.len())];
            let width = if is_window {
                house.window[0]
            } else {
                dice.range(least, most)
            };
            let end = door_at.unwrap_or(length - 0.05);
            if at + width > end {
                match door_at {
                    Some(x) => at = x,
                    None => break,
                }
                continue;
            }
            let here = basis.moved(at, 0.0, 0.0);
            if is_window {
                window(&mut b, &mut dice, &here, &house);
            } else {
                piece(&mut b, &mut dice, &here, kind, width, h);
            }
            at += width + dice.range(0.02, 0.4);
        }
    }
    middle(&mut b, &mut dice, [w, d]);
    let built = Built {
        quads: b.quads,
        textures: b.textures,
        edges: b.edges,
    };
    (built, [w, d, h])
}

fn floor_and_ceiling(b: &mut Builder, dice: &mut Dice, [w, d, h]: [f64; 3]) {
    let floor = match dice.index(5) {
        0 => Texture::Boards,
        1 => Texture::WoodAlong(wood(dice)),
        2 => Texture::Fabric(color(dice)),
        _ => pattern(dice),
    };
    b.quad(Vector3::zeros(), w * Vector3::x(), d * Vector3::y(), floor);
    let ceiling = Texture::Plaster(shade(srgb(0xE8E3D6), dice.range(0.8, 1.05)));
    let far = Vector3::new(0.0, d, h);
    b.quad(far, w * Vector3::x(), -d * Vector3::y(), ceiling);
    if dice.unit() < 0.35 {
        let beam = Texture::WoodAlong(wood(dice));
        let (is_along, count) = (dice.unit() < 0.5, 2 + dice.index(4));
        let (length, across) = if is_along { (w, d) } else { (d, w) };
        let along = match is_along {
            true => Basis::standing(0.0, d, 0.0),
            false => Basis::standing(0.0, 0.0, 90.0),
        };
        for i in 0..count {
            let n = across * (i as f64 + 0.5) / count as f64;
            b.solid(
                &along,
                [0.0, length],
                [h - 0.17, h],
                [n - 0.07, n + 0.07],
                beam,
            );
        }
    }
    let metal = Texture::Paint(color(dice));
    let (columns, rows) = (1 + dice.index(3), 1 + dice.index(2));
    let half = [dice.range(0.12, 0.6), dice.range(0.09, 0.25)];
    let low = h - dice.range(0.08, 0.4);
    for i in 0..columns * rows {
        let x = w * ((i % columns) as f64 + 0.5) / columns as f64;
        let y = d * ((i / columns) as f64 + 0.5) / rows as f64;
        let hang = Basis::standing(x, y, 0.0);
        let rod = [-0.006, 0.006];
        b.solid(&hang, rod, [low, h], rod, metal);
        b.solid(
            &hang,
            [-half[0], half[0]],
            [low - 0.04, low],
            [-half[1], half[1]],
            metal,
        );
        let (x, n) = (half[0] - 0.02, half[1] - 0.02);
        b.solid(
            &hang,
            [-x, x],
            [low - 0.06, low - 0.04],
            [-n, n],
            Texture::Lamp,
        );
    }
}

fn door(b: &mut Builder, at: &Basis, house: &House) {
    for x in [[0.0, 0.07], [0.93, 1.0]] {
        b.solid(at, x, [0.0, 2.1], [0.0, 0.035], house.trim);
    }
    b.solid(at, [0.07, 0.93], [2.03, 2.1], [0.0, 0.035], house.trim);
    b.solid(at, [0.07, 0.93], [0.0, 2.03], [0.0, 0.012], house.door);
    let (columns, rows) = house.panels;
    let (w, h) = (0.76 / columns as f64, 1.85 / rows as f64);
    for i in 0..columns * rows {
        let (x, y) = (
            0.12 + w * (i % columns) as f64,
            0.1 + h * (i / columns) as f64,
        );
        b.solid(
            at,
            [x + 0.04, x + w - 0.04],
            [y + 0.04, y + h - 0.04],
            [0.012, 0.026],
            house.door,
        );
    }
    let brass = Texture::Paint(srgb(0xB08D3F));
    b.solid(at, [0.84, 0.9], [0.98, 1.02], [0.012, 0.07], brass);
}

fn window(b: &mut Builder, dice: &mut Dice, at: &Basis, house: &House) {
    let [w, sill, top] = house.window;
    b.window(at, [0.06, w - 0.06], [sill, top]);
    if dice.unit() < 0.4 {
        let cloth = match dice.index(2) {
            0 => Texture::Fabric(color(dice)),
            _ => pattern(dice),
        };
        for x in [[-0.1, 0.2], [w - 0.2, w + 0.1]] {
            b.solid(at, x, [0.15, top + 0.12], [0.17, 0.21], cloth);
        }
    } else if dice.unit() < 0.5 && sill > 0.6 {
        radiator(b, &at.moved(0.1, 0.0, 0.0), w - 0.2, sill - 0.15);
    }
}

fn radiator(b: &mut Builder, at: &Basis, w: f64, top: f64) {
    let white = Texture::Paint(srgb(0xE7E5DF));
    for i in 0..(w / 0.075) as usize {
        let x = 0.075 * i as f64;
        b.solid(at, [x, x + 0.052], [0.15, top], [0.04, 0.13], white);
    }
}

/// Pictures in a band of a wall, one beside the other.
fn pictures(b: &mut Builder, dice: &mut Dice, at: &Basis, w: f64, [low, high]: Span) {
    let mut x = dice.range(0.0, 0.2);
    loop {
        let size = [dice.range(0.25, 0.9), dice.range(0.3, 0.95)];
        let height = size[1].min(high - low);
        if x + size[0] > w || height < 0.2 {
            return;
        }
        let y = dice.range(low, high - height);
        let bar = dice.range(0.008, 0.05);
        let frame = match dice.index(2) {
            0 => Texture::Paint(color(dice)),
            _ => Texture::WoodUp(wood(dice)),
        };
        let print = Texture::Print(dice.index(usize::from(STYLES)) as u8);
        b.framed(at, [x, x + size[0]], [y, y + height], bar, frame, print);
        x += size[0] + dice.range(0.03, 0.4);
    }
}

/// Boxes, books and papers on a board.
fn clutter(b: &mut Builder, dice: &mut Dice, at: &Basis, w: f64, depth: f64) {
    let mut x = dice.range(0.02, 0.2);
    while x + 0.45 < w {
        let width = dice.range(0.08, 0.4);
        let here = at.moved(x, 0.0, 0.0);
        match dice.index(4) {
            0 => b.books(&here, [0.0, width], 0.0, 0.28, depth.min(0.26)),
            1 => {
                let turned = here.moved(0.0, 0.0, 0.05).turned(dice.range(-20.0, 20.0));
                let skin = Skin {
                    front: Texture::Pages,
                    side: Texture::Pages,
                    top: Texture::Print(dice.index(usize::from(STYLES)) as u8),
                };
                let back = (0.8 * depth).min(0.3);
                b.solid(&turned, [0.0, width], [0.0, 0.02], [0.0, back], skin);
            }
            2 => {
                let skin = match dice.index(2) {
                    0 => Texture::Paint(color(dice)),
                    _ => pattern(dice),
                };
                let top = dice.range(0.08, 0.35);
                b.solid(
                    &here,
                    [0.0, width],
                    [0.0, top],
                    [0.03, 0.7 * depth.min(0.4)],
                    skin,
                );
            }
            _ => {}
        }
        x += width + dice.range(0.02, 0.3);
    }
}

fn piece(b: &mut Builder, dice: &mut Dice, at: &Basis, kind: Kind, w: f64, room_height: f64) {
    let tall = room_height - 0.3;
    let above = room_height - 0.25;
    match kind {
        Kind::Bookcase => {
            let h = dice.range(0.7, tall);
            let rows = ((h / dice.range(0.28, 0.42)) as usize).max(1);
            bookcase(b, at, w, h, dice.range(0.24, 0.36), rows, wood(dice));
            pictures(b, dice, at, w, [h + 0.15, above]);
        }
        Kind::Shelves => {
            let (board, gap) = (Texture::WoodAlong(wood(dice)), dice.range(0.32, 0.55));
            let mut y = dice.range(0.3, 1.0);
            while y + gap < above {
                b.solid(at, [0.0, w], [y, y + 0.03], [0.0, 0.26], board);
                clutter(b, dice, &at.moved(0.0, y + 0.03, 0.0), w, 0.26);
                y += gap;
            }
        }
        Kind::Sideboard | Kind::Wardrobe => {
            let is_tall = kind == Kind::Wardrobe;
            let h = if is_tall {
                dice.range(1.6, tall)
            } else {
                dice.range(0.5, 1.1)
            };
            let grid = (
                1 + dice.index(4),
                1 + dice.index(if is_tall { 2 } else { 3 }),
            );
            let skin = match dice.index(3) {
                0 => Texture::Paint(color(dice)),
                1 => Texture::WoodUp(wood(dice)),
                _ => Texture::WoodAlong(wood(dice)),
            };
            let depth = dice.range(0.35, 0.6);
            b.cabinet(at, w, [0.06, h], depth, grid, skin);
            if !is_tall {
                clutter(b, dice, &at.moved(0.0, h, 0.0), w, depth);
            }
            pictures(b, dice, at, w, [h + 0.3, above]);
        }
        Kind::Desk => {
            let (depth, high) = (dice.range(0.6, 0.8), dice.range(0.7, 0.8));
            b.table(at, w, depth, high, wood(dice));
            let top = at.moved(0.0, high, 0.0);
            clutter(b, dice, &top, w, 0.5 * depth);
            let screen = top.moved(dice.range(0.1, 0.5 * w), 0.0, 0.25);
            let black = Texture::Paint(srgb(0x25262A));
            let (sw, sh) = (dice.range(0.35, 0.6), dice.range(0.25, 0.4));
            let lid = Skin {
                front: Texture::Screen,
                side: black,
                top: black,
            };
            b.solid(&screen, [0.0, sw], [0.08, 0.08 + sh], [0.0, 0.03], lid);
            let chair = at.moved(dice.range(0.5, w), 0.0, depth + 0.55);
            b.chair(
                &chair.turned(dice.range(140.0, 220.0)),
                wood(dice),
                color(dice),
            );
            pictures(b, dice, at, w, [1.35, above]);
        }
        Kind::Kitchen => {
            let doors = Texture::Paint(color(dice));
            let columns = 2 + dice.index(4);
            b.cabinet(
                at,
                w,
                [0.1, 0.86],
                0.58,
                (columns, 1 + dice.index(3)),
                doors,
            );
            let top = Texture::WoodAlong(wood(dice));
            b.solid(at, [0.0, w], [0.86, 0.9], [0.0, 0.62], top);
            let tiles = match dice.index(3) {
                0 => Texture::Tiles,
                _ => pattern(dice),
            };
            b.sheet(at, [0.0, w], [0.9, 1.5], 0.006, tiles);
            clutter(b, dice, &at.moved(0.0, 0.9, 0.0), w, 0.4);
            let part = w * dice.range(0.3, 1.0);
            let upper = Texture::Paint(color(dice));
            b.cabinet(at, part, [1.52, 2.15], 0.34, (1 + dice.index(4), 1), upper);
        }
        Kind::Sofa | Kind::Bed => {
            let (depth, back) = match kind {
                Kind::Sofa => (0.85, dice.range(0.6, 1.0)),
                _ => (2.0, dice.range(0.5, 1.2)),
            };
            let cloth = match dice.index(3) {
                0 => pattern(dice),
                _ => Texture::Fabric(color(dice)),
            };
            b.solid(at, [0.0, w], [0.1, 0.45], [0.0, depth], cloth);
            b.solid(at, [0.0, w], [0.3, back], [0.0, 0.2], cloth);
            let mut x = dice.range(0.1, 0.5);
            while x + 0.45 < w {
                let skin = match dice.index(2) {
                    0 => pattern(dice),
                    _ => Texture::Fabric(color(dice)),
                };
                let turned = at.moved(x, 0.45, 0.22).turned(dice.range(-10.0, 10.0));
                b.solid(&turned, [0.0, 0.4], [0.0, 0.38], [0.0, 0.12], skin);
                x += dice.range(0.45, 0.9);
            }
            pictures(b, dice, at, w, [back + 0.25, above]);
        }
        Kind::Gallery => {
            let middle = dice.range(1.2, 1.5);
            pictures(b, dice, at, w, [0.6, middle]);
            pictures(b, dice, at, w, [middle + 0.03, above]);
        }
        Kind::Poster => {
            let print = Texture::Print(dice.index(usize::from(STYLES)) as u8);
            let high = dice.range(0.8, 1.6).min(above - 0.5);
            let y = dice.range(0.45, above - high);
            let frame = Texture::Paint(color(dice));
            let bar = dice.range(0.005, 0.03);
            b.framed(at, [0.0, w], [y, y + high], bar, frame, print);
        }
        Kind::Board => {
            let inside = match dice.index(2) {
                0 => Texture::Cork,
                _ => Texture::Blackboard,
            };
            let y = dice.range(0.8, 1.1);
            let high = y + dice.range(0.6, 1.1);
            let frame = Texture::WoodAlong(wood(dice));
            b.framed(at, [0.0, w], [y, high], 0.03, frame, inside);
        }
        Kind::Radiator => {
            radiator(b, at, w, dice.range(0.5, 0.9));
            pictures(b, dice, at, w, [1.1, above]);
        }
        Kind::Crates => {
            let boards = Texture::WoodAlong(wood(dice));
            for i in 0..1 + dice.index(4) {
                let turned = at.moved(0.03, 0.0, 0.06).turned(dice.range(-8.0, 8.0));
                for slat in 0..3 {
                    let y = 0.27 * i as f64 + 0.01 + 0.085 * f64::from(slat);
                    b.solid(&turned, [0.0, 0.44], [y, y + 0.07], [0.0, 0.3], boards);
                }
            }
        }
        Kind::Fireplace => {
            let stone = match dice.index(2) {
                0 => Texture::Brick,
                _ => Texture::Plaster(color(dice)),
            };
            let high = dice.range(0.9, 1.25);
            b.solid(at, [0.0, w], [0.0, high], [0.0, 0.25], stone);
            b.solid(at, [0.0, w], [high, room_height], [0.0, 0.15], stone);
            let black = Texture::Paint(srgb(0x1A1817));
            b.sheet(at, [0.25, w - 0.25], [0.1, 0.7], 0.256, black);
            let shelf = Texture::WoodAlong(wood(dice));
            b.solid(
                at,
                [-0.05, w + 0.05],
                [high, high + 0.05],
                [0.0, 0.32],
                shelf,
            );
            clutter(b, dice, &at.moved(0.0, high + 0.05, 0.12), w, 0.18);
            pictures(b, dice, &at.moved(0.0, 0.0, 0.15), w, [high + 0.3, above]);
        }
        Kind::Chairs => {
            let (frame, seat) = (wood(dice), color(dice));
            let mut x = 0.05;
            while x + 0.45 < w {
                b.chair(&at.moved(x, 0.0, 0.05), frame, seat);
                x += 0.55;
            }
            pictures(b, dice, at, w, [1.2, above]);
        }
    }
}

fn middle(b: &mut Builder, dice: &mut Dice, [w, d]: [f64; 2]) {
    let at = |dice: &mut Dice| {
        let (x, y) = (w * dice.range(0.3, 0.6), d * dice.range(0.4, 0.65));
        Basis::standing(x, y, dice.range(-90.0, 90.0))
    };
    if dice.unit() < 0.6 {
        let top = match dice.index(2) {
            0 => Texture::Rug,
            _ => pattern(dice),
        };
        let edge = Texture::Fabric(color(dice));
        let skin = Skin {
            front: edge,
            side: edge,
            top,
        };
        let size = [dice.range(1.2, 2.6), dice.range(0.9, 1.8)];
        let rug = Basis::standing(w * 0.3, d * 0.65, dice.range(-12.0, 12.0));
        b.solid(&rug, [0.0, size[0]], [0.0, 0.01], [0.0, size[1]], skin);
    }
    for _ in 0..dice.index(3) {
        let table = at(dice);
        let size = [dice.range(0.6, 1.5), dice.range(0.5, 0.9)];
        let high = dice.range(0.4, 0.78);
        b.table(&table, size[0], size[1], high, wood(dice));
        clutter(b, dice, &table.moved(0.0, high, 0.1), size[0], size[1]);
        let (frame, seat) = (wood(dice), color(dice));
        for _ in 0..dice.index(4) {
            let side = dice.range(0.0, size[0] - 0.2);
            let chair = match dice.index(2) {
                0 => table.moved(side, 0.0, -0.55),
                _ => table.moved(side + 0.4, 0.0, size[1] + 0.6).turned(180.0),
            };
            b.chair(&chair.turned(dice.range(-15.0, 15.0)), frame, seat);
        }
    }
}
