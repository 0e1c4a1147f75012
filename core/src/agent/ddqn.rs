//! Double DQN (van Hasselt et al. 2016) as the paper uses it (docs/method.md R1 to R9).
//!
//! # Update
//! On a batch of (s, a, r, s', terminated), with live parameters θ and target parameters θ⁻:
//! 1. target y = r + γ·(1 − terminated)·Q(s', argmax_a Q(s', a; θ); θ⁻), without gradient (equation 1);
//! 2. loss: mean over the batch of SmoothL1(Q(s, a; θ) − y), β = 1;
//! 3. one optimiser step on θ, then θ⁻ ← θ⁻ + τ·(θ − θ⁻), after every update.
//!
//! # Differences from other implementations
//! 1. A truncated episode is not terminal: its last value is bootstrapped.
//! 2. The target network moves a little after every update instead of by copies.
//! 3. Equal states of a batch are computed once; their loss derivatives are summed in sample order.

use alloc::vec;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

use super::Agent;
use crate::config::Config;
use crate::digest::Digest;
use crate::env::{ActionSpec, Discrete, EnvSpec, ObservationSpec};
use crate::forecast::Carry;
use crate::nn::buffer::Buffer;
use crate::nn::loss::smooth_l1;
use crate::nn::mlp::{Gradient, Mlp, Scratch};
use crate::nn::optim::{Adam, AdamConfig};
use crate::nn::rows::Rows;
use crate::replay::{Minibatch, NO_ROW};
use crate::rng::{Purpose, Rng};

/// Settings of the learner.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DdqnConfig {
    /// Units per hidden layer.
    pub hidden: usize,
    /// Hidden layers.
    pub layers: usize,
    /// Discount gamma, per step.
    pub gamma: f32,
    /// Share tau of θ that enters θ⁻ after an update.
    pub tau: f32,
    /// Optimiser.
    pub adam: AdamConfig,
}

/// The learner.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Ddqn {
    gamma: f32,
    tau: f32,
    online: Mlp,
    target: Mlp,
    optimizer: Adam,
    #[serde(skip)]
    work: Work,
}

/// Working memory of an update.
#[derive(Clone, Debug, Default)]
struct Work {
    online: Scratch,
    target: Scratch,
    gradient: Gradient,
    output_gradient: Buffer,
}

impl Ddqn {
    /// A fresh learner; θ⁻ starts equal to θ.
    pub fn new(observation: ObservationSpec, actions: &ActionSpec, config: &DdqnConfig, rng: &mut Rng) -> Self {
        let mut sizes = Vec::with_capacity(config.layers + 2);
        sizes.push(observation.width);
        sizes.extend(core::iter::repeat_n(config.hidden, config.layers));
        sizes.push(actions.features());
        let online = Mlp::new(&sizes, rng);
        let (rows, row) = if observation.binary { online.first_rows() } else { (0, 0) };
        let optimizer = Adam::new(config.adam, online.params().len(), rows, row);
        Self { gamma: config.gamma, tau: config.tau, target: online.clone(), online, optimizer, work: Work::default() }
    }

    /// The learner that a configuration describes, with weights drawn from its seed.
    pub fn configured(config: &Config, spec: &EnvSpec) -> Self {
        let ddqn = DdqnConfig {
            hidden: config.hidden as usize,
            layers: config.layers as usize,
            gamma: config.gamma,
            tau: config.tau,
            adam: AdamConfig::of(config, config.lr),
        };
        let mut weights = Rng::stream(config.weights_seed(), Purpose::Weights, 0);
        Self::new(spec.observation, &spec.actions, &ddqn, &mut weights)
    }

    /// Multiply-adds of an update on `batch` transitions, by the dense definition: s and s' forward through
    /// the live network, s' through the target network, s backward.
    pub fn update_work(&self, batch: u32) -> u64 {
        u64::from(batch) * (3 * self.online.forward_work() + self.online.backward_work())
    }

    /// Discount gamma, per step.
    pub fn gamma(&self) -> f32 {
        self.gamma
    }

    /// Share tau of θ that enters θ⁻ after an update.
    pub fn tau(&self) -> f32 {
        self.tau
    }

    /// The optimiser of the live network.
    pub fn optimizer(&self) -> &Adam {
        &self.optimizer
    }

