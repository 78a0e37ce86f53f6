//! Environment maps.

use std::sync::Arc;

use headtail_render::{
    Error, batch,
    environment::{self, MapSpec},
    image::{Image, MapLayout},
    remark::Remark,
};
use numpy::{
    PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray2, PyUntypedArrayMethods, ToPyArray, ndarray::Array3,
};
use pyo3::prelude::*;

use crate::{arrays::rows, error::of_render};

/// An environment map.
#[pyclass(frozen, module = "headtail._native")]
pub struct Environment(pub Arc<environment::Environment>);

#[pymethods]
impl Environment {
    #[staticmethod]
    fn open(py: Python<'_>, name_or_path: &str, layout: Option<&str>, layer: Option<String>) -> PyResult<Self> {
        let open = || {
            let spec = MapSpec::parse(name_or_path)?;
            let layout = layout.map(layout_of).transpose()?.or(spec.layout);
            environment::Environment::open(
                &MapSpec { name: spec.name, layout, layer: layer.or(spec.layer) }.to_string(),
            )
        };
        let map = py.detach(open).map_err(of_render)?;
        Ok(Self(Arc::new(map)))
    }

    #[staticmethod]
    fn from_array(
        py: Python<'_>,
        texels: PyReadonlyArray3<'_, f32>,
        name: &str,
        layout: Option<&str>,
    ) -> PyResult<Self> {
        let (height, width) = (texels.shape()[0], texels.shape()[1]);
        let pixels = texels.as_slice()?.as_chunks().0.to_vec();
        let layout = layout.map(layout_of).transpose().map_err(of_render)?.unwrap_or_default();
        let image = Image { width, height, pixels };
        let map = py.detach(|| environment::Environment::from_image_in(name, image, layout));
        Ok(Self(Arc::new(map.map_err(of_render)?)))
    }

    #[getter]
    fn name(&self) -> &str {
        self.0.name()
    }

    #[getter]
    fn width(&self) -> usize {
        self.0.width()
    }

    #[getter]
    fn height(&self) -> usize {
        self.0.height()
    }

    #[getter]
    fn hash(&self) -> &str {
        self.0.hash()
    }

    #[getter]
    fn notes(&self) -> Vec<String> {
        remarks(self.0.remarks(), false)
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        remarks(self.0.remarks(), true)
    }

    fn array<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let Image { width, height, pixels } = self.0.to_image();
        array_of(py, (height, width), &pixels)
    }

    fn radiance(
        &self,
        py: Python<'_>,
        wi: PyReadonlyArray2<'_, f32>,
        mut out: PyReadwriteArray2<'_, f32>,
    ) -> PyResult<()> {
        let (wi, out) = (rows(&wi)?, out.as_slice_mut()?.as_chunks_mut().0);
        py.detach(|| batch::radiance(&self.0, wi, out)).map_err(of_render)
    }
}

/// Returns the texts of warnings or of notes.
pub fn remarks(remarks: &[Remark], warnings: bool) -> Vec<String> {
    remarks.iter().filter(|remark| remark.is_warning() == warnings).map(|remark| remark.text().to_owned()).collect()
}

fn layout_of(name: &str) -> Result<MapLayout, Error> {
    name.parse().map_err(|reason| Error::argument(format!("layout '{name}'"), reason))
}

/// Returns an image as `[height, width, 3]`.
pub fn array_of<'py>(
    py: Python<'py>,
    (height, width): (usize, usize),
    pixels: &[[f32; 3]],
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let array = Array3::from_shape_vec((height, width, 3), pixels.as_flattened().to_vec());
    array.map(|array| array.to_pyarray(py)).map_err(|error| crate::error::refused(error.to_string()))
}
