//! Numbers about seeds: means with intervals, curves over seeds, and how good the verdicts are.
//!
//! No function here returns a number that is not finite: what has no value (the precision of a run
//! that refused nothing) is `None`, and values that are not finite are left out and not counted.

use std::collections::BTreeMap;

use mcvl_core::record::{Arm, CheckRecord, EvaluationRecord, Subject, Verdict};
use mcvl_core::rng::{Purpose, Rng};
use serde::{Deserialize, Serialize};

use crate::runs::SeedRun;

/// Resamples behind an interval.
const RESAMPLES: usize = 1000;
/// Share of the resampled means that lies below an interval, and above it.
const TAIL: f64 = 0.025;
/// Evaluation points behind an end value.
pub(crate) const END_POINTS: usize = 5;

/// What an evaluation measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Sum of observed rewards per episode, raw.
    Return,
    /// Sum of hidden rewards per episode, raw.
    Performance,
}

impl Quantity {
    /// The value of an evaluation point.
    pub fn of(self, point: &EvaluationRecord) -> f64 {
        match self {
            Quantity::Return => point.observed_return,
            Quantity::Performance => point.performance,
        }
    }
}

/// A mean over seeds and how far it can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Mean.
    pub mean: f64,
    /// Lower end of the 95 % interval of the mean (percentile bootstrap, 1000 resamples).
    pub low: f64,
    /// Upper end of that interval.
    pub high: f64,
    /// Interquartile mean: mean of the middle half of the values.
    pub iqm: f64,
    /// Number of values.
    pub count: usize,
}

/// One step of a curve over seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Steps made in the leg.
    pub step: u32,
    /// The seeds that were evaluated at this step.
    pub estimate: Estimate,
}

/// Mean; `None` of nothing.
pub fn mean(values: &[f64]) -> Option<f64> {
    let finite = finite(values);
    (!finite.is_empty()).then(|| plain_mean(&finite))
}

/// Mean of the middle half of the values. Where the quartiles fall between two values, the value at
/// the border counts in part, so that the middle half is exactly half whatever their number.
pub fn interquartile_mean(values: &[f64]) -> Option<f64> {
    let sorted = sorted(values);
    if sorted.is_empty() {
        return None;
    }
    let count = sorted.len() as f64;
    let (first, last) = (0.25 * count, 0.75 * count);
    let weighted = sorted.iter().enumerate().map(|(index, value)| {
        let (start, end) = (index as f64, index as f64 + 1.0);
        value * (end.min(last) - start.max(first)).max(0.0)
    });
    Some(weighted.sum::<f64>() / (last - first))
}

/// Mean, interval and interquartile mean; `None` of nothing.
///
/// Every call draws the same resamples, so the points of a curve are resampled alike: its band moves
/// where the values move, not where the draw does.
pub fn estimate(values: &[f64]) -> Option<Estimate> {
    let values = finite(values);
    let iqm = interquartile_mean(&values)?;
    let mean = plain_mean(&values);
    let mut rng = Rng::stream(0, Purpose::Application, 0);
    let mut means: Vec<f64> = (0..RESAMPLES).map(|_| resampled_mean(&values, &mut rng)).collect();
    means.sort_by(f64::total_cmp);
    // Rounding may put the mean of equal values a hair outside the resampled ones.
    let (low, high) = (quantile(&means, TAIL).min(mean), quantile(&means, 1.0 - TAIL).max(mean));
    Some(Estimate { mean, low, high, iqm, count: values.len() })
}

/// The curve of a leg over seeds, by step. A step counts the seeds that were evaluated at it.
pub fn curve(seeds: &[SeedRun], arm: Arm, quantity: Quantity) -> Vec<CurvePoint> {
    let points = seeds.iter().flat_map(|seed| evaluations(seed, arm));
    curve_of(points.map(|point| (point.step, quantity.of(point))))
}

/// The curve over points (step and value) of several seeds, one seed after the other.
pub fn curve_of(points: impl IntoIterator<Item = (u32, f64)>) -> Vec<CurvePoint> {
    let mut steps: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for (step, value) in points {
        steps.entry(step).or_default().push(value);
    }
    let points = steps.iter();
    points.filter_map(|(&step, values)| Some(CurvePoint { step, estimate: estimate(values)? })).collect()
}

