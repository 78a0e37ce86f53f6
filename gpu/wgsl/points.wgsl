// The view, and the numbers of points: what all pixels share comes from the host, the shift or the scrambling of each pixel is drawn here.

struct HeadtailView {
    // Position in metres; half the image's height at distance 1.
    look_from: vec4<f32>,
    // Axes of the camera; the principal point right of and above the middle, in half heights; 1 where rays are parallel.
    right: vec4<f32>,
    up: vec4<f32>,
    forward: vec4<f32>,
    // Width and height of the image in pixels; the most surfaces on a path; 1 without shadow rays.
    size: vec4<u32>,
    // Left, top, width and height of the part that is rendered.
    part: vec4<u32>,
    // First row in the part; number of samples; the seed's low and high word.
    work: vec4<u32>,
    // For each sample its groups of numbers: three numbers, three words of a counter; its first word, 0 or 2, and whether they are scrambled, 1.
    numbers: array<u32>,
}

@group(0) @binding(6) var<storage, read> headtail_view: HeadtailView;

const HEADTAIL_GROUP: u32 = 7u;

// The upper half of a product of two words.
fn headtail_multiply_high(a: u32, b: u32) -> u32 {
    let al = a & 0xffffu;
    let ah = a >> 16u;
    let bl = b & 0xffffu;
    let bh = b >> 16u;
    let low = al * bl;
    let middle = ah * bl + (low >> 16u);
    let cross = al * bh + (middle & 0xffffu);
    return ah * bh + (middle >> 16u) + (cross >> 16u);
}

// Philox4x32-7 (Salmon et al. 2011).
fn headtail_philox(given: vec4<u32>, seed: vec2<u32>) -> vec4<u32> {
    var counter = given;
    var key = seed;
    for (var round = 0u; round < 7u; round++) {
        let first = vec2<u32>(headtail_multiply_high(0xd2511f53u, counter.x), 0xd2511f53u * counter.x);
        let second = vec2<u32>(headtail_multiply_high(0xcd9e8d57u, counter.z), 0xcd9e8d57u * counter.z);
        counter = vec4<u32>(second.x ^ counter.y ^ key.x, second.y, first.x ^ counter.w ^ key.y, first.y);
        key += vec2<u32>(0x9e3779b9u, 0xbb67ae85u);
    }
    return counter;
}

// Digits of numbers, the first in bit 0, permuted by seeds: see `owen.rs` of headtail-sampling.
fn headtail_scramble(before_seed: vec3<u32>, seed: vec3<u32>) -> vec3<u32> {
    var x = (before_seed + seed) * ((seed >> vec3<u32>(16u)) | vec3<u32>(1u));
    x ^= x * 0x05526c56u;
    return reverseBits(x ^ (x * 0x53a22864u));
}

// Three numbers in [0, 1) of a group of the host's, for a pixel's key.
fn headtail_numbers(group: u32, key: u32) -> vec3<f32> {
    let at = HEADTAIL_GROUP * group;
    let base = vec3<u32>(headtail_view.numbers[at], headtail_view.numbers[at + 1u], headtail_view.numbers[at + 2u]);
    let counter = vec4<u32>(key, headtail_view.numbers[at + 3u], headtail_view.numbers[at + 4u], headtail_view.numbers[at + 5u]);
    let kind = headtail_view.numbers[at + 6u];
    let words = headtail_philox(counter, headtail_view.work.zw);
    let seeds = select(words.xyz, words.zwx, kind >= 2u);
    var bits = base + seeds;
    if ((kind & 1u) == 1u) { bits = headtail_scramble(base, seeds); }
    return vec3<f32>(bits >> vec3<u32>(8u)) * (1.0 / 16777216.0);
}

// A pixel's place on Morton's curve: the key of its numbers.
fn headtail_spread_bits(given: u32) -> u32 {
    var x = given & 0xffffu;
    x = (x | (x << 8u)) & 0x00ff00ffu;
    x = (x | (x << 4u)) & 0x0f0f0f0fu;
    x = (x | (x << 2u)) & 0x33333333u;
    return (x | (x << 1u)) & 0x55555555u;
}

fn headtail_key(pixel: vec2<u32>) -> u32 {
    return headtail_spread_bits(pixel.x) | (headtail_spread_bits(pixel.y) << 1u);
}
