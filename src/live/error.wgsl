// The mean squared difference of two films over the pixels where every camera ray of both hit a surface.

struct Counts {
    pixels: u32,
    // Samples of each pixel.
    film: f32,
    reference: f32,
    pad: f32,
}

@group(0) @binding(0) var<storage, read> film: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> reference: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> counts: Counts;
// Sum of squares, and number of pixels.
@group(0) @binding(3) var<storage, read_write> result: array<f32>;

var<workgroup> sums: array<vec2<f32>, 256>;

@compute @workgroup_size(256)
fn measure(@builtin(local_invocation_index) own: u32) {
    var sum = vec2<f32>(0.0);
    for (var pixel = own; pixel < counts.pixels; pixel += 256u) {
        let at = 3u * pixel;
        if (film[at + 1u].w == counts.film && reference[at + 1u].w == counts.reference) {
            let difference = film[at].rgb / counts.film - reference[at].rgb / counts.reference;
            sum += vec2<f32>(dot(difference, difference) / 3.0, 1.0);
        }
    }
    sums[own] = sum;
    workgroupBarrier();
    for (var step = 128u; step > 0u; step /= 2u) {
        if (own < step) { sums[own] += sums[own + step]; }
        workgroupBarrier();
    }
    if (own == 0u) {
        result[0] = sums[0].x;
        result[1] = sums[0].y;
    }
}
