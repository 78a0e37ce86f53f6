//! The paper's figure of compositing.

use std::sync::Arc;

use anyhow::{Context, Result};
use glam::{Affine3A, Vec3, Vec3A};
use headtail_render::{
    composite::{Catcher, Layers, Mask, MaskForm, Settings, Stage},
    image::{Image, Photograph, encode_png, encode_png_rgb8, srgb_code},
    integrator::View,
    scene::{MaterialSpec, Scene},
    spec::SamplerSpec,
};

use super::{
    PaperContext,
    bias::bias,
    figure::{Layout, Panel, Strip, heading, note},
    part::{Part, PartOutput},
    passes,
    shot::{Shot, size},
};
use crate::{
    cost,
    report::number::{escape, text},
    view::automatic_exposure,
};

/// Samples per pixel of the pictures.
const SHOWN: u32 = 64;

/// The section.
pub fn section(context: &PaperContext) -> (String, Vec<Part>) {
    let intro = "<p class=\"note\">Objects before rectified views of maps, in one pass: photograph, composite and mask (per channel, control variate). The object is lit over up to four \
         surfaces, throws light back, and sees the photograph on the ground. One pass is set against two with MIS, RIS-4 and patches: MSE of the mask of luminance over the pixels of the catcher and over those in shadow (mask below 0.98), and of the composite's pixels on \
         the catcher, with 16 shadow rays per pixel: 16 samples in one pass, or 8 with the object and 8 without. How many times lower than two passes with one-sample MIS stands beside each. Bias is the mean error in the shadow. \
         <span class=\"paper\">The paper shows its composite and gives no figures; its estimator is the form \u{201c}paper\u{201d}.</span></p>\n";
    let effort = context.effort;
    let (width, height) = size(context);
    let pixels = (width * height) as f64 / (effort.width * effort.width * 3 / 4) as f64;
    let shot = pixels * effort.rendering(4 * SHOWN + 5 * effort.mask_spp + 3 * effort.runs.min(4) * 32);
    let mut parts: Vec<Part> = (0..3)
        .map(|index| {
            let name = format!("object {}, {}", index + 1, context.data.map_name(index));
            Part::new(name, shot, move |context| composite(context, index))
        })
        .collect();
    let own_shadow = pixels * effort.rendering(passes::OWN_SHADOW * effort.mask_spp);
    parts.push(Part::new("mesh", shot + own_shadow, mesh));
    let training = cost::training(&context.heads.config(&MaterialSpec::LAMBERT));
    parts.push(Part::new("bias", training + pixels * effort.rendering(9 * effort.mask_spp), bias));
    (intro.to_owned(), parts)
}

fn composite(context: &PaperContext, index: usize) -> Result<PartOutput> {
    let shot = Shot::new(context, index)?;
    let estimator = SamplerSpec::patches().build(&shot.environment)?;
    let backdrop = shot.backdrop();
    let film = shot.film(&backdrop, &*estimator, Settings { depth: 4, mask_only: false, ..shot.settings(SHOWN, 3) });
    let mask = Mask::of(&film, MaskForm::ControlVariate);
    let layers = Layers::new(&film, &mask, &shot.photograph, Vec3A::ONE, true);
    let stops = automatic_exposure(&shot.photograph.image) + 0.5;
    let mut output = PartOutput::of(heading(&format!("{} under {}", shot.name, shot.environment.name())));
    let panels = vec![
        Panel::new(&encode_png(&shot.photograph.image, stops)?, "photograph", ""),
        Panel::new(&encode_png(&layers.composite(), stops)?, "composite", format!("{SHOWN} spp")),
        Panel::new(&codes(&layers.shadow)?, "mask", format!("{SHOWN} spp")),
    ];
    output.strip(&format!("composite-{index}"), &Strip { layout: Layout::Wide, panels, scales: Vec::new() })?;
    passes::compare(context, &shot, &backdrop, &mut output)?;
    Ok(output)
}

/// A mask as a PNG.
fn codes(image: &Image) -> Result<Vec<u8>> {
    let codes: Vec<[u8; 3]> = image.pixels.iter().map(|pixel| pixel.map(srgb_code)).collect();
    Ok(encode_png_rgb8(image.width, image.height, &codes)?)
}

/// A mesh catcher that shadows itself: inserts an object into a rendering of a scene and compares the
/// composite with a rendering of both.
fn mesh(context: &PaperContext) -> Result<PartOutput> {
    let view = context.data.view("temple", "lambert:albedo=0.6")?;
    let environment = context.data.map(1)?;
    let (name, object) = context.data.object(0)?;
    let bounds = object.bounds();
    let object = "lambert:albedo=0.6".parse::<MaterialSpec>()?.dress(object, &bounds)?;
    let (width, height) = size(context);
    let camera = view.camera;
    let ground = view.scene.intersect(&camera.ray(0.36 * width as f32, 0.86 * height as f32, width, height));
    let place = ground.context("a scene that fills the lower middle of its picture")?.p;
    let foot = Vec3A::new(bounds.center().x, bounds.min.y, bounds.center().z);
    let scale = 0.17 * (place - camera.look_from()).length() / bounds.extent().max_element();
    let to_place = Affine3A::from_translation(place.into())
        * Affine3A::from_scale(Vec3::splat(scale))
        * Affine3A::from_translation((-foot).into());
    let object = object.moved(&to_place)?;
    let both = object.joined(&view.scene)?;
    let estimator = SamplerSpec::patches().build(&environment)?;
    let render = |scene: &Scene, seed: u64| {
        let view =
            View { scene, camera: &camera, environment: &environment, width, height, unshadowed: false, depth: 1 };
        context.render(view, &*estimator, context.effort.mask_spp, seed).composite()
    };
    let (before, after) = (render(&view.scene, 31), render(&both, 32));
    context.check()?;
    let stage = Stage::new(object, Catcher::mesh(Arc::into_inner(view.scene).context("the view is no longer used")?))?;
    let photograph = Photograph::of_radiance(before);
    let shot = Shot { name, environment: environment.clone(), stage, camera, photograph, stop: context.stop.clone() };
    let backdrop = shot.backdrop();
    let film = shot.film(&backdrop, &*estimator, Settings { mask_only: false, ..shot.settings(SHOWN, 3) });
    let mask = Mask::of(&film, MaskForm::ControlVariate);
    let layers = Layers::new(&film, &mask, &shot.photograph, Vec3A::ONE, true);
    let (composite, stops) = (layers.composite(), automatic_exposure(&shot.photograph.image) + 0.5);
    let mse = headtail_render::statistics::ErrorMetrics::of(&composite, &after)?.mse;
    let mut output =
        PartOutput::of(heading(&format!("{} on a mesh: {} under {}", shot.name, view.name, environment.name())));
    output.html += &note(&format!(
        "The photograph is a rendering of the {} under direct light; it is the catcher as it is, a mesh that shadows itself. What the composite should be is a rendering of both.",
        escape(&view.name)
    ));
    let spp = format!("{} spp", context.effort.mask_spp);
    let panels = vec![
        Panel::new(&encode_png(&shot.photograph.image, stops)?, "photograph", spp.clone()),
        Panel::new(&encode_png(&composite, stops)?, "composite", format!("{SHOWN} spp, MSE {}", text(mse))),
        Panel::new(&codes(&layers.shadow)?, "mask", ""),
        Panel::new(&encode_png(&after, stops)?, "rendering of both", spp),
    ];
    output.strip("composite-mesh", &Strip { layout: Layout::Four, panels, scales: Vec::new() })?;
    passes::compare(context, &shot, &backdrop, &mut output)?;
    Ok(output)
}
