// Portal-masked sampling (Bitterli, Novák and Jarosz 2015), with a few of the samples from the tail.
//
// Sums of pixels are integers, so that their differences are exact. Parts of pixels are added to these and never
// subtracted, so that single precision is enough.

const HEADTAIL_LEAST_DISTANCE: f32 = 1e-5;
// The fraction of samples through portals, at points that see one.
const HEADTAIL_THROUGH_PORTALS: f32 = 0.875;
const HEADTAIL_NO_PORTAL: u32 = 0xffffffffu;
const HEADTAIL_CORNERS: u32 = HEADTAIL_PORTAL_PIXELS + 1u;

// A portal at the prepared point: the tangents of its left, right, lower and upper sides, these in pixels, the sum of the pixels
// between, and the probability that it is chosen.
struct HeadtailOpening { sides: vec4<f32>, pixels: vec4<f32>, total: f32, chance: f32 }

var<private> headtail_openings: array<HeadtailOpening, HEADTAIL_OPENINGS>;
// The fraction of samples through portals at the prepared point.
var<private> headtail_through: f32;

// Three numbers of a portal: the axes of its width, height and normal, then the middle along these.
fn headtail_of_portal(portal: u32, k: u32) -> vec3<f32> {
    let at = HEADTAIL_PORTALS_RECTANGLES + 14u * portal + 3u * k;
    return vec3<f32>(headtail_float(at), headtail_float(at + 1u), headtail_float(at + 2u));
}

fn headtail_pixels_of(tangents: vec4<f32>) -> vec4<f32> {
    return 0.5 * f32(HEADTAIL_PORTAL_PIXELS) * (1.0 + tangents / (1.0 + abs(tangents)));
}

fn headtail_tangents_of(pixels: vec2<f32>) -> vec2<f32> {
    let within = clamp(pixels / (0.5 * f32(HEADTAIL_PORTAL_PIXELS)) - 1.0, vec2<f32>(-HEADTAIL_BELOW_ONE), vec2<f32>(HEADTAIL_BELOW_ONE));
    return within / (1.0 - abs(within));
}

// The solid angle per pixel at tangents, in an order in which no product overflows.
fn headtail_pixel_angle(tangents: vec2<f32>) -> f32 {
    let pixel = 2.0 / f32(HEADTAIL_PORTAL_PIXELS);
    let s = 1.0 + abs(tangents);
    let squared = 1.0 + dot(tangents, tangents);
    return (pixel * s.x) * (s.x / squared) * (pixel * s.y) * (s.y / sqrt(squared));
}

fn headtail_pixel_at(place: f32) -> u32 {
    return min(u32(max(place, 0.0)), HEADTAIL_PORTAL_PIXELS - 1u);
}

// The place of the first sum of a portal's image.
fn headtail_image_of(portal: u32) -> u32 {
    return HEADTAIL_PORTALS_SUMS + headtail_integers[HEADTAIL_PORTALS_IMAGE + portal] * HEADTAIL_CORNERS * HEADTAIL_CORNERS;
}

// The sum of the pixels from the first one to the last one, both included.
fn headtail_sum_of_pixels(image: u32, first: vec2<u32>, last: vec2<u32>) -> f32 {
    let above = image + (last.y + 1u) * HEADTAIL_CORNERS;
    let below = image + first.y * HEADTAIL_CORNERS;
    let upper = headtail_integers[above + last.x + 1u] - headtail_integers[above + first.x];
    return f32(upper - (headtail_integers[below + last.x + 1u] - headtail_integers[below + first.x]));
}

// A band of pixels between two places across it, along which sums are taken: the places of its lines of corners (the two of the first pixels
// across, the two of the last ones), the parts of these pixels that are inside, and the distance of two corners along a line.
struct HeadtailBand { lines: vec4<u32>, first: f32, last: f32, step: u32 }

// The rows between two places.
fn headtail_rows(image: u32, bottom: f32, top: f32) -> HeadtailBand {
    let first = headtail_pixel_at(bottom);
    let last = headtail_pixel_at(top);
    let line = image + first * HEADTAIL_CORNERS;
    let next = line + HEADTAIL_CORNERS;
    if (first == last) { return HeadtailBand(vec4<u32>(line, next, next, next), top - bottom, 0.0, 1u); }
    let other = image + last * HEADTAIL_CORNERS;
    return HeadtailBand(vec4<u32>(line, next, other, other + HEADTAIL_CORNERS), f32(first + 1u) - bottom, top - f32(last), 1u);
}

fn headtail_corners_of(band: HeadtailBand, k: u32) -> vec4<u32> {
    let at = band.lines + k * band.step;
    return vec4<u32>(headtail_integers[at.x], headtail_integers[at.y], headtail_integers[at.z], headtail_integers[at.w]);
}

