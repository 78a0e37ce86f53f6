//! Compact emitters of a map: the sun and lamps, small and far brighter than what is around them.

use std::f32::consts::PI;

use glam::{Vec2, Vec3A};

use crate::latlong;

/// Most emitters that are taken out of a map.
const MOST_EMITTERS: usize = 4;
/// An emitter is made of texels that have at least this share of its brightest one's luminance, ...
const LEAST_OF_PEAK: f32 = 0.02;
/// ... and at least this many times the mean luminance of the map.
const LEAST_OVER_MEAN: f64 = 16.0;
/// Largest angle in radians from its centre: beyond it a cosine or a lobe changes over the emitter.
const LARGEST_RADIUS: f32 = 0.09;
/// Least share of the map's light. Fainter lamps gain less than their own samples cost.
const LEAST_SHARE: f64 = 0.03;
/// Where less than this share of the light is left, the emitters are the map, and a tail alone samples them.
const LEAST_REST: f64 = 1e-3;

/// The luminance `[height * width]` of a map whose compact emitters are brought down to what surrounds them; `None` where there is no
/// compact emitter, or nothing else.
///
/// The difference to the map is the emitters' own luminance. Both are luminances of bilinear maps, and their sum is the map's.
pub fn without_compact_emitters(width: usize, height: usize, luminance: &[f32]) -> Option<Vec<f32>> {
    let grid = Grid { width, height };
    let light = |values: &[f32]| -> f64 { (0..values.len()).map(|k| f64::from(values[k]) * grid.solid_angle(k)).sum() };
    let total = light(luminance);
    let mean = total / (0..luminance.len()).map(|k| grid.solid_angle(k)).sum::<f64>();
    let mut rest = luminance.to_vec();
    let mut found = false;
    for _ in 0..MOST_EMITTERS {
        let peak = (0..rest.len()).max_by(|&a, &b| rest[a].total_cmp(&rest[b]))?;
        let threshold = (rest[peak] * LEAST_OF_PEAK).max((LEAST_OVER_MEAN * mean) as f32);
        if rest[peak] <= threshold {
            break;
        }
        let (inside, border) = grid.region(peak, |k| rest[k] > threshold);
        if grid.radius(&inside, &rest) > LARGEST_RADIUS || border.is_empty() {
            break;
        }
        let around = border.iter().map(|&k| rest[k]).sum::<f32>() / border.len() as f32;
        let excess = |k: usize| (rest[k] - around).max(0.0);
        if inside.iter().map(|&k| f64::from(excess(k)) * grid.solid_angle(k)).sum::<f64>() < LEAST_SHARE * total {
            break;
        }
        for &k in &inside {
            rest[k] = rest[k].min(around);
        }
        found = true;
    }
    (found && light(&rest) > LEAST_REST * total).then_some(rest)
}

/// The emitters of a map that was brought down to `rest`: one luminance `[height * width]` for each connected set of texels that are
/// brighter in the map. `None` if they are more than `MOST_EMITTERS`, or none.
pub fn compact_emitters(width: usize, height: usize, luminance: &[f32], rest: &[f32]) -> Option<Vec<Vec<f32>>> {
    let grid = Grid { width, height };
    let mut left: Vec<f32> = luminance.iter().zip(rest).map(|(map, rest)| (map - rest).max(0.0)).collect();
    let mut emitters = Vec::new();
    for seed in 0..left.len() {
        if left[seed] <= 0.0 {
            continue;
        }
        if emitters.len() == MOST_EMITTERS {
            return None;
        }
        let (inside, _) = grid.region(seed, |k| left[k] > 0.0);
        let mut emitter = vec![0.0; left.len()];
        for k in inside {
            emitter[k] = std::mem::take(&mut left[k]);
        }
        emitters.push(emitter);
    }
    (!emitters.is_empty()).then_some(emitters)
}

/// The texels of a map as a graph: columns are periodic, and all texels of a pole row touch each other.
#[derive(Clone, Copy)]
struct Grid {
    width: usize,
    height: usize,
}

impl Grid {
    /// The direction of a texel's centre.
    fn direction(self, texel: usize) -> Vec3A {
        let (column, row) = (texel % self.width, texel / self.width);
        let u = (column as f32 + 0.5) / self.width as f32;
        latlong::direction(Vec2::new(u, row as f32 / (self.height - 1) as f32))
    }

    /// The solid angle of a texel, to a common factor; pole rows have that of their half cells.
    fn solid_angle(self, texel: usize) -> f64 {
        let step = f64::from(PI) / (self.height - 1) as f64;
        let theta = (texel / self.width) as f64 * step;
        ((theta - step / 2.0).max(0.0)).cos() - (theta + step / 2.0).min(f64::from(PI)).cos()
    }

    /// Whether all texels of a row touch each other.
    fn is_pole(self, row: usize) -> bool {
        row == 0 || row == self.height - 1
    }

