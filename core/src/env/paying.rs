//! A world as one leg of a run meets it: the same world, paying its observed reward or, for the oracle,
//! its hidden performance.
//!
//! The oracle is the learner that later work compares with: it is told what the designer wants. It is
//! told by its *world*, so learner, reward model and trainer stay as they are and never see performance.

use serde::{Deserialize, Serialize};

use super::{EnvSpec, Environment, Frame, Step};
use crate::rng::Rng;

/// A world and what it pays.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Paying<E> {
    world: E,
    oracle: bool,
}

impl<E> Paying<E> {
    /// The world as it is.
    pub fn observed(world: E) -> Self {
        Self { world, oracle: false }
    }

    /// The world with its performance as observed reward, in the same unit and with the same scale.
    pub fn performance(world: E) -> Self {
        Self { world, oracle: true }
    }

    /// The world itself.
    pub fn world(&self) -> &E {
        &self.world
    }
}

impl<E: Environment> Environment for Paying<E> {
    type Action = E::Action;

    fn spec(&self) -> &EnvSpec {
        self.world.spec()
    }

    fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
        self.world.reset(rng, observation);
    }

    fn step(&mut self, action: &E::Action, rng: &mut Rng, observation: &mut [f32]) -> Step {
        let step = self.world.step(action, rng, observation);
        if self.oracle { Step { reward: step.performance, ..step } } else { step }
    }

    fn model(&self) -> Self {
        Self { world: self.world.model(), oracle: self.oracle }
    }

    fn frame(&self) -> Frame {
        self.world.frame()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::box_moving::{BoxMoving, Variant};
    use crate::env::{Discrete, contract};

    #[test]
    fn pays_what_it_says_and_changes_nothing_else() {
        let world = BoxMoving::new(Variant::Full, true);
        let (mut plain, mut oracle) = (Paying::observed(world.clone()), Paying::performance(world.clone()));
        contract::check(&oracle, 10).unwrap();
        let mut rng = Rng::new(0);
        let (mut bare, mut seen, mut told) = (world, [0.0; 11], [0.0; 11]);
        let mut hacks = 0;
        for action in [1, 1, 0, 1, 0, 1, 0, 0, 0, 1] {
            let step = bare.step(&Discrete(action), &mut rng, &mut seen);
            assert_eq!(plain.step(&Discrete(action), &mut rng, &mut told), step);
            let paid = oracle.step(&Discrete(action), &mut rng, &mut told);
            assert_eq!((paid.reward, paid.performance, paid.end), (step.performance, step.performance, step.end));
            assert_eq!((told, oracle.frame(), oracle.world()), (seen, bare.frame(), &bare));
            hacks += u32::from(step.reward != step.performance);
        }
        assert!(hacks > 0, "the walk meets the hack");
    }
}
