//! A run with its types erased: what the command line, the page and embedders of the built-in worlds hold.

use alloc::borrow::ToOwned;
use alloc::boxed::Box;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;
use core::any::Any;
use core::fmt;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::agent::Agent;
use crate::agent::ddqn::Ddqn;
#[cfg(feature = "continuous")]
use crate::agent::td3::Td3;
use crate::config::{Config, Learner, Simulator};
use crate::digest::Digest;
#[cfg(feature = "continuous")]
use crate::env::BuiltIn;
use crate::env::gridworld::Gridworld;
#[cfg(feature = "continuous")]
use crate::env::reacher::Reacher;
use crate::env::trap::Trapped;
use crate::env::{EnvSpec, Environment, Frame};
use crate::forecast::Forecaster;
use crate::forecast::cpu::CpuForecaster;
use crate::record::{Arm, Recorder};
use crate::trainer::Trainer;

/// How much work one call may do. One unit is about one gradient update of the gridworld learner; a call
/// overshoots by at most one indivisible piece: an evaluation point (all its episodes), or the rating of a
/// check (all its rollouts). A budget of 0 does nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget(pub u32);

impl Budget {
    /// Notes that `units` of work were done.
    pub fn spend(&mut self, units: u32) {
        self.0 = self.0.saturating_sub(units);
    }
}

/// Where a run stands after a poll.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// There is more to do in this leg.
    Working,
    /// Safe training is finished. [`Run::fork`] continues with either learner from here;
    /// polling on continues with the configured one.
    Switch,
    /// The Full phase is finished: further polls do nothing.
    Done,
}

/// Figures for progress displays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Current leg.
    pub arm: Arm,
    /// Steps made in this leg.
    pub step: u32,
    /// Steps planned for this leg.
    pub steps: u32,
    /// Gradient updates of the live learner since the start of Safe training.
    pub updates: u64,
    /// Checks made in this leg.
    pub checks: u32,
    /// Refusals in this leg.
    pub refusals: u32,
    /// Gradient updates spent in forecasts in this leg.
    pub forecast_updates: u64,
    /// Part of the current check that is done, 0 to 1, while one is under way.
    pub check: Option<f32>,
}

/// Why a run cannot go on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunError {
    /// A loss, a parameter, a reward or a utility is not finite.
    NotFinite {
        /// What was not finite.
        what: String,
        /// Which leg.
        arm: Arm,
        /// At which step of the leg.
        step: u32,
    },
    /// The forecasting back end failed; the state of the run is intact.
    Forecast(String),
}

impl fmt::Display for RunError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RunError::NotFinite { what, arm, step } => write!(
                f,
                "{what} is not a finite number at step {step} of the {} leg: training diverged; \
                 lower the learning rates (lr, lr_reward) or set gradient_clip",
                arm.name()
            ),
            RunError::Forecast(why) => write!(f, "the forecasting back end failed: {why}"),
        }
    }
}

impl core::error::Error for RunError {}

/// Why bytes are no snapshot of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SnapshotError {
    /// The bytes do not begin like a snapshot.
    Unrecognised,
    /// Another version wrote it.
    Version {
        /// Version of the snapshot.
        found: u32,
        /// Version that this program reads.
        expected: u32,
    },
    /// It ends too early.
    Truncated {
        /// Bytes there are.
        found: u64,
        /// Bytes there should be.
        expected: u64,
    },
    /// It is of a world that is not looked for here.
    World(String),
    /// Its bytes were altered, or its content makes no sense.
    Damaged(String),
}

impl fmt::Display for SnapshotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SnapshotError::Unrecognised => f.write_str("not a snapshot of a run"),
            SnapshotError::Version { found, expected } => write!(
                f,
                "the snapshot has format version {found}, this program reads version {expected}: \
                 continue it with the version of mcvl that wrote it, or start afresh"
            ),
            SnapshotError::Truncated { found, expected } => {
                write!(f, "the snapshot is cut off: {found} bytes of {expected}")
            }
            SnapshotError::World(name) => {
                write!(f, "the snapshot is of the world `{name}`, which is not among those that are looked for")
            }
            SnapshotError::Damaged(why) => write!(f, "the snapshot is damaged: {why}"),
        }
    }
}

