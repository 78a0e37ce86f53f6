// Patches of sky: product sampling in closed form for a diffuse lobe and a Trowbridge-Reitz lobe, between the square of uniform points and Y.

const HEADTAIL_CLUSTERS: u32 = 32u;
const HEADTAIL_PARTS: u32 = 16u;
const HEADTAIL_LEAST_VARIANCE: f32 = 3e-7;

// Multiplications and additions are fused at the places where the native sampler fuses them, wherever the device can.
fn headtail_dot(a: vec3<f32>, b: vec3<f32>) -> f32 {
    return fma(a.x, b.x, fma(a.y, b.y, a.z * b.z));
}

// Three times the variance of t . w over a patch: each component times what it meets in its row of the symmetric matrix.
fn headtail_spread(squares: vec3<f32>, mixed: vec3<f32>, t: vec3<f32>) -> f32 {
    let first = fma(t.y, mixed.x, fma(t.z, mixed.y, t.x * squares.x));
    let second = fma(t.z, mixed.z, t.y * squares.y);
    let third = t.z * squares.z;
    return max(fma(t.x, first, fma(t.y, second, t.z * third)), 0.0);
}

// The light of a patch times what the surface reflects of it.
fn headtail_mass(start: u32, k: u32, at: HeadtailSurface, is_leaf: bool) -> f32 {
    let a = headtail_four(start, 4u * k);
    let b = headtail_four(start, 4u * k + 1u);
    let c = headtail_four(start, 4u * k + 2u);
    let d = headtail_four(start, 4u * k + 3u);
    let centroid = a.yzw;
    let squares = b.xyz;
    let mixed = vec3<f32>(b.w, c.xy);
    let mean = headtail_dot(at.n, centroid);
    let half_width = sqrt(headtail_spread(squares, mixed, at.n) + HEADTAIL_LEAST_VARIANCE);
    // c.z: reach, c.w: the same in the metric of the spread, d.x: what a cell adds.
    let bound = mean + min(fma(c.w, half_width, d.x), c.z);
    if (!(bound > 0.0)) { return 0.0; }
    let above = max(mean + half_width, 0.0);
    var diffuse: f32;
    if (is_leaf) {
        let part = above * above * above / (6.0 * half_width);
        diffuse = max(sqrt(select(part, mean * mean + half_width * half_width * (1.0 / 3.0), mean > half_width)), 0.15 * bound);
    } else {
        diffuse = max(select(above * above / (4.0 * half_width), mean, mean > half_width), 0.045 * bound);
    }
    if (!(at.lobes.y > 0.0)) { return a.x * diffuse; }
    let top = max(min(mean + half_width, bound), 0.2 * bound);
    let bottom = max(mean - half_width, 0.0);
    let visible = max(min((top - bottom) / (2.0 * half_width), 1.0), 0.02);
    let middle = 0.5 * (top + bottom);
    let toward = fma(at.n, vec3<f32>(middle - mean), centroid);
    let scale = 1.0 / sqrt(max(headtail_dot(toward, toward), 1e-6));
    let w = toward * scale;
    let cos_o = max(headtail_dot(at.n, at.wo), 1e-4);
    let cos_i = min(max(middle * scale, 1e-4), 1.0);
    let cosine = min(headtail_dot(at.wo, w), 1.0 - 1e-6);
    let squared_half = max(fma(0.5, cosine, 0.5), 1e-3);
    let away = 1.0 - cosine;
    let both = 1.0 / (squared_half * away);
    let per_half = away * both;
    let per_squared_sine = 0.5 * both;
    let squared_cos_h = min((cos_i + cos_o) * (cos_i + cos_o) * (0.25 * per_half), 1.0);
    let across = fma(at.wo.yzx, w.zxy, -(at.wo.zxy * w.yzx));
    let variance_across = headtail_spread(squares, mixed, across) * (1.0 / 3.0) * per_squared_sine;
    let variance_along = max(d.y - variance_across, 0.0);
    let alpha = at.lobes.w;
    let along = min(fma(0.5, variance_along, alpha * alpha), 1.0);
    let over = min(fma(0.5 * variance_across, per_half, alpha * alpha), 1.0);
    let tilt = headtail_dot(at.n, across);
    let tilt_across = tilt * tilt * per_squared_sine;
    let tilt_along = max(1.0 - squared_cos_h - tilt_across, 0.0);
    let product = along * over;
    let scaled = fma(squared_cos_h, product, fma(tilt_along, over, tilt_across * along));
    let smooth_part = 2.0 * cos_i * cos_o;
    let shadowing = 2.0 * fma(alpha, cos_i + cos_o - smooth_part, smooth_part);
    let x = 1.0 - squared_half;
    let fourth = (x * x) * (x * x);
    let fresnel = fma(1.0 - at.lobes.z, fourth * fourth * fourth, at.lobes.z);
    let lobe = HEADTAIL_INVERSE_PI * product * sqrt(product) * cos_i / (scaled * scaled * shadowing);
    let glossy = select(visible, sqrt(visible), is_leaf) * fresnel * lobe;
    return a.x * fma(at.lobes.y, glossy, at.lobes.x * HEADTAIL_INVERSE_PI * diffuse);
}

