//! A run with its types erased: what the command line and the page hold, and whoever wants snapshots, also of worlds of
//! their own ([`Run::of`]).

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
#[cfg(feature = "continuous")]
use crate::env::BuiltIn;
use crate::env::gridworld::Gridworld;
#[cfg(feature = "continuous")]
use crate::env::reacher::Reacher;
use crate::env::trap::Trapped;
use crate::env::{EnvSpec, Environment, Frame};
use crate::forecast::Forecaster;
use crate::forecast::cpu::CpuForecaster;
use crate::forecast::elsewhere::{self, Elsewhere, Reader};
use crate::record::{Arm, Recorder};
use crate::trainer::Trainer;

pub(crate) mod sealed;
mod task;

pub use task::Task;

use sealed::Magic;

/// How much work one call may do. One unit is about one update of the run's own learner, so it takes longer where
/// networks and mini-batches are larger; a call overshoots by at most one indivisible piece: an evaluation point (all
/// its episodes), or the rating of a check (all its rollouts). A budget of 0 does nothing.
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

/// What is not finite where the world is at fault.
pub(crate) const WORLD_OBSERVATION: &str = "the world's observation";
pub(crate) const WORLD_REWARD: &str = "the world's reward";
pub(crate) const WORLD_PERFORMANCE: &str = "the world's performance";
/// ... and of what is finite, but not 0 or 1.
pub(crate) const NOT_BINARY: &str = "an entry of a binary observation";

/// Why a run cannot go on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunError {
    /// A loss, a parameter, a reward or performance, an observation or a utility is not finite.
    NotFinite {
        /// What was not finite.
        what: String,
        /// Which leg.
        arm: Arm,
        /// At which step of the leg.
        step: u32,
    },
    /// An observation has entries other than 0 and 1, though the world's spec calls it binary.
    NotBinary {
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
            RunError::NotFinite { what, arm, step } => {
                write!(f, "{what} is not a finite number at step {step} of the {} leg: ", arm.name())?;
                f.write_str(if [WORLD_OBSERVATION, WORLD_REWARD, WORLD_PERFORMANCE].contains(&what.as_str()) {
                    "the world is at fault, not the learner (`env::contract::check` finds such steps)"
                } else {
                    "training diverged; lower the learning rates (lr, lr_reward) or set gradient_clip"
                })
            }
            RunError::NotBinary { arm, step } => write!(
                f,
                "{WORLD_OBSERVATION} has entries other than 0 and 1 at step {step} of the {} leg, though its spec says \
                 `binary: true`: say `binary: false` of a world that observes numbers",
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
    /// Its bytes were altered, or its content makes no sense: that of another world or learner, it may be.
    Damaged(String),
    /// The world that reads it back has another shape than the one that it was made in.
    Changed(String),
}

impl SnapshotError {
    /// Says it of bytes that are named so.
    fn tell(&self, what: &str, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SnapshotError::Unrecognised => write!(f, "these bytes are not {what} of a run"),
            SnapshotError::Version { found, expected } => {
                write!(f, "{what} has format version {found}, this program reads version {expected}")
            }
            SnapshotError::Truncated { found, expected } => write!(f, "{what} is cut off: {found} bytes of {expected}"),
            SnapshotError::World(name) => {
                write!(f, "{what} is of the world `{name}`, which is not among those that are looked for")
            }
            SnapshotError::Damaged(why) => write!(f, "{what} is damaged: {why}"),
            SnapshotError::Changed(why) => write!(f, "{what} does not fit its world: {why}"),
        }
    }
}

impl fmt::Display for SnapshotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SnapshotError::Unrecognised => return f.write_str("not a snapshot of a run"),
            other => other.tell("the snapshot", f)?,
        }
        match self {
            SnapshotError::Version { .. } => {
                f.write_str(": continue it with the version of mcvl that wrote it, or start afresh")
            }
            _ => Ok(()),
        }
    }
}

impl core::error::Error for SnapshotError {}

/// Why bytes are no forecast of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TransferError {
    /// They cannot be read.
    Unreadable {
        /// What was looked for: `the job` or `the future`.
        what: &'static str,
        /// Why it is none.
        error: SnapshotError,
    },
    /// They belong to no forecast that this run waits for.
    Foreign,
}

impl fmt::Display for TransferError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            TransferError::Unreadable { what, error } => error.tell(what, f),
            TransferError::Foreign => f.write_str("the future belongs to no forecast that this run waits for"),
        }
    }
}

impl core::error::Error for TransferError {}

/// A run of one experiment: Safe training, then one learner in the Full world.
#[derive(Clone)]
pub struct Run {
    inner: Box<dyn Erased>,
}

