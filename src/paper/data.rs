//! Maps and scenes: those of a folder, or the built-in ones.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, Result, ensure};
use glam::{Affine3A, Quat, Vec3};
use headtail_render::{
    environment::Environment,
    path_text::{path_of, text_of},
    scene::{Camera, MaterialSpec, Scene},
};

use super::is_folder;
use crate::arguments::open_environment;

/// Where maps and scenes come from.
pub struct Data {
    /// Names or paths of maps. Those of [`FIRST`] come first.
    maps: Vec<String>,
    /// Files of scenes.
    scenes: Vec<PathBuf>,
    /// Files of neural materials.
    materials: Vec<PathBuf>,
    /// A measured material as a network, if present.
    fabric: Option<MaterialSpec>,
    /// The file of `fabric`.
    measured: Option<PathBuf>,
    is_built_in: bool,
}

/// A scene with its camera.
pub struct View {
    /// The scene's name.
    pub name: String,
    /// The material's name: `--material` without its file.
    pub material: String,
    /// The surfaces.
    pub scene: Arc<Scene>,
    /// The camera.
    pub camera: Camera,
}

/// Maps that come first if present: one of each kind.
const FIRST: [&str; 6] = ["lebombo", "studio_small", "venice_sunset", "drachenfels", "dancing_hall", "forest_slope"];

/// Words in the names of files that replace scenes of the paper.
const STAND_INS: [(&str, &[&str]); 3] =
    [("temple", &["temple"]), ("droid", &["droid", "robot"]), ("diorama", &["diorama", "garden"])];

/// Neural materials by name.
const NEURAL_MATERIALS: [&str; 3] = ["welt", "satin", "velvet"];

/// The measured material that replaces a fabric: satin of the RGL database.
const FABRIC: &str = "rgl-isotropic/satin_gold_rgb";

impl Data {
    /// The maps and scenes of a folder.
    ///
    /// # Errors
    /// If the folder cannot be read or has no maps.
    pub fn open(folder: Option<&Path>, quick: bool) -> Result<Self> {
        let Some(folder) = folder else {
            let maps = ["studio", "window", "sunset", "overcast"].map(str::to_owned).to_vec();
            let materials = neural_materials(Path::new("checkpoints"));
            return Ok(Self { maps, scenes: Vec::new(), materials, fabric: None, measured: None, is_built_in: true });
        };
        ensure!(is_folder(folder), "--data: {}: there is no such folder", folder.display());
        let maps = files(folder, "envmaps", &["hdr", "exr"])?;
        ensure!(!maps.is_empty(), "--data: {}: there is no .hdr or .exr file in it, nor in envmaps", folder.display());
        let mut maps: Vec<String> = maps.iter().map(|path| text_of(path).into_owned()).collect();
        let rank = |name: &String| FIRST.iter().position(|first| name.contains(first)).unwrap_or(FIRST.len());
        maps.sort_by_key(|name| (rank(name), name.clone()));
        // The fits of a quick page use two maps, the shadow catcher three.
        maps.truncate(if quick { 3 } else { usize::MAX });
        let own = neural_materials(&folder.join("materials"));
        let materials = if own.is_empty() { neural_materials(Path::new("checkpoints")) } else { own };
        let measured = Some(folder.join("nbrdf/nbrdf_all.f32")).filter(|file| file.is_file());
        let fabric = measured.as_ref().map(|file| format!("nbrdf:{}#{FABRIC}", text_of(file)).parse());
        let fabric = fabric.transpose()?;
        let scenes = files(folder, "scenes", &["glb", "gltf"])?;
        Ok(Self { maps, scenes, materials, fabric, measured, is_built_in: false })
    }