    /// The optimiser, writable: for back ends that make its steps elsewhere.
    pub fn optimizer_mut(&mut self) -> &mut Adam {
        &mut self.optimizer
    }

    /// The live network, Q(·; θ).
    pub fn online(&self) -> &Mlp {
        &self.online
    }

    /// The target network, Q(·; θ⁻).
    pub fn target(&self) -> &Mlp {
        &self.target
    }

    /// The live network, writable: for tests, and for back ends that make updates elsewhere.
    ///
    /// Of binary observations, updates skip the first-layer rows of inputs that never were one in a state of a batch:
    /// nothing moves θ⁻ to θ there, as both are the same from the start. Whoever changes such rows keeps them the
    /// same in both networks, or uses [`Ddqn::set_parameters`].
    pub fn online_mut(&mut self) -> &mut Mlp {
        &mut self.online
    }

    /// The target network, writable, under the same condition as [`Ddqn::online_mut`].
    pub fn target_mut(&mut self) -> &mut Mlp {
        &mut self.target
    }

    /// Sets θ and θ⁻, such as to those of a learner that was trained before, in the layout of [`Mlp::params`]; θ⁻
    /// follows θ in every row from here on. The moments of the optimiser stay.
    ///
    /// # Panics
    /// If there are more or fewer parameters than before.
    pub fn set_parameters(&mut self, online: &[f32], target: &[f32]) {
        self.online.params_mut().copy_from_slice(online);
        self.target.params_mut().copy_from_slice(target);
        self.optimizer.touch_all();
    }
}

/// Position of the largest value; the first of equal ones.
fn argmax(values: &[f32]) -> usize {
    let mut best = 0;
    for (i, value) in values.iter().enumerate().skip(1) {
        if *value > values[best] {
            best = i;
        }
    }
    best
}

impl Agent for Ddqn {
    type Action = Discrete;

    fn act(&self, observations: &Rows, scratch: &mut Scratch, actions: &mut Vec<Discrete>) {
        let outputs = self.online.outputs();
        let q = self.online.forward(observations, scratch);
        actions.clear();
        actions.extend(q.chunks_exact(outputs).map(|row| Discrete(argmax(row) as u8)));
    }

    fn values(&self, observations: &Rows, actions: &[Discrete], scratch: &mut Scratch, values: &mut Vec<f32>) {
        let outputs = self.online.outputs();
        let q = self.online.forward(observations, scratch);
        values.clear();
        values.extend(q.chunks_exact(outputs).zip(actions).map(|(row, action)| row[action.index()]));
    }

    fn target_values(&self, observations: &Rows, scratch: &mut Scratch, values: &mut Vec<f32>) {
        let outputs = self.target.outputs();
        let q = self.target.forward(observations, scratch);
        values.clear();
        values.extend(q.chunks_exact(outputs).map(|row| row[argmax(row)]));
    }

    fn update(&mut self, batch: &Minibatch<Discrete>, _rng: &mut Rng) -> f32 {
        let Work { online, target, gradient, output_gradient } = &mut self.work;
        let outputs = self.online.outputs();
        let q = self.online.forward(&batch.rows, online);
        let q_target = self.target.forward(&batch.next_rows, target);
        let output_gradient = output_gradient.at_least(batch.states * outputs);
        output_gradient.fill(0.0);
        let share = 1.0 / batch.len() as f32;
        let mut loss = 0.0;
        for i in 0..batch.len() {
            let mut y = batch.rewards[i];
            if batch.next[i] != NO_ROW {
                let next = batch.next[i] as usize * outputs;
                let best = argmax(&q[next..next + outputs]);
                y += self.gamma * q_target[batch.next_target[i] as usize * outputs + best];
            }
            let at = batch.state[i] as usize * outputs + batch.actions[i].index();
            let (value, slope) = smooth_l1(q[at] - y);
            loss += value * share;
            output_gradient[at] += slope * share;
        }
        self.online.backward(&batch.rows, batch.states, output_gradient, online, gradient);
        gradient.mark(&mut self.optimizer);
        let target = (self.target.params_mut(), self.tau);
        self.optimizer.step(self.online.params_mut(), gradient.values(), Some(target));
        loss
    }

