//! Knitted cloth: courses of loops along u, each pulled through the loops of the course below it.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::yarn::{Section, Strands, irregular};

/// Pieces of a loop, and around the yarn.
const STEPS: [usize; 2] = [36, 14];

/// A plain knit of one yarn, seen from the side of its legs.
///
/// A course is the curve `(t / TAU + overhang sin 2t, height cos t, -depth cos 2t)`, one loop for a turn of `t`: heads (t = 0) and feet (t = pi) lie at the back,
/// legs in front. Where a leg crosses the foot of the course above, and the head of its own course a leg of that one, the leg is the nearer of the two.
pub struct Knit {
    /// Loops along u and courses along v, in a tile.
    pub loops: [usize; 2],
    /// By how much a loop is wider than its neck, as a part of a loop's width.
    pub overhang: f32,
    /// Half of a loop's height, in courses.
    pub height: f32,
    /// Half of what legs lie in front of heads, and the height of the middle between them, in tiles.
    pub depth: f32,
    pub middle: f32,
    pub section: Section,
}

impl Knit {
    /// Adds the courses of a tile to the strands.
    pub fn build(&self, strands: &mut Strands) {
        let [wales, courses] = self.loops;
        let (wide, high) = (1.0 / wales as f32, 1.0 / courses as f32);
        for course in 0..courses {
            let y = (course as f32 + 0.5) * high;
            let phase = TAU * irregular(course, 3);
            // No two loops are pulled alike.
            let uneven = |s: f32| 0.04 * high * ((TAU * s + phase).sin() + (TAU * 2.0 * s + 2.0 * phase).cos());
            let path = |s: f32| {
                let t = TAU * wales as f32 * s;
                let x = s + wide * self.overhang * (2.0 * t).sin();
                let y = y + self.height * high * t.cos() + uneven(s);
                Vec3::new(x, y, self.middle - self.depth * (2.0 * t).cos())
            };
            strands.sweep(path, &self.section, |_| 1.0, [STEPS[0] * wales, STEPS[1]]);
        }
    }
}

/// A jersey of woollen yarn of three plies.
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

    /// The middle of the yarn of a course at a place in turns.
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
    fn courses_hold_each_other_and_do_not_meet() {
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
        // Yarns are pressed where they touch, by less than a fifth.
        assert!(nearest > 0.8 * thickness, "{nearest} {thickness}");
        // From head to head: the head is behind the legs that come out of it, both legs are in front of the feet beside them.
        crossings.sort_by(|a, b| a.0.total_cmp(&b.0));
        crossings.dedup_by(|a, b| a.1 == b.1);
        assert_eq!(
            crossings.iter().map(|crossing| crossing.1).collect::<Vec<_>>(),
            [false, true, false],
            "{crossings:?}"
        );
    }
}
