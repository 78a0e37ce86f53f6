//! Tests that points in mixed tiles, in any order, get the same results as alone.

use headtail_render::{
    brdf::{Ggx, MAX_PARAMETERS, MetallicRoughness, Surface},
    columns::strips,
    discrete::BELOW_ONE,
    frame::Frame,
    simd::{LANES, Lanes},
    tile::Rows,
};

use super::{
    conditioned::{HEADS, product},
    *,
};

/// Maximum points of a tile in these tests.
const MOST: usize = 256;

/// One row of a tile with its input numbers.
#[derive(Clone, Copy)]
struct Row {
    at: ShadingPoint,
    u: Vec2,
    /// A direction whose pdf is evaluated.
    wi: Vec3A,
}

/// Results of a sampler and a BRDF for one row, as bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Got {
    /// Direction and pdf; zeros where there is no sample.
    sample: [u32; 4],
    /// Pdf of the direction `wi`.
    pdf: u32,
    mixture_weight: u32,
    /// Reflection towards `wi`, BRDF sampling's pdf there, and the width of the lobe.
    brdf: [u32; 5],
}

/// Returns different points: diffuse, glossy, mixed and measured, with shading normals that differ from
/// geometric ones.
fn rows() -> Vec<Row> {
    let mut random = Stream::new(7, Purpose::Test, 5);
    let row = |k: usize| {
        let ns = random.direction();
        let frame = Frame::from_normal(ns.into());
        let mut above = |least: f32| -> Vec3A {
            let local = random.direction().abs().max(Vec3A::new(0.0, 0.0, least)).normalize();
            frame.to_world(local.into()).normalize().into()
        };
        let (wo, lean) = (above(0.05), above(0.0));
        let color = Vec3::new(0.9, 0.1 + 0.8 * random.uniform(), 0.3);
        let surface: Surface = match (k * 7 + k / 5) % 4 {
            0 => Lambert { albedo: color }.into(),
            1 => Ggx::new(0.03 + 0.9 * random.uniform(), color).into(),
            2 => {
                Surface { brdf: BrdfTable::METALLIC_ROUGHNESS + 1 + (k % 2) as u32, parameters: [0.0; MAX_PARAMETERS] }
            }
            _ => MetallicRoughness::new(color, random.uniform(), random.uniform()).into(),
        };
        let p = 3.0 * random.direction();
        let at = ShadingPoint { p, ng: (ns + 0.2 * lean).normalize(), ns, wo, surface };
        let u = if k.is_multiple_of(29) { Vec2::new(0.0, BELOW_ONE) } else { random.uniform2() };
        Row { at, u, wi: random.direction() }
    };
    (0..MOST).map(row).collect()
}

/// Returns an arena whose memory is filled with NaN.
fn poisoned() -> Arena {
    let arena = Arena::default();
    let mut taken: Vec<_> = (0..24).map(|_| arena.columns::<1>(64 * strips(MOST))).collect();
    taken.iter_mut().for_each(|columns| columns.get_mut()[0].fill([f32::NAN; LANES]));
    drop(taken);
    arena
}

/// Fills columns for the places of rows; lanes beyond the last are NaN.
fn columns<const N: usize>(at: &Rows<'_>, numbers: impl Fn(usize) -> [f32; N]) -> [Vec<Lanes>; N] {
    let mut columns = std::array::from_fn(|_| vec![[f32::NAN; LANES]; at.strips()]);
    for place in 0..at.len() {
        for (column, number) in columns.iter_mut().zip(numbers(at.row(place))) {
            column[place / LANES][place % LANES] = number;
        }
    }
    columns
}

/// Returns the results of each place of `at`; `given` are the inputs of each row of the tile.
fn ask(sampler: &dyn Sampler, at: &Rows<'_>, given: &[Row], arena: &Arena) -> Vec<Got> {
    let u = columns(at, |row| given[row].u.to_array());
    let wi = columns(at, |row| given[row].wi.to_array());
    let (u, wi) = (u.each_ref().map(|column| &column[..]), wi.each_ref().map(|column| &column[..]));
    let mut out = arena.columns::<11>(at.strips());
    let [x, y, z, drawn_pdf, pdf, mixture_weight, red, green, blue, brdf_pdf, alpha] = out.get_mut();
    prepared(sampler, at, arena, |state| {
        sampler.sample(at, state, u, Draws { wi: [x, y, z], pdf: drawn_pdf }, arena);
        sampler.pdf(at, state, wi, pdf, arena);
        sampler.mixture_weight(at, state, mixture_weight, arena);
    });
    at.brdf_cosine(wi, [red, green, blue], arena);
    at.brdf_pdf(wi, brdf_pdf, arena);
    at.alpha(alpha, arena);
    let out = out.get().map(<[Lanes]>::as_flattened);
    let got = |place: usize| {
        let bits = |k: usize| out[k][place].to_bits();
        let sample = if out[3][place] > 0.0 { [0, 1, 2, 3].map(bits) } else { [0; 4] };
        Got { sample, pdf: bits(4), mixture_weight: bits(5), brdf: [6, 7, 8, 9, 10].map(bits) }
    };
    (0..at.len()).map(got).collect()
}

/// Returns places in several orders: forwards, backwards, in strides (of 7, which divides none of the
/// lengths), sorted by surface, and every row twice.
fn orders(rows: &[Row]) -> Vec<Vec<u16>> {
    let count = rows.len() as u16;
    let forwards: Vec<u16> = (0..count).collect();
    let backwards: Vec<u16> = (0..count).rev().collect();
    let strided: Vec<u16> = (0..u32::from(count)).map(|k| ((7 * k + 3) % u32::from(count)) as u16).collect();
    let mut by_surface = forwards.clone();
    by_surface.sort_by_key(|&k| rows[usize::from(k)].at.surface.brdf);
    let twice = strided.iter().chain(&backwards).copied().collect();
    vec![forwards, backwards, strided, by_surface, twice]
}