    fn for_forecast(&self, carry: Carry) -> Self {
        let mut copy = self.clone();
        if !carry.target {
            copy.target = self.online.clone();
        }
        if !carry.optimizer {
            copy.optimizer = self.optimizer.restarted();
        }
        copy
    }

    fn networks(&self) -> Vec<(&'static str, &Mlp)> {
        vec![("value", &self.online), ("value_target", &self.target)]
    }

    fn is_finite(&self) -> bool {
        self.online.is_finite()
    }

    fn digest(&self) -> u64 {
        Digest::default().f32s(self.online.params()).finish()
    }

    fn fits(&self, spec: &EnvSpec) -> bool {
        let (inputs, outputs) = (spec.observation.width, spec.actions.features());
        // Rows of the first layer that wait for an entry 1 would wait for ever in dense observations.
        (spec.observation.binary || !self.optimizer.skips_rows())
            && [&self.online, &self.target].iter().all(|q| q.sizes()[0] == inputs && q.outputs() == outputs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Optimizer;
    use crate::replay::{Forced, ReplayBuffer, Transition};

    const SPEC: ObservationSpec = ObservationSpec { width: 4, binary: true };
    const ACTIONS: ActionSpec = ActionSpec::Discrete(&["left", "right"]);

    fn agent(lr: f32, hidden: usize) -> Ddqn {
        let adam = AdamConfig { kind: Optimizer::Adam, lr, weight_decay: 0.0, clip: 0.0 };
        let config = DdqnConfig { hidden, layers: 2, gamma: 0.5, tau: 0.25, adam };
        Ddqn::new(SPEC, &ACTIONS, &config, &mut Rng::new(1))
    }

    fn one_hot(state: usize) -> Vec<f32> {
        (0..4).map(|i| f32::from(u8::from(i == state))).collect()
    }

    fn transition(state: usize, action: u8, reward: f32, next: usize, terminated: bool) -> Transition<Discrete> {
        let (observation, next_observation) = (one_hot(state), one_hot(next));
        Transition { observation, action: Discrete(action), reward, next_observation, terminated }
    }

    fn batch(transitions: &[Transition<Discrete>]) -> Minibatch<Discrete> {
        let mut replay = ReplayBuffer::new(SPEC, 100);
        transitions.iter().for_each(|t| replay.push(t));
        let slots: Vec<u32> = (0..replay.len()).collect();
        let mut batch = Minibatch::default();
        batch.gather(&replay, &slots, &Forced::new(&[], &replay));
        batch
    }

    fn q(network: &Mlp, state: usize) -> Vec<f32> {
        let mut rows = Rows::new(SPEC);
        rows.push_observation(&one_hot(state));
        network.forward(&rows, &mut Scratch::default()).to_vec()
    }

    #[test]
    fn the_loss_is_that_of_double_dqn() {
        let mut agent = agent(1e-3, 16);
        // A target network that differs, so that the two networks' roles show.
        agent.target = Mlp::new(&[4, 16, 16, 2], &mut Rng::new(7));
        let samples =
            [transition(0, 1, 0.3, 2, false), transition(1, 0, -2.0, 3, true), transition(0, 1, 0.1, 0, false)];
        let expected: f32 = samples
            .iter()
            .map(|t| {
                let state = argmax(&t.observation);
                let next = argmax(&t.next_observation);
                let best = argmax(&q(&agent.online, next));
                let bootstrap = if t.terminated { 0.0 } else { 0.5 * q(&agent.target, next)[best] };
                smooth_l1(q(&agent.online, state)[t.action.index()] - (t.reward + bootstrap)).0 / 3.0
            })
            .sum();
        let loss = agent.update(&batch(&samples), &mut Rng::new(0));
        assert!((loss - expected).abs() < 1e-6, "{loss} {expected}");
    }

    #[test]
    fn the_target_follows_after_every_update() {
        let mut agent = agent(1e-3, 8);
        let before = agent.target.params().to_vec();
        agent.update(&batch(&[transition(0, 0, 1.0, 1, false)]), &mut Rng::new(0));
        let moved = before.iter().zip(agent.online.params()).zip(agent.target.params());
        for ((old, live), new) in moved {
            assert!((new - (old + 0.25 * (live - old))).abs() < 1e-7);
        }
        assert_ne!(before, agent.target.params());
    }

    #[test]
    fn the_target_follows_parameters_that_were_set_also_where_no_input_is_one() {
        let (mut agent, other) = (agent(1e-3, 8), Mlp::new(&[4, 8, 8, 2], &mut Rng::new(7)));
        let before = agent.target.params().to_vec();
        agent.set_parameters(other.params(), &before);
        assert_eq!((&agent.online, agent.target.params()), (&other, &before[..]));
        // Only the first input is ever one.
        agent.update(&batch(&[transition(0, 0, 1.0, 0, false)]), &mut Rng::new(0));
        for ((old, live), new) in before.iter().zip(agent.online.params()).zip(agent.target.params()) {
            assert!((new - (old + 0.25 * (live - old))).abs() < 1e-6, "{old} {live} {new}");
        }
        assert_eq!(agent.online.params()[8..32], other.params()[8..32]);
    }

    #[test]
    fn fits_worlds_of_its_observations_and_actions() {
        let spec = |width, actions| EnvSpec {
            name: "chain",
            observation: ObservationSpec { width, binary: true },
            actions: ActionSpec::Discrete(actions),
            max_steps: 10,
            reward_scale: 1.0,
            deterministic: true,
            legend: &[],
        };
        let agent = agent(1e-3, 8);
        assert!(agent.fits(&spec(4, &["left", "right"])));
        assert!(!agent.fits(&spec(5, &["left", "right"])) && !agent.fits(&spec(4, &["left", "right", "wait"])));
    }

    #[test]
    fn a_forecast_takes_along_what_it_is_told_to() {
        let mut agent = agent(1e-2, 8);
        let batch = batch(&[transition(0, 0, 1.0, 1, false), transition(1, 1, -1.0, 0, false)]);
        (0..20).for_each(|_| _ = agent.update(&batch, &mut Rng::new(0)));
        let all = agent.for_forecast(Carry::ALL);
        assert_eq!((&all.online, &all.target, &all.optimizer), (&agent.online, &agent.target, &agent.optimizer));
        let target = agent.for_forecast(Carry { target: false, optimizer: true });
        assert_eq!(
            (&target.online, &target.target, &target.optimizer),
            (&agent.online, &agent.online, &agent.optimizer)
        );
        assert_ne!(agent.online, agent.target);
        let optimizer = agent.for_forecast(Carry { target: true, optimizer: false });
        assert_eq!((&optimizer.online, &optimizer.target), (&agent.online, &agent.target));
        assert_eq!((agent.optimizer.steps(), optimizer.optimizer.steps()), (20, 0));
        let next = |mut agent: Ddqn| {
            agent.update(&batch, &mut Rng::new(0));
            agent.digest()
        };
        // Each makes a difference to the first update, and another one.
        let [kept, target, optimizer] = [all, target, optimizer].map(next);
        assert_eq!(kept, next(agent));
        assert_ne!(target, kept);
        assert_ne!(optimizer, kept);
        assert_ne!(target, optimizer);
    }

    #[test]
    fn learns_the_values_of_a_small_chain() {
        // 0 → 1 → 2 → end with reward 1 at the end; "left" stays and pays nothing. γ = 0.5.
        let mut agent = agent(3e-3, 32);
        let samples: Vec<_> = (0..3)
            .flat_map(|s| {
                [transition(s, 0, 0.0, s, false), transition(s, 1, f32::from(u8::from(s == 2)), s + 1, s == 2)]
            })
            .collect();
        let batch = batch(&samples);
        for _ in 0..3000 {
            agent.update(&batch, &mut Rng::new(0));
        }
        for (state, right) in [(0, 0.25), (1, 0.5), (2, 1.0)] {
            let values = q(&agent.online, state);
            assert!((values[1] - right).abs() < 0.02, "{state}: {values:?}");
            assert!((values[0] - right * 0.5).abs() < 0.02, "{state}: {values:?}");
        }
    }

    #[test]
    fn ties_take_the_first_action() {
        assert_eq!(argmax(&[1.0, 1.0]), 0);
        assert_eq!(argmax(&[0.0, 2.0, 2.0]), 1);
        assert_eq!(vec![argmax(&[f32::NAN, 1.0])], [0]);
    }
}
