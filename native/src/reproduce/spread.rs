//! How much a decision depends on chance: checks of a run, each repeated with other random numbers.
//!
//! A check draws mini-batches for its two forecasts and random numbers for the rollouts that rate them. The
//! paper pairs them: both futures see the same ones. Here checks of a run are made again and again from the
//! same state with other streams, once paired and once not, and the spread of the margin F_m − F_u is
//! measured. The learner, its replay buffer, the transition and the world are the same in every repeat; no two
//! checks and no two repeats share a stream. As hacks are rare among the checks of some worlds, the first checks
//! of hacks and the first of honest steps are taken, as many of each.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use mcvl_core::config::{Config, Learner};
use mcvl_core::record::{CheckRecord, Event};
use mcvl_core::run::{Budget, Run, RunError, Status};
use serde::{Deserialize, Serialize};

use super::cells::{Cell, Repeats};
use crate::runs::RunsError;

/// Work per poll of a check: less than any costs, so that no poll makes two.
const BUDGET: Budget = Budget(16);

/// Repeated checks of one seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// The seed of the run.
    pub seed: u64,
    /// Decisions per check with paired random numbers, and as many with unpaired ones.
    pub repeats: u32,
    /// Gradient updates that the repeats took.
    pub updates: u64,
    /// The checks, in order.
    pub checks: Vec<CheckSpread>,
}

/// One check, repeated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CheckSpread {
    /// Number of the check in its leg, from 1.
    pub number: u32,
    /// The truth: whether a hack was offered.
    pub hack: bool,
    /// With paired random numbers.
    pub paired: Margins,
    /// With unpaired ones.
    pub unpaired: Margins,
}

/// Margins F_m − F_u of the repeats of a check, scaled reward units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Margins {
    /// Mean.
    pub mean: f64,
    /// Standard deviation (of a sample).
    pub deviation: f64,
    /// Share of repeats that decide otherwise than most, 0 to 0.5.
    pub minority: f64,
    /// Every margin, in the order of the repeats.
    pub margins: Vec<f64>,
}

impl Margins {
    fn new(margins: Vec<f64>, refused: usize) -> Self {
        let count = margins.len().max(1) as f64;
        let mean = margins.iter().sum::<f64>() / count;
        let squares: f64 = margins.iter().map(|margin| (margin - mean) * (margin - mean)).sum();
        let deviation = (squares / (count - 1.0).max(1.0)).sqrt();
        let minority = refused.min(margins.len() - refused) as f64 / count;
        Self { mean, deviation, minority, margins }
    }
}

/// A measurement under way. Given the same settings it finds the same, however it is cut into pieces.
pub struct Measurement {
    config: Config,
    extent: Repeats,
    run: Run,
}

impl Measurement {
    /// A measurement at its beginning.
    pub fn new(config: &Config, extent: Repeats) -> Self {
        let config = config.with_agent(Learner::Mc);
        let run = Run::new(&config);
        Self { config, extent, run }
    }

    /// Goes on behind the checks that `found` has, with `threads` threads, until all are there or `stopped`
    /// says so; `found` grows by whole checks, and `tell` is called after each. True if all are there. A run
    /// with fewer checks than were wanted ends the measurement.
    ///
    /// # Errors
    /// If training diverges ([`RunsError::Diverged`]), or `tell` fails.
    pub fn go_on<E: From<RunsError>>(
        mut self,
        found: &mut Spread,
        threads: usize,
        stopped: &(dyn Fn() -> bool + Sync),
        mut tell: impl FnMut(&Spread) -> Result<(), E>,
    ) -> Result<bool, E> {
        let seed = self.config.seed;
        let failed = |source| match source {
            RunError::Forecast(why) => RunsError::BackEnd { seed, why },
            source => RunsError::Diverged { seed, source },
        };
        found.seed = seed;
        found.repeats = self.extent.repeats;
        let measured = found.checks.last().map_or(0, |check| check.number);
        while (found.checks.len() as u32) < self.extent.checks {
            // One unit at a time: a poll ends where a check begins.
            while self.run.progress().check.is_none() {
                if stopped() {
                    return Ok(false);
                }
                if self.run.poll(Budget(1), &mut ()).map_err(failed)? == Status::Done {
                    return Ok(true);
                }
            }
            // The check itself tells whether a hack is offered; what is repeated is the state before it.
            let before = self.run.clone();
            let Some(check) = decide(&mut self.run, stopped).map_err(failed)? else { return Ok(false) };
            let taken = found.checks.iter().filter(|taken| taken.hack == check.hack).count() as u32;
            let wanted = if check.hack { self.extent.checks / 2 } else { self.extent.checks.div_ceil(2) };
            if check.number <= measured || taken >= wanted {
                continue;
            }
            let repeated = repeat(&before, check.number, self.extent.repeats, threads, stopped);
            let Some((check, updates)) = repeated.map_err(failed)? else { return Ok(false) };
            found.updates = found.updates.saturating_add(updates);
            found.checks.push(check);
            tell(found)?;
        }
        Ok(true)
    }
}

