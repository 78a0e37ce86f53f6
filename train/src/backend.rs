//! The tensor library's backends, selected at run time.

use std::fmt;

use burn::prelude::Device;
use serde::{Deserialize, Serialize};

use crate::{Error, Result, config::name_of};

/// A backend. All names exist in every build, so that selecting one that is not compiled in is an error that
/// names its feature.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Backend {
    /// The CPU backend of the default build, which burn removes after 0.22.
    #[default]
    Ndarray,
    /// burn's newer CPU backend.
    Flex,
    /// Vulkan, Metal or DX12, through wgpu.
    Wgpu,
}

impl Backend {
    /// All backends, compiled in or not.
    pub const ALL: [Self; 3] = [Self::Ndarray, Self::Flex, Self::Wgpu];

    /// Returns the backend's device, without autodiff.
    ///
    /// # Errors
    /// [`Error::BackendNotCompiled`] if the build lacks the backend's feature; [`Error::NoAdapter`] if the
    /// machine has no graphics adapter.
    pub fn device(self) -> Result<Device> {
        match self {
            #[cfg(feature = "flex")]
            Self::Flex => Ok(Device::flex()),
            // Deprecated by burn 0.22, whose successor has no ndarray backend: remove with the next burn
            // upgrade.
            #[cfg(feature = "ndarray")]
            #[allow(deprecated)]
            Self::Ndarray => Ok(Device::ndarray()),
            #[cfg(feature = "wgpu")]
            Self::Wgpu => wgpu_device(),
            #[allow(unreachable_patterns)]
            backend => Err(Error::BackendNotCompiled { backend }),
        }
    }

    /// Returns whether tensors are in host memory, so that reading them back needs a copy and no
    /// synchronisation.
    pub const fn is_host(self) -> bool {
        matches!(self, Self::Flex | Self::Ndarray)
    }
}

/// Returns a GPU if there is one, else a software adapter, which burn never selects by itself.
#[cfg(feature = "wgpu")]
fn wgpu_device() -> Result<Device> {
    use burn::{prelude::DeviceKind, tensor::DeviceType};

    let software = Device::wgpu(DeviceKind::Cpu);
    let adapters = Device::enumerate(DeviceType::Wgpu);
    let processor = adapters.iter().find(|&adapter| *adapter != software);
    processor.or(adapters.first()).cloned().ok_or(Error::NoAdapter)
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&name_of(self))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_backend_that_is_not_compiled_in_names_its_feature() {
        for backend in Backend::ALL {
            let compiled = match backend {
                Backend::Flex => cfg!(feature = "flex"),
                Backend::Ndarray => cfg!(feature = "ndarray"),
                Backend::Wgpu => cfg!(feature = "wgpu"),
            };
            if !compiled {
                let message = backend.device().unwrap_err().to_string();
                assert!(message.contains(&format!("--features {backend}")), "{message}");
            }
        }
    }
}
