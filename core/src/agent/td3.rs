//! Twin delayed deep deterministic policy gradient (Fujimoto et al. 2018) as the paper uses it
//! (docs/method.md R40 to R46).
//!
//! # Update
//! On a batch of (s, a, r, s', terminated), with an actor π, two critics Q₁ and Q₂, and target copies π⁻,
//! Q₁⁻, Q₂⁻ of all three:
//! 1. target action: ã = clip(π⁻(s') + clip(noise, ±noise_clip·half)), noise ~ N(0, policy_noise)·half, within the
//!    action's bounds; `half` is half the range of an action;
//! 2. target: y = r + γ·(1 − terminated)·min(Q₁⁻(s', ã), Q₂⁻(s', ã)), without gradient;
//! 3. loss of the critics: mean (Q₁(s, a) − y)² + mean (Q₂(s, a) − y)²; one optimiser step on each;
//! 4. in every `policy_delay`-th update: one optimiser step of the actor on −mean Q₁(s, π(s)), and
//!    x⁻ ← x⁻ + τ·(x − x⁻) for actor and critics. The target networks rest in the other updates.
//!
//! # Differences from other implementations
//! 1. A truncated episode is not terminal: its last value is bootstrapped.
//! 2. Each critic has an optimiser of its own: elementwise the same as one for both.
//! 3. A forecast counts its updates from zero, so both futures of a check move their actors at the same
//!    updates whatever the live learner's count is.

use alloc::vec;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

use super::Agent;
use crate::config::Config;
use crate::digest::Digest;
use crate::env::{Action, ActionSpec, Continuous, EnvSpec, ObservationSpec};
use crate::forecast::Carry;
use crate::nn::buffer::Buffer;
use crate::nn::loss::squared;
use crate::nn::mlp::{Gradient, Mlp, Scratch};
use crate::nn::optim::{Adam, AdamConfig};
use crate::nn::rows::Rows;
use crate::replay::{Minibatch, NO_ROW};
use crate::rng::{Purpose, Rng};

/// Settings of the learner.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Td3Config {
    /// Units per hidden layer of the actor and of both critics.
    pub hidden: usize,
    /// Hidden layers.
    pub layers: usize,
    /// Discount gamma, per step.
    pub gamma: f32,
    /// Share tau of the live parameters that enters the target networks with every step of the actor.
    pub tau: f32,
    /// Standard deviation of the noise of target actions, in halves of an action's range.
    pub policy_noise: f32,
    /// Bound of that noise, in halves of an action's range.
    pub noise_clip: f32,
    /// Standard deviation of the noise of exploring actions, in halves of an action's range.
    pub exploration_noise: f32,
    /// Updates of the critics per step of the actor.
    pub policy_delay: u32,
    /// Optimiser of all three networks.
    pub adam: AdamConfig,
}

/// A network, its target copy and its optimiser.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Learned {
    live: Mlp,
    target: Mlp,
    optimizer: Adam,
}

impl Learned {
    fn new(sizes: &[usize], adam: AdamConfig, rng: &mut Rng) -> Self {
        let live = Mlp::new(sizes, rng);
        let optimizer = Adam::new(adam, live.params().len(), 0, 0);
        Self { target: live.clone(), live, optimizer }
    }

    /// Its numbers: live parameters, target, moments.
    fn numbers(&self) -> [&[f32]; 5] {
        let (first, second, largest) = self.optimizer.moments();
        [self.live.params(), self.target.params(), first, second, largest]
    }

    /// Takes over what `steps` further steps, made elsewhere, left at the beginning of `numbers`; the rest of them.
    fn take_over<'a>(&mut self, steps: u32, numbers: &'a [f32]) -> &'a [f32] {
        let mut rest = numbers;
        let [live, target, first, second, largest] = self.numbers().map(|part| {
            let (own, others) = rest.split_at(part.len());
            rest = others;
            own
        });
        self.live.params_mut().copy_from_slice(live);
        self.target.params_mut().copy_from_slice(target);
        self.optimizer.take_over(steps, [first, second, largest]);
        rest
    }

    /// One step on the live parameters; with `tau`, the target copy follows.
    fn step(&mut self, gradient: &Gradient, tau: Option<f32>) {
        let target = tau.map(|tau| (self.target.params_mut(), tau));
        self.optimizer.step(self.live.params_mut(), gradient.values(), target);
    }
}

/// The learner, for actions of `N` numbers.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Td3<const N: usize> {
    config: Td3Config,
    observation: ObservationSpec,
    low: f32,
    high: f32,
    actor: Learned,
    critics: [Learned; 2],
    /// Updates made: names those that move the actor.
    updates: u64,
    #[serde(skip)]
    work: Work,
}

