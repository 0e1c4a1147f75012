//! Proof of exactness: digests of every stage of the method, computed on the machine at hand and compared with the
//! committed ones. Native, wasm scalar, wasm SIMD and every vector unit must agree on all of them. TD3's stands apart,
//! since the page's modules do without it (feature `continuous`).
//!
//! ```
//! for ((name, digest), (committed_name, committed)) in mcvl_core::exact::digests().into_iter().zip(mcvl_core::exact::COMMITTED) {
//!     assert_eq!((name, digest), (*committed_name, *committed));
//! }
//! ```

use alloc::vec;
use alloc::vec::Vec;
use core::task::Poll;

use crate::agent::Agent;
use crate::agent::ddqn::Ddqn;
use crate::agent::reward_model::RewardModel;
#[cfg(feature = "continuous")]
use crate::agent::td3::Td3;
use crate::check::utility::{Judge, Start, rate};
use crate::config::Config;
use crate::digest::Digest;
use crate::env::box_moving::{BoxMoving, Variant};
use crate::env::reacher::{Button, ClosedForm, Reacher};
use crate::env::{Action, Continuous, Discrete, Environment, ObservationSpec};
use crate::forecast::cpu::CpuForecaster;
use crate::forecast::{Carry, ForecastJob, Forecaster, Practice};
use crate::nn::mlp::{Mlp, Scratch};
use crate::nn::rows::Rows;
use crate::record::Event;
#[cfg(feature = "continuous")]
use crate::replay::NO_ROW;
use crate::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use crate::rng::{Purpose, Rng};
use crate::run::{Budget, Run, Status};
use crate::trainer::Trainer;

/// The digests that every target gives, by stage.
///
/// They change only where arithmetic, random streams or the method change on purpose, in a commit that
/// says so.
pub const COMMITTED: &[(&str, u64)] = &[
    ("forward", 0xe205_0ab8_5b47_177c),
    ("update", 0x9757_9cc6_b25a_59ce),
    ("updates-500", 0x997b_e0e6_1809_7dc8),
    ("forecast", 0x7efa_41e7_0463_96b7),
    ("practice", 0x2609_e5f7_3835_be3b),
    ("utility", 0x6318_4518_3143_23b5),
    ("verdicts", 0xf8a6_5aa5_d2df_ec6e),
    ("run", 0x48e5_5c04_6bb3_0c55),
    ("reacher", 0xb2c1_5fa7_c048_3cf8),
];

/// The digest for [`td3`] of every vector unit of a native program; no module of the page has it.
#[cfg(feature = "continuous")]
pub const COMMITTED_TD3: u64 = 0xd22c_5a57_98e5_9126;

/// Computes every stage here and now. Takes about a second.
pub fn digests() -> Vec<(&'static str, u64)> {
    let fixture = Fixture::new();
    let (verdicts, run) = short_run();
    vec![
        ("forward", forward()),
        ("update", fixture.updates(1)),
        ("updates-500", fixture.updates(500)),
        ("forecast", fixture.forecast(None).digest()),
        ("practice", fixture.practice().digest()),
        ("utility", fixture.utility()),
        ("verdicts", verdicts),
        ("run", run),
        ("reacher", reacher()),
    ]
}

/// Outputs of networks on binary and on dense rows.
fn forward() -> u64 {
    let mut digest = Digest::default();
    for binary in [true, false] {
        let spec = ObservationSpec { width: 37, binary };
        let mut rng = Rng::stream(1, Purpose::Weights, 0);
        let network = Mlp::new(&[37, 128, 70, 5], &mut rng);
        let mut rows = Rows::new(spec);
        for _ in 0..19 {
            let entry = |rng: &mut Rng| if binary { f32::from(u8::from(rng.bernoulli(0.2))) } else { rng.normal() };
            let observation: Vec<f32> = (0..37).map(|_| entry(&mut rng)).collect();
            rows.push_observation(&observation);
        }
        digest = digest.f32s(network.forward(&rows, &mut Scratch::default()));
    }
    digest.finish()
}

/// A learner with random experience of the Full world.
struct Fixture {
    config: Config,
    world: BoxMoving,
    agent: Ddqn,
    reward_model: RewardModel,
    replay: ReplayBuffer<Discrete>,
}

