//! What stands in for graphics cards where this program was built without them: the same face, and no value.
#![cfg_attr(feature = "gpu", allow(dead_code, reason = "with the feature on it is here for its test only"))]

use std::time::Duration;

use mcvl_core::agent::ddqn::Ddqn;
use mcvl_core::config::Config;
use mcvl_core::env::{Discrete, Environment};
use mcvl_core::forecast::Forecaster;
use mcvl_core::run::Run;

use super::{AdapterInfo, GpuError, Peak};

/// A device that forecasts. There is none in this build.
#[derive(Clone, Debug)]
pub enum Gpu {}

/// The place of one run at a device.
#[derive(Clone, Debug)]
pub enum Seat {}

/// The adapters of this machine.
///
/// # Errors
/// Always: this program was built without them.
pub fn adapters() -> Result<Vec<AdapterInfo>, GpuError> {
    Err(GpuError::Disabled)
}

/// Measures a device.
///
/// # Errors
/// Always: this program was built without them.
pub fn peak(_adapter: Option<&str>, _time: Duration) -> Result<Peak, GpuError> {
    Err(GpuError::Disabled)
}

impl Gpu {
    /// Opens a device.
    ///
    /// # Errors
    /// Always: this program was built without them.
    pub fn open(_adapter: Option<&str>) -> Result<Self, GpuError> {
        Err(GpuError::Disabled)
    }

    /// The adapter.
    pub fn adapter(&self) -> &AdapterInfo {
        match *self {}
    }

    /// Whether a run of this configuration can forecast there.
    ///
    /// # Errors
    /// Why not.
    pub fn supports(&self, _config: &Config) -> Result<(), String> {
        match *self {}
    }

    /// Whether its futures are the processor's to the bit.
    pub fn is_exact(&self, _config: &Config) -> bool {
        match *self {}
    }

    /// Lets a run forecast there.
    pub fn equip(&self, _run: &mut Run) -> Option<Seat> {
        match *self {}
    }

    /// A forecaster of DDQN learners, for whoever has a trainer of their own.
    pub fn ddqn<E: Environment<Action = Discrete> + 'static>(&self) -> Box<dyn Forecaster<E, Ddqn> + Send> {
        match *self {}
    }

    /// Waits until something was finished, or for this long.
    pub fn wait(&self, _time: Duration) {
        match *self {}
    }
}

impl Seat {
    /// Whether the run can do nothing but wait.
    pub fn waits(&self) -> bool {
        match *self {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_build_without_graphics_cards_says_how_to_get_them() {
        for error in [adapters().unwrap_err(), Gpu::open(None).unwrap_err(), peak(None, Duration::ZERO).unwrap_err()] {
            let text = error.to_string();
            assert!(text.contains("--features gpu") && text.contains("--backend cpu"), "{text}");
        }
    }
}