// The sum of a band between corners.
fn headtail_band_sum(band: HeadtailBand, start: vec4<u32>, end: vec4<u32>) -> f32 {
    let s = bitcast<vec4<i32>>(end - start);
    return band.first * f32(s.y - s.x) + f32(s.z - s.y) + band.last * f32(s.w - s.z);
}

// The start of a band between two places along it: its first pixel, the sum of this one from the place on, and the sum to the other place.
struct HeadtailGrowth { pixel: u32, first: f32, total: f32 }

fn headtail_growth(band: HeadtailBand, start: f32, end: f32) -> HeadtailGrowth {
    let first = headtail_pixel_at(start);
    let last = headtail_pixel_at(end);
    let inner = headtail_corners_of(band, first + 1u);
    let of_first = headtail_band_sum(band, headtail_corners_of(band, first), inner);
    let rest = (f32(first + 1u) - start) * of_first;
    if (last == first) { return HeadtailGrowth(first, rest, (end - start) * of_first); }
    let outer = headtail_corners_of(band, last);
    let of_last = headtail_band_sum(band, outer, headtail_corners_of(band, last + 1u));
    return HeadtailGrowth(first, rest, rest + headtail_band_sum(band, inner, outer) + (end - f32(last)) * of_last);
}

// Where a band between two places reaches the fraction u of its sum: the place, its pixel, the sum of that pixel and that of the band.
struct HeadtailReached { place: f32, pixel: u32, value: f32, total: f32 }

fn headtail_reach(band: HeadtailBand, start: f32, end: f32, u: f32) -> HeadtailReached {
    let growth = headtail_growth(band, start, end);
    let inner = headtail_corners_of(band, growth.pixel + 1u);
    let wanted = u * growth.total;
    // The last pixel that starts at the wanted sum or below.
    var low = growth.pixel;
    var high = max(headtail_pixel_at(end), low) + 1u;
    var below = 0.0;
    while (high - low > 1u) {
        let middle = (low + high) / 2u;
        let sum = growth.first + headtail_band_sum(band, inner, headtail_corners_of(band, middle));
        if (sum <= wanted) {
            low = middle;
            below = sum;
        } else {
            high = middle;
        }
    }
    let value = headtail_band_sum(band, headtail_corners_of(band, low), headtail_corners_of(band, low + 1u));
    let from_low = max(start, f32(low)) - f32(low);
    let inside = select(0.5, from_low + (wanted - below) / value, value > 0.0);
    return HeadtailReached(f32(low) + clamp(inside, 0.0, HEADTAIL_BELOW_ONE), low, value, growth.total);
}

// The cosine of the direction of tangents, at least 0, from those of the axes.
fn headtail_cosine_through(axes: vec3<f32>, x: f32, y: f32) -> f32 {
    return max(x * axes.x + y * axes.y - axes.z, 0.0) / sqrt(1.0 + x * x + y * y);
}

// A portal at a point, with an unnormalised probability: its light times the mean cosine of its corners and its middle.
fn headtail_opening(portal: u32, n: vec3<f32>) -> HeadtailOpening {
    let right = headtail_of_portal(portal, 0u);
    let up = headtail_of_portal(portal, 1u);
    let normal = headtail_of_portal(portal, 2u);
    let middle = headtail_of_portal(portal, 3u);
    let half = headtail_of_portal(portal, 4u).xy;
    let least = HEADTAIL_LEAST_DISTANCE * (half.x + half.y);
    let away = dot(normal, headtail_position) - middle.z;
    let x = middle.x - dot(right, headtail_position);
    let y = middle.y - dot(up, headtail_position);
    let s = vec4<f32>(x - half.x, x + half.x, y - half.y, y + half.y) / max(away, least);
    let axes = vec3<f32>(dot(right, n), dot(up, n), dot(normal, n));
    let sum = headtail_cosine_through(axes, s.x, s.z) + headtail_cosine_through(axes, s.y, s.z) + headtail_cosine_through(axes, s.x, s.w)
        + headtail_cosine_through(axes, s.y, s.w) + headtail_cosine_through(axes, 0.5 * (s.x + s.y), 0.5 * (s.z + s.w));
    var opening = HeadtailOpening(s, headtail_pixels_of(s), 0.0, 0.0);
    if (!(away > least && sum > 0.0)) { return opening; }
    let image = headtail_image_of(portal);
    let p = opening.pixels;
    let first = vec2<u32>(headtail_pixel_at(p.x), headtail_pixel_at(p.z));
    opening.chance = sum * headtail_sum_of_pixels(image, first, vec2<u32>(headtail_pixel_at(p.y), headtail_pixel_at(p.w)));
    opening.total = headtail_growth(headtail_rows(image, p.z, p.w), p.x, p.y).total;
    return opening;
}

