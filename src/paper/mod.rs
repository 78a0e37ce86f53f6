//! `headtail paper`: every table and figure of the paper in terms of this program, on one page.

mod ablation;
mod catcher;
mod costs;
mod data;
mod effort;
mod figure;
mod fits;
mod heads;
mod measure;
mod scenes;
mod two_dimensions;

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use headtail_render::file;
use maud::{Markup, PreEscaped, html};

use self::{data::Data, effort::Effort, heads::Heads};
use crate::terminal::{self, note, say};
use crate::{
    arguments::make_folder,
    compare::machine,
    output::OutputFolder,
    progress,
    report::{number::duration, shell},
};

/// Make every table and figure of the paper on one page, DIR/paper.html, with the paper's numbers beside ours where its text states them.
#[derive(Args)]
#[command(after_help = "Examples:
  headtail paper --quick --out out/paper
  headtail paper --data maps --out out/paper

--quick takes under ten minutes on two cores. Whatever ends the program, the same command goes on where it was: heads and \
finished sections are kept in DIR/heads and DIR/sections, the page shows those that are done. Without --data, maps and scenes are the built-in ones. Of --data \
the folders envmaps (.hdr, .exr) and scenes (.glb, .gltf) are used.")]
pub struct Arguments {
    /// Folder of maps and scenes.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Fewer maps, smaller pictures, shorter training.
    #[arg(long)]
    quick: bool,
    /// Make only sections whose name contains this text; may be repeated. What is there of others is shown.
    #[arg(long, value_name = "TEXT")]
    only: Vec<String>,
    /// Threads. Default: all cores.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Folder for the results.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// What sections are made with.
pub struct Workshop {
    data: Data,
    effort: Effort,
    heads: Heads,
    stop: Arc<AtomicBool>,
}

impl Workshop {
    /// An error once a signal has come: nothing of an unfinished section is kept.
    fn check(&self) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) {
            bail!(progress::Interrupted::new("the same command goes on with the section that was being made"));
        }
        Ok(())
    }
}

/// A section of the page.
struct Section {
    name: &'static str,
    title: &'static str,
    /// About its share of the work.
    weight: u64,
    make: fn(&Workshop) -> Result<String>,
}

const SECTIONS: [Section; 8] = [
    Section {
        name: "example",
        title: "A product of an image and a Gaussian",
        weight: 5,
        make: two_dimensions::section,
    },
    Section { name: "fits", title: "Fits of maps and materials", weight: 30, make: fits::section },
    Section { name: "cosine", title: "Cosine-weighted emitter sampling", weight: 12, make: scenes::cosine },
    Section { name: "microfacet", title: "Microfacet materials", weight: 12, make: scenes::microfacet },
    Section { name: "neural", title: "Neural materials", weight: 1, make: |_| Ok(NEURAL.to_owned()) },
    Section { name: "catcher", title: "Shadow-catcher compositing", weight: 12, make: catcher::section },
    Section { name: "ablation", title: "Ablation", weight: 30, make: ablation::section },
    Section { name: "costs", title: "Costs", weight: 3, make: costs::section },
];

/// What stands in the place of the paper's figures of bedroom and cloth.
const NEURAL: &str = "<p class=\"incomplete\"><b>Not implemented.</b> This program has no neural materials, so that there is nothing to set beside the \
                      paper's figures of striped, low-roughness and high-roughness fabrics (bedroom, cloth). The built-in scenes of these names have \
                      analytic materials.</p>\n";

