//! Writing an exported sampler.

use std::{collections::HashMap, path::Path};

use glam::Vec2;
use safetensors::tensor::{Dtype, TensorView, serialize};

use super::{ExportedSampler, Intermediate};
use crate::{
    error::{Error, Result},
    file,
    tail::Tail,
};

impl ExportedSampler {
    /// Writes the file atomically. Equal samplers give equal bytes.
    ///
    /// # Errors
    /// The file cannot be written, or a figure of the training summary is not finite, which JSON cannot
    /// represent.
    pub fn write(&self, path: &Path) -> Result<()> {
        if let Some(training) = &self.training {
            let seconds = training.seconds.unwrap_or(0.0) + training.tabulated_seconds.unwrap_or(0.0);
            let figures = [
                ("final_kl", training.final_kl),
                ("relative_variance", training.relative_variance),
                ("seconds", seconds),
            ];
            if let Some((name, value)) = figures.into_iter().find(|(_, value)| !value.is_finite()) {
                let reason = format!("is {value}: a sampler whose training diverged is not exported");
                return Err(Error::invalid(path, format!("training.{name}"), reason));
            }
        }
        let bytes = self.to_bytes().map_err(|reason| Error::invalid(path, "tensors", reason))?;
        file::replace(path, &bytes)
    }

    fn to_bytes(&self) -> std::result::Result<Vec<u8>, String> {
        let mut tensors: Vec<(String, Vec<usize>, Vec<f32>)> = Vec::new();
        let (width, height, luminance) = &self.luminance;
        tensors.push(("tail.luminance".into(), vec![*height, *width], luminance.clone()));
        if let Tail::Flow(flow) = &*self.tail {
            let values = flow.map().nodes().iter().flat_map(Vec2::to_array).collect();
            tensors.push(("tail.map".into(), vec![flow.map().cells() + 1, flow.map().cells(), 2], values));
        }
        match &self.intermediate {
            Intermediate::Head(head) => {
                for (name, layer) in head.layers() {
                    let shape = vec![layer.outputs(), layer.inputs()];
                    tensors.push((format!("{name}.weight"), shape, layer.weight().to_vec()));
                    tensors.push((format!("{name}.bias"), vec![layer.outputs()], layer.bias().to_vec()));
                }
            }
            Intermediate::Bake(table) | Intermediate::DirectBake(table) => {
                let ((polar, azimuth), (rows, columns)) = (table.normals().shape(), table.cells().shape());
                tensors.push(("table.masses".into(), vec![polar, azimuth, rows, columns], table.masses().to_vec()));
            }
        }
        let description = serde_json::to_string(&self.description()).map_err(|error| error.to_string())?;
        // A single entry: the order of several would vary between runs.
        let metadata = HashMap::from([("headtail".to_owned(), description)]);
        let bytes: Vec<Vec<u8>> = tensors.iter().map(|(.., values)| to_little_endian(values)).collect();
        let mut views = Vec::with_capacity(tensors.len());
        for ((name, shape, _), bytes) in tensors.iter().zip(&bytes) {
            let view = TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(|error| error.to_string())?;
            views.push((name.as_str(), view));
        }
        serialize(views, Some(metadata)).map_err(|error| error.to_string())
    }
}

fn to_little_endian(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}
