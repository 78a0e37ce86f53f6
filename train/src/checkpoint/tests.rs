//! Checkpoints round-trip, and damaged or foreign ones are rejected.

use std::cell::RefCell;

use tempfile::TempDir;

use super::*;
use crate::{
    Divergence, FitConfig, GradientForm,
    optimizer::OptimizerState,
    state::{BestValidation, Parameters, as_json},
};

const WEIGHTS: usize = 7;

fn blank() -> TrainingState {
    TrainingState::new(&FitConfig::default(), vec![0.0; WEIGHTS])
}

fn state(step: usize) -> TrainingState {
    let parameters = |moves: usize, start: f32| {
        let list = |start: f32| (0..WEIGHTS).map(|i| start + (i as f32).sqrt() * 1e-3).collect::<Vec<f32>>();
        let [first_moments, second_moments] = [list(start - 0.3), list(1e-20 * start)];
        let optimizer = OptimizerState { moves: moves as u64, first_moments, second_moments };
        Parameters { weights: list(start), average: Vec::new(), optimizer }
    };
    // Numbers whose decimals lose the last bit, and one that JSON cannot represent.
    let divergence = Divergence { kl: 0.1_f64.sqrt(), log_chi_square: f64::INFINITY, relative_variance: step as f64 };
    TrainingState {
        step,
        skipped: 2,
        loss: Some(0.1 + step as f32),
        mean_loss: Some(0.7),
        seconds: 1.25,
        rate_factor: 0.5,
        parameters: parameters(step - 2, step as f32),
        best: Some(BestValidation { divergence, parameters: parameters(3, 4.0) }),
        ..blank()
    }
}

fn save(folder: &CheckpointFolder, config: &FitConfig, state: &TrainingState) {
    fs::create_dir_all(&folder.folder).unwrap();
    folder.save(&as_json(config), state).unwrap();
}

fn folder(temporary: &TempDir, resume: bool) -> CheckpointFolder {
    CheckpointFolder { folder: temporary.path().join("run"), every: 10, resume, target: "environment 1234".into() }
}

fn names(folder: &CheckpointFolder) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(&folder.folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Returns the state that a run would resume from, and the warnings.
fn resume(folder: &CheckpointFolder, config: &FitConfig) -> (Result<Option<TrainingState>>, Vec<String>) {
    let warnings = RefCell::new(Vec::new());
    let found = folder.open(&as_json(config), &blank(), &mut |error| warnings.borrow_mut().push(error.to_string()));
    (found, warnings.into_inner())
}

#[test]
fn the_last_checkpoint_is_restored_bit_identically_and_three_are_kept() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = folder(&temporary, true);
    let config = FitConfig::default();
    assert_eq!(resume(&folder, &config).0.unwrap(), None);
    for step in [10, 20, 30, 40, 50] {
        save(&folder, &config, &state(step));
    }
    assert_eq!(names(&folder), ["step-000000030", "step-000000040", "step-000000050"]);
    let (found, warnings) = resume(&folder, &config);
    assert_eq!(found.unwrap().unwrap(), state(50));
    assert!(warnings.is_empty());
    // The same step can be saved again.
    save(&folder, &config, &TrainingState { seconds: 9.0, ..state(50) });
    assert_eq!(resume(&folder, &config).0.unwrap().unwrap().seconds, 9.0);
}

#[test]
fn a_damaged_checkpoint_is_named_and_the_previous_one_is_used() {
    let config = FitConfig::default();
    type Damage = fn(&mut Vec<u8>);
    let damages: [Damage; 4] =
        [|bytes| bytes.truncate(100), |bytes| bytes[300] ^= 1, |bytes| *bytes.last_mut().unwrap() ^= 1, Vec::clear];
    for damage in damages {
        let temporary = tempfile::tempdir().unwrap();
        let folder = folder(&temporary, true);
        save(&folder, &config, &state(10));
        save(&folder, &config, &state(20));
        let damaged = |step| {
            let mut bytes = fs::read(folder.path(step)).unwrap();
            damage(&mut bytes);
            fs::write(folder.path(step), bytes).unwrap();
        };
        damaged(20);
        let (found, warnings) = resume(&folder, &config);
        assert_eq!(found.unwrap().unwrap(), state(10));
        assert!(warnings.len() == 1 && warnings[0].contains("step-000000020: does not have"), "{warnings:?}");
        assert_eq!(names(&folder), ["refused-step-000000020", "step-000000010"]);
        // If all are damaged, the run starts from the beginning.
        damaged(10);
        assert_eq!(resume(&folder, &config).0.unwrap(), None);
    }
}

