//! Samplers from SPECs, from files, and baked.

use std::{path::PathBuf, sync::Arc};

use headtail_eval::OpenedView;
use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    batch::{self, DrawList, FittedMaterial, Numbers, PointList, PreparedPoints, SurfaceList},
    environment,
    estimator::{Estimator, SingleSample},
    export::{ExportedSampler, Intermediate, flat_exported, flat_patches},
    flat::{FlatArray, FlatNumbers},
    image::Image,
    patches::{Detail, PatchSampler},
    sampler::{self, Covering, EmitterSampler},
    spec::{Companion, SamplerSpec, Source, Visibility},
    tail::{Tail, TailKind},
};
use numpy::{IntoPyArray, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadwriteArray1, PyReadwriteArray2};
use pyo3::{prelude::*, types::PyDict};

use crate::{
    arrays::rows,
    environment::Environment,
    error::{of_eval, of_render, refused},
};

/// A sampler of directions for one map.
#[pyclass(frozen, module = "headtail._native")]
pub struct Sampler {
    /// Its SPEC or file.
    pub name: String,
    /// Samples directions; `None` for estimators without a closed-form pdf (`ris`, `mis2`).
    sampler: Option<Arc<dyn sampler::Sampler>>,
    /// The map, and whether it has colours; the luminance in a sampler's file suffices for sampling, but not
    /// for radiance.
    pub map: Arc<environment::Environment>,
    pub has_map: bool,
    pub spec: Option<SamplerSpec>,
    pub exported: Option<ExportedSampler>,
}

type Rows<'py> = PyReadonlyArray2<'py, f32>;
type List<'py> = PyReadonlyArray1<'py, f32>;

#[pymethods]
impl Sampler {
    /// The sampler of a SPEC that is built for the rendered scene and has no pdf here.
    #[staticmethod]
    fn in_scene(py: Python<'_>, spec: &str, environment: &Environment) -> PyResult<Self> {
        let map = environment.0.clone();
        py.detach(|| {
            let spec: SamplerSpec = spec.parse()?;
            let exported = spec.path().map(|(_, file)| ExportedSampler::read(file)).transpose()?;
            Ok(Self { name: spec.to_string(), sampler: None, map, has_map: true, spec: Some(spec), exported })
        })
        .map_err(of_render)
    }

    #[staticmethod]
    fn from_spec(py: Python<'_>, spec: &str, environment: &Environment) -> PyResult<Self> {
        let mut own = Self::in_scene(py, spec, environment)?;
        py.detach(|| {
            match &own.spec {
                Some(spec) if spec.has_pdf() => own.sampler = Some(spec.build_sampler(&own.map)?),
                // Visibility in a file with several directions is checked against the scene when it is rendered.
                Some(spec) if !matches!(spec.visibility(), Visibility::File(_)) => drop(spec.build(&own.map)?),
                _ => {}
            }
            Ok(own)
        })
        .map_err(of_render)
    }

    #[staticmethod]
    #[pyo3(signature = (path, environment=None))]
    fn open(py: Python<'_>, path: PathBuf, environment: Option<&Environment>) -> PyResult<Self> {
        let map = environment.map(|environment| environment.0.clone());
        py.detach(|| {
            let exported = ExportedSampler::read(&path)?;
            Self::of_exported(path.display().to_string(), exported, map).map_err(|error| error.in_file(&path))
        })
        .map_err(of_render)
    }

    /// Patches without BRDF sampling, which has no SPEC, for pointwise comparison with other implementations.
    #[staticmethod]
    fn patches_alone(py: Python<'_>, environment: &Environment, fine: bool) -> PyResult<Self> {
        let (map, detail) = (environment.0.clone(), if fine { Detail::Twigs } else { Detail::Leaves });
        py.detach(|| {
            let light = sampler::EnvironmentLight::new(map.clone(), TailKind::Hierarchical)?;
            let sampler: Arc<dyn sampler::Sampler> = Arc::new(PatchSampler::new(light, detail)?);
            let spec = Some(SamplerSpec::new(Source::Patches(detail), Companion::None)?);
            Ok(Self { name: "patches".into(), sampler: Some(sampler), map, has_map: true, spec, exported: None })
        })
        .map_err(of_render)
    }

