//! `metrics.jsonl`: one JSON object per line and validation.

use std::{
    fs::{self, File, OpenOptions},
    io::Write,
    path::{Path, PathBuf},
};

use headtail_render::file;
use serde::Serialize;

use crate::{Error, Progress, Result};

/// A line: the keys of [`Progress`] except `steps`, and of its divergence. The first line is that of the
/// untrained head. Non-finite numbers are written as `null`.
#[derive(Serialize)]
struct Row<'a> {
    #[serde(flatten)]
    progress: &'a Progress,
    seed: u64,
    /// The program's version.
    version: &'static str,
}

/// The `metrics.jsonl` file of a run.
pub struct MetricsFile {
    path: PathBuf,
    seed: u64,
    /// Opened at the first step, which determines where the run resumes.
    file: Option<File>,
    /// The step of the last line; a run resumed at its end measures that step again.
    last: Option<u64>,
}

impl MetricsFile {
    /// Writes lines to `path`. A new run replaces the file, a resumed one keeps the lines up to its step.
    pub fn new(path: &Path, seed: u64) -> Self {
        Self { path: path.to_owned(), seed, file: None, last: None }
    }

    /// Adds a line if there was a validation.
    ///
    /// # Errors
    /// [`Error::Output`] if the file cannot be written.
    pub fn add(&mut self, progress: &Progress) -> Result<()> {
        let failed = |reason: std::io::Error| Error::Output { path: self.path.clone(), reason: reason.to_string() };
        let file = match &mut self.file {
            Some(file) => file,
            closed => {
                let (file, last) = open(&self.path, progress.step).map_err(failed)?;
                self.last = last;
                closed.insert(file)
            }
        };
        let is_told = self.last == Some(progress.step as u64);
        if progress.divergence.is_none() || is_told {
            return Ok(());
        }
        self.last = Some(progress.step as u64);
        let row = Row { progress, seed: self.seed, version: env!("CARGO_PKG_VERSION") };
        let line = serde_json::to_string(&row).expect("a row can be written as JSON") + "\n";
        file.write_all(line.as_bytes()).map_err(failed)
    }
}

/// Opens the file for appending, without lines of steps beyond `step` or truncated lines; returns also the
/// last line's step.
fn open(path: &Path, step: usize) -> std::io::Result<(File, Option<u64>)> {
    let (mut kept, mut last) = (String::new(), None);
    if step > 0 && path.exists() {
        for line in fs::read_to_string(path)?.split_inclusive('\n') {
            let row: serde_json::Value = serde_json::from_str(line).unwrap_or_default();
            let known = row["step"].as_u64().filter(|&other| other <= step as u64 && line.ends_with('\n'));
            if known.is_some() {
                kept += line;
                last = known;
            }
        }
    }
    file::replace(path, kept.as_bytes()).map_err(std::io::Error::other)?;
    Ok((OpenOptions::new().append(true).open(path)?, last))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Divergence;

    fn progress(step: usize, validated: bool) -> Progress {
        let divergence = Divergence { kl: 0.1, log_chi_square: 0.2, relative_variance: f64::INFINITY };
        Progress {
            step,
            steps: 100,
            loss: if step == 0 { f32::NAN } else { 0.5 },
            mean_loss: None,
            divergence: validated.then_some(divergence),
            learning_rate: 1e-3,
            samples_per_second: 5e4,
            seconds: 1.5,
            skipped: 0,
        }
    }

    fn steps(path: &Path) -> Vec<u64> {
        let text = fs::read_to_string(path).unwrap();
        let row = |line: &str| serde_json::from_str::<serde_json::Value>(line).unwrap()["step"].as_u64().unwrap();
        text.lines().map(row).collect()
    }

    #[test]
    fn each_validation_adds_a_line_and_a_resumed_run_continues_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let mut file = MetricsFile::new(&path, 3);
        for step in 0..=25 {
            file.add(&progress(step, step % 10 == 0)).unwrap();
        }
        assert_eq!(steps(&path), [0, 10, 20]);
        // Killed in the middle of a line, resumed at step 15.
        let text = fs::read_to_string(&path).unwrap();
        fs::write(&path, text.clone() + &text[..40]).unwrap();
        let mut file = MetricsFile::new(&path, 3);
        file.add(&progress(15, false)).unwrap();
        file.add(&progress(20, true)).unwrap();
        assert_eq!(steps(&path), [0, 10, 20]);
        // Resumed at its end.
        let mut file = MetricsFile::new(&path, 3);
        file.add(&progress(20, false)).unwrap();
        file.add(&progress(20, true)).unwrap();
        assert_eq!(steps(&path), [0, 10, 20]);
        MetricsFile::new(&path, 3).add(&progress(0, true)).unwrap();
        assert_eq!(steps(&path), [0], "a new run replaces the file");
    }

    /// A kill during an in-place write would leave a partial file.
    #[test]
    fn lines_are_dropped_in_a_new_file() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other_name) = (folder.path().join("metrics.jsonl"), folder.path().join("before"));
        let mut file = MetricsFile::new(&path, 3);
        (0..3).for_each(|k| file.add(&progress(10 * k, true)).unwrap());
        fs::hard_link(&path, &other_name).unwrap();
        MetricsFile::new(&path, 3).add(&progress(10, false)).unwrap();
        assert_eq!((steps(&path), steps(&other_name)), (vec![0, 10], vec![0, 10, 20]));
    }

    #[test]
    fn a_file_that_cannot_be_written_is_named() {
        let error = MetricsFile::new(Path::new("/nowhere/metrics.jsonl"), 0).add(&progress(0, true)).unwrap_err();
        assert!(error.to_string().contains("/nowhere/metrics.jsonl"), "{error}");
    }
}
