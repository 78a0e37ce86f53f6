use super::*;

fn grid(from: f64, to: f64) -> impl Iterator<Item = f32> {
    (0..=200_000).map(move |k| (from + (to - from) * f64::from(k) / 200_000.0) as f32)
}

#[test]
fn exponential_and_logarithm_match_the_standard_library() {
    for x in grid(-86.9, 87.9) {
        let expected = f64::from(x).exp();
        assert!((f64::from(exp(x)) - expected).abs() < 2e-7 * expected, "{x}");
    }
    for x in grid(-86.0, 88.0).map(|x| f64::from(x).exp() as f32).chain(grid(0.5, 2.0)) {
        let expected = f64::from(x).ln();
        assert!((f64::from(ln(x)) - expected).abs() < 2e-7 * expected.abs().max(1.0), "{x} {} {expected}", ln(x));
    }
}

#[test]
fn arguments_out_of_range_stay_finite() {
    for x in [-1e30, -88.0, 89.0, 1e30] {
        assert!(exp(x).is_finite() && exp(x) > 0.0 && softplus(x).is_finite() && sigmoid(x).is_finite());
    }
    for function in [exp, ln, softplus, sigmoid] {
        assert!(function(f32::NAN).is_nan());
    }
    for x in grid(-20.0, 20.0) {
        let expected = f64::from(x).exp().ln_1p();
        assert!((f64::from(softplus(x)) - expected).abs() < 2e-7 * expected.max(1.0));
        assert!((f64::from(sigmoid(x)) - 1.0 / (1.0 + (-f64::from(x)).exp())).abs() < 2e-7);
    }
}

#[test]
fn cosine_and_sine_match_the_standard_library() {
    for turns in grid(-2.0, 2.0).chain([0.25, 0.5, 0.75, 1.0, 999.9]) {
        let (cos, sin) = cos_sin_turns(turns);
        let (expected_sin, expected_cos) = (f64::from(turns) * std::f64::consts::TAU).sin_cos();
        assert!((f64::from(cos) - expected_cos).abs() < 2e-7, "{turns}: {cos} {expected_cos}");
        assert!((f64::from(sin) - expected_sin).abs() < 2e-7, "{turns}: {sin} {expected_sin}");
    }
}

#[test]
fn angles_match_the_standard_library() {
    for turns in grid(-0.499_999, 0.499_999).chain([1e-9, 1e-30, 0.25, 0.125, 0.062_5, 0.5]) {
        let (sin, cos) = (f64::from(turns) * std::f64::consts::TAU).sin_cos();
        for scale in [1.0, 1e-18, 1e18] {
            let (y, x) = ((scale * sin) as f32, (scale * cos) as f32);
            let expected = f64::from(y).atan2(f64::from(x)) / std::f64::consts::TAU;
            let angle = f64::from(atan2_turns(y, x));
            assert!((angle - expected).abs() <= 3e-7 * expected.abs(), "{y} {x}: {angle} {expected}");
        }
    }
    assert_eq!(atan2_turns(0.0, 0.0), 0.0);
    assert!(atan2_turns(f32::NAN, 1.0).is_nan() && atan2_turns(1.0, f32::NAN).is_nan());
}

#[test]
fn dispatched_work_is_done() {
    struct Fill<'a>(&'a mut Lanes);
    impl Vectorized for Fill<'_> {
        #[inline(always)]
        fn run<S: Simd>(self, _simd: S) {
            for (k, x) in self.0.iter_mut().enumerate() {
                *x = exp(k as f32);
            }
        }
    }
    let mut values = [0.0; LANES];
    dispatch(Fill(&mut values));
    assert_eq!(values[3], exp(3.0));
}

/// All functions of this module.
struct Functions<'a> {
    x: &'a [Lanes],
    y: &'a [Lanes],
    out: &'a mut [[Lanes; 7]],
}

impl Vectorized for Functions<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        for ((x, y), out) in self.x.iter().zip(self.y).zip(self.out) {
            for l in 0..LANES {
                out[0][l] = exp(x[l]);
                out[1][l] = ln(x[l]);
                out[2][l] = softplus(x[l]);
                out[3][l] = sigmoid(x[l]);
                (out[4][l], out[5][l]) = cos_sin_turns(x[l]);
                out[6][l] = atan2_turns(y[l], x[l]);
            }
        }
    }
}

#[test]
fn functions_give_the_same_bits_with_every_instruction_set() {
    // Every 4099th bit pattern, including NaN and infinities, then numbers of common magnitude.
    let patterns = (0..1_u32 << 20).map(|k| f32::from_bits(k.wrapping_mul(4099)));
    let x: Vec<f32> = patterns.chain((0..1 << 20).map(|k| (k - (1 << 19)) as f32 * 1.7e-4)).collect();
    let y: Vec<f32> = x.iter().rev().map(|y| y * 0.7).collect();
    let (x, y) = (x.as_chunks::<LANES>().0, y.as_chunks::<LANES>().0);
    let results: Vec<_> = available()
        .into_iter()
        .map(|set| {
            let mut out = vec![[[0.0; LANES]; 7]; x.len()];
            set.arch.dispatch(Op(Functions { x, y, out: &mut out }));
            (set.name, out)
        })
        .collect();
    let (reference, expected) = results.last().unwrap();
    assert_eq!(*reference, "portable");
    for (name, out) in &results {
        for (k, (out, expected)) in out.iter().zip(expected).enumerate() {
            for (function, (out, expected)) in out.iter().zip(expected).enumerate() {
                for l in 0..LANES {
                    // The payload of NaN is not compared.
                    let equal = out[l].to_bits() == expected[l].to_bits() || out[l].is_nan() && expected[l].is_nan();
                    assert!(equal, "{name}, function {function} of {}: {} {}", x[k][l], out[l], expected[l]);
                }
            }
        }
    }
}

#[test]
fn an_instruction_set_is_chosen_by_its_name() {
    let choose = |name: &str| choose(Some(OsStr::new(name))).map(|set| set.name);
    for set in available() {
        assert_eq!(choose(set.name), Ok(set.name));
    }
    assert_eq!(super::choose(None).map(|set| set.name), Ok(available()[0].name));
    for unknown in ["", "AVX2", "mmx", if cfg!(target_arch = "x86_64") { "neon" } else { "avx2" }] {
        let reason = choose(unknown).unwrap_err();
        assert!(reason.starts_with(&format!("{unknown:?} is not an instruction set of this processor")), "{reason}");
        assert!(reason.ends_with("portable"), "{reason}");
    }
}

/// Run by the next test in a separate process.
#[test]
fn the_instruction_set_has_a_name() {
    let name = instruction_set().unwrap();
    println!("it is {name}");
    assert!(available().iter().any(|set| set.name == name));
}

#[test]
fn the_environment_variable_names_the_instruction_set() {
    let run = |value: &str, test: &str| {
        let program = std::env::current_exe().unwrap();
        let mut command = std::process::Command::new(program);
        command.args(["--exact", "--nocapture", &format!("simd::tests::{test}")]).env(VARIABLE, value);
        let output = command.output().unwrap();
        (output.status.success(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
    };
    for set in available() {
        let (success, output) = run(set.name, "the_instruction_set_has_a_name");
        assert!(success && output.contains(&format!("it is {}", set.name)), "{output}");
    }
    let (success, output) = run("mmx", "the_instruction_set_has_a_name");
    assert!(!success && output.contains("HEADTAIL_SIMD") && output.contains("portable"), "{output}");
    let (success, output) = run("mmx", "dispatched_work_is_done");
    assert!(success, "an unknown name is reported, and work is done all the same: {output}");
}