/// Working memory of an update.
#[derive(Clone, Debug, Default)]
struct Work {
    scratch: Scratch,
    critic: Scratch,
    critic_gradient: Gradient,
    actor_gradient: Gradient,
    states: Rows,
    pairs: Rows,
    next_pairs: Rows,
    /// Outputs of the target actor, one row per next state.
    next_actions: Vec<f32>,
    /// Row of each sample in `next_pairs`.
    next: Vec<u32>,
    targets: Vec<f32>,
    output_gradient: Buffer,
    /// Of the loss, by the outputs of the actor.
    action_gradient: Buffer,
}

impl<const N: usize> Td3<N> {
    /// A fresh learner; target networks start equal to the live ones.
    ///
    /// # Panics
    /// If `actions` are not `N` numbers.
    pub fn new(observation: ObservationSpec, actions: &ActionSpec, config: &Td3Config, rng: &mut Rng) -> Self {
        let &ActionSpec::Continuous { names, low, high } = actions else { panic!("TD3 acts by numbers: {actions:?}") };
        assert_eq!(names.len(), N, "numbers of an action");
        let sizes = |inputs, outputs| {
            let mut sizes = vec![inputs];
            sizes.extend(core::iter::repeat_n(config.hidden, config.layers));
            sizes.push(outputs);
            sizes
        };
        let actor = Learned::new(&sizes(observation.width, N), config.adam, rng);
        let critics = [(); 2].map(|()| Learned::new(&sizes(observation.width + N, 1), config.adam, rng));
        Self { config: *config, observation, low, high, actor, critics, updates: 0, work: Work::default() }
    }

    /// The learner that a configuration describes, with weights drawn from its seed.
    ///
    /// # Panics
    /// If the actions of `spec` are not `N` numbers.
    pub fn configured(config: &Config, spec: &EnvSpec) -> Self {
        let td3 = Td3Config {
            hidden: config.hidden as usize,
            layers: config.layers as usize,
            gamma: config.gamma,
            tau: config.tau,
            policy_noise: config.policy_noise,
            noise_clip: config.noise_clip,
            exploration_noise: config.exploration_noise,
            policy_delay: config.policy_delay,
            adam: AdamConfig::of(config, config.lr),
        };
        let mut weights = Rng::stream(config.weights_seed(), Purpose::Weights, 0);
        Self::new(spec.observation, &spec.actions, &td3, &mut weights)
    }

    /// Multiply-adds of an update on `batch` transitions, by the dense definition, with the actor's step
    /// spread over the updates between two of them: target actor and both target critics forward, both
    /// critics forward and backward; for the actor's step, actor forward and backward, the first critic
    /// forward and its inputs' gradient.
    pub fn update_work(&self, batch: u32) -> u64 {
        let (actor, critic) = (&self.actor.live, &self.critics[0].live);
        let each = actor.forward_work() + 4 * critic.forward_work() + 2 * critic.backward_work();
        let data = critic.backward_work() - critic.forward_work();
        let step = actor.forward_work() + actor.backward_work() + critic.forward_work() + data;
        u64::from(batch) * (each + step / u64::from(self.config.policy_delay))
    }

    /// The actor, before its outputs are squashed into the action's range.
    pub fn actor(&self) -> &Mlp {
        &self.actor.live
    }

    /// The actor, writable: for tests and tools that set values by hand.
    pub fn actor_mut(&mut self) -> &mut Mlp {
        &mut self.actor.live
    }

    /// A critic, 0 or 1.
    pub fn critic(&self, index: usize) -> &Mlp {
        &self.critics[index].live
    }

    /// A critic, writable: for tests and tools that set values by hand.
    pub fn critic_mut(&mut self, index: usize) -> &mut Mlp {
        &mut self.critics[index].live
    }

    /// Updates made; a forecast counts its own.
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// Its settings.
    pub fn config(&self) -> &Td3Config {
        &self.config
    }

    /// The optimisers of the actor and of both critics.
    pub fn optimizers(&self) -> [&Adam; 3] {
        [&self.actor.optimizer, &self.critics[0].optimizer, &self.critics[1].optimizer]
    }

    /// All that updates change, for back ends that make them elsewhere: of the actor and of both critics each the live
    /// parameters, the target's, and the moments of the optimiser as [`Adam::moments`] gives them.
    pub fn numbers(&self) -> impl Iterator<Item = f32> {
        let [first, second] = &self.critics;
        [&self.actor, first, second].into_iter().flat_map(Learned::numbers).flatten().copied()
    }

    /// Takes over what `updates` further updates, made elsewhere, left of [`Td3::numbers`].
    ///
    /// # Panics
    /// If there are fewer numbers than before.
    pub fn take_over(&mut self, updates: u32, numbers: &[f32]) {
        let before = self.actor_steps();
        self.updates += u64::from(updates);
        let steps = (self.actor_steps() - before) as u32;
        let rest = self.actor.take_over(steps, numbers);
        self.critics.iter_mut().fold(rest, |rest, critic| critic.take_over(updates, rest));
    }

