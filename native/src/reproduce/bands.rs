//! What the page shows behind the curves of a run: ten recorded seeds of every scheme and baseline.

use std::collections::BTreeMap;

use mcvl_core::record::Arm;
use serde::Serialize;

use super::record::Record;
use super::table;

/// What the page names: a cell, one of its legs, and its title.
const ENTRIES: &[(&str, Arm, &str)] = &[
    ("box", Arm::Mc, "Check what surprises"),
    ("box-all", Arm::Mc, "Check everything"),
    ("box-discard", Arm::Mc, "Discard what surprises"),
    ("box-each-step", Arm::Mc, "Check every update"),
    ("box-punish", Arm::Mc, "Store refused steps as \u{2212}2"),
    ("box-store-predicted", Arm::Mc, "Store the predicted reward"),
    ("box", Arm::Baseline, "No check: ordinary learner"),
    ("box-baselines", Arm::Oracle, "Oracle, paid the performance"),
    ("box-baselines", Arm::FrozenReward, "Frozen reward model, no check"),
    ("box-baselines", Arm::Frozen, "Frozen policy"),
    ("absent", Arm::Mc, "Check what surprises"),
    ("absent-alive", Arm::Mc, "Check what surprises, reward model alive"),
    ("absent", Arm::Baseline, "No check: ordinary learner"),
    ("tomato", Arm::Mc, "Check what surprises"),
    ("tomato-alive", Arm::Mc, "Check what surprises, reward model alive"),
    ("tomato", Arm::Baseline, "No check: ordinary learner"),
    ("rocks", Arm::Mc, "Check what surprises"),
    ("rocks-alive", Arm::Mc, "Check what surprises, reward model alive"),
    ("rocks", Arm::Baseline, "No check: ordinary learner"),
    ("reacher-small", Arm::Mc, "Check what surprises"),
    ("reacher-small", Arm::Baseline, "No check: TD3"),
];

/// A leg over its seeds.
#[derive(Debug, Serialize)]
struct Entry<'a> {
    title: &'a str,
    seeds: usize,
    /// Return and performance at the end: means over seeds.
    mean: [f64; 2],
    /// Seeds that were hacked.
    hacked: usize,
    /// Checks per seed; none without checks.
    checks: Option<f64>,
    /// Steps of the evaluation points.
    steps: Vec<u32>,
    /// Ends of the 95 % intervals at those points.
    #[serde(rename = "return")]
    observed_return: Vec<[f64; 2]>,
    performance: Vec<[f64; 2]>,
}

/// The entries of every world that has some, as JSON: the world's name, and a list. A cell with some of its seeds is left
/// out: those that finish first are not like the others.
pub fn bands(records: &BTreeMap<String, Record>, quick: bool) -> String {
    let planned = |name: &str| table::cells().into_iter().find(|cell| cell.name == name).map(|cell| cell.seeds(quick));
    let mut worlds: BTreeMap<&str, Vec<Entry<'_>>> = BTreeMap::new();
    for (cell, arm, title) in ENTRIES {
        let Some(record) = records.get(*cell) else { continue };
        let whole = |seeds: Vec<u64>| seeds.iter().all(|seed| record.seeds().contains(seed));
        if !planned(cell).is_some_and(whole) {
            continue;
        }
        let world = record.config.split([' ', '=']).nth(1).unwrap_or_default();
        worlds.entry(world).or_default().extend(Entry::of(record, *arm, title));
    }
    serde_json::to_string(&worlds).expect("bands are plain data") + "\n"
}

/// Whether a text is what [`bands`] writes.
pub fn is_bands(text: &str) -> bool {
    let worlds: Result<BTreeMap<String, Vec<BTreeMap<String, serde_json::Value>>>, _> = serde_json::from_str(text);
    worlds.is_ok_and(|worlds| worlds.values().flatten().all(|entry| entry.contains_key("title")))
}

impl<'a> Entry<'a> {
    fn of(record: &Record, arm: Arm, title: &'a str) -> Option<Self> {
        let summary = record.summary.as_ref()?;
        let leg = summary.arm(arm)?;
        let curve = &record.arms.iter().find(|leg| leg.arm == arm)?.curve;
        let verdicts = summary.verdicts.filter(|_| arm == Arm::Mc);
        Some(Self {
            title,
            seeds: leg.seeds.len(),
            mean: [leg.observed_return.mean, leg.performance.mean].map(rounded),
            hacked: leg.hacked(),
            checks: verdicts.map(|verdicts| rounded(verdicts.checks as f64 / leg.seeds.len().max(1) as f64)),
            steps: curve.iter().map(|point| point.step).collect(),
            observed_return: curve.iter().map(|point| ends(point.observed_return)).collect(),
            performance: curve.iter().map(|point| ends(point.performance)).collect(),
        })
    }
}

/// An interval without its mean.
fn ends([_, low, high]: [f64; 3]) -> [f64; 2] {
    [rounded(low), rounded(high)]
}

/// A drawing needs no more than a decimal.
fn rounded(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::samples;
    use crate::runs::Manifest;

    #[test]
    fn every_entry_is_a_leg_of_a_cell() {
        for (name, arm, _) in ENTRIES {
            let cell = table::cells().into_iter().find(|cell| cell.name == *name).expect("a cell of the table");
            assert!(cell.learners.iter().any(|learner| Arm::of(*learner) == *arm), "{name} {arm:?}");
        }
    }

    #[test]
    fn a_cell_with_some_of_its_seeds_is_left_out() {
        let whole = Record::of_run("box", &samples::ten(), &Manifest::begin());
        let part = whole.only(&[0, 1, 2, 3]).unwrap();
        let of = |record: &Record, quick: bool| bands(&[("box".to_owned(), record.clone())].into(), quick);
        assert_eq!(of(&part, false), "{}\n");
        assert!(of(&whole, false).contains("\"seeds\":10") && of(&part, true).contains("\"seeds\":4"));
        assert!(is_bands(&of(&whole, false)) && is_bands("{}\n"));
        assert!(
            ["", "notes", "[1]", r#"{"a": 1}"#, r#"{"box-moving": [{"step": 1}]}"#].iter().all(|text| !is_bands(text))
        );
    }
}
