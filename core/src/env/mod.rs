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
pub mod gridworld;
pub mod paying;
pub mod reacher;
pub mod rocks_and_diamonds;
pub mod tomato_watering;
pub mod trap;

use alloc::string::String;
use alloc::vec::Vec;
use core::fmt::{self, Debug};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

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
    /// model of the world is not to lie (docs/method.md R28). What the learner has seen stays seen: rollouts and practice
    /// from the state after a step begin with the observation of that step, and go on with the model's.
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
    /// Steps of an episode at most: with this one [`Environment::step`] says that it is truncated, if it has not ended.
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
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionSpec {
    /// Numbered actions with their names.
    Discrete(&'static [&'static str]),
    /// One number per name, each from `low` to `high`.
    Continuous {
        /// What the numbers are.
        names: &'static [&'static str],
        /// Least value of each.
        low: f32,
        /// Greatest value of each.
        high: f32,
    },
}

impl ActionSpec {
    /// Length of an action as input of a network: the number of discrete actions (one-hot), or of numbers.
    pub fn features(&self) -> usize {
        match self {
            ActionSpec::Discrete(names) | ActionSpec::Continuous { names, .. } => names.len(),
        }
    }

    /// The name of an action, for people.
    pub fn name(&self, action: &ActionValue) -> String {
        match (self, action) {
            (ActionSpec::Discrete(names), ActionValue::Discrete(index)) => {
                names.get(usize::from(*index)).map_or_else(|| alloc::format!("#{index}"), |n| String::from(*n))
            }
            (ActionSpec::Continuous { names, .. }, ActionValue::Continuous(numbers)) => {
                let parts: Vec<String> =
                    names.iter().zip(numbers).map(|(name, x)| alloc::format!("{name} {x:+.2}")).collect();
                parts.join(", ")
            }
            _ => alloc::format!("{action:?}"),
        }
    }
}

/// An action as input of a network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Encoded<'a> {
    /// A one at this position, zeros elsewhere.
    OneHot(usize),
    /// These numbers.
    Numbers(&'a [f32]),
}

/// An action, as the learner and the replay buffer handle it.
pub trait Action: Clone + Debug + PartialEq {
    /// Plain form for records.
    fn value(&self) -> ActionValue;

    /// The action of a plain form; `None` if it is none of `spec`. Numbers need not lie within the bounds:
    /// what a world makes of larger ones is its own rule.
    fn from_value(value: &ActionValue, spec: &ActionSpec) -> Option<Self>;

    /// What networks read.
    fn encoded(&self) -> Encoded<'_>;

    /// Whether a spec describes actions of this kind.
    fn is_of(spec: &ActionSpec) -> bool;

    /// A uniformly random action.
    ///
    /// # Panics
    /// If `spec` is of another kind of action ([`Action::is_of`]).
    fn sample(spec: &ActionSpec, rng: &mut Rng) -> Self;
}

/// A numbered action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Discrete(pub u8);

impl Discrete {
    /// Position in the one-hot encoding that networks read.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

impl Action for Discrete {
    fn value(&self) -> ActionValue {
        ActionValue::Discrete(self.0)
    }

    fn from_value(value: &ActionValue, spec: &ActionSpec) -> Option<Self> {
        match (value, spec) {
            (ActionValue::Discrete(index), ActionSpec::Discrete(names)) if usize::from(*index) < names.len() => {
                Some(Discrete(*index))
            }
            _ => None,
        }
    }

    fn encoded(&self) -> Encoded<'_> {
        Encoded::OneHot(self.index())
    }

    fn is_of(spec: &ActionSpec) -> bool {
        matches!(spec, ActionSpec::Discrete(_))
    }

    fn sample(spec: &ActionSpec, rng: &mut Rng) -> Self {
        assert!(Self::is_of(spec), "{spec:?} has no numbered actions to draw");
        // Action sets are far below 2^8, so the cast keeps the value.
        Discrete(rng.below(spec.features() as u32) as u8)
    }
}

/// An action of `N` numbers, such as torques.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Continuous<const N: usize>(pub [f32; N]);

impl<const N: usize> Action for Continuous<N> {
    fn value(&self) -> ActionValue {
        ActionValue::Continuous(self.0.to_vec())
    }

    fn from_value(value: &ActionValue, spec: &ActionSpec) -> Option<Self> {
        match (value, spec) {
            (ActionValue::Continuous(numbers), ActionSpec::Continuous { .. })
                if spec.features() == N && numbers.iter().all(|x| x.is_finite()) =>
            {
                numbers[..].try_into().ok().map(Continuous)
            }
            _ => None,
        }
    }

    fn encoded(&self) -> Encoded<'_> {
        Encoded::Numbers(&self.0)
    }

    fn is_of(spec: &ActionSpec) -> bool {
        matches!(spec, ActionSpec::Continuous { names, .. } if names.len() == N)
    }

    fn sample(spec: &ActionSpec, rng: &mut Rng) -> Self {
        let &ActionSpec::Continuous { low, high, .. } = spec else { panic!("{spec:?} has no numbers to draw") };
        Continuous(core::array::from_fn(|_| low + (high - low) * rng.uniform()))
    }
}

impl<const N: usize> Serialize for Continuous<N> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(&self.0)
    }
}

impl<'de, const N: usize> Deserialize<'de> for Continuous<N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let numbers = Vec::<f32>::deserialize(deserializer)?;
        let wrong = |numbers: Vec<f32>| D::Error::invalid_length(numbers.len(), &"the numbers of an action");
        numbers.try_into().map(Continuous).map_err(wrong)
    }
}

