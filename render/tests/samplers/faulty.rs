//! Deliberately broken samplers fail the checks that the others pass.

use glam::Quat;
use headtail_render::{simd::Lanes, tile::Rows};

use super::*;

/// A correct sampler with a fault.
struct Faulty<S> {
    sampler: S,
    fault: Fault,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// The pdfs of samples and of directions are both 2 % too large.
    ClaimsMore,
    /// Only the pdf of directions is too large: MIS weights would be wrong.
    PdfClaimsMore,
    /// Directions within 20 degrees of the zenith are never drawn and have pdf 0.
    LeavesOut,
    /// Draws with the table of a normal 6 degrees away, as a bake would that draws from the nearest node and
    /// returns the interpolated pdf.
    DrawsFromNeighbour,
}

impl<S: Sampler> Faulty<S> {
    fn has_lost(&self, wi: [&[Lanes]; 3], place: usize) -> bool {
        self.fault == Fault::LeavesOut && wi[1].as_flattened()[place] > 0.94
    }
}

impl<S: Sampler> Sampler for Faulty<S> {
    fn columns(&self) -> usize {
        self.sampler.columns()
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        self.sampler.prepare(at, state, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], Draws { wi, pdf }: Draws<'_>, arena: &Arena) {
        let [x, y, z] = wi;
        let out = Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *pdf };
        if self.fault == Fault::DrawsFromNeighbour {
            let turned = |place: usize| {
                let own = at.point(place);
                ShadingPoint { ns: Quat::from_rotation_x(0.105) * own.ns, ..own }
            };
            let neighbours = Tile::of(&(0..at.len()).map(turned).collect::<Vec<_>>());
            let rows = neighbours.rows();
            prepared(&self.sampler, &rows, arena, |other| self.sampler.sample(&rows, other, u, out, arena));
            self.sampler.pdf(at, state, [x, y, z], pdf, arena);
        } else {
            self.sampler.sample(at, state, u, out, arena);
        }
        for place in 0..at.len() {
            let lost = self.has_lost([x, y, z], place);
            let pdf = &mut pdf.as_flattened_mut()[place];
            *pdf *= if lost { 0.0 } else { 1.0 };
            *pdf *= if self.fault == Fault::ClaimsMore { 1.02 } else { 1.0 };
        }
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        self.sampler.pdf(at, state, wi, out, arena);
        let claims_more = matches!(self.fault, Fault::ClaimsMore | Fault::PdfClaimsMore);
        for place in 0..at.len() {
            let lost = self.has_lost(wi, place);
            let pdf = &mut out.as_flattened_mut()[place];
            *pdf *= if lost { 0.0 } else { 1.0 };
            *pdf *= if claims_more { 1.02 } else { 1.0 };
        }
    }

    fn coverage(&self) -> Coverage {
        self.sampler.coverage()
    }
}

#[test]
fn broken_samplers_are_detected() {
    let world = WORLDS.iter().find(|world| world.name.starts_with("overcast")).unwrap();
    let at = shading_point(Vec3A::new(0.4, 0.8, -0.3).normalize());
    let table =
        direct_bake(world.light.tail(), NormalGrid::new(16, 32).unwrap(), CellGrid::new(32, 32).unwrap()).unwrap();
    let truth = world.quadrature.reflected(at.ns);
    // Each fault with the checks that must detect it: 0 chi-square and mass, 1 pdf of samples, 2 coverage, 3
    // mean.
    let expected: [(Fault, &[usize]); 5] = [
        (Fault::None, &[]),
        (Fault::ClaimsMore, &[0, 3]),
        (Fault::PdfClaimsMore, &[0, 1]),
        (Fault::LeavesOut, &[2, 3]),
        (Fault::DrawsFromNeighbour, &[0]),
    ];
    for (fault, finders) in expected {
        let sampler = Faulty { sampler: ProductSampler::new(world.light.clone(), table.clone()), fault };
        let bound = AtPoint::new(&sampler, &at);
        let verdicts = [
            draws_follow_pdf(&bound, None, 2, 150),
            pdf_of_samples_agrees(&bound, 10_000),
            pdf_covers(&bound, world),
            mean_of_sampler(&bound, world, truth, 50_000, 450),
        ];
        assert!(finders.iter().all(|&check| verdicts[check].is_err()), "{fault:?} was not found: {verdicts:?}");
        assert!(fault != Fault::None || verdicts.iter().all(Verdict::is_ok), "{verdicts:?}");
    }
}
