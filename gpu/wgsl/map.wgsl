// The environment map: bilinear radiance.

@group(0) @binding(4) var<storage, read> headtail_texels: array<f32>;

fn headtail_texel(column: u32, row: u32) -> vec3<f32> {
    let at = 3u * (row * HEADTAIL_MAP_WIDTH + column);
    return vec3<f32>(headtail_texels[at], headtail_texels[at + 1u], headtail_texels[at + 2u]);
}

// The radiance from a unit direction.
fn headtail_radiance(wi: vec3<f32>) -> vec3<f32> {
    let x = headtail_square(wi);
    let width = f32(HEADTAIL_MAP_WIDTH);
    let column = x.x * width - 0.5;
    let left = floor(column);
    let i = select(min(u32(max(left, 0.0)), HEADTAIL_MAP_WIDTH - 1u), HEADTAIL_MAP_WIDTH - 1u, left < 0.0);
    let next = select(i + 1u, 0u, i + 1u == HEADTAIL_MAP_WIDTH);
    let row = x.y * f32(HEADTAIL_MAP_HEIGHT - 1u);
    let j = min(u32(row), HEADTAIL_MAP_HEIGHT - 2u);
    let inside = vec2<f32>(column - left, row - f32(j));
    let upper = mix(headtail_texel(i, j), headtail_texel(next, j), inside.x);
    let lower = mix(headtail_texel(i, j + 1u), headtail_texel(next, j + 1u), inside.x);
    return mix(upper, lower, inside.y);
}
