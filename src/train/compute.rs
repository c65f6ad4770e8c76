//! What a training run is computed on. Apart from rounding it does not change the result.

use burn::tensor::Device;

/// Processor of the network's part; rendering, solving and loss are always the CPU's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Processor {
    /// burn's flex backend.
    Cpu,
    /// An NVIDIA card (feature `train-cuda`).
    Cuda,
    /// Any card with Vulkan, Metal or DirectX 12 (feature `train-wgpu`).
    Wgpu,
}

/// Why a processor can't be used.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("this build can't train on {name}: build with --features {feature}")]
pub struct NotBuilt {
    name: &'static str,
    feature: &'static str,
}

/// Threads and processor of a run.
#[derive(Clone, Debug)]
pub struct Compute {
    /// Threads for pictures, solver and loss, and for micro-batches.
    pub threads: usize,
    /// Where the network runs.
    pub device: Device,
}

impl Compute {
    /// The CPU with so many threads.
    #[must_use]
    pub fn cpu(threads: usize) -> Self {
        Self { threads, device: Device::flex() }
    }

    /// A processor that this build knows.
    ///
    /// # Errors
    /// [`NotBuilt`] names the feature that is missing.
    pub fn new(processor: Processor, threads: usize) -> Result<Self, NotBuilt> {
        let device = match processor {
            Processor::Cpu => Device::flex(),
            #[cfg(feature = "train-cuda")]
            Processor::Cuda => Device::cuda(burn::tensor::DeviceIndex::Default),
            #[cfg(not(feature = "train-cuda"))]
            Processor::Cuda => return Err(NotBuilt { name: "CUDA", feature: "train-cuda" }),
            #[cfg(feature = "train-wgpu")]
            Processor::Wgpu => Device::wgpu(burn::tensor::DeviceKind::DefaultDevice),
            #[cfg(not(feature = "train-wgpu"))]
            Processor::Wgpu => return Err(NotBuilt { name: "wgpu", feature: "train-wgpu" }),
        };
        Ok(Self { threads, device })
    }
}
