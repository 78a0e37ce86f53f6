//! `headtail inspect --tail`: draws and measures the tails of a map.

use std::time::Instant;

use anyhow::Result;
use glam::Vec2;
use headtail_render::{
    color::tone_map,
    environment::Environment,
    export::ExportedSampler,
    latlong::direction,
    random::{Purpose, Stream},
    tail::{Tail, TailKind, TailWarp},
};

use super::discontinuities::{self, Discontinuities};
use crate::report::{
    chart::{Panel, Sides, densities},
    vector::Chart,
};

const WIDTH: usize = 512;
const HEIGHT: usize = 256;
/// Lines of the pattern along each side of Y.
const LINES: f32 = 16.0;
/// Points along a side of Y at which neighbours are compared.
const SIDE: usize = 512;
/// Cells along a side of Y in which energy is summed.
const CELLS: usize = 64;
/// Points for measuring a divergence.
const POINTS: usize = 100_000;

/// Figures of a tail.
struct Figures {
    kind: TailKind,
    /// `KL(light || tail)` in nats.
    kl: f64,
    /// Largest ratio of the Jacobians of neighbouring points, and the 99th percentile.
    jump: f64,
    jump_99: f64,
    discontinuities: Discontinuities,
    /// Energy of the fullest of 64 x 64 cells of Y, as a fraction of the total.
    worst_cell: f64,
    /// Nanoseconds for y -> x and x -> y.
    nanoseconds: [f64; 2],
}

/// Results of an inspection of tails.
pub struct Found {
    pub picture: Chart,
    /// Plain text.
    pub table: String,
    /// The rows of `table` as objects.
    pub objects: Vec<serde_json::Value>,
}

/// Returns the flow tail of a file for a map; `None` if its tail is exact.
///
/// # Errors
/// If the file is for another map.
pub fn flow_of<'a>(exported: &'a ExportedSampler, environment: &Environment) -> Result<Option<&'a Tail>> {
    exported.check_environment(environment)?;
    Ok((exported.tail.kind() == TailKind::Flow).then_some(&*exported.tail))
}

/// Draws and measures the exact tails of a map, and a flow that was fitted to it.
pub fn inspect(environment: &Environment, flow: Option<&Tail>) -> Result<Found> {
    let exact = |kind| Tail::new(kind, environment.width(), environment.height(), &environment.luminance());
    let mut tails = vec![exact(TailKind::RowColumn)?, exact(TailKind::Hierarchical)?];
    tails.extend(flow.cloned());
    let figures: Vec<Figures> = tails.iter().map(Figures::of).collect();
    let mut table = String::from(
        "tail           KL (nats)  largest jump  99 % jump  breaks  mean break  worst cell  y -> x   x -> y\n",
    );
    for f in &figures {
        table += &format!(
            "{:<13} {:>10.4} {:>13.3e} {:>10.2} {:>7.2} {:>9.2} % {:>9.4} % {:>5.0} ns {:>5.0} ns\n",
            f.kind.name(),
            f.kl,
            f.jump,
            f.jump_99,
            f.discontinuities.length,
            100.0 * f.discontinuities.mean,
            100.0 * f.worst_cell,
            f.nanoseconds[0],
            f.nanoseconds[1]
        );
    }
    let object = |f: &Figures| {
        serde_json::json!({
            "tail": f.kind.name(),
            "kl": f.kl,
            "largest_jump": f.jump,
            "jump_99": f.jump_99,
            "discontinuity_sides": f.discontinuities.length,
            "mean_discontinuity": f.discontinuities.mean,
            "worst_cell_share": f.worst_cell,
            "ns_y_to_x": f.nanoseconds[0],
            "ns_x_to_y": f.nanoseconds[1],
        })
    };
    let objects = figures.iter().map(object).collect();
    Ok(Found { picture: draw(environment, &tails, &figures)?, table, objects })
}

impl Figures {
    fn of(tail: &Tail) -> Self {
        let mut random = Stream::new(1, Purpose::Test, 0);
        let light = Tail::Hierarchical(headtail_render::tail::Hierarchical::new(tail.light().clone()));
        let y: Vec<Vec2> = (0..POINTS).map(|_| random.uniform2()).collect();
        let x: Vec<Vec2> = light.forward_points(&y).into_iter().map(|(x, _)| x).collect();
        let logs = light.inverse_points(&x).into_iter().zip(tail.inverse_points(&x));
        let logs = logs.map(|((_, p), (_, q))| f64::from(p).ln() - f64::from(q).ln());
        let kl = logs.sum::<f64>() / POINTS as f64;
        let (jump, jump_99) = neighbours(tail);
        let nanoseconds = [false, true].map(|back| lookup_time(tail, back));
        let discontinuities = Discontinuities::of(tail);
        Self { kind: tail.kind(), kl, jump, jump_99, discontinuities, worst_cell: worst_cell(tail), nanoseconds }
    }
}

/// Returns the largest ratio of Jacobians between neighbours of a grid over Y, and the 99th percentile.
fn neighbours(tail: &Tail) -> (f64, f64) {
    let at = |k: usize| Vec2::new((k % SIDE) as f32 + 0.5, (k / SIDE) as f32 + 0.5) / SIDE as f32;
    let points: Vec<(Vec2, f32)> = tail.forward_points(&(0..SIDE * SIDE).map(at).collect::<Vec<_>>());
    let mut jumps = Vec::new();
    for (k, (_, jacobian)) in points.iter().enumerate() {
        let (column, row) = (k % SIDE, k / SIDE);
        let right = row * SIDE + (column + 1) % SIDE;
        let below = (row + 1 < SIDE).then_some(k + SIDE);
        for other in [Some(right), below].into_iter().flatten() {
            jumps.push(f64::from(jacobian / points[other].1).ln().abs());
        }
    }
    jumps.retain(|jump| jump.is_finite());
    jumps.sort_by(f64::total_cmp);
    let pick =
        |fraction: f64| jumps.get(((jumps.len() - 1) as f64 * fraction) as usize).map_or(f64::NAN, |jump| jump.exp());
    (pick(1.0), pick(0.99))
}