impl core::error::Error for SnapshotError {}

/// A run of one experiment: Safe training, then one learner in the Full world.
#[derive(Clone)]
pub struct Run {
    inner: Box<dyn Erased>,
}

/// First bytes of a snapshot.
const MAGIC: &[u8; 8] = b"mcvlsnap";
/// Version of the snapshot format.
pub const SNAPSHOT_VERSION: u32 = 4;
/// Bytes before the payload: magic, version, length, digest.
const HEADER: usize = 8 + 4 + 8 + 8;

/// A trainer whose world and learner are not named.
trait Erased: Send {
    fn poll(&mut self, budget: Budget, recorder: &mut dyn Recorder) -> Result<Status, RunError>;
    fn config(&self) -> &Config;
    fn status(&self) -> Status;
    fn progress(&self) -> Progress;
    fn choose(&mut self, agent: Learner) -> Option<()>;
    fn redrawn(&self, draw: u64, paired: bool) -> Option<Box<dyn Erased>>;
    fn state(&self) -> Vec<u8>;
    fn spec(&self) -> &EnvSpec;
    fn frame(&self) -> Frame;
    fn tensors(&self) -> Vec<(String, Vec<usize>, Vec<f32>)>;
    /// The world's name in snapshots: it says which types the state has.
    fn name(&self) -> &str;
    fn boxed_clone(&self) -> Box<dyn Erased>;
    fn forecast_here(&mut self);
    fn as_any_mut(&mut self) -> &mut dyn Any;
}

impl Clone for Box<dyn Erased> {
    fn clone(&self) -> Self {
        self.boxed_clone()
    }
}

/// A trainer with its forecaster.
struct Typed<E: Environment<Action = A::Action>, A: Agent> {
    /// Name in snapshots, where it is not that of the configuration's world.
    name: Option<&'static str>,
    trainer: Trainer<E, A>,
    forecaster: CpuForecaster<E, A>,
    /// Forecasts in place of the processor's.
    other: Option<Box<dyn Forecaster<E, A> + Send>>,
}

impl<E: Environment<Action = A::Action>, A: Agent> Clone for Typed<E, A> {
    fn clone(&self) -> Self {
        let (trainer, forecaster) = (self.trainer.clone(), self.forecaster.clone());
        Self { name: self.name, trainer, forecaster, other: None }
    }
}

impl<E, A> Typed<E, A>
where
    E: Environment<Action = A::Action>,
    A: Agent,
{
    fn new(trainer: Trainer<E, A>) -> Self {
        Self { name: None, trainer, forecaster: CpuForecaster::default(), other: None }
    }
}

