//! Furnishing: what stands where.

use super::alike::Vary;
use super::color::{Rgb, srgb};
use super::noise::Dice;
use super::pieces::{Basis, Builder, Skin};
use super::prints::STYLES;
use super::texture::Texture;
use super::trace::Quad;
use super::{Edge, Room};
use nalgebra::Vector3;

/// Result of furnishing.
pub(super) struct Built {
    pub(super) quads: Vec<Quad>,
    pub(super) textures: Vec<Texture>,
    pub(super) edges: Vec<Edge>,
}

/// Everything in the room.
pub(super) fn furnish(seed: u64, vary: Option<Vary>) -> Built {
    let mut b = Builder {
        quads: Vec::new(),
        textures: Vec::new(),
        edges: Vec::new(),
        dice: Dice::new(seed ^ 0x4C41_4E44),
        vary,
    };
    let [w, d, h] = Room::SIZE_M;
    let wall = |x: f64, y: f64, dx: f64, dy: f64| Basis {
        origin: Vector3::new(x, y, 0.0),
        x: Vector3::new(dx, dy, 0.0),
        y: Vector3::z(),
        n: Vector3::new(dy, -dx, 0.0),
    };
    let north = wall(0.0, d, 1.0, 0.0);
    let east = wall(w, d, 0.0, -1.0);
    let south = wall(w, 0.0, -1.0, 0.0);
    let west = wall(0.0, 0.0, 0.0, 1.0);
    shell(&mut b, &north, &east, &south, &west);
    let mut is_swapped = || b.vary.as_mut().is_some_and(Vary::is_swapped);
    let (long, short) = (is_swapped(), is_swapped());
    let [first, second] = if long {
        [&south, &north]
    } else {
        [&north, &south]
    };
    north_side(&mut b, first);
    let [third, fourth] = if short {
        [&west, &east]
    } else {
        [&east, &west]
    };
    east_side(&mut b, third);
    south_side(&mut b, second);
    west_side(&mut b, fourth);
    middle(&mut b);
    debug_assert!(h > 2.0);
    Built {
        quads: b.quads,
        textures: b.textures,
        edges: b.edges,
    }
}

fn shell(b: &mut Builder, north: &Basis, east: &Basis, south: &Basis, west: &Basis) {
    let [w, d, h] = Room::SIZE_M;
    b.quad(
        Vector3::zeros(),
        w * Vector3::x(),
        d * Vector3::y(),
        Texture::Boards,
    );
    b.quad(
        Vector3::new(0.0, d, h),
        w * Vector3::x(),
        -d * Vector3::y(),
        Texture::Plaster(srgb(0xE8E3D6)),
    );
    let skirting = Texture::Paint(srgb(0xE4DFD2));
    for (wall, length, texture) in [
        (north, w, Texture::Brick),
        (east, d, Texture::Plaster(srgb(0xD9CDB4))),
        (south, w, Texture::Plaster(srgb(0xC9CFC0))),
        (west, d, Texture::Plaster(srgb(0x5F7F8C))),
    ] {
        b.sheet(wall, [0.0, length], [0.0, h], 0.0, texture);
        b.solid(wall, [0.0, length], [0.0, 0.09], [0.0, 0.016], skirting);
    }
    let beam = Texture::WoodAlong(srgb(0x6B452B));
    let along_y = Basis::standing(0.0, 0.0, 90.0);
    for x in [0.9, 2.3, 3.7, 5.1] {
        b.solid(
            &along_y,
            [0.0, d],
            [h - 0.17, h],
            [x - 0.07, x + 0.07],
            beam,
        );
    }
    let metal = Texture::Paint(srgb(0x33353A));
    for (x, y) in [(1.6, 2.5), (4.4, 2.5)] {
        let hang = Basis::standing(x, y, 0.0);
        for s in [-0.4, 0.4] {
            b.solid(
                &hang,
                [s - 0.006, s + 0.006],
                [2.5, h],
                [-0.006, 0.006],
                metal,
            );
        }
        b.solid(&hang, [-0.55, 0.55], [2.46, 2.5], [-0.11, 0.11], metal);
        b.solid(
            &hang,
            [-0.53, 0.53],
            [2.44, 2.46],
            [-0.09, 0.09],
            Texture::Lamp,
        );
    }
}