#[test]
fn a_run_moves_between_forms_of_the_gradient_and_says_so() {
    let temporary = tempfile::tempdir().unwrap();
    let here = folder(&temporary, true);
    let config = FitConfig { gradient: GradientForm::Fused, ..FitConfig::default() };
    save(&here, &config, &state(10));
    let (found, warnings) = resume(&here, &FitConfig { gradient: GradientForm::Device, ..config });
    assert_eq!(found.unwrap(), Some(state(10)));
    assert!(
        warnings.len() == 1 && warnings[0].contains(r#"gradient = "fused"; it goes on with "device""#),
        "{warnings:?}"
    );
}

#[test]
fn a_checkpoint_of_another_run_is_an_error() {
    let temporary = tempfile::tempdir().unwrap();
    let here = folder(&temporary, true);
    let config = FitConfig::default();
    save(&here, &config, &state(10));
    // A longer run resumes from it, a shorter one does not.
    let of_steps = |steps| resume(&here, &FitConfig { steps, ..config.clone() });
    assert_eq!(of_steps(config.steps + 1).0.unwrap(), Some(state(10)));
    assert!(of_steps(config.steps - 1).0.unwrap_err().to_string().contains("`steps`"));
    for (key, other) in [
        ("learning_rate", FitConfig { learning_rate: 1e-3, ..config.clone() }),
        ("head.bins", FitConfig { head: headtail_model::HeadConfig { bins: 5, ..config.head }, ..config.clone() }),
    ] {
        let error = resume(&here, &other).0.unwrap_err().to_string();
        assert!(error.contains(&format!("`{key}`")) && error.contains("step-000000010"), "{error}");
    }
    let elsewhere = CheckpointFolder { target: "environment 99".into(), ..here.clone() };
    assert!(resume(&elsewhere, &config).0.unwrap_err().to_string().contains("environment 1234"));
    let fresh = folder(&temporary, false);
    assert!(resume(&fresh, &config).0.unwrap_err().to_string().contains("earlier run"));
    assert_eq!(names(&here), ["step-000000010"], "nothing is set aside");
}

#[test]
fn an_undamaged_checkpoint_that_cannot_be_used_is_an_error_with_its_field() {
    let config = FitConfig::default();
    type Change = fn(&mut TrainingState);
    let changes: [(&str, Change); 7] = [
        ("0.weights: F32 [6], expected F32 [7]", |state| state.parameters.weights.truncate(6)),
        ("0.best.average: F32 [1]", |state| state.best.as_mut().unwrap().parameters.average.push(0.0)),
        ("0.second_moments: inf", |state| state.parameters.optimizer.second_moments[3] = f32::INFINITY),
        ("`moves`", |state| state.parameters.optimizer.moves = 11),
        ("`skipped`", |state| state.skipped = usize::MAX),
        ("`step`", |state| state.step = usize::MAX),
        ("`rate_factor`", |state| state.rate_factor = -0.5),
    ];
    for (named, change) in changes {
        let temporary = tempfile::tempdir().unwrap();
        let folder = folder(&temporary, true);
        let mut changed = state(10);
        change(&mut changed);
        save(&folder, &config, &changed);
        let error = resume(&folder, &config).0.unwrap_err().to_string();
        assert!(error.contains(named) && error.contains("step-") && error.contains("start again"), "{error}");
    }
}

#[test]
fn a_checkpoint_of_an_earlier_format_is_an_error() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = folder(&temporary, true);
    fs::create_dir_all(folder.path(30)).unwrap();
    let error = resume(&folder, &FitConfig::default()).0.unwrap_err().to_string();
    assert!(error.ends_with("is a checkpoint of an earlier version; remove it to start again"), "{error}");
    assert_eq!(names(&folder), ["step-000000030"], "nothing is set aside");
}

#[test]
fn unfinished_checkpoints_are_ignored_and_removed() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = folder(&temporary, true);
    let config = FitConfig::default();
    save(&folder, &config, &state(10));
    fs::write(folder.folder.join(UNFINISHED), "half").unwrap();
    assert_eq!(resume(&folder, &config).0.unwrap().unwrap(), state(10));
    save(&folder, &config, &state(20));
    assert_eq!(names(&folder), ["step-000000010", "step-000000020"]);
}

#[test]
fn a_folder_that_cannot_be_created_is_an_error() {
    let temporary = tempfile::tempdir().unwrap();
    fs::write(temporary.path().join("run"), "in the way").unwrap();
    let error = resume(&folder(&temporary, true), &FitConfig::default()).0.unwrap_err().to_string();
    assert!(error.contains("run"), "{error}");
}
