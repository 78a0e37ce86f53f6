//! How much is computed.

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

impl Effort {
    /// Under ten minutes on two cores.
    pub const QUICK: Self = Self {
        maps: 2,
        cosine_steps: 400,
        ggx_steps: 600,
        flow_steps: 150,
        width: 160,
        runs: 3,
        reference_spp: 512,
        mask_spp: 512,
        density_rows: 96,
    };
    /// Whatever it takes.
    pub const FULL: Self = Self {
        maps: 12,
        cosine_steps: 1000,
        ggx_steps: 4000,
        flow_steps: 1000,
        width: 400,
        runs: 10,
        reference_spp: 4096,
        mask_spp: 1024,
        density_rows: 160,
    };
}
