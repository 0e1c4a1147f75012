//! Tidy tables: one file per kind of record, one row per record, the seed in the first column.
//!
//! Numbers are printed with the fewest digits that read back exactly; no cell needs quotes. What the
//! columns mean is told in `docs/export.md`.

use std::fmt::Write as _;

use mcvl_core::record::{CheckRecord, FutureRecord, Subject, Verdict};

use super::File;
use crate::runs::{SeedRun, end_name};

/// The tables of some seeds.
pub fn csv(seeds: &[&SeedRun]) -> Vec<File> {
    vec![
        table(
            seeds,
            "evaluations.csv",
            "arm,step,return,performance,length",
            |seed| &seed.evaluations,
            |point| {
                let (arm, step) = (point.arm.name(), point.step);
                format!("{arm},{step},{},{},{}", point.observed_return, point.performance, point.length)
            },
        ),
        table(
            seeds,
            "learner.csv",
            "arm,step,updates,epsilon,replay,value_loss,reward_loss,dead_units",
            |seed| &seed.learner,
            |state| {
                let (arm, step, updates) = (state.arm.name(), state.step, state.updates);
                let losses = format!("{},{}", state.value_loss, state.reward_loss);
                format!("{arm},{step},{updates},{},{},{losses},{}", state.epsilon, state.replay, state.dead_units)
            },
        ),
        table(
            seeds,
            "episodes.csv",
            "arm,step,return,performance,length,cut",
            |seed| &seed.episodes,
            |episode| {
                let (arm, step) = (episode.arm.name(), episode.step);
                let sums = format!("{},{}", episode.observed_return, episode.performance);
                format!("{arm},{step},{sums},{},{}", episode.length, episode.cut)
            },
        ),
        table(seeds, "checks.csv", CHECK_COLUMNS, |seed| &seed.checks, check),
    ]
}

fn table<T>(
    seeds: &[&SeedRun],
    name: &str,
    columns: &str,
    records: fn(&SeedRun) -> &[T],
    row: fn(&T) -> String,
) -> File {
    let mut text = format!("seed,{columns}\n");
    for seed in seeds {
        for record in records(seed) {
            let _ = writeln!(text, "{},{}", seed.seed, row(record));
        }
    }
    File::new(name, text)
}

/// Everything of a check but its pictures. What a scheme does not have is empty: a discard has no futures.
const CHECK_COLUMNS: &str = "arm,check,step,updates,action,end,reward_raw,reward,predicted,threshold,\
                             subject,utility_with,utility_without,margin,verdict,replaced,tie,cost,reused,performance,\
                             performance_with,performance_without,hack,wrong";

fn check(check: &CheckRecord) -> String {
    let verdict = match check.verdict {
        Verdict::Accept => "accept",
        Verdict::Refuse => "refuse",
    };
    let subject = match check.subject {
        Subject::Transition => "transition",
        Subject::Update => "update",
    };
    let text = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    let utility = |future: &Option<FutureRecord>| text(future.as_ref().map(|future| future.utility));
    let performance = |future: &Option<FutureRecord>| text(future.as_ref().map(|future| future.performance));
    let cells: [&dyn std::fmt::Display; 24] = [
        &check.arm.name(),
        &check.number,
        &check.step,
        &check.updates,
        &check.action,
        &end_name(check.end),
        &check.reward_raw,
        &check.reward,
        &check.predicted,
        &check.threshold,
        &subject,
        &utility(&check.modified),
        &utility(&check.unmodified),
        &text(check.margin),
        &verdict,
        &check.replaced.map_or(String::new(), |reward| reward.to_string()),
        &check.tie,
        &check.cost,
        &check.reused,
        &check.performance,
        &performance(&check.modified),
        &performance(&check.unmodified),
        &check.hack,
        &check.wrong(),
    ];
    cells.map(ToString::to_string).join(",")
}