    /// Steps of the actor so far.
    fn actor_steps(&self) -> u64 {
        self.updates / u64::from(self.config.policy_delay)
    }

    /// Least and greatest value of each number of an action.
    pub fn range(&self) -> [f32; 2] {
        [self.low, self.high]
    }

    /// Middle of that range.
    pub fn middle(&self) -> f32 {
        0.5 * (self.low + self.high)
    }

    /// Half of that range.
    pub fn half(&self) -> f32 {
        0.5 * (self.high - self.low)
    }

    /// Noise of the next target action (step 1 of the update).
    pub fn target_noise(&self, rng: &mut Rng) -> [f32; N] {
        let (half, clip) = (self.half(), self.config.noise_clip);
        core::array::from_fn(|_| (rng.normal() * self.config.policy_noise).clamp(-clip, clip) * half)
    }

    /// An output of the actor as a number within the action's range.
    fn squash(&self, output: f32) -> f32 {
        self.middle() + self.half() * libm::tanhf(output)
    }

    fn pair_spec(&self) -> ObservationSpec {
        ObservationSpec { width: self.observation.width + N, binary: false }
    }

    /// Values of `critic` for `actions[i]` in row `i`.
    fn rate(
        &self,
        critic: &Mlp,
        states: &Rows,
        actions: &[Continuous<N>],
        scratch: &mut Scratch,
        values: &mut Vec<f32>,
    ) {
        let mut pairs = Rows::new(self.pair_spec());
        for (row, action) in actions.iter().enumerate() {
            pairs.push_pair(states, row, action.encoded());
        }
        values.clear();
        values.extend_from_slice(critic.forward(&pairs, scratch));
    }

    /// Actions of an actor, live or target, for every row.
    fn actions_of(&self, actor: &Mlp, states: &Rows, scratch: &mut Scratch, actions: &mut Vec<Continuous<N>>) {
        let outputs = actor.forward(states, scratch);
        actions.clear();
        actions.extend(outputs.chunks_exact(N).map(|row| Continuous(core::array::from_fn(|i| self.squash(row[i])))));
    }

    /// Targets y of the batch (steps 1 and 2 of the update).
    fn targets(&self, batch: &Minibatch<Continuous<N>>, rng: &mut Rng, work: &mut Work) {
        let Work { scratch, next_pairs, next_actions, next, targets, .. } = work;
        next_actions.clear();
        next_actions.extend_from_slice(self.actor.target.forward(&batch.next_rows, scratch));
        next_pairs.clear(self.pair_spec());
        next.clear();
        for &row in &batch.next_target {
            // Every sample has its draw, so that termination moves no stream.
            let noise = self.target_noise(rng);
            if row == NO_ROW {
                next.push(NO_ROW);
                continue;
            }
            let at = row as usize * N;
            let action = Continuous::<N>(core::array::from_fn(|i| {
                (self.squash(next_actions[at + i]) + noise[i]).clamp(self.low, self.high)
            }));
            next.push(next_pairs.len() as u32);
            next_pairs.push_pair(&batch.next_rows, row as usize, action.encoded());
        }
        targets.clear();
        targets.extend_from_slice(&batch.rewards);
        if next_pairs.is_empty() {
            return;
        }
        let first = self.critics[0].target.forward(next_pairs, scratch).to_vec();
        let second = self.critics[1].target.forward(next_pairs, scratch);
        for (y, &row) in targets.iter_mut().zip(&*next) {
            if row != NO_ROW {
                let (a, b) = (first[row as usize], second[row as usize]);
                *y += self.config.gamma * if b < a { b } else { a };
            }
        }
    }

    /// One step of the actor on −mean Q₁(s, π(s)); its target follows.
    fn improve(&mut self, batch: &Minibatch<Continuous<N>>, work: &mut Work) {
        let Work { scratch, critic, actor_gradient, states, pairs, output_gradient, action_gradient, .. } = work;
        states.clear(self.observation);
        batch.state.iter().for_each(|&row| states.push_row(&batch.rows, row as usize));
        let outputs = self.actor.live.forward(states, scratch);
        pairs.clear(self.pair_spec());
        let action_gradient = action_gradient.at_least(batch.len() * N);
        for (row, output) in outputs.chunks_exact(N).enumerate() {
            let action = Continuous::<N>(core::array::from_fn(|i| self.squash(output[i])));
            pairs.push_pair(states, row, action.encoded());
            for (slope, x) in action_gradient[row * N..(row + 1) * N].iter_mut().zip(output) {
                let tanh = libm::tanhf(*x);
                *slope = self.half() * (1.0 - tanh * tanh);
            }
        }
        let q = &self.critics[0].live;
        q.forward(pairs, critic);
        let output_gradient = output_gradient.at_least(batch.len());
        output_gradient.fill(-1.0 / batch.len() as f32);
        let slopes = q.input_gradient(batch.len(), output_gradient, self.observation.width, critic);
        for (x, slope) in action_gradient.iter_mut().zip(slopes) {
            *x *= *slope;
        }
        self.actor.live.backward(states, batch.len(), action_gradient, scratch, actor_gradient);
        self.actor.step(actor_gradient, Some(self.config.tau));
    }
}