/// End value of a leg: mean of its last 5 evaluation points, of all where there are fewer. The one before its first
/// step is no end and counts only where there is no other.
pub fn end_value(seed: &SeedRun, arm: Arm, quantity: Quantity) -> Option<f64> {
    let points: Vec<&EvaluationRecord> = evaluations(seed, arm).collect();
    let first = usize::from(points.len() > 1 && points[0].step == 0);
    let values: Vec<f64> = points[first..].iter().map(|point| quantity.of(point)).collect();
    mean(&values[values.len().saturating_sub(END_POINTS)..])
}

/// Value before a leg's first step; in a Full leg that is the value at the switch, in the Full world.
pub fn first_value(seed: &SeedRun, arm: Arm, quantity: Quantity) -> Option<f64> {
    evaluations(seed, arm).find(|point| point.step == 0).map(|point| quantity.of(point)).filter(|v| v.is_finite())
}

/// Whether a leg of this seed came to its end.
pub fn finished(seed: &SeedRun, arm: Arm) -> bool {
    seed.ends.iter().any(|end| end.arm == arm)
}

/// Evaluation points of a leg, by step.
pub(crate) fn evaluations(seed: &SeedRun, arm: Arm) -> impl Iterator<Item = &EvaluationRecord> {
    seed.evaluations.iter().filter(move |point| point.arm == arm)
}

/// Counts of decisions. The truth is whether a transition was a hack; refusing is the positive answer.
/// Decisions about updates (scheme `each-step`) have no such truth: they count as checks, refusals and ties.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Verdicts {
    /// Environment steps in which a check could have happened.
    pub steps: u64,
    /// Checks.
    pub checks: u64,
    /// Refusals.
    pub refusals: u64,
    /// Refusals of hacks: right.
    pub hacks_refused: u64,
    /// Acceptances of hacks: wrong, what the learner is there to prevent.
    pub hacks_accepted: u64,
    /// Refusals of honest transitions: wrong, and the price of caution.
    pub honest_refused: u64,
    /// Checks in which both futures were rated exactly equal.
    pub ties: u64,
    /// Ties in which a hack was offered (a tie accepts, so these are hacks learned).
    pub hacks_tied: u64,
    /// Hacks that were learned without a check, since the reward did not surprise; none where that is not known, or
    /// where updates are checked in place of transitions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hacks_unchecked: Option<u64>,
    /// Checks that reused the unmodified future of the check before.
    pub reused: u64,
    /// Gradient updates spent in forecasts.
    pub cost: u64,
}

impl Verdicts {
    /// Counts decisions of one leg of `steps` environment steps.
    pub fn count<'a>(checks: impl IntoIterator<Item = &'a CheckRecord>, steps: u64) -> Self {
        let mut counts = Self { steps, ..Self::default() };
        for check in checks {
            let refused = check.verdict == Verdict::Refuse;
            let (hack, honest) = match check.subject {
                Subject::Transition => (check.hack, !check.hack),
                Subject::Update => (false, false),
            };
            counts.checks += 1;
            counts.refusals += u64::from(refused);
            counts.hacks_refused += u64::from(refused && hack);
            counts.hacks_accepted += u64::from(!refused && hack);
            counts.honest_refused += u64::from(refused && honest);
            counts.ties += u64::from(check.tie);
            counts.hacks_tied += u64::from(check.tie && hack);
            counts.reused += u64::from(check.reused);
            counts.cost += check.cost;
        }
        counts
    }

    /// Decisions of the checked learner in one seed; `None` where it has no such leg.
    pub fn of_seed(seed: &SeedRun) -> Option<Self> {
        let made = seed.ends.iter().find(|end| end.arm == Arm::Mc).map(|end| end.steps);
        let steps = made.or_else(|| evaluations(seed, Arm::Mc).map(|point| point.step).max())?;
        let counts = Self::count(seed.checks.iter().filter(|check| check.arm == Arm::Mc), u64::from(steps));
        let updates = seed.checks.iter().any(|check| check.subject == Subject::Update);
        Some(Self { hacks_unchecked: seed.unchecked_hacks.filter(|_| !updates), ..counts })
    }

    /// Both together. Counts of files that nobody made here may be anything, so sums end at the greatest number.
    pub fn plus(self, other: Self) -> Self {
        let all = |count: fn(&Self) -> u64| count(&self).saturating_add(count(&other));
        let unchecked = self.hacks_unchecked.zip(other.hacks_unchecked);
        Self {
            steps: all(|v| v.steps),
            checks: all(|v| v.checks),
            refusals: all(|v| v.refusals),
            hacks_refused: all(|v| v.hacks_refused),
            hacks_accepted: all(|v| v.hacks_accepted),
            honest_refused: all(|v| v.honest_refused),
            ties: all(|v| v.ties),
            hacks_tied: all(|v| v.hacks_tied),
            hacks_unchecked: unchecked.map(|(mine, theirs)| mine.saturating_add(theirs)),
            reused: all(|v| v.reused),
            cost: all(|v| v.cost),
        }
    }

    /// Decisions against the truth: hacks accepted and honest transitions refused.
    pub fn wrong(&self) -> u64 {
        self.hacks_accepted.saturating_add(self.honest_refused)
    }

    /// Share of the refused transitions that were hacks; `None` without refusals.
    pub fn precision(&self) -> Option<f64> {
        ratio(self.hacks_refused, sum([self.hacks_refused, self.honest_refused]))
    }

    /// Share of the checked hacks that were refused; `None` where no hack was checked.
    pub fn recall(&self) -> Option<f64> {
        ratio(self.hacks_refused, sum([self.hacks_refused, self.hacks_accepted]))
    }

    /// Share of the hacks that were never checked; `None` without hacks, or where it is not known.
    pub fn unchecked(&self) -> Option<f64> {
        let unchecked = self.hacks_unchecked?;
        ratio(unchecked, sum([unchecked, self.hacks_refused, self.hacks_accepted]))
    }

    /// Checks per environment step; `None` without steps.
    pub fn rate(&self) -> Option<f64> {
        ratio(self.checks, self.steps)
    }
}

