//! Learners: action selection plus an update rule, one algorithm per file.

pub mod ddqn;
pub mod reward_model;
pub mod td3;

use alloc::vec::Vec;

use crate::env::{Action, ActionSpec, EnvSpec};
use crate::forecast::Carry;
use crate::nn::mlp::{Mlp, Scratch};
use crate::nn::rows::Rows;
use crate::replay::Minibatch;
use crate::rng::Rng;

/// Action selection plus an update rule. `Clone` is the snapshot from which a forecast starts.
///
/// Methods work on batches of observations; `scratch` is working memory without content. Same state, same rows and same
/// random stream have to give the same answer, or a run is not what its text says: no clock, no map without an order.
///
/// # Writing one
/// A learner of an application is given to [`Trainer::new`](crate::trainer::Trainer::new), with the reward model that
/// [`RewardModel::configured`](reward_model::RewardModel::configured) makes; the example `agent` has one with a table
/// of values. [`Run::of`](crate::run::Run::of) wants it `Serialize` and `Send`, too, and `Run::resume_of`
/// `Deserialize`.
///
/// **Rows.** One per observation. [`Rows::ones`] reads those of a world whose observations are binary: the ascending
/// positions of the ones. [`Rows::numbers`] reads all others.
///
/// **Mini-batches.** Sample `i` of a [`Minibatch`] did `actions[i]` in row `state[i]` of `rows`, was paid `rewards[i]`
/// (scaled) and came to row `next[i]` of `rows`. The same observation is row `next_target[i]` of `next_rows`, which has
/// nothing but what a target network reads; a learner without one needs only `rows`. Both numbers are
/// [`NO_ROW`](crate::replay::NO_ROW) where the transition terminated and no value follows; a truncated one has its next
/// row. Equal observations share a row, so count samples by [`Minibatch::len`], not by rows. In a forecast the forced
/// transitions stand last, after the `batch` that were drawn.
///
/// **Settings.** `lr`, `tau` and TD3's noise and delay are read by the built-in learners alone: they do nothing to a
/// learner that does not take them from the [`Config`](crate::config::Config) itself. `hidden`, `layers` and the
/// optimiser's settings are then the reward model's only. `gamma` also discounts utilities, to whose sum the learner
/// adds the last value: it should discount alike. `copy_target` and `copy_optimizer` arrive as [`Carry`].
pub trait Agent: Clone {
    /// What it does in the world.
    type Action: Action;

    /// The policy's action for every row, without exploration, in place of what `actions` held.
    fn act(&self, observations: &Rows, scratch: &mut Scratch, actions: &mut Vec<Self::Action>);

    /// Value of doing `actions[i]` in row `i` and following the policy from there, scaled units, in place of what
    /// `values` held.
    fn values(&self, observations: &Rows, actions: &[Self::Action], scratch: &mut Scratch, values: &mut Vec<f32>);

    /// Value of every row by the target network and its own best action, scaled units, in place of what `values` held.
    ///
    /// Only `final_value=target-max` asks for it, where a rated rollout ends. A learner without a target network
    /// answers with the values of its best actions.
    fn target_values(&self, observations: &Rows, scratch: &mut Scratch, values: &mut Vec<f32>);

    /// One gradient update on a mini-batch; returns the mean loss before it. One that is not finite ends the run.
    fn update(&mut self, batch: &Minibatch<Self::Action>, rng: &mut Rng) -> f32;

    /// The copy from which a forecast starts, with what it takes along.
    fn for_forecast(&self, carry: Carry) -> Self;

    /// The networks with their names, for files that other programs read; none where it has none. No decision
    /// reads them; where forecasts are made elsewhere, their sizes tell what was handed back for another learner.
    fn networks(&self) -> Vec<(&'static str, &Mlp)>;

    /// Whether every parameter that decides actions is a finite number.
    fn is_finite(&self) -> bool;

    /// Digest of the parameters that decide actions.
    fn digest(&self) -> u64;

    /// Whether it reads the observations and offers the actions of a world with this spec: asked where a trainer
    /// is made, and where a run is resumed, since the world may have changed in between. True by default.
    fn fits(&self, spec: &EnvSpec) -> bool {
        let _ = spec;
        true
    }

    /// An exploring action for one observation: a random one with probability `epsilon`.
    fn explore(
        &self,
        observation: &Rows,
        actions: &ActionSpec,
        epsilon: f32,
        rng: &mut Rng,
        scratch: &mut Scratch,
    ) -> Self::Action {
        // The coin is thrown whatever the learner has become, so that learners that share a stream and a
        // schedule explore at the same steps.
        let coin = rng.uniform();
        if coin < epsilon {
            return Self::Action::sample(actions, rng);
        }
        let mut chosen = Vec::with_capacity(1);
        self.act(observation, scratch, &mut chosen);
        chosen.pop().expect("one action per row")
    }
}