/// Compares a sampler over mixed tiles of `lengths` points with tiles in which every lane has the same point.
///
/// Lanes are independent and have the same arithmetic, so that results must be equal bit for bit.
fn check(sampler: &dyn Sampler, lengths: &[usize]) -> Verdict {
    let (all, arena) = (rows(), poisoned());
    let longest = lengths.iter().copied().max().unwrap_or(0);
    let alone = |row: &Row| {
        let tile = Tile::of_table(&[row.at; LANES], &BRDFS);
        ask(sampler, &tile.rows(), &[*row; LANES], &arena)
    };
    let alone: Vec<Vec<Got>> = all[..longest].iter().map(alone).collect();
    assert!(alone.iter().any(|got| got[0].sample != [0; 4] && got[0].pdf != 0), "it draws nothing");
    for &length in lengths {
        let given = &all[..length];
        let tile = Tile::of_table(&given.iter().map(|row| row.at).collect::<Vec<_>>(), &BRDFS);
        let whole = tile.rows();
        let compare = |at: &Rows<'_>, order: &str| {
            for (place, got) in ask(sampler, at, given, &arena).into_iter().enumerate() {
                let row = at.row(place);
                let expected = alone[row][place % LANES];
                if got != expected {
                    return Err(format!("row {row}, place {place} of {length}, {order}: {got:?}, alone {expected:?}"));
                }
            }
            Ok(())
        };
        compare(&whole, "all rows")?;
        for (k, order) in orders(given).into_iter().enumerate() {
            let (mut list, mut again) = (Vec::new(), Vec::new());
            let selected = whole.select(&order, &mut list);
            compare(&selected, &format!("order {k}"))?;
            // A selection of a selection, of odd length.
            let odd: Vec<u16> = (0..order.len() as u16).step_by(2).rev().collect();
            compare(&selected.select(&odd, &mut again), &format!("every other one of order {k}"))?;
        }
    }
    Ok(())
}

/// Lengths around those of a strip and of a tile.
const LENGTHS: [usize; 6] = [1, 15, 16, 17, 255, 256];

#[test]
fn results_in_mixed_tiles_equal_those_of_single_points() {
    let kinds = ["window", "sunset", "seam"];
    let tasks: Vec<(String, &dyn Sampler)> = WORLDS
        .iter()
        .filter(|world| kinds.iter().any(|kind| world.name.starts_with(kind)))
        .flat_map(|world| {
            world.cases.iter().map(move |case| (format!("{} / {}", world.name, case.name), &*case.sampler))
        })
        .collect();
    tasks.par_iter().for_each(|(name, sampler)| {
        // The oracle has a state of 66,000 numbers per point, from 1e5 evaluations.
        let is_slow = name.ends_with("oracle");
        let verdict = check(*sampler, if is_slow { &LENGTHS[..4] } else { &LENGTHS });
        verdict.unwrap_or_else(|reason| panic!("{name}: {reason}"));
    });
}

#[test]
fn results_of_heads_in_mixed_tiles_equal_those_of_single_points() {
    let world = WORLDS.iter().find(|world| world.name.starts_with("window")).unwrap();
    HEADS.par_iter().for_each(|(name, head)| {
        let head = || product(world, head);
        let emitter = EmitterSampler::new(world.light.clone());
        let samplers: [&dyn Sampler; 3] =
            [&head(), &OneSampleMis::new(head(), BrdfSampler), &OneSampleMis::new(emitter, head())];
        for (sampler, form) in samplers.into_iter().zip(["head", "head+mis", "emitter and head"]) {
            check(sampler, &LENGTHS).unwrap_or_else(|reason| panic!("{form} of {name}: {reason}"));
        }
    });
}

/// Errors of batches that copies of one point cannot reveal.
#[derive(Clone, Copy, Debug)]
enum Confusion {
    /// Confuses the row of the tile with the place in the list.
    RowForPlace,
    /// Gives the last place the result of the one before.
    LastPlace,
    /// Reads an uninitialised lane.
    UnusedLane,
}

/// BRDF sampling with an error in its rows.
struct Confused(Confusion);

impl Sampler for Confused {
    fn sample(&self, at: &Rows<'_>, state: &[Lanes], u: [&[Lanes]; 2], mut out: Draws<'_>, arena: &Arena) {
        let reborrowed = Draws { wi: out.wi.each_mut().map(|column| &mut **column), pdf: &mut *out.pdf };
        BrdfSampler.sample(at, state, u, reborrowed, arena);
        let pdf = out.pdf.as_flattened_mut();
        let last = at.len() - 1;
        match self.0 {
            Confusion::RowForPlace => pdf[last] = pdf[at.row(last).min(last)],
            Confusion::LastPlace => pdf[last] = pdf[last.saturating_sub(1)],
            Confusion::UnusedLane => pdf[last] += 0.0 * u[0].as_flattened().last().copied().unwrap_or(0.0),
        }
    }

    fn pdf(&self, at: &Rows<'_>, state: &[Lanes], wi: [&[Lanes]; 3], out: &mut [Lanes], arena: &Arena) {
        BrdfSampler.pdf(at, state, wi, out, arena);
    }

    fn coverage(&self) -> Coverage {
        Coverage::Everything
    }
}

#[test]
fn confused_batches_are_detected() {
    for confusion in [Confusion::RowForPlace, Confusion::LastPlace, Confusion::UnusedLane] {
        assert!(check(&Confused(confusion), &LENGTHS).is_err(), "{confusion:?} was not found");
    }
    check(&BrdfSampler, &LENGTHS).unwrap();
}
