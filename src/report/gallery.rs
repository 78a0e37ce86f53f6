//! The pictures of a page as `data:` addresses.

use anyhow::{Context, Result};
use headtail_render::statistics::{HdrFlip, PIXELS_PER_DEGREE};

use super::comparison::{Comparison, RenderedImage};
use super::crop::Crop;
use super::picture::{self, ErrorMap, ErrorScale};
use super::radiance;
use super::summary::{Budget, Summary};
use crate::exposure;

/// Up to this number of pixels in all pictures, the page contains linear values of all, about four bytes per
/// pixel; above it, only those of the budget that is shown first.
const MOST_PIXELS: usize = 4_000_000;

/// The pictures of the page, each embedded once. Encoded pictures are reused by the next page.
#[derive(Default)]
pub struct Gallery {
    /// Exposure of all renderings in stops.
    pub exposure: f32,
    /// The reference prepared for HDR-FLIP; `None` before the first page.
    hdr_flip: Option<HdrFlip>,
    /// The reference as a `data:` address; empty before the first page.
    pub reference: String,
    /// The reference's linear values.
    pub reference_radiance: Option<String>,
    /// The budgets with pictures, in the order of the summary.
    pub panels: Vec<Panel>,
    /// Initial places of the insets, for the page's script.
    pub insets: String,
    /// Whether the page contains linear values of all pictures.
    pub all_radiance: bool,
}

/// The pictures at a budget.
pub struct Panel {
    /// The budget.
    pub budget: Budget,
    /// The scale of the error maps.
    pub scale: ErrorScale,
    /// One per sampler that has an image.
    pub pictures: Vec<Picture>,
}

/// A rendering and its error maps as `data:` addresses.
#[derive(Clone)]
pub struct Picture {
    /// The sampler.
    pub sampler: String,
    /// The tone-mapped image.
    pub rendering: String,
    /// The linear values if the page contains them, see [`radiance::encode`].
    pub radiance: Option<String>,
    /// The error map, on the scale of the panel.
    pub errors: String,
    /// The FLIP map, from 0 to 1.
    pub flip_map: String,
    /// The mean of FLIP over the measured pixels.
    pub flip: f64,
    /// The mean of HDR-FLIP over the measured pixels.
    pub hdr_flip: f64,
}

impl Gallery {
    /// Adds the new images of a comparison.
    ///
    /// # Errors
    /// If an image differs in size from the reference.
    pub fn update(&mut self, comparison: &Comparison, summary: &Summary) -> Result<()> {
        if self.reference.is_empty() {
            self.exposure = exposure::of_image(&comparison.reference, &comparison.measured);
            self.hdr_flip = Some(HdrFlip::new(&comparison.reference, PIXELS_PER_DEGREE)?);
            self.reference = picture::rendering(&comparison.reference, self.exposure)?;
            self.reference_radiance = Some(radiance::encode(&comparison.reference, self.exposure)?);
        }
        let mut known = std::mem::take(&mut self.panels);
        for budget in &summary.budgets {
            let images: Vec<&RenderedImage> = summary
                .at(&budget.name)
                .filter_map(|group| {
                    comparison.images.iter().find(|i| i.sampler == group.sampler && i.budget == group.budget)
                })
                .collect();
            let panel = known.iter().position(|panel| panel.budget == *budget).map(|at| known.swap_remove(at));
            match panel {
                // A sampler has one image per budget, so equal counts mean the same images.
                Some(panel) if panel.pictures.len() == images.len() => self.panels.push(panel),
                _ if images.is_empty() => {}
                _ => {
                    let known = panel.map(|panel| panel.pictures).unwrap_or_default();
                    self.panels.push(self.panel_of(budget, &images, comparison, &known)?);
                }
            }
        }
        self.add_radiance(comparison, summary)?;
        self.insets = insets(comparison, summary);
        Ok(())
    }