impl<E, A> Erased for Typed<E, A>
where
    E: Environment<Action = A::Action> + Serialize + Send + 'static,
    A: Agent + Serialize + Send + 'static,
    A::Action: Serialize + Send,
{
    fn poll(&mut self, budget: Budget, recorder: &mut dyn Recorder) -> Result<Status, RunError> {
        match &mut self.other {
            Some(other) => self.trainer.poll(&mut **other, budget, recorder),
            None => self.trainer.poll(&mut self.forecaster, budget, recorder),
        }
    }

    fn config(&self) -> &Config {
        self.trainer.config()
    }

    fn status(&self) -> Status {
        self.trainer.status()
    }

    fn progress(&self) -> Progress {
        self.trainer.progress()
    }

    fn choose(&mut self, agent: Learner) -> Option<()> {
        self.trainer.choose(agent)
    }

    fn redrawn(&self, draw: u64, paired: bool) -> Option<Box<dyn Erased>> {
        let mut trainer = self.trainer.clone();
        trainer.redraw_check(draw, paired).map(|()| Box::new(Self::new(trainer)) as Box<dyn Erased>)
    }

    fn state(&self) -> Vec<u8> {
        postcard::to_allocvec(&self.trainer).expect("plain data has a binary form")
    }

    fn spec(&self) -> &EnvSpec {
        self.trainer.world().spec()
    }

    fn frame(&self) -> Frame {
        self.trainer.world().frame()
    }

    fn tensors(&self) -> Vec<(String, Vec<usize>, Vec<f32>)> {
        let reward = ("reward", self.trainer.reward_model().network());
        let mut tensors = Vec::new();
        for (name, network) in self.trainer.agent().networks().into_iter().chain([reward]) {
            for layer in 0..network.sizes().len() - 1 {
                let (weights, bias) = network.layer(layer);
                let values = |x: &mut dyn Iterator<Item = &f32>| x.copied().collect();
                tensors.push((format!("{name}.{layer}.weight"), weights.shape().to_vec(), values(&mut weights.iter())));
                tensors.push((format!("{name}.{layer}.bias"), bias.shape().to_vec(), values(&mut bias.iter())));
            }
        }
        tensors
    }

    fn name(&self) -> &str {
        self.name.unwrap_or(&self.trainer.config().env)
    }

    fn boxed_clone(&self) -> Box<dyn Erased> {
        Box::new(self.clone())
    }

    fn forecast_here(&mut self) {
        self.other = None;
    }

    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
}

/// Built-in worlds that share a learner, with their types erased: how runs in them begin and come back. Bare
/// worlds have a table of their own, in [`play`](crate::play): they need no learner.
struct Family {
    names: &'static [&'static str],
    begin: fn(&Config) -> Box<dyn Erased>,
    resume: fn(&[u8]) -> Resumed,
}

/// What became of a snapshot's state.
type Resumed = Result<Box<dyn Erased>, SnapshotError>;

/// Every built-in world that this build trains, in the order of the table of experiments.
static FAMILIES: &[Family] = &[
    Family {
        names: Gridworld::NAMES,
        begin: |config| {
            let (safe, full) = Trapped::worlds(config).expect("the family has this world");
            Box::new(Typed::new(Trainer::gridworld(config.clone(), safe, full)))
        },
        resume: resumed::<Trapped, Ddqn>,
    },
    #[cfg(feature = "continuous")]
    Family {
        names: &[<Reacher as BuiltIn>::NAME],
        begin: |config| {
            let (safe, full) = Reacher::worlds(config);
            Box::new(Typed::new(Trainer::continuous(config.clone(), safe, full)))
        },
        resume: resumed::<Reacher, Td3<2>>,
    },
];

impl Family {
    fn find(name: &str) -> Option<&'static Self> {
        FAMILIES.iter().find(|family| family.names.contains(&name))
    }
}

/// A trainer from its binary form.
fn trainer<E, A>(state: &[u8]) -> Result<Trainer<E, A>, SnapshotError>
where
    E: Environment<Action = A::Action> + DeserializeOwned,
    A: Agent + DeserializeOwned,
    A::Action: DeserializeOwned,
{
    let (trainer, rest): (Trainer<E, A>, _) = postcard::take_from_bytes(state)
        .map_err(|error| SnapshotError::Damaged(format!("its content makes no sense: {error}")))?;
    if !rest.is_empty() {
        return Err(SnapshotError::Damaged("its parts do not belong together".to_owned()));
    }
    Ok(trainer)
}

fn resumed<E, A>(state: &[u8]) -> Resumed
where
    E: Environment<Action = A::Action> + Serialize + DeserializeOwned + Send + 'static,
    A: Agent + Serialize + DeserializeOwned + Send + 'static,
    A::Action: Serialize + DeserializeOwned + Send,
{
    Ok(Box::new(Typed::new(trainer::<E, A>(state)?)))
}

