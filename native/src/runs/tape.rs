//! A tape: one seed of a run as one JSON file, whole enough for the page to play it.

use std::fs;

use mcvl_core::config::Learner;
use mcvl_core::env::EnvSpec;
use mcvl_core::record::{Arm, EvaluationRecord, StartRecord};
use serde::Serialize;
use serde_json::value::RawValue;

use super::read::check_tape;
use super::{Reader, RunsError};
use crate::worlds;

/// First field of every tape.
pub const TAPE_FORMAT: &str = "mcvl tape";
/// Version of the format.
pub const TAPE_VERSION: u32 = 1;

#[derive(Serialize)]
struct Tape<'a> {
    format: &'a str,
    version: u32,
    /// Canonical text of the run of the modification-considering learner: the same text re-derives it.
    configuration: String,
    world: &'a EnvSpec,
    /// Returns of its episodes count as equal within this much, raw.
    tolerance: f64,
    legs: Vec<StartRecord>,
    /// Gradient updates of all legs and forecasts together until the last of its checks was decided: what deriving them
    /// again costs.
    updates: u64,
    evaluations: &'a [EvaluationRecord],
    /// Checks with their films, as they stand in the files of the run.
    checks: Vec<Box<RawValue>>,
}

/// The tape of a seed as JSON text, with the checks of which `wanted` says so. An unfinished run gives
/// what it has so far.
///
/// # Errors
/// If a file of the seed cannot be read, or is not what was written.
pub fn run_tape(run: &Reader, seed: u64, wanted: &dyn Fn(u32) -> bool) -> Result<String, RunsError> {
    let (plan, dir) = (run.plan(), run.run().seed(seed));
    // The ledger first: of a run under way, the checks are then at least those of its lines.
    let ledger = run.ledger(&dir)?;
    let read = run.seed(&dir)?;
    let config = plan.config.with_seed(seed).with_agent(Learner::Mc);
    let mut checks = Vec::new();
    for (number, line) in (1..).zip(ledger) {
        if !wanted(number) {
            continue;
        }
        check_tape(&dir, number, &line)?;
        let path = dir.tape(number);
        let text = fs::read_to_string(&path).map_err(RunsError::io("read", &path))?;
        let raw = RawValue::from_string(text);
        checks.push(raw.map_err(|error| RunsError::damaged(&path, format!("is no tape: {error}")))?);
    }
    let world = worlds::spec(&config);
    let leg =
        |arm: Arm| StartRecord { arm, steps: if arm == Arm::Safe { config.safe_steps } else { config.full_steps } };
    // All legs go on side by side from the switch.
    let decided = &read.checks[..read.checks.iter().rposition(|check| wanted(check.number)).map_or(0, |last| last + 1)];
    let learned = decided.last().map_or(0, |last| {
        let safe = read.learner.iter().rev().find(|point| point.arm == Arm::Safe).map_or(0, |point| point.updates);
        safe + plan.learners.len() as u64 * last.updates.saturating_sub(safe)
    });
    let forecast: u64 = decided.iter().map(|check| check.cost).sum();
    let tape = Tape {
        format: TAPE_FORMAT,
        version: TAPE_VERSION,
        world: &world,
        legs: [Arm::Safe].into_iter().chain(plan.learners.iter().map(|agent| Arm::of(*agent))).map(leg).collect(),
        configuration: config.to_string(),
        updates: learned + forecast,
        tolerance: config.experiment().tolerance,
        evaluations: &read.evaluations,
        checks,
    };
    Ok(serde_json::to_string(&tape).expect("a tape is plain data"))
}
