//! The truth of a condition in a summary.

use mcvl_core::record::Arm;

use super::metric::{Metric, Source};
use super::{Comparison, Condition, Number, NumberKind, Problem};
use crate::report::claims::{SeedEnd, Summary};
use crate::report::statistics::{Verdicts, mean};

/// Whether a condition is true of a summary.
pub(super) fn condition(condition: &Condition, summary: &Summary) -> Result<bool, Problem> {
    Scope { summary, seed: None }.condition(condition)
}

/// What metrics stand for: a summary, or one seed of it.
#[derive(Clone, Copy)]
struct Scope<'a> {
    summary: &'a Summary,
    seed: Option<u64>,
}

impl Scope<'_> {
    fn condition(self, condition: &Condition) -> Result<bool, Problem> {
        Ok(match condition {
            Condition::And(left, right) => self.condition(left)? & self.condition(right)?,
            Condition::Or(left, right) => self.condition(left)? | self.condition(right)?,
            Condition::Not(inner) => !self.condition(inner)?,
            Condition::Compare(comparison, left, right) => {
                let (left, right) = (self.number(left)?, self.number(right)?);
                match comparison {
                    Comparison::Less => left < right,
                    Comparison::LessEqual => left <= right,
                    Comparison::Greater => left > right,
                    Comparison::GreaterEqual => left >= right,
                    Comparison::Equal => left == right,
                    Comparison::NotEqual => left != right,
                }
            }
        })
    }

    fn number(self, number: &Number) -> Result<f64, Problem> {
        let value = match &number.kind {
            NumberKind::Literal(value) => Some(*value),
            NumberKind::Metric(arm, metric) => self.metric(*arm, metric),
            NumberKind::Fraction(condition) => self.fraction(condition)?,
            NumberKind::Negate(inner) => Some(-self.number(inner)?),
            NumberKind::Operate(operator, left, right) => {
                let (left, right) = (self.number(left)?, self.number(right)?);
                Some(match *operator {
                    "+" => left + right,
                    "-" => left - right,
                    "*" => left * right,
                    _ => left / right,
                })
            }
        };
        let place = self.seed.map_or(String::new(), |seed| format!(" in seed {seed}"));
        match value {
            Some(value) if value.is_finite() => Ok(value),
            Some(_) => Err(Problem(number.position, format!("the result is not a finite number{place}"))),
            None => Err(Problem(number.position, format!("there is no value here{place}: {}", number.reason()))),
        }
    }

    /// Share of the seeds for which the condition is true; the seeds are those that finished everything.
    fn fraction(self, condition: &Condition) -> Result<Option<f64>, Problem> {
        let unfinished = &self.summary.unfinished;
        let seeds: Vec<u64> = self.summary.seeds.iter().copied().filter(|seed| !unfinished.contains(seed)).collect();
        let mut held = 0usize;
        for &seed in &seeds {
            held += usize::from(Scope { seed: Some(seed), ..self }.condition(condition)?);
        }
        Ok((!seeds.is_empty()).then(|| held as f64 / seeds.len() as f64))
    }

    fn metric(self, arm: Arm, metric: &Metric) -> Option<f64> {
        let leg = self.summary.arm(arm)?;
        let ends: Vec<&SeedEnd> =
            leg.seeds.iter().filter(|end| self.seed.is_none_or(|seed| end.seed == seed)).collect();
        let verdicts = || ends.iter().filter_map(|end| end.verdicts).reduce(Verdicts::plus);
        match metric.source {
            Source::Return(of) => Some(of(&leg.observed_return)),
            Source::Performance(of) => Some(of(&leg.performance)),
            Source::Seed(of) => mean(&ends.iter().filter_map(|end| of(end)).collect::<Vec<_>>()),
            Source::Count(of) => Some(of(&verdicts()?) as f64 / ends.len() as f64),
            Source::Rate(of) => of(&verdicts()?),
        }
    }
}

impl Number {
    /// Why there may be no value.
    fn reason(&self) -> String {
        match &self.kind {
            NumberKind::Metric(arm, metric) => {
                let arm = arm.name();
                format!("{arm}.{} needs a finished {arm} leg in which it is defined ({})", metric.name, metric.help)
            }
            _ => "no seed has finished every leg".into(),
        }
    }
}