/// The world's name and the state in a snapshot.
fn opened(bytes: &[u8]) -> Result<(&str, &[u8]), SnapshotError> {
    let damaged = |why: String| SnapshotError::Damaged(why);
    let found = bytes.len() as u64;
    if bytes.len() < HEADER {
        return Err(if MAGIC.starts_with(&bytes[..bytes.len().min(8)]) && !bytes.is_empty() {
            SnapshotError::Truncated { found, expected: HEADER as u64 }
        } else {
            SnapshotError::Unrecognised
        });
    }
    if &bytes[..8] != MAGIC {
        return Err(SnapshotError::Unrecognised);
    }
    let number = |range: core::ops::Range<usize>| {
        let mut word = [0; 8];
        word[..range.len()].copy_from_slice(&bytes[range]);
        u64::from_le_bytes(word)
    };
    let version = number(8..12) as u32;
    if version != SNAPSHOT_VERSION {
        return Err(SnapshotError::Version { found: version, expected: SNAPSHOT_VERSION });
    }
    let expected = number(12..20).saturating_add(HEADER as u64);
    if found < expected {
        return Err(SnapshotError::Truncated { found, expected });
    }
    let payload = &bytes[HEADER..];
    if found > expected {
        return Err(damaged(format!("{} bytes too many", found - expected)));
    }
    if Digest::default().bytes(payload).finish() != number(20..28) {
        return Err(damaged("its bytes were altered".to_owned()));
    }
    let (name, state) = payload
        .split_first()
        .and_then(|(&len, rest)| rest.split_at_checked(usize::from(len)))
        .ok_or_else(|| damaged("it names no world".to_owned()))?;
    let name = core::str::from_utf8(name).map_err(|_| damaged("it names no world".to_owned()))?;
    Ok((name, state))
}

impl Run {
    /// Whether this build of the crate trains in the world of a configuration; [`Play::offers`] says whether it has
    /// the bare world.
    ///
    /// [`Play::offers`]: crate::play::Play::offers
    pub fn offers(config: &Config) -> bool {
        config.physics == Simulator::ClosedForm && Family::find(&config.env).is_some()
    }

    /// A run from its beginning.
    ///
    /// # Panics
    /// Unless [`Run::offers`] it: if the configuration is [`Config::custom`], or of a simulator that is not in this crate: such worlds go to
    /// a [`Trainer`] and to [`Run::of`].
    pub fn new(config: &Config) -> Self {
        assert_eq!(config.physics, Simulator::ClosedForm, "core has no other simulator");
        let family = Family::find(&config.env).expect("runs are of built-in worlds");
        Self { inner: (family.begin)(config) }
    }

    /// The configuration: the run as text.
    pub fn config(&self) -> &Config {
        self.inner.config()
    }

    /// Does a bounded amount of work. Never blocks, sleeps, spawns or prints; the budget has no
    /// influence on any result.
    ///
    /// # Errors
    /// If training diverged. The run is then of no further use.
    pub fn poll(&mut self, budget: Budget, recorder: &mut dyn Recorder) -> Result<Status, RunError> {
        self.inner.poll(budget, recorder)
    }

    /// Lets `forecaster` train the futures in place of the processor's back end. It belongs to this value alone:
    /// copies, forks and resumed snapshots forecast on the processor again. A back end's arithmetic is the only
    /// influence it has.
    ///
    /// # Errors
    /// Gives it back if the run is not of this world and learner; nothing is changed then.
    pub fn forecast_with<E, A>(
        &mut self,
        forecaster: Box<dyn Forecaster<E, A> + Send>,
    ) -> Result<(), Box<dyn Forecaster<E, A> + Send>>
    where
        E: Environment<Action = A::Action> + 'static,
        A: Agent + 'static,
    {
        match self.inner.as_any_mut().downcast_mut::<Typed<E, A>>() {
            Some(typed) => {
                typed.other = Some(forecaster);
                Ok(())
            }
            None => Err(forecaster),
        }
    }

    /// Forecasts on the processor from here on; a forecast under way begins again.
    pub fn forecast_here(&mut self) {
        self.inner.forecast_here();
    }