pub(super) fn bookcase(
    b: &mut Builder,
    at: &Basis,
    w: f64,
    h: f64,
    depth: f64,
    rows: usize,
    color: Rgb,
) {
    let (up, along) = (Texture::WoodUp(color), Texture::WoodAlong(color));
    let board = 0.028;
    b.solid(at, [0.0, board], [0.0, h], [0.0, depth], up);
    b.solid(at, [w - board, w], [0.0, h], [0.0, depth], up);
    let middle = 0.5 * w;
    b.solid(
        at,
        [middle - 0.5 * board, middle + 0.5 * board],
        [0.08, h - board],
        [0.0, depth - 0.01],
        up,
    );
    b.sheet(
        at,
        [board, w - board],
        [0.05, h],
        0.012,
        Texture::WoodUp([0.12, 0.07, 0.04]),
    );
    let step = (h - 0.08 - board) / rows as f64;
    for row in 0..=rows {
        let y = 0.08 + step * row as f64;
        b.solid(
            at,
            [board, w - board],
            [y, y + board],
            [0.0, depth - 0.004],
            along,
        );
        if row == rows {
            break;
        }
        for (x0, x1) in [
            (board, middle - 0.5 * board),
            (middle + 0.5 * board, w - board),
        ] {
            let end = if b.dice.unit() > 0.6 {
                x0 + 0.72 * (x1 - x0)
            } else {
                x1
            };
            b.books(at, [x0, end], y + board, step - board - 0.015, depth);
            if end < x1 {
                let (cx, size) = (0.5 * (end + x1), 0.35 * (x1 - end));
                let box_color =
                    Texture::Paint(srgb([0xD8A24A, 0x3E7C7B, 0xB8473F][b.dice.index(3)]));
                b.solid(
                    at,
                    [cx - size, cx + size],
                    [y + board, y + board + 0.6 * step],
                    [0.06, depth - 0.05],
                    box_color,
                );
            }
        }
    }
}

fn north_side(b: &mut Builder, wall: &Basis) {
    let case = b.placed(wall.moved(0.45, 0.0, 0.0), 0.2, 0.0);
    bookcase(b, &case, 1.7, 2.15, 0.30, 6, srgb(0x8A5A34));
    let board = b.placed(wall.moved(2.6, 0.0, 0.0), 0.15, 0.0);
    b.cabinet(
        &board,
        1.7,
        [0.10, 0.78],
        0.42,
        (3, 2),
        Texture::WoodAlong(srgb(0xA9713F)),
    );
    let foot = Texture::Paint(srgb(0x2C2A29));
    b.solid(&board, [0.05, 1.65], [0.0, 0.10], [0.05, 0.36], foot);
    b.books(&board, [0.08, 0.62], 0.78, 0.26, 0.26);
    b.framed(
        &board.moved(1.16, 0.78, 0.20).turned(-12.0),
        [-0.15, 0.15],
        [0.0, 0.36],
        0.02,
        Texture::Paint(srgb(0x222326)),
        Texture::Print(3),
    );
    for (i, x) in [0.05, 0.62, 1.19].into_iter().enumerate() {
        let frame = Texture::WoodUp(srgb([0x2A2320, 0xB98A4E, 0x2A2320][i]));
        b.framed(
            &board,
            [x, x + 0.48],
            [1.22, 1.88],
            0.028,
            frame,
            Texture::Print([1, 6, 0][i]),
        );
    }
    let shelves = b.placed(wall.moved(4.6, 0.0, 0.0), 0.12, 0.0);
    for (row, y) in [0.55, 0.95, 1.35, 1.75].into_iter().enumerate() {
        b.solid(
            &shelves,
            [0.0, 1.15],
            [y, y + 0.03],
            [0.0, 0.26],
            Texture::WoodAlong(srgb(0xC79B66)),
        );
        for x in [0.12, 1.0] {
            b.solid(
                &shelves,
                [x, x + 0.03],
                [y - 0.14, y],
                [0.0, 0.2],
                Texture::Paint(srgb(0x2B2B2E)),
            );
        }
        let split = [0.62, 0.4, 0.75, 0.5][row];
        b.books(&shelves, [0.04, split], y + 0.03, 0.30, 0.24);
        let crate_wood = Texture::WoodAlong(srgb([0x7A9E9F, 0xC65D3B, 0xE0B04A, 0x4F6D7A][row]));
        b.solid(
            &shelves,
            [split + 0.1, split + 0.32],
            [y + 0.03, y + 0.2],
            [0.03, 0.2],
            crate_wood,
        );
    }
}

