//! Time to make the files of a sampler, as recorded in them.

use headtail_render::{
    export::{ExportedSampler, Intermediate},
    rival::RivalFile,
    spec::{SamplerSpec, Source, Visibility},
    visibility::SceneVisibility,
};

use crate::Result;

/// Time to make a sampler's files, and a description.
#[derive(Clone, Debug, PartialEq)]
pub struct FilePreparation {
    /// Seconds; times that are not recorded count as 0.
    pub seconds: f64,
    /// Description, such as "file read; trained before for 1000 steps on ndarray (3.2 s)".
    pub text: String,
}

impl FilePreparation {
    /// Sums over all files of a SPEC.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn of(spec: &SamplerSpec) -> Result<Self> {
        let mut own = match spec.path() {
            Some((_, file)) => Self::of_exported(&ExportedSampler::read(file)?),
            None => Self { seconds: 0.0, text: "tables built".into() },
        };
        if let Source::Rival(_, file) = spec.source() {
            own.add("trained for materials", RivalFile::read(file)?.seconds);
        }
        if let Visibility::File(file) = spec.visibility() {
            own.add("visibility learned", SceneVisibility::read(file)?.seconds);
        }
        Ok(own)
    }

    /// Returns the preparation of an exported sampler.
    pub fn of_exported(exported: &ExportedSampler) -> Self {
        let Some(training) = &exported.training else {
            return Self { seconds: 0.0, text: "file read; the time of its bake is not in the file".into() };
        };
        let mut text = format!("file read; trained before for {} steps on {}", training.steps, training.backend);
        if let Intermediate::Head(head) = &exported.intermediate {
            let parameters: usize = head.layers().iter().map(|(_, layer)| (layer.inputs() + 1) * layer.outputs()).sum();
            text += &format!("; {parameters} parameters");
        }
        let mut own = Self { seconds: 0.0, text };
        if let Some(seconds) = training.seconds {
            own.seconds += seconds;
            own.text += &format!(" ({seconds:.1} s)");
        }
        match (&exported.intermediate, training.tabulated_seconds) {
            (Intermediate::Head(_), _) => {}
            (_, Some(seconds)) => {
                own.seconds += seconds;
                own.text += &format!("; tabulated ({seconds:.1} s)");
            }
            (_, None) => own.text += "; the time of tabulating the head is not known",
        }
        own
    }

    fn add(&mut self, what: &str, seconds: Option<f64>) {
        self.seconds += seconds.unwrap_or(0.0);
        self.text += &match seconds {
            Some(seconds) => format!("; {what} before ({seconds:.1} s)"),
            None => format!("; {what} before, whose time is not known"),
        };
    }
}
