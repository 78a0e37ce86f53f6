//! Rivals as samplers of scenes.

use std::{path::Path, sync::Arc};

use super::{Rival, RivalKind, file::RivalFile};
use crate::{
    brdf::{Brdf, BrdfTable},
    columns::Arena,
    error::{Error, Result},
    sampler::{Coverage, Draws, Sampler},
    simd::Lanes,
    tile::{Rows, gather_all, scatter_all},
};

/// The samplers of a file, for points of the materials that they were trained for; BRDF sampling elsewhere.
#[derive(Clone, Debug)]
pub struct RivalSampler {
    rivals: Arc<[(blake3::Hash, Rival)]>,
}

impl RivalSampler {
    /// Creates a sampler from several, each with the identity of its material.
    pub fn new(rivals: Vec<(blake3::Hash, Rival)>) -> Self {
        Self { rivals: rivals.into() }
    }

    /// Reads a file of samplers of one of `kinds`.
    ///
    /// # Errors
    /// The file cannot be read, or holds another kind.
    pub fn open(path: &Path, kinds: &[RivalKind]) -> Result<Self> {
        let file = RivalFile::read(path)?;
        if !kinds.contains(&file.kind) {
            let names = kinds.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(" or ");
            return Err(Error::invalid(path, "kind", format!("is '{}'; {names} is expected", file.kind.name())));
        }
        Ok(Self::new(file.rivals.into_iter().map(|(_, identity, rival)| (identity, rival)).collect()))
    }

    /// Checks that a scene's table has at least one of the materials.
    ///
    /// # Errors
    /// The table has none of them: all directions would come from BRDF sampling.
    pub fn check(&self, brdfs: &BrdfTable) -> Result<()> {
        let is_there = brdfs.added().any(|brdf| self.of(&**brdf).is_some());
        let reason = "was trained for a material that the scene does not have";
        if is_there { Ok(()) } else { Err(Error::argument("sampler", reason)) }
    }

    fn of(&self, brdf: &dyn Brdf) -> Option<&Rival> {
        let identity = brdf.identity()?;
        self.rivals.iter().find(|(known, _)| *known == identity).map(|(_, rival)| rival)
    }
}

impl Sampler for RivalSampler {
    fn sample(&self, at: &Rows<'_>, _state: &[Lanes], u: [&[Lanes]; 2], mut out: Draws<'_>, arena: &Arena) {
        at.by_brdf(arena, |group| {
            let draw = |u: [&[Lanes]; 2], wi: [&mut [Lanes]; 3], pdf: &mut [Lanes]| match self.of(group.brdf) {
                Some(rival) => rival.sample(group.brdf, &group.surfaces, u, wi, pdf, arena),
                None => group.brdf.sample(&group.surfaces, u, wi, pdf),
            };
            let [x, y, z] = &mut out.wi;
            match group.places {
                None => draw(u, [x, y, z], out.pdf),
                Some(places) => {
                    let (mut own, mut drawn) = (arena.columns::<2>(group.strips), arena.columns::<4>(group.strips));
                    gather_all(u, places, own.get_mut());
                    let [a, b, c, d] = drawn.get_mut();
                    draw(own.get(), [a, b, c], d);
                    scatter_all(drawn.get(), places, [x, y, z, out.pdf]);
                }
            }
        });
    }

    fn pdf(&self, at: &Rows<'_>, _state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        at.by_brdf(arena, |group| {
            let pdf = |wi: [&[Lanes]; 3], out: &mut [Lanes]| match self.of(group.brdf) {
                Some(rival) => rival.pdf(group.brdf, &group.surfaces, wi, out, arena),
                None => group.brdf.pdf(&group.surfaces, wi, out),
            };
            match group.places {
                None => pdf(wi, out),
                Some(places) => {
                    let [mut own, mut pdfs] = [arena.columns::<3>(group.strips), arena.columns::<3>(group.strips)];
                    gather_all(wi, places, own.get_mut());
                    pdf(own.get(), pdfs.get_mut()[0]);
                    scatter_all([pdfs.get()[0]], places, [out]);
                }
            }
        });
    }

    fn coverage(&self) -> Coverage {
        Coverage::Everything
    }
}
