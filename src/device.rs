//! `--device`: pictures by the CPU or by a graphics device.

use anyhow::{Context as _, Result};
use headtail_eval::{GraphicsDevice, OpenedView};

use crate::terminal::note;

/// What renders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// All threads of the CPU.
    #[default]
    Cpu,
    /// The fastest graphics adapter.
    Gpu,
}

/// The values of `--device`.
pub const DEVICES: [(Device, &str, &str); 2] =
    [(Device::Cpu, "cpu", "All threads of the CPU"), (Device::Gpu, "gpu", "The fastest Vulkan, Metal or DX12 adapter")];

impl Device {
    /// Opens the graphics adapter for a view; `None` for the CPU.
    pub fn open(self, view: &OpenedView) -> Result<Option<GraphicsDevice>> {
        if self == Self::Cpu {
            return Ok(None);
        }
        let device = GraphicsDevice::open(view).context("--device gpu")?;
        if device.is_software() {
            note!("{} computes in software; --device cpu is faster", device.name());
        }
        Ok(Some(device))
    }
}

/// Chooses the graphics adapter of this process by its number, see [`headtail_gpu::Gpu::use_adapter`].
#[cfg(feature = "gpu")]
pub fn use_adapter(number: usize) -> Result<()> {
    Ok(headtail_gpu::Gpu::use_adapter(number)?)
}

#[cfg(not(feature = "gpu"))]
pub fn use_adapter(_number: usize) -> Result<()> {
    anyhow::bail!("this program was built without graphics devices; build it with --features gpu")
}
