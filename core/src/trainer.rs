//! The only training loop, and the only writer of the replay buffer.
//!
//! A [`Trainer`] leads one learner through two legs: Safe training without checks, then the Full world,
//! plain or with the modification check (paper algorithm 5, docs/method.md R6 to R26). It is a state
//! machine without input or output of its own: [`Trainer::poll`] does a bounded amount of work and
//! returns; how the work is cut into polls changes no bit.
//!
//! # Order of one step
//! 1. choose an action (epsilon-greedy), step the environment, scale the reward;
//! 2. predict the reward; in the Full leg of the checking learner, ask the trigger;
//! 3. where it fires: forecast with and without, rate both, decide (or what else the scheme says);
//! 4. accepted or unchecked: store and make one update of the value function and of the reward model;
//!    refused: neither, and the environment is reset;
//! 5. at the end of an episode: reset.
//!
//! # Differences from the paper's text
//! 1. The check stands right after the environment step, so that no action is chosen for a state that a
//!    reset then discards (R26); `check_after=next-action` has the paper's order.
//! 2. Every random number comes from a stream named by (seed, purpose, counter): a check never moves the
//!    streams of the learner (R18; `own_streams=false` lets it). Streams of a forecast are named by the number of updates the
//!    learner has made, so a refusal, after which nothing has changed, leaves the unmodified future as
//!    it was; it is reused then.
//! 3. A transition that truncates its episode is rated from the current state by its value alone.
//! 4. In a deterministic world all resets are equal: one rollout stands for all of them.
//!
//! # Legs of other lengths
//! Checks begin with the first step of the Full leg, so the Safe leg has to be long enough: the reward model that
//! triggers and rates is at first the one it left behind. In Reacher the Safe leg *is* the random exploration (R45
//! to R47). With `epsilon_restart=false` what `safe_steps` leaves of `exploration` goes on into the Full leg, and
//! its random steps are checked; where `learning_starts` was not reached, by a reward model that has not learned.
//! Whoever shortens the legs shortens `exploration` and `learning_starts` with them.

use alloc::borrow::ToOwned;
use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

use crate::agent::Agent;
use crate::agent::ddqn::Ddqn;
use crate::agent::reward_model::RewardModel;
use crate::agent::td3::Td3;
use crate::check::Disposition;
use crate::check::utility::Rollout;
use crate::config::{CheckAfter, Config, Forced as ForcedKind, Learner, RewardBatch};
use crate::digest::Digest;
use crate::env::paying::Paying;
use crate::env::{
    Action, ActionSpec, ActionValue, Continuous, Discrete, EnvSpec, Environment, EpisodeEnd, Frame, ObservationSpec,
    Step, contract,
};
use crate::forecast::Forecaster;
use crate::nn::mlp::Scratch;
use crate::nn::rows::Rows;
use crate::record::{Arm, EndRecord, EpisodeRecord, Event, Recorder, StartRecord, StepRecord, Verdict};
use crate::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use crate::rng::{Purpose, Rng};
use crate::run::{Budget, NOT_BINARY, Progress, RunError, Status, WORLD_OBSERVATION, WORLD_PERFORMANCE, WORLD_REWARD};

/// Accepted transitions of the episode that the `episode` way of forcing appends.
const TAIL: usize = 10;

/// A learner on its way through the Safe and the Full leg.
///
/// [`Run`](crate::run::Run) keeps one in snapshots that know their version, their world and their digest, and looks at
/// what it reads back; serde alone does not. Binary formats hold it (postcard), text formats have no place for the keys
/// of its replay buffer.
#[derive(Clone, Serialize, Deserialize)]
#[serde(bound(
    serialize = "E: Serialize, A: Serialize, A::Action: Serialize",
    deserialize = "E: Deserialize<'de>, A: Deserialize<'de>, A::Action: Deserialize<'de>"
))]
pub struct Trainer<E: Environment<Action = A::Action>, A: Agent> {
    config: Config,
    safe: E,
    full: E,
    world: Paying<E>,
    observation: Vec<f32>,
    /// The next action, where it is chosen before the check of this one.
    chosen: Option<A::Action>,
    agent: A,
    reward_model: RewardModel,
    replay: ReplayBuffer<A::Action>,
    explore_rng: Rng,
    world_rng: Rng,
    arm: Arm,
    step: u32,
    updates: u64,
    /// Updates that the scheme `each-step` took back.
    dropped: u64,
    episode: Episode,
    tail: Vec<Transition<A::Action>>,
    activity: Activity<A::Action>,
    losses: Losses,
    checks: u32,
    refusals: u32,
    forecast_updates: u64,
    reusable: Option<Reusable<A>>,
    #[serde(skip)]
    work: Work<A::Action>,
    #[serde(skip)]
    check_progress: Option<f32>,
}

