//! Pages and their generated blocks.
//!
//! A block begins with `<!-- results: KIND EXPERIMENT key=value ... -->` and ends with `<!-- end of results
//! -->`; the text between is generated.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use headtail_eval::Store;
use headtail_render::file;

use crate::{Plans, block::Block, data::Data, markdown::CHART, prose};

const BEGIN: &str = "<!-- results: ";
const END: &str = "<!-- end of results -->";

/// All pages and the data that they show.
pub struct Site {
    root: PathBuf,
    pages: Vec<PathBuf>,
    data: Data,
}

/// The expected content of a page or of a chart beside it.
struct Built {
    path: PathBuf,
    content: String,
}

impl Site {
    /// Opens the pages of a repository: those of its root and of `docs/`.
    ///
    /// # Errors
    /// If a folder or the data cannot be read.
    pub fn open(root: &Path, store: &Store, plans: &Plans) -> Result<Self> {
        let mut pages = vec![root.join("README.md"), root.join("RESULTS.md")];
        let mut folders = vec![root.join("docs")];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).with_context(|| folder.display().to_string())?.flatten() {
                let path = entry.path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|extension| extension == "md") {
                    pages.push(path);
                }
            }
        }
        pages.sort();
        Ok(Self { root: root.to_owned(), pages, data: Data::open(store, plans)? })
    }

    /// Writes pages and charts, or checks that they are up to date.
    ///
    /// # Errors
    /// If a block asks for missing data, a file cannot be read or written, or the check fails.
    pub fn build(&self, check: bool) -> Result<()> {
        let mut findings = Vec::new();
        for page in &self.pages {
            let text = std::fs::read_to_string(page).with_context(|| page.display().to_string())?;
            let name = page.strip_prefix(&self.root).unwrap_or(page);
            if check {
                findings.extend(prose::measured_numbers(name, &text));
            }
            for built in self.page(page, &text)? {
                let known = std::fs::read_to_string(&built.path).unwrap_or_default();
                if known == built.content {
                    continue;
                }
                if check {
                    findings.push(format!("{}: differs from its data; run `results build`", built.path.display()));
                } else {
                    file::replace(&built.path, built.content.as_bytes())?;
                    eprintln!("{} written", built.path.display());
                }
            }
        }
        if findings.is_empty() { Ok(()) } else { bail!("{}", findings.join("\n")) }
    }

    /// Builds everything without writing.
    ///
    /// # Errors
    /// If a block asks for missing data.
    pub fn build_in_memory(&self) -> Result<()> {
        for page in &self.pages {
            let text = std::fs::read_to_string(page).with_context(|| page.display().to_string())?;
            self.page(page, &text)?;
        }
        Ok(())
    }

    /// Returns the link from a page to a file of the repository.
    fn linked_from(&self, page: &Path, file: &str) -> String {
        let folder = page.strip_prefix(&self.root).ok().and_then(Path::parent).unwrap_or(Path::new(""));
        match Path::new(file).strip_prefix(folder) {
            Ok(rest) => rest.display().to_string(),
            Err(_) => "../".repeat(folder.components().count()) + file,
        }
    }

    /// Fills the blocks of a page; also returns the charts that they draw.
    fn page(&self, path: &Path, text: &str) -> Result<Vec<Built>> {
        let (mut content, mut rest, mut built) = (String::new(), text, Vec::new());
        while let Some(begin) = rest.find(BEGIN) {
            let head_end = begin + rest[begin..].find("-->").context("a block's head does not end")? + 3;
            let head = &rest[begin + BEGIN.len()..head_end - 3];
            let end =
                head_end + rest[head_end..].find(END).with_context(|| format!("{head}: the block does not end"))?;
            let block = Block::parse(head.trim()).with_context(|| path.display().to_string())?;
            let filled = self.data.fill(&block).with_context(|| format!("{}: {head}", path.display()))?;
            content += &rest[..head_end];
            content += "\n\n";
            let chart = filled.chart.as_ref().map_or(String::new(), |(name, _)| self.linked_from(path, name));
            content += &filled.markdown.trim_end().replace(CHART, &chart);
            content += "\n\n";
            content += END;
            built.extend(filled.chart.map(|(name, svg)| Built { path: self.root.join(name), content: svg }));
            rest = &rest[end + END.len()..];
        }
        content += rest;
        built.push(Built { path: path.to_owned(), content });
        Ok(built)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use headtail_eval::{Experiment, Measurement, MeasurementEnvironment};

    use super::*;

    const EXPERIMENT: &str = r#"
        question = "Which?"
        width = 8
        height = 6
        budgets = ["4spp"]
        runs = 2
        threads = 1
        reference_samples = 16
        scenes = [{ name = "plane", file = "plane", tuned = true }]
        maps = [{ name = "studio", file = "studio", kind = "lamps", tuned = true }]
        materials = [{ name = "own" }]
        views = [{ scenes = ["plane"], maps = ["studio"], materials = ["own"] }]
        samplers = [{ name = "mis", spec = "mis" }, { name = "patches", spec = "patches" }]
        quick = { views = 1, width = 8, height = 6, budgets = ["1spp"], runs = 1 }
    "#;

    /// A repository with one experiment, measured with the given sources.
    fn repository(sources: &str) -> (tempfile::TempDir, Plans) {
        let root = tempfile::tempdir().unwrap();
        fs::create_dir_all(root.path().join("docs")).unwrap();
        fs::write(root.path().join("README.md"), "A page.\n").unwrap();
        let page = "# Results\n\n<!-- results: ratios small samples=4spp baselines=mis samplers=patches -->\n<!-- end of results -->\n\n\
                    <!-- results: conditions small -->\n<!-- end of results -->\n";
        fs::write(root.path().join("RESULTS.md"), page).unwrap();
        let folder = root.path().join("results");
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("small.toml"), EXPERIMENT).unwrap();
        let run = |sampler: &str, run: u32, mse: f64| Measurement {
            scene: "plane".into(),
            env: "studio".into(),
            material: "own".into(),
            sampler: sampler.into(),
            budget: "4spp".into(),
            run,
            mse,
            ..Measurement::unknown()
        };
        let runs = [run("mis", 0, 3.0), run("mis", 1, 5.0), run("patches", 0, 1.5), run("patches", 1, 2.5)];
        let environment = MeasurementEnvironment { sources: sources.into(), ..MeasurementEnvironment::current() };
        Store::new(&folder).add("small", &runs, &environment).unwrap();
        let plans =
            Plans { experiments: vec![Experiment::open(&folder.join("small.toml")).unwrap()], recordings: Vec::new() };
        (root, plans)
    }

    fn site(root: &Path, plans: &Plans) -> Site {
        Site::open(root, &Store::new(&root.join("results")), plans).unwrap()
    }

    #[test]
    fn pages_are_rebuilt_byte_for_byte_and_a_changed_digit_is_found() {
        let (root, plans) = repository(headtail_eval::source_hash());
        let page = root.path().join("RESULTS.md");
        assert!(site(root.path(), &plans).build(true).is_err(), "the blocks are empty");
        site(root.path(), &plans).build(false).unwrap();
        let built = fs::read_to_string(&page).unwrap();
        assert!(built.contains("| `patches` | 2.00 [") && !built.contains("Stale"), "{built}");
        site(root.path(), &plans).build(false).unwrap();
        assert_eq!(fs::read_to_string(&page).unwrap(), built);
        site(root.path(), &plans).build(true).unwrap();
        fs::write(&page, built.replace("2.00 [", "2.01 [")).unwrap();
        assert!(site(root.path(), &plans).build(true).unwrap_err().to_string().contains("differs from its data"));
        fs::write(&page, built.replace("# Results", "It is 2.3x better.")).unwrap();
        assert!(site(root.path(), &plans).build(true).unwrap_err().to_string().contains("'2.3x' is a measured number"));
    }

    #[test]
    fn tables_of_other_sources_are_marked_stale() {
        let (root, plans) = repository("0123456789abcdef");
        site(root.path(), &plans).build(false).unwrap();
        let built = fs::read_to_string(root.path().join("RESULTS.md")).unwrap();
        assert!(built.contains("**Stale:** samplers or integrator have changed since 4 of 4 runs"), "{built}");
    }
}
