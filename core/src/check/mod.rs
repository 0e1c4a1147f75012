//! The modification check: is the future that learned from a transition worse, by today's utility?
//!
//! The parts, in the order of their use:
//! 1. [`Trigger`]: does this transition need a check?
//! 2. two forecasts ([`crate::forecast`]), with and without the transition, otherwise equal;
//! 3. [`utility`]: both futures act in the same copies of the world and are rated by the *current* reward
//!    model and value function;
//! 4. [`decide`]: refuse if the changed future is worse;
//! 5. [`Disposition`]: what becomes of the transition.
//!
//! # Schemes of comparison (paper section 5.3, specification section 2)
//! `discard` stops after the trigger and drops the transition. `each-step` stores every transition and
//! judges updates instead: two policies, before and after one update, are rated by the values before it.
//! `punish` and `store-predicted` store a refused transition under another reward.

pub mod utility;

use crate::config::{Config, Scheme};
use crate::record::Verdict;

/// Which transitions are checked (specification R12).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trigger {
    /// Those whose scaled reward differs from the predicted one by more than the threshold.
    ByReward {
        /// Least deviation.
        threshold: f32,
        /// Whether the threshold itself is enough.
        inclusive: bool,
    },
    /// Every one.
    All,
    /// None.
    Never,
}

impl Trigger {
    /// The trigger of a configuration.
    pub fn new(config: &Config) -> Self {
        match config.scheme {
            Scheme::ByReward | Scheme::Discard | Scheme::Punish | Scheme::StorePredicted => {
                Trigger::ByReward { threshold: config.threshold, inclusive: config.threshold_inclusive }
            }
            Scheme::All => Trigger::All,
            Scheme::EachStep | Scheme::None => Trigger::Never,
        }
    }

    /// Whether a transition with this received and predicted reward is checked.
    pub fn fires(self, reward: f32, predicted: f32) -> bool {
        match self {
            Trigger::ByReward { threshold, inclusive } => {
                let deviation = (reward - predicted).abs();
                deviation > threshold || inclusive && deviation == threshold
            }
            Trigger::All => true,
            Trigger::Never => false,
        }
    }

    /// Least deviation that is checked; 0 where the deviation does not matter.
    pub fn threshold(self) -> f32 {
        match self {
            Trigger::ByReward { threshold, .. } => threshold,
            Trigger::All | Trigger::Never => 0.0,
        }
    }
}

/// What becomes of a transition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disposition {
    /// It is stored as it is.
    Store,
    /// It is stored with this scaled reward in place of its own.
    StoreAs(f32),
    /// It is not stored.
    Drop,
}

impl Disposition {
    /// What a scheme does with a transition after a verdict (specification R25, R26, S5).
    pub fn new(verdict: Verdict, config: &Config, predicted: f32) -> Self {
        match (verdict, config.scheme) {
            (Verdict::Accept, _) => Disposition::Store,
            (Verdict::Refuse, Scheme::Punish) => Disposition::StoreAs(config.punishment),
            (Verdict::Refuse, Scheme::StorePredicted) => Disposition::StoreAs(predicted),
            (Verdict::Refuse, _) => Disposition::Drop,
        }
    }
}

/// The decision between two futures (specification R24): the modified one is refused if its utility is
/// lower by more than `tolerance`; ties accept.
pub fn decide(modified: f64, unmodified: f64, tolerance: f32) -> Verdict {
    if unmodified - modified > f64::from(tolerance) { Verdict::Refuse } else { Verdict::Accept }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fires_at_the_threshold_and_beyond() {
        let by_reward = |threshold, inclusive| Trigger::ByReward { threshold, inclusive };
        let trigger = by_reward(0.5, true);
        assert!(trigger.fires(1.0, 0.5) && trigger.fires(-1.0, 0.0) && !trigger.fires(0.4, 0.0));
        assert!(Trigger::All.fires(0.0, 0.0) && !Trigger::Never.fires(9.0, 0.0));
        assert!(by_reward(0.0, true).fires(0.25, 0.25), "threshold 0 checks all");
        assert!(!by_reward(0.5, false).fires(1.0, 0.5) && by_reward(0.5, false).fires(1.1, 0.5));
        assert!(!by_reward(0.0, false).fires(0.25, 0.25));
    }

    #[test]
    fn refuses_only_what_is_worse() {
        assert_eq!(decide(1.0, 2.0, 1e-6), Verdict::Refuse);
        assert_eq!(decide(2.0, 1.0, 1e-6), Verdict::Accept);
        assert_eq!(decide(1.0, 1.0, 1e-6), Verdict::Accept);
        assert_eq!(decide(1.0, 1.0 + 1e-7, 1e-6), Verdict::Accept);
    }

    /// The ideal utilities of the fact sheet: refuse the hack, accept with the roles swapped.
    #[test]
    fn decides_the_ideal_cases() {
        for (intended, hacking) in [(1.851, -1.851), (0.5155, 0.2754), (6.789, 3.327), (1.710, -0.209)] {
            assert_eq!(decide(hacking, intended, 1e-6), Verdict::Refuse);
            assert_eq!(decide(intended, hacking, 1e-6), Verdict::Accept);
            assert_eq!(decide(intended, intended, 1e-6), Verdict::Accept);
        }
    }
}
