//! The reward model R(s, a; ψ): what reward the learner expects (docs/method.md R1, R3, R5).
//!
//! A network from (observation, action) to one number, trained by mean squared error on the
//! rewards of the value function's mini-batches. It predicts for the trigger and rates forecast futures;
//! a forecast never trains it, but at most a copy (docs/method.md R27).

use alloc::vec;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

use crate::config::Config;
use crate::digest::Digest;
use crate::env::{Action, ActionSpec, Encoded, EnvSpec, ObservationSpec};
use crate::forecast::Carry;
use crate::nn::buffer::Buffer;
use crate::nn::loss::squared;
use crate::nn::mlp::{Gradient, Mlp, Scratch};
use crate::nn::optim::{Adam, AdamConfig};
use crate::nn::rows::Rows;
use crate::replay::{Minibatch, NO_ROW};
use crate::rng::{Purpose, Rng};

/// The model.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RewardModel {
    input: ObservationSpec,
    actions: usize,
    network: Mlp,
    optimizer: Adam,
    /// First-layer units that were active in an update since [`RewardModel::dead_units`] was asked.
    alive: Vec<bool>,
    #[serde(skip)]
    work: Work,
}

/// Working memory.
#[derive(Clone, Debug, Default)]
struct Work {
    rows: Rows,
    row_of: Vec<u32>,
    row: Vec<u32>,
    scratch: Scratch,
    gradient: Gradient,
    output_gradient: Buffer,
}

/// What it reads: an observation and an action. Actions of numbers make the whole row one of numbers.
fn input_of(observation: ObservationSpec, actions: &ActionSpec) -> ObservationSpec {
    let binary = observation.binary && matches!(actions, ActionSpec::Discrete(_));
    ObservationSpec { width: observation.width + actions.features(), binary }
}

impl RewardModel {
    /// A fresh model with `layers` hidden layers of `hidden` units.
    pub fn new(
        observation: ObservationSpec,
        actions: &ActionSpec,
        hidden: usize,
        layers: usize,
        adam: AdamConfig,
        rng: &mut Rng,
    ) -> Self {
        let input = input_of(observation, actions);
        let mut sizes = vec![input.width];
        sizes.extend(core::iter::repeat_n(hidden, layers));
        sizes.push(1);
        let network = Mlp::new(&sizes, rng);
        let (rows, row) = if input.binary { network.first_rows() } else { (0, 0) };
        let optimizer = Adam::new(adam, network.params().len(), rows, row);
        Self {
            input,
            actions: actions.features(),
            alive: vec![false; hidden],
            network,
            optimizer,
            work: Work::default(),
        }
    }

    /// The model that a configuration describes, with weights drawn from its seed.
    pub fn configured(config: &Config, spec: &EnvSpec) -> Self {
        let mut weights = Rng::stream(config.weights_seed(), Purpose::Weights, 1);
        let (hidden, layers) = (config.hidden as usize, config.layers as usize);
        let adam = AdamConfig::of(config, config.lr_reward);
        Self::new(spec.observation, &spec.actions, hidden, layers, adam, &mut weights)
    }

    /// The copy that a practising forecast trains; what it takes along says `carry` (it has no target network).
    pub(crate) fn for_forecast(&self, carry: Carry) -> Self {
        let mut copy = self.clone();
        if !carry.optimizer {
            copy.optimizer = self.optimizer.restarted();
        }
        copy
    }

    /// Multiply-adds of an update on `batch` transitions, by the dense definition.
    pub fn update_work(&self, batch: u32) -> u64 {
        u64::from(batch) * (self.network.forward_work() + self.network.backward_work())
    }

    /// The network.
    pub fn network(&self) -> &Mlp {
        &self.network
    }

    /// The network, writable: for tests and tools that set values by hand.
    pub fn network_mut(&mut self) -> &mut Mlp {
        &mut self.network
    }

    /// Predicted scaled reward of doing `actions[i]` in row `i`.
    pub fn predict<A: Action>(&self, states: &Rows, actions: &[A], scratch: &mut Scratch, rewards: &mut Vec<f32>) {
        let mut rows = Rows::new(self.input);
        for (row, action) in actions.iter().enumerate() {
            rows.push_pair(states, row, action.encoded());
        }
        rewards.clear();
        rewards.extend_from_slice(self.network.forward(&rows, scratch));
    }

