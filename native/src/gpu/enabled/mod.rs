//! What forecasts on a graphics card where this program was built with them.

mod arena;
mod arithmetic;
mod ddqn;
mod device;
mod forecaster;
mod pool;
mod probe;
mod td3;
#[cfg(test)]
mod tests;
mod tight;
mod transfer;
mod worker;

use std::sync::Arc;
use std::time::Duration;

use mcvl_core::agent::ddqn::Ddqn;
use mcvl_core::agent::td3::Td3;
use mcvl_core::config::Config;
use mcvl_core::env::reacher::Reacher;
use mcvl_core::env::trap::Trapped;
use mcvl_core::env::{BuiltIn as _, Discrete, Environment};
use mcvl_core::forecast::Forecaster;
use mcvl_core::run::Run;

use device::Device;
pub use device::adapters;
use forecaster::{GpuForecaster, OnDevice};
pub use probe::peak;
use worker::Desk;

use super::{AdapterInfo, GpuError};
use crate::mujoco::Mujoco;

/// A device that forecasts, with the thread that owns it. Copies share both; the thread ends with the last copy
/// and the last equipped run.
#[derive(Clone, Debug)]
pub struct Gpu {
    desk: Arc<Desk>,
}

/// The place of one run at a device.
#[derive(Clone, Debug)]
pub struct Seat(Arc<worker::Waiting>);

impl Gpu {
    /// Opens the adapter whose name contains `adapter`, or the most powerful one, and starts its thread.
    ///
    /// # Errors
    /// If there is no such adapter, or it gives no device.
    pub fn open(adapter: Option<&str>) -> Result<Self, GpuError> {
        Ok(Self { desk: Desk::open(Device::open(adapter)?) })
    }

    /// The adapter.
    pub fn adapter(&self) -> &AdapterInfo {
        self.desk.adapter()
    }

    /// Whether a run of this configuration can forecast there.
    ///
    /// # Errors
    /// Why not.
    pub fn supports(&self, config: &Config) -> Result<(), String> {
        if config.practice {
            return Err("its forecasts practise in copies of the world".to_owned());
        }
        if config.env == <Reacher>::NAME { td3::supports(config) } else { ddqn::supports(config) }
    }

    /// Whether the futures of a run of this configuration are the processor's to the bit: where the device rounds as a
    /// processor does, or can be made to, those of DDQN learners are.
    pub fn is_exact(&self, config: &Config) -> bool {
        self.desk.arithmetic().exact && config.env != <Reacher>::NAME
    }

    /// Lets a run forecast there from here on; `None`, with nothing changed, if [`Gpu::supports`] does not.
    pub fn equip(&self, run: &mut Run) -> Option<Seat> {
        self.supports(run.config()).ok()?;
        let waiting = Arc::new(worker::Waiting::default());
        let taken = self.seat::<Trapped, Ddqn>(run, &waiting)
            || self.seat::<Reacher, Td3<2>>(run, &waiting)
            || self.seat::<Reacher<Mujoco>, Td3<2>>(run, &waiting);
        taken.then_some(Seat(waiting))
    }

    /// Whether the run is of this world and learner; it forecasts there then.
    fn seat<E, A>(&self, run: &mut Run, waiting: &Arc<worker::Waiting>) -> bool
    where
        E: Environment<Action = A::Action> + 'static,
        A: OnDevice + 'static,
        GpuForecaster<A>: Send,
    {
        let forecaster = GpuForecaster::<A>::new(self.desk.clone(), waiting.clone());
        run.forecast_with::<E, A>(Box::new(forecaster)).is_ok()
    }

    /// A forecaster of DDQN learners, for whoever has a trainer of their own.
    pub fn ddqn<E: Environment<Action = Discrete> + 'static>(&self) -> Box<dyn Forecaster<E, Ddqn> + Send> {
        Box::new(GpuForecaster::<Ddqn>::new(self.desk.clone(), Arc::default()))
    }

    /// Waits until something was finished, or for this long.
    pub fn wait(&self, time: Duration) {
        self.desk.wait(time);
    }
}

impl Seat {
    /// Whether the run can do nothing but wait.
    pub fn waits(&self) -> bool {
        self.0.now()
    }
}
