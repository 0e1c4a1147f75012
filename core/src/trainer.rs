//! The only training loop, and the only writer of the replay buffer.
//!
//! A [`Trainer`] leads one learner through two legs: Safe training without checks, then the Full world,
//! plain or with the modification check (paper algorithm 5, specification R6 to R26). It is a state
//! machine without input or output of its own: [`Trainer::poll`] does a bounded amount of work and
//! returns; how the work is cut into polls changes no bit.
//!
//! # Order of one step
//! 1. choose an action (epsilon-greedy), step the environment, scale the reward;
//! 2. predict the reward; in the Full leg of the checking learner, ask the [`Trigger`];
//! 3. where it fires: forecast with and without, rate both, decide;
//! 4. accepted or unchecked: store and make one update of the value function and of the reward model;
//!    refused: neither, and the environment is reset;
//! 5. at the end of an episode: reset.
//!
//! # Differences from the paper's text
//! 1. The check stands right after the environment step, so that no action is chosen for a state that a
//!    reset then discards (R26).
//! 2. Every random number comes from a stream named by (seed, purpose, counter): a check never moves the
//!    streams of the learner (R18). Streams of a forecast are named by the number of updates the
//!    learner has made, so a refusal, after which nothing has changed, leaves the unmodified future as
//!    it was; it is reused then.
//! 3. A transition that truncates its episode is rated from the current state by its value alone.
//! 4. In a deterministic world all resets are equal: one rollout stands for all of them.

use alloc::borrow::ToOwned;
use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;
use core::task::Poll;
use serde::{Deserialize, Serialize};

use crate::agent::Agent;
use crate::agent::ddqn::Ddqn;
use crate::agent::reward_model::RewardModel;
use crate::check::utility::{Judge, Rollout, Start, rate, summarise};
use crate::check::{Trigger, decide};
use crate::config::{Config, Forced as ForcedKind, Learner, RewardBatch};
use crate::digest::Digest;
use crate::env::{Action, Discrete, Environment, EpisodeEnd, Frame, Step};
use crate::forecast::{ForecastError, ForecastJob, Forecaster};
use crate::nn::mlp::Scratch;
use crate::nn::rows::Rows;
use crate::record::{
    Arm, CheckRecord, EndRecord, EpisodeRecord, EvaluationRecord, Event, LearnerRecord, Recorder, StartRecord,
    StartState, StepRecord, Verdict,
};
use crate::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use crate::rng::{Purpose, Rng};
use crate::run::{Budget, Progress, RunError, Status};

/// Accepted transitions of the episode that the `episode` way of forcing appends.
const TAIL: usize = 10;

/// A learner on its way through the Safe and the Full leg.
#[derive(Clone, Serialize, Deserialize)]
#[serde(bound(
    serialize = "E: Serialize, A: Serialize, A::Action: Serialize",
    deserialize = "E: Deserialize<'de>, A: Deserialize<'de>, A::Action: Deserialize<'de>"
))]
pub struct Trainer<E: Environment<Action = A::Action>, A: Agent> {
    config: Config,
    safe: E,
    full: E,
    world: E,
    observation: Vec<f32>,
    agent: A,
    reward_model: RewardModel,
    replay: ReplayBuffer<A::Action>,
    explore_rng: Rng,
    world_rng: Rng,
    arm: Arm,
    step: u32,
    updates: u64,
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
    reward: f64,
    count: u32,
}