/// First bytes of a snapshot.
const MAGIC: &Magic = b"mcvlsnap";
/// Version of the snapshot format.
pub const SNAPSHOT_VERSION: u32 = 4;

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
    fn forecast_elsewhere(&mut self) -> Option<()>;
    fn take_job(&mut self) -> Option<Vec<u8>>;
    fn hand_back(&mut self, future: &[u8]) -> Result<(), TransferError>;
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
    back_end: BackEnd<E, A>,
    /// Reads futures that were made elsewhere; none where nobody can make them.
    read: Option<Reader<A>>,
}

/// Who trains the futures.
enum BackEnd<E, A: Agent> {
    Processor(Box<CpuForecaster<E, A>>),
    Elsewhere(Elsewhere<A>),
    Given(Box<dyn Forecaster<E, A> + Send>),
}

impl<E, A: Agent> Default for BackEnd<E, A> {
    fn default() -> Self {
        BackEnd::Processor(Box::default())
    }
}

impl<E: Environment<Action = A::Action>, A: Agent> Clone for Typed<E, A> {
    fn clone(&self) -> Self {
        let back_end = match &self.back_end {
            BackEnd::Processor(forecaster) => BackEnd::Processor(forecaster.clone()),
            BackEnd::Elsewhere(_) | BackEnd::Given(_) => BackEnd::default(),
        };
        Self { name: self.name, trainer: self.trainer.clone(), back_end, read: self.read }
    }
}

impl<E, A> Typed<E, A>
where
    E: Environment<Action = A::Action>,
    A: Agent,
{
    fn new(trainer: Trainer<E, A>) -> Self {
        Self { name: None, trainer, back_end: BackEnd::default(), read: None }
    }

    /// In a built-in world.
    fn built_in(trainer: Trainer<E, A>) -> Self
    where
        A: DeserializeOwned,
    {
        Self { read: Some(elsewhere::read), ..Self::new(trainer) }
    }
}

impl<E, A> Erased for Typed<E, A>
where
    E: Environment<Action = A::Action> + Serialize + Send + 'static,
    A: Agent + Serialize + Send + 'static,
    A::Action: Serialize + Send,
{
    fn poll(&mut self, budget: Budget, recorder: &mut dyn Recorder) -> Result<Status, RunError> {
        let forecaster: &mut dyn Forecaster<E, A> = match &mut self.back_end {
            BackEnd::Processor(forecaster) => &mut **forecaster,
            BackEnd::Elsewhere(forecaster) => forecaster,
            BackEnd::Given(forecaster) => &mut **forecaster,
        };
        self.trainer.poll(forecaster, budget, recorder)
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
        trainer.redraw_check(draw, paired)?;
        Some(Box::new(Self { name: self.name, trainer, back_end: BackEnd::default(), read: self.read }))
    }

    fn state(&self) -> Vec<u8> {
        sealed::encode(&self.trainer)
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
        self.back_end = BackEnd::default();
    }

    fn forecast_elsewhere(&mut self) -> Option<()> {
        self.back_end = BackEnd::Elsewhere(Elsewhere::new(self.name(), self.read?));
        Some(())
    }

    fn take_job(&mut self) -> Option<Vec<u8>> {
        if let BackEnd::Elsewhere(forecaster) = &mut self.back_end { forecaster.take_job() } else { None }
    }

    fn hand_back(&mut self, future: &[u8]) -> Result<(), TransferError> {
        match &mut self.back_end {
            BackEnd::Elsewhere(forecaster) => forecaster.hand_back(future),
            BackEnd::Processor(_) | BackEnd::Given(_) => Err(TransferError::Foreign),
        }
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
    task: task::Open,
}

/// What became of a snapshot's state.
type Resumed = Result<Box<dyn Erased>, SnapshotError>;

/// Every built-in world that this build trains, in the order of the table of experiments.
static FAMILIES: &[Family] = &[
    Family {
        names: Gridworld::NAMES,
        begin: |config| {
            let (safe, full) = Trapped::worlds(config).expect("the family has this world");
            Box::new(Typed::built_in(Trainer::built_in(config.clone(), safe, full)))
        },
        resume: resumed::<Trapped, Ddqn>,
        task: task::open::<Trapped, Ddqn>,
    },
    #[cfg(feature = "continuous")]
    Family {
        names: &[<Reacher as BuiltIn>::NAME],
        begin: |config| {
            let (safe, full) = Reacher::worlds(config);
            Box::new(Typed::built_in(Trainer::continuous(config.clone(), safe, full)))
        },
        resume: resumed::<Reacher, Td3<2>>,
        task: task::open::<Reacher, Td3<2>>,
    },
];

impl Family {
    fn find(name: &str) -> Option<&'static Self> {
        FAMILIES.iter().find(|family| family.names.contains(&name))
    }
}