/// Sums over the running episode.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Episode {
    observed_return: f64,
    performance: f64,
    length: u32,
}

/// Sums of losses since the last evaluation point.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Losses {
    value: f64,
    updates: u32,
    reward: f64,
    reward_updates: u32,
}

/// Panics where worlds cannot be trained in together: before networks are made for them.
fn assert_alike<E: Environment>(safe: &E, full: &E) {
    let model = full.model();
    let worlds = [("Safe world", safe), ("Full world", full), ("model of the Full world", &model)];
    all_alike(worlds.map(|(name, world)| (name, world.spec(), contract::spec(world))));
}

/// Once for all kinds of worlds: the page has four.
fn all_alike(specs: [(&str, &EnvSpec, Result<(), contract::Violation>); 3]) {
    let safe = specs[0].1;
    for (name, spec, rules) in specs {
        if let Err(violation) = rules {
            panic!("the {name}: {violation}");
        }
        let alike = spec.observation == safe.observation && spec.actions == safe.actions;
        assert!(alike, "the Safe world and the {name} have other observations or actions");
    }
}

/// Whether the parts of a trainer belong together, once for all kinds of worlds; what does not, if so. `networks` says
/// that learner and reward model are for the worlds.
fn fit(worlds: [&EnvSpec; 3], held: ObservationSpec, seen: usize, networks: bool) -> Result<(), String> {
    let [spec, ..] = worlds;
    if worlds.iter().any(|world| world.observation != spec.observation || world.actions != spec.actions) {
        return Err("its worlds differ in their observations or actions".to_owned());
    }
    let kind = |spec: ObservationSpec| {
        alloc::format!("{} {}", spec.width, if spec.binary { "zeros and ones" } else { "numbers" })
    };
    if held != spec.observation || seen != spec.observation.width {
        let (held, shown) = (kind(held), kind(spec.observation));
        return Err(alloc::format!("its observations are {held}, those of its world here are {shown}"));
    }
    if !networks {
        return Err("its networks are for other observations or actions than those of its world here".to_owned());
    }
    Ok(())
}

/// Whether the action is one of its world; not so are numbers that are none, when training has diverged.
///
/// # Panics
/// If it is of no world, which networks would say far from here.
fn is_offered<A: Action>(action: &A, spec: &ActionSpec) -> bool {
    let value = action.value();
    let offered = A::from_value(&value, spec).is_some();
    let diverged = matches!(&value, ActionValue::Continuous(numbers) if !numbers.iter().all(|x| x.is_finite()));
    if !offered && !diverged {
        not_offered(spec, &value);
    }
    offered
}

fn not_offered(spec: &ActionSpec, action: &ActionValue) -> ! {
    panic!("the learner chose {}, which its world does not offer", spec.name(action))
}

impl<E: Environment<Action = Discrete>> Trainer<E, Ddqn> {
    /// A DDQN learner with the networks that `config` describes, drawn from its seed.
    ///
    /// # Panics
    /// As [`Trainer::new`].
    pub fn gridworld(config: Config, safe: E, full: E) -> Self {
        assert_alike(&safe, &full);
        Self::built_in(config, safe, full)
    }

    /// The same of worlds that are known to go together: those of this program, which tests hold to the contract.
    pub(crate) fn built_in(config: Config, safe: E, full: E) -> Self {
        if cfg!(debug_assertions) {
            assert_alike(&safe, &full);
        }
        let agent = Ddqn::configured(&config, safe.spec());
        let reward = RewardModel::configured(&config, safe.spec());
        Self::put_together(config, safe, full, agent, reward)
    }
}