fn east_side(b: &mut Builder, wall: &Basis) {
    b.window(wall, [0.65, 2.15], [0.95, 2.35]);
    b.window(wall, [2.75, 4.25], [0.95, 2.35]);
    let radiator = Texture::Paint(srgb(0xE7E5DF));
    for i in 0..18 {
        let x = 0.75 + 0.075 * f64::from(i);
        b.solid(wall, [x, x + 0.052], [0.18, 0.78], [0.04, 0.13], radiator);
    }
    b.solid(wall, [0.73, 2.10], [0.70, 0.74], [0.05, 0.12], radiator);
    b.framed(
        wall,
        [2.24, 2.66],
        [1.35, 1.95],
        0.022,
        Texture::Paint(srgb(0x7A2E2E)),
        Texture::Print(8),
    );
    let desk = b.placed(wall.moved(2.6, 0.0, 0.04), 0.4, 0.0);
    b.table(&desk, 1.75, 0.72, 0.75, srgb(0xB5834F));
    let laptop = desk.moved(0.75, 0.75, 0.30).turned(12.0);
    let metal = Texture::Paint(srgb(0xA9ADB3));
    let deck = Skin {
        front: metal,
        side: metal,
        top: Texture::Keys,
    };
    b.solid(&laptop, [0.0, 0.36], [0.0, 0.016], [0.0, 0.25], deck);
    let lid = Skin {
        front: Texture::Screen,
        side: metal,
        top: metal,
    };
    b.solid(&laptop, [0.0, 0.36], [0.016, 0.25], [-0.012, 0.0], lid);
    b.books(&desk, [0.06, 0.5], 0.75, 0.25, 0.24);
    b.solid(
        &desk.moved(1.35, 0.75, 0.35).turned(-24.0),
        [0.0, 0.24],
        [0.0, 0.045],
        [0.0, 0.17],
        Texture::Paint(srgb(0xB5442F)),
    );
    b.solid(
        &desk.moved(1.36, 0.795, 0.36).turned(8.0),
        [0.0, 0.21],
        [0.0, 0.035],
        [0.0, 0.15],
        Texture::Paint(srgb(0x2F5D73)),
    );
    b.chair(
        &desk.moved(1.1, 0.0, 1.28).turned(170.0),
        srgb(0x5A3A24),
        srgb(0x3F6B5C),
    );
    b.framed(
        wall,
        [4.38, 4.86],
        [1.25, 1.9],
        0.024,
        Texture::WoodUp(srgb(0x3A2A20)),
        Texture::Print(5),
    );
}