    /// One update on a mini-batch; returns the mean squared error before it. Equal pairs of state and
    /// action are computed once.
    pub fn update<A: Action>(&mut self, batch: &Minibatch<A>) -> f32 {
        let Work { rows, row_of, row, scratch, gradient, output_gradient } = &mut self.work;
        rows.clear(self.input);
        row_of.clear();
        row_of.resize(batch.states * self.actions, NO_ROW);
        row.clear();
        for (&state, action) in batch.state.iter().zip(&batch.actions) {
            let mut single = NO_ROW;
            let pair = match action.encoded() {
                Encoded::OneHot(index) => &mut row_of[state as usize * self.actions + index],
                // Actions of numbers hardly ever repeat.
                Encoded::Numbers(_) => &mut single,
            };
            if *pair == NO_ROW {
                *pair = rows.len() as u32;
                rows.push_pair(&batch.rows, state as usize, action.encoded());
            }
            row.push(*pair);
        }
        let predicted = self.network.forward(rows, scratch);
        let output_gradient = output_gradient.at_least(rows.len());
        output_gradient.fill(0.0);
        let share = 1.0 / batch.len() as f32;
        let mut loss = 0.0;
        for (&row, reward) in row.iter().zip(&batch.rewards) {
            let (value, slope) = squared(predicted[row as usize] - reward);
            loss += value * share;
            output_gradient[row as usize] += slope * share;
        }
        for units in self.network.first_activations(rows, scratch).chunks_exact(self.alive.len()) {
            for (alive, unit) in self.alive.iter_mut().zip(units) {
                *alive |= *unit > 0.0;
            }
        }
        self.network.backward(rows, rows.len(), output_gradient, scratch, gradient);
        gradient.mark(&mut self.optimizer);
        self.optimizer.step(self.network.params_mut(), gradient.values(), None);
        loss
    }

    /// Share of first-layer units that were inactive in every update since the last call; starts anew.
    pub fn dead_units(&mut self) -> f64 {
        let dead = self.alive.iter().filter(|alive| !**alive).count();
        let share = dead as f64 / self.alive.len() as f64;
        self.alive.fill(false);
        share
    }

    /// Whether it reads the observations and actions of a world with this spec.
    pub(crate) fn fits(&self, spec: &EnvSpec) -> bool {
        let input = input_of(spec.observation, &spec.actions);
        self.actions == spec.actions.features()
            && self.input.width == input.width
            && (input.binary || !self.input.binary)
    }

    /// Digest of the parameters.
    pub fn digest(&self) -> u64 {
        Digest::default().f32s(self.network.params()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Optimizer;
    use crate::env::Discrete;
    use crate::replay::{Forced, ReplayBuffer, Transition};

    const SPEC: ObservationSpec = ObservationSpec { width: 3, binary: true };
    const ACTIONS: ActionSpec = ActionSpec::Discrete(&["a", "b"]);

    fn samples() -> Minibatch<Discrete> {
        let mut replay = ReplayBuffer::new(SPEC, 100);
        for (state, action, reward) in [(0, 0, 1.0), (1, 0, -0.5), (1, 1, 0.25), (0, 0, 1.0), (2, 1, 0.0)] {
            let observation: Vec<f32> = (0..3).map(|i| f32::from(u8::from(i == state))).collect();
            replay.push(&Transition {
                next_observation: observation.clone(),
                observation,
                action: Discrete(action),
                reward,
                terminated: false,
            });
        }
        let mut batch = Minibatch::default();
        batch.gather(&replay, &[0, 1, 2, 3, 4], &Forced::new(&[], &replay));
        batch
    }

    #[test]
    fn learns_rewards_of_state_and_action() {
        let adam = AdamConfig { kind: Optimizer::Adam, lr: 1e-2, weight_decay: 0.0, clip: 0.0 };
        let mut model = RewardModel::new(SPEC, &ACTIONS, 32, 2, adam, &mut Rng::new(1));
        let batch = samples();
        let first = model.update(&batch);
        let mut last = first;
        for _ in 0..500 {
            last = model.update(&batch);
        }
        assert!(last < 1e-4 && last < first, "{first} {last}");
        let mut rewards = Vec::new();
        let mut rows = Rows::new(SPEC);
        [0, 1, 1, 2].iter().for_each(|&state| rows.push(&[state]));
        let actions = [Discrete(0), Discrete(0), Discrete(1), Discrete(1)];
        model.predict(&rows, &actions, &mut Scratch::default(), &mut rewards);
        for (predicted, reward) in rewards.iter().zip([1.0, -0.5, 0.25, 0.0]) {
            assert!((predicted - reward).abs() < 0.02, "{rewards:?}");
        }
    }

    #[test]
    fn dead_units_are_counted_between_calls() {
        let adam = AdamConfig { kind: Optimizer::Adam, lr: 1e-3, weight_decay: 0.0, clip: 0.0 };
        let mut model = RewardModel::new(SPEC, &ACTIONS, 8, 1, adam, &mut Rng::new(1));
        assert_eq!(model.dead_units(), 1.0);
        model.update(&samples());
        let share = model.dead_units();
        assert!((0.0..1.0).contains(&share), "{share}");
        // A bias of -10 silences every unit.
        let (inputs, units) = model.network.first_rows();
        model.network_mut().params_mut()[inputs * units..(inputs + 1) * units].fill(-10.0);
        model.update(&samples());
        assert_eq!(model.dead_units(), 1.0);
    }
}