/// Returns the fraction of the light in the fullest cell of Y; for an exact tail, 1 over the number of cells.
fn worst_cell(tail: &Tail) -> f64 {
    let mut random = Stream::new(2, Purpose::Test, 0);
    let mut cells = vec![0.0_f64; CELLS * CELLS];
    const EACH: usize = 64;
    for (k, cell) in cells.iter_mut().enumerate() {
        let corner = Vec2::new((k % CELLS) as f32, (k / CELLS) as f32);
        let y: Vec<Vec2> = (0..EACH).map(|_| (corner + random.uniform2()) / CELLS as f32).collect();
        let ratios = tail.forward_points(&y).into_iter().map(|(x, _)| f64::from(tail.light_ratio(x)));
        *cell = ratios.sum::<f64>() / (EACH * CELLS * CELLS) as f64;
    }
    cells.into_iter().fold(0.0, f64::max)
}

fn lookup_time(tail: &Tail, back: bool) -> f64 {
    let mut random = Stream::new(3, Purpose::Test, 0);
    let mut points: Vec<Vec2> = (0..20_000).map(|_| random.uniform2()).collect();
    if back {
        points = tail.forward_points(&points).into_iter().map(|(x, _)| x).collect();
    }
    let start = Instant::now();
    std::hint::black_box(if back { tail.inverse_points(&points) } else { tail.forward_points(&points) });
    start.elapsed().as_nanos() as f64 / points.len() as f64
}

/// Colour of a point of Y: hue along the circle, darker downwards, with a grid of lines.
fn color(y: Vec2) -> [u8; 3] {
    let near_line = |t: f32| ((t * LINES).fract() - 0.5).abs() > 0.44;
    let rgb = rgb_of_hsl(y.x, 0.85, 0.78 - 0.5 * y.y);
    if near_line(y.x) || near_line(y.y) { rgb.map(|c| c / 2) } else { rgb }
}

/// Converts hue, saturation and lightness in `[0, 1]` to 8-bit RGB.
fn rgb_of_hsl(hue: f32, saturation: f32, lightness: f32) -> [u8; 3] {
    let chroma = (1.0 - (2.0 * lightness - 1.0).abs()) * saturation;
    [0.0, 8.0, 4.0].map(|shift| {
        let place = (shift + 12.0 * hue).rem_euclid(12.0);
        let value = lightness - 0.5 * chroma * (place - 3.0).min(9.0 - place).clamp(-1.0, 1.0);
        (255.0 * value).round().clamp(0.0, 255.0) as u8
    })
}

/// Draws the square and its image under each tail; below them the map and the discontinuities of each tail.
fn draw(environment: &Environment, tails: &[Tail], figures: &[Figures]) -> Result<Chart> {
    let pixel = |k: usize| {
        Vec2::new((k % WIDTH) as f32 + 0.5, (k / WIDTH) as f32 + 0.5) / Vec2::new(WIDTH as f32, HEIGHT as f32)
    };
    let points: Vec<Vec2> = (0..WIDTH * HEIGHT).map(pixel).collect();
    let panel = |title: String, points: &[Vec2], sides| {
        let colors: Vec<[u8; 3]> = points.iter().copied().map(color).collect();
        Panel::plain(title, (&colors, WIDTH), sides)
    };
    let mut panels = vec![panel("the square Y".into(), &points, Sides::Square)?];
    for (tail, figures) in tails.iter().zip(figures) {
        let images: Vec<Vec2> = tail.inverse_points(&points).into_iter().map(|(y, _)| y).collect();
        let title = format!("{}: KL {:.4} nats", figures.kind.name(), figures.kl);
        panels.push(panel(title, &images, Sides::Sphere)?);
    }
    let map_pixels: Vec<[u8; 3]> = points.iter().map(|x| tone_map(environment.radiance(direction(*x)))).collect();
    panels.push(Panel::plain("the map", (&map_pixels, WIDTH), Sides::Sphere)?);
    for figures in figures {
        let Discontinuities { length, mean, .. } = figures.discontinuities;
        let title = format!("{}: breaks of {length:.1} sides, mean {:.1} %", figures.kind.name(), 100.0 * mean);
        // Twice as wide as high, like the square above.
        let colors: Vec<[u8; 3]> = figures.discontinuities.colors().into_iter().flat_map(|color| [color; 2]).collect();
        panels.push(Panel::plain(title, (&colors, 2 * discontinuities::SIDE), Sides::Square)?);
    }
    densities("tails", &[format!("Tails of '{}'", environment.name())], &panels, 1 + tails.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn primary_hues_convert_to_rgb() {
        assert_eq!(rgb_of_hsl(0.0, 1.0, 0.5), [255, 0, 0]);
        assert_eq!(rgb_of_hsl(1.0 / 3.0, 1.0, 0.5), [0, 255, 0]);
        assert_eq!(rgb_of_hsl(2.0 / 3.0, 1.0, 0.5), [0, 0, 255]);
        assert_eq!(rgb_of_hsl(0.4, 0.0, 1.0), [255; 3]);
    }
}
