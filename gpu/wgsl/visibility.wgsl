// Weights of patches by visibility that the host has learned, and the cell of a point.

// Slots of the table less 1; the eye and the side of a cell over its distance from it; the place of the weights; 1 if weights are used, and
// a free word. Then slots of three words (low and high word of a key, number of its weights from 1, or 0), then weights, four per word.
@group(0) @binding(7) var<storage, read> headtail_visibility: array<u32>;

const HEADTAIL_LEVELS_OF_CELLS: u32 = 7u;
const HEADTAIL_SLOTS: u32 = 8u;
const HEADTAIL_WORDS_OF_CELL: u32 = 136u;
const HEADTAIL_COORDINATE: u32 = 0x1ffffu;

// The place of the weights of the point that is prepared.
var<private> headtail_cell_weights: u32;

fn headtail_cell_number(at: u32) -> f32 {
    return bitcast<f32>(headtail_visibility[at]);
}

// The number of the weights of a key, or 0.
fn headtail_find_key(key: vec2<u32>) -> u32 {
    var mixed = (key.x * 0x9e3779b9u) ^ (key.y * 0x85ebca6bu);
    mixed = (mixed ^ (mixed >> 15u)) * 0x2c1b3c6du;
    mixed = mixed ^ (mixed >> 16u);
    let mask = headtail_visibility[0];
    // Half of the slots are free.
    for (var k = 0u; k <= mask; k++) {
        let slot = HEADTAIL_SLOTS + 3u * ((mixed + k) & mask);
        let number = headtail_visibility[slot + 2u];
        if (number == 0u || (headtail_visibility[slot] == key.x && headtail_visibility[slot + 1u] == key.y)) { return number; }
    }
    return 0u;
}

// Finds the finest cell of a point with a normal: cubes that grow with the distance from the eye, and normals by their nearest axis.
fn headtail_find_cell(p: vec3<f32>, n: vec3<f32>) {
    headtail_cell_weights = HEADTAIL_NONE;
    if (headtail_visibility[6] == 0u) { return; }
    let away = p - vec3<f32>(headtail_cell_number(1u), headtail_cell_number(2u), headtail_cell_number(3u));
    let side = headtail_cell_number(4u) * sqrt(dot(away, away));
    let size = clamp(i32(bitcast<u32>(side) >> 23u) - 126, -100, 100);
    let scale = bitcast<f32>(u32(127 - size) << 23u);
    let long = abs(n);
    let is_x = long.x >= long.y && long.x >= long.z;
    let is_y = !is_x && long.y >= long.z;
    let along = select(select(n.z, n.y, is_y), n.x, is_x);
    let axis = select(select(4u, 2u, is_y), 0u, is_x) | select(0u, 1u, along < 0.0);
    var at = bitcast<vec3<u32>>(vec3<i32>(floor(p * scale))) & vec3<u32>(HEADTAIL_COORDINATE);
    var top = (u32(size + 100) << 3u) | axis;
    for (var level = 0u; level < HEADTAIL_LEVELS_OF_CELLS; level++) {
        let number = headtail_find_key(vec2<u32>(at.z | (at.y << 17u), (at.y >> 15u) | (at.x << 2u) | (top << 19u)));
        if (number > 0u) {
            headtail_cell_weights = headtail_visibility[5] + HEADTAIL_WORDS_OF_CELL * (number - 1u);
            return;
        }
        // The cell of the next level: coordinates are signed numbers of 17 bits.
        at = bitcast<vec3<u32>>(bitcast<vec3<i32>>(at << vec3<u32>(15u)) >> vec3<u32>(16u)) & vec3<u32>(HEADTAIL_COORDINATE);
        top += 8u;
    }
}

fn headtail_weight_of(k: u32) -> f32 {
    if (headtail_cell_weights == HEADTAIL_NONE) { return 1.0; }
    return f32((headtail_visibility[headtail_cell_weights + k / 4u] >> (8u * (k & 3u))) & 255u) / 255.0;
}

fn headtail_cluster_weight(cluster: u32) -> f32 {
    return headtail_weight_of(cluster);
}

fn headtail_part_weight(cluster: u32, part: u32) -> f32 {
    return headtail_weight_of(32u + 16u * cluster + part);
}