fn headtail_prepare(at: HeadtailSurface) {
    headtail_at = at;
    var sum = 0.0;
    for (var k = 0u; k < HEADTAIL_OPENINGS; k++) {
        headtail_openings[k] = headtail_opening(k, at.n);
        sum += headtail_openings[k].chance;
    }
    for (var k = 0u; k < HEADTAIL_OPENINGS; k++) {
        headtail_openings[k].chance = select(0.0, headtail_openings[k].chance / sum, sum > 0.0);
    }
    headtail_through = select(0.0, HEADTAIL_THROUGH_PORTALS, sum > 0.0);
}

fn headtail_share_here() -> f32 {
    return 0.5;
}

// A direction through a portal, its part of the pdf, and the portal.
struct HeadtailThrough { wi: vec3<f32>, pdf: f32, portal: u32 }

fn headtail_draw_through(z: vec2<f32>) -> HeadtailThrough {
    var portal = HEADTAIL_NO_PORTAL;
    var start = 0.0;
    var below = 0.0;
    for (var k = 0u; k < HEADTAIL_OPENINGS; k++) {
        let chance = headtail_openings[k].chance;
        // The last portal takes what is left by rounding.
        if (chance > 0.0 && below <= z.x) {
            portal = k;
            start = below;
        }
        below += chance;
    }
    if (portal == HEADTAIL_NO_PORTAL) { return HeadtailThrough(vec3<f32>(0.0, 0.0, 1.0), 0.0, portal); }
    let opening = headtail_openings[portal];
    let image = headtail_image_of(portal);
    let p = opening.pixels;
    let across = headtail_reach(headtail_rows(image, p.z, p.w), p.x, p.y, headtail_remap(z.x, start, start + opening.chance));
    let line = image + across.pixel;
    let column = HeadtailBand(vec4<u32>(line, line + 1u, line + 1u, line + 1u), 1.0, 0.0, HEADTAIL_CORNERS);
    let along = headtail_reach(column, p.z, p.w, z.y);
    let t = headtail_tangents_of(vec2<f32>(across.place, along.place));
    let density = select(0.0, along.value / across.total, across.total > 0.0);
    let toward = t.x * headtail_of_portal(portal, 0u) + t.y * headtail_of_portal(portal, 1u) - headtail_of_portal(portal, 2u);
    return HeadtailThrough(normalize(toward), opening.chance * density / headtail_pixel_angle(t), portal);
}

// The sum of the pdfs through all portals but one.
fn headtail_through_others(wi: vec3<f32>, portal: u32) -> f32 {
    var pdf = 0.0;
    for (var k = 0u; k < HEADTAIL_OPENINGS; k++) {
        let opening = headtail_openings[k];
        let at = vec2<f32>(dot(headtail_of_portal(k, 0u), wi), dot(headtail_of_portal(k, 1u), wi));
        let z = -dot(headtail_of_portal(k, 2u), wi);
        let s = opening.sides * z;
        let is_through = z > 0.0 && at.x >= s.x && at.x <= s.y && at.y >= s.z && at.y <= s.w;
        if (k == portal || !(is_through && opening.chance > 0.0 && opening.total > 0.0)) { continue; }
        let t = at / z;
        let place = headtail_pixels_of(vec4<f32>(t, 0.0, 0.0));
        let pixel = vec2<u32>(headtail_pixel_at(place.x), headtail_pixel_at(place.y));
        pdf += opening.chance * headtail_sum_of_pixels(headtail_image_of(k), pixel, pixel) / (opening.total * headtail_pixel_angle(t));
    }
    return pdf;
}

fn headtail_of_tail(wi: vec3<f32>) -> f32 {
    let x = headtail_square(wi);
    return headtail_pull_back(x.xy).z * x.z;
}

fn headtail_sample_here(z: vec2<f32>) -> vec4<f32> {
    let share = headtail_through;
    if (z.x < share) {
        let own = headtail_draw_through(vec2<f32>(headtail_remap(z.x, 0.0, share), z.y));
        let pdf = share * (own.pdf + headtail_through_others(own.wi, own.portal)) + (1.0 - share) * headtail_of_tail(own.wi);
        return vec4<f32>(own.wi, select(0.0, pdf, own.pdf > 0.0));
    }
    let drawn = headtail_through_tail(vec2<f32>(headtail_remap(z.x, share, 1.0), z.y), 1.0);
    let pdf = share * headtail_through_others(drawn.xyz, HEADTAIL_NO_PORTAL) + (1.0 - share) * drawn.w;
    return vec4<f32>(drawn.xyz, select(0.0, pdf, drawn.w > 0.0));
}

fn headtail_pdf_here(wi: vec3<f32>) -> f32 {
    return headtail_through * headtail_through_others(wi, HEADTAIL_NO_PORTAL) + (1.0 - headtail_through) * headtail_of_tail(wi);
}
