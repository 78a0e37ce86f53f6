//! Portals as flat lists, for implementations on other devices.

use std::sync::Arc;

use super::{
    image::PortalImage,
    sampler::{Opening, PortalSampler},
};
use crate::flat::FlatArray;

impl PortalSampler {
    /// Returns all arrays that sampling and pdf read.
    ///
    /// - `portals.rectangles` `[portals, 14]`: the axes of width, height and normal; the middle along each of them; half
    ///   the size.
    /// - `portals.image` `[portals]`: the number of the image of each.
    /// - `portals.sums` `[images, side + 1, side + 1]`: the sums of pixels below and left of each corner of an image.
    pub fn flat(&self) -> Vec<FlatArray> {
        let (mut images, mut numbers): (Vec<&Arc<PortalImage>>, Vec<u32>) = Default::default();
        for opening in &self.openings {
            let known = images.iter().position(|image| Arc::ptr_eq(image, &opening.image));
            numbers.push(known.unwrap_or(images.len()) as u32);
            if known.is_none() {
                images.push(&opening.image);
            }
        }
        let rectangle = |own: &Opening| {
            let middle = own.axes.map(|axis| own.portal.center.dot(axis.into()));
            own.axes.into_iter().flatten().chain(middle).chain(own.half)
        };
        let rectangles = self.openings.iter().flat_map(rectangle).collect();
        let side = images.first().map_or(0, |image| image.sums().len().isqrt());
        let sums = images.iter().flat_map(|image| image.sums()).copied().collect();
        vec![
            FlatArray::floats("portals.rectangles", vec![numbers.len(), 14], rectangles),
            FlatArray::integers("portals.image", vec![numbers.len()], numbers),
            FlatArray::integers("portals.sums", vec![images.len(), side, side], sums),
        ]
    }
}
