// The best candidates by score, in the order in which they came; among equal scores the first ones. One workgroup: a radix
// selection over the bits of the scores (positive floats order as their bits do), then a prefix sum. Nothing depends on
// timing.
var<workgroup> bins: array<atomic<u32>, 256>;
var<workgroup> partial: array<u32, 256>;
var<workgroup> prefix: u32;
var<workgroup> wanted: u32;
var<workgroup> num_candidates: u32;

@compute @workgroup_size(256, 1, 1)
fn main(@builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        num_candidates = counts[p.candidates_count];
        prefix = 0u;
        wanted = min(num_candidates, p.capacity);
    }
    // Loaded so that every thread provably sees the same number: the loops below hold barriers.
    let n = workgroupUniformLoad(&num_candidates);
    // Eight bits at a time from the top: which bin holds the last wanted score, and how many of that bin are wanted.
    for (var shift = 32u; shift > 0u; shift -= 8u) {
        atomicStore(&bins[lane], 0u);
        workgroupBarrier();
        for (var i = lane; i < n; i += 256u) {
            let bits = bitcast<u32>(arena[p.candidates_offset + 2u * i + 1u]);
            var same = true;
            if shift < 32u { same = (bits >> shift) == (prefix >> shift); }
            if same { atomicAdd(&bins[(bits >> (shift - 8u)) & 255u], 1u); }
        }
        workgroupBarrier();
        if lane == 0u {
            var above = 0u;
            for (var b = 0u; b < 256u; b += 1u) {
                let bin = 255u - b;
                let here = atomicLoad(&bins[bin]);
                if above + here >= wanted || bin == 0u {
                    prefix |= bin << (shift - 8u);
                    wanted -= min(above, wanted);
                    break;
                }
                above += here;
            }
        }
        workgroupBarrier();
    }
    // Now `prefix` is the last wanted score and `wanted` the number of candidates with just that score to take.
    let last = prefix;
    let ties = wanted;
    workgroupBarrier();
    var taken = 0u;
    var tied = 0u;
    for (var first = 0u; first < n; first += 256u) {
        let i = first + lane;
        var bits = 0u;
        if i < n { bits = bitcast<u32>(arena[p.candidates_offset + 2u * i + 1u]); }
        // Ties in the low half, sure ones in the high half: one sum serves both (a block has 256).
        let is_tie = select(0u, 1u, i < n && bits == last);
        let is_sure = select(0u, 1u, i < n && bits > last);
        partial[lane] = is_tie | (is_sure << 16u);
        workgroupBarrier();
        for (var step = 1u; step < 256u; step *= 2u) {
            var add = 0u;
            if lane >= step { add = partial[lane - step]; }
            workgroupBarrier();
            partial[lane] += add;
            workgroupBarrier();
        }
        let sum_tie = partial[lane] & 0xffffu;
        let sum_sure = partial[lane] >> 16u;
        let take_tie = is_tie != 0u && tied + sum_tie <= ties;
        if is_sure != 0u || take_tie {
            let tie_before = min(tied + sum_tie - select(0u, 1u, take_tie), ties) - min(tied, ties);
            let slot = taken + tie_before + sum_sure - is_sure;
            if slot < p.capacity {
                let pixel = u32(arena[p.candidates_offset + 2u * i]);
                arena[p.positions_offset + 2u * slot] = (f32(pixel % p.width) + 0.5) * p.scale_x;
                arena[p.positions_offset + 2u * slot + 1u] = (f32(pixel / p.width) + 0.5) * p.scale_y;
                arena[p.chosen_offset + slot] = bitcast<f32>(bits);
            }
        }
        let all_tie = partial[255] & 0xffffu;
        taken += (partial[255] >> 16u) + min(tied + all_tie, ties) - min(tied, ties);
        tied += all_tie;
        workgroupBarrier();
    }
    if lane == 0u { counts[p.kept_count] = min(taken, p.capacity); }
}