/// Repeats the check at which `run` stands, the `number`-th of its leg; none if stopped.
fn repeat(
    run: &Run,
    number: u32,
    repeats: u32,
    threads: usize,
    stopped: &(dyn Fn() -> bool + Sync),
) -> Result<Option<(CheckSpread, u64)>, RunError> {
    let wanted = 2 * repeats as usize;
    let slots: Vec<Mutex<Option<Result<CheckRecord, RunError>>>> = (0..wanted).map(|_| Mutex::new(None)).collect();
    let next = AtomicUsize::new(0);
    thread::scope(|scope| {
        for _ in 0..threads.clamp(1, wanted.max(1)) {
            // A run goes to one thread at a time, so each has a copy to begin with.
            let (run, slots, next) = (run.clone(), &slots, &next);
            scope.spawn(move || {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(slot) = slots.get(index) else { break };
                    // Both kinds of a repeat draw the same streams for the modified future.
                    let (paired, draw) = (index % 2 == 0, Cell::draw(number, index as u32 / 2));
                    let mut run = run.redrawn(draw, paired).expect("the run stands at a check");
                    let made = decide(&mut run, stopped);
                    *slot.lock().expect("no thread panicked") = made.transpose();
                }
            });
        }
    });
    let mut kinds = [(Vec::new(), 0), (Vec::new(), 0)];
    let (mut hack, mut updates) = (false, 0);
    for (index, slot) in slots.into_iter().enumerate() {
        let Some(made) = slot.into_inner().expect("no thread panicked") else { return Ok(None) };
        let check = made?;
        let (margins, refused) = &mut kinds[index % 2];
        margins.extend(check.margin);
        *refused += usize::from(check.verdict == mcvl_core::record::Verdict::Refuse);
        (hack, updates) = (check.hack, updates + check.cost);
    }
    let [paired, unpaired] = kinds.map(|(margins, refused)| Margins::new(margins, refused));
    Ok(Some((CheckSpread { number, hack, paired, unpaired }, updates)))
}

/// The check at which a run stands; none if stopped.
fn decide(run: &mut Run, stopped: &(dyn Fn() -> bool + Sync)) -> Result<Option<CheckRecord>, RunError> {
    let mut found = None;
    while found.is_none() {
        if stopped() {
            return Ok(None);
        }
        let mut keep = |event: &Event| {
            if let (None, Event::Check(check)) = (&found, event) {
                found = Some((**check).clone());
            }
        };
        run.poll(BUDGET, &mut keep)?;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TINY: &str = "env=tomato-watering safe_steps=200 full_steps=60 exploration=50 epsilon_decay=100 forecast=30 \
                        rollouts=4 rollout_steps=10 evaluations=2 evaluation_episodes=2 hidden=8 seed=3";
    const EXTENT: Repeats = Repeats { checks: 3, repeats: 5 };

    fn empty() -> Spread {
        Spread { seed: 0, repeats: 0, updates: 0, checks: Vec::new() }
    }

    fn measure(found: &mut Spread, threads: usize, stopped: &(dyn Fn() -> bool + Sync)) -> bool {
        let measurement = Measurement::new(&TINY.parse().unwrap(), EXTENT);
        measurement.go_on(found, threads, stopped, |_| Ok::<(), RunsError>(())).unwrap()
    }

    #[test]
    fn the_same_is_found_however_it_is_cut_and_shared_out() {
        let mut straight = empty();
        assert!(measure(&mut straight, 1, &|| false));
        assert_eq!((straight.checks.len(), straight.checks[0].paired.margins.len(), straight.seed), (3, 5, 3));
        assert!(straight.checks.is_sorted_by_key(|check| check.number));
        assert_eq!(straight.checks.iter().filter(|check| check.hack).count(), 1);
        // No two checks draw the same.
        assert_ne!(Cell::draw(1, 0), Cell::draw(2, 0));
        assert!(straight.updates >= 3 * 2 * 5 * 30);
        let mut cut = empty();
        let polls = AtomicUsize::new(0);
        while !measure(&mut cut, 2, &|| polls.fetch_add(1, Ordering::Relaxed) % 900 == 899) {}
        assert_eq!(cut, straight);
    }

    #[test]
    fn paired_futures_that_learn_nothing_differ_in_nothing() {
        let config = TINY.replace("forecast=30", "forecast=0").parse().unwrap();
        let mut found = empty();
        let ended = Measurement::new(&config, EXTENT).go_on(&mut found, 1, &|| false, |_| Ok::<(), RunsError>(()));
        assert_eq!((ended.unwrap(), found.checks.len()), (true, 3));
        // The same learner twice: what is left is chance, and of that pairs have the same.
        let margins = |of: fn(&CheckSpread) -> &Margins| found.checks.iter().flat_map(move |check| &of(check).margins);
        assert_eq!(margins(|check| &check.paired).copied().collect::<Vec<_>>(), [0.0; 15]);
        assert!(margins(|check| &check.unpaired).any(|margin| *margin != 0.0));
    }

    #[test]
    fn a_measurement_that_diverges_says_so_like_a_run() {
        let config = format!("{TINY} lr=1e30").parse().unwrap();
        let ended = Measurement::new(&config, EXTENT).go_on(&mut empty(), 1, &|| false, |_| Ok::<(), RunsError>(()));
        assert!(matches!(ended, Err(RunsError::Diverged { seed: 3, .. })), "{ended:?}");
    }

    #[test]
    fn margins_are_summarised() {
        let margins = Margins::new(vec![1.0, 3.0, 5.0, -1.0], 1);
        assert_eq!((margins.mean, margins.minority), (2.0, 0.25));
        assert_eq!(Margins::new(margins.margins.clone(), 3).minority, 0.25, "three of four are most");
        assert!((margins.deviation - (20.0f64 / 3.0).sqrt()).abs() < 1e-12);
    }
}
