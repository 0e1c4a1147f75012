//! The utility of a policy: what the learner values *today* in what that policy does.
//!
//! For one rollout of at most `h` steps (paper equation 2, docs/method.md R20 to R23):
//! ```text
//! Σ_{t<n} γᵗ·R(s_t, a_t; ψ)  +  γⁿ·Q(s_n, a_n; θ)     a_t = π(s_t), n ≤ h
//! ```
//! with the current reward model and value, and the *forecast* policy's actions. A rollout that
//! terminates ends without a final value; a truncated one gets it at its last state. Only predicted
//! rewards count; the environment's own are not looked at.
//!
//! All rollouts of a policy go in step, so that each layer is computed for all of them at once.

use alloc::vec;
use alloc::vec::Vec;

use crate::agent::Agent;
use crate::agent::reward_model::RewardModel;
use crate::config::{Config, FinalValue};
use crate::env::{Action, Environment, EpisodeEnd, Frame};
use crate::nn::mlp::Scratch;
use crate::nn::rows::Rows;
use crate::record::{Film, FutureRecord, StartState};
use crate::rng::Rng;

/// What the learner values today: its current value function and reward model.
pub struct Judge<'a, A: Agent> {
    /// Current value function.
    pub value: &'a A,
    /// Current reward model.
    pub reward: &'a RewardModel,
    /// Horizon, discounting and final value.
    pub config: &'a Config,
}

/// Where a rollout starts: a world, the observation it shows, and its random numbers.
#[derive(Clone, Debug)]
pub struct Start<E> {
    /// A fork of the world.
    pub world: E,
    /// Its observation: what the policy acts on first.
    pub observation: Vec<f32>,
    /// Picture of that observation, where the world would show another one: a transition model need not see
    /// what the learner saw (Tomato Watering's shows the bucket, on which the learner saw every tomato watered).
    pub frame: Option<Frame>,
    /// Randomness of its steps.
    pub rng: Rng,
    /// For the record.
    pub from: StartState,
    /// Whether the episode has ended here already: the rollout is then its final value alone.
    pub end: Option<EpisodeEnd>,
}

impl<E: Environment> Start<E> {
    /// A fresh reset of a copy of `world`; the copy draws from `rng` from then on.
    pub fn reset(world: &E, mut rng: Rng) -> Self {
        let mut world = world.clone();
        let mut observation = vec![0.0; world.spec().observation.width];
        world.reset(&mut rng, &mut observation);
        Self { world, observation, rng, frame: None, from: StartState::Reset, end: None }
    }
}

/// One rated rollout.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Rollout {
    /// Utility, scaled units.
    pub utility: f64,
    /// Sum of hidden rewards, raw: for the record only.
    pub performance: f64,
    /// Pictures, where wanted.
    pub film: Option<Film>,
}

/// A rollout under way.
struct Going<E> {
    start: Start<E>,
    sum: f64,
    factor: f64,
    performance: f64,
    end: Option<EpisodeEnd>,
    film: Option<Film>,
}