    /// Where the run stands, without doing anything.
    pub fn status(&self) -> Status {
        self.inner.status()
    }

    /// Figures for progress displays.
    pub fn progress(&self) -> Progress {
        self.inner.progress()
    }

    /// A copy that continues from the switch with another learner: both share the Safe training.
    ///
    /// # Errors
    /// `None` unless the run stands at [`Status::Switch`] or before it.
    pub fn fork(&self, agent: Learner) -> Option<Self> {
        let mut copy = self.clone();
        copy.inner.choose(agent).map(|()| copy)
    }

    /// A copy whose check under way is made anew with other random streams, named by `draw` (the learner's
    /// count of updates names the run's own); `paired` says whether the two futures share them. For measuring
    /// how far a decision depends on chance: the copy is no run of its configuration any more.
    ///
    /// # Errors
    /// `None` unless a check is under way ([`Progress::check`]).
    pub fn redrawn(&self, draw: u64, paired: bool) -> Option<Self> {
        self.inner.redrawn(draw, paired).map(|inner| Self { inner })
    }

    /// The whole state as bytes; [`Run::resume`] continues to the last bit, wherever the poll stood.
    /// Forecasts under way are not part of it: they are made again from the same start, so whoever stops
    /// and continues more often than a check takes does not get past it.
    pub fn snapshot(&self) -> Vec<u8> {
        let state = self.inner.state();
        let name = self.inner.name().as_bytes();
        let mut payload = Vec::with_capacity(1 + name.len() + state.len());
        payload.push(name.len() as u8);
        payload.extend_from_slice(name);
        payload.extend_from_slice(&state);
        let mut bytes = Vec::with_capacity(HEADER + payload.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&SNAPSHOT_VERSION.to_le_bytes());
        bytes.extend_from_slice(&(payload.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&Digest::default().bytes(&payload).finish().to_le_bytes());
        bytes.extend_from_slice(&payload);
        bytes
    }

    /// A run of a world that is not built in. `name` stands in its snapshots, for [`Run::resume_of`].
    ///
    /// # Panics
    /// If `name` has more than 255 bytes.
    pub fn of<E, A>(name: &'static str, trainer: Trainer<E, A>) -> Self
    where
        E: Environment<Action = A::Action> + Serialize + Send + 'static,
        A: Agent + Serialize + Send + 'static,
        A::Action: Serialize + Send,
    {
        assert!(name.len() <= usize::from(u8::MAX), "a short name");
        let mut typed = Typed::new(trainer);
        typed.name = Some(name);
        Self { inner: Box::new(typed) }
    }

    /// Continues from a snapshot of a run that [`Run::of`] made with this name.
    ///
    /// # Errors
    /// See [`SnapshotError`]; [`SnapshotError::World`] for a snapshot of another world.
    pub fn resume_of<E, A>(name: &'static str, bytes: &[u8]) -> Result<Self, SnapshotError>
    where
        E: Environment<Action = A::Action> + Serialize + DeserializeOwned + Send + 'static,
        A: Agent + Serialize + DeserializeOwned + Send + 'static,
        A::Action: Serialize + DeserializeOwned + Send,
    {
        let (found, state) = opened(bytes)?;
        if found != name {
            return Err(SnapshotError::World(found.to_owned()));
        }
        Ok(Self::of(name, trainer::<E, A>(state)?))
    }

    /// Continues from a snapshot of a built-in world.
    ///
    /// # Errors
    /// See [`SnapshotError`].
    pub fn resume(bytes: &[u8]) -> Result<Self, SnapshotError> {
        let (name, state) = opened(bytes)?;
        let family = Family::find(name).ok_or_else(|| SnapshotError::World(name.to_owned()))?;
        let inner = (family.resume)(state)?;
        if inner.config().env != name {
            return Err(SnapshotError::Damaged("its parts do not belong together".to_owned()));
        }
        Ok(Self { inner })
    }

    /// Facts of the environment of the current leg: names of actions, legend, sizes.
    pub fn spec(&self) -> &EnvSpec {
        self.inner.spec()
    }

    /// The current situation of the live environment.
    pub fn frame(&self) -> Frame {
        self.inner.frame()
    }

    /// Named parameter tensors of the learner and the reward model: (name, shape, row-major values).
    pub fn tensors(&self) -> Vec<(String, Vec<usize>, Vec<f32>)> {
        self.inner.tensors()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Preset;
    use crate::experiment::EXPERIMENTS;
    use crate::record::Event;

    fn finish(mut run: Run) -> Vec<Event> {
        let mut events = Vec::new();
        while run.poll(Budget(u32::MAX), &mut |event: &Event| events.push(event.clone())).unwrap() != Status::Done {}
        events
    }

    #[test]
    fn every_experiment_has_its_world() {
        let names = FAMILIES.iter().flat_map(|family| family.names.iter().copied());
        assert!(names.eq(EXPERIMENTS.iter().map(|experiment| experiment.name)));
        for experiment in EXPERIMENTS {
            let run = Run::new(&Config::new(experiment.name, Preset::Paper).unwrap());
            assert_eq!(run.spec().name, experiment.name);
        }
    }

    #[test]
    fn a_check_can_be_made_anew_with_other_streams() {
        let text = "env=tomato-watering safe_steps=60 full_steps=40 exploration=30 forecast=20 rollouts=4 \
                    rollout_steps=10 evaluations=2 evaluation_episodes=2 hidden=8 scheme=all";
        let mut run = Run::new(&text.parse().unwrap());
        assert!(run.redrawn(1, true).is_none(), "no check is under way");
        while run.progress().check.is_none() {
            run.poll(Budget(1), &mut ()).unwrap();
        }
        let decide = |mut run: Run| {
            let mut found = None;
            while found.is_none() {
                let mut keep = |event: &Event| {
                    if let Event::Check(check) = event {
                        found = Some((**check).clone());
                    }
                };
                run.poll(Budget(1), &mut keep).unwrap();
            }
            found.unwrap()
        };
        let own = decide(run.clone());
        // Also where the forecasts have begun.
        run.poll(Budget(5), &mut ()).unwrap();
        assert_eq!(decide(run.redrawn(run.progress().updates, true).unwrap()), own);
        let other = decide(run.redrawn(7, true).unwrap());
        assert_ne!(other.modified, own.modified);
        assert_ne!(decide(run.redrawn(7, false).unwrap()).unmodified, other.unmodified);
    }

    #[test]
    fn every_variant_runs_and_resumes_to_the_last_bit() {
        for experiment in EXPERIMENTS {
            let pairs = experiment.maps().iter().flat_map(|map| experiment.variants.iter().map(move |v| (map, v)));
            for (map, variant) in pairs {
                let mut config = Config::new(experiment.name, Preset::Paper).unwrap();
                let short = "practice_reward_updates=4 scheme=all safe_steps=60 full_steps=6 exploration=30 \
                             learning_starts=30 batch=16 forecast=3 rollouts=2 \
                             rollout_steps=4 evaluations=2 evaluation_episodes=2 hidden=8";
                for (key, value) in short.split_whitespace().filter_map(|pair| pair.split_once('=')) {
                    config.set(key, value).unwrap();
                }
                config.set("variant", variant).unwrap();
                config.set("map", map).unwrap();
                let mut run = Run::new(&config);
                let mut ignore = |_: &Event| {};
                while run.progress().arm == Arm::Safe || run.progress().step < 3 {
                    run.poll(Budget(1), &mut ignore).unwrap();
                }
                let resumed = Run::resume(&run.snapshot()).unwrap();
                let rest = finish(resumed);
                assert!(rest.iter().any(|event| matches!(event, Event::Check(_))), "{config}");
                assert_eq!(finish(run), rest, "{config}");
            }
        }
    }
}
