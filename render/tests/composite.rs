//! Compositing: masks against integrals, furnaces, and unaffected pixels.

use std::sync::{Arc, atomic::AtomicBool};

use glam::{DVec3, Vec2, Vec3A};
use headtail_render::{
    composite::{Backdrop, Catcher, Composition, Film, Layers, Mask, MaskForm, Settings, Stage, compose},
    environment::{Environment, built_in},
    image::{Image, Photograph},
    latlong,
    scene::{Camera, MaterialSpec, Scene},
    spec::{BuildContext, SamplerSpec},
};

/// Returns a two-sided square of 1 m, 0.5 m above the origin.
fn lid() -> Scene {
    Scene::square(Vec3A::new(0.2, 0.5, 0.0), Vec3A::Y, 1.0).unwrap()
}

/// Returns a camera below the lid whose picture shows only the origin, to 1e-4 m.
fn at_origin() -> Camera {
    Camera::new(Vec3A::new(0.0, 0.4, 0.0), Vec3A::ZERO, 0.02).unwrap()
}

fn settings(side: usize, spp: u32) -> Settings {
    Settings { width: side, height: side, spp, depth: 1, seed: 5, mask_only: true }
}

fn grey(width: usize, height: usize, value: f32) -> Photograph {
    Photograph::of_radiance(Image { width, height, pixels: vec![[value; 3]; width * height] })
}

/// Computes a film of a lid over a plane.
fn film(environment: &Arc<Environment>, sampler: &str, settings: Settings) -> Film {
    let (camera, object) = (at_origin(), lid());
    let catcher = Catcher::plane(Vec3A::ZERO, Vec3A::Y, &object, &camera).unwrap();
    film_on(environment, sampler, settings, catcher)
}

/// Computes a film of a lid over any catcher.
fn film_on(environment: &Arc<Environment>, sampler: &str, settings: Settings, catcher: Catcher) -> Film {
    let (camera, object) = (at_origin(), lid());
    let stage = Stage::new(object, catcher).unwrap();
    let photograph = grey(settings.width, settings.height, 1.0);
    let backdrop = Backdrop::new(&stage, environment, &photograph, camera, Vec3A::ONE);
    // Trained visibility is used regardless of its predicted gain.
    let context = BuildContext { always: true, ..BuildContext::default() };
    let estimator = sampler.parse::<SamplerSpec>().unwrap().build_in(environment, context).unwrap();
    let composition = Composition { stage: &stage, backdrop: &backdrop, camera: &camera, estimator: &*estimator };
    compose(composition, settings, &AtomicBool::new(false), &|_| {})
}

/// Integrates the mask at the origin under the lid by midpoints of cells of the map; directions that meet the
/// lid's plane inside the square are blocked.
fn truth(environment: &Environment) -> DVec3 {
    truth_where(environment, |_| true)
}

/// Integrates the mask over the directions that a catcher leaves open.
fn truth_where(environment: &Environment, is_open: impl Fn(Vec3A) -> bool) -> DVec3 {
    let (width, height) = (2048, 1024);
    let (mut open, mut all) = (DVec3::ZERO, DVec3::ZERO);
    for k in 0..width * height / 2 {
        let x = Vec2::new((k % width) as f32 + 0.5, (k / width) as f32 + 0.5) / Vec2::new(width as f32, height as f32);
        let wi = latlong::direction(x);
        if !is_open(wi) {
            continue;
        }
        let light = environment.radiance(wi).as_dvec3() * f64::from(wi.y * latlong::sin_theta(x.y));
        let at = wi * (0.5 / wi.y);
        let is_covered = (at.x - 0.2).abs() < 0.5 && at.z.abs() < 0.5;
        all += light;
        open += if is_covered { DVec3::ZERO } else { light };
    }
    open / all
}

