//! `composite.html`: before and after under a slider, and the layers.

use std::fmt::Write;

use headtail_render::composite::{Film, MaskForm};

use super::{Arguments, Setting};
use crate::report::{
    html::{SCRIPT, head},
    number::{duration, escape},
    slider,
};

/// The pictures as `data:` addresses.
pub struct Pictures {
    /// Before.
    pub photograph: String,
    /// After.
    pub composite: String,
    /// The object, multiplied by its alpha.
    pub object: String,
    /// What the photograph is multiplied by.
    pub mask: String,
    /// What the object throws back.
    pub light: String,
}

/// The whole page; it needs nothing but itself.
pub fn page(arguments: &Arguments, setting: &Setting, film: &Film, pictures: &Pictures) -> String {
    let title = format!("{} under {}", setting.stage.object().name(), setting.environment.name());
    let command = crate::terminal::command();
    let (width, height) = (film.width, film.height);
    let mut page = head(env!("CARGO_PKG_VERSION"), &format!("{title} \u{b7} headtail composite"));
    let _ = write!(
        page,
        "<body>\n<header>\n<p class=\"kicker\">headtail \u{b7} composite</p>\n<h1>{}</h1>\n<ul class=\"facts\"><li>{width} \u{d7} {height} pixels</li>\
         <li>{} samples per pixel</li><li>{}</li><li>headtail {}</li></ul>\n\
         <pre class=\"command\" tabindex=\"0\" aria-label=\"Command\"><code>{}</code></pre>\n</header>\n<main>\n",
        escape(&title),
        film.spp,
        duration(film.seconds),
        env!("CARGO_PKG_VERSION"),
        escape(&command),
    );
    let entries = entries(pictures);
    page += &slider::section(
        (width, height),
        &options(&entries, "image-photograph"),
        &options(&entries, "image-composite"),
    );
    page += "<section>\n<h2>Layers</h2>\n<div class=\"multiples\">\n";
    for (id, name, note, address) in &entries {
        let _ = writeln!(
            page,
            "<figure class=\"card\"><img id=\"{id}\" src=\"{address}\" alt=\"{name}\" width=\"{width}\" height=\"{height}\">\
             <figcaption><b>{name}</b><span>{note}</span></figcaption></figure>"
        );
    }
    page += "</div>\n<p class=\"note\">composite = object + (1 \u{2212} \u{3b1}) (photograph \u{d7} shadow + light)</p>\n</section>\n";
    page += &method(arguments, setting, film);
    let _ = write!(page, "</main>\n<script>\n{SCRIPT}</script>\n</body>\n</html>\n");
    page
}

/// Id, name, what it is, and address of each picture.
fn entries(pictures: &Pictures) -> [(&'static str, &'static str, &'static str, &String); 5] {
    [
        ("image-photograph", "photograph", "before", &pictures.photograph),
        ("image-composite", "composite", "after", &pictures.composite),
        ("image-object", "object", "multiplied by its alpha", &pictures.object),
        ("image-mask", "shadow", "what the photograph is multiplied by, per channel", &pictures.mask),
        ("image-light", "light", "what the object throws back onto the photograph", &pictures.light),
    ]
}

fn options(entries: &[(&str, &str, &str, &String)], selected: &str) -> String {
    let option = |(id, name, note, _): &(&str, &str, &str, &String)| {
        let mark = if *id == selected { " selected" } else { "" };
        format!("<option value=\"{id}\" data-note=\"{note}\"{mark}>{name}</option>")
    };
    entries.iter().map(option).collect()
}

fn method(arguments: &Arguments, setting: &Setting, film: &Film) -> String {
    let mask = match (arguments.mask, setting.stage.is_plane()) {
        (MaskForm::Paper, _) => {
            "mean visibility of the samples, the paper's estimator: right where the sampler is the exact product"
        }
        (MaskForm::Weights, true) => "mean of the weighted visibility over the exact irradiance: unbiased",
        (MaskForm::ControlVariate, true) => {
            "weighted visibility over the exact irradiance, with the weights themselves as a control variate: unbiased"
        }
        _ => {
            "ratio of the weights that are visible to all weights; its bias falls inversely with the samples of a pixel"
        }
    };
    let catcher =
        if setting.stage.is_plane() { "a plane".into() } else { format!("the mesh {}", escape(&arguments.catcher)) };
    let rows = [
        ("Mask", format!("{mask}{}", if arguments.grey_mask { "; one for all channels" } else { "; per channel" })),
        ("Sampler", format!("<code>{}</code>", escape(&arguments.sampler.to_string()))),
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
    let rows: Vec<String> =
        rows.iter().map(|(name, text)| format!("<div><dt>{name}</dt><dd>{text}</dd></div>\n")).collect();
    format!("<section>\n<h2>How it was made</h2>\n<dl class=\"method\">\n{}</dl>\n</section>\n", rows.concat())
}