    #[staticmethod]
    fn direct(
        py: Python<'_>,
        environment: &Environment,
        normals: [usize; 2],
        cells: [usize; 2],
        tail: &str,
    ) -> PyResult<Self> {
        let map = environment.0.clone();
        let kind = TailKind::from_name(tail)
            .ok_or_else(|| refused(format!("tail '{tail}' is neither hierarchical nor row-column")))?;
        py.detach(|| {
            let warp = Tail::of_environment(kind, &map)?;
            let table =
                direct_bake(&warp, NormalGrid::new(normals[0], normals[1])?, CellGrid::new(cells[0], cells[1])?)?;
            let exported = ExportedSampler::new(Intermediate::DirectBake(table), kind, &map, None)?;
            Self::of_exported("direct".into(), exported, Some(map))
        })
        .map_err(of_render)
    }

    /// Returns the named arrays that implementations on other devices read.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let is_pointwise = |spec: &SamplerSpec| spec.has_pdf() && *spec.visibility() == Visibility::None;
        let spec = self.spec.as_ref().map(|spec| spec.resolved(false)).filter(is_pointwise);
        let arrays = py.detach(|| match (spec.as_ref().map(SamplerSpec::source), &self.exported) {
            (Some(Source::Patches(detail)), _) => {
                flat_patches(&Tail::of_environment(TailKind::Hierarchical, &self.map)?, *detail)
            }
            // The emitters' part of MIS: implementations sample BRDFs themselves.
            (Some(Source::Compensated), _) => {
                Ok(EmitterSampler::compensated(&self.map, TailKind::Hierarchical)?.light().tail().flat())
            }
            (_, Some(exported)) => flat_exported(exported),
            (_, None) => Err(headtail_render::Error::argument(
                &*self.name,
                "has no form for other devices: use patches, mis-comp or a table",
            )),
        });
        dictionary(py, arrays.map_err(of_render)?)
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    #[getter]
    fn has_map(&self) -> bool {
        self.has_map
    }

    fn description(&self) -> PyResult<Option<String>> {
        let text = self.exported.as_ref().map(|exported| serde_json::to_string(&exported.description()));
        text.transpose().map_err(|error| refused(error.to_string()))
    }

    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let Some(exported) = &self.exported else {
            return Err(refused(format!("{}: is not one that a file holds; bake or fit one", self.name)));
        };
        py.detach(|| exported.write(&path)).map_err(of_render)
    }

    fn sample(
        &self,
        py: Python<'_>,
        at: Points<'_>,
        u: Option<Rows<'_>>,
        seed: u64,
        mut out: Drawn<'_>,
    ) -> PyResult<()> {
        let (sampler, at, numbers) = (self.closed()?, self.list(&at)?, numbers(&u, seed)?);
        let out = out.list(&self.name, self.has_map.then_some(&self.map))?;
        py.detach(|| batch::sample(&**sampler, &at, numbers, out)).map_err(of_render)
    }

    fn pdf(&self, py: Python<'_>, at: Points<'_>, wi: Rows<'_>, mut out: PyReadwriteArray1<'_, f32>) -> PyResult<()> {
        let (sampler, at) = (self.closed()?, self.list(&at)?);
        let (wi, out) = (rows(&wi)?, out.as_slice_mut()?);
        py.detach(|| batch::pdf(&**sampler, &at, wi, out)).map_err(of_render)
    }

    fn prepare(&self, py: Python<'_>, at: Points<'_>, count: usize) -> PyResult<Prepared> {
        let (sampler, at) = (self.closed()?, self.list(&at)?);
        let points = py.detach(|| PreparedPoints::new(sampler.clone(), &at, count)).map_err(of_render)?;
        Ok(Prepared { points, name: self.name.clone(), map: self.has_map.then(|| self.map.clone()) })
    }
}

/// Points prepared for a sampler.
#[pyclass(frozen, module = "headtail._native")]
pub struct Prepared {
    points: PreparedPoints,
    name: String,
    map: Option<Arc<environment::Environment>>,
}

