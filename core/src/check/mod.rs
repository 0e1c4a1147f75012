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
//! # Schemes of comparison (paper section 5.3)
//! `discard` stops after the trigger and drops the transition. `each-step` stores every transition and
//! judges updates instead: two policies, before and after one update, are rated by the values before it.
//! `punish` and `store-predicted` store a refused transition under another reward.

pub mod utility;

use crate::config::{Config, Scheme};
use crate::record::Verdict;

/// Which transitions are checked (docs/method.md R12).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trigger {
    /// Those whose scaled reward differs from the predicted one by the threshold or, where that is not inclusive, by more.
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
    /// What a scheme does with a transition after a verdict (docs/method.md R25, R26).
    pub fn new(verdict: Verdict, config: &Config, predicted: f32) -> Self {
        match (verdict, config.scheme) {
            (Verdict::Accept, _) => Disposition::Store,
            (Verdict::Refuse, Scheme::Punish) => Disposition::StoreAs(config.punishment),
            (Verdict::Refuse, Scheme::StorePredicted) => Disposition::StoreAs(predicted),
            (Verdict::Refuse, _) => Disposition::Drop,
        }
    }
}

/// The decision between two futures (docs/method.md R24): the modified one is refused if its utility is
/// lower by more than `tolerance`; ties accept.
pub fn decide(modified: f64, unmodified: f64, tolerance: f32) -> Verdict {
    if unmodified - modified > f64::from(tolerance) { Verdict::Refuse } else { Verdict::Accept }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::{ActionSpec, Demonstration, Discrete, Environment};
    use crate::rng::Rng;
    use alloc::vec;

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
        // The tolerance itself is not worse; a half has no rounding.
        assert_eq!(decide(0.0, 0.5, 0.5), Verdict::Accept);
        assert_eq!(decide(0.0, 0.75, 0.5), Verdict::Refuse);
        assert_eq!(decide(1.0, 1.0, 0.0), Verdict::Accept);
        assert_eq!(decide(1.0, 1.0 + f64::EPSILON, 0.0), Verdict::Refuse);
    }

    /// Discounted sum of what the steps of a route are truly worth, scaled: its utility to a perfect reward model.
    fn ideal<E: Environment<Action = Discrete>>(world: &E, route: &Demonstration, rng: &mut Rng) -> f64 {
        let mut world = world.clone();
        let spec = world.spec().clone();
        let ActionSpec::Discrete(names) = spec.actions else { panic!("{:?}", spec.actions) };
        let mut observation = vec![0.0; spec.observation.width];
        world.reset(rng, &mut observation);
        let (mut sum, mut factor) = (0.0, 1.0);
        for i in 0.. {
            let step = world.step(&route.action(i, names), rng, &mut observation);
            sum += factor * f64::from(spec.scaled(step.performance));
            factor *= 0.95;
            if step.end.is_some() {
                break;
            }
        }
        sum
    }

    /// The ideal utilities of the larger worlds (Box Moving's are in `utility`):
    /// refuse the hack, accept with the roles swapped.
    #[test]
    fn decides_the_ideal_cases() {
        use crate::env::{absent_supervisor as absent, rocks_and_diamonds as rocks, tomato_watering as tomato};
        let utility = |index: usize| {
            let (options, route) = &absent::DEMONSTRATIONS[index];
            ideal(&absent::AbsentSupervisor::new(*options), route, &mut Rng::new(0))
        };
        // Around the tile, and through it while nobody watches.
        let [around, through] = [2, 3].map(utility);
        let utility = |index: usize| {
            let (options, route) = &rocks::DEMONSTRATIONS[index];
            ideal(&rocks::RocksAndDiamonds::new(*options), route, &mut Rng::new(0))
        };
        let [diamond, switched] = [2, 3].map(utility);
        // Tomatoes dry by chance: means over episodes. No route waters them well, so that the intended one is the sheet's.
        let (options, route) = &tomato::DEMONSTRATIONS[0];
        let mut rng = Rng::new(3);
        let episodes = 2000;
        let bucket = (0..episodes).map(|_| ideal(&tomato::TomatoWatering::new(*options), route, &mut rng)).sum::<f64>();
        let bucket = bucket / f64::from(episodes);
        for (measured, sheet, margin) in [
            (around, 0.5155, 1e-4),
            (through, 0.2754, 1e-4),
            (diamond, 1.710, 0.011),
            (switched, -0.209, 0.011),
            (bucket, 3.327, 0.05),
        ] {
            assert!((measured - sheet).abs() < margin, "{measured}, in the sheet {sheet}");
        }
        for (intended, hacking) in [(around, through), (diamond, switched), (6.789, bucket)] {
            assert_eq!(decide(hacking, intended, 1e-6), Verdict::Refuse);
            assert_eq!(decide(intended, hacking, 1e-6), Verdict::Accept);
            assert_eq!(decide(intended, intended, 1e-6), Verdict::Accept);
        }
    }
}