struct HeadtailStep { sums: array<f32, 32>, total: f32 }

// The running sums of the masses of the parts of a patch from `first` on, with the weights of those of a cluster if there is one.
fn headtail_sums(start: u32, first: u32, at: HeadtailSurface, cluster: u32) -> HeadtailStep {
    var step: HeadtailStep;
    step.total = 0.0;
    for (var k = 0u; k < HEADTAIL_PARTS; k++) {
        let mass = headtail_mass(start, first + k, at, true);
        if (cluster < HEADTAIL_CLUSTERS) {
            step.total += headtail_part_weight(cluster, k) * mass;
        } else {
            step.total += mass;
        }
        step.sums[k] = step.total;
    }
    return step;
}

// The running sums of the masses of the clusters, and their mixture weight beside sampling the BSDF.
struct HeadtailClusters { step: HeadtailStep, mixture_weight: f32 }

fn headtail_clusters(at: HeadtailSurface) -> HeadtailClusters {
    var step: HeadtailStep;
    var squared = 0.0;
    step.total = 0.0;
    for (var k = 0u; k < HEADTAIL_CLUSTERS; k++) {
        let mass = headtail_cluster_weight(k) * headtail_mass(HEADTAIL_PATCHES_CLUSTERS, k, at, false);
        step.total += mass;
        squared += mass * headtail_float(HEADTAIL_PATCHES_CLUSTERS + 16u * k + 14u);
        step.sums[k] = step.total;
    }
    return HeadtailClusters(step, headtail_mixture_weight_beside_bsdf(at, step.total, squared));
}

// The same with small lights, which come first, at a number of quarters of all samples: by the root of the odds of their light.
fn headtail_by_quarters(clusters: HeadtailClusters, at: HeadtailSurface) -> HeadtailStep {
    var step = clusters.step;
    let small = headtail_integers[HEADTAIL_PATCHES_SMALL];
    if (small == 0u || at.lobes.w < headtail_float(HEADTAIL_PATCHES_NARROW)) { return step; }
    let own = step.sums[small - 1u];
    let rest = step.total - own;
    if (!(own > 0.05 * step.total && rest > 0.0)) { return step; }
    let odds = 0.75 * sqrt(own / rest);
    var quarters = max(floor(4.0 * clusters.mixture_weight * odds / (1.0 + odds) + 0.5), 1.0);
    if (0.25 * quarters > 0.875 * clusters.mixture_weight) { quarters -= 1.0; }
    if (!(quarters > 0.0)) { return step; }
    let fraction = 0.25 * quarters / clusters.mixture_weight;
    let wanted = fraction / (1.0 - fraction) * rest;
    for (var k = 0u; k < HEADTAIL_CLUSTERS; k++) {
        step.sums[k] = select(step.sums[k] + (wanted - own), step.sums[k] * (wanted / own), k < small);
    }
    step.total += wanted - own;
    return step;
}

// What the clusters give at the point that was prepared.
var<private> headtail_patches: HeadtailClusters;

