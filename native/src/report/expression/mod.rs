//! The language of `mcvl compare --assert`: a claim about a summary's numbers that is true or false.
//!
//! ```text
//! mc.performance >= 45 and baseline.performance < safe.performance
//! mc.return - mc.performance < 1
//! fraction(mc.performance >= 48) >= 0.9
//! ```
//!
//! Numbers, `+ - * /`, `< <= > >= == !=`, `and`, `or`, `not`, parentheses, and the metrics of
//! [`METRICS`]. Outside `fraction(...)` a metric is its mean over seeds; inside, it is the value of one
//! seed, and `fraction` is the share of the seeds for which the condition is true.

use std::fmt;

use mcvl_core::record::Arm;

use super::claims::Summary;
pub use metric::{METRICS, Metric};

mod evaluate;
mod metric;
mod parse;

/// What is wrong with an expression, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExpressionError {
    /// Character of the expression, 0-based.
    pub position: usize,
    /// What is wrong and what would be right.
    pub message: String,
    text: String,
}

impl fmt::Display for ExpressionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "at character {}: {}", self.position + 1, self.message)?;
        writeln!(f, "  {}", self.text)?;
        write!(f, "  {:position$}^", "", position = self.position)
    }
}

impl std::error::Error for ExpressionError {}

/// A parsed expression: a condition, known to be well formed.
#[derive(Clone)]
pub struct Expression {
    text: String,
    root: Condition,
}

#[derive(Clone)]
enum Condition {
    Compare(Comparison, Box<Number>, Box<Number>),
    And(Box<Condition>, Box<Condition>),
    Or(Box<Condition>, Box<Condition>),
    Not(Box<Condition>),
}

#[derive(Clone, Copy)]
enum Comparison {
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    Equal,
    NotEqual,
}

#[derive(Clone)]
struct Number {
    position: usize,
    kind: NumberKind,
}

#[derive(Clone)]
enum NumberKind {
    Literal(f64),
    Metric(Arm, &'static Metric),
    Fraction(Box<Condition>),
    Negate(Box<Number>),
    Operate(&'static str, Box<Number>, Box<Number>),
}

impl Expression {
    /// Parses an expression.
    ///
    /// # Errors
    /// Where it is not well formed or names an unknown metric; the error lists the known ones.
    pub fn parse(text: &str) -> Result<Self, ExpressionError> {
        let root = parse::condition(text).map_err(|problem| problem.of(text))?;
        Ok(Self { text: text.to_owned(), root })
    }

    /// Whether the expression is true of a summary.
    ///
    /// # Errors
    /// If a metric has no value in it: a leg that no seed finished, the precision of a learner that
    /// refused nothing, a division by zero.
    pub fn evaluate(&self, summary: &Summary) -> Result<bool, ExpressionError> {
        evaluate::condition(&self.root, summary).map_err(|problem| problem.of(&self.text))
    }
}

impl fmt::Display for Expression {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// Where, and what: an error before it knows the text.
struct Problem(usize, String);

impl Problem {
    fn of(self, text: &str) -> ExpressionError {
        ExpressionError { position: self.0, message: self.1, text: text.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::samples;

    /// Asserts the truth of expressions about ten seeds: eight mc at 49, one hacked (3), one at 25 (7).
    fn check(truth: bool, expressions: &[&str]) {
        let summary = Summary::new(&samples::ten());
        for text in expressions {
            let expression = Expression::parse(text).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(expression.evaluate(&summary), Ok(truth), "{text}");
        }
    }

    fn error(text: &str) -> (usize, String) {
        let summary = Summary::new(&samples::set(&[samples::Outcome::Intended]));
        let result = Expression::parse(text).and_then(|expression| expression.evaluate(&summary));
        let error = result.expect_err(text);
        (error.position, error.message)
    }

    #[test]
    fn metrics_are_means_over_seeds() {
        check(
            true,
            &[
                "mc.performance == 36.8",
                "baseline.performance < safe.performance",
                "mc.performance.iqm == 49 and mc.performance.low < mc.performance",
                "baseline.return - baseline.performance == 250",
                "mc.hacked == 1 / 10",
                "mc.checks == 12 and mc.wrong == 0.2 and mc.missed == 0.1",
                "mc.performance.first == 25",
            ],
        );
        check(false, &["mc.performance > 36.8", "baseline.performance >= safe.performance"]);
    }

    #[test]
    fn fractions_count_seeds() {
        check(
            true,
            &[
                "fraction(mc.performance >= 48) == 0.8",
                "fraction(mc.performance >= 48 or mc.performance == 25) >= 0.9",
                "fraction(baseline.performance < mc.performance) == 0.9",
                "fraction(mc.recall == 1) == 0.9 and mc.recall < 1",
            ],
        );
    }

    #[test]
    fn operators_bind_as_in_arithmetic() {
        check(
            true,
            &[
                "1 + 2 * 3 == 7",
                "(1 + 2) * 3 == 9",
                "8 - 4 - 2 == 2",
                "8 / 4 / 2 == 1",
                "-2 + 3 == 1",
                "1 == 2 and 1 == 2 or 1 == 1",
                "not 1 == 2",
                "not (1 == 1 and 1 == 2)",
                "((1 < 2))",
                "1 != 2",
            ],
        );
        check(false, &["1 == 2 and (1 == 2 or 1 == 1)", "not 1 == 1"]);
    }

    #[test]
    fn errors_say_where_and_what_would_be_right() {
        for (text, position, part) in [
            ("mc.performence >= 1", 0, "did you mean `mc.performance`?"),
            (
                "1 < plain.return",
                4,
                "known are safe., baseline., mc., oracle., frozen., frozen_reward. followed by return, ",
            ),
            ("mc.return", 0, "a condition compares"),
            ("mc.return >=", 12, "the expression ends here"),
            ("(1 < 2", 6, "`)` is missing here"),
            ("1 < 2 3", 6, "unexpected `3`"),
            ("1 < 2 < 3", 6, "unexpected `<`"),
            ("mc.return = 3", 10, "equality is `==`"),
            ("1 + (2 < 3) > 0", 5, "a number is needed here"),
            ("1.2.3 < 4", 0, "`1.2.3` is not a number"),
            ("fraction(mc.return.low > 1) > 0", 9, "about all seeds together"),
            ("fraction(fraction(1 < 2) > 1) > 0", 9, "cannot stand inside"),
            ("1 / 0 > 1", 2, "not a finite number"),
            ("baseline.recall > 0", 0, "needs a finished baseline leg"),
            ("frozen_reward.return > 0", 0, "frozen-reward"),
            ("", 0, "the expression ends here"),
        ] {
            let (at, message) = error(text);
            assert_eq!(at, position, "{text}: {message}");
            assert!(message.contains(part), "{text}: {message}");
        }
    }

    #[test]
    fn the_caret_points_at_the_place() {
        let error = Expression::parse("1 < x").err().unwrap().to_string();
        let lines: Vec<&str> = error.lines().collect();
        assert!(lines[0].starts_with("at character 5: unknown metric `x`"), "{error}");
        assert_eq!(lines[1..], ["  1 < x", "      ^"]);
    }
}