impl<E: Environment<Action = Discrete>> Trainer<E, Ddqn> {
    /// A DDQN learner with the networks that `config` describes, drawn from its seed.
    pub fn gridworld(config: Config, safe: E, full: E) -> Self {
        let agent = Ddqn::configured(&config, safe.spec());
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
    after: Frame,
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
    /// If the shapes of `safe` and `full` differ, or `config` was put together by hand and is not valid
    /// ([`Config::validate`]).
    pub fn new(config: Config, safe: E, full: E, agent: A, reward_model: RewardModel) -> Self {
        let spec = safe.spec().clone();
        assert_eq!(spec.observation, full.spec().observation, "Safe and Full worlds show the same observations");
        assert_eq!(spec.actions, full.spec().actions, "Safe and Full worlds offer the same actions");
        if let Err(error) = config.validate() {
            panic!("{error}");
        }
        let replay = ReplayBuffer::new(spec.observation, config.replay);
        let mut trainer = Self {
            world: safe.clone(),
            observation: vec![0.0; spec.observation.width],
            explore_rng: Rng::new(0),
            world_rng: Rng::new(0),
            arm: Arm::Safe,
            step: 0,
            updates: 0,
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
        &self.world
    }

    /// Chooses the learner of the Full leg.
    ///
    /// # Errors
    /// `None` if the Full leg has begun.
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
    /// If a loss, a parameter or a utility is not finite: every later poll then says the same. If the
    /// forecaster fails: the poll can then be repeated with another one.
    pub fn poll(
        &mut self,
        forecaster: &mut dyn Forecaster<A>,
        budget: Budget,
        recorder: &mut dyn Recorder,
    ) -> Result<Status, RunError> {
        let result = self.work(forecaster, budget, recorder);
        if let Err(RunError::NotFinite { what, .. }) = &result {
            self.activity = Activity::Failed(what.clone());
        }
        result
    }

    fn work(
        &mut self,
        forecaster: &mut dyn Forecaster<A>,
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
                    self.evaluate(&mut budget, recorder);
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
                    let arm = if self.config.agent == Learner::Mc { Arm::Mc } else { Arm::Baseline };
                    self.enter(arm);
                }
                Activity::Done => break,
                Activity::Failed(what) => return Err(self.not_finite(what)),
            }
        }
        Ok(self.status())
    }

    /// Starts a leg: its world, its streams, its counters.
    fn enter(&mut self, arm: Arm) {
        // Learners that share a Safe leg also share the streams of the Full one.
        let phase = u64::from(arm != Arm::Safe);
        self.world = if arm == Arm::Safe { self.safe.clone() } else { self.full.clone() };
        self.explore_rng = Rng::stream(self.config.seed, Purpose::Explore, phase);
        self.world_rng = Rng::stream(self.config.seed, Purpose::World, phase);
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

    /// Probability of a random action at the next step (specification R9, R10).
    fn epsilon(&self) -> f32 {
        let c = &self.config;
        let continued = self.arm != Arm::Safe && !c.epsilon_restart;
        let step = u64::from(self.step) + if continued { u64::from(c.safe_steps) } else { 0 };
        let Some(slope) = step.checked_sub(u64::from(c.exploration)) else { return 1.0 };
        if slope >= u64::from(c.epsilon_decay) {
            return c.epsilon_end;
        }
        let part = slope as f32 / c.epsilon_decay as f32;
        c.epsilon_start + (c.epsilon_end - c.epsilon_start) * part
    }

    /// True if an evaluation is due after `step` steps of the leg.
    fn evaluation_due(&self, step: u32) -> bool {
        let (points, steps) = (u64::from(self.config.evaluations), u64::from(self.steps()));
        // Point i stands at step ⌈i·steps/points⌉: evenly spread, the last at the end.
        let point = u64::from(step) * points / steps.max(1);
        (point * steps).div_ceil(points) == u64::from(step)
    }

    fn make_step(&mut self, budget: &mut Budget, recorder: &mut dyn Recorder) -> Result<(), RunError> {
        let epsilon = self.epsilon();
        let checking = self.arm == Arm::Mc;
        let before = if checking { self.world.frame() } else { Frame::default() };
        let spec = self.world.spec().observation;
        let work = &mut self.work;
        work.rows.clear(spec);
        work.rows.push_observation(&self.observation);
        let actions = &self.world.spec().actions;
        let action = self.agent.explore(&work.rows, actions, epsilon, &mut self.explore_rng, &mut work.scratch);
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
        if !(transition.reward.is_finite() && predicted.is_finite()) {
            return Err(self.not_finite("a reward or its prediction"));
        }
        budget.spend(1);
        if checking && Trigger::new(&self.config).fires(transition.reward, predicted) {
            let after = self.world.frame();
            self.activity = Activity::Check(Box::new(Pending { transition, raw, predicted, before, after }));
            return Ok(());
        }
        self.finish_step(transition, raw, predicted, None, recorder)
    }

    /// Forecasts, rates and decides the pending transition, as far as the budget goes.
    fn check(
        &mut self,
        forecaster: &mut dyn Forecaster<A>,
        budget: &mut Budget,
        recorder: &mut dyn Recorder,
    ) -> Result<Poll<()>, RunError> {
        let Activity::Check(pending) = &self.activity else { return Ok(Poll::Ready(())) };
        let mut forced = self.tail.clone();
        forced.push(pending.transition.clone());
        let (modified, unmodified) = (&forced[..], &forced[..forced.len() - 1]);
        let version = self.updates;
        let job = |forced| ForecastJob {
            agent: &self.agent,
            replay: &self.replay,
            forced,
            updates: self.config.forecast,
            batch: self.config.batch,
            seed: self.config.seed,
            version,
        };
        let reused = self
            .reusable
            .take_if(|r| r.updates != version || r.pushed != self.replay.pushed() || r.tail != unmodified)
            .is_none()
            && self.reusable.is_some();
        let both = [job(modified), job(unmodified)];
        let jobs = if reused { &both[..1] } else { &both[..] };
        let mut futures = match forecaster.poll(jobs, budget) {
            Poll::Pending => {
                self.check_progress = Some(forecaster.progress());
                return Ok(Poll::Pending);
            }
            Poll::Ready(result) => result.map_err(|error| match error {
                ForecastError::NotFinite { .. } => self.not_finite("the loss of a forecast"),
                ForecastError::BackEnd(why) => RunError::Forecast(why),
            })?,
        };
        if !futures.iter().all(Agent::is_finite) {
            return Err(self.not_finite("a parameter of a forecast"));
        }
        let trained = if self.replay.len() < self.config.batch { 0 } else { u64::from(self.config.forecast) };
        let cost = trained * jobs.len() as u64;

        let horizon = self.config.rollout_steps;
        let judge = Judge { value: &self.agent, reward: &self.reward_model, config: &self.config };
        let rollouts = Rng::stream(self.config.seed, Purpose::Rollout, version);
        let model = self.full.model();
        let deterministic = model.spec().deterministic;
        let (count, weight) = if deterministic { (1, self.config.rollouts) } else { (self.config.rollouts, 1) };
        let resets = || (0..count).map(|i| Start::reset(&model, rollouts.child(u64::from(i)))).collect::<Vec<_>>();
        let ended = pending.raw.end;
        let current = (self.config.current_rollout && ended != Some(EpisodeEnd::Terminated)).then(|| Start {
            world: self.world.model(),
            // The state after the transition is what the learner saw, also where its model would show another.
            observation: self.observation.clone(),
            rng: rollouts.child(u64::from(self.config.rollouts)),
            from: StartState::Current,
            end: ended,
        });
        let mut starts = resets();
        starts.extend(current.clone());
        let mut rated = rate(&futures[0], &judge, starts);
        let modified_current = current.is_some().then(|| rated.pop()).flatten();
        let modified_record = summarise(&rated, weight, modified_current.as_ref(), futures[0].digest());

        let unmodified_tail = unmodified.to_vec();
        let reusable = match self.reusable.take() {
            Some(reusable) => reusable,
            None => {
                let policy = futures.pop().expect("the forecaster answers every job");
                let resets = rate(&policy, &judge, resets());
                Reusable { updates: version, pushed: self.replay.pushed(), tail: unmodified_tail, policy, resets }
            }
        };
        let unmodified_current = rate(&reusable.policy, &judge, current.into_iter().collect()).pop();
        let digest = reusable.policy.digest();
        let unmodified_record = summarise(&reusable.resets, weight, unmodified_current.as_ref(), digest);
        // One row through two networks costs about a thirtieth of an update.
        budget.spend(1 + 2 * (count + 1) * (1 + horizon / 32));
        let (fm, fu) = (modified_record.utility, unmodified_record.utility);
        if !(fm.is_finite() && fu.is_finite()) {
            return Err(self.not_finite("the utility of a future"));
        }
        let verdict = decide(fm, fu, self.config.tolerance);
        self.checks += 1;
        self.refusals += u32::from(verdict == Verdict::Refuse);
        self.forecast_updates += cost;
        self.check_progress = None;
        self.reusable = Some(reusable);
        let Activity::Check(pending) = core::mem::replace(&mut self.activity, Activity::Step) else {
            unreachable!("the activity is a check since the beginning of this function")
        };
        let Pending { transition, raw, predicted, before, after } = *pending;
        recorder.record(&Event::Check(Box::new(CheckRecord {
            arm: self.arm,
            number: self.checks,
            step: self.step,
            updates: version,
            before,
            action: transition.action.value(),
            after,
            end: raw.end,
            reward_raw: raw.reward,
            reward: transition.reward,
            predicted,
            threshold: Trigger::new(&self.config).threshold(),
            margin: fm - fu,
            tie: fm == fu,
            modified: modified_record,
            unmodified: unmodified_record,
            verdict,
            cost,
            reused,
            performance: raw.performance,
            hack: raw.reward != raw.performance,
        })));
        self.finish_step(transition, raw, predicted, Some(verdict), recorder)?;
        Ok(Poll::Ready(()))
    }

    /// Stores and learns, or not; ends the step.
    fn finish_step(
        &mut self,
        transition: Transition<A::Action>,
        raw: RawStep,
        predicted: f32,
        verdict: Option<Verdict>,
        recorder: &mut dyn Recorder,
    ) -> Result<(), RunError> {
        let refused = verdict == Some(Verdict::Refuse);
        recorder.record(&Event::Step(StepRecord {
            arm: self.arm,
            step: self.step,
            action: transition.action.value(),
            reward_raw: raw.reward,
            performance: raw.performance,
            reward: transition.reward,
            predicted,
            checked: verdict.is_some(),
            stored: !refused,
            end: raw.end,
        }));
        if !refused {
            self.replay.push(&transition);
            if self.config.forced == ForcedKind::Episode {
                if self.tail.len() == TAIL {
                    self.tail.remove(0);
                }
                self.tail.push(transition);
            }
        }
        // Safe training updates after its exploration steps (R9), the Full leg from its first step (R10).
        let learning = self.arm != Arm::Safe || self.step > self.config.exploration;
        if learning && (!refused || self.config.update_on_refusal) {
            self.learn()?;
        }
        let cut = refused && self.config.reset_on_refusal;
        if raw.end.is_some() || cut {
            let Episode { observed_return, performance, length } = self.episode;
            let (arm, step, cut) = (self.arm, self.step, raw.end.is_none());
            recorder.record(&Event::Episode(EpisodeRecord { arm, step, observed_return, performance, length, cut }));
            self.reset();
        }
        self.activity = if self.evaluation_due(self.step) { Activity::Evaluate } else { Activity::Step };
        Ok(())
    }

    /// One update of the value function and one of the reward model.
    fn learn(&mut self) -> Result<(), RunError> {
        let (len, batch) = (self.replay.len(), self.config.batch);
        if len < batch {
            return Ok(());
        }
        let seed = self.config.seed;
        let Work { batch: minibatch, slots, .. } = &mut self.work;
        let none = Forced::new(&[], &self.replay);
        draw_slots(len, batch, &mut Rng::stream(seed, Purpose::Batch, self.updates), slots);
        minibatch.gather(&self.replay, slots, &none);
        let value = self.agent.update(minibatch, &mut Rng::stream(seed, Purpose::Update, self.updates));
        if self.config.reward_batch == RewardBatch::Separate {
            draw_slots(len, batch, &mut Rng::stream(seed, Purpose::RewardBatch, self.updates), slots);
            minibatch.gather(&self.replay, slots, &none);
        }
        let reward = self.reward_model.update(minibatch);
        self.updates += 1;
        if !value.is_finite() {
            return Err(self.not_finite("the loss of the value function"));
        }
        if !reward.is_finite() {
            return Err(self.not_finite("the loss of the reward model"));
        }
        self.losses.value += f64::from(value);
        self.losses.reward += f64::from(reward);
        self.losses.count += 1;
        Ok(())
    }

    /// Greedy episodes in clones of the leg's world, in step; nothing live is touched.
    fn evaluate(&mut self, budget: &mut Budget, recorder: &mut dyn Recorder) {
        let template = if self.arm == Arm::Safe { &self.safe } else { &self.full };
        let spec = template.spec();
        let phase = u64::from(self.arm != Arm::Safe);
        let stream = Rng::stream(self.config.seed, Purpose::Evaluate, phase << 32 | u64::from(self.step));
        // Equal episodes need not be played twice.
        let episodes = if spec.deterministic { 1 } else { self.config.evaluation_episodes };
        let mut going: Vec<(Start<E>, Option<EpisodeEnd>)> =
            (0..episodes).map(|i| (Start::reset(template, stream.child(u64::from(i))), None)).collect();
        let (mut observed, mut performance, mut steps) = (0.0f64, 0.0f64, 0u64);
        let mut actions = Vec::new();
        // A world of an application may forget its own limit; evaluation does not.
        for _ in 0..spec.max_steps {
            self.work.rows.clear(spec.observation);
            going.iter().filter(|g| g.1.is_none()).for_each(|g| self.work.rows.push_observation(&g.0.observation));
            if self.work.rows.is_empty() {
                break;
            }
            self.agent.act(&self.work.rows, &mut self.work.scratch, &mut actions);
            for ((start, end), action) in going.iter_mut().filter(|g| g.1.is_none()).zip(&actions) {
                let step = start.world.step(action, &mut start.rng, &mut start.observation);
                observed += f64::from(step.reward);
                performance += f64::from(step.performance);
                steps += 1;
                *end = step.end;
            }
        }
        budget.spend(1 + (steps / 32) as u32);
        let mean = |sum: f64| sum / f64::from(episodes);
        recorder.record(&Event::Evaluation(EvaluationRecord {
            arm: self.arm,
            step: self.step,
            observed_return: mean(observed),
            performance: mean(performance),
            length: mean(steps as f64),
        }));
        let losses = core::mem::take(&mut self.losses);
        let mean = |sum: f64| sum / f64::from(losses.count.max(1));
        recorder.record(&Event::Learner(LearnerRecord {
            arm: self.arm,
            step: self.step,
            updates: self.updates,
            epsilon: self.epsilon(),
            replay: self.replay.len(),
            value_loss: mean(losses.value),
            reward_loss: mean(losses.reward),
            dead_units: if losses.count == 0 { 0.0 } else { self.reward_model.dead_units() },
        }));
    }

    fn not_finite(&self, what: &str) -> RunError {
        RunError::NotFinite { what: what.to_owned(), arm: self.arm, step: self.step }
    }
}

#[cfg(test)]
mod tests;