impl<E: Environment<Action = Continuous<N>>, const N: usize> Trainer<E, Td3<N>> {
    /// A TD3 learner with the networks that `config` describes, drawn from its seed. [`Config::custom`] has DDQN's values
    /// for gridworlds; what TD3 wants otherwise stands there.
    ///
    /// # Panics
    /// As [`Trainer::new`].
    pub fn continuous(config: Config, safe: E, full: E) -> Self {
        assert_alike(&safe, &full);
        let agent = Td3::configured(&config, safe.spec());
        let reward = RewardModel::configured(&config, safe.spec());
        Self::new(config, safe, full, agent, reward)
    }
}

/// What the next poll does.
#[derive(Clone, Serialize, Deserialize)]
enum Activity<A> {
    Begin,
    Evaluate,
    Step,
    Check(Box<Pending<A>>),
    Switch,
    Done,
    /// Training diverged: what was not finite.
    Failed(String),
}

/// A step whose transition waits for its verdict.
#[derive(Clone, Serialize, Deserialize)]
struct Pending<A> {
    transition: Transition<A>,
    raw: RawStep,
    predicted: f32,
    before: Frame,
    /// Names the random streams of its check.
    draw: u64,
}

/// What the environment said about a step.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct RawStep {
    reward: f32,
    performance: f32,
    end: Option<EpisodeEnd>,
}

/// The unmodified future of the last check, valid while nothing has been learned since.
#[derive(Clone, Serialize, Deserialize)]
#[serde(bound(
    serialize = "A: Serialize, A::Action: Serialize",
    deserialize = "A: Deserialize<'de>, A::Action: Deserialize<'de>"
))]
struct Reusable<A: Agent> {
    updates: u64,
    pushed: u64,
    tail: Vec<Transition<A::Action>>,
    policy: A,
    resets: Vec<Rollout>,
}

/// Working memory without content.
#[derive(Clone)]
struct Work<A> {
    batch: Minibatch<A>,
    slots: Vec<u32>,
    scratch: Scratch,
    rows: Rows,
    numbers: Vec<f32>,
}

impl<A> Default for Work<A> {
    fn default() -> Self {
        Self {
            batch: Minibatch::default(),
            slots: Vec::new(),
            scratch: Scratch::default(),
            rows: Rows::default(),
            numbers: Vec::new(),
        }
    }
}

impl<E: Environment<Action = A::Action>, A: Agent> Trainer<E, A> {
    /// A trainer at the beginning of the Safe leg. `safe` and `full` are templates: every leg starts
    /// with a reset of a copy. Their observations and actions must have the same shape.
    ///
    /// # Panics
    /// If a spec of these worlds or of Full's model makes no sense ([`contract`] has the rules), their shapes differ,
    /// learner or reward model are for another shape, or `config` was put together by hand and is not valid
    /// ([`Config::validate`]).
    pub fn new(config: Config, safe: E, full: E, agent: A, reward_model: RewardModel) -> Self {
        assert_alike(&safe, &full);
        let trainer = Self::put_together(config, safe, full, agent, reward_model);
        if let Err(why) = trainer.fits() {
            panic!("this trainer does not hold together: {why}");
        }
        trainer
    }

    fn put_together(config: Config, safe: E, full: E, agent: A, reward_model: RewardModel) -> Self {
        let spec = safe.spec().clone();
        config.assert_valid();
        let replay = ReplayBuffer::new(spec.observation, config.replay);
        let mut trainer = Self {
            world: Paying::observed(safe.clone()),
            observation: vec![0.0; spec.observation.width],
            chosen: None,
            explore_rng: Rng::new(0),
            world_rng: Rng::new(0),
            arm: Arm::Safe,
            step: 0,
            updates: 0,
            dropped: 0,
            episode: Episode::default(),
            tail: Vec::new(),
            activity: Activity::Begin,
            losses: Losses::default(),
            checks: 0,
            refusals: 0,
            forecast_updates: 0,
            reusable: None,
            work: Work::default(),
            check_progress: None,
            config,
            safe,
            full,
            agent,
            reward_model,
            replay,
        };
        trainer.enter(Arm::Safe);
        trainer
    }

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The learner.
    pub fn agent(&self) -> &A {
        &self.agent
    }

