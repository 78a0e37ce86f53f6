//! The layers of a composite over the photograph.

use glam::Vec3A;

use super::{film::Film, mask::Mask};
use crate::{
    error::Result,
    image::{Attribute, Channel, Image, Photograph, encode_layered_exr},
};

/// Layers over a photograph, all in its units: `composite = object + (1 - alpha) (photograph x shadow + light)`.
#[derive(Clone, Debug)]
pub struct Layers {
    /// The object, premultiplied by its alpha.
    pub object: Image,
    /// Fraction of each pixel that the object covers, `[height * width]`.
    pub alpha: Vec<f32>,
    /// Factor of the visible photograph; 1 where no shadow falls.
    pub shadow: Image,
    /// Light that the object reflects onto the photographed surface.
    pub light: Image,
    /// The photograph; finite where the object changes it.
    pub photograph: Image,
}

impl Layers {
    /// Builds the layers from a film and its mask. The photograph must have the film's size; its values times
    /// `gain`, per channel, are radiance in the map's units.
    pub fn new(film: &Film, mask: &Mask, photograph: &Photograph, gain: Vec3A, in_color: bool) -> Self {
        let (width, height, spp) = (film.width, film.height, f64::from(film.spp.max(1)));
        let black = || Image::black(width, height);
        let mut layers = Self {
            object: black(),
            alpha: vec![0.0; width * height],
            shadow: Image { width, height, pixels: vec![[1.0; 3]; width * height] },
            light: black(),
            photograph: photograph.image.clone(),
        };
        for (index, (catcher, object)) in film.catcher.iter().zip(&film.object).enumerate() {
            layers.alpha[index] = (f64::from(object.0) / spp) as f32;
            layers.object.pixels[index] = (object.1 / (spp * gain.as_dvec3())).as_vec3().to_array();
            let rest = f64::from(film.spp - object.0);
            if rest > 0.0 {
                let fraction = (f64::from(catcher.hits) / rest) as f32;
                let [red, green, blue, grey] = mask.values[index];
                let mask = if in_color { [red, green, blue] } else { [grey; 3] };
                layers.shadow.pixels[index] = mask.map(|mask| 1.0 + fraction * (mask - 1.0));
                let behind = photograph.finite(index).max(Vec3A::ZERO);
                let light = Vec3A::from((catcher.thrown_back / rest).as_vec3());
                layers.light.pixels[index] = (behind * light).to_array();
            }
            // Other pixels keep infinite values and NaN.
            if layers.changes(index) {
                layers.photograph.pixels[index] = photograph.finite(index).to_array();
            }
        }
        layers
    }

    /// Whether the composite differs from the photograph in a pixel.
    fn changes(&self, index: usize) -> bool {
        self.alpha[index] != 0.0 || self.shadow.pixels[index] != [1.0; 3] || self.light.pixels[index] != [0.0; 3]
    }

    /// Combines the layers into the composite.
    pub fn composite(&self) -> Image {
        let pixel = |index: usize| {
            let [object, shadow, light, behind] = [&self.object, &self.shadow, &self.light, &self.photograph]
                .map(|image| Vec3A::from_array(image.pixels[index]));
            (object + (1.0 - self.alpha[index]) * (behind * shadow + light)).to_array()
        };
        Image { pixels: (0..self.alpha.len()).map(pixel).collect(), ..self.object }
    }

    /// Encodes an OpenEXR file with the composite as R, G, B and the layers `object` (with A), `shadow`,
    /// `light` and `photograph`.
    ///
    /// # Errors
    /// See [`encode_layered_exr`].
    pub fn encode_exr(&self, attributes: &[Attribute]) -> Result<Vec<u8>> {
        let composite = self.composite();
        let images = [
            ("", &composite),
            ("object.", &self.object),
            ("shadow.", &self.shadow),
            ("light.", &self.light),
            ("photograph.", &self.photograph),
        ];
        let mut channels = vec![Channel { name: "object.A".into(), values: self.alpha.clone() }];
        for (layer, image) in images {
            for (k, letter) in ["R", "G", "B"].into_iter().enumerate() {
                let values = image.pixels.iter().map(|pixel| pixel[k]).collect();
                channels.push(Channel { name: format!("{layer}{letter}"), values });
            }
        }
        encode_layered_exr(self.object.width, self.object.height, channels, attributes)
    }
}
