// Sums of products of eight rows and eight columns, a thread's share of a matrix product. Places are constants everywhere, so that the sums are in
// registers: row k has the columns x in place k and the columns y in place 8 + k.

alias Tile = array<vec4<f32>, 16>;

fn add_products(tile: ptr<function, Tile>, f: vec4<f32>, g: vec4<f32>, x: vec4<f32>, y: vec4<f32>) {
    (*tile)[0] = fma(vec4<f32>(f.x), x, (*tile)[0]);
    (*tile)[1] = fma(vec4<f32>(f.y), x, (*tile)[1]);
    (*tile)[2] = fma(vec4<f32>(f.z), x, (*tile)[2]);
    (*tile)[3] = fma(vec4<f32>(f.w), x, (*tile)[3]);
    (*tile)[4] = fma(vec4<f32>(g.x), x, (*tile)[4]);
    (*tile)[5] = fma(vec4<f32>(g.y), x, (*tile)[5]);
    (*tile)[6] = fma(vec4<f32>(g.z), x, (*tile)[6]);
    (*tile)[7] = fma(vec4<f32>(g.w), x, (*tile)[7]);
    (*tile)[8] = fma(vec4<f32>(f.x), y, (*tile)[8]);
    (*tile)[9] = fma(vec4<f32>(f.y), y, (*tile)[9]);
    (*tile)[10] = fma(vec4<f32>(f.z), y, (*tile)[10]);
    (*tile)[11] = fma(vec4<f32>(f.w), y, (*tile)[11]);
    (*tile)[12] = fma(vec4<f32>(g.x), y, (*tile)[12]);
    (*tile)[13] = fma(vec4<f32>(g.y), y, (*tile)[13]);
    (*tile)[14] = fma(vec4<f32>(g.z), y, (*tile)[14]);
    (*tile)[15] = fma(vec4<f32>(g.w), y, (*tile)[15]);
}

// Sixteen steps of a product; `add_step` is that of the shader.
fn add_sixteen_steps(tile: ptr<function, Tile>, local: vec3<u32>) {
    for (var k = 0u; k < 16u; k += 4u) {
        add_step(tile, k, local);
        add_step(tile, k + 1u, local);
        add_step(tile, k + 2u, local);
        add_step(tile, k + 3u, local);
    }
}
