//! Parts of sections, each computed, cached and shown separately.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::{Context, Result};
use headtail_render::file;
use maud::html;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{PaperContext, figure::Strip};
use crate::{
    output::{make_folder, remove_kept},
    report::{
        table::{Cell, Column, Table},
        vector,
    },
};

/// Computes a part.
type Make = Box<dyn Fn(&PaperContext) -> Result<PartOutput>>;

/// A part of a section, computed as a whole.
pub struct Part {
    /// Unique in its section.
    pub name: String,
    /// Estimated seconds on one core.
    pub cost: f64,
    make: Make,
}

impl Part {
    /// A part.
    pub fn new(
        name: impl Into<String>,
        cost: f64,
        make: impl Fn(&PaperContext) -> Result<PartOutput> + 'static,
    ) -> Self {
        Self { name: name.into(), cost, make: Box::new(make) }
    }

    /// Computes the part.
    ///
    /// # Errors
    /// Any error of the part; [`crate::progress::Interrupted`] after a signal.
    pub fn make(&self, context: &PaperContext, stamp: &str) -> Result<CachedPart> {
        let start = Instant::now();
        let made = (self.make)(context)?;
        Ok(CachedPart { stamp: stamp.to_owned(), seconds: start.elapsed().as_secs_f64(), made })
    }
}

/// The output of a part.
#[derive(Default, Serialize, Deserialize)]
pub struct PartOutput {
    /// HTML for the page.
    pub html: String,
    /// The same as data.
    pub tables: Vec<Figures>,
    /// Its rows of pictures.
    #[serde(default)]
    pub drawings: Vec<SavedDrawing>,
}

/// A drawing that is saved beside the page.
#[derive(Serialize, Deserialize)]
pub struct SavedDrawing {
    /// Stem of its file name.
    name: String,
    svg: String,
}

/// The folder of drawings, beside the page.
const FIGURES: &str = "figures";

impl SavedDrawing {
    /// Its file.
    fn path(&self, out: &Path) -> PathBuf {
        // Only the file name is used, so that an edited cache file cannot write outside the folder.
        out.join(FIGURES).join(Path::new(&self.name).file_name().unwrap_or_default()).with_extension("svg")
    }

    /// Writes the drawing as SVG into `out`/figures, unless the file is up to date.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, out: &Path) -> Result<()> {
        make_folder(&out.join(FIGURES))?;
        let path = self.path(out);
        if fs::read(&path).is_ok_and(|own| own == self.svg.as_bytes()) {
            return Ok(());
        }
        Ok(file::replace(&path, self.svg.as_bytes())?)
    }
}

/// A table as data.
#[derive(Serialize, Deserialize)]
pub struct Figures {
    name: String,
    rows: Vec<Map<String, Value>>,
}

impl PartOutput {
    /// Output without data.
    pub fn of(html: String) -> Self {
        Self { html, ..Self::default() }
    }

    /// Adds a row of pictures with a link to its SVG file of this name.
    ///
    /// # Errors
    /// If a picture cannot be encoded.
    pub fn strip(&mut self, name: &str, strip: &Strip<'_>) -> Result<()> {
        let name = name.replace(|c: char| !(c.is_ascii_alphanumeric() || "-_".contains(c)), "-");
        let saved = html! {
            p.save {
                "Save " (vector::link(&name, "svg", &format!("{FIGURES}/{name}.svg")))
            }
        };
        self.html += &(strip.html() + &saved.into_string());
        self.drawings.push(SavedDrawing { name, svg: strip.drawing()?.file() });
        Ok(())
    }

    /// Adds data without showing it as a table. The first column is text, the others are numbers.
    pub fn figures(&mut self, name: &str, head: &[&str], rows: &[Vec<Cell>]) {
        let named =
            |row: &Vec<Cell>| head.iter().zip(row).map(|(title, cell)| ((*title).to_owned(), cell.json())).collect();
        let data = rows.iter().map(named).collect();
        self.tables.push(Figures { name: name.to_owned(), rows: data });
    }

    /// Adds a table to the page and to the data; `name` is the stem of its saved files.
    pub fn table(&mut self, name: &str, head: &[&str], rows: Vec<Vec<Cell>>) {
        self.figures(name, head, &rows);
        let columns = head.iter().enumerate().map(|(k, title)| match k {
            0 => Column::text(*title),
            _ => Column::number(*title, ""),
        });
        self.html += &Table::new(name, columns.collect(), rows).html(false).into_string();
    }
}

/// A cached part.
#[derive(Serialize, Deserialize)]
pub struct CachedPart {
    /// Key of the version, data and effort.
    stamp: String,
    /// Seconds that the part took.
    pub seconds: f64,
    /// The part's output.
    pub made: PartOutput,
}

impl CachedPart {
    fn path(folder: &Path, section: &str, part: &str) -> PathBuf {
        let name: String = part.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
        folder.join(format!("{section}--{name}.json"))
    }

    /// Removes parts of other data or effort, and their drawings in `out`.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn remove_others(folder: &Path, out: &Path, stamp: &str) -> Result<()> {
        for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
            let path = entry.with_context(|| folder.display().to_string())?.path();
            let cached: Option<Self> = fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok());
            let Some(cached) = cached.filter(|cached| cached.stamp != stamp) else { continue };
            cached.made.drawings.iter().try_for_each(|drawing| remove_kept(&drawing.path(out)))?;
            remove_kept(&path)?;
        }
        Ok(())
    }

    /// Reads a cached part with the same stamp.
    pub fn read(folder: &Path, section: &str, part: &str, stamp: &str) -> Option<Self> {
        let cached: Self = serde_json::from_slice(&fs::read(Self::path(folder, section, part)).ok()?).ok()?;
        (cached.stamp == stamp).then_some(cached)
    }

    /// Writes the part to the cache.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, folder: &Path, section: &str, part: &str) -> Result<()> {
        let path = Self::path(folder, section, part);
        file::replace(&path, &serde_json::to_vec(self)?).with_context(|| format!("{}", path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::vector::Drawing;

    #[test]
    fn parts_with_another_stamp_are_removed_with_their_drawings() {
        let out = tempfile::tempdir().unwrap();
        let folder = out.path().join("sections");
        make_folder(&folder).unwrap();
        let svg = || Drawing::new("none", (9.0, 9.0), "").file();
        let drawing = |name: &str| SavedDrawing { name: name.to_owned(), svg: svg() };
        let cached = |stamp: &str, name: &str| {
            let made = PartOutput { drawings: vec![drawing(name)], ..PartOutput::default() };
            CachedPart { stamp: stamp.into(), seconds: 1.0, made }
        };
        for (stamp, name) in [("old", "one"), ("new", "two")] {
            let cached = cached(stamp, name);
            cached.write(&folder, "fits", name).unwrap();
            cached.made.drawings.iter().try_for_each(|drawing| drawing.write(out.path())).unwrap();
        }
        let own = out.path().join("figures/own.svg");
        fs::write(&own, "of somebody else").unwrap();
        CachedPart::remove_others(&folder, out.path(), "new").unwrap();
        let is_there = |name: &str| out.path().join("figures").join(name).with_extension("svg").exists();
        assert_eq!((is_there("one"), is_there("two")), (false, true));
        assert!(
            CachedPart::read(&folder, "fits", "one", "old").is_none()
                && CachedPart::read(&folder, "fits", "two", "new").is_some()
        );
        assert!(own.exists());
    }
}
