//! The metrics an expression can name, and where each value comes from.

use mcvl_core::config::nearest;
use mcvl_core::record::Arm;

use crate::report::claims::SeedEnd;
use crate::report::statistics::{Estimate, Verdicts};

/// One metric of a leg.
pub struct Metric {
    /// Name after the leg's: `performance.low` of `mc.performance.low`.
    pub name: &'static str,
    /// Meaning, with unit.
    pub help: &'static str,
    pub(super) source: Source,
}

/// Where a metric's value comes from.
#[derive(Clone, Copy)]
pub(super) enum Source {
    /// A value of every seed; over seeds its mean.
    Seed(fn(&SeedEnd) -> Option<f64>),
    /// A number about all seeds together.
    Return(fn(&Estimate) -> f64),
    /// Likewise, of performance.
    Performance(fn(&Estimate) -> f64),
    /// A count of decisions: per seed, and its mean over seeds (legs with checks only).
    Count(fn(&Verdicts) -> u64),
    /// A rate of decisions: of one seed, or of the decisions of all seeds together.
    Rate(fn(&Verdicts) -> Option<f64>),
}

/// Every metric; each is written after the name of a leg, like `safe.`, `baseline.` or `mc.`.
pub static METRICS: &[Metric] = &[
    Metric {
        name: "return",
        help: "observed return at the end, raw",
        source: Source::Seed(|end| Some(end.observed_return)),
    },
    Metric {
        name: "return.low",
        help: "lower end of its 95 % interval over seeds",
        source: Source::Return(|value| value.low),
    },
    Metric { name: "return.high", help: "upper end of that interval", source: Source::Return(|value| value.high) },
    Metric { name: "return.iqm", help: "its interquartile mean over seeds", source: Source::Return(|value| value.iqm) },
    Metric {
        name: "return.first",
        help: "observed return before the first step (at the switch)",
        source: Source::Seed(|end| end.first_return),
    },
    Metric {
        name: "performance",
        help: "performance at the end, raw",
        source: Source::Seed(|end| Some(end.performance)),
    },
    Metric {
        name: "performance.low",
        help: "lower end of its 95 % interval over seeds",
        source: Source::Performance(|value| value.low),
    },
    Metric {
        name: "performance.high",
        help: "upper end of that interval",
        source: Source::Performance(|value| value.high),
    },
    Metric {
        name: "performance.iqm",
        help: "its interquartile mean over seeds",
        source: Source::Performance(|value| value.iqm),
    },
    Metric {
        name: "performance.first",
        help: "performance before the first step (at the switch)",
        source: Source::Seed(|end| end.first_performance),
    },
    Metric {
        name: "hacked",
        help: "1 for a seed that was hacked, 0 for others",
        source: Source::Seed(|end| Some(f64::from(u8::from(end.hacked())))),
    },
    Metric { name: "checks", help: "checks per seed", source: Source::Count(|counts| counts.checks) },
    Metric { name: "refusals", help: "refusals per seed", source: Source::Count(|counts| counts.refusals) },
    Metric { name: "ties", help: "exact ties per seed", source: Source::Count(|counts| counts.ties) },
    Metric { name: "wrong", help: "wrong decisions per seed", source: Source::Count(Verdicts::wrong) },
    Metric { name: "missed", help: "hacks accepted per seed", source: Source::Count(|counts| counts.hacks_accepted) },
    Metric {
        name: "cost",
        help: "gradient updates in forecasts per seed",
        source: Source::Count(|counts| counts.cost),
    },
    Metric {
        name: "precision",
        help: "share of refusals that were hacks, 0 to 1",
        source: Source::Rate(Verdicts::precision),
    },
    Metric {
        name: "recall",
        help: "share of checked hacks that were refused, 0 to 1",
        source: Source::Rate(Verdicts::recall),
    },
    Metric {
        name: "unchecked",
        help: "share of hacks that were never checked, 0 to 1",
        source: Source::Rate(Verdicts::unchecked),
    },
    Metric { name: "rate", help: "checks per environment step, 0 to 1", source: Source::Rate(Verdicts::rate) },
];

/// The name of a leg in expressions, where `-` is subtraction.
fn leg(arm: Arm) -> String {
    arm.name().replace('-', "_")
}

/// The leg and metric of a name like `mc.return`.
pub(super) fn find(word: &str) -> Option<(Arm, &'static Metric)> {
    let (arm, name) = word.split_once('.')?;
    let arm = Arm::ALL.into_iter().find(|candidate| leg(*candidate) == arm)?;
    let metric = METRICS.iter().find(|metric| metric.name == name)?;
    Some((arm, metric))
}

/// What to say of a name that is no metric.
pub(super) fn unknown(word: &str) -> String {
    let all: Vec<String> =
        Arm::ALL.iter().flat_map(|arm| METRICS.iter().map(|metric| format!("{}.{}", leg(*arm), metric.name))).collect();
    let names: Vec<&str> = all.iter().map(String::as_str).collect();
    let hint = nearest(word, &names).map_or(String::new(), |name| format!(", did you mean `{name}`?"));
    let known: Vec<&str> = METRICS.iter().map(|metric| metric.name).collect();
    let legs: Vec<String> = Arm::ALL.iter().map(|arm| format!("{}.", leg(*arm))).collect();
    format!("unknown metric `{word}`{hint}; known are {} followed by {}", legs.join(", "), known.join(", "))
}
