//! The views of an experiment that a block shows.

use anyhow::{Result, bail};
use headtail_eval::{Experiment, summary::ViewRuns};

use crate::block::Block;

/// An experiment and its views with data.
pub struct Shown<'a> {
    pub experiment: &'a Experiment,
    pub views: Vec<ViewRuns>,
}

impl Shown<'_> {
    /// Returns the groups of views in columns: by the block's `columns` key (material, scene, light or tuned), and all views.
    pub fn groups(&self, block: &Block) -> Result<Vec<(String, Vec<&ViewRuns>)>> {
        let name = |view: &ViewRuns| -> Result<String> {
            let map = self.experiment.map(&view.key.map);
            let is_interior = self.experiment.scene(&view.key.scene).is_some_and(|scene| scene.interior);
            Ok(match block.get("columns").unwrap_or("material") {
                "material" => view.key.material.clone(),
                "scene" => view.key.scene.clone(),
                "light" if is_interior => "interiors".into(),
                "light" => map.map(|map| map.kind.clone()).unwrap_or_default(),
                "tuned" if self.experiment.is_tuned(&view.key) => "tuned".into(),
                "tuned" => "untuned".into(),
                other => bail!("columns: there is no grouping '{other}'"),
            })
        };
        let mut groups: Vec<(String, Vec<&ViewRuns>)> = Vec::new();
        // In the order of the experiment.
        let mut views: Vec<&ViewRuns> = self.views.iter().collect();
        let keys = self.experiment.view_keys();
        views.sort_by_key(|view| keys.iter().position(|key| *key == view.key));
        for view in &views {
            let name = name(view)?;
            match groups.iter_mut().find(|group| group.0 == name) {
                Some(group) => group.1.push(view),
                None => groups.push((name, vec![view])),
            }
        }
        if groups.len() > 1 {
            groups.push(("all".into(), views));
        }
        Ok(groups)
    }

    /// Returns the samplers in the order of the experiment.
    pub fn samplers(&self) -> Vec<String> {
        let is_there = |name: &&String| self.views.iter().any(|view| view.samplers.contains_key(*name));
        let mut names: Vec<String> = Vec::new();
        for name in self.experiment.samplers.iter().map(|own| &own.name).filter(is_there) {
            // Several files for different materials may have the same name.
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        names
    }
}
