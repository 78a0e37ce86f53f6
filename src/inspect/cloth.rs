//! A point of a neural material, as the condition of a head.

use std::{str::FromStr, sync::Arc};

use clap::Args;
use glam::{Vec2, Vec3, Vec3A};
use headtail_render::{
    brdf::{
        BrdfTable, NeuralTexture, OF_MATERIAL, Surface,
        neural_texture::{FEATURES, Seen},
    },
    frame::Frame,
    head::{Condition, MAX_CONDITION},
    tile::ShadingPoint,
};

/// Position on a neural material.
#[derive(Args)]
pub struct Arguments {
    /// Position on a neural material, in tiles.
    #[arg(long, value_name = "U,V", default_value = "0.5,0.5", allow_hyphen_values = true)]
    place: TexelPosition,
    /// Level of a neural material's textures.
    /// 0 is the finest; each further level has twice the footprint.
    #[arg(long, value_name = "LEVEL", default_value_t = 0.0, value_parser = level)]
    level: f32,
}

/// A position in tiles.
#[derive(Clone, Copy, Debug)]
pub struct TexelPosition(Vec2);

impl FromStr for TexelPosition {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f32>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[u, v]) if u.is_finite() && v.is_finite() => Ok(Self(Vec2::new(u, v))),
            _ => Err("write two numbers separated by a comma, as in 0.25,0.5".into()),
        }
    }
}

fn level(text: &str) -> Result<f32, String> {
    let in_range = |level: &f32| (0.0..=16.0).contains(level);
    text.parse().ok().filter(in_range).ok_or_else(|| "write a number from 0 to 16".into())
}

/// Returns the surface at the position, seen from `wo`, and a table that contains it. Its first tangent is
/// that of [`Frame::from_normal`].
pub fn surface(arguments: &Arguments, texture: &Arc<NeuralTexture>, n: Vec3A, wo: Vec3A) -> (BrdfTable, Surface) {
    let width = texture.finest_width() * arguments.level.exp2();
    let wo = Frame::from_normal(n.into()).to_local(wo.into());
    let parameters = texture.parameters(&Seen { uv: arguments.place.0, width, wo, tangent: [1.0, 0.0, 1.0] });
    let (table, brdf) = BrdfTable::default().with(texture.clone());
    (table, Surface { brdf, parameters })
}

/// Returns the condition of a head at a point with such a surface.
pub fn condition(at: &ShadingPoint) -> [f32; MAX_CONDITION] {
    let n: Vec3 = at.ns.into();
    let mut material = [0.0; OF_MATERIAL];
    material[..FEATURES].copy_from_slice(&at.surface.parameters[..FEATURES]);
    material[FEATURES..FEATURES + 3].copy_from_slice(&Frame::from_normal(n).s.to_array());
    material[FEATURES + 3] = 1.0;
    Condition::encode_texture(at.wo.into(), n, &material)
}
