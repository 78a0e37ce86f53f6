// Points of a batch drawn from tables of light x BRDF x cosine over X, one per condition, as in the paper. A table has running sums along each row,
// and then those of the rows.

@group(0) @binding(5) var<storage, read_write> table: array<f32>;

const TABLE_CELLS: u32 = TABLE_ROWS * TABLE_COLUMNS;
const TABLE_NUMBERS: u32 = TABLE_CELLS + TABLE_ROWS;
const OWN_COLUMNS: u32 = TABLE_COLUMNS / 256u;
const OWN_ROWS: u32 = TABLE_ROWS / 256u;

var<workgroup> thread_sums: array<f32, 256>;

// The sum of the numbers of the threads up to this one.
fn running_sum(thread: u32, own: f32) -> f32 {
    thread_sums[thread] = own;
    for (var reach = 1u; reach < 256u; reach *= 2u) {
        workgroupBarrier();
        let before = select(0.0, thread_sums[max(thread, reach) - reach], thread >= reach);
        workgroupBarrier();
        thread_sums[thread] += before;
    }
    workgroupBarrier();
    return thread_sums[thread];
}

fn first_condition() -> u32 {
    return stream[5];
}

// A workgroup per row of a table.
@compute @workgroup_size(256)
fn tabulate(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let at = surface_of(first_condition() + group.y);
    let first = group.x * TABLE_COLUMNS + OWN_COLUMNS * thread;
    let v = (f32(group.x) + 0.5) / f32(TABLE_ROWS);
    var sums: array<f32, OWN_COLUMNS>;
    var sum = 0.0;
    for (var k = 0u; k < OWN_COLUMNS; k++) {
        let wi = headtail_direction(vec2<f32>((f32(OWN_COLUMNS * thread + k) + 0.5) / f32(TABLE_COLUMNS), v));
        sum += surface_reflected(at, wi.xyz) * headtail_float(HEADTAIL_LIGHT_CELLS + first + k);
        sums[k] = sum;
    }
    let end = running_sum(thread, sum);
    var before = 0.0;
    if (thread > 0u) { before = thread_sums[thread - 1u]; }
    let start = group.y * TABLE_NUMBERS;
    for (var k = 0u; k + 1u < OWN_COLUMNS; k++) { table[start + first + k] = min(before + sums[k], end); }
    table[start + first + OWN_COLUMNS - 1u] = end;
    if (thread == 255u) { table[start + TABLE_CELLS + group.x] = end; }
}

// A workgroup per table.
@compute @workgroup_size(256)
fn sum_rows(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let first = group.x * TABLE_NUMBERS + TABLE_CELLS + OWN_ROWS * thread;
    var sums: array<f32, OWN_ROWS>;
    var sum = 0.0;
    for (var k = 0u; k < OWN_ROWS; k++) {
        sum += table[first + k];
        sums[k] = sum;
    }
    let end = running_sum(thread, sum);
    var before = 0.0;
    if (thread > 0u) { before = thread_sums[thread - 1u]; }
    for (var k = 0u; k + 1u < OWN_ROWS; k++) { table[first + k] = min(before + sums[k], end); }
    table[first + OWN_ROWS - 1u] = end;
}

// The cell of running sums in which they pass u times their total, the position in it, and its probability relative to a uniform one.
struct Cell { index: u32, inside: f32, probability: f32 }

fn cell_of(start: u32, count: u32, u: f32) -> Cell {
    let total = table[start + count - 1u];
    let goal = u * total;
    var index = 0u;
    for (var size = count; size > 1u; size -= size / 2u) {
        if (table[start + index + size / 2u - 1u] <= goal) { index += size / 2u; }
    }
    let before = select(0.0, table[start + max(index, 1u) - 1u], index > 0u);
    let after = table[start + index];
    return Cell(index, headtail_remap(goal, before, after), (after - before) / total * f32(count));
}

// A thread per point.
@compute @workgroup_size(64)
fn place_tabulated(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let place = first_condition() * SAMPLES + id.y * groups.x * 64u + id.x;
    let condition = place / SAMPLES;
    let start = (condition - first_condition()) * TABLE_NUMBERS;
    if (place >= POINTS || start + TABLE_NUMBERS > arrayLength(&table)) { return; }
    let u = uniform_point(condition, place % SAMPLES);
    // Nothing is reflected.
    if (!(table[start + TABLE_NUMBERS - 1u] > 0.0)) {
        store_point(place, u, Values(u, 1.0, 0.0, 0.0), 1.0);
        return;
    }
    let row = cell_of(start + TABLE_CELLS, TABLE_ROWS, u.y);
    let column = cell_of(start + row.index * TABLE_COLUMNS, TABLE_COLUMNS, u.x);
    let x = vec2<f32>((f32(column.index) + column.inside) / f32(TABLE_COLUMNS), (f32(row.index) + row.inside) / f32(TABLE_ROWS));
    let back = headtail_pull_back(x);
    let y = clamp(back.xy, vec2<f32>(0.0), vec2<f32>(HEADTAIL_BELOW_ONE));
    let there = values_at(surface_of(condition), y);
    // Cells overlap texels without light, where points have no position in Y.
    var density = 0.0;
    if (back.z > 0.0) { density = row.probability * column.probability / back.z; }
    if (density > 0.0) {
        store_point(place, y, Values(there.x, back.z, density, there.brdf), 1.0 / density);
    } else {
        store_point(place, y, Values(there.x, 1.0, 0.0, 0.0), 0.0);
    }
}
