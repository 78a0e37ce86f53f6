//! `composite.html`: before and after under a slider, and the layers.

use headtail_render::composite::{Film, MaskForm};
use maud::{Markup, html};

use super::{arguments::Arguments, setting::Setting};
use crate::report::{
    number::duration,
    shell::Page,
    stage::{self, Choice},
};

/// Pictures as `data:` URLs.
pub struct Pictures {
    /// Photograph.
    pub photograph: String,
    /// Composite.
    pub composite: String,
    /// The object, multiplied by its alpha.
    pub object: String,
    /// Factor of the photograph.
    pub mask: String,
    /// Light that the object reflects onto the catcher.
    pub light: String,
}

/// Returns the whole self-contained page.
pub fn page(arguments: &Arguments, setting: &Setting, film: &Film, pictures: &Pictures) -> String {
    let light = arguments.light.words();
    let title = format!("{} under {}{light}", setting.stage.object().name(), setting.environment.name());
    let command = crate::terminal::command();
    let (width, height) = (film.width, film.height);
    let entries = entries(pictures);
    let choices = entries.iter().map(|(id, name, note, _)| Choice {
        id: (*id).into(),
        name: (*name).into(),
        note: (*note).into(),
    });
    let choices = [(String::new(), choices.collect())];
    let main = html! {
        (stage::section((width, height), &choices, ["image-photograph", "image-composite"]))
        section {
            h2 { "Layers" }
            div.multiples {
                @for (id, name, note, address) in &entries {
                    figure.card {
                        img #(id) src=(address) alt=(name) width=(width) height=(height);
                        figcaption { b { (name) } span { (note) } }
                    }
                }
            }
            p.note { "composite = object + (1 \u{2212} \u{3b1}) (photograph \u{d7} shadow + light)" }
        }
        (method(arguments, setting, film))
    };
    let page = Page {
        kicker: "composite",
        heading: html! { (title) },
        title,
        facts: vec![
            format!("{width} \u{d7} {height} pixels"),
            format!("{} samples per pixel", film.spp),
            duration(film.seconds),
            format!("headtail {}", env!("CARGO_PKG_VERSION")),
        ],
        command: &command,
        version: env!("CARGO_PKG_VERSION"),
        style: "",
        script: "",
    };
    page.encode(&main)
}

/// Returns id, name, description and URL of each picture.
fn entries(pictures: &Pictures) -> [(&'static str, &'static str, &'static str, &String); 5] {
    [
        ("image-photograph", "photograph", "before", &pictures.photograph),
        ("image-composite", "composite", "after", &pictures.composite),
        ("image-object", "object", "multiplied by its alpha", &pictures.object),
        ("image-mask", "shadow", "what the photograph is multiplied by, per channel", &pictures.mask),
        ("image-light", "light", "what the object throws back onto the photograph", &pictures.light),
    ]
}

fn method(arguments: &Arguments, setting: &Setting, film: &Film) -> Markup {
    let mask = match arguments.mask {
        MaskForm::Paper => {
            "mean visibility of the samples, the paper's estimator: right where the sampler is the exact product"
        }
        MaskForm::Weights => "mean of the weighted visibility over the exact irradiance: unbiased",
        MaskForm::ControlVariate => {
            "weighted visibility over the exact irradiance, with the weights themselves as a control variate: unbiased"
        }
        MaskForm::Ratio => {
            "ratio of the weights that are visible to all weights; its bias falls inversely with the samples of a pixel"
        }
    };
    let own_shadow = match (arguments.mask, setting.stage.is_plane()) {
        (MaskForm::Weights | MaskForm::ControlVariate, false) => {
            ", but for a bias that falls inversely with the samples of a pixel where the catcher shadows itself"
        }
        _ => "",
    };
    let catcher = if setting.stage.is_plane() { "a plane".into() } else { format!("the mesh {}", arguments.catcher) };
    let rows = [
        (
            "Mask",
            format!(
                "{mask}{own_shadow}{}",
                if arguments.grey_mask { "; one for all channels" } else { "; per channel" }
            ),
        ),
        ("Sampler", arguments.sampler.resolved(false).to_string()),
        (
            "Catcher",
            format!(
                "{catcher}, diffuse, with the photograph as its texture. Light from below the horizon casts no shadow."
            ),
        ),
        ("Depth", format!("light over up to {} surfaces", arguments.depth)),
        ("Gain", format!("the photograph's values times {} are in the map's units", setting.gain)),
        (
            "Rays",
            format!(
                "{} shadow rays of the mask, {} of the object and further bounces",
                film.mask_rays, film.other_rays
            ),
        ),
    ];
    html! {
        section {
            h2 { "How it was made" }
            dl.method { @for (name, text) in rows { div { dt { (name) } dd { (text) } } } }
        }
    }
}