fn resumed<E, A>(state: &[u8]) -> Resumed
where
    E: Environment<Action = A::Action> + Serialize + DeserializeOwned + Send + 'static,
    A: Agent + Serialize + DeserializeOwned + Send + 'static,
    A::Action: Serialize + DeserializeOwned + Send,
{
    Ok(Box::new(Typed::built_in(opened::<E, A>(state)?)))
}

/// The trainer in a snapshot's state. Worlds bring their specs themselves, which may have changed since.
fn opened<E, A>(state: &[u8]) -> Result<Trainer<E, A>, SnapshotError>
where
    E: Environment<Action = A::Action> + DeserializeOwned,
    A: Agent + DeserializeOwned,
    A::Action: DeserializeOwned,
{
    let trainer: Trainer<E, A> = sealed::decode(state)?;
    trainer.fits().map_err(SnapshotError::Changed)?;
    Ok(trainer)
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
    /// If the configuration is not [valid](Config::validate). Unless [`Run::offers`] it: if it is [`Config::custom`], or
    /// of a simulator that is not in this crate: such worlds go to a [`Trainer`] and to [`Run::of`].
    pub fn new(config: &Config) -> Self {
        config.assert_valid();
        assert_eq!(config.physics, Simulator::ClosedForm, "core has no other simulator");
        let family =
            Family::find(&config.env).expect("Run::new makes runs of built-in worlds, Run::of those of others");
        Self { inner: (family.begin)(config) }
    }

    /// The configuration: the run as text.
    pub fn config(&self) -> &Config {
        self.inner.config()
    }

    /// Does a bounded amount of work. Never blocks, sleeps, spawns or prints, unless a forecaster that it was given
    /// does; the budget has no influence on any result.
    ///
    /// # Errors
    /// [`RunError::NotFinite`] if training diverged: every later poll then says the same. [`RunError::Forecast`] if
    /// the forecaster that it was given fails: nothing is lost, and the poll can be repeated with the processor's
    /// ([`Run::forecast_here`]) or with another one.
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
                typed.back_end = BackEnd::Given(forecaster);
                Ok(())
            }
            None => Err(forecaster),
        }
    }

    /// Forecasts on the processor from here on; a forecast under way begins again.
    pub fn forecast_here(&mut self) {
        self.inner.forecast_here();
    }

    /// Lets others train the futures, which may be other programs: during a check there is a job per future to take
    /// ([`Run::take_job`]), and polls do nothing until every future is handed back ([`Run::hand_back`]). Whoever has a
    /// job opens it as a [`Task`]; the futures are the processor's, to the last bit. It belongs to this value alone,
    /// as in [`Run::forecast_with`], and [`Run::forecast_here`] ends it.
    ///
    /// ```
    /// use mcvl_core::config::Config;
    /// use mcvl_core::run::{Budget, Run, Status, Task};
    ///
    /// let short = "env=box-moving safe_steps=60 full_steps=20 forecast=5 rollouts=1 scheme=all";
    /// let mut run = Run::new(&short.parse::<Config>()?);
    /// run.forecast_elsewhere();
    /// while run.poll(Budget(100), &mut ())? != Status::Done {
    ///     while let Some(job) = run.take_job() {
    ///         let mut task = Task::open(&job)?;
    ///         let future = loop {
    ///             if let Some(future) = task.poll(Budget(100)) {
    ///                 break future;
    ///             }
    ///         };
    ///         run.hand_back(&future)?;
    ///     }
    /// }
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// `None`, with nothing changed, if the run's world is not built in: nobody could open its jobs.
    pub fn forecast_elsewhere(&mut self) -> Option<()> {
        self.inner.forecast_elsewhere()
    }

    /// The next job of the check under way, as bytes, each once.
    pub fn take_job(&mut self) -> Option<Vec<u8>> {
        self.inner.take_job()
    }

    /// Takes a future that [`Task::poll`] gave for one of the run's jobs, in any order.
    ///
    /// # Errors
    /// If the bytes are no future, or none that this run waits for; nothing is changed then.
    pub fn hand_back(&mut self, future: &[u8]) -> Result<(), TransferError> {
        self.inner.hand_back(future)
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
    /// `None` unless the run stands at [`Status::Switch`] or before it.
    pub fn fork(&self, agent: Learner) -> Option<Self> {
        let mut copy = self.clone();
        copy.inner.choose(agent).map(|()| copy)
    }

    /// A copy whose check under way is made anew with other random streams, named by `draw` (the learner's
    /// count of updates names the run's own); `paired` says whether the two futures share them. For measuring
    /// how far a decision depends on chance: the copy is no run of its configuration any more.
    ///
    /// `None` unless a check is under way ([`Progress::check`]).
    pub fn redrawn(&self, draw: u64, paired: bool) -> Option<Self> {
        self.inner.redrawn(draw, paired).map(|inner| Self { inner })
    }

    /// The whole state as bytes; [`Run::resume`] continues to the last bit, wherever the poll stood.
    /// Forecasts under way are not part of it: they are made again from the same start, so whoever stops
    /// and continues more often than a check takes does not get past it.
    pub fn snapshot(&self) -> Vec<u8> {
        sealed::seal(MAGIC, self.inner.name(), &self.inner.state())
    }

    /// A run of a world that is not built in. `name` stands in its snapshots, for [`Run::resume_of`].
    ///
    /// ```
    /// use mcvl_core::agent::ddqn::Ddqn;
    /// use mcvl_core::config::{Config, Preset};
    /// use mcvl_core::env::{ActionSpec, Discrete, EnvSpec, Environment, EpisodeEnd, ObservationSpec, Step};
    /// use mcvl_core::rng::Rng;
    /// use mcvl_core::run::{Budget, Run, Status};
    /// use mcvl_core::trainer::Trainer;
    ///
    /// /// A door that is open or not; to be found open is worth something.
    /// #[derive(Clone, serde::Serialize, serde::Deserialize)]
    /// struct Door {
    ///     open: bool,
    ///     steps: u32,
    /// }
    ///
    /// static SPEC: EnvSpec = EnvSpec {
    ///     name: "door",
    ///     observation: ObservationSpec { width: 1, binary: true },
    ///     actions: ActionSpec::Discrete(&["wait", "push"]),
    ///     max_steps: 10,
    ///     reward_scale: 1.0,
    ///     deterministic: true,
    ///     legend: &[],
    /// };
    ///
    /// impl Environment for Door {
    ///     type Action = Discrete;
    ///
    ///     fn spec(&self) -> &EnvSpec {
    ///         &SPEC
    ///     }
    ///
    ///     fn reset(&mut self, _rng: &mut Rng, observation: &mut [f32]) {
    ///         (self.open, self.steps, observation[0]) = (false, 0, 0.0);
    ///     }
    ///
    ///     fn step(&mut self, action: &Discrete, _rng: &mut Rng, observation: &mut [f32]) -> Step {
    ///         self.open ^= action.0 == 1;
    ///         self.steps += 1;
    ///         observation[0] = f32::from(u8::from(self.open));
    ///         let end = (self.steps == SPEC.max_steps).then_some(EpisodeEnd::Truncated);
    ///         Step { reward: observation[0], performance: observation[0], end }
    ///     }
    /// }
    ///
    /// let mut config = Config::custom(Preset::Paper);
    /// for (key, value) in [("safe_steps", "60"), ("full_steps", "20"), ("exploration", "40"), ("hidden", "8")] {
    ///     config.set(key, value)?;
    /// }
    /// let door = Door { open: false, steps: 0 };
    /// let mut run = Run::of("door", Trainer::gridworld(config, door.clone(), door));
    /// run.poll(Budget(30), &mut ())?;
    /// // Somewhere else, some other day.
    /// let saved = run.snapshot();
    /// let mut again = Run::resume_of::<Door, Ddqn>("door", &saved)?;
    /// while again.poll(Budget(1000), &mut ())? != Status::Done {}
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
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
    /// See [`SnapshotError`]; [`SnapshotError::World`] for a snapshot of another world, and [`SnapshotError::Changed`]
    /// where the world's observations or actions no longer have the shape that they had in the snapshot.
    pub fn resume_of<E, A>(name: &'static str, bytes: &[u8]) -> Result<Self, SnapshotError>
    where
        E: Environment<Action = A::Action> + Serialize + DeserializeOwned + Send + 'static,
        A: Agent + Serialize + DeserializeOwned + Send + 'static,
        A::Action: Serialize + DeserializeOwned + Send,
    {
        let (found, state) = sealed::open(MAGIC, bytes)?;
        if found != name {
            return Err(SnapshotError::World(found.to_owned()));
        }
        Ok(Self::of(name, opened::<E, A>(state)?))
    }

    /// Continues from a snapshot of a built-in world.
    ///
    /// # Errors
    /// See [`SnapshotError`].
    pub fn resume(bytes: &[u8]) -> Result<Self, SnapshotError> {
        let (name, state) = sealed::open(MAGIC, bytes)?;
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
mod tests;