    /// The reward model.
    pub fn reward_model(&self) -> &RewardModel {
        &self.reward_model
    }

    /// The replay buffer.
    pub fn replay(&self) -> &ReplayBuffer<A::Action> {
        &self.replay
    }

    /// The live environment.
    pub fn world(&self) -> &E {
        self.world.world()
    }

    /// Whether what it holds has the shape of its worlds' observations and actions, which a world that is read back may
    /// have changed; what does not, if so.
    pub(crate) fn fits(&self) -> Result<(), String> {
        let spec = self.safe.spec();
        let networks = self.agent.fits(spec) && self.reward_model.fits(spec);
        let worlds = [spec, self.full.spec(), self.world.world().spec()];
        fit(worlds, self.replay.spec(), self.observation.len(), networks)
    }

    /// Chooses the learner of the Full leg.
    ///
    /// `None`, with nothing changed, if the Full leg has begun.
    pub fn choose(&mut self, agent: Learner) -> Option<()> {
        (self.arm == Arm::Safe).then(|| self.config.agent = agent)
    }

    /// Forgets the unmodified future of the last check, so that the next check forecasts both. Changes
    /// no decision, only its cost. During a check it does nothing: the jobs of a check stay the same.
    pub fn forget_forecast(&mut self) {
        if !matches!(self.activity, Activity::Check(_)) || self.check_progress.is_none() {
            self.reusable = None;
        }
    }

    /// Makes the check that is under way anew with other random streams, those that `draw` names; `paired` says
    /// whether its two futures share them. For measuring how far a decision depends on chance: a trainer that
    /// was treated so is no run of its configuration any more. Give it a new forecaster.
    ///
    /// `None`, with nothing changed, unless a check is under way.
    pub fn redraw_check(&mut self, draw: u64, paired: bool) -> Option<()> {
        let Activity::Check(pending) = &mut self.activity else { return None };
        pending.draw = draw;
        (self.config.paired_batches, self.config.paired_rollouts) = (paired, paired);
        (self.reusable, self.check_progress) = (None, None);
        Some(())
    }

    /// Where the run stands.
    pub fn status(&self) -> Status {
        match self.activity {
            Activity::Switch => Status::Switch,
            Activity::Done => Status::Done,
            _ => Status::Working,
        }
    }

    /// Figures for progress displays.
    pub fn progress(&self) -> Progress {
        Progress {
            arm: self.arm,
            step: self.step,
            steps: self.steps(),
            updates: self.updates,
            checks: self.checks,
            refusals: self.refusals,
            forecast_updates: self.forecast_updates,
            check: matches!(self.activity, Activity::Check(_)).then(|| self.check_progress.unwrap_or(0.0)),
        }
    }

    /// Does a bounded amount of work. The budget has no influence on any result; the forecaster has none
    /// beyond its arithmetic.
    ///
    /// A budget of 0 does nothing. Each trainer has a forecaster of its own.
    ///
    /// # Errors
    /// If a loss, a parameter or a utility is not finite, or the world's step is not what its spec says: every later
    /// poll with a budget then says the same. If the forecaster fails: the poll can then be repeated with another one.
    pub fn poll(
        &mut self,
        forecaster: &mut dyn Forecaster<E, A>,
        budget: Budget,
        recorder: &mut dyn Recorder,
    ) -> Result<Status, RunError> {
        let result = self.work(forecaster, budget, recorder);
        match &result {
            Err(RunError::NotFinite { what, .. }) => self.activity = Activity::Failed(what.clone()),
            Err(RunError::NotBinary { .. }) => self.activity = Activity::Failed(NOT_BINARY.to_owned()),
            _ => {}
        }
        result
    }