    /// Calls `visit` with the texels around one; of a pole row's own, only where `whole_pole` asks for them.
    fn neighbours(self, texel: usize, whole_pole: bool, mut visit: impl FnMut(usize)) {
        let (column, row) = (texel % self.width, texel / self.width);
        for near in row.saturating_sub(1)..=(row + 1).min(self.height - 1) {
            let start = near * self.width;
            if near != row || !self.is_pole(row) {
                for across in [self.width - 1, 0, 1] {
                    visit(start + (column + across) % self.width);
                }
            } else if whole_pole {
                (start..start + self.width).for_each(&mut visit);
            }
        }
    }

    /// The connected texels around `seed` that belong, and those next to them that do not; linear in the number of texels.
    fn region(self, seed: usize, belongs: impl Fn(usize) -> bool) -> (Vec<usize>, Vec<usize>) {
        let mut seen = vec![false; self.width * self.height];
        let (mut inside, mut border) = (vec![seed], Vec::new());
        seen[seed] = true;
        // The first texel of a pole row brings in all others of it.
        let mut poles_seen = [false; 2];
        let mut next = 0;
        while let Some(&texel) = inside.get(next) {
            next += 1;
            let row = texel / self.width;
            let whole_pole = self.is_pole(row) && !std::mem::replace(&mut poles_seen[usize::from(row > 0)], true);
            self.neighbours(texel, whole_pole, |near| {
                if std::mem::replace(&mut seen[near], true) {
                    return;
                }
                if belongs(near) { inside.push(near) } else { border.push(near) }
            });
        }
        (inside, border)
    }

    /// The largest angle from the centre of light.
    fn radius(self, texels: &[usize], luminance: &[f32]) -> f32 {
        let centre: Vec3A =
            texels.iter().map(|&k| self.direction(k) * (f64::from(luminance[k]) * self.solid_angle(k)) as f32).sum();
        let centre = centre.normalize_or_zero();
        texels.iter().map(|&k| self.direction(k).dot(centre).clamp(-1.0, 1.0).acos()).fold(0.0, f32::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::built_in;

    fn split(map: &str) -> Option<(Vec<f32>, Vec<f32>)> {
        let map = built_in(map).unwrap();
        let luminance = map.luminance();
        without_compact_emitters(map.width(), map.height(), &luminance).map(|rest| (luminance, rest))
    }

    #[test]
    fn a_sun_is_taken_out_and_the_sky_is_left() {
        let (map, rest) = split("sunset").unwrap();
        assert!(map.iter().zip(&rest).all(|(map, rest)| rest <= map && *rest >= 0.0));
        let brightest = |values: &[f32]| values.iter().copied().fold(0.0, f32::max);
        assert!(brightest(&rest) < 0.05 * brightest(&map));
        let changed = map.iter().zip(&rest).filter(|(map, rest)| map != rest).count();
        assert!((1..200).contains(&changed), "{changed}");
        let emitters = compact_emitters(512, 256, &map, &rest).unwrap();
        let sums: f32 = emitters.iter().flatten().sum();
        let differences: f32 = map.iter().zip(&rest).map(|(map, rest)| map - rest).sum();
        assert!((sums / differences - 1.0).abs() < 1e-3);
    }

    #[test]
    fn maps_without_small_bright_lights_are_left_whole() {
        assert!(split("overcast").is_none() && split("window").is_none());
        assert!(without_compact_emitters(8, 5, &[1.0; 40]).is_none());
        // A single lit texel is all there is.
        let mut lit = vec![0.0; 64 * 32];
        lit[700] = 5.0;
        assert!(without_compact_emitters(64, 32, &lit).is_none());
    }

    #[test]
    fn a_sun_on_the_seam_or_at_the_pole_is_one_emitter() {
        for texels in [vec![16 * 64, 16 * 64 + 63, 17 * 64], (0..64).collect()] {
            let mut map = vec![1.0; 64 * 32];
            for k in texels {
                map[k] = 1e5;
            }
            // At the pole the row of texels is one small disc.
            let rest = without_compact_emitters(64, 32, &map).unwrap();
            assert_eq!(compact_emitters(64, 32, &map, &rest).unwrap().len(), 1);
            assert!(rest.iter().all(|&value| value == 1.0));
        }
    }

    #[test]
    fn wide_pole_rows_take_linear_time() {
        // With every texel of a pole asking for all others, this map would take 2^44 steps.
        let width = 1 << 22;
        let mut map = vec![1.0; 2 * width];
        map[..width].fill(1e5);
        let grid = Grid { width, height: 2 };
        let (inside, border) = grid.region(width - 1, |k| map[k] > 2.0);
        assert_eq!((inside.len(), border.len()), (width, width));
        let emitters = compact_emitters(width, 2, &map, &vec![1.0; 2 * width]).unwrap();
        assert!(emitters.len() == 1 && emitters[0][width / 2] == 1e5 - 1.0 && emitters[0][width] == 0.0);
    }

    #[test]
    fn too_many_emitters_are_none() {
        let mut map = vec![1.0; 64 * 32];
        for k in 0..6 {
            map[64 * 15 + 10 * k] = 2.0;
        }
        assert!(compact_emitters(64, 32, &map, &[1.0; 64 * 32]).is_none());
        assert!(compact_emitters(64, 32, &map, &map).is_none());
    }
}
