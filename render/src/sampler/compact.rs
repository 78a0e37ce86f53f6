//! Compact emitters sampled on their own, in a mixture with a sampler for the rest of the light.

mod flat;

use std::sync::Arc;

use glam::{Vec2, Vec3A};

use super::{Coverage, Draws, EnvironmentLight, Sampler, prefiltered::Prefiltered, prepared};
use crate::{
    color::luminance,
    columns::{Arena, gather, scatter},
    discrete::remap,
    environment::{Environment, compact_emitters},
    error::{Error, Result},
    simd::{LANES, Lanes},
    tail::{Tail, TailKind},
    tile::Rows,
};

/// Points at which the light of an emitter is judged for a shading point.
const POINTS: usize = 4;
/// Least share of samples of each emitter: a disc on the horizon may be seen by a corner that no point shows.
const LEAST_SHARE: f32 = 0.01;
/// What the rest counts for, over an emitter of equal light: its samples spread more.
const REST_SPREAD: f32 = 1.6;
/// Least share of the rest.
const LEAST_REST: f32 = 0.05;

/// The compact emitters of a map, and what the rest looks like to lobes.
#[derive(Clone, Debug)]
pub struct CompactEmitters {
    emitters: Vec<Emitter>,
    rest: Prefiltered,
}

#[derive(Clone, Debug)]
struct Emitter {
    light: EnvironmentLight,
    /// Integral of its luminance over solid angle.
    power: f32,
    /// Directions spread over it in proportion to its light.
    towards: [Vec3A; POINTS],
}

impl CompactEmitters {
    /// The emitters of a map that was brought down to `rest`, see [`crate::environment::without_compact_emitters`].
    ///
    /// # Errors
    /// `rest` is not of the map's size, is brighter than the map, or leaves no emitters or too many.
    pub fn new(environment: &Arc<Environment>, rest: &[f32]) -> Result<Self> {
        let (width, height, map) = (environment.width(), environment.height(), environment.luminance());
        // To rounding: another processor may add the three channels in another order.
        if rest.len() != map.len() || rest.iter().zip(&map).any(|(rest, map)| !(0.0..=map * 1.000_01).contains(rest)) {
            return Err(Error::argument("tail.luminance", "is not a part of the map's: the file is damaged"));
        }
        // What is equal to rounding is equal.
        let clean: Vec<f32> =
            rest.iter().zip(&map).map(|(&rest, &map)| if rest >= map * 0.999_99 { map } else { rest }).collect();
        let parts = compact_emitters(width, height, &map, &clean).ok_or_else(|| {
            Error::argument("compact_emitters", "the map and the file differ by no emitter, or by too many")
        })?;
        let emitters = parts.iter().map(|part| Emitter::new(environment, part)).collect::<Result<_>>()?;
        Ok(Self { emitters, rest: Prefiltered::new(width, height, &clean) })
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.emitters.len()
    }

    /// The share of samples of each emitter, then of the rest, in the columns of `state`: in proportion to the light that a shading point
    /// reflects of each, as far as a few fixed points show it.
    fn shares(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        let count = self.emitters.len();
        let mut light = arena.columns::<1>((count + 1) * at.strips());
        let [light] = light.get_mut();
        let (of_emitters, of_rest) = light.split_at_mut(count * at.strips());
        for (light, emitter) in of_emitters.chunks_exact_mut(at.strips()).zip(&self.emitters) {
            emitter.reflected(at, light, arena);
        }
        self.rest.reflected(at, of_rest, arena);
        for light in of_rest.as_flattened_mut() {
            *light *= REST_SPREAD;
        }
        for strip in 0..at.strips() {
            let mut total = [0.0; LANES];
            for part in 0..=count {
                for lane in 0..LANES {
                    total[lane] += light[part * at.strips() + strip][lane];
                }
            }
            let free = 1.0 - LEAST_REST - LEAST_SHARE * count as f32;
            for part in 0..=count {
                let least = if part == count { LEAST_REST } else { LEAST_SHARE };
                let out = &mut state[strip * (count + 1) + part];
                for lane in 0..LANES {
                    let share = light[part * at.strips() + strip][lane] / total[lane];
                    let known = (total[lane] > 0.0) & (total[lane] < f32::INFINITY);
                    out[lane] = least + free * if known { share } else { 1.0 / (count + 1) as f32 };
                }
            }
        }
    }
}

/// Van der Corput's sequence in base 2, shifted off 0.
fn radical_inverse(k: usize) -> f32 {
    (k as u32).reverse_bits() as f32 / 4_294_967_296.0 + 0.5 / POINTS as f32
}

impl Emitter {
    fn new(environment: &Arc<Environment>, luminance: &[f32]) -> Result<Self> {
        let (width, height) = (environment.width(), environment.height());
        let tail = Tail::new(TailKind::RowColumn, width, height, luminance)?;
        let light = EnvironmentLight::with_tail(environment.clone(), Arc::new(tail));
        let towards = std::array::from_fn(|k| {
            let y = Vec2::new((k as f32 + 0.5) / POINTS as f32, radical_inverse(k));
            light.tail().forward_direction(y).1
        });
        let power = light.tail().light().power() as f32;
        Ok(Self { light, power, towards })
    }

    /// The light of the emitter that shading points reflect, by a few points of it.
    fn reflected(&self, at: &Rows<'_>, out: &mut [Lanes], arena: &Arena) {
        out.as_flattened_mut().fill(0.0);
        let mut columns = arena.columns::<6>(at.strips());
        for wi in self.towards {
            let [x, y, z, red, green, blue] = columns.get_mut();
            for (column, number) in [&mut *x, y, z].into_iter().zip(wi.to_array()) {
                column.as_flattened_mut().fill(number);
            }
            at.brdf_cosine([x, y, z], [red, green, blue], arena);
            for (strip, out) in out.iter_mut().enumerate() {
                for lane in 0..LANES {
                    let reflected = Vec3A::new(red[strip][lane], green[strip][lane], blue[strip][lane]);
                    out[lane] += luminance(reflected) / POINTS as f32 * self.power;
                }
            }
        }
    }
}