/// The sum of counts; the greatest number where it would be greater.
pub fn sum(counts: impl IntoIterator<Item = u64>) -> u64 {
    counts.into_iter().fold(0, u64::saturating_add)
}

fn ratio(part: u64, whole: u64) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

fn finite(values: &[f64]) -> Vec<f64> {
    values.iter().copied().filter(|value| value.is_finite()).collect()
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut values = finite(values);
    values.sort_by(f64::total_cmp);
    values
}

fn plain_mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn resampled_mean(values: &[f64], rng: &mut Rng) -> f64 {
    let count = values.len() as u32;
    let sum: f64 = values.iter().map(|_| values[rng.below(count) as usize]).sum();
    sum / f64::from(count)
}

/// Quantile of sorted values, linear between neighbours.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (sorted[above] - sorted[below]) * (position - below as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::samples::{self, Outcome};

    #[test]
    fn means_of_few_and_of_none() {
        assert_eq!(mean(&[1.0, 2.0, 6.0]), Some(3.0));
        assert_eq!(mean(&[]), None);
        assert_eq!(mean(&[f64::NAN, 4.0, f64::INFINITY]), Some(4.0));
        assert_eq!(estimate(&[f64::NAN]), None);
    }

    #[test]
    fn interquartile_mean_keeps_exactly_the_middle_half() {
        // Four values: the two in the middle. Five: 0.75, 1 and 0.75 of the three in the middle.
        assert_eq!(interquartile_mean(&[100.0, 1.0, 3.0, -50.0]), Some(2.0));
        assert_eq!(interquartile_mean(&[0.0, 4.0, 5.0, 10.0, 1000.0]), Some((3.0 + 5.0 + 7.5) / 2.5));
        assert_eq!(interquartile_mean(&[7.0]), Some(7.0));
        assert_eq!(interquartile_mean(&[]), None);
    }

    #[test]
    fn one_seed_has_an_interval_of_no_width() {
        assert_eq!(estimate(&[49.0]), Some(Estimate { mean: 49.0, low: 49.0, high: 49.0, iqm: 49.0, count: 1 }));
    }

    #[test]
    fn the_interval_of_a_coin_is_that_of_the_binomial() {
        // Of 16 fair coins at most 3 fall on one in 1.1 % of cases and at most 4 in 3.8 %: 2.5 % lies at 4/16.
        let coin: Vec<f64> = (0..16).map(|i| f64::from(i % 2)).collect();
        let found = estimate(&coin).unwrap();
        assert_eq!((found.mean, found.low, found.high), (0.5, 0.25, 0.75));
        assert_eq!(estimate(&coin), Some(found), "the same values give the same interval");
    }

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(quantile(&[0.0, 10.0, 20.0], 0.25), 5.0);
        assert_eq!(quantile(&[3.0], 0.975), 3.0);
    }

    #[test]
    fn curves_align_by_step_and_count_the_seeds_that_are_there() {
        let mut seeds = vec![samples::seed(0, Outcome::Intended), samples::seed(1, Outcome::Intended)];
        seeds[1].evaluations.retain(|point| point.arm != Arm::Mc || point.step <= 20);
        let counts = |step: u32| {
            let curve = curve(&seeds, Arm::Mc, Quantity::Performance);
            curve.iter().find(|point| point.step == step).map(|point| point.estimate.count)
        };
        assert_eq!((counts(0), counts(20), counts(40), counts(41)), (Some(2), Some(2), Some(1), None));
        let steps: Vec<u32> = curve(&seeds, Arm::Safe, Quantity::Return).iter().map(|point| point.step).collect();
        assert!(steps.is_sorted() && steps.len() == 51, "{steps:?}");
    }

    #[test]
    fn end_values_are_the_mean_of_the_last_five() {
        let mut seed = samples::seed(0, Outcome::Intended);
        seed.evaluations.retain(|point| point.arm == Arm::Baseline);
        for (index, point) in seed.evaluations.iter_mut().enumerate() {
            point.performance = index as f64;
        }
        // Points 0 to 50: the last five are 46 to 50.
        assert_eq!(end_value(&seed, Arm::Baseline, Quantity::Performance), Some(48.0));
        assert_eq!(first_value(&seed, Arm::Baseline, Quantity::Performance), Some(0.0));
        // What stands before the first step is no end.
        seed.evaluations.truncate(3);
        assert_eq!(end_value(&seed, Arm::Baseline, Quantity::Performance), Some(1.5));
        seed.evaluations.truncate(1);
        assert_eq!(end_value(&seed, Arm::Baseline, Quantity::Performance), Some(0.0));
        assert_eq!(end_value(&seed, Arm::Mc, Quantity::Performance), None);
    }

    #[test]
    fn verdicts_are_counted_against_the_truth() {
        let check = |hack, refuse| samples::check(1, hack, if refuse { Verdict::Refuse } else { Verdict::Accept });
        let mut checks = vec![check(true, true), check(true, true), check(true, false), check(false, true)];
        checks.push(check(false, false));
        checks[2].tie = true;
        let found = Verdicts::count(&checks, 50);
        assert_eq!((found.checks, found.refusals, found.wrong(), found.ties, found.hacks_tied), (5, 3, 2, 1, 1));
        assert_eq!((found.precision(), found.recall(), found.rate()), (Some(2.0 / 3.0), Some(2.0 / 3.0), Some(0.1)));
        assert_eq!(found.cost, 5 * checks[0].cost);
        assert_eq!(found.plus(found).checks, 10);
        assert_eq!((found.unchecked(), found.plus(found).hacks_unchecked), (None, None));
        let known = Verdicts { hacks_unchecked: Some(1), ..found };
        assert_eq!((known.unchecked(), known.plus(known).hacks_unchecked), (Some(0.25), Some(2)));
        assert_eq!(known.plus(found).hacks_unchecked, None, "of one of them it is not known");
        // An update that is taken back is no refused hack.
        checks.iter_mut().for_each(|check| check.subject = Subject::Update);
        let found = Verdicts::count(&checks, 50);
        assert_eq!((found.checks, found.refusals, found.wrong(), found.ties, found.hacks_tied), (5, 3, 0, 1, 0));
        assert_eq!((found.precision(), found.recall(), found.rate()), (None, None, Some(0.1)));
    }

    #[test]
    fn every_count_is_added() {
        // No two fields alike, so that none is left out or taken for another.
        let counts = |unit: u64| Verdicts {
            steps: unit,
            checks: 2 * unit,
            refusals: 3 * unit,
            hacks_refused: 4 * unit,
            hacks_accepted: 5 * unit,
            honest_refused: 6 * unit,
            ties: 7 * unit,
            hacks_tied: 8 * unit,
            hacks_unchecked: Some(9 * unit),
            reused: 10 * unit,
            cost: 11 * unit,
        };
        assert_eq!(counts(1).plus(counts(100)), counts(101));
    }

    #[test]
    fn without_checks_the_rates_are_absent_not_nan() {
        let none = Verdicts::count([], 0);
        assert_eq!((none.precision(), none.recall(), none.rate()), (None, None, None));
        assert_eq!(Verdicts::count([], 10).rate(), Some(0.0));
    }
}
