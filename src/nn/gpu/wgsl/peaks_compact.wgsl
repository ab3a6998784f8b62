// Gathers the pixels with a positive score in the order of rows, in three calls: count each block of 256 (mode 0), sum over
// the blocks in one workgroup (mode 1), write pixel number and score (mode 2).
var<workgroup> partial: array<u32, 256>;

// Inclusive sum over the workgroup.
fn scan(lane: u32, value: u32) -> u32 {
    partial[lane] = value;
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
        var add = 0u;
        if lane >= step { add = partial[lane - step]; }
        workgroupBarrier();
        partial[lane] += add;
        workgroupBarrier();
    }
    return partial[lane];
}

@compute @workgroup_size(256, 1, 1)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if p.mode == 1u {
        // Block numbers are exact in f32: there are fewer than 2^24.
        var before = 0u;
        for (var first = 0u; first < p.blocks; first += 256u) {
            let block = first + lane;
            var count = 0u;
            if block < p.blocks { count = u32(arena[p.blocks_offset + block]); }
            let sum = scan(lane, count);
            if block < p.blocks { arena[p.blocks_offset + block] = f32(before + sum - count); }
            before += partial[255];
            workgroupBarrier();
        }
        if lane == 0u { counts[p.candidates_count] = before; }
        return;
    }
    let pixel = group.x * 256u + lane;
    var score = 0.0;
    if pixel < p.pixels { score = arena[p.scores_offset + pixel]; }
    let flag = select(0u, 1u, score > 0.0);
    let sum = scan(lane, flag);
    if p.mode == 0u {
        if lane == 255u { arena[p.blocks_offset + group.x] = f32(sum); }
    } else if flag != 0u {
        let at = p.candidates_offset + 2u * (u32(arena[p.blocks_offset + group.x]) + sum - 1u);
        arena[at] = f32(pixel);
        arena[at + 1u] = score;
    }
}