    fn work(
        &mut self,
        forecaster: &mut dyn Forecaster<E, A>,
        mut budget: Budget,
        recorder: &mut dyn Recorder,
    ) -> Result<Status, RunError> {
        while budget.0 > 0 {
            match &self.activity {
                Activity::Begin => {
                    recorder.record(&Event::Start(StartRecord { arm: self.arm, steps: self.steps() }));
                    self.reset();
                    self.activity = Activity::Evaluate;
                }
                Activity::Evaluate => {
                    self.evaluate(&mut budget, recorder)?;
                    self.activity = Activity::Step;
                    if self.step == self.steps() {
                        self.finish_leg(recorder)?;
                        break;
                    }
                }
                Activity::Step => self.make_step(&mut budget, recorder)?,
                Activity::Check(_) => {
                    if self.check(forecaster, &mut budget, recorder)?.is_pending() {
                        break;
                    }
                }
                Activity::Switch => {
                    self.enter(Arm::of(self.config.agent));
                }
                Activity::Done => break,
                Activity::Failed(what) if what == NOT_BINARY => return Err(self.not_binary()),
                Activity::Failed(what) => return Err(self.not_finite(what)),
            }
        }
        Ok(self.status())
    }

    /// Starts a leg: its world, its streams, its counters.
    fn enter(&mut self, arm: Arm) {
        // Learners that share a Safe leg also share the streams of the Full one.
        let phase = u64::from(arm != Arm::Safe);
        self.world = match arm {
            Arm::Safe => Paying::observed(self.safe.clone()),
            Arm::Oracle => Paying::performance(self.full.clone()),
            Arm::Baseline | Arm::Mc | Arm::Frozen | Arm::FrozenReward => Paying::observed(self.full.clone()),
        };
        self.explore_rng = Rng::stream(self.config.seed, Purpose::Explore, phase);
        self.world_rng = Rng::stream(self.config.seed, Purpose::World, phase);
        self.chosen = None;
        self.arm = arm;
        self.step = 0;
        (self.checks, self.refusals, self.forecast_updates) = (0, 0, 0);
        self.activity = Activity::Begin;
    }

    fn finish_leg(&mut self, recorder: &mut dyn Recorder) -> Result<(), RunError> {
        if !(self.agent.is_finite() && self.reward_model.network().is_finite()) {
            return Err(self.not_finite("a parameter"));
        }
        let digest = Digest::default().u64(self.agent.digest()).u64(self.reward_model.digest()).finish();
        let (arm, steps, updates) = (self.arm, self.step, self.updates);
        recorder.record(&Event::End(EndRecord { arm, steps, updates, digest: alloc::format!("{digest:016x}") }));
        self.activity = if self.arm == Arm::Safe { Activity::Switch } else { Activity::Done };
        Ok(())
    }

    /// Steps of the current leg.
    fn steps(&self) -> u32 {
        if self.arm == Arm::Safe { self.config.safe_steps } else { self.config.full_steps }
    }

    fn reset(&mut self) {
        self.world.reset(&mut self.world_rng, &mut self.observation);
        self.episode = Episode::default();
        self.tail.clear();
    }

    /// Probability of a random action at the next step (docs/method.md R9, R10).
    fn epsilon(&self) -> f32 {
        let c = &self.config;
        let continued = self.arm != Arm::Safe && !c.epsilon_restart;
        let step = u64::from(self.step) + if continued { u64::from(c.safe_steps) } else { 0 };
        let Some(slope) = step.checked_sub(u64::from(c.exploration)) else { return 1.0 };
        if slope >= u64::from(c.epsilon_decay) && (c.epsilon_clamp || c.epsilon_decay == 0) {
            return c.epsilon_end;
        }
        let part = slope as f32 / c.epsilon_decay as f32;
        (c.epsilon_start + (c.epsilon_end - c.epsilon_start) * part).clamp(0.0, 1.0)
    }

    /// Steps of Safe training before its first update.
    fn learning_starts(&self) -> u32 {
        if self.config.learning_starts > 0 { self.config.learning_starts } else { self.config.exploration }
    }

    /// True if an evaluation is due after `step` steps of the leg.
    fn evaluation_due(&self, step: u32) -> bool {
        let (points, steps) = (u64::from(self.config.evaluations), u64::from(self.steps()));
        // Point i stands at step ⌈i·steps/points⌉: evenly spread, the last at the end.
        let point = u64::from(step) * points / steps.max(1);
        (point * steps).div_ceil(points) == u64::from(step)
    }