/// The mixture of compact emitters with a sampler of the rest. Its shares depend on the shading point, its pdf is that of the
/// mixture.
#[derive(Clone, Debug)]
pub struct WithCompactEmitters<S> {
    compact: Arc<CompactEmitters>,
    rest: S,
}

impl<S: Sampler> WithCompactEmitters<S> {
    /// The mixture; `rest` draws by a tail of the light without these emitters.
    pub fn new(compact: Arc<CompactEmitters>, rest: S) -> Self {
        Self { compact, rest }
    }

    /// `pdf` holds that of the rest before and that of the mixture after.
    fn mix(
        &self,
        at: &Rows<'_>,
        shares: &dyn Fn(usize, usize) -> f32,
        wi: [&[Lanes]; 3],
        pdf: &mut [Lanes],
        arena: &Arena,
    ) {
        let count = self.compact.count();
        for (place, pdf) in pdf.as_flattened_mut()[..at.len()].iter_mut().enumerate() {
            *pdf *= shares(place, count);
        }
        let mut own = arena.columns::<1>(at.strips());
        for (part, emitter) in self.compact.emitters.iter().enumerate() {
            emitter.light.pdf(wi, own.get_mut()[0], arena);
            let both = pdf.as_flattened_mut().iter_mut().zip(own.get()[0].as_flattened());
            for (place, (pdf, own)) in both.take(at.len()).enumerate() {
                *pdf += shares(place, part) * own;
            }
        }
    }

    /// Draws for the rows at `places`, from an emitter or (`None`) from the rest.
    fn sample_part(
        &self,
        from: Option<&Emitter>,
        (at, places): (&Rows<'_>, &[u16]),
        shares: &dyn Fn(usize, usize) -> f32,
        u: [&[Lanes]; 2],
        out: &mut Draws<'_>,
        arena: &Arena,
    ) {
        let mut rows = arena.list();
        let at = at.select(places, &mut rows);
        let (mut numbers, mut drawn) = (arena.columns::<2>(at.strips()), arena.columns::<5>(at.strips()));
        for (from, to) in u.into_iter().zip(numbers.get_mut()) {
            gather(from, places, to);
        }
        let [x, y, z, own, mixed] = drawn.get_mut();
        prepared(&self.rest, &at, arena, |state| match from {
            None => {
                let out = Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *own };
                self.rest.sample(&at, state, numbers.get(), out, arena);
                mixed.copy_from_slice(own);
            }
            Some(emitter) => {
                own.as_flattened_mut().fill(1.0);
                let out = Draws { wi: [&mut *x, &mut *y, &mut *z], pdf: &mut *own };
                emitter.light.directions(numbers.get(), out, arena);
                self.rest.pdf(&at, state, [x, y, z], mixed, arena);
            }
        });
        self.mix(&at, &|place, part| shares(places[place] as usize, part), [x, y, z], mixed, arena);
        for (mixed, own) in mixed.as_flattened_mut().iter_mut().zip(own.as_flattened()) {
            // No direction is no sample.
            *mixed = if *own > 0.0 { *mixed } else { 0.0 };
        }
        let [x, y, z, _, mixed] = drawn.get();
        for (from, to) in [x, y, z].into_iter().zip(&mut out.wi) {
            scatter(from, places, to);
        }
        scatter(mixed, places, out.pdf);
    }
}

impl<S: Sampler> Sampler for WithCompactEmitters<S> {
    fn columns(&self) -> usize {
        self.compact.count() + 1
    }

    fn prepare(&self, at: &Rows<'_>, state: &mut [Lanes], arena: &Arena) {
        self.compact.shares(at, state, arena);
    }

    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], mut out: Draws<'_>, arena: &Arena) {
        let count = self.compact.count();
        let shares = |place: usize, part: usize| state[place / LANES * (count + 1) + part][place % LANES];
        // What is left of the first number once it has chosen where to draw from.
        let mut numbers = arena.columns::<2>(at.strips());
        let [left, chosen] = numbers.get_mut();
        for place in 0..at.len() {
            let u = u[0].as_flattened()[place];
            let (mut before, mut part) = (0.0, 0);
            while part < count && u >= before + shares(place, part) {
                before += shares(place, part);
                part += 1;
            }
            let end = if part == count { 1.0 } else { before + shares(place, part) };
            left.as_flattened_mut()[place] = remap(u, before, end);
            chosen.as_flattened_mut()[place] = part as f32;
        }
        let [left, chosen] = numbers.get();
        let mut places = arena.list();
        for part in 0..=count {
            places.clear();
            places.extend((0..at.len() as u16).filter(|&k| chosen.as_flattened()[k as usize] == part as f32));
            if !places.is_empty() {
                let from = self.compact.emitters.get(part);
                self.sample_part(from, (at, &places), &shares, [left, u[1]], &mut out, arena);
            }
        }
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        let count = self.compact.count();
        let shares = |place: usize, part: usize| state[place / LANES * (count + 1) + part][place % LANES];
        prepared(&self.rest, at, arena, |state| self.rest.pdf(at, state, wi, out, arena));
        self.mix(at, &shares, wi, out, arena);
    }

    fn coverage(&self) -> Coverage {
        match self.rest.coverage() {
            Coverage::Everything | Coverage::LightOfTail => Coverage::Everything,
            Coverage::Part => Coverage::Part,
        }
    }
}