/// Returns the mean over pixels and its standard error by blocks of 8 x 8 pixels, since the factors of
/// neighbouring control variates are correlated.
fn mean(mask: &Mask, channel: usize) -> (f64, f64) {
    let side = mask.width / 8;
    let mut blocks = vec![0.0; side * side];
    for (k, value) in mask.values.iter().enumerate() {
        blocks[k / mask.width / 8 * side + k % mask.width / 8] += f64::from(value[channel]) / 64.0;
    }
    let count = blocks.len() as f64;
    let mean = blocks.iter().sum::<f64>() / count;
    let variance = blocks.iter().map(|block| (block - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (mean, (variance / count).sqrt())
}

/// 13 pairs of map and sampler, 3 channels and 2 forms are 78 tests: at 4.5 standard errors, a correct
/// estimator fails one of them with a probability of 78 x 6.8e-6 = 5e-4, and seeds are fixed. Cosine sampling
/// hits lamps too rarely for normally distributed means. The quadrature of 2048 x 1024 cells has an error of
/// at most 1e-4, from the lid's edges.
#[test]
fn unbiased_forms_have_the_mean_of_the_integral() {
    const QUADRATURE: f64 = 1e-4;
    for name in ["studio", "sunset", "window"] {
        let environment = Arc::new(built_in(name).unwrap());
        let expected = truth(&environment);
        for sampler in
            ["patches", "patches+vis", "mis", "ris:4", "cosine"].into_iter().take(if name == "window" { 5 } else { 4 })
        {
            let film = film(&environment, sampler, settings(128, 4));
            for form in [MaskForm::Weights, MaskForm::ControlVariate] {
                let mask = Mask::of(&film, form);
                for channel in 0..3 {
                    let (mean, error) = mean(&mask, channel);
                    let off = (mean - expected[channel]).abs();
                    assert!(
                        off < 4.5 * error + QUADRATURE,
                        "{name} {sampler} {form} {channel}: {mean} +- {error}, not {}",
                        expected[channel]
                    );
                }
            }
        }
    }
}

/// With exact visibility the mask would have no noise.
#[test]
fn learned_visibility_lowers_the_noise_of_the_mask() {
    let environment = Arc::new(built_in("studio").unwrap());
    let error = |sampler: &str, form| mean(&Mask::of(&film(&environment, sampler, settings(64, 16)), form), 3).1;
    for form in [MaskForm::Weights, MaskForm::ControlVariate] {
        let (plain, learned) = (error("patches", form), error("patches+vis", form));
        eprintln!("{form}: {plain} {learned}");
        assert!(learned < 0.8 * plain, "{form}: {learned}, without learning {plain}");
    }
}

/// Forms without a control variate vary with the sampler's weights, and the paper's form is wrong unless the
/// sampler's density is the product.
#[test]
fn biased_forms_are_detected() {
    let environment = Arc::new(built_in("studio").unwrap());
    let expected = truth(&environment);
    let film = film(&environment, "cosine", settings(128, 2));
    let deviation = |form| {
        let (mean, error) = mean(&Mask::of(&film, form), 1);
        ((mean - expected.y).abs(), error)
    };
    for form in [MaskForm::Paper, MaskForm::Ratio] {
        let (off, error) = deviation(form);
        assert!(off > 10.0 * error && off > 0.02, "{form}: {off} +- {error}");
    }
    let (off, error) = deviation(MaskForm::ControlVariate);
    assert!(off < 4.5 * error + 1e-4, "{off} +- {error}");
}

/// Returns a dim sky with a lamp, of few texels, so that the irradiance table of a mesh is built quickly.
fn small_sky() -> Arc<Environment> {
    let pixel = |k: usize| match (k % 64, k / 64) {
        (8..12, 5..9) => [60.0, 50.0, 40.0],
        (_, row) => [0.5 + 0.01 * row as f32; 3],
    };
    let image = Image { width: 64, height: 32, pixels: (0..64 * 32).map(pixel).collect() };
    Arc::new(Environment::from_image("small sky", image).unwrap())
}

/// On a mesh without self-shadowing, the control variate is unbiased as well; the ratio is not.
#[test]
fn the_mask_of_a_mesh_without_self_shadowing_is_unbiased() {
    let environment = small_sky();
    let expected = truth(&environment);
    let catcher = Catcher::mesh(Scene::square(Vec3A::ZERO, Vec3A::Y, 60.0).unwrap());
    let film = film_on(&environment, "cosine", settings(128, 2), catcher);
    let deviation = |form| {
        let (mean, error) = mean(&Mask::of(&film, form), 1);
        ((mean - expected.y).abs(), error)
    };
    let (off, error) = deviation(MaskForm::Ratio);
    assert!(off > 10.0 * error && off > 0.02, "{off} +- {error}");
    for form in [MaskForm::Weights, MaskForm::ControlVariate] {
        // The table's irradiance has an error of 5e-5, the quadrature of 1e-4.
        let (off, error) = deviation(form);
        assert!(off < 4.5 * error + 1.5e-4, "{form}: {off} +- {error}");
    }
}

/// The light that a wall of the catcher blocks is not in the mask: forms agree with the integral over the
/// open directions.
#[test]
fn self_shadowing_of_a_mesh_is_excluded() {
    let environment = small_sky();
    let ground = Scene::square(Vec3A::ZERO, Vec3A::Y, 60.0).unwrap();
    // Besides the lid, a wall blocks light.
    let wall = Scene::square(Vec3A::new(0.8, 0.0, 0.0), Vec3A::NEG_X, 8.0).unwrap();
    let catcher = Catcher::mesh(ground.joined(&wall).unwrap());
    let film = film_on(&environment, "patches", settings(64, 64), catcher);
    let is_open = |wi: Vec3A| {
        wi.x <= 0.0 || {
            let at = wi * (0.8 / wi.x);
            at.y.abs() > 4.0 || at.z.abs() > 4.0
        }
    };
    let expected = truth_where(&environment, is_open);
    assert!((expected.y - truth(&environment).y).abs() > 0.02, "the wall should matter: {expected}");
    for form in [MaskForm::Ratio, MaskForm::Weights, MaskForm::ControlVariate] {
        // The bias of a ratio is of the order of its relative variance: at most 1/4 / 64 = 4e-3 for binary
        // visibility, and less than 10 % of that with stratified points.
        let (mean, error) = mean(&Mask::of(&film, form), 1);
        assert!((mean - expected.y).abs() < 4.5 * error + 5e-4, "{form}: {mean} +- {error}, not {}", expected.y);
    }
}

/// A white object on white ground under a white sky: shadows and reflected light cancel, and everything is as
/// bright as the sky.
#[test]
fn a_white_furnace_is_white() {
    let environment = Arc::new(Environment::from_image("white", grey(256, 128, 2.0).image).unwrap());
    let white: MaterialSpec = "lambert:albedo=1".parse().unwrap();
    let object = Scene::open("sphere").unwrap();
    let object = white.dress(object, &object_bounds()).unwrap();
    let camera = Camera::new(Vec3A::new(0.0, 2.0, 6.0), Vec3A::new(0.0, 0.5, 0.0), 40.0).unwrap();
    let (low, size) = (object.bounds().min.y, 48);
    let catcher = Catcher::plane(Vec3A::new(0.0, low, 0.0), Vec3A::Y, &object, &camera).unwrap();
    let stage = Stage::new(object, catcher).unwrap();
    // 1 in the photograph is the sky's radiance of 2.
    let photograph = grey(size, size, 1.0);
    let backdrop = Backdrop::new(&stage, &environment, &photograph, camera, Vec3A::splat(2.0));
    let estimator = SamplerSpec::brdf().build(&environment).unwrap();
    let composition = Composition { stage: &stage, backdrop: &backdrop, camera: &camera, estimator: &*estimator };
    let full = Settings { depth: 200, mask_only: false, ..settings(size, 256) };
    let film = compose(composition, full, &AtomicBool::new(false), &|_| {});
    let mask = Mask::of(&film, MaskForm::ControlVariate);
    let layers = Layers::new(&film, &mask, &photograph, Vec3A::splat(2.0), true);
    let composite = layers.composite();
    let covered: f32 = layers.alpha.iter().sum();
    assert!(covered > 100.0 && mask.values.iter().any(|value| value[1] < 0.7));
    let mean = |weight: &dyn Fn(usize) -> f32| {
        let sum: f32 = (0..size * size).map(|k| weight(k) * composite.pixels[k][1]).sum();
        sum / (0..size * size).map(weight).sum::<f32>()
    };
    // Hundreds of pixels of 256 samples with a standard deviation below 1: 3e-3 for the object, less for the
    // ground. The ground ends 60 sizes away, which removes 1e-3 of its light on the object.
    assert!((mean(&|k| layers.alpha[k]) - 1.0).abs() < 1e-2, "object {}", mean(&|k| layers.alpha[k]));
    assert!((mean(&|k| 1.0 - layers.alpha[k]) - 1.0).abs() < 3e-3, "ground {}", mean(&|k| 1.0 - layers.alpha[k]));
}

/// A mirror ball on a photograph, red on the left and green on the right, under a blue map: its lower part
/// reflects the photograph, its upper part the map.
#[test]
fn a_glossy_object_shows_the_photograph() {
    const SIDE: usize = 48;
    let blue = Image { width: 64, height: 32, pixels: vec![[0.0, 0.0, 1.0]; 64 * 32] };
    let environment = Arc::new(Environment::from_image("blue", blue).unwrap());
    let mirror: MaterialSpec = "ggx:alpha=0.01".parse().unwrap();
    let object = mirror.dress(Scene::open("sphere").unwrap(), &object_bounds()).unwrap();
    let camera = Camera::new(Vec3A::new(0.0, 2.0, 6.0), Vec3A::new(0.0, 0.5, 0.0), 40.0).unwrap();
    let low = Vec3A::new(0.0, object.bounds().min.y, 0.0);
    let stage = Stage::new(object, Catcher::plane(low, Vec3A::Y, &Scene::open("sphere").unwrap(), &camera).unwrap());
    let stage = stage.unwrap();
    let is_left = |k: usize| k % SIDE < SIDE / 2;
    let pixels = (0..SIDE * SIDE).map(|k| if is_left(k) { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] }).collect();
    let photograph = Photograph::of_radiance(Image { width: SIDE, height: SIDE, pixels });
    let backdrop = Backdrop::new(&stage, &environment, &photograph, camera, Vec3A::ONE);
    let estimator = SamplerSpec::brdf().build(&environment).unwrap();
    let composition = Composition { stage: &stage, backdrop: &backdrop, camera: &camera, estimator: &*estimator };
    let full = Settings { depth: 2, mask_only: false, ..settings(SIDE, 32) };
    let film = compose(composition, full, &AtomicBool::new(false), &|_| {});
    let layers = Layers::new(&film, &Mask::of(&film, MaskForm::ControlVariate), &photograph, Vec3A::ONE, true);
    let filled: Vec<usize> = (0..SIDE * SIDE).filter(|&k| layers.alpha[k] == 1.0).collect();
    let (top, bottom) = (filled[0] / SIDE, filled[filled.len() - 1] / SIDE);
    let mean = |is_there: &dyn Fn(usize) -> bool| {
        let own: Vec<Vec3A> =
            filled.iter().filter(|&&k| is_there(k)).map(|&k| layers.object.get(k % SIDE, k / SIDE)).collect();
        assert!(own.len() > 20, "{}", own.len());
        own.iter().sum::<Vec3A>() / own.len() as f32
    };
    let above = mean(&|k| k / SIDE < top + (bottom - top) / 3);
    let below = |left: bool| mean(&|k| k / SIDE > bottom - (bottom - top) / 3 && is_left(k) == left);
    // A smooth ball reflects all but a few per cent of the light, from one point per pixel.
    assert!(above.z > 0.9 && above.x + above.y < 0.05, "{above}");
    for (color, own, other) in [(below(true), 0, 1), (below(false), 1, 0)] {
        assert!(color[own] > 0.5 && color[other] < 0.1 * color[own] && color.z < 0.5 * color[own], "{own}: {color}");
    }
}

fn object_bounds() -> headtail_render::scene::Bounds {
    Scene::open("sphere").unwrap().bounds()
}

/// The lid below a wall that is lit only from below casts no shadow, although it blocks the light.
#[test]
fn light_from_below_the_horizon_casts_no_shadow() {
    let rows = |k: usize| if k < 16 * 8 { [0.0; 3] } else { [1.0; 3] };
    let image = Image { width: 16, height: 16, pixels: (0..256).map(rows).collect() };
    let environment = Arc::new(Environment::from_image("ground", image).unwrap());
    let object = Scene::square(Vec3A::new(0.0, -1.0, 0.5), Vec3A::Y, 1.0).unwrap();
    let wall = Scene::square(Vec3A::ZERO, Vec3A::Z, 4.0).unwrap();
    let camera = Camera::new(Vec3A::new(0.0, 0.5, 5.0), Vec3A::ZERO, 30.0).unwrap();
    let stage = Stage::new(object, Catcher::mesh(wall)).unwrap();
    let photograph = grey(16, 16, 1.0);
    let backdrop = Backdrop::new(&stage, &environment, &photograph, camera, Vec3A::ONE);
    let estimator = SamplerSpec::brdf().build(&environment).unwrap();
    let composition = Composition { stage: &stage, backdrop: &backdrop, camera: &camera, estimator: &*estimator };
    let film = compose(composition, settings(16, 16), &AtomicBool::new(false), &|_| {});
    assert!(film.catcher.iter().any(|sums| sums.hits > 0));
    for (sums, value) in film.catcher.iter().zip(Mask::of(&film, MaskForm::Ratio).values) {
        // The row of texels at the horizon is interpolated with the dark one above it.
        assert!(sums.hits == 0 || value[1] > 0.97, "{value:?}");
    }
}

/// A square mesh equals a plane: it has no self-shadowing, and its irradiance is in the table.
#[test]
fn a_flat_mesh_catches_as_a_plane_does() {
    let environment = Arc::new(built_in("studio").unwrap());
    let camera = Camera::new(Vec3A::new(0.0, 2.0, 4.0), Vec3A::ZERO, 40.0).unwrap();
    let masks = [true, false].map(|is_plane| {
        let object = lid();
        let catcher = if is_plane {
            Catcher::plane(Vec3A::ZERO, Vec3A::Y, &object, &camera).unwrap()
        } else {
            Catcher::mesh(Scene::square(Vec3A::ZERO, Vec3A::Y, 200.0).unwrap())
        };
        let stage = Stage::new(object, catcher).unwrap();
        let photograph = grey(32, 32, 1.0);
        let backdrop = Backdrop::new(&stage, &environment, &photograph, camera, Vec3A::ONE);
        let estimator = SamplerSpec::patches().build(&environment).unwrap();
        let composition = Composition { stage: &stage, backdrop: &backdrop, camera: &camera, estimator: &*estimator };
        let film = compose(composition, settings(32, 64), &AtomicBool::new(false), &|_| {});
        Mask::of(&film, MaskForm::Ratio)
    });
    let sums = masks.each_ref().map(|mask| mask.values.iter().map(|value| f64::from(value[1])).sum::<f64>() / 1024.0);
    // Equal random numbers at points that differ by rounding.
    assert!((sums[0] - sums[1]).abs() < 1e-3 && sums[0] < 0.97, "{sums:?}");
}

/// Returns a lid over a plane, whose camera sees the sky too.
fn lid_from_afar() -> (Stage, Arc<Environment>, Camera) {
    let object = lid();
    let camera = Camera::new(Vec3A::new(0.0, 1.5, 6.0), Vec3A::new(0.0, 1.5, 0.0), 50.0).unwrap();
    let catcher = Catcher::plane(Vec3A::ZERO, Vec3A::Y, &object, &camera).unwrap();
    (Stage::new(object, catcher).unwrap(), Arc::new(built_in("studio").unwrap()), camera)
}

#[test]
fn unaffected_pixels_equal_the_photograph_bit_for_bit() {
    let (stage, environment, camera) = lid_from_afar();
    let pixels = (0..24 * 24).map(|k| [0.1 + k as f32 / 100.0, 0.3, 0.7]).collect();
    let photograph = Photograph::of_radiance(Image { width: 24, height: 24, pixels });
    let backdrop = Backdrop::new(&stage, &environment, &photograph, camera, Vec3A::ONE);
    let estimator = SamplerSpec::patches().build(&environment).unwrap();
    let composition = Composition { stage: &stage, backdrop: &backdrop, camera: &camera, estimator: &*estimator };
    let full = Settings { depth: 3, mask_only: false, ..settings(24, 8) };
    let films = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| compose(composition, full, &AtomicBool::new(false), &|_| {}))
    });
    assert!(films[0].catcher == films[1].catcher && films[0].object == films[1].object, "threads change the film");
    let mask = Mask::of(&films[0], MaskForm::ControlVariate);
    let layers = Layers::new(&films[0], &mask, &photograph, Vec3A::ONE, true);
    let above = 24 * 6;
    assert_eq!(layers.composite().pixels[..above], photograph.image.pixels[..above]);
    assert!(layers.alpha.iter().sum::<f32>() > 1.0);
    assert!(layers.composite().pixels.as_flattened().iter().all(|value| value.is_finite()));
}

