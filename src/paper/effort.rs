//! Sizes of the computations, and estimates of their time.

/// Image sizes, sample counts and training lengths.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Number of maps for the fits; most other sections use the first.
    pub maps: usize,
    /// Steps of cosine heads.
    pub cosine_steps: usize,
    /// Steps of microfacet heads.
    pub ggx_steps: usize,
    /// Steps of the flow tail.
    pub flow_steps: usize,
    /// Steps of NeuSample's flows; 0 trains none.
    pub rival_steps: usize,
    /// Width of renderings; the height is 3/4 of it.
    pub width: usize,
    /// Runs of each sampler.
    pub runs: u32,
    /// Samples per pixel of references.
    pub reference_spp: u32,
    /// Samples per pixel of masks with little noise; references of masks use a multiple.
    pub mask_spp: u32,
    /// Rows of the pictures of densities; columns are twice the rows.
    pub density_rows: usize,
}

/// Seconds on one core per sample of a pixel with its shadow ray, measured as in [`crate::cost`].
const SAMPLE: f64 = 0.5e-6;

impl Effort {
    /// A few minutes on two cores.
    pub const QUICK: Self = Self {
        maps: 2,
        cosine_steps: 400,
        ggx_steps: 600,
        // With 150 steps, the flow of a room with a window shears by more turns than its table supports.
        flow_steps: 300,
        rival_steps: 0,
        width: 128,
        runs: 3,
        reference_spp: 256,
        mask_spp: 128,
        density_rows: 96,
    };
    /// About two hours on one core for twelve maps. A reference of 2048 samples by patches has 1/500 of the
    /// MSE at 4 samples.
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

    /// Estimates the seconds on one core for `spp` samples per pixel.
    pub fn rendering(self, spp: u32) -> f64 {
        (self.width * self.width * 3 / 4) as f64 * f64::from(spp) * SAMPLE
    }

    /// Estimates the seconds on one core for comparing samplers in a view.
    pub fn comparison(self, samplers: u32) -> f64 {
        // 1, 4 and 16 samples, and some at equal time.
        self.rendering(self.reference_spp + self.runs * samplers * 30)
    }
}
