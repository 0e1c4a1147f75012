//! From values to places on the paper, and ticks at numbers that people count in.

/// A linear map from values to places.
#[derive(Clone, Copy, Debug)]
pub(in crate::report) struct Scale {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Scale {
    /// Maps `low..high` to `from..to`.
    pub(in crate::report) fn new(low: f64, high: f64, from: f64, to: f64) -> Self {
        Self { low, high, from, to }
    }

    /// The place of a value.
    pub(in crate::report) fn at(&self, value: f64) -> f64 {
        self.from + (value - self.low) / (self.high - self.low) * (self.to - self.from)
    }

    /// About `count` round numbers inside the range, ascending.
    pub(in crate::report) fn ticks(&self, count: usize) -> Vec<f64> {
        let step = nice_step((self.high - self.low) / count as f64);
        // The slack keeps a tick that rounding put a hair outside.
        let first = (self.low / step - 1e-9).ceil() as i64;
        let last = (self.high / step + 1e-9).floor() as i64;
        (first..=last).map(|index| index as f64 * step).collect()
    }
}

/// Least and greatest of the values with some air around them; never empty.
pub(in crate::report) fn padded_range(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .into_iter()
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return (0.0, 1.0);
    }
    let air = if high > low { 0.06 * (high - low) } else { 1.0 };
    (low - air, high + air)
}

/// The smallest of 1, 2, 5 times a power of ten that is not below `raw`.
fn nice_step(raw: f64) -> f64 {
    let mut power = 1.0;
    while power > raw {
        power /= 10.0;
    }
    while power * 10.0 <= raw {
        power *= 10.0;
    }
    [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power).into_iter().find(|step| *step >= raw).unwrap_or(10.0 * power)
}

/// A tick's number, with a real minus sign.
pub(in crate::report) fn label(value: f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    if rounded < 0.0 { format!("−{}", -rounded) } else { format!("{}", rounded.abs()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let ticks = |low, high| Scale::new(low, high, 0.0, 1.0).ticks(6);
        assert_eq!(ticks(-62.0, 214.0), [-50.0, 0.0, 50.0, 100.0, 150.0, 200.0]);
        assert_eq!(ticks(0.0, 2000.0), [0.0, 500.0, 1000.0, 1500.0, 2000.0]);
        assert_eq!(ticks(0.0, 0.3).len(), 7, "0, 0.05, ... 0.3");
    }

    #[test]
    fn one_value_and_none_have_a_range() {
        assert_eq!(padded_range([5.0]), (4.0, 6.0));
        assert_eq!(padded_range([f64::NAN]), (0.0, 1.0));
        assert_eq!(padded_range([0.0, 100.0]), (-6.0, 106.0));
    }

    #[test]
    fn labels_have_no_negative_zero() {
        assert_eq!([label(-50.0), label(-0.0), label(0.30000000000000004)], ["−50", "0", "0.3"]);
    }
}
