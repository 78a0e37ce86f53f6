//! Checkpoints come back as they were written, and nothing else does.

use std::{cell::RefCell, fs};

use tempfile::TempDir;

use super::*;
use crate::{optimizer::OptimizerState, state::Kept};

const WEIGHTS: usize = 7;

fn run(step: usize) -> SavedRun {
    let list = |start: f32| (0..WEIGHTS).map(|i| start + (i as f32).sqrt() * 1e-3).collect::<Vec<f32>>();
    SavedRun {
        state: TrainingState {
            step,
            skipped: 2,
            loss: 0.1 + step as f32,
            weights: list(step as f32),
            average: Vec::new(),
            optimizer: OptimizerState {
                moves: step as u64 - 2,
                first_moments: list(-0.3),
                second_moments: list(1e-20),
            },
            rate_factor: 0.5,
            kept: Some(Kept {
                divergence: Divergence { kl: 0.1, log_chi_square: 0.2, relative_variance: 0.3 + step as f64 },
                weights: list(4.0),
                average: Vec::new(),
                optimizer: OptimizerState { moves: 3, first_moments: list(5.0), second_moments: list(6.0) },
            }),
        },
        seconds: 1.25,
    }
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

/// What a run would go on from, and the warnings.
fn resume(folder: &CheckpointFolder, config: &FitConfig) -> (Result<Option<SavedRun>>, Vec<String>) {
    let warnings = RefCell::new(Vec::new());
    let found = folder.open(config, WEIGHTS, &mut |error| warnings.borrow_mut().push(error.to_string()));
    (found, warnings.into_inner())
}

#[test]
fn the_last_checkpoint_comes_back_to_the_bit_and_three_stay() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = folder(&temporary, true);
    let config = FitConfig::default();
    assert_eq!(resume(&folder, &config).0.unwrap(), None);
    for step in [10, 20, 30, 40, 50] {
        folder.save(&config, &run(step)).unwrap();
    }
    assert_eq!(names(&folder), ["step-000000030", "step-000000040", "step-000000050"]);
    let (found, warnings) = resume(&folder, &config);
    assert_eq!(found.unwrap().unwrap(), run(50));
    assert!(warnings.is_empty());
    // The same step can be reached again.
    folder.save(&config, &SavedRun { seconds: 9.0, ..run(50) }).unwrap();
    assert_eq!(resume(&folder, &config).0.unwrap().unwrap().seconds, 9.0);
}

#[test]
fn a_damaged_checkpoint_is_refused_by_name_and_the_one_before_it_used() {
    let config = FitConfig::default();
    type Damage = fn(&Path);
    let damages: [(&str, Damage); 7] = [
        (STATE, |path| fs::write(path.join(STATE), &fs::read(path.join(STATE)).unwrap()[..100]).unwrap()),
        (STATE, |path| {
            let mut bytes = fs::read(path.join(STATE)).unwrap();
            *bytes.last_mut().unwrap() ^= 1;
            fs::write(path.join(STATE), bytes).unwrap();
        }),
        (STATE, |path| fs::remove_file(path.join(STATE)).unwrap()),
        (MANIFEST, |path| {
            let text = fs::read_to_string(path.join(MANIFEST)).unwrap().replace("\"step\": 20", "\"step\": 21");
            fs::write(path.join(MANIFEST), text).unwrap();
        }),
        (MANIFEST, |path| fs::write(path.join(MANIFEST), "").unwrap()),
        (CHECKSUMS, |path| fs::remove_file(path.join(CHECKSUMS)).unwrap()),
        ("step-000000020", |path| fs::write(path.join(CHECKSUMS), "").unwrap()),
    ];
    for (named, damage) in damages {
        let temporary = tempfile::tempdir().unwrap();
        let folder = folder(&temporary, true);
        folder.save(&config, &run(10)).unwrap();
        folder.save(&config, &run(20)).unwrap();
        damage(&folder.path(20));
        let (found, warnings) = resume(&folder, &config);
        assert_eq!(found.unwrap().unwrap(), run(10), "{named}");
        assert!(
            warnings.len() == 1 && warnings[0].contains(named) && warnings[0].contains("step-000000020"),
            "{warnings:?}"
        );
        assert_eq!(names(&folder), ["refused-step-000000020", "step-000000010"]);
        // Where all are damaged, the run starts afresh.
        fs::remove_file(folder.path(10).join(STATE)).unwrap();
        assert_eq!(resume(&folder, &config).0.unwrap(), None);
    }
}

#[test]
fn a_checkpoint_of_another_run_is_an_error() {
    let temporary = tempfile::tempdir().unwrap();
    let here = folder(&temporary, true);
    let config = FitConfig::default();
    here.save(&config, &run(10)).unwrap();
    // A longer run goes on from it, a shorter one does not.
    let of_steps = |steps| resume(&here, &FitConfig { steps, ..config.clone() });
    assert_eq!(of_steps(config.steps + 1).0.unwrap(), Some(run(10)));
    assert!(of_steps(config.steps - 1).0.unwrap_err().to_string().contains("`steps`"));
    for (key, other) in [
        ("learning_rate", FitConfig { learning_rate: 1e-3, ..config.clone() }),
        ("head.bins", FitConfig { head: headtail_model::HeadConfig { bins: 5, ..config.head }, ..config }),
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
fn what_a_kill_leaves_half_done_is_ignored_and_removed() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = folder(&temporary, true);
    let config = FitConfig::default();
    folder.save(&config, &run(10)).unwrap();
    for name in [".unfinished-step-000000020", ".unfinished-removed-step-000000005"] {
        fs::create_dir(folder.folder.join(name)).unwrap();
        fs::write(folder.folder.join(name).join(STATE), "half").unwrap();
    }
    assert_eq!(resume(&folder, &config).0.unwrap().unwrap(), run(10));
    folder.save(&config, &run(20)).unwrap();
    assert_eq!(names(&folder), ["step-000000010", "step-000000020"]);
}

#[test]
fn a_folder_that_cannot_be_made_is_an_error() {
    let temporary = tempfile::tempdir().unwrap();
    fs::write(temporary.path().join("run"), "in the way").unwrap();
    let error = resume(&folder(&temporary, true), &FitConfig::default()).0.unwrap_err().to_string();
    assert!(error.contains("run"), "{error}");
}
