//! Errors of training.

use crate::backend::Backend;

/// An error of training.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The backend is not part of this build.
    #[error("the backend `{backend}` is not in this build: build with `--features {backend}`")]
    BackendNotCompiled {
        /// The requested backend.
        backend: Backend,
    },
    /// Gradients on a graphics device are not part of this build.
    #[error("gradients on a graphics device are not in this build: build with `--features gpu`")]
    DeviceNotCompiled,
    /// A graphics device cannot be had, has too little memory, or failed.
    #[error("training on a graphics device: {reason}")]
    Device {
        /// What is wrong.
        reason: String,
    },
    /// Only heads for diffuse surfaces can be baked.
    #[error("tables are over normals: only a head for diffuse surfaces can be baked")]
    NotBakeable,
    /// The machine has no graphics adapter for the backend wgpu.
    #[error(
        "the backend `wgpu` finds no graphics adapter: install a Vulkan, Metal or DX12 driver (mesa-vulkan-drivers has one in \
         software), or choose `ndarray`"
    )]
    NoAdapter,
    /// A field of the training configuration is out of range.
    #[error("training configuration: {field} = {value}, but it must be {requirement}")]
    Config {
        /// The field's name.
        field: &'static str,
        /// Its value.
        value: String,
        /// The permitted range.
        requirement: &'static str,
    },
    /// A configuration file, or a value that replaces one, is invalid.
    #[error("{name}: {reason}")]
    ConfigFile {
        /// The file, or another source of the value.
        name: String,
        /// What is wrong.
        reason: String,
    },
    /// The head's configuration or weights are invalid.
    #[error(transparent)]
    Model(#[from] headtail_model::Error),
    /// The exported sampler or its tables cannot be built or written.
    #[error(transparent)]
    Render(#[from] std::sync::Arc<headtail_render::Error>),
    /// The flow that was fitted to a map cannot be tabulated.
    #[error(
        "the flow that was fitted to the map has no table: {reason}; with other settings or another seed it may have one"
    )]
    NoTable {
        /// Why the table rejects it.
        reason: std::sync::Arc<headtail_render::Error>,
    },
    /// The target returned a density that is negative, infinite or NaN.
    #[error("the target density is {density} at y = {y:?} under condition {condition:?}")]
    BadTarget {
        /// The returned density.
        density: f32,
        /// The point of the intermediate square.
        y: [f32; 2],
        /// The condition.
        condition: Vec<f32>,
    },
    /// The target is zero under every validation condition.
    #[error("the target is zero everywhere under all {conditions} validation conditions: is the environment black?")]
    EmptyTarget {
        /// Number of conditions tried.
        conditions: usize,
    },
    /// The camera that provides conditions sees no surface.
    #[error("the scene '{scene}': its camera sees (almost) no surface to take conditions from")]
    NothingSeen {
        /// The scene's name.
        scene: String,
    },
    /// A checkpoint, or the folder of checkpoints, cannot be used.
    #[error("{}: {reason}", path.display())]
    Checkpoint {
        /// The folder or file.
        path: std::path::PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A file of results cannot be written.
    #[error("{}: {reason}", path.display())]
    Output {
        /// The file.
        path: std::path::PathBuf,
        /// The system's reason.
        reason: String,
    },
    /// Too many steps had no finite loss and gradient.
    #[error("training diverged: {skipped} steps were not finite by step {step}; try a smaller learning rate")]
    Diverged {
        /// The step at which training stopped.
        step: usize,
        /// Steps skipped so far.
        skipped: usize,
    },
}

/// The crate's result type.
pub type Result<T> = std::result::Result<T, Error>;

impl From<headtail_render::Error> for Error {
    fn from(error: headtail_render::Error) -> Self {
        Self::Render(std::sync::Arc::new(error))
    }
}
