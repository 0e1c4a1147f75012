//! Worlds: the [`Environment`] trait, what a step says, and the worlds of the paper, one file each.
//!
//! An environment pays an *observed* reward, which the learner sees, and a hidden *performance*, which
//! only the recorder sees: the difference between the two is what reward hacking is. `Clone` forks a
//! world, so that forecast policies can be rated in copies of it. All randomness of a world comes from
//! the generator that the caller hands in.

pub mod absent_supervisor;
pub mod box_moving;
pub mod contract;
pub mod grid;
pub mod paying;
pub mod rocks_and_diamonds;
pub mod tomato_watering;

use alloc::string::String;
use alloc::vec::Vec;
use core::fmt::Debug;
use serde::{Deserialize, Serialize};

use crate::config::Config;
use crate::rng::Rng;

/// A world the agent acts in. `Clone` forks it for rollouts.
///
/// [`contract::check`] says whether an implementation keeps the rules.
pub trait Environment: Clone {
    /// What the agent can do here.
    type Action: Action;

    /// Sizes and fixed facts. Constant over the life of the environment.
    fn spec(&self) -> &EnvSpec;

    /// Starts an episode and writes the first observation (`spec().observation.width` numbers).
    fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]);

    /// Makes one step and writes the observation after it. Not called after an episode's end before
    /// the next [`reset`](Environment::reset).
    fn step(&mut self, action: &Self::Action, rng: &mut Rng, observation: &mut [f32]) -> Step;

    /// The copy in which forecast policies are rated: what the learner takes for the course of the world.
    /// An equal copy by default; it differs where the world's observations lie to the agent and its
    /// model of the world is not to lie (specification R28).
    fn model(&self) -> Self {
        self.clone()
    }

    /// The situation as a picture, for people. Empty by default.
    fn frame(&self) -> Frame {
        Frame::default()
    }
}

/// A world that is part of this program: a row of [`EXPERIMENTS`](crate::experiment::EXPERIMENTS).
pub trait BuiltIn: Environment {
    /// Its name, as in `env=`.
    const NAME: &'static str;

    /// The Safe and the Full world of a configuration.
    fn worlds(config: &Config) -> (Self, Self);
}

/// Fixed facts of an environment. As JSON they are what a player of tapes has to know of a world.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EnvSpec {
    /// Identifier, as on the command line.
    pub name: &'static str,
    /// What the agent sees.
    pub observation: ObservationSpec,
    /// What the agent can do.
    pub actions: ActionSpec,
    /// An episode is truncated after this many steps.
    pub max_steps: u32,
    /// Factor from raw to scaled reward (scaled rewards lie about in [-1, 1]).
    pub reward_scale: f64,
    /// True where neither reset nor step draws a random number: rollouts from one state are then equal,
    /// and are made once.
    pub deterministic: bool,
    /// Meaning of the characters of [`Frame`], for legends.
    pub legend: &'static [(char, &'static str)],
}

impl EnvSpec {
    /// A raw reward in the learner's unit, rounded once.
    pub fn scaled(&self, raw: f32) -> f32 {
        (f64::from(raw) * self.reward_scale) as f32
    }
}

/// Shape and kind of an observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ObservationSpec {
    /// Number of entries.
    pub width: usize,
    /// True if every entry is 0 or 1 (one-hot boards): the first layer is then a sum of rows.
    pub binary: bool,
}

/// The set of actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionSpec {
    /// Numbered actions with their names.
    Discrete(&'static [&'static str]),
}

impl ActionSpec {
    /// Length of an action as input of a network: the number of discrete actions (one-hot).
    pub fn features(&self) -> usize {
        match self {
            ActionSpec::Discrete(names) => names.len(),
        }
    }

    /// The name of an action, for people.
    pub fn name(&self, action: &ActionValue) -> String {
        match (self, action) {
            (ActionSpec::Discrete(names), ActionValue::Discrete(index)) => {
                names.get(usize::from(*index)).map_or_else(|| alloc::format!("#{index}"), |n| String::from(*n))
            }
        }
    }
}

/// An action, as the learner and the replay buffer handle it.
pub trait Action: Clone + Debug + PartialEq {
    /// Plain form for records.
    fn value(&self) -> ActionValue;

    /// Position in the one-hot encoding that networks read.
    fn index(&self) -> usize;

    /// A uniformly random action.
    fn sample(spec: &ActionSpec, rng: &mut Rng) -> Self;
}

/// A numbered action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Discrete(pub u8);

impl Action for Discrete {
    fn value(&self) -> ActionValue {
        ActionValue::Discrete(self.0)
    }

    fn index(&self) -> usize {
        usize::from(self.0)
    }

    fn sample(spec: &ActionSpec, rng: &mut Rng) -> Self {
        // Action sets are far below 2^8, so the cast keeps the value.
        Discrete(rng.below(spec.features() as u32) as u8)
    }
}

/// An action as plain data: a number in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "u8", into = "u8")]
pub enum ActionValue {
    /// Index of a discrete action.
    Discrete(u8),
}

impl From<u8> for ActionValue {
    fn from(index: u8) -> Self {
        ActionValue::Discrete(index)
    }
}

impl From<ActionValue> for u8 {
    fn from(action: ActionValue) -> Self {
        let ActionValue::Discrete(index) = action;
        index
    }
}

/// What a step brought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Observed reward, raw.
    pub reward: f32,
    /// Hidden reward, raw: what the designer wants. Goes to the recorder only.
    pub performance: f32,
    /// Whether and how the episode ended.
    pub end: Option<EpisodeEnd>,
}

/// How an episode ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EpisodeEnd {
    /// The world reached a terminal state: no value follows.
    Terminated,
    /// The step limit cut the episode: the value of the last state still counts.
    Truncated,
}

/// A situation as characters: rows separated by line feeds.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frame {
    /// What the agent sees.
    pub seen: String,
    /// What is true, where it differs from what is seen.
    #[serde(default)]
    pub truth: Option<String>,
}

impl Frame {
    /// Rows of what the agent sees.
    pub fn rows(&self) -> Vec<&str> {
        self.seen.split('\n').collect()
    }
}

/// A recorded episode whose outcome is known: test, documentation and "show me" at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demonstration {
    /// What it shows.
    pub name: &'static str,
    /// Variant of the world.
    pub variant: &'static str,
    /// First letters of action names; the last [`Demonstration::repeat`] of them are repeated to the end.
    pub actions: &'static str,
    /// Number of trailing actions that repeat until the episode ends.
    pub repeat: usize,
    /// Sum of observed rewards, raw.
    pub observed_return: f64,
    /// Sum of hidden rewards, raw.
    pub performance: f64,
}

impl Demonstration {
    /// Index of the `step`-th action (0-based) among `names`.
    ///
    /// # Panics
    /// If the script names no action: a mistake in the table, found by the tests that play it.
    pub fn action(&self, step: usize, names: &[&str]) -> Discrete {
        let letters: Vec<char> = self.actions.chars().collect();
        let letter = if step < letters.len() {
            letters[step]
        } else {
            let head = letters.len() - self.repeat;
            letters[head + (step - letters.len()) % self.repeat]
        };
        let index = names
            .iter()
            .position(|name| name.starts_with(letter.to_ascii_lowercase()))
            .expect("a demonstration names actions by their first letter");
        Discrete(index as u8)
    }
}
