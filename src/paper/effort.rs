//! How much is computed, and about how long it takes.

/// Sizes, and lengths of training.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Maps of the fits; the first is that of most other sections.
    pub maps: usize,
    /// Steps of cosine heads.
    pub cosine_steps: usize,
    /// Steps of microfacet heads.
    pub ggx_steps: usize,
    /// Steps of the flow tail.
    pub flow_steps: usize,
    /// Steps of NeuSample's flows; none are trained where there are none.
    pub rival_steps: usize,
    /// Width of renderings; their height is three quarters of it.
    pub width: usize,
    /// Runs of each sampler.
    pub runs: u32,
    /// Samples per pixel of references.
    pub reference_spp: u32,
    /// Samples per pixel of masks whose noise is to be small; references of masks have a few times as many.
    pub mask_spp: u32,
    /// Rows of the pictures of densities; they are twice as wide.
    pub density_rows: usize,
}

/// Seconds of one core for a sample of a pixel with its shadow ray, measured as those of [`crate::cost`].
const SAMPLE: f64 = 0.5e-6;

impl Effort {
    /// Under ten minutes on two cores.
    pub const QUICK: Self = Self {
        maps: 2,
        cosine_steps: 400,
        ggx_steps: 600,
        // With 150 steps the flow of a room with a window shears by more turns than its table takes.
        flow_steps: 300,
        rival_steps: 0,
        width: 160,
        runs: 3,
        reference_spp: 512,
        mask_spp: 512,
        density_rows: 96,
    };
    /// Some two hours of one core for twelve maps. A reference of 2048 samples by patches has a 500th of the error at 4 samples.
    pub const FULL: Self = Self {
        maps: 12,
        cosine_steps: 1000,
        ggx_steps: 4000,
        flow_steps: 1000,
        rival_steps: 2000,
        width: 320,
        runs: 6,
        reference_spp: 2048,
        mask_spp: 1024,
        density_rows: 160,
    };

    /// About the seconds of one core for so many samples per pixel.
    pub fn rendering(self, spp: u32) -> f64 {
        (self.width * self.width * 3 / 4) as f64 * f64::from(spp) * SAMPLE
    }

    /// About the seconds of one core for comparing samplers in a view.
    pub fn comparison(self, samplers: u32) -> f64 {
        // 1, 4 and 16 samples, and some at equal time.
        self.rendering(self.reference_spp + self.runs * samplers * 30)
    }
}
