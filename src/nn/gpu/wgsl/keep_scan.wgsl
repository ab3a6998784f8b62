// Rows whose logit is greater than a bound, in their order: a prefix sum in one workgroup, so that the order never depends
// on timing. Writes each kept row's number and the new count; keep_gather.wgsl moves the rows.
var<workgroup> partial: array<u32, 256>;

@compute @workgroup_size(256, 1, 1)
fn main(@builtin(local_invocation_index) lane: u32) {
    let rows = rows_of(p.rows_count, p.rows_per);
    var kept = 0u;
    for (var row0 = 0u; row0 < p.rows_capacity; row0 += 256u) {
        let row = row0 + lane;
        var flag = 0u;
        if row < rows { flag = select(0u, 1u, arena[p.l_offset + row * p.l_stride] > p.min_logit); }
        partial[lane] = flag;
        workgroupBarrier();
        for (var step = 1u; step < 256u; step *= 2u) {
            var add = 0u;
            if lane >= step { add = partial[lane - step]; }
            workgroupBarrier();
            partial[lane] += add;
            workgroupBarrier();
        }
        if flag != 0u { arena[p.i_offset + (kept + partial[lane] - 1u) * p.i_stride] = f32(row); }
        kept += partial[255];
        workgroupBarrier();
    }
    if lane == 0u { counts[p.kept_count] = kept; }
}
