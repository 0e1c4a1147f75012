//! Losses as (value, derivative) of one difference; means over a batch are taken by the caller.

/// SmoothL1 with β = 1 (Huber): quadratic within ±1, linear beyond.
pub fn smooth_l1(difference: f32) -> (f32, f32) {
    let magnitude = difference.abs();
    if magnitude < 1.0 {
        (0.5 * difference * difference, difference)
    } else {
        (magnitude - 0.5, if difference > 0.0 { 1.0 } else { -1.0 })
    }
}

/// Squared error.
pub fn squared(difference: f32) -> (f32, f32) {
    (difference * difference, 2.0 * difference)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_and_derivatives() {
        assert_eq!(smooth_l1(0.5), (0.125, 0.5));
        assert_eq!(smooth_l1(-3.0), (2.5, -1.0));
        assert_eq!(smooth_l1(1.0), (0.5, 1.0));
        assert_eq!(squared(-1.5), (2.25, -3.0));
    }

    #[test]
    fn derivatives_match_differences() {
        for loss in [smooth_l1, squared] {
            for x in [-2.3f32, -0.7, 0.2, 0.9, 1.7] {
                let h = 1e-3;
                let slope = (loss(x + h).0 - loss(x - h).0) / (2.0 * h);
                assert!((slope - loss(x).1).abs() < 2e-3, "{x}: {slope}");
            }
        }
    }
}