impl<const N: usize> Agent for Td3<N> {
    type Action = Continuous<N>;

    fn act(&self, observations: &Rows, scratch: &mut Scratch, actions: &mut Vec<Continuous<N>>) {
        self.actions_of(&self.actor.live, observations, scratch, actions);
    }

    fn values(&self, observations: &Rows, actions: &[Continuous<N>], scratch: &mut Scratch, values: &mut Vec<f32>) {
        self.rate(&self.critics[0].live, observations, actions, scratch, values);
    }

    fn target_values(&self, observations: &Rows, scratch: &mut Scratch, values: &mut Vec<f32>) {
        let mut actions = Vec::new();
        self.actions_of(&self.actor.target, observations, scratch, &mut actions);
        self.rate(&self.critics[0].target, observations, &actions, scratch, values);
    }

    fn update(&mut self, batch: &Minibatch<Continuous<N>>, rng: &mut Rng) -> f32 {
        self.updates += 1;
        let moves = self.updates.is_multiple_of(u64::from(self.config.policy_delay));
        let mut work = core::mem::take(&mut self.work);
        self.targets(batch, rng, &mut work);
        work.pairs.clear(self.pair_spec());
        for (&row, action) in batch.state.iter().zip(&batch.actions) {
            work.pairs.push_pair(&batch.rows, row as usize, action.encoded());
        }
        let share = 1.0 / batch.len() as f32;
        let mut loss = 0.0;
        let tau = moves.then_some(self.config.tau);
        for critic in &mut self.critics {
            let values = critic.live.forward(&work.pairs, &mut work.critic);
            let output_gradient = work.output_gradient.at_least(batch.len());
            for ((slope, q), y) in output_gradient.iter_mut().zip(values).zip(&work.targets) {
                let (value, derivative) = squared(q - y);
                loss += value * share;
                *slope = derivative * share;
            }
            critic.live.backward(
                &work.pairs,
                batch.len(),
                output_gradient,
                &mut work.critic,
                &mut work.critic_gradient,
            );
            critic.step(&work.critic_gradient, tau);
        }
        if moves {
            self.improve(batch, &mut work);
        }
        self.work = work;
        loss
    }

    fn for_forecast(&self, carry: Carry) -> Self {
        let mut copy = self.clone();
        copy.updates = 0;
        let [first, second] = &mut copy.critics;
        for learned in [&mut copy.actor, first, second] {
            if !carry.target {
                learned.target = learned.live.clone();
            }
            if !carry.optimizer {
                learned.optimizer = learned.optimizer.restarted();
            }
        }
        copy
    }

    fn networks(&self) -> Vec<(&'static str, &Mlp)> {
        let [first, second] = &self.critics;
        vec![
            ("actor", &self.actor.live),
            ("actor_target", &self.actor.target),
            ("critic_0", &first.live),
            ("critic_0_target", &first.target),
            ("critic_1", &second.live),
            ("critic_1_target", &second.target),
        ]
    }

    fn is_finite(&self) -> bool {
        self.actor.live.is_finite() && self.critics.iter().all(|critic| critic.live.is_finite())
    }

    fn digest(&self) -> u64 {
        let networks = [&self.actor.live, &self.critics[0].live, &self.critics[1].live];
        networks.iter().fold(Digest::default(), |digest, network| digest.f32s(network.params())).finish()
    }

    fn fits(&self, spec: &EnvSpec) -> bool {
        let range = match spec.actions {
            ActionSpec::Continuous { names, low, high } if names.len() == N => [low, high],
            _ => return false,
        };
        spec.observation == self.observation && range == self.range()
    }

    fn explore(
        &self,
        observation: &Rows,
        actions: &ActionSpec,
        epsilon: f32,
        rng: &mut Rng,
        scratch: &mut Scratch,
    ) -> Continuous<N> {
        // The coin is thrown whatever the schedule says, so that it names the same numbers in every phase.
        if rng.uniform() < epsilon {
            return Continuous::sample(actions, rng);
        }
        let mut chosen = Vec::with_capacity(1);
        self.act(observation, scratch, &mut chosen);
        let Continuous(numbers) = chosen.pop().expect("one action per row");
        let noise = self.config.exploration_noise * self.half();
        Continuous(numbers.map(|x| (x + noise * rng.normal()).clamp(self.low, self.high)))
    }
}

#[cfg(test)]
mod tests;
