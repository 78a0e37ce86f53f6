//! `headtail inspect --lights`: the sun and the lamps of a map, for renderers without environment sampling.
//!
//! A light is a connected set of texels around a peak that is much brighter than the ring around it; its irradiance is
//! what it has more than that ring. A halo that touches a light is added to it. The rest is the map with each light
//! replaced by its ring.

use std::{
    collections::{HashMap, HashSet},
    path::Path,
};

use anyhow::{Result, ensure};
use glam::{DVec3, Quat, Vec2, Vec3, Vec3A};
use headtail_render::{
    color::luminance,
    environment::Environment,
    image::{Image, write_exr},
    latlong, memory,
};
use serde_json::{Value, json};

use super::light_files::{Format, LightFile, blender_vector, gltf_of_nodes};
use crate::{
    output::OutputFile,
    report::number,
    terminal::{self, out},
};

/// Largest solid angle of a light in steradians: a disc of 10 degrees radius.
const MOST_SOLID_ANGLE: f64 = 0.095;
/// Luminance of a light's texels over that of its peak, at least.
const OF_PEAK: f64 = 0.1;
/// Luminance of the peak over that of the ring, at least.
const CONTRAST: f64 = 4.0;
/// Fraction of the map's light in a light, at least.
const LEAST: f64 = 0.005;
/// Largest number of lights.
const MOST: usize = 16;
/// Number of peaks that are tried.
const TRIES: usize = 256;

/// A compact light.
#[derive(Clone, Debug)]
struct Light {
    /// Unit vector towards it.
    direction: Vec3A,
    /// Irradiance of a surface that faces it, per channel, in the units of the map.
    irradiance: DVec3,
    /// Steradians of the texels without a halo.
    solid_angle: f64,
    /// Fraction of the map's light, by luminance.
    fraction: f64,
}

impl Light {
    /// Angular radius, in radians, of the disc of its solid angle.
    fn radius(&self) -> f64 {
        (1.0 - self.solid_angle / std::f64::consts::TAU).acos()
    }

    /// Adds the light of a halo.
    fn add(&mut self, halo: &Self) {
        let towards = self.fraction as f32 * self.direction + halo.fraction as f32 * halo.direction;
        self.direction = towards.normalize_or(self.direction);
        self.irradiance += halo.irradiance;
        self.fraction += halo.fraction;
    }

    /// Its colour, with the largest channel 1, and the irradiance of that channel.
    fn color_and_strength(&self) -> (DVec3, f64) {
        let strength = self.irradiance.max_element();
        (self.irradiance / strength, strength)
    }
}

const FORMATS: [Format<Light>; 4] = [
    Format { extension: "json", text: |lights| format!("{:#}", Value::from_iter(lights.iter().map(described))) },
    Format { extension: "csv", text: csv },
    Format { extension: "gltf", text: gltf },
    Format { extension: "py", text: blender },
];

/// Finds the lights of a map, writes them, and the map without them to `rest`.
pub fn inspect(environment: &Environment, path: &Path, rest: Option<&Path>, json: bool) -> Result<()> {
    if let Some(rest) = rest {
        let is_exr = rest.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
        ensure!(is_exr, "--rest {}: the map is written as OpenEXR; name a .exr file", rest.display());
    }
    let output = LightFile::take(path, &FORMATS, ".json, .csv, .gltf or .py (Blender)")?;
    let rest = rest.map(OutputFile::take).transpose()?;
    // The map's copy, and as much for luminances and lists of texels.
    memory::require_pictures(environment.width(), environment.height(), 2)?;
    let (lights, without) = Texels::new(environment).lights();
    output.write(&lights)?;
    if let Some(rest) = rest {
        rest.write(|path| write_exr(path, &without, &[]))?;
    }
    if json {
        return terminal::print_json(&lights.iter().map(described).collect::<Vec<_>>());
    }
    for (number, light) in lights.iter().enumerate() {
        out!(
            "light {}: {:.1} % of the light, direction {}, radius {:.2} degrees",
            number + 1,
            100.0 * light.fraction,
            number::vector(light.direction),
            light.radius().to_degrees()
        );
    }
    let all = lights.iter().fold(0.0, |sum, light| sum + light.fraction);
    out!("{} lights with {:.1} % of the light of {}", lights.len(), 100.0 * all, environment.name());
    out!("{} written", path.display());
    Ok(())
}

/// A map by texels.
struct Texels {
    image: Image,
    /// `[rows]` solid angle of a texel.
    solid_angles: Vec<f64>,
    luminances: Vec<f64>,
}

