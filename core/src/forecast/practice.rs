//! Practice in the transition model («add transitions from transition model», docs/method.md R27).
//!
//! A future that practises has copies of its own: of the reward model, of the replay buffer and of the
//! world in the state after the checked transition.
//! 1. Its reward model makes updates on mini-batches of the replay buffer with the forced transitions
//!    appended, so that what follows does not contradict them.
//! 2. After every update of the forecast learner it makes one epsilon-greedy step in its world, which is
//!    reset at the end of an episode, and stores it with the reward that *its* reward model predicts.
//!
//! The two futures of a check name the same streams, so they differ in nothing but the forced transitions
//! and what follows from them. The world's own rewards are not looked at.

use alloc::vec::Vec;
use serde::Serialize;

use super::ForecastJob;
use crate::agent::Agent;
use crate::agent::reward_model::RewardModel;
use crate::env::{Action, Environment, EpisodeEnd};
use crate::nn::mlp::Scratch;
use crate::nn::rows::Rows;
use crate::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use crate::rng::{Purpose, Rng};

/// Where and how a future practises. Nothing of it is changed.
#[derive(Debug, Serialize)]
pub struct Practice<'a, E> {
    /// The transition model in the state after the checked transition.
    pub world: &'a E,
    /// The observation of that state.
    pub observation: &'a [f32],
    /// Whether the episode ended there: practice then begins with a reset.
    pub ended: bool,
    /// Start of the copy that is trained: parameters, and with [`Carry::optimizer`](super::Carry::optimizer) the moments of
    /// its optimiser.
    pub reward_model: &'a RewardModel,
    /// Updates of that copy before the forecast's first one.
    pub reward_updates: u32,
    /// Probability of a random action.
    pub epsilon: f32,
}

/// A future's own copies.
#[derive(Clone, Debug)]
pub(super) struct Practising<E, A> {
    world: E,
    observation: Vec<f32>,
    ended: bool,
    reward_model: RewardModel,
    replay: ReplayBuffer<A>,
    epsilon: f32,
    draws: Rng,
    choices: Rng,
    chance: Rng,
    rows: Rows,
    scratch: Scratch,
    predicted: Vec<f32>,
}

impl<E: Environment<Action = A>, A: Action> Practising<E, A> {
    pub(super) fn new<G: Agent<Action = A>>(practice: &Practice<'_, E>, job: &ForecastJob<'_, E, G>) -> Self {
        let stream = |purpose| Rng::stream(job.seed, purpose, job.version);
        Self {
            world: practice.world.clone(),
            observation: practice.observation.to_vec(),
            ended: practice.ended,
            reward_model: practice.reward_model.for_forecast(job.carry),
            replay: job.replay.clone(),
            epsilon: practice.epsilon,
            draws: stream(Purpose::PracticeBatch),
            choices: stream(Purpose::PracticeExplore),
            chance: stream(Purpose::PracticeWorld),
            rows: Rows::default(),
            scratch: Scratch::default(),
            predicted: Vec::new(),
        }
    }

    /// The copy of the replay buffer, with what was practised so far.
    pub(super) fn replay(&self) -> &ReplayBuffer<A> {
        &self.replay
    }

    /// One update of the copy of the reward model; its loss.
    pub(super) fn train(
        &mut self,
        size: u32,
        forced: &Forced<A>,
        batch: &mut Minibatch<A>,
        slots: &mut Vec<u32>,
    ) -> f32 {
        draw_slots(self.replay.len(), size, &mut self.draws, slots);
        batch.gather(&self.replay, slots, forced);
        self.reward_model.update(batch)
    }