    /// Checks what the world wrote: networks read it, and one that is no number would be noticed far from here; what is
    /// called binary is packed into bits.
    fn check_observation(&self, observation: &[f32]) -> Result<(), RunError> {
        if !observation.iter().all(|number| number.is_finite()) {
            return Err(self.not_finite(WORLD_OBSERVATION));
        }
        let binary = self.world.spec().observation.binary;
        if binary && !observation.iter().all(|number| *number == 0.0 || *number == 1.0) {
            return Err(self.not_binary());
        }
        Ok(())
    }

    /// An action for the current observation, exploring.
    fn pick(&mut self) -> Result<A::Action, RunError> {
        self.check_observation(&self.observation)?;
        let epsilon = self.epsilon();
        let work = &mut self.work;
        work.rows.clear(self.world.spec().observation);
        work.rows.push_observation(&self.observation);
        let actions = &self.world.spec().actions;
        let action = self.agent.explore(&work.rows, actions, epsilon, &mut self.explore_rng, &mut work.scratch);
        if is_offered(&action, actions) { Ok(action) } else { Err(self.not_finite("an action")) }
    }

    fn make_step(&mut self, budget: &mut Budget, recorder: &mut dyn Recorder) -> Result<(), RunError> {
        let before = if self.arm == Arm::Mc { self.world.frame() } else { Frame::default() };
        let action = match self.chosen.take() {
            Some(action) => action,
            None => self.pick()?,
        };
        let work = &mut self.work;
        work.rows.clear(self.world.spec().observation);
        work.rows.push_observation(&self.observation);
        let model = &self.reward_model;
        model.predict(&work.rows, core::slice::from_ref(&action), &mut work.scratch, &mut work.numbers);
        let predicted = work.numbers[0];
        let observation = self.observation.clone();
        let Step { reward, performance, end } = self.world.step(&action, &mut self.world_rng, &mut self.observation);
        self.step += 1;
        self.episode.length += 1;
        self.episode.observed_return += f64::from(reward);
        self.episode.performance += f64::from(performance);
        let raw = RawStep { reward, performance, end };
        let transition = Transition {
            observation,
            action,
            reward: self.world.spec().scaled(reward),
            next_observation: self.observation.clone(),
            terminated: end == Some(EpisodeEnd::Terminated),
        };
        // Also at an end, where no network reads it: a transition that does not equal itself can never be checked.
        // The one before the step was looked at when its action was chosen.
        self.check_observation(&transition.next_observation)?;
        // The scaled one is beyond all numbers where the raw one is near the end of them.
        if !(raw.reward.is_finite() && transition.reward.is_finite()) {
            return Err(self.not_finite(WORLD_REWARD));
        }
        if !raw.performance.is_finite() {
            return Err(self.not_finite(WORLD_PERFORMANCE));
        }
        if !predicted.is_finite() {
            return Err(self.not_finite("a predicted reward"));
        }
        budget.spend(1);
        // After an episode the next action waits for the reset.
        if self.config.check_after == CheckAfter::NextAction && end.is_none() {
            self.chosen = Some(self.pick()?);
        }
        let pending = Pending { transition, raw, predicted, before, draw: 0 };
        match self.arm {
            Arm::Mc => self.consider(pending, budget, recorder),
            Arm::FrozenReward => self.finish_step(pending, None, Disposition::StoreAs(predicted), recorder),
            _ => self.finish_step(pending, None, Disposition::Store, recorder),
        }
    }

    /// Stores and learns, or not; ends the step. `verdict` is there where there was something to decide.
    fn finish_step(
        &mut self,
        pending: Pending<A::Action>,
        verdict: Option<Verdict>,
        disposition: Disposition,
        recorder: &mut dyn Recorder,
    ) -> Result<(), RunError> {
        let Pending { transition, raw, predicted, .. } = pending;
        let stored = disposition != Disposition::Drop;
        self.tell_step(&transition, raw, predicted, verdict.is_some(), stored, recorder);
        self.store(transition, disposition);
        // Safe training updates after its exploration steps (R9), the Full leg from its first step (R10).
        let learning = match self.arm {
            Arm::Safe => self.step > self.learning_starts(),
            Arm::Frozen => false,
            _ => true,
        };
        if learning && (stored || self.config.update_on_refusal) {
            self.learn()?;
        }
        self.end_step(raw, verdict == Some(Verdict::Refuse) && self.config.reset_on_refusal, recorder);
        Ok(())
    }