impl Texels {
    fn new(environment: &Environment) -> Self {
        let image = environment.to_image();
        let (width, height) = (image.width as f64, image.height);
        // The first and the last row are centred at the poles.
        let edge = |row: f64| (std::f64::consts::PI * (row / (height - 1) as f64).clamp(0.0, 1.0)).cos();
        let solid_angle =
            |row: usize| std::f64::consts::TAU / width * (edge(row as f64 - 0.5) - edge(row as f64 + 0.5));
        let luminances = image.pixels.iter().map(|&pixel| f64::from(luminance(pixel.into()))).collect();
        Self { solid_angles: (0..height).map(solid_angle).collect(), image, luminances }
    }

    /// Returns the lights, the strongest first, and the map without them.
    fn lights(mut self) -> (Vec<Light>, Image) {
        let Self { image: Image { width, .. }, solid_angles, luminances } = &self;
        let total: f64 = luminances.iter().enumerate().map(|(k, light)| light * solid_angles[k / width]).sum();
        let mut peaks: Vec<usize> = (0..luminances.len()).collect();
        peaks.sort_by(|&a, &b| luminances[b].total_cmp(&luminances[a]));
        let mut is_seen = vec![false; peaks.len()];
        // Texels of lights, with the index of the light; they belong to no other, but to the halo around it.
        let mut owners = HashMap::new();
        let (mut lights, mut tries) = (Vec::<Light>::new(), 0);
        for peak in peaks {
            if is_seen[peak] || tries == TRIES || lights.len() == MOST || total <= 0.0 {
                continue;
            }
            tries += 1;
            let (own, ring) = self.grown(peak, |k| is_seen[k] && !owners.contains_key(&k));
            own.iter().for_each(|&k| is_seen[k] = true);
            let Some(light) = self.light(peak, &own, &ring, total) else { continue };
            let around = self.median(&ring);
            for &k in &own {
                self.image.pixels[k] = around;
                self.luminances[k] = f64::from(luminance(around.into()));
            }
            let owner = own.iter().chain(&ring).find_map(|k| owners.get(k).copied()).unwrap_or(lights.len());
            owners.extend(own.into_iter().map(|k| (k, owner)));
            match lights.get_mut(owner) {
                Some(core) => core.add(&light),
                None => lights.push(light),
            }
        }
        lights.sort_by(|a, b| b.fraction.total_cmp(&a.fraction));
        (lights, self.image)
    }

    /// Returns the connected texels around a peak that are bright enough, and the texels around them. Stops beyond the
    /// largest solid angle.
    fn grown(&self, peak: usize, is_taken: impl Fn(usize) -> bool) -> (Vec<usize>, Vec<usize>) {
        let least = OF_PEAK * self.luminances[peak];
        let (mut own, mut ring, mut solid_angle) = (vec![peak], Vec::new(), 0.0);
        let mut is_known = HashSet::from([peak]);
        let mut next = 0;
        while next < own.len() && solid_angle <= MOST_SOLID_ANGLE {
            solid_angle += self.solid_angles[own[next] / self.image.width];
            for k in self.neighbours(own[next]) {
                if is_known.insert(k) {
                    let is_own = self.luminances[k] >= least && !is_taken(k);
                    if is_own { own.push(k) } else { ring.push(k) }
                }
            }
            next += 1;
        }
        (own, ring)
    }

    /// The eight neighbours of a texel; rows are circles, and there is nothing beyond the poles.
    fn neighbours(&self, k: usize) -> impl Iterator<Item = usize> {
        let Image { width, height, .. } = self.image;
        let (column, row) = (k % width, k / width);
        let rows = row.saturating_sub(1)..(row + 2).min(height);
        rows.flat_map(move |row| [width - 1, 0, 1].map(|step| row * width + (column + step) % width))
            .filter(move |&other| other != k)
    }

    /// Returns the light of some texels, if they are compact and much brighter than the ring.
    fn light(&self, peak: usize, own: &[usize], ring: &[usize], total: f64) -> Option<Light> {
        let width = self.image.width;
        let around = DVec3::from_array(self.median(ring).map(f64::from));
        let (mut irradiance, mut towards, mut solid_angle, mut power) = (DVec3::ZERO, DVec3::ZERO, 0.0, 0.0);
        for &k in own {
            let part = self.solid_angles[k / width];
            let more = (DVec3::from_array(self.image.pixels[k].map(f64::from)) - around).max(DVec3::ZERO);
            let light = f64::from(luminance(more.as_vec3().into()));
            let u = ((k % width) as f32 + 0.5) / width as f32;
            let v = (k / width) as f32 / (self.image.height - 1) as f32;
            irradiance += part * more;
            towards += part * light * latlong::direction(Vec2::new(u, v)).as_dvec3();
            solid_angle += part;
            power += part * light;
        }
        let contrast = self.luminances[peak] / f64::from(luminance(around.as_vec3().into()));
        let is_light = solid_angle <= MOST_SOLID_ANGLE && contrast >= CONTRAST && power >= LEAST * total;
        is_light.then(|| Light {
            direction: towards.normalize_or(DVec3::Y).as_vec3a(),
            irradiance,
            solid_angle,
            fraction: power / total,
        })
    }