    /// Returns a hash of the names and contents of all files (including those that scenes refer to) and of
    /// the names of built-in maps.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn key(&self) -> Result<String> {
        let maps: Vec<PathBuf> = self.maps.iter().map(|name| path_of(name)).collect();
        let mut hasher = blake3::Hasher::new();
        for path in maps.iter().chain(&self.scenes).chain(&self.materials).chain(&self.measured) {
            hasher.update(path.file_name().unwrap_or_default().as_encoded_bytes());
            if path.is_file() {
                let contents = fs::read(path).with_context(|| path.display().to_string())?;
                hasher.update(blake3::hash(&contents).as_bytes());
            }
        }
        // A scene that cannot be loaded is hashed as bytes above; the section that uses it reports the error.
        for scene in self.scenes.iter().filter_map(|path| Scene::load(path).ok()) {
            hasher.update(scene.content_hash().as_bytes());
        }
        Ok(hasher.finalize().to_hex().to_string())
    }

    /// Describes the data in words.
    pub fn words(&self) -> String {
        match self.is_built_in {
            true => "built-in maps and scenes".into(),
            false => format!("{} maps and {} scenes of --data", self.maps.len(), self.scenes.len()),
        }
    }

    /// Returns the number of maps.
    pub fn map_count(&self) -> usize {
        self.maps.len()
    }

    /// Opens a map; indices wrap around.
    pub fn map(&self, index: usize) -> Result<Arc<Environment>> {
        open_environment(&self.maps[index % self.maps.len()])
    }

    /// Returns a map's name without reading the map.
    pub fn map_name(&self, index: usize) -> String {
        let name = &self.maps[index % self.maps.len()];
        path_of(name).file_stem().map_or_else(|| name.clone(), |stem| stem.to_string_lossy().into_owned())
    }

    /// Returns the measured fabric as a network for which a head can be trained.
    pub fn fabric(&self) -> Option<MaterialSpec> {
        self.fabric.clone()
    }

    /// Returns the file of a neural material.
    pub fn neural_material(&self, name: &str) -> Option<&Path> {
        self.materials.iter().find(|file| file.file_stem().is_some_and(|stem| stem == name)).map(PathBuf::as_path)
    }

    /// Loads the stand-in for a scene of the paper, all of one material. Scenes from files get a ground.
    pub fn view(&self, name: &str, material: &str) -> Result<View> {
        let words = STAND_INS.iter().find(|(own, _)| *own == name).map_or(&[][..], |(_, words)| words);
        let is_it = |path: &&PathBuf| {
            path.file_stem().is_some_and(|stem| words.iter().any(|word| stem.to_string_lossy().contains(word)))
        };
        let file = self.scenes.iter().find(is_it);
        let mut scene = match file {
            Some(path) => Scene::load(path)?,
            None => Scene::built_in(name).context("a built-in scene")?,
        };
        let (camera, bounds) = (scene.camera(), scene.bounds());
        if file.is_some() {
            scene.add_ground();
        }
        let spec: MaterialSpec = material.parse()?;
        let name = scene.name().to_owned();
        let own = material.rsplit(['/', '#']).next().unwrap_or(material);
        Ok(View { name, material: own.to_owned(), scene: Arc::new(spec.dress(scene, &bounds)?), camera })
    }

    /// Loads an object to insert into a photograph, without a ground: from a file, or built from spheres.
    pub fn object(&self, index: usize) -> Result<(String, Scene)> {
        let wanted = ["spot", "shaderball", "robot"];
        let file = self.scenes.iter().find(|path| path.to_string_lossy().contains(wanted[index % 3]));
        if let Some(path) = file {
            let scene = Scene::load(path)?;
            return Ok((scene.name().to_owned(), scene));
        }
        let ball = Scene::built_in("sphere").context("a built-in scene")?;
        let made = |material: &str| -> Result<Scene> {
            Ok(material.parse::<MaterialSpec>()?.dress(ball.moved(&Affine3A::IDENTITY)?, &ball.bounds())?)
        };
        Ok(match index % 3 {
            0 => ("ball".into(), made("lambert:albedo=0.6")?),
            1 => ("metal ball".into(), made("ggx:alpha=0.15,f0=0.8")?),
            _ => {
                let place = |y: f32, size: f32| {
                    Affine3A::from_scale_rotation_translation(Vec3::splat(size), Quat::IDENTITY, Vec3::new(0.0, y, 0.0))
                };
                let white = made("lambert:albedo=0.8")?;
                let upper = white.moved(&place(1.45, 0.7))?.joined(&white.moved(&place(2.4, 0.45))?)?;
                ("three balls".into(), white.joined(&upper)?)
            }
        })
    }
}

/// The files of the neural materials in a folder.
fn neural_materials(folder: &Path) -> Vec<PathBuf> {
    let file = |name: &str| folder.join(name).with_extension("safetensors");
    NEURAL_MATERIALS.into_iter().map(file).filter(|file| file.is_file()).collect()
}

/// Files of a subfolder (of the folder itself if there is none) with one of these extensions, sorted.
fn files(folder: &Path, under: &str, endings: &[&str]) -> Result<Vec<PathBuf>> {
    let own = folder.join(under);
    let folder = if is_folder(&own) { own } else { folder.to_owned() };
    let entries = fs::read_dir(&folder).with_context(|| format!("{}", folder.display()))?;
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut paths: Vec<PathBuf> = paths
        .filter(|path| {
            path.extension().is_some_and(|own| endings.iter().any(|ending| own.eq_ignore_ascii_case(ending)))
        })
        .collect();
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parts are cached by file contents; size and path do not identify them.
    #[test]
    fn key_depends_on_file_contents_but_not_on_paths() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        let data = |folder: &Path| {
            let file = |name: &str| folder.join(name);
            Data {
                maps: vec![file("a.hdr").to_string_lossy().into_owned()],
                scenes: vec![file("b.glb")],
                materials: vec![file("c.safetensors")],
                fabric: None,
                measured: Some(file("d.f32")),
                is_built_in: false,
            }
        };
        let names = ["a.hdr", "b.glb", "c.safetensors", "d.f32"];
        names.into_iter().for_each(|name| fs::write(path.join(name), name).unwrap());
        let first = data(path).key().unwrap();
        for name in names {
            fs::write(path.join(name), name.to_uppercase()).unwrap();
            assert_ne!(data(path).key().unwrap(), first, "{name}");
            fs::write(path.join(name), name).unwrap();
        }
        fs::create_dir(path.join("moved")).unwrap();
        names.into_iter().for_each(|name| fs::rename(path.join(name), path.join("moved").join(name)).unwrap());
        assert_eq!(data(&path.join("moved")).key().unwrap(), first);
        assert_ne!(Data::open(None, true).unwrap().key().unwrap(), first);
    }

    /// A scene's vertices may be in another file.
    #[test]
    fn key_depends_on_files_that_scenes_refer_to() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        let triangle = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "buffers": [{"uri": "a.bin", "byteLength": 36}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}]}"#;
        fs::write(file("a.gltf"), triangle).unwrap();
        let key = |height: f32| {
            let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, height, 0.0_f32];
            fs::write(file("a.bin"), corners.map(f32::to_le_bytes).concat()).unwrap();
            Scene::load(&file("a.gltf")).unwrap();
            let scenes = vec![file("a.gltf")];
            Data { scenes, maps: Vec::new(), materials: Vec::new(), fabric: None, measured: None, is_built_in: false }
                .key()
                .unwrap()
        };
        assert_eq!(key(1.0), key(1.0));
        assert_ne!(key(1.0), key(0.5));
    }
}
