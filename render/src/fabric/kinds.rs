//! The project's reference materials, by name.

use std::str::FromStr;

use glam::{Vec2, Vec3, Vec3A};

use super::{Fabric, Layered, Source, knit, pile, weave, yarn::TriangleSoup};
use crate::{
    error::{Error, Result},
    scene::{Material, Mesh, TexturedMetallicRoughness},
};

/// A source of bidirectional texture samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceKind {
    /// A rough striped weave with ribs.
    Welt,
    /// A satin of metallic threads.
    Satin,
    /// A glossy velvet with flattened pile.
    Velvet,
    /// A plain knit of wool.
    Jersey,
    /// A clear coat of varying roughness over a diffuse pattern.
    Lacquer,
    /// A tinted rough coat over brushed metal.
    Anodized,
}

impl SourceKind {
    /// All kinds.
    pub const ALL: [Self; 6] = [Self::Welt, Self::Satin, Self::Velvet, Self::Jersey, Self::Lacquer, Self::Anodized];

    /// Returns the name that [`FromStr`] parses.
    pub fn name(self) -> &'static str {
        match self {
            Self::Welt => "welt",
            Self::Satin => "satin",
            Self::Velvet => "velvet",
            Self::Jersey => "jersey",
            Self::Lacquer => "lacquer",
            Self::Anodized => "anodized",
        }
    }

    /// Builds the source.
    ///
    /// # Errors
    /// When the geometry cannot be built.
    pub fn build(self) -> Result<Box<dyn Source>> {
        Ok(match self {
            Self::Welt | Self::Satin | Self::Velvet | Self::Jersey => Box::new(self.fabric()?),
            Self::Lacquer => Box::new(Layered::lacquer()),
            Self::Anodized => Box::new(Layered::anodized()),
        })
    }

    pub(super) fn fabric(self) -> Result<Fabric> {
        let colors = self.fibres();
        let mut soups: Vec<TriangleSoup> = colors.iter().map(|_| TriangleSoup::default()).collect();
        match self {
            Self::Welt => weave::welt().build(&mut soups),
            Self::Satin => weave::satin().build(&mut soups),
            Self::Jersey => knit::jersey().build(&mut soups[0]),
            _ => pile::velvet(&mut soups[0]),
        }
        let mut meshes = Vec::new();
        for (material, soup) in soups.iter().enumerate() {
            meshes.push(soup.tiled(material)?);
        }
        Fabric::new(self.name(), meshes, colors)
    }

    /// Returns the materials of the fibres, the lining's last.
    fn fibres(self) -> Vec<Material> {
        match self {
            Self::Welt => vec![
                fibre([0.42, 0.38, 0.33], 0.0, 0.85),
                fibre([0.72, 0.66, 0.54], 0.0, 0.85),
                fibre([0.10, 0.17, 0.32], 0.0, 0.80),
                lining([0.1, 0.1, 0.12]),
            ],
            Self::Satin => vec![
                fibre([0.45, 0.14, 0.10], 0.3, 0.6),
                fibre([0.78, 0.28, 0.16], 0.6, 0.46),
                lining([0.12, 0.04, 0.03]),
            ],
            Self::Jersey => vec![fibre([0.52, 0.16, 0.13], 0.0, 0.8), lining([0.12, 0.04, 0.03])],
            _ => vec![fibre([0.20, 0.42, 0.38], 0.85, 0.33), lining([0.02, 0.05, 0.05])],
        }
    }
}

fn fibre(color: [f32; 3], metallic: f32, roughness: f32) -> Material {
    Material::MetallicRoughness(TexturedMetallicRoughness {
        base_color: color.into(),
        base_color_texture: None,
        metallic,
        roughness,
        metallic_roughness_texture: None,
        ..TexturedMetallicRoughness::default()
    })
}

fn lining(albedo: [f32; 3]) -> Material {
    Material::diffuse(Vec3A::from_array(albedo))
}

/// Builds the lining at z = 0, wide enough for every ray that enters through the central tile.
pub(super) fn lining_mesh(material: usize) -> Result<Mesh> {
    const HALF: f32 = 3.0;
    let corner = |x: f32, y: f32| (Vec2::splat(0.5) + HALF * Vec2::new(x, y)).extend(0.0);
    let corners: Vec<Vec3> = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    Mesh::new(corners, vec![], vec![], vec![[0, 1, 2], [0, 2, 3]], material)
}

impl FromStr for SourceKind {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            Error::argument(format!("source '{text}'"), format!("is not one of {names}"))
        })
    }
}