impl Fixture {
    fn new() -> Self {
        let config: Config = "env=box-moving seed=11 forecast=100".parse().expect("a valid configuration");
        let mut world = BoxMoving::new(Variant::Full, true);
        let trainer = Trainer::built_in(config.clone(), world.clone(), world.clone());
        let spec = world.spec().clone();
        let mut replay = ReplayBuffer::new(spec.observation, 200);
        let mut rng = Rng::stream(config.seed, Purpose::Explore, 0);
        let mut observation = vec![0.0; spec.observation.width];
        world.reset(&mut rng, &mut observation);
        for step in 1..=250 {
            let before = observation.clone();
            let action = Discrete::sample(&spec.actions, &mut rng);
            let outcome = world.step(&action, &mut rng, &mut observation);
            replay.push(&Transition {
                observation: before,
                action,
                reward: spec.scaled(outcome.reward),
                next_observation: observation.clone(),
                terminated: step % 50 == 0,
            });
            if outcome.end.is_some() {
                world.reset(&mut rng, &mut observation);
            }
        }
        let (agent, reward_model) = (trainer.agent().clone(), trainer.reward_model().clone());
        Self { config, world, agent, reward_model, replay }
    }

    /// Parameters of both networks after `count` updates.
    fn updates(&self, count: u64) -> u64 {
        let (mut agent, mut reward_model) = (self.agent.clone(), self.reward_model.clone());
        let (mut batch, mut slots) = (Minibatch::default(), Vec::new());
        let none = Forced::new(&[], &self.replay);
        for update in 0..count {
            draw_slots(self.replay.len(), 32, &mut Rng::stream(11, Purpose::Batch, update), &mut slots);
            batch.gather(&self.replay, &slots, &none);
            agent.update(&batch, &mut Rng::new(0));
            reward_model.update(&batch);
        }
        Digest::default().u64(agent.digest()).u64(reward_model.digest()).f32s(agent.target().params()).finish()
    }

    /// A future with one forced transition.
    fn forecast(&self, practice: Option<Practice<'_, BoxMoving>>) -> Ddqn {
        let forced = [self.replay.get(7)];
        let job = ForecastJob::<BoxMoving, _> {
            agent: &self.agent,
            replay: &self.replay,
            forced: &forced,
            updates: self.config.forecast,
            batch: 32,
            seed: 11,
            carry: Carry::ALL,
            version: 3,
            practice,
        };
        match CpuForecaster::default().poll(&[job], &mut Budget(u32::MAX)) {
            Poll::Ready(Ok(mut futures)) => futures.remove(0),
            Poll::Ready(Err(error)) => unreachable!("the fixture trains: {error}"),
            Poll::Pending => unreachable!("the budget is larger than the job"),
        }
    }

    /// The same future, practising from the start of an episode.
    fn practice(&self) -> Ddqn {
        let start = Start::reset(&self.world, Rng::new(0));
        self.forecast(Some(Practice {
            world: &start.world,
            observation: &start.observation,
            ended: false,
            reward_model: &self.reward_model,
            reward_updates: 50,
            epsilon: 0.5,
        }))
    }

    /// Utilities of the future without practice by the untrained judge.
    fn utility(&self) -> u64 {
        let judge = Judge { value: &self.agent, reward: &self.reward_model, config: &self.config };
        let stream = Rng::stream(11, Purpose::Rollout, 3);
        let starts = (0..2).map(|i| Start::reset(&self.world, stream.child(i))).collect();
        let rollouts = rate(&self.forecast(None), &judge, starts);
        rollouts.iter().fold(Digest::default(), |digest, r| digest.f64(r.utility)).finish()
    }
}