#[pymethods]
impl Prepared {
    #[getter]
    fn count(&self) -> usize {
        self.points.count()
    }

    #[getter]
    fn has_map(&self) -> bool {
        self.map.is_some()
    }

    fn sample(&self, py: Python<'_>, u: Option<Rows<'_>>, seed: u64, mut out: Drawn<'_>) -> PyResult<()> {
        let (numbers, out) = (numbers(&u, seed)?, out.list(&self.name, self.map.as_ref())?);
        py.detach(|| self.points.sample(numbers, out)).map_err(of_render)
    }

    fn pdf(&self, py: Python<'_>, wi: Rows<'_>, mut out: PyReadwriteArray1<'_, f32>) -> PyResult<()> {
        let (wi, out) = (rows(&wi)?, out.as_slice_mut()?);
        py.detach(|| self.points.pdf(wi, out)).map_err(of_render)
    }
}

/// Returns named arrays as a dictionary.
pub fn dictionary(py: Python<'_>, arrays: Vec<FlatArray>) -> PyResult<Bound<'_, PyDict>> {
    let result = PyDict::new(py);
    for FlatArray { name, shape, numbers } in arrays {
        match numbers {
            FlatNumbers::Floats(numbers) => result.set_item(name, numbers.into_pyarray(py).reshape(shape)?)?,
            FlatNumbers::Integers(numbers) => result.set_item(name, numbers.into_pyarray(py).reshape(shape)?)?,
        }
    }
    Ok(result)
}

/// A measured or neural material.
#[pyclass(frozen, module = "headtail._native")]
pub struct Material {
    name: String,
    material: FittedMaterial,
}

#[pymethods]
impl Material {
    #[new]
    fn new(py: Python<'_>, name: String) -> PyResult<Self> {
        let material = py.detach(|| FittedMaterial::open(&name)).map_err(of_render)?;
        Ok(Self { name, material })
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }
}

/// Evaluates BRDF times cosine.
#[pyfunction]
pub fn brdf_cosine(py: Python<'_>, at: Points<'_>, wi: Rows<'_>, mut out: PyReadwriteArray2<'_, f32>) -> PyResult<()> {
    let (at, wi, out) = (at.list()?, rows(&wi)?, out.as_slice_mut()?.as_chunks_mut().0);
    py.detach(|| batch::brdf_cosine(&at, wi, out)).map_err(of_render)
}

/// The arrays of shading points: positions, normals, directions to the viewer, and surfaces.
#[derive(FromPyObject)]
pub struct Points<'py>(Option<Rows<'py>>, Rows<'py>, Option<Rows<'py>>, Option<SurfaceArrays<'py>>);

/// The arrays of surfaces that are not diffuse.
#[derive(FromPyObject)]
enum SurfaceArrays<'py> {
    /// `alpha`, `f0`.
    Glossy(List<'py>, List<'py>),
    /// Base colours, metalness, roughness.
    MetallicRoughness(Rows<'py>, List<'py>, List<'py>),
    /// A material; texture coordinates, tangents and footprints of neural ones.
    Fitted(Py<Material>, Option<Rows<'py>>, Option<Rows<'py>>, Option<List<'py>>),
}

impl Points<'_> {
    fn list(&self) -> PyResult<PointList<'_>> {
        let Points(p, n, wo, surface) = self;
        let surface = match surface {
            None => SurfaceList::Diffuse,
            Some(SurfaceArrays::Glossy(alpha, f0)) => {
                SurfaceList::Glossy { alpha: alpha.as_slice()?, f0: f0.as_slice()? }
            }
            Some(SurfaceArrays::MetallicRoughness(color, metallic, roughness)) => SurfaceList::MetallicRoughness {
                base_color: rows(color)?,
                metallic: metallic.as_slice()?,
                roughness: roughness.as_slice()?,
            },
            Some(SurfaceArrays::Fitted(material, uv, tangent, footprint)) => SurfaceList::Fitted {
                material: &material.get().material,
                uv: optional(uv)?,
                tangent: optional(tangent)?,
                footprint: footprint.as_ref().map_or(Ok(&[] as &[f32]), |list| list.as_slice())?,
            },
        };
        Ok(PointList { p: optional(p)?, n: rows(n)?, wo: optional(wo)?, surface })
    }
}