fn south_side(b: &mut Builder, wall: &Basis) {
    let paint = Texture::Paint(srgb(0x8A9A86));
    let trim = Texture::Paint(srgb(0xEDE8DC));
    b.solid(wall, [0.42, 0.50], [0.0, 2.12], [0.0, 0.035], trim);
    b.solid(wall, [1.40, 1.48], [0.0, 2.12], [0.0, 0.035], trim);
    b.solid(wall, [0.50, 1.40], [2.05, 2.12], [0.0, 0.035], trim);
    b.solid(wall, [0.50, 1.40], [0.0, 2.05], [0.0, 0.012], paint);
    for (x0, x1) in [(0.60, 0.91), (0.99, 1.30)] {
        for (y0, y1) in [(0.18, 0.82), (0.98, 1.52), (1.64, 1.94)] {
            b.solid(wall, [x0, x1], [y0, y1], [0.012, 0.026], paint);
        }
    }
    b.solid(
        wall,
        [1.30, 1.36],
        [0.98, 1.02],
        [0.012, 0.07],
        Texture::Paint(srgb(0xB08D3F)),
    );
    b.framed(
        wall,
        [1.72, 2.92],
        [1.12, 1.92],
        0.03,
        Texture::WoodAlong(srgb(0x9C6B3C)),
        Texture::Cork,
    );
    b.solid(
        wall,
        [1.78, 2.86],
        [0.58, 0.61],
        [0.0, 0.24],
        Texture::WoodAlong(srgb(0x9C6B3C)),
    );
    b.books(wall, [1.84, 2.5], 0.61, 0.27, 0.22);
    let kitchen = b.placed(wall.moved(3.25, 0.0, 0.0), 0.2, 0.0);
    b.cabinet(
        &kitchen,
        2.45,
        [0.10, 0.86],
        0.58,
        (4, 2),
        Texture::Paint(srgb(0x37586B)),
    );
    b.solid(
        &kitchen,
        [-0.02, 2.47],
        [0.86, 0.90],
        [0.0, 0.63],
        Texture::WoodAlong(srgb(0xB98A58)),
    );
    b.sheet(&kitchen, [0.0, 2.45], [0.90, 1.50], 0.006, Texture::Tiles);
    b.cabinet(
        &kitchen,
        1.5,
        [1.52, 2.2],
        0.34,
        (3, 1),
        Texture::Paint(srgb(0xDAD6C8)),
    );
    b.solid(
        &kitchen,
        [1.55, 2.43],
        [1.58, 1.61],
        [0.0, 0.22],
        Texture::WoodAlong(srgb(0xB98A58)),
    );
    for i in 0..6 {
        let x = 1.60 + 0.135 * f64::from(i);
        let height = b.dice.range(0.10, 0.2);
        let color = srgb([0xD9A441, 0x8F3B2E, 0xE8E2D0, 0x3D6B5A, 0x5B4A6E, 0xC7B299][i as usize]);
        b.solid(
            &kitchen,
            [x, x + 0.09],
            [1.61, 1.61 + height],
            [0.05, 0.14],
            Texture::Paint(color),
        );
    }
    let oven = Texture::Paint(srgb(0x25262A));
    b.solid(&kitchen, [0.3, 0.78], [0.90, 1.17], [0.08, 0.42], oven);
    b.solid(
        &kitchen,
        [0.33, 0.62],
        [0.94, 1.13],
        [0.42, 0.426],
        Texture::Paint(srgb(0x5A6C77)),
    );
    b.solid(
        &kitchen.moved(1.15, 0.90, 0.3).turned(20.0),
        [0.0, 0.34],
        [0.0, 0.02],
        [0.0, 0.22],
        Texture::WoodAlong(srgb(0xD2A46B)),
    );
    b.framed(
        &kitchen,
        [1.72, 2.26],
        [1.90, 2.4],
        0.022,
        Texture::Paint(srgb(0x303236)),
        Texture::Print(9),
    );
}

fn west_side(b: &mut Builder, wall: &Basis) {
    let sofa = b.placed(wall.moved(1.1, 0.0, 0.03), 0.4, 0.0);
    let cloth = Texture::Fabric(srgb(0xB8654A));
    let cushion = Texture::Fabric(srgb(0xD7B98C));
    b.solid(&sofa, [0.0, 2.1], [0.10, 0.30], [0.0, 0.85], cloth);
    b.solid(&sofa, [0.0, 2.1], [0.30, 0.82], [0.0, 0.2], cloth);
    for x in [0.0, 1.92] {
        b.solid(&sofa, [x, x + 0.18], [0.30, 0.60], [0.2, 0.85], cloth);
    }
    for i in 0..3 {
        let x = 0.19 + 0.577 * f64::from(i);
        b.solid(&sofa, [x, x + 0.566], [0.30, 0.45], [0.2, 0.86], cloth);
    }
    for (x, turn) in [(0.28, 9.0), (1.35, -7.0)] {
        b.solid(
            &sofa.moved(x, 0.45, 0.24).turned(turn),
            [0.0, 0.42],
            [0.0, 0.4],
            [0.0, 0.12],
            cushion,
        );
    }
    let frames = [0x1F1F22, 0xC49A55, 0xEDE7D8, 0x5B3A29];
    let hang: [(f64, f64, f64, f64, u8); 9] = [
        (0.95, 1.08, 0.50, 0.66, 5),
        (0.95, 1.80, 0.50, 0.40, 9),
        (1.52, 1.08, 0.78, 0.54, 4),
        (1.52, 1.68, 0.36, 0.52, 2),
        (1.94, 1.68, 0.36, 0.52, 7),
        (2.37, 1.08, 0.44, 0.60, 0),
        (2.37, 1.74, 0.44, 0.46, 3),
        (2.87, 1.08, 0.40, 0.54, 8),
        (2.87, 1.68, 0.52, 0.52, 1),
    ];
    for (i, (x, y, w, h, style)) in hang.into_iter().enumerate() {
        let frame = Texture::Paint(srgb(frames[i % frames.len()]));
        b.framed(
            wall,
            [x, x + w],
            [y, y + h],
            0.024,
            frame,
            Texture::Print(style % STYLES),
        );
    }
    b.framed(
        wall,
        [3.62, 4.72],
        [1.0, 1.78],
        0.035,
        Texture::WoodAlong(srgb(0xA67843)),
        Texture::Blackboard,
    );
    b.solid(
        wall,
        [3.66, 4.68],
        [0.97, 1.0],
        [0.0, 0.07],
        Texture::WoodAlong(srgb(0xA67843)),
    );
    b.framed(
        wall,
        [4.0, 4.34],
        [1.98, 2.32],
        0.012,
        Texture::Paint(srgb(0x2A2A2E)),
        Texture::Clock,
    );
    let low = b.placed(wall.moved(3.66, 0.0, 0.0), 0.2, 0.0);
    bookcase(b, &low, 1.05, 0.82, 0.28, 2, srgb(0x6E4A2E));
    b.framed(
        &wall.moved(0.22, 0.0, 0.0),
        [0.0, 0.52],
        [1.15, 1.85],
        0.026,
        Texture::WoodUp(srgb(0xB98A4E)),
        Texture::Print(6),
    );
    let stack = Basis::standing(0.32, 0.62, 62.0);
    let boards = Texture::WoodAlong(srgb(0xC29A66));
    for i in 0..3 {
        let y = 0.27 * f64::from(i);
        let turned = stack.turned(11.0 * f64::from(i));
        for slat in 0..3 {
            let at = y + 0.01 + 0.085 * f64::from(slat);
            b.solid(&turned, [0.0, 0.44], [at, at + 0.07], [0.0, 0.30], boards);
        }
    }
}

