// The quad-tree tail, and the density of the map's light: bilinear in the cells between texels.

// The densities at the corners of a cell: upper left, upper right, lower left, lower right.
fn headtail_corners(cell: vec2<u32>) -> vec4<f32> {
    let next = select(cell.x + 1u, 0u, cell.x + 1u == HEADTAIL_WIDTH);
    let upper = HEADTAIL_TAIL_NODES + cell.y * HEADTAIL_WIDTH;
    let lower = upper + HEADTAIL_WIDTH;
    return vec4<f32>(
        headtail_float(upper + cell.x),
        headtail_float(upper + next),
        headtail_float(lower + cell.x),
        headtail_float(lower + next),
    );
}

// |dy/dx| at a cell's position.
fn headtail_density(cell: vec4<f32>) -> f32 {
    let c = headtail_corners(vec2<u32>(cell.xy));
    let west = (1.0 - cell.w) * c.x + cell.w * c.z;
    let east = (1.0 - cell.w) * c.y + cell.w * c.w;
    return (1.0 - cell.z) * west + cell.z * east;
}

// x of a point y of Y, and the density |dy/dx| there.
fn headtail_tail(y: vec2<f32>) -> vec3<f32> {
    let u = clamp(y.x, 0.0, HEADTAIL_BELOW_ONE);
    let v = clamp(y.y, 0.0, HEADTAIL_BELOW_ONE);
    var index = 0u;
    var cell = vec2<u32>(0u, 0u);
    // Left, right, top, bottom.
    var sides = vec4<f32>(0.0, 1.0, 0.0, 1.0);
    for (var level = 0u; level < HEADTAIL_LEVELS; level++) {
        let bits = vec2<u32>(headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level], headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level + 1u]);
        let cuts = headtail_four(HEADTAIL_TAIL_CUTS, headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level + 2u] + index);
        let lower = bits.y == 1u && v >= cuts.x;
        if (bits.y == 1u) {
            sides = select(vec4<f32>(sides.xyz, cuts.x), vec4<f32>(sides.xy, cuts.x, sides.w), lower);
        }
        let vertical = select(cuts.y, cuts.z, lower);
        let east = bits.x == 1u && u >= vertical;
        if (bits.x == 1u) {
            sides = select(vec4<f32>(sides.x, vertical, sides.zw), vec4<f32>(vertical, sides.yzw), east);
        }
        let half = vec2<u32>(select(0u, 1u, east), select(0u, 1u, lower));
        index = (index << (bits.x + bits.y)) + (half.y << bits.x) + half.x;
        cell = (cell << bits) + half;
    }
    let c = headtail_corners(cell);
    let down = headtail_sample_linear(headtail_remap(v, sides.z, sides.w), c.x + c.y, c.z + c.w);
    let west = (1.0 - down) * c.x + down * c.z;
    let east = (1.0 - down) * c.y + down * c.w;
    let across = headtail_sample_linear(headtail_remap(u, sides.x, sides.y), west, east);
    return vec3<f32>(headtail_point(cell, vec2<f32>(across, down)), (1.0 - across) * west + across * east);
}

// y of a cell's position: down the tree to the cell's rectangle.
fn headtail_inverse(cell: vec4<f32>) -> vec2<f32> {
    let place = vec2<u32>(cell.xy);
    var index = 0u;
    var sides = vec4<f32>(0.0, 1.0, 0.0, 1.0);
    for (var level = 0u; level < HEADTAIL_LEVELS; level++) {
        let bits = vec2<u32>(headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level], headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level + 1u]);
        let cuts = headtail_four(HEADTAIL_TAIL_CUTS, headtail_integers[HEADTAIL_TAIL_LEVELS + 3u * level + 2u] + index);
        let half = ((place >> vec2<u32>(HEADTAIL_LEVELS - 1u - level)) & vec2<u32>(1u)) * bits;
        if (bits.y == 1u) {
            sides = select(vec4<f32>(sides.xyz, cuts.x), vec4<f32>(sides.xy, cuts.x, sides.w), half.y == 1u);
        }
        let vertical = select(cuts.y, cuts.z, half.y == 1u);
        if (bits.x == 1u) {
            sides = select(vec4<f32>(sides.x, vertical, sides.zw), vec4<f32>(vertical, sides.yzw), half.x == 1u);
        }
        index = (index << (bits.x + bits.y)) + (half.y << bits.x) + half.x;
    }
    let c = headtail_corners(place);
    let west = (1.0 - cell.w) * c.x + cell.w * c.z;
    let east = (1.0 - cell.w) * c.y + cell.w * c.w;
    let inside = vec2<f32>(headtail_invert_linear(cell.z, west, east), headtail_invert_linear(cell.w, c.x + c.y, c.z + c.w));
    return min(sides.xz + inside * (sides.yw - sides.xz), vec2<f32>(HEADTAIL_BELOW_ONE));
}

// y of a point of X, and |dy/dx| there.
fn headtail_pull_back(x: vec2<f32>) -> vec3<f32> {
    let cell = headtail_cell(x);
    return vec3<f32>(headtail_inverse(cell), headtail_density(cell));
}