    /// One step of `agent` in the copy of the world.
    pub(super) fn step<G: Agent<Action = A>>(&mut self, agent: &G) {
        if self.ended {
            self.world.reset(&mut self.chance, &mut self.observation);
        }
        let spec = self.world.spec();
        self.rows.clear(spec.observation);
        self.rows.push_observation(&self.observation);
        let action = agent.explore(&self.rows, &spec.actions, self.epsilon, &mut self.choices, &mut self.scratch);
        let pair = core::slice::from_ref(&action);
        self.reward_model.predict(&self.rows, pair, &mut self.scratch, &mut self.predicted);
        let observation = self.observation.clone();
        let end = self.world.step(&action, &mut self.chance, &mut self.observation).end;
        self.ended = end.is_some();
        self.replay.push(&Transition {
            observation,
            action,
            reward: self.predicted[0],
            next_observation: self.observation.clone(),
            terminated: end == Some(EpisodeEnd::Terminated),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::Carry;
    use super::*;
    use crate::agent::ddqn::Ddqn;
    use crate::env::box_moving::{BoxMoving, Variant};
    use crate::env::{Discrete, EnvSpec, Step};
    use crate::trainer::Trainer;
    use alloc::vec;

    /// Box Moving whose own rewards are no numbers.
    #[derive(Clone)]
    struct Unpaid(BoxMoving);

    impl Environment for Unpaid {
        type Action = Discrete;
        fn spec(&self) -> &EnvSpec {
            self.0.spec()
        }
        fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
            self.0.reset(rng, observation);
        }
        fn step(&mut self, action: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
            Step { reward: f32::NAN, ..self.0.step(action, rng, observation) }
        }
    }

    fn predict(model: &RewardModel, state: &[f32], action: Discrete) -> f32 {
        let (mut rows, mut rewards) = (Rows::new(BoxMoving::new(Variant::Full, true).spec().observation), Vec::new());
        rows.push_observation(state);
        model.predict(&rows, &[action], &mut Scratch::default(), &mut rewards);
        rewards[0]
    }

    /// An untrained learner, and a full buffer whose transitions all pay nothing.
    fn learner() -> (Ddqn, RewardModel, ReplayBuffer<Discrete>) {
        let mut world = BoxMoving::new(Variant::Full, true);
        let trainer = Trainer::gridworld("env=box-moving".parse().unwrap(), world.clone(), world.clone());
        let spec = world.spec().clone();
        let mut replay = ReplayBuffer::new(spec.observation, 60);
        let (mut rng, mut next) = (Rng::new(1), vec![0.0; spec.observation.width]);
        world.reset(&mut rng, &mut next);
        for _ in 0..60 {
            let (observation, action) = (next.clone(), Discrete::sample(&spec.actions, &mut rng));
            world.step(&action, &mut rng, &mut next);
            let next_observation = next.clone();
            replay.push(&Transition { observation, action, reward: 0.0, next_observation, terminated: false });
        }
        (trainer.agent().clone(), trainer.reward_model().clone(), replay)
    }

    #[test]
    fn the_copy_of_the_reward_model_takes_its_moments_along_only_if_told() {
        let (agent, mut reward_model, replay) = learner();
        let slots: Vec<u32> = (0..32).collect();
        let mut batch = Minibatch::default();
        batch.gather(&replay, &slots, &Forced::new(&[], &replay));
        // Moments to take along.
        reward_model.update(&batch);
        let world = BoxMoving::new(Variant::Full, true);
        let after_one_update = |optimizer: bool| {
            let observation = replay.get(0).observation;
            let practice = Practice {
                world: &world,
                observation: &observation,
                ended: false,
                reward_model: &reward_model,
                reward_updates: 1,
                epsilon: 0.5,
            };
            let carry = Carry { optimizer, ..Carry::ALL };
            let (agent, replay, forced, practice) = (&agent, &replay, &[][..], Some(practice));
            let job =
                ForecastJob { agent, replay, forced, updates: 1, batch: 32, seed: 1, carry, version: 5, practice };
            let mut own = Practising::new(job.practice.as_ref().unwrap(), &job);
            assert_eq!(own.reward_model.digest(), reward_model.digest());
            own.train(32, &Forced::new(&[], own.replay()), &mut Minibatch::default(), &mut Vec::new());
            own.reward_model.digest()
        };
        assert_ne!(after_one_update(true), after_one_update(false));
    }

    #[test]
    fn practice_is_rewarded_by_the_futures_own_reward_model() {
        let (agent, reward_model, replay) = learner();
        let surprise = Transition { reward: 1.0, ..replay.get(7) };
        let world = Unpaid(BoxMoving::new(Variant::Full, true));
        let practice = || Practice {
            world: &world,
            observation: &surprise.observation,
            ended: false,
            reward_model: &reward_model,
            reward_updates: 200,
            epsilon: 0.5,
        };
        let mut learned = Vec::new();
        for forced in [core::slice::from_ref(&surprise), &[]] {
            let replay = &replay;
            let (agent, practice) = (&agent, Some(practice()));
            let (carry, version) = (Carry::ALL, 5);
            let job = ForecastJob { agent, replay, forced, updates: 20, batch: 32, seed: 1, carry, version, practice };
            let mut own = Practising::new(job.practice.as_ref().unwrap(), &job);
            let (mut batch, mut slots) = (Minibatch::default(), Vec::new());
            for _ in 0..200 {
                own.train(32, &Forced::new(forced, own.replay()), &mut batch, &mut slots);
                assert_eq!(batch.rewards.len(), 32 + forced.len());
            }
            learned.push(predict(&own.reward_model, &surprise.observation, surprise.action));
            let mut state = surprise.observation.clone();
            for _ in 0..20 {
                own.step(agent);
                // The youngest stands before the slot that is overwritten next.
                let newest = ((own.replay().pushed() - 1) % 60) as u32;
                let stored = own.replay().get(newest);
                assert_eq!(stored.observation, state);
                assert_eq!(stored.reward, predict(&own.reward_model, &state, stored.action));
                state = stored.next_observation;
            }
            assert_eq!((own.replay().pushed(), replay.pushed()), (80, 60));
        }
        // Only one of the two has seen the reward, and the learner's own model is as it was.
        assert!(learned[0] > 0.5 && learned[1].abs() < 0.2, "{learned:?}");
    }
}