    /// Adds linear values to pictures within the page's limit.
    fn add_radiance(&mut self, comparison: &Comparison, summary: &Summary) -> Result<()> {
        self.all_radiance = comparison.images.len() * comparison.width * comparison.height <= MOST_PIXELS;
        let first = self.shown_first(summary).map(|panel| panel.budget.clone());
        for panel in &mut self.panels {
            let wanted = self.all_radiance || first.as_ref() == Some(&panel.budget);
            for picture in &mut panel.pictures {
                if !wanted {
                    picture.radiance = None;
                } else if picture.radiance.is_none() {
                    let of = |i: &&RenderedImage| i.sampler == picture.sampler && i.budget == panel.budget.name;
                    let image = comparison.images.iter().find(of);
                    picture.radiance = image.map(|image| radiance::encode(&image.image, self.exposure)).transpose()?;
                }
            }
        }
        Ok(())
    }

    fn panel(&self, budget: &str) -> Option<&Panel> {
        self.panels.iter().find(|panel| panel.budget.name == budget)
    }

    fn picture(&self, sampler: &str, budget: &str) -> Option<&Picture> {
        self.panel(budget)?.pictures.iter().find(|picture| picture.sampler == sampler)
    }

    /// Returns whether a sampler has a picture at a budget.
    pub fn has(&self, sampler: &str, budget: &str) -> bool {
        self.picture(sampler, budget).is_some()
    }

    /// Returns FLIP and HDR-FLIP of a sampler's picture at a budget.
    pub fn flips(&self, sampler: &str, budget: &str) -> Option<[f64; 2]> {
        self.picture(sampler, budget).map(|picture| [picture.flip, picture.hdr_flip])
    }

    /// The budget whose pictures are shown first.
    pub fn shown_first(&self, summary: &Summary) -> Option<&Panel> {
        self.panel(&summary.shown_first().name).or(self.panels.last())
    }

    /// Returns the pictures of a budget, reusing those in `known`.
    fn panel_of(
        &self,
        budget: &Budget,
        images: &[&RenderedImage],
        comparison: &Comparison,
        known: &[Picture],
    ) -> Result<Panel> {
        let error_map = |image: &&RenderedImage| ErrorMap::of(&image.image, comparison);
        let maps = images.iter().map(error_map).collect::<Result<Vec<_>>>()?;
        let scale = ErrorScale::of(maps.iter());
        let picture = |(rendered, map): (&&RenderedImage, &ErrorMap)| {
            let errors = map.picture(&scale)?;
            if let Some(known) = known.iter().find(|known| known.sampler == rendered.sampler) {
                return Ok(Picture { errors, ..known.clone() });
            }
            let (flips, flip) = ErrorMap::of_flip(&rendered.image, comparison, self.exposure)?;
            let reference = self.hdr_flip.as_ref().context("a page without a reference")?;
            Ok(Picture {
                sampler: rendered.sampler.clone(),
                rendering: picture::rendering(&rendered.image, self.exposure)?,
                radiance: None,
                errors,
                flip_map: flips.fraction_picture()?,
                flip,
                hdr_flip: comparison.mean_of_measured(&reference.of(&rendered.image)?),
            })
        };
        let pictures = images.iter().zip(&maps).map(picture).collect::<Result<Vec<_>>>()?;
        Ok(Panel { budget: budget.clone(), scale, pictures })
    }
}

/// Places insets where the baseline is worst at the budget that is shown first; without its picture, where
/// the last picture is.
fn insets(comparison: &Comparison, summary: &Summary) -> String {
    let budget = &summary.shown_first().name;
    let of = |i: &&RenderedImage| i.budget == *budget && i.sampler == summary.baseline;
    let Some(shown) = comparison.images.iter().find(of).or(comparison.images.last()) else { return String::new() };
    let crops = Crop::two_worst(&shown.image, &comparison.reference, &comparison.measured);
    crops.map(|crop| crop.attribute((comparison.width, comparison.height))).join(";")
}
