//! Keeps outputs apart from inputs: the files that the command has opened, and those that it will replace.
//!
//! Files are compared by identity, whatever links and spellings lead to them. An output that was opened is
//! rejected, and so is opening an input that is a planned output: both before the file is replaced.

use std::{
    io,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

use anyhow::{Result, bail};
use headtail_render::{
    file,
    path_text::{path_of, text_of},
};

#[derive(Default)]
struct Files {
    opened: Vec<PathBuf>,
    planned: Vec<PathBuf>,
}

static FILES: Mutex<Files> = Mutex::new(Files { opened: Vec::new(), planned: Vec::new() });

fn files() -> MutexGuard<'static, Files> {
    FILES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Begins to watch the files that this process opens.
pub fn watch() {
    file::watch_inputs(|path| {
        let mut files = files();
        // An input even if it is rejected: not all callers report the error.
        if !files.opened.iter().any(|known| known == path) {
            files.opened.push(path.to_owned());
        }
        match files.planned.iter().find(|output| file::is_same(output, path)) {
            None => Ok(()),
            Some(output) => Err(io::Error::other(format!(
                "the input is also an output of this command, {}; name another output",
                output.display()
            ))),
        }
    });
}

/// Returns the path by which this process opened a file as an input.
fn input_at(path: &Path) -> Option<PathBuf> {
    files().opened.iter().find(|input| file::is_same(input, path)).cloned()
}

/// Whether a path leads to a file that this process opened as an input.
pub fn is_input(path: &Path) -> bool {
    input_at(path).is_some()
}

/// Returns what to do about an output that exists. An argument other than that of `--out` or `--file` may name
/// it, possibly after `=` or `:` and before `#`: then it is an input, and `--force` would not help.
pub fn advice(path: &Path) -> &'static str {
    let is_output = |option: &str| ["--out", "--file"].contains(&option);
    let names = |argument: &str| {
        let starts = argument.match_indices(['=', ':']).map(|(at, _)| at + 1);
        let mut parts = std::iter::once(0).chain(starts).map(|start| &argument[start..]);
        let leads = |name: &str| file::is_same(&path_of(name), path);
        parts.any(|part| leads(part) || leads(part.split('#').next().unwrap_or_default()))
    };
    let arguments: Vec<String> =
        std::env::args_os().map(|argument| text_of(Path::new(&argument)).into_owned()).collect();
    let mut pairs = arguments.windows(2);
    let is_input = pairs.any(|pair| {
        let option = pair[1].split('=').next().unwrap_or_default();
        !is_output(&pair[0]) && !is_output(option) && names(&pair[1])
    });
    if is_input { "it is also an input; name another output" } else { "name another, or replace it by --force" }
}

/// Returns an error if an output is a file that this process opened as an input.
///
/// # Errors
/// See above.
pub fn check_output(path: &Path) -> Result<()> {
    let Some(input) = input_at(path) else { return Ok(()) };
    bail!("{}: the output is also an input, {}; name another output", path.display(), input.display())
}

/// A file that this command will replace; until this is dropped, it cannot be opened as an input.
#[derive(Debug)]
pub struct Planned(PathBuf);

impl Planned {
    /// Plans to replace a file, which need not exist.
    ///
    /// # Errors
    /// As [`check_output`].
    pub fn new(path: &Path) -> Result<Self> {
        check_output(path)?;
        files().planned.push(path.to_owned());
        Ok(Self(path.to_owned()))
    }
}

impl Drop for Planned {
    fn drop(&mut self) {
        let mut files = files();
        if let Some(index) = files.planned.iter().position(|path| *path == self.0) {
            files.planned.swap_remove(index);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    #[cfg(unix)]
    fn files_are_inputs_or_outputs_whatever_leads_to_them() {
        watch();
        let here = tempfile::tempdir().unwrap();
        let path = |name: &str| here.path().join(name);
        fs::create_dir(path("folder")).unwrap();
        for name in ["map", "other"] {
            fs::write(path(name), name).unwrap();
            fs::hard_link(path(name), path(&format!("hard {name}"))).unwrap();
            std::os::unix::fs::symlink(path(name), path(&format!("soft {name}"))).unwrap();
        }
        let all = |name: &str| {
            [name.to_owned(), format!("folder/../{name}"), format!("hard {name}"), format!("soft {name}")]
                .map(|name| path(&name))
        };
        file::open_regular(&path("map")).unwrap();
        for output in all("map") {
            assert!(is_input(&output));
            let said = Planned::new(&output).unwrap_err().to_string();
            assert!(said.contains("the output is also an input"), "{said}");
        }
        let planned = Planned::new(&path("soft other")).unwrap();
        for input in all("other") {
            assert!(file::open_regular(&input).unwrap_err().to_string().contains("also an output"));
        }
        drop(planned);
        file::open_regular(&path("other")).unwrap();
    }
}