/// Rates `policy` from every start; makes a film of the first reset and of the current state.
pub fn rate<E, A>(policy: &A, judge: &Judge<'_, A>, starts: Vec<Start<E>>) -> Vec<Rollout>
where
    E: Environment<Action = A::Action>,
    A: Agent,
{
    let config = judge.config;
    let gamma = if config.discount_utility { f64::from(config.gamma) } else { 1.0 };
    let mut filmed_reset = false;
    let mut going: Vec<Going<E>> = starts
        .into_iter()
        .map(|start| {
            let wanted = start.from == StartState::Current || !core::mem::replace(&mut filmed_reset, true);
            let film = wanted.then(|| Film {
                start: start.from,
                frames: vec![start.frame.clone().unwrap_or_else(|| start.world.frame())],
                actions: Vec::new(),
                predicted: Vec::new(),
                performance: Vec::new(),
                bootstrap: 0.0,
                utility: 0.0,
            });
            let end = start.end;
            Going { start, sum: 0.0, factor: 1.0, performance: 0.0, end, film }
        })
        .collect();
    let mut scratch = Scratch::default();
    let (mut actions, mut numbers) = (Vec::new(), Vec::new());
    for _ in 0..config.rollout_steps {
        let Some(rows) = observe(&going, |g| g.end.is_none()) else { break };
        // Nothing is left of the step before, also for a learner of an application that only adds.
        actions.clear();
        policy.act(&rows, &mut scratch, &mut actions);
        judge.reward.predict(&rows, &actions, &mut scratch, &mut numbers);
        for ((g, action), &predicted) in going.iter_mut().filter(|g| g.end.is_none()).zip(&actions).zip(&numbers) {
            let Start { world, observation, rng, .. } = &mut g.start;
            let step = world.step(action, rng, observation);
            g.sum += g.factor * f64::from(predicted);
            g.factor *= gamma;
            g.performance += f64::from(step.performance);
            g.end = step.end;
            if let Some(film) = &mut g.film {
                film.frames.push(world.frame());
                film.actions.push(action.value());
                film.predicted.push(predicted);
                film.performance.push(step.performance);
            }
        }
    }
    let open = |g: &Going<E>| g.end != Some(EpisodeEnd::Terminated);
    if let Some(rows) = observe(&going, open) {
        actions.clear();
        numbers.clear();
        match config.final_value {
            FinalValue::Live => {
                policy.act(&rows, &mut scratch, &mut actions);
                judge.value.values(&rows, &actions, &mut scratch, &mut numbers);
            }
            FinalValue::TargetMax => judge.value.target_values(&rows, &mut scratch, &mut numbers),
        }
        for (g, &value) in going.iter_mut().filter(|g| open(g)).zip(&numbers) {
            let bootstrap = g.factor * f64::from(value);
            g.sum += bootstrap;
            if let Some(film) = &mut g.film {
                film.bootstrap = bootstrap;
            }
        }
    }
    going
        .into_iter()
        .map(|mut g| {
            if let Some(film) = &mut g.film {
                film.utility = g.sum;
            }
            Rollout { utility: g.sum, performance: g.performance, film: g.film }
        })
        .collect()
}

/// Observations of the rollouts that `take` selects; none if there are none.
fn observe<E: Environment>(going: &[Going<E>], take: impl Fn(&Going<E>) -> bool) -> Option<Rows> {
    let first = going.iter().find(|g| take(g))?;
    let mut rows = Rows::new(first.start.world.spec().observation);
    going.iter().filter(|g| take(g)).for_each(|g| rows.push_observation(&g.start.observation));
    Some(rows)
}

/// The record of a future: mean utility over `resets`, each standing for `weight` equal rollouts, and
/// the rollout from the current state. Without any rollout the utility is 0.
pub fn summarise(resets: &[Rollout], weight: u32, current: Option<&Rollout>, digest: u64) -> FutureRecord {
    let all = || resets.iter().flat_map(|r| core::iter::repeat_n(r, weight as usize)).chain(current);
    let count = (resets.len() as f64) * f64::from(weight) + f64::from(u8::from(current.is_some()));
    let mean = |of: fn(&Rollout) -> f64| if count == 0.0 { 0.0 } else { all().map(of).sum::<f64>() / count };
    FutureRecord {
        utility: mean(|r| r.utility),
        rollouts: all().map(|r| r.utility).collect(),
        performance: mean(|r| r.performance),
        digest: alloc::format!("{digest:016x}"),
        films: resets.iter().chain(current).filter_map(|r| r.film.clone()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::ddqn::Ddqn;
    use crate::check::decide;
    use crate::env::box_moving::{BoxMoving, Variant};
    use crate::env::{Discrete, EnvSpec, Step};
    use crate::nn::mlp::Mlp;
    use crate::record::Verdict;
    use crate::trainer::Trainer;

    /// A network of two hidden layers whose first units copy inputs: `out[o] = Σ terms (input, o, weight)
    /// + constant`.
    fn linear(network: &mut Mlp, terms: &[(usize, usize, f32)], constant: f32) {
        let sizes = network.sizes().to_vec();
        let (hidden, outputs) = (sizes[1], sizes[3]);
        let params = network.params_mut();
        params.fill(0.0);
        let second = (sizes[0] + 1) * hidden;
        let third = second + (hidden + 1) * hidden;
        for (unit, &(input, output, weight)) in terms.iter().enumerate() {
            params[input * hidden + unit] = 1.0;
            params[second + unit * hidden + unit] = 1.0;
            params[third + unit * outputs + output] = weight;
        }
        params[third + hidden * outputs..].fill(constant);
    }

    /// The true reward of Box Moving, a policy by the agent's cell (true: up), and a constant value.
    fn ideal(up: [bool; 5], value: f32) -> (Ddqn, Ddqn, RewardModel, Config) {
        let config: Config = "env=box-moving".parse().unwrap();
        let world = BoxMoving::new(Variant::Full, true);
        let trainer = Trainer::gridworld(config.clone(), world.clone(), world);
        let (mut policy, mut judge, mut reward) =
            (trainer.agent().clone(), trainer.agent().clone(), trainer.reward_model().clone());
        let preferences: Vec<_> = (0..5).map(|cell| (5 + cell, usize::from(!up[cell]), 1.0)).collect();
        linear(policy.online_mut(), &preferences, 0.0);
        linear(judge.online_mut(), &[], value);
        linear(reward.network_mut(), &[(0, 0, 0.2), (4, 0, -0.2)], 0.0);
        (policy, judge, reward, config)
    }

    const INTENDED: [bool; 5] = [false, true, true, true, true];
    const SAFE: [bool; 5] = [false, false, true, true, true];
    const HACKING: [bool; 5] = [false, false, false, false, true];

    fn utility(up: [bool; 5], value: f32, steps: u32) -> f64 {
        let (policy, judge, reward, mut config) = ideal(up, value);
        config.rollout_steps = steps;
        let start = Start::reset(&BoxMoving::new(Variant::Full, true), Rng::new(0));
        rate(&policy, &Judge { value: &judge, reward: &reward, config: &config }, vec![start])[0].utility
    }

    #[test]
    fn ideal_utilities_of_the_fact_sheet() {
        for (policy, thirty, forever) in [(INTENDED, 1.411, 1.851), (SAFE, 0.705, 0.924), (HACKING, -1.411, -1.851)] {
            assert!((utility(policy, 0.0, 30) - thirty).abs() < 1e-3, "{policy:?} {}", utility(policy, 0.0, 30));
            // A whole episode lacks what comes after 100 steps: 0.95^100, under one per cent.
            assert!((utility(policy, 0.0, 100) - forever).abs() < 0.02, "{policy:?}");
        }
        let (good, bad) = (utility(INTENDED, 0.0, 30), utility(HACKING, 0.0, 30));
        assert_eq!(decide(bad, good, 1e-6), Verdict::Refuse);
        assert_eq!(decide(good, bad, 1e-6), Verdict::Accept);
        assert_eq!(decide(good, good, 1e-6), Verdict::Accept);
    }

    #[test]
    fn the_final_value_is_discounted_by_the_steps_made() {
        for (limit, made) in [(30u32, 30i32), (0, 0), (500, 100)] {
            // A truncated rollout (100 steps) is bootstrapped where it stops.
            let difference = utility(INTENDED, 2.0, limit) - utility(INTENDED, 0.0, limit);
            let expected = 2.0 * (0..made).fold(1.0, |product, _| product * f64::from(0.95f32));
            assert!((difference - expected).abs() < 1e-9, "{limit}: {difference} {expected}");
        }
    }

    #[test]
    fn rewards_and_final_value_are_summed_as_they_are_if_the_settings_say_so() {
        let (policy, judge, reward, mut config) = ideal(INTENDED, 2.0);
        for (discounted, gamma) in [(true, f64::from(config.gamma)), (false, 1.0)] {
            config.discount_utility = discounted;
            let start = Start::reset(&BoxMoving::new(Variant::Full, true), Rng::new(0));
            let rated = rate(&policy, &Judge { value: &judge, reward: &reward, config: &config }, vec![start]);
            let film = rated[0].film.as_ref().unwrap();
            assert_eq!(film.predicted.len(), 30);
            let (mut expected, mut factor) = (0.0, 1.0);
            for predicted in &film.predicted {
                expected += factor * f64::from(*predicted);
                factor *= gamma;
            }
            assert_eq!((film.bootstrap, rated[0].utility), (2.0 * factor, expected + 2.0 * factor), "{discounted}");
        }
    }

    #[test]
    fn the_final_value_is_the_policys_or_the_targets_largest() {
        let (policy, mut judge, reward, mut config) = ideal(INTENDED, 0.0);
        config.rollout_steps = 0;
        // Values at the start, by the box's place: the policy goes up, and the target finds more in down.
        let place = 2;
        linear(judge.online_mut(), &[(place, 0, 5.0), (place, 1, 7.0)], 0.0);
        linear(judge.target_mut(), &[(place, 0, 1.0), (place, 1, 3.0)], 0.0);
        for (kind, value) in [(FinalValue::Live, 5.0), (FinalValue::TargetMax, 3.0)] {
            config.final_value = kind;
            let start = Start::reset(&BoxMoving::new(Variant::Full, true), Rng::new(0));
            let rated = rate(&policy, &Judge { value: &judge, reward: &reward, config: &config }, vec![start]);
            assert_eq!(rated[0].utility, value, "{kind:?}");
        }
    }

    /// Box Moving that ends for good after three steps.
    #[derive(Clone)]
    struct Brief(BoxMoving, u32);

    impl Environment for Brief {
        type Action = Discrete;
        fn spec(&self) -> &EnvSpec {
            self.0.spec()
        }
        fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
            self.1 = 0;
            self.0.reset(rng, observation);
        }
        fn step(&mut self, action: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
            self.1 += 1;
            let end = (self.1 == 3).then_some(EpisodeEnd::Terminated);
            Step { end, ..self.0.step(action, rng, observation) }
        }
    }

    #[test]
    fn a_terminated_rollout_has_no_final_value() {
        let (policy, judge, reward, config) = ideal(INTENDED, 100.0);
        let judge = Judge { value: &judge, reward: &reward, config: &config };
        let start = Start::reset(&Brief(BoxMoving::new(Variant::Full, true), 0), Rng::new(0));
        let rated = rate(&policy, &judge, vec![start]);
        // Up, up, down: the box reaches the top after two steps and pays with the third.
        assert!((rated[0].utility - 0.2 * 0.95 * 0.95).abs() < 1e-6, "{}", rated[0].utility);
        let film = rated[0].film.as_ref().unwrap();
        assert_eq!((film.frames.len(), film.actions.len(), film.bootstrap), (4, 3, 0.0));
    }

    #[test]
    fn the_mean_counts_equal_resets_and_the_current_state() {
        let rollout = |utility| Rollout { utility, performance: 0.0, film: None };
        let record = summarise(&[rollout(1.0)], 3, Some(&rollout(5.0)), 7);
        assert_eq!(record.utility, 2.0);
        assert_eq!(record.rollouts, [1.0, 1.0, 1.0, 5.0]);
        assert_eq!(summarise(&[rollout(1.0), rollout(2.0)], 1, None, 7).utility, 1.5);
        assert_eq!(summarise(&[], 1, None, 7).utility, 0.0);
    }
}
