// Local maxima of a keypoint map, one thread a pixel, in one of five modes:
// 0: mark what no pixel of the window exceeds.
// 1: hide (-1) what has a mark in its window, copy the map elsewhere.
// 2: add marks where what is not hidden is not exceeded by its window either.
// 3: score of the marked pixels above the threshold and away from the border; zero elsewhere.
// 4: 0 and 3 in one, without marks, times the reliability read between its cells.
// Modes 0 1 2 1 2 3 are SuperPoint's three-pass suppression, mode 4 is XFeat's.
fn cell(x: f32, y: f32) -> f32 {
    if x < 0.0 || y < 0.0 || x >= f32(p.cells_x) || y >= f32(p.cells_y) { return 0.0; }
    return arena[p.r_offset + (u32(y) * p.cells_x + u32(x)) * p.r_stride];
}

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= p.width || id.y >= p.height { return; }
    let pixel = id.y * p.width + id.x;
    let x0 = id.x - min(id.x, p.radius);
    let x1 = min(id.x + p.radius, p.width - 1u);
    let y0 = id.y - min(id.y, p.radius);
    let y1 = min(id.y + p.radius, p.height - 1u);
    let heat = arena[p.heat_offset + pixel];
    if p.mode == 1u {
        var marks = 0.0;
        for (var y = y0; y <= y1; y += 1u) {
            for (var x = x0; x <= x1; x += 1u) { marks = max(marks, arena[p.marks_offset + y * p.width + x]); }
        }
        arena[p.hidden_offset + pixel] = select(heat, -1.0, marks > 0.0);
        return;
    }
    if p.mode == 3u {
        let inside = id.x >= p.border && id.y >= p.border && id.x + p.border < p.width && id.y + p.border < p.height;
        let chosen = inside && heat > p.min_heat && arena[p.marks_offset + pixel] > 0.0;
        arena[p.scores_offset + pixel] = select(0.0, heat, chosen);
        return;
    }
    if p.mode == 4u {
        // The last column and row never become keypoints, as in the reference.
        let inside = id.x >= p.border && id.y >= p.border
            && id.x + max(p.border, 1u) < p.width && id.y + max(p.border, 1u) < p.height;
        if !inside || heat <= p.min_heat {
            arena[p.scores_offset + pixel] = 0.0;
            return;
        }
    }
    let source = select(p.heat_offset, p.hidden_offset, p.mode == 2u);
    let own = arena[source + pixel];
    var largest = own;
    for (var y = y0; y <= y1; y += 1u) {
        for (var x = x0; x <= x1; x += 1u) { largest = max(largest, arena[source + y * p.width + x]); }
    }
    if p.mode == 0u {
        arena[p.marks_offset + pixel] = select(0.0, 1.0, own == largest);
    } else if p.mode == 2u {
        if own >= 0.0 && own == largest { arena[p.marks_offset + pixel] = 1.0; }
    } else {
        var score = 0.0;
        if own == largest {
            score = heat;
            if p.weighted != 0u {
                let fx = (f32(id.x) + 0.5) * p.scale_x + p.offset_x;
                let fy = (f32(id.y) + 0.5) * p.scale_y + p.offset_y;
                let cx = floor(fx);
                let cy = floor(fy);
                let ax = fx - cx;
                let ay = fy - cy;
                let top = cell(cx, cy) * (1.0 - ax) + cell(cx + 1.0, cy) * ax;
                let bottom = cell(cx, cy + 1.0) * (1.0 - ax) + cell(cx + 1.0, cy + 1.0) * ax;
                score *= top * (1.0 - ay) + bottom * ay;
            }
        }
        arena[p.scores_offset + pixel] = score;
    }
}