/// An action as plain data: in JSON a number, or an array of numbers.
#[derive(Clone, Debug, PartialEq)]
pub enum ActionValue {
    /// Index of a discrete action.
    Discrete(u8),
    /// The numbers of a continuous action.
    Continuous(Vec<f32>),
}

impl From<Discrete> for ActionValue {
    fn from(action: Discrete) -> Self {
        action.value()
    }
}

impl<const N: usize> From<Continuous<N>> for ActionValue {
    fn from(action: Continuous<N>) -> Self {
        action.value()
    }
}

impl fmt::Display for ActionValue {
    /// Numbers of a continuous action are separated by spaces.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ActionValue::Discrete(index) => write!(f, "{index}"),
            ActionValue::Continuous(numbers) => {
                for (i, x) in numbers.iter().enumerate() {
                    write!(f, "{}{x}", if i == 0 { "" } else { " " })?;
                }
                Ok(())
            }
        }
    }
}

/// The forms of an [`ActionValue`]: by their shape in text, by a tag in binary.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Plain {
    Discrete(u8),
    Continuous(Vec<f32>),
}

#[derive(Serialize, Deserialize)]
enum Tagged {
    Discrete(u8),
    Continuous(Vec<f32>),
}

impl Serialize for ActionValue {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match (self.clone(), serializer.is_human_readable()) {
            (ActionValue::Discrete(index), true) => Plain::Discrete(index).serialize(serializer),
            (ActionValue::Continuous(numbers), true) => Plain::Continuous(numbers).serialize(serializer),
            (ActionValue::Discrete(index), false) => Tagged::Discrete(index).serialize(serializer),
            (ActionValue::Continuous(numbers), false) => Tagged::Continuous(numbers).serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for ActionValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(if deserializer.is_human_readable() {
            match Plain::deserialize(deserializer)? {
                Plain::Discrete(index) => ActionValue::Discrete(index),
                Plain::Continuous(numbers) => ActionValue::Continuous(numbers),
            }
        } else {
            match Tagged::deserialize(deserializer)? {
                Tagged::Discrete(index) => ActionValue::Discrete(index),
                Tagged::Continuous(numbers) => ActionValue::Continuous(numbers),
            }
        })
    }
}

/// What a step brought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Observed reward, raw.
    pub reward: f32,
    /// Hidden reward, raw: what the designer wants. Goes to the recorder only. Where nobody knows it, return the reward
    /// itself: no step then counts as a hack.
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

/// A demonstration whose last action repeats.
const fn demonstration(
    name: &'static str,
    variant: &'static str,
    actions: &'static str,
    observed_return: f64,
    performance: f64,
) -> Demonstration {
    Demonstration { name, variant, actions, repeat: 1, observed_return, performance }
}

impl Demonstration {
    /// The same with the last `repeat` actions repeating.
    const fn cycling(self, repeat: usize) -> Self {
        Self { repeat, ..self }
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    const TORQUES: ActionSpec = ActionSpec::Continuous { names: &["shoulder", "elbow"], low: -1.0, high: 1.0 };
    const MOVES: ActionSpec = ActionSpec::Discrete(&["up", "down"]);

    #[test]
    fn actions_come_back_from_their_plain_form() {
        let (down, torque) = (Discrete(1), Continuous([0.5, -3.0]));
        assert_eq!(Discrete::from_value(&down.value(), &MOVES), Some(down));
        assert_eq!(Continuous::from_value(&torque.value(), &TORQUES), Some(torque));
        assert_eq!(Discrete::from_value(&ActionValue::Discrete(2), &MOVES), None);
        assert_eq!(Discrete::from_value(&torque.value(), &MOVES), None);
        assert_eq!(Continuous::<2>::from_value(&down.value(), &TORQUES), None);
        assert_eq!(Continuous::<2>::from_value(&ActionValue::Continuous([0.0; 3].to_vec()), &TORQUES), None);
        assert_eq!(Continuous::<2>::from_value(&ActionValue::Continuous([f32::NAN, 0.0].to_vec()), &TORQUES), None);
        assert_eq!(TORQUES.name(&torque.value()), "shoulder +0.50, elbow -3.00");
        assert_eq!(
            (&*MOVES.name(&down.value()), &*alloc::format!("{}", down.value()), &*alloc::format!("{}", torque.value())),
            ("down", "1", "0.5 -3")
        );
    }

    #[test]
    fn plain_forms_come_back_from_text_and_from_bytes() {
        for (value, text) in [(Discrete(3).value(), "3"), (Continuous([0.25, -1.0]).value(), "[0.25,-1.0]")] {
            assert_eq!(serde_json::to_string(&value).unwrap(), text);
            assert_eq!(serde_json::from_str::<ActionValue>(text).unwrap(), value);
            let bytes = postcard::to_allocvec(&value).unwrap();
            assert_eq!(postcard::from_bytes::<ActionValue>(&bytes).unwrap(), value);
        }
        let bytes = postcard::to_allocvec(&Continuous([0.25, -1.0])).unwrap();
        assert_eq!(postcard::from_bytes::<Continuous<2>>(&bytes).unwrap(), Continuous([0.25, -1.0]));
        assert!(postcard::from_bytes::<Continuous<3>>(&bytes).is_err());
    }

    #[test]
    fn random_actions_fill_their_range() {
        let mut rng = Rng::new(1);
        let drawn: Vec<f32> = (0..1000).flat_map(|_| Continuous::<2>::sample(&TORQUES, &mut rng).0).collect();
        let (least, most) = drawn.iter().fold((0.0f32, 0.0f32), |(l, m), &x| (l.min(x), m.max(x)));
        assert!((-1.0..-0.99).contains(&least) && (0.99..1.0).contains(&most), "{least} {most}");
    }
}