/// Makes all sections that are not there yet, and the page after each.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global().context("--threads")?;
    }
    let start = Instant::now();
    let _output = OutputFolder::share(&arguments.out)?;
    let folder = arguments.out.join("sections");
    make_folder(&folder)?;
    let data = Data::open(arguments.data.as_deref(), arguments.quick)?;
    let effort = if arguments.quick { Effort::QUICK } else { Effort::FULL };
    let stop = progress::stop_flag()?;
    let heads = Heads::new(&arguments.out.join("heads"), effort, stop.clone())?;
    let key = format!("{} {} {effort:?}", env!("CARGO_PKG_VERSION"), data.key());
    let workshop = Workshop { data, effort, heads, stop };
    let is_wanted = |name: &str| arguments.only.is_empty() || arguments.only.iter().any(|text| name.contains(&**text));
    ensure!(SECTIONS.iter().any(|section| is_wanted(section.name)), "--only: there is no section of such a name");
    let bar = progress::bar(SECTIONS.iter().map(|section| section.weight).sum(), "paper");
    let mut page = Page { folder, key, made: Vec::new() };
    for section in &SECTIONS {
        bar.set_message(section.name);
        let known = page.read(section.name);
        let html = match known {
            Some(html) => Some(html),
            None if is_wanted(section.name) => Some(page.write(section, &workshop)?),
            None => None,
        };
        page.made.extend(html.map(|html| (section, html)));
        file::replace(&arguments.out.join("paper.html"), page.encode(&workshop).as_bytes())?;
        bar.inc(section.weight);
        workshop.check()?;
    }
    bar.finish_and_clear();
    say!(
        "{} of {} sections in {}; the page to open is {}",
        page.made.len(),
        SECTIONS.len(),
        duration(start.elapsed().as_secs_f64()),
        arguments.out.join("paper.html").display()
    );
    Ok(())
}

/// The page with the sections that are there.
struct Page {
    folder: PathBuf,
    /// What all sections depend on.
    key: String,
    made: Vec<(&'static Section, String)>,
}

impl Page {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name).with_extension("html")
    }

    /// The first line of a section's file.
    fn stamp(&self) -> String {
        format!("<!-- {} -->\n", self.key.replace("--", "- "))
    }

    /// A section that was made before with the same settings.
    fn read(&self, name: &str) -> Option<String> {
        let text = std::fs::read_to_string(self.path(name)).ok()?;
        text.strip_prefix(&self.stamp()).map(str::to_owned)
    }

    fn write(&self, section: &Section, workshop: &Workshop) -> Result<String> {
        let start = Instant::now();
        let html = (section.make)(workshop).with_context(|| format!("section '{}'", section.name))?;
        let seconds = duration(start.elapsed().as_secs_f64());
        let html = format!("{html}<p class=\"note\">Made in {seconds}.</p>\n");
        file::replace(&self.path(section.name), (self.stamp() + &html).as_bytes())?;
        note!("{}: {seconds}", section.name);
        Ok(html)
    }

    fn encode(&self, workshop: &Workshop) -> String {
        let version = env!("CARGO_PKG_VERSION");
        let main = html! {
            (self.contents(workshop))
            @for (section, made) in &self.made {
                section #(section.name) { h2 { (section.title) } (PreEscaped(made)) }
            }
        };
        let page = shell::Page {
            kicker: "paper",
            title: "The paper, figure by figure".into(),
            heading: html! { "The paper, figure by figure" },
            facts: vec![workshop.data.words(), machine(), format!("headtail {version}")],
            command: &terminal::command(),
            version,
            style: figure::STYLE,
            script: "",
        };
        page.encode(&main)
    }

    fn contents(&self, workshop: &Workshop) -> Markup {
        let is_made = |name: &str| self.made.iter().any(|(made, _)| made.name == name);
        html! {
            section.reading {
                h2 { "Contents" }
                ul {
                    @for Section { name, title, .. } in &SECTIONS {
                        @if is_made(name) { li { a href={ "#" (name) } { (title) } } }
                        @else { li { (title) " " small { "(not made yet)" } } }
                    }
                }
                p.note {
                    "After Litalien et al. 2024, \u{201c}Neural Product Importance Sampling via Warp Composition\u{201d}. Scenes and maps are not the paper\u{2019}s: \
                     its numbers stand beside ours where its text states them, and only ratios can be compared. Heads are trained with this program\u{2019}s batches and optimiser ("
                    (workshop.effort.cosine_steps) " and " (workshop.effort.ggx_steps)
                    " steps), without a learned share beside BRDF sampling."
                }
            }
        }
    }
}

/// Whether a path is a folder.
fn is_folder(path: &Path) -> bool {
    path.is_dir()
}