fn middle(b: &mut Builder) {
    // A rug is a box of one centimetre: textures of the top lie with s along x and t towards -n.
    let rug = b.placed(Basis::standing(1.55, 3.55, 0.0), 0.3, 10.0);
    let edge = Texture::Fabric(srgb(0x25405F));
    let skin = Skin {
        front: edge,
        side: edge,
        top: Texture::Rug,
    };
    b.solid(&rug, [0.0, 2.7], [0.0, 0.01], [0.0, 1.95], skin);
    let table = b.placed(Basis::standing(2.35, 2.95, -14.0), 0.35, 35.0);
    b.table(&table, 1.25, 0.78, 0.74, srgb(0x9A5F33));
    let mut pile = 0.74;
    for (color, turn) in [
        (0x2B4C6F, 10.0),
        (0xC98B2B, -14.0),
        (0xE4DCC7, 24.0),
        (0x7B2D26, 3.0),
    ] {
        let thick = b.dice.range(0.022, 0.042);
        let book = table.moved(0.22, 0.0, 0.25).turned(turn);
        let cover = Texture::Paint(srgb(color));
        let skin = Skin {
            front: Texture::Pages,
            side: cover,
            top: cover,
        };
        b.solid(&book, [0.0, 0.2], [pile, pile + thick], [0.0, 0.27], skin);
        pile += thick;
    }
    let magazine = Skin {
        front: Texture::Pages,
        side: Texture::Pages,
        top: Texture::Print(0),
    };
    b.solid(
        &table.moved(0.66, 0.74, 0.36).turned(-31.0),
        [0.0, 0.22],
        [0.0, 0.008],
        [0.0, 0.29],
        magazine,
    );
    let game = Skin {
        front: Texture::WoodAlong(srgb(0x5A3A24)),
        side: Texture::WoodAlong(srgb(0x5A3A24)),
        top: Texture::Print(9),
    };
    b.solid(
        &table.moved(0.78, 0.74, 0.06).turned(17.0),
        [0.0, 0.27],
        [0.0, 0.03],
        [0.0, 0.27],
        game,
    );
    b.chair(
        &table.moved(0.45, 0.0, -0.55).turned(-8.0),
        srgb(0x7A4A28),
        srgb(0xC7A34B),
    );
    b.chair(
        &table.moved(0.95, 0.0, 1.30).turned(172.0),
        srgb(0x7A4A28),
        srgb(0x8A3B3B),
    );
}
