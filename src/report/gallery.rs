//! The pictures of a page as `data:` addresses.

use anyhow::Result;

use super::picture::{self, ErrorMap, ErrorScale};
use super::summary::{Budget, Summary};
use super::{Comparison, RenderedImage};

/// The pictures of the page, each embedded once. What is encoded is kept from one page to the next.
#[derive(Default)]
pub struct Gallery {
    /// Exposure of all renderings in stops.
    pub exposure: f32,
    /// The reference as a `data:` address; empty before the first page.
    pub reference: String,
    /// The budgets that have pictures, in the order of the summary.
    pub panels: Vec<Panel>,
}

/// The pictures at a budget.
pub struct Panel {
    /// The budget.
    pub budget: Budget,
    /// What the colours of the error maps mean.
    pub scale: ErrorScale,
    /// One for each sampler that has an image.
    pub pictures: Vec<Picture>,
}

/// A rendering and its error map as `data:` addresses.
pub struct Picture {
    /// The sampler.
    pub sampler: String,
    /// The tone-mapped image.
    pub rendering: String,
    /// The error map, on the scale of the panel.
    pub errors: String,
}

impl Gallery {
    /// Adds the images that are new in a comparison.
    ///
    /// # Errors
    /// If an image is not of the size of the reference.
    pub fn update(&mut self, comparison: &Comparison, summary: &Summary) -> Result<()> {
        if self.reference.is_empty() {
            self.exposure = picture::exposure(&comparison.reference);
            self.reference = picture::rendering(&comparison.reference, self.exposure)?;
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
                // A sampler has one image at a budget, so that an equal number is the same images.
                Some(panel) if panel.pictures.len() == images.len() => self.panels.push(panel),
                _ if images.is_empty() => {}
                _ => self.panels.push(Panel::of(budget, &images, comparison, self.exposure)?),
            }
        }
        Ok(())
    }

    fn panel(&self, budget: &str) -> Option<&Panel> {
        self.panels.iter().find(|panel| panel.budget.name == budget)
    }

    /// Whether there is a picture of a sampler at a budget.
    pub fn has(&self, sampler: &str, budget: &str) -> bool {
        self.panel(budget).is_some_and(|panel| panel.pictures.iter().any(|picture| picture.sampler == sampler))
    }

    /// The budget whose pictures are shown first.
    pub fn shown_first(&self, summary: &Summary) -> Option<&Panel> {
        self.panel(&summary.shown_first().name).or(self.panels.last())
    }
}

impl Panel {
    fn of(budget: &Budget, images: &[&RenderedImage], comparison: &Comparison, exposure: f32) -> Result<Self> {
        let error_map = |image: &&RenderedImage| ErrorMap::of(&image.image, comparison);
        let maps = images.iter().map(error_map).collect::<Result<Vec<_>>>()?;
        let scale = ErrorScale::of(maps.iter());
        let picture = |(rendered, map): (&&RenderedImage, &ErrorMap)| {
            Ok(Picture {
                sampler: rendered.sampler.clone(),
                rendering: picture::rendering(&rendered.image, exposure)?,
                errors: map.picture(&scale)?,
            })
        };
        let pictures = images.iter().zip(&maps).map(picture).collect::<Result<Vec<_>>>()?;
        Ok(Self { budget: budget.clone(), scale, pictures })
    }
}
