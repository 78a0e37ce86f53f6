// Uniform numbers equal to those of `headtail_sampling::random::Stream`: words of ChaCha with 8 rounds (Bernstein 2008), the 24 upper bits of each.

// The key's first three words (seed and purpose; the others are 0) and two of the stream, the first condition to draw points of, then the position
// of the first number of each condition's points.
@group(0) @binding(4) var<storage, read> stream: array<u32>;

fn quarter_round(s: ptr<function, array<u32, 16>>, a: u32, b: u32, c: u32, d: u32) {
    (*s)[a] += (*s)[b]; (*s)[d] ^= (*s)[a]; (*s)[d] = ((*s)[d] << 16u) | ((*s)[d] >> 16u);
    (*s)[c] += (*s)[d]; (*s)[b] ^= (*s)[c]; (*s)[b] = ((*s)[b] << 12u) | ((*s)[b] >> 20u);
    (*s)[a] += (*s)[b]; (*s)[d] ^= (*s)[a]; (*s)[d] = ((*s)[d] << 8u) | ((*s)[d] >> 24u);
    (*s)[c] += (*s)[d]; (*s)[b] ^= (*s)[c]; (*s)[b] = ((*s)[b] << 7u) | ((*s)[b] >> 25u);
}

fn block_of(number: u32) -> array<u32, 16> {
    let before = array<u32, 16>(
        0x61707865u, 0x3320646eu, 0x79622d32u, 0x6b206574u,
        stream[0], stream[1], stream[2], 0u,
        0u, 0u, 0u, 0u,
        number, 0u, stream[3], stream[4],
    );
    var s = before;
    for (var k = 0u; k < 4u; k++) {
        quarter_round(&s, 0u, 4u, 8u, 12u);
        quarter_round(&s, 1u, 5u, 9u, 13u);
        quarter_round(&s, 2u, 6u, 10u, 14u);
        quarter_round(&s, 3u, 7u, 11u, 15u);
        quarter_round(&s, 0u, 5u, 10u, 15u);
        quarter_round(&s, 1u, 6u, 11u, 12u);
        quarter_round(&s, 2u, 7u, 8u, 13u);
        quarter_round(&s, 3u, 4u, 9u, 14u);
    }
    for (var k = 0u; k < 16u; k++) { s[k] += before[k]; }
    return s;
}

fn uniform_of(word: u32) -> f32 {
    return f32(word >> 8u) / 16777216.0;
}

// The two numbers of a condition's point.
fn uniform_point(condition: u32, index: u32) -> vec2<f32> {
    let position = stream[6u + condition] + 2u * index;
    var block = block_of(position / 16u);
    let first = block[position % 16u];
    if (position % 16u == 15u) { block = block_of(position / 16u + 1u); }
    return vec2<f32>(uniform_of(first), uniform_of(block[(position + 1u) % 16u]));
}
