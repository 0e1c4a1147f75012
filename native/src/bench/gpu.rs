//! How fast a graphics card forecasts.

use std::hint::black_box;
use std::task::Poll;
use std::thread;
use std::time::{Duration, Instant};

use mcvl_core::agent::ddqn::Ddqn;
use mcvl_core::env::trap::Trapped;
use mcvl_core::forecast::{Carry, ForecastJob};
use mcvl_core::run::Budget;
use serde::Serialize;

use super::{Bench, Case, FORECASTS};
use crate::gpu::Gpu;

/// Forecasts that are under way at once.
pub const JOBS: [u32; 4] = [1, 20, 200, 2_000];
/// Updates of a forecast in a measurement: few enough for a slow device, and no more than the paper's.
const UPDATES: std::ops::RangeInclusive<u32> = 8..=5_000;

/// What was measured for one number of jobs.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Throughput {
    /// Forecasts under way at once.
    pub jobs: u32,
    /// Updates of each.
    pub updates: u32,
    /// Updates per second of all together, with what it takes to bring them there and back.
    pub updates_per_second: f64,
}

impl Bench<Trapped, Ddqn> {
    /// Forecasts on a card: `jobs` at once, half of them with the surprise, as in checks; for about this time, if the
    /// device makes `expected` updates per second. `None` if even a short measurement would take twenty times as long.
    ///
    /// # Errors
    /// If the device fails.
    pub fn forecasts_on(
        &self,
        gpu: &Gpu,
        jobs: u32,
        time: Duration,
        expected: f64,
    ) -> Result<Option<Throughput>, String> {
        let wanted = (expected * time.as_secs_f64() / f64::from(jobs)) as u32;
        let updates = wanted.clamp(*UPDATES.start(), *UPDATES.end());
        if f64::from(updates) * f64::from(jobs) > 20.0 * expected * time.as_secs_f64().max(0.1) {
            return Ok(None);
        }
        let forced = std::slice::from_ref(&self.surprise);
        let job = |number: u32| ForecastJob::<Trapped, Ddqn> {
            agent: &self.agent,
            replay: &self.replay,
            forced: if number.is_multiple_of(2) { forced } else { &[] },
            updates,
            batch: self.config.batch,
            // Every check has draws of its own.
            seed: u64::from(number / 2),
            carry: Carry::ALL,
            version: 0,
            practice: None,
        };
        let all: Vec<_> = (0..jobs).map(job).collect();
        let checks: Vec<&[ForecastJob<'_, Trapped, Ddqn>]> = all.chunks(2).collect();
        let start = Instant::now();
        let mut forecasters: Vec<_> = checks.iter().map(|_| Some(gpu.ddqn::<Trapped>())).collect();
        while forecasters.iter().any(Option::is_some) {
            for (slot, jobs) in forecasters.iter_mut().zip(&checks) {
                let Some(forecaster) = slot else { continue };
                if let Poll::Ready(result) = forecaster.poll(jobs, &mut Budget(1)) {
                    black_box(result.map_err(|error| error.to_string())?);
                    *slot = None;
                }
            }
            thread::yield_now();
            gpu.wait(Duration::from_millis(1));
        }
        let rate = f64::from(jobs) * f64::from(updates) / start.elapsed().as_secs_f64();
        Ok(Some(Throughput { jobs, updates, updates_per_second: rate }))
    }

    /// Updates per second in forecasts of the processor, on so many cores together.
    pub fn forecast_updates(&self, cores: usize, time: Duration) -> f64 {
        let [updates, ..] = FORECASTS;
        let case = Case { name: String::new(), work: None, worker: Box::new(|| self.forecast(updates)) };
        f64::from(updates) * case.rates(cores, time).all
    }

    /// Multiply-adds of an update in a forecast, by the dense definition.
    pub fn forecast_work(&self) -> u64 {
        self.agent.update_work(self.config.batch + 1)
    }

    /// Bytes that an update moves by the dense definition: parameters, target and moments of all inputs are read and
    /// written once. Inputs that are never one do not go to the card.
    pub fn forecast_bytes(&self) -> u64 {
        8 * 4 * self.agent.online().params().len() as u64
    }

    /// Updates of a check.
    pub fn check_updates(&self) -> u32 {
        2 * self.config.forecast
    }
}