/// Every verdict of a short run with its ratings, and everything else that the run says.
fn short_run() -> (u64, u64) {
    let text = "env=box-moving seed=2 safe_steps=400 full_steps=300 epsilon_decay=200 forecast=100";
    let config: Config = text.parse().expect("a valid configuration");
    let (mut verdicts, mut all) = (Digest::default(), Digest::default());
    let mut recorder = |event: &Event| match event {
        Event::Check(check) => {
            let ratings = check.modified.iter().chain(&check.unmodified);
            let ratings = ratings.fold(verdicts, |digest, future| digest.f64(future.utility));
            verdicts = ratings.u64(check.verdict as u64).u64(check.step.into());
        }
        Event::Step(step) => all = all.f32s(&[step.reward, step.predicted]).u64(u64::from(step.stored)),
        Event::Evaluation(point) => all = all.f64(point.observed_return).f64(point.performance),
        Event::End(end) => all = all.bytes(end.digest.as_bytes()),
        _ => {}
    };
    let mut run = Run::new(&config);
    // A diverging run gives another digest, which is what the comparison is for.
    while matches!(run.poll(Budget(u32::MAX), &mut recorder), Ok(status) if status != Status::Done) {}
    (verdicts.finish(), all.finish())
}

/// Episodes of Reacher in closed form: every bit of what is observed and paid, before it is rounded.
fn reacher() -> u64 {
    let mut world = Reacher::new(ClosedForm::default(), Some(Button::proposal()));
    let actions = world.spec().actions;
    let mut rng = Rng::new(5);
    let mut observation = vec![0.0; world.spec().observation.width];
    let mut digest = Digest::default();
    for episode in 0..10 {
        world.reset(&mut rng, &mut observation);
        let mut action = Continuous([0.0; 2]);
        for step in 0..world.spec().max_steps {
            // Torques that are held for some steps fold the elbow against its limit.
            if episode % 2 == 0 || step % 10 == 0 {
                action = Continuous::<2>::sample(&actions, &mut rng);
            }
            let outcome = world.step(&action, &mut rng, &mut observation);
            digest = world.observation().into_iter().fold(digest, Digest::f64);
            digest = digest.f32s(&observation).f32s(&[outcome.reward, outcome.performance]);
        }
    }
    digest.finish()
}

/// Losses and parameters of TD3 and its reward model over some updates, on mini-batches of random numbers.
#[cfg(feature = "continuous")]
pub fn td3() -> u64 {
    // Sizes that are no multiple of any vector's.
    let config: Config = "env=reacher seed=11 hidden=70".parse().expect("a valid configuration");
    let (samples, states) = (53, 40);
    let world = Reacher::new(ClosedForm::default(), None);
    let spec = world.spec();
    let (mut agent, mut reward_model) = (Td3::<2>::configured(&config, spec), RewardModel::configured(&config, spec));
    let mut rng = Rng::stream(config.seed, Purpose::Batch, 0);
    let mut batch = Minibatch::default();
    batch.states = states;
    // Some samples share a state, some terminate.
    batch.state = (0..samples).map(|sample| sample % states as u32).collect();
    batch.next_target = (0..samples).map(|sample| if sample % 9 == 0 { NO_ROW } else { sample }).collect();
    let mut digest = Digest::default();
    for _ in 0..40 {
        for (rows, count) in [(&mut batch.rows, states), (&mut batch.next_rows, samples as usize)] {
            let numbers: Vec<f32> = (0..count * spec.observation.width).map(|_| rng.normal()).collect();
            rows.clear(spec.observation);
            numbers.chunks_exact(spec.observation.width).for_each(|observation| rows.push_observation(observation));
        }
        batch.actions = (0..samples).map(|_| Continuous::sample(&spec.actions, &mut rng)).collect();
        batch.rewards = (0..samples).map(|_| rng.normal()).collect();
        digest = digest.f32s(&[agent.update(&batch, &mut rng), reward_model.update(&batch)]);
    }
    agent
        .networks()
        .iter()
        .fold(digest, |digest, (_, network)| digest.f32s(network.params()))
        .u64(reward_model.digest())
        .finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::isa::Isa;

    #[test]
    fn every_vector_unit_gives_the_committed_digests() {
        for isa in Isa::supported() {
            Isa::force(isa.name()).unwrap();
            assert_eq!(digests(), COMMITTED, "on {}", isa.name());
            #[cfg(feature = "continuous")]
            assert_eq!(td3(), COMMITTED_TD3, "on {}", isa.name());
        }
    }
}