/// Values that are not radiance stay where nothing touches a pixel, and spread nowhere.
#[test]
fn unaffected_pixels_keep_infinite_negative_and_missing_values() {
    const SIDE: usize = 24;
    let (stage, environment, camera) = lid_from_afar();
    let odd = [f32::INFINITY, -0.5, f32::NAN];
    let pixels = (0..SIDE * SIDE).map(|k| if k % 2 == 0 { odd } else { [0.5; 3] }).collect();
    let photograph = Photograph::of_radiance(Image { width: SIDE, height: SIDE, pixels });
    let backdrop = Backdrop::new(&stage, &environment, &photograph, camera, Vec3A::ONE);
    let estimator = SamplerSpec::patches().build(&environment).unwrap();
    let composition = Composition { stage: &stage, backdrop: &backdrop, camera: &camera, estimator: &*estimator };
    let full = Settings { depth: 3, mask_only: false, ..settings(SIDE, 8) };
    let film = compose(composition, full, &AtomicBool::new(false), &|_| {});
    let layers = Layers::new(&film, &Mask::of(&film, MaskForm::ControlVariate), &photograph, Vec3A::ONE, true);
    let composite = layers.composite().pixels;
    let is_odd = |pixel: &[f32; 3]| pixel[0] == f32::INFINITY && pixel[1] == -0.5 && pixel[2].is_nan();
    let is_kept = |(k, pixel): (usize, &[f32; 3])| if k % 2 == 0 { is_odd(pixel) } else { *pixel == [0.5; 3] };
    assert!(composite[..SIDE * 6].iter().enumerate().all(is_kept));
    let touched: Vec<&[f32; 3]> = composite.iter().step_by(2).filter(|pixel| !is_odd(pixel)).collect();
    assert!(touched.len() > 20 && touched.iter().copied().flatten().all(|value| value.is_finite()), "{touched:?}");
}