/// The arrays of draws: directions, pdfs and, if wanted, radiance.
#[derive(FromPyObject)]
pub struct Drawn<'py>(PyReadwriteArray2<'py, f32>, PyReadwriteArray1<'py, f32>, Option<PyReadwriteArray2<'py, f32>>);

impl Drawn<'_> {
    fn list<'a>(&'a mut self, name: &str, map: Option<&'a Arc<environment::Environment>>) -> PyResult<DrawList<'a>> {
        let radiance = match (&mut self.2, map) {
            (Some(list), Some(map)) => Some((&**map, list.as_slice_mut()?.as_chunks_mut().0)),
            (Some(_), None) => return Err(refused(format!("{name}: was opened without its map"))),
            (None, _) => None,
        };
        Ok(DrawList { wi: self.0.as_slice_mut()?.as_chunks_mut().0, pdf: self.1.as_slice_mut()?, radiance })
    }
}

fn numbers<'a>(u: &'a Option<Rows<'_>>, seed: u64) -> PyResult<Numbers<'a>> {
    Ok(match u {
        Some(u) => Numbers::Given(rows(u)?),
        None => Numbers::Seed(seed),
    })
}

impl Sampler {
    /// The sampler of an exported file; without its map for directions only.
    pub fn of_exported(
        name: String,
        mut exported: ExportedSampler,
        map: Option<Arc<environment::Environment>>,
    ) -> headtail_render::Result<Self> {
        let has_map = map.is_some();
        let kept = exported.clone();
        let map = match map {
            Some(map) => map,
            None => {
                let (width, height, luminance) = &exported.luminance;
                let pixels = luminance.iter().map(|&value| [value; 3]).collect();
                let grey = Image { width: *width, height: *height, pixels };
                let map = environment::Environment::from_image(&exported.environment, grey)?;
                map.hash().clone_into(&mut exported.environment_hash);
                Arc::new(map)
            }
        };
        let sampler = exported.open(&map)?.into_inner();
        Ok(Self { name, sampler: Some(sampler), map, has_map, spec: None, exported: Some(kept) })
    }

    fn closed(&self) -> PyResult<&Arc<dyn sampler::Sampler>> {
        self.sampler
            .as_ref()
            .ok_or_else(|| refused(format!("{}: has no pdf of its own; it can be rendered and compared", self.name)))
    }

    fn list<'a>(&self, at: &'a Points<'_>) -> PyResult<PointList<'a>> {
        if at.0.is_none() && self.spec.as_ref().is_some_and(SamplerSpec::needs_positions) {
            return Err(refused(format!("p: {} depends on positions", self.name)));
        }
        at.list()
    }

    /// Returns the estimator for a rendering.
    pub fn estimator(&self, view: &OpenedView) -> PyResult<Box<dyn Estimator>> {
        if !self.has_map {
            return Err(refused(format!("{}: was opened without its map", self.name)));
        }
        if self.map.hash() != view.environment.hash() {
            let given = view.environment.name();
            return Err(refused(format!("{}: was made for another map than {given}", self.name)));
        }
        match (&self.sampler, &self.spec) {
            (_, Some(spec)) if *spec.source() == Source::Auto || spec.needs_positions() => {
                view.estimator(spec).map_err(of_eval)
            }
            (Some(sampler), _) => {
                let sampler = Covering::new(sampler.clone()).map_err(of_render)?;
                Ok(Box::new(SingleSample::new(sampler, self.map.clone())))
            }
            (None, Some(spec)) => view.estimator(spec).map_err(of_eval),
            (None, None) => Err(refused("sampler: has neither a pdf nor a SPEC")),
        }
    }
}

fn optional<'a, const N: usize>(array: &'a Option<Rows<'_>>) -> PyResult<&'a [[f32; N]]> {
    array.as_ref().map_or(Ok(&[]), rows)
}