    /// Returns the median of each channel over texels; black without any.
    fn median(&self, texels: &[usize]) -> [f32; 3] {
        [0, 1, 2].map(|channel| {
            let mut values: Vec<f32> = texels.iter().map(|&k| self.image.pixels[k][channel]).collect();
            values.sort_by(f32::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.0)
        })
    }
}

fn described(light: &Light) -> Value {
    json!({
        "direction": light.direction.to_array(),
        "irradiance": light.irradiance.to_array(),
        "solid_angle": light.solid_angle,
        "angular_radius": light.radius(),
        "fraction": light.fraction,
    })
}

fn csv(lights: &[Light]) -> String {
    let mut text = "x,y,z,red,green,blue,solid_angle,angular_radius,fraction\n".to_owned();
    for light in lights {
        let (d, e) = (light.direction, light.irradiance);
        let numbers = [d.x, d.y, d.z].map(f64::from).into_iter().chain(e.to_array());
        let numbers = numbers.chain([light.solid_angle, light.radius(), light.fraction]);
        text += &(numbers.map(|number| number.to_string()).collect::<Vec<_>>().join(",") + "\n");
    }
    text
}

/// Directional lights of `KHR_lights_punctual`, which shine along -Z of their nodes.
fn gltf(lights: &[Light]) -> String {
    let node = |(number, light): (usize, &Light)| {
        let turn = Quat::from_rotation_arc(Vec3::Z, light.direction.into());
        json!({
            "name": format!("light-{}", number + 1),
            "rotation": turn.normalize().to_array(),
            "extensions": {"KHR_lights_punctual": {"light": number}},
        })
    };
    let light = |(number, light): (usize, &Light)| {
        let (color, strength) = light.color_and_strength();
        json!({
            "name": format!("light-{}", number + 1),
            "type": "directional",
            "color": color.to_array(),
            "intensity": strength,
        })
    };
    let nodes: Vec<Value> = lights.iter().enumerate().map(node).collect();
    let mut file = gltf_of_nodes("lights", nodes);
    if !lights.is_empty() {
        file["extensionsUsed"] = json!(["KHR_lights_punctual"]);
        let lights: Vec<Value> = lights.iter().enumerate().map(light).collect();
        file["extensions"] = json!({"KHR_lights_punctual": {"lights": lights}});
    }
    format!("{file:#}")
}