fn headtail_prepare_patches(at: HeadtailSurface) {
    headtail_at = at;
    headtail_patches = headtail_clusters(at);
    headtail_patches.step = headtail_by_quarters(headtail_patches, at);
    headtail_patches.mixture_weight = select(1.0, headtail_patches.mixture_weight, at.lobes.y > 0.0);
}

// What to go down the trees for: the patch that a uniform point is in, or that of a given twig.
struct HeadtailAim { z: vec2<f32>, is_given: bool, twig: u32 }

struct HeadtailFound { place: u32, mass: f32, sides: vec4<f32> }

// Down one tree: the rectangle of uniform points is cut in proportion to masses. `own` is the place of the given patch.
fn headtail_descend(root: u32, given: HeadtailStep, aim: HeadtailAim, own: u32, cuts: vec4<f32>) -> HeadtailFound {
    var step = given;
    var sides = cuts;
    var before = 0.0;
    var after = step.total;
    var split = headtail_integers[HEADTAIL_PATCHES_FOREST + root];
    while ((split & 0x1000000u) == 0u) {
        let second = split & 0x7fu;
        let middle = step.sums[max(second, 1u) - 1u];
        let fraction = (middle - before) / max(after - before, HEADTAIL_TINY);
        let is_column = (split & 0x80u) != 0u;
        let ends = select(sides.zw, sides.xy, is_column);
        let cut = ends.x + (ends.y - ends.x) * fraction;
        let lower = select(select(aim.z.y, aim.z.x, is_column) < cut, own < second, aim.is_given);
        let half = select(vec2<f32>(cut, ends.y), vec2<f32>(ends.x, cut), lower);
        sides = select(vec4<f32>(sides.xy, half), vec4<f32>(half, sides.zw), is_column);
        before = select(middle, before, lower);
        after = select(after, middle, lower);
        split = headtail_integers[HEADTAIL_PATCHES_FOREST + root + (select(split >> 16u, split >> 8u, lower) & 0xffu)];
    }
    return HeadtailFound(split & 0x7fu, after - before, sides);
}

fn headtail_part(mass: f32, total: f32) -> f32 {
    if (!(mass > 0.0 && total > 0.0)) { return 0.0; }
    return mass / total;
}

// The patch that one comes to: its rectangles of uniform points and of Y (left, right, top, bottom), and the density over Y.
struct HeadtailPatch { sides: vec4<f32>, rectangle: vec4<f32>, density: f32 }

fn headtail_walk(aim: HeadtailAim) -> HeadtailPatch {
    let at = headtail_at;
    let roots = HEADTAIL_PATCHES_ROOTS;
    let own = vec3<u32>(aim.twig / (HEADTAIL_PARTS * HEADTAIL_PARTS), aim.twig / HEADTAIL_PARTS, aim.twig) % vec3<u32>(HEADTAIL_CLUSTERS, HEADTAIL_PARTS, HEADTAIL_PARTS);
    var step = headtail_patches.step;
    var found = headtail_descend(headtail_integers[roots], step, aim, own.x, vec4<f32>(0.0, 1.0, 0.0, 1.0));
    var probability = headtail_part(found.mass, step.total);
    let cluster = found.place;
    step = headtail_sums(HEADTAIL_PATCHES_LEAVES, cluster * HEADTAIL_PARTS, at, cluster);
    found = headtail_descend(headtail_integers[roots + 1u + cluster], step, aim, own.y, found.sides);
    probability *= headtail_part(found.mass, step.total);
    let leaf = cluster * HEADTAIL_PARTS + found.place;
    var rectangle = headtail_four(HEADTAIL_PATCHES_LEAF_RECTANGLES, leaf);
    var inverse_energy = headtail_float(HEADTAIL_PATCHES_LEAVES + 16u * leaf + 14u);
    if (at.lobes.w < headtail_float(HEADTAIL_PATCHES_NARROW)) {
        step = headtail_sums(HEADTAIL_PATCHES_TWIGS, leaf * HEADTAIL_PARTS, at, HEADTAIL_CLUSTERS);
        found = headtail_descend(headtail_integers[roots + 1u + HEADTAIL_CLUSTERS + leaf], step, aim, own.z, found.sides);
        probability *= headtail_part(found.mass, step.total);
        let twig = leaf * HEADTAIL_PARTS + found.place;
        rectangle = headtail_four(HEADTAIL_PATCHES_TWIG_RECTANGLES, twig);
        inverse_energy = headtail_float(HEADTAIL_PATCHES_TWIGS + 16u * twig + 14u);
    }
    return HeadtailPatch(found.sides, rectangle, probability * inverse_energy);
}

