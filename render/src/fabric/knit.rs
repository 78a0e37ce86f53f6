//! Knitted cloth: courses of loops along u, each pulled through the loops of the course below it.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::yarn::{Section, TriangleSoup, irregular};

/// Segments along a loop and around the yarn.
const STEPS: [usize; 2] = [36, 14];

/// A plain knit of one yarn, with the legs of the loops on the visible side.
///
/// A course is the curve `(t / TAU + overhang sin 2t, height cos t, -depth cos 2t)` with one loop per
/// turn of `t`: heads (t = 0) and feet (t = pi) lie at the back, legs in front. Legs cross the feet of
/// the course above and the heads of the course below, in front of both.
pub struct Knit {
    /// Loops along u and courses along v per tile.
    pub loops: [usize; 2],
    /// How much wider a loop is than its neck, as a fraction of the loop's width.
    pub overhang: f32,
    /// Half the height of a loop, in courses.
    pub height: f32,
    /// Half the distance between legs and heads along z, in tiles; `middle` is the mean height of both.
    pub depth: f32,
    pub middle: f32,
    pub section: Section,
}

impl Knit {
    /// Adds the courses of one tile to `soup`.
    pub fn build(&self, soup: &mut TriangleSoup) {
        let [wales, courses] = self.loops;
        let (wide, high) = (1.0 / wales as f32, 1.0 / courses as f32);
        for course in 0..courses {
            let y = (course as f32 + 0.5) * high;
            let phase = TAU * irregular(course, 3);
            // Perturbs each loop differently.
            let uneven = |s: f32| 0.04 * high * ((TAU * s + phase).sin() + (TAU * 2.0 * s + 2.0 * phase).cos());
            let path = |s: f32| {
                let t = TAU * wales as f32 * s;
                let x = s + wide * self.overhang * (2.0 * t).sin();
                let y = y + self.height * high * t.cos() + uneven(s);
                Vec3::new(x, y, self.middle - self.depth * (2.0 * t).cos())
            };
            soup.sweep(path, &self.section, |_| 1.0, [STEPS[0] * wales, STEPS[1]]);
        }
    }
}

/// Returns a jersey of three-ply woollen yarn.
pub fn jersey() -> Knit {
    Knit {
        loops: [5, 7],
        overhang: 0.23,
        height: 0.85,
        depth: 0.033,
        middle: 0.062,
        section: Section { radii: Vec2::splat(0.026), plies: 3.0, groove: 0.25, twist: 15.0 },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the yarn's centre line of a course after `turn` loops.
    fn middle(knit: &Knit, turn: f32, course: f32) -> Vec3 {
        let [wales, courses] = knit.loops.map(|count| count as f32);
        let t = TAU * turn;
        Vec3::new(
            (turn + knit.overhang * (2.0 * t).sin()) / wales,
            (course + knit.height * t.cos()) / courses,
            -knit.depth * (2.0 * t).cos(),
        )
    }

    #[test]
    fn courses_interlock_without_intersecting() {
        let knit = jersey();
        const STEPS: usize = 1500;
        let place = |k: usize| k as f32 / STEPS as f32;
        let thickness = 2.0 * knit.section.radii.max_element();
        let (mut nearest, mut crossings) = (f32::INFINITY, Vec::new());
        for a in 0..STEPS {
            for b in 0..STEPS {
                let (lower, upper) = (middle(&knit, place(a), 0.0), middle(&knit, place(b), 1.0));
                nearest = nearest.min((lower - upper).length());
                if (lower - upper).truncate().length() < 6e-4 {
                    crossings.push((place(a), lower.z > upper.z));
                }
            }
        }
        // Touching yarns interpenetrate by less than 20 % of their thickness.
        assert!(nearest > 0.8 * thickness, "{nearest} {thickness}");
        // From head to head: the head lies behind the legs of the loop through it, and both legs lie in
        // front of the adjacent feet.
        crossings.sort_by(|a, b| a.0.total_cmp(&b.0));
        crossings.dedup_by(|a, b| a.1 == b.1);
        assert_eq!(
            crossings.iter().map(|crossing| crossing.1).collect::<Vec<_>>(),
            [false, true, false],
            "{crossings:?}"
        );
    }
}