/// A script that adds sun lights.
fn blender(lights: &[Light]) -> String {
    let row = |light: &Light| {
        let (towards, (color, strength)) = (blender_vector(light.direction), light.color_and_strength());
        let [red, green, blue] = color.to_array();
        format!("    ({towards}, ({red}, {green}, {blue}), {strength}, {}),\n", 2.0 * light.radius())
    };
    format!(
        "\"\"\"Adds lights found by headtail as suns. Run it in Blender's text editor.\"\"\"\n\nimport bpy\n\
         from mathutils import Vector\n\n# Direction towards the light, Z up; colour; irradiance; angular diameter in radians.\n\
         LIGHTS = [\n{}]\n\n\
         for number, (direction, color, strength, angle) in enumerate(LIGHTS, 1):\n    \
         light = bpy.data.lights.new(f\"light-{{number}}\", \"SUN\")\n    \
         light.color, light.energy, light.angle = color, strength, angle\n    \
         sun = bpy.data.objects.new(light.name, light)\n    \
         sun.rotation_euler = Vector(direction).to_track_quat(\"Z\", \"Y\").to_euler()\n    \
         bpy.context.scene.collection.objects.link(sun)\n",
        lights.iter().map(row).collect::<String>()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey sky with discs of a colour (the first counts), given by direction, angular radius in radians, and radiance.
    fn sky(discs: &[(Vec3A, f32, f32)]) -> Environment {
        let (width, height) = (512, 256);
        let texel = |k: usize| {
            let x = Vec2::new(((k % width) as f32 + 0.5) / width as f32, (k / width) as f32 / (height - 1) as f32);
            let towards = latlong::direction(x);
            let lit = discs.iter().find(|(centre, radius, _)| towards.dot(*centre) > radius.cos());
            lit.map_or([1.0; 3], |(.., radiance)| [*radiance, 0.5 * radiance, 0.25 * radiance])
        };
        let pixels = (0..width * height).map(texel).collect();
        Environment::from_image("sky", Image { width, height, pixels }).unwrap()
    }

    #[test]
    fn discs_are_found_with_their_direction_and_irradiance() {
        let low = Vec3A::new(0.3, 0.2, -1.0).normalize();
        // One disc lies on the seam of the map, in +Z.
        let discs = [(low, 0.06, 2000.0), (Vec3A::new(0.0, 0.8, 1.0).normalize(), 0.1, 300.0)];
        let texels = Texels::new(&sky(&discs));
        let solid_angle: f64 = texels.solid_angles.iter().sum::<f64>() * 512.0;
        assert!((solid_angle / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-12, "{solid_angle}");
        let light_of = |image: &Image| -> f64 {
            image.pixels.iter().enumerate().map(|(k, pixel)| texels.solid_angles[k / 512] * f64::from(pixel[0])).sum()
        };
        let before = light_of(&texels.image);
        let (lights, rest) = Texels::new(&sky(&discs)).lights();
        assert_eq!(lights.len(), 2);
        for (light, (direction, radius, radiance)) in lights.iter().zip(discs) {
            assert!(light.direction.dot(direction) > 0.002_f32.cos(), "{light:?}");
            // A disc of n texels has a border of some sqrt(n) texels.
            assert!((light.radius() / f64::from(radius) - 1.0).abs() < 0.04, "{light:?}");
            let expected = light.solid_angle * f64::from(radiance - 1.0);
            assert!((light.irradiance.x / expected - 1.0).abs() < 1e-5, "{light:?}");
            let (color, _) = light.color_and_strength();
            assert!((color.y - 0.5).abs() < 0.01 && color.x == 1.0, "{color}");
        }
        // Lights and rest together are the map.
        let apart: f64 = lights.iter().map(|light| light.irradiance.x).sum::<f64>() + light_of(&rest);
        assert!((apart / before - 1.0).abs() < 1e-6, "{apart} {before}");
        assert!(rest.pixels.iter().all(|pixel| *pixel == [1.0; 3]));
    }

    #[test]
    fn a_halo_is_part_of_its_light() {
        let towards = Vec3A::new(0.3, 0.2, -1.0).normalize();
        let discs = [(towards, 0.03, 5000.0), (towards, 0.08, 100.0)];
        let (lights, rest) = Texels::new(&sky(&discs)).lights();
        assert_eq!(lights.len(), 1);
        assert!((lights[0].radius() / 0.03 - 1.0).abs() < 0.08, "{lights:?}");
        let halo = 100.0 * std::f64::consts::TAU * (0.03_f64.cos() - 0.08_f64.cos());
        assert!(lights[0].irradiance.x > 5000.0 * lights[0].solid_angle + 0.8 * halo, "{lights:?}");
        assert!(rest.pixels.iter().all(|pixel| *pixel == [1.0; 3]));
    }

    #[test]
    fn skies_without_lamps_have_no_lights() {
        assert!(Texels::new(&sky(&[])).lights().0.is_empty());
        let half = [(Vec3A::Y, 1.5, 100.0)];
        assert!(Texels::new(&sky(&half)).lights().0.is_empty(), "a window is no lamp");
    }

    #[test]
    fn every_format_has_every_light() {
        let discs = [(Vec3A::new(0.3, 0.2, -1.0).normalize(), 0.06, 2000.0)];
        let (lights, _) = Texels::new(&sky(&discs)).lights();
        let file: Value = serde_json::from_str(&gltf(&lights)).unwrap();
        let turn = Quat::from_array(std::array::from_fn(|k| file["nodes"][0]["rotation"][k].as_f64().unwrap() as f32));
        // A directional light shines along -Z of its node.
        assert!((turn * Vec3::NEG_Z + Vec3::from(lights[0].direction)).length() < 1e-5);
        assert_eq!(file["extensions"]["KHR_lights_punctual"]["lights"].as_array().unwrap().len(), 1);
        assert_eq!(csv(&lights).lines().count(), 2);
        assert!(blender(&lights).contains("\"SUN\""));
        assert!(serde_json::from_str::<Value>(&gltf(&[])).unwrap()["nodes"].is_null());
    }
}