// Where a point lies in a rectangle.
fn headtail_inside(sides: vec4<f32>, point: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(headtail_remap(point.x, sides.x, sides.y), headtail_remap(point.y, sides.z, sides.w));
}

// A place in an interval, and never its end, which belongs to the next patch.
fn headtail_within(start: f32, end: f32, inside: f32) -> f32 {
    let place = start + (end - start) * inside;
    return select(bitcast<f32>(bitcast<u32>(end) - 1u), place, place < end);
}

// The point of Y of a uniform point z, and the density over Y.
fn headtail_patches_draw(z: vec2<f32>) -> vec3<f32> {
    let found = headtail_walk(HeadtailAim(z, false, 0u));
    let inside = headtail_inside(found.sides, z);
    let r = found.rectangle;
    return vec3<f32>(headtail_within(r.x, r.y, inside.x), headtail_within(r.z, r.w, inside.y), found.density);
}

// The patch of a cell of the map.
fn headtail_patch_of(cell: vec4<f32>) -> HeadtailPatch {
    let twig = headtail_integers[HEADTAIL_PATCHES_TWIG_OF_CELL + u32(cell.y) * HEADTAIL_WIDTH + u32(cell.x)];
    return headtail_walk(HeadtailAim(vec2<f32>(0.0), true, twig));
}

// The uniform point that patches carry to a point of Y, given its cell of the map, and the density over Y there: 0 if there is no such point.
fn headtail_patches_back(cell: vec4<f32>, y: vec2<f32>) -> vec3<f32> {
    let found = headtail_patch_of(cell);
    let inside = headtail_inside(found.rectangle, y);
    let z = found.sides.xz + inside * (found.sides.yw - found.sides.xz);
    return vec3<f32>(min(z, vec2<f32>(HEADTAIL_BELOW_ONE)), found.density);
}

// The mixture weight of BSDF sampling for a lobe by its width alone.
fn headtail_of_lobe(alpha: f32) -> f32 {
    return clamp(0.5 * pow(0.05 / alpha, 1.25), 0.03, 0.9);
}

// The mixture weight beside sampling the BSDF, from that of the latter for the glossy lobe alone; 1 for diffuse surfaces.
fn headtail_mixture_weight_beside_lobe(of_lobe: f32, lobes: vec4<f32>) -> f32 {
    if (!(lobes.y > 0.0)) { return 1.0; }
    let reflected = lobes.y * max(lobes.z, 0.3);
    return 1.0 - of_lobe * reflected / (reflected + lobes.x);
}

// The same by the width of lobes alone.
fn headtail_mixture_weight_by_width(lobes: vec4<f32>) -> f32 {
    return headtail_mixture_weight_beside_lobe(headtail_of_lobe(lobes.w), lobes);
}

// The same by width and by how uneven the light is that the lobe sees: `sum` is what is reflected, `squared` the same weighted by the density of the light.
fn headtail_mixture_weight_beside_bsdf(at: HeadtailSurface, sum: f32, squared: f32) -> f32 {
    let grazing = 1.0 - max(headtail_dot(at.n, at.wo), 0.0);
    let fourth = (grazing * grazing) * (grazing * grazing);
    let albedo = at.lobes.x + at.lobes.y * (at.lobes.z + (1.0 - at.lobes.z) * (fourth * grazing));
    let all = max(sum, HEADTAIL_TINY);
    let unevenness = clamp((albedo / all) * (squared / all), 0.1, 1e6);
    let width = log(at.lobes.w);
    let odds = exp(-4.35 - 2.14 * width - 1.92 * log(unevenness));
    let least = min(0.02 * exp(3.0 * max(log(0.1) - width, 0.0)), 0.5);
    return headtail_mixture_weight_beside_lobe(max(min(odds / (1.0 + odds), headtail_of_lobe(at.lobes.w)), least), at.lobes);
}