    fn tell_step(
        &self,
        transition: &Transition<A::Action>,
        raw: RawStep,
        predicted: f32,
        checked: bool,
        stored: bool,
        recorder: &mut dyn Recorder,
    ) {
        recorder.record(&Event::Step(StepRecord {
            arm: self.arm,
            step: self.step,
            action: transition.action.value(),
            reward_raw: raw.reward,
            performance: raw.performance,
            reward: transition.reward,
            predicted,
            checked,
            stored,
            end: raw.end,
        }));
    }

    /// The only place where the replay buffer grows.
    fn store(&mut self, mut transition: Transition<A::Action>, disposition: Disposition) {
        match disposition {
            Disposition::Store => {
                self.replay.push(&transition);
                if self.config.forced == ForcedKind::Episode {
                    if self.tail.len() == TAIL {
                        self.tail.remove(0);
                    }
                    self.tail.push(transition);
                }
            }
            // What was made up is no accepted transition of the episode.
            Disposition::StoreAs(reward) => {
                transition.reward = reward;
                self.replay.push(&transition);
            }
            Disposition::Drop => {}
        }
    }

    /// Ends the episode where the environment or, with `cut`, a refusal does; then the next activity.
    fn end_step(&mut self, raw: RawStep, cut: bool, recorder: &mut dyn Recorder) {
        if raw.end.is_some() || cut {
            let Episode { observed_return, performance, length } = self.episode;
            let (arm, step, cut) = (self.arm, self.step, raw.end.is_none());
            recorder.record(&Event::Episode(EpisodeRecord { arm, step, observed_return, performance, length, cut }));
            self.reset();
        }
        self.activity = if self.evaluation_due(self.step) { Activity::Evaluate } else { Activity::Step };
    }

    /// One update of the value function and one of the reward model (unless that is frozen); false while the
    /// replay buffer holds no full mini-batch.
    fn learn(&mut self) -> Result<bool, RunError> {
        let (len, batch) = (self.replay.len(), self.config.batch);
        if len < batch {
            return Ok(false);
        }
        let seed = self.config.seed;
        // An update that was dropped had its draw: the next one has another.
        let draw = self.updates + self.dropped;
        let Work { batch: minibatch, slots, .. } = &mut self.work;
        let none = Forced::new(&[], &self.replay);
        draw_slots(len, batch, &mut Rng::stream(seed, Purpose::Batch, draw), slots);
        minibatch.gather(&self.replay, slots, &none);
        let value = self.agent.update(minibatch, &mut Rng::stream(seed, Purpose::Update, draw));
        self.updates += 1;
        if !value.is_finite() {
            return Err(self.not_finite("the loss of the value function"));
        }
        self.losses.value += f64::from(value);
        self.losses.updates += 1;
        if self.arm == Arm::FrozenReward {
            return Ok(true);
        }
        let Work { batch: minibatch, slots, .. } = &mut self.work;
        if self.config.reward_batch == RewardBatch::Separate {
            draw_slots(len, batch, &mut Rng::stream(seed, Purpose::RewardBatch, draw), slots);
            minibatch.gather(&self.replay, slots, &none);
        }
        let reward = self.reward_model.update(minibatch);
        if !reward.is_finite() {
            return Err(self.not_finite("the loss of the reward model"));
        }
        self.losses.reward += f64::from(reward);
        self.losses.reward_updates += 1;
        Ok(true)
    }

    fn not_binary(&self) -> RunError {
        RunError::NotBinary { arm: self.arm, step: self.step }
    }

    fn not_finite(&self, what: &str) -> RunError {
        RunError::NotFinite { what: what.to_owned(), arm: self.arm, step: self.step }
    }
}

mod evaluation;
mod gate;
#[cfg(test)]
mod tests;
