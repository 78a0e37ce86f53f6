// Shows two films beside each other, tone-mapped.

struct Display {
    // Width and height in pixels.
    size: vec4<u32>,
    // For each film: samples of every pixel, more samples of the rows above a row, that row.
    left: vec4<f32>,
    right: vec4<f32>,
    // Position of the divider from 0 to 1, and the exposure as a factor.
    look: vec4<f32>,
}

@group(0) @binding(0) var<storage, read> left_film: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> right_film: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> display: Display;

const WHITE: f32 = 8.0;

@vertex
fn corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    // A triangle that covers the canvas.
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

fn encoded(linear: f32) -> f32 {
    let x = clamp(linear, 0.0, 1.0);
    return select(1.055 * pow(x, 1.0 / 2.4) - 0.055, 12.92 * x, x <= 0.0031308);
}

// The tone curve of the program's pictures: extended Reinhard (2002); colours fade where a channel would pass 1.
fn shown(radiance: vec3<f32>) -> vec3<f32> {
    let bright = dot(radiance, vec3<f32>(0.2126, 0.7152, 0.0722));
    if (bright >= WHITE) { return vec3<f32>(1.0); }
    let level = bright * (1.0 + bright / (WHITE * WHITE)) / (1.0 + bright);
    let color = radiance * (level / max(bright, 1e-20));
    let peak = max(max(color.r, color.g), color.b);
    let fade = select(1.0, (1.0 - level) / (peak - level), peak > 1.0);
    return vec3<f32>(level) + (color - level) * fade;
}

@fragment
fn pixel(@builtin(position) place: vec4<f32>) -> @location(0) vec4<f32> {
    let x = min(u32(place.x), display.size.x - 1u);
    let y = min(u32(place.y), display.size.y - 1u);
    let at = 3u * (y * display.size.x + x);
    let is_left = place.x < display.look.x * f32(display.size.x);
    var light: vec3<f32>;
    var counts: vec4<f32>;
    if (is_left) {
        light = left_film[at].rgb + left_film[at + 1u].rgb;
        counts = display.left;
    } else {
        light = right_film[at].rgb + right_film[at + 1u].rgb;
        counts = display.right;
    }
    let count = counts.x + select(0.0, counts.y, f32(y) < counts.z);
    let color = shown(light * (display.look.y / max(count, 1.0)));
    return vec4<f32>(encoded(color.r), encoded(color.g), encoded(color.b), 1.0);
}
