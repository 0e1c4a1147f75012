//! Forecasts on a graphics card, through wgpu (the cargo feature `gpu`). Without the feature everything here has
//! the same face, and the errors say how to get it.
//!
//! Runs are trained on the processor as ever; only the futures of their checks go to the card. A [`Gpu`] has one
//! thread that owns the device. Runs that were [equipped](Gpu::equip) hand it their jobs and are told to wait; the
//! thread trains the networks of all of them at once, in slices short enough for any driver's watchdog.
//!
//! Jobs and their random numbers are the processor's to the bit. So are the futures of DDQN learners on devices whose
//! arithmetic can be made to round as a processor does ([`Gpu::is_exact`]; found out when the device is opened).
//! Elsewhere a card is an arithmetic of its own: it may fuse multiply-adds and divides within an ulp or two. What a
//! device cannot do ([`Gpu::supports`]) stays on the processor.

#[cfg(any(test, not(feature = "gpu")))]
mod disabled;
#[cfg(feature = "gpu")]
mod enabled;

use std::fmt;

#[cfg(not(feature = "gpu"))]
pub use disabled::{Gpu, Seat, adapters, peak};
#[cfg(feature = "gpu")]
pub use enabled::{Gpu, Seat, adapters, peak};

/// Why a graphics card does not forecast.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum GpuError {
    /// This program was built without it.
    Disabled,
    /// No adapter of this machine has what was asked for, or there is none.
    NoAdapter {
        /// Part of the name that was asked for.
        wanted: Option<String>,
        /// Names of the adapters there are.
        found: Vec<String>,
    },
    /// The adapter gives no device.
    NoDevice(String),
    /// The device is gone or does not answer.
    Lost(String),
    /// The device ran out of memory.
    Memory(String),
    /// One forecast alone is more than the device can do.
    TooLarge(String),
}

impl fmt::Display for GpuError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Disabled => f.write_str(
                "this program was built without graphics cards: build with `--features gpu`, or take --backend cpu",
            ),
            Self::NoAdapter { wanted: Some(wanted), found } if !found.is_empty() => {
                write!(f, "no adapter has `{wanted}` in its name; there are: {}", found.join(", "))
            }
            Self::NoAdapter { .. } => f.write_str(
                "this machine has no adapter that wgpu can use: install the driver of the card (for Vulkan on Linux \
                 also the loader libvulkan; without a card mesa-vulkan-drivers computes on the processor), or take \
                 --backend cpu",
            ),
            Self::NoDevice(why) => write!(f, "the adapter gives no device: {why}; or take --backend cpu"),
            Self::Lost(why) => write!(
                f,
                "the device does not answer: {why}. What was saved is intact: go on with --resume, or on the \
                 processor with --resume --backend cpu"
            ),
            Self::Memory(why) => write!(
                f,
                "the device has not enough memory: {why}. What was saved is intact: go on with --resume and fewer seeds \
                 at a time, or with --resume --backend cpu"
            ),
            Self::TooLarge(why) => write!(
                f,
                "a forecast is too large for the device: {why}. What was saved is intact: go on with --resume --backend \
                 cpu"
            ),
        }
    }
}

impl std::error::Error for GpuError {}

/// An adapter of this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterInfo {
    /// Name of the card, or of the software that stands in for one.
    pub name: String,
    /// Interface and driver, like `Vulkan, NVIDIA 570.1`.
    pub driver: String,
    /// True where it is the processor that computes.
    pub software: bool,
}

impl fmt::Display for AdapterInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.software { ", on the processor" } else { "" };
        write!(f, "{} ({}{kind})", self.name, self.driver)
    }
}

/// What a device can do at most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Multiply-adds per second, fused where its compiler does so.
    pub multiply_adds: f64,
    /// Bytes read and written per second within its memory.
    pub bytes_moved: f64,
}
