//! The gate of the Full leg: what the checking learner's scheme decides about a step, and how.

use alloc::boxed::Box;
use alloc::vec::Vec;
use core::task::Poll;

use super::{Activity, Pending, Reusable, Trainer};
use crate::agent::Agent;
use crate::check::utility::{Judge, Start, rate, summarise};
use crate::check::{Disposition, Trigger, decide};
use crate::config::{Against, Scheme};
use crate::env::{Action, Environment, EpisodeEnd};
use crate::forecast::{Carry, ForecastError, ForecastJob, Forecaster, Practice};
use crate::record::{CheckRecord, Event, FutureRecord, Recorder, StartState, Subject, Verdict};
use crate::rng::{Purpose, Rng};
use crate::run::{Budget, RunError};

/// A decision with its grounds.
struct Decision {
    subject: Subject,
    verdict: Verdict,
    /// Modified and unmodified.
    futures: Option<(FutureRecord, FutureRecord)>,
    replaced: Option<f32>,
    /// Updates of the learner when the step was made.
    updates: u64,
    cost: u64,
    reused: bool,
}

/// Where two futures are rated: resets, each standing for `weight` equal ones, and the current state.
struct Starts<E> {
    resets: Vec<Start<E>>,
    weight: u32,
    current: Option<Start<E>>,
}

impl<E: Environment<Action = A::Action>, A: Agent> Trainer<E, A> {
    /// What the scheme makes of a step of the checking learner.
    pub(super) fn consider(
        &mut self,
        mut pending: Pending<A::Action>,
        budget: &mut Budget,
        recorder: &mut dyn Recorder,
    ) -> Result<(), RunError> {
        if self.config.scheme == Scheme::EachStep {
            pending.draw = self.draw();
            return self.check_update(pending, budget, recorder);
        }
        if !Trigger::new(&self.config).fires(pending.transition.reward, pending.predicted) {
            return self.finish_step(pending, None, Disposition::Store, recorder);
        }
        if self.config.scheme == Scheme::Discard {
            let (subject, verdict, updates) = (Subject::Transition, Verdict::Refuse, self.updates);
            let decision =
                Decision { subject, verdict, futures: None, replaced: None, updates, cost: 0, reused: false };
            self.tell_check(&pending, decision, recorder);
            return self.finish_step(pending, Some(verdict), Disposition::Drop, recorder);
        }
        pending.draw = self.draw();
        self.activity = Activity::Check(Box::new(pending));
        Ok(())
    }

    /// Names the random streams of a check (docs/method.md R18): by what has been learned, or by a number
    /// from the learner's own stream.
    fn draw(&mut self) -> u64 {
        if self.config.own_streams { self.updates + self.dropped } else { self.explore_rng.next_u64() }
    }

    /// Forecasts, rates and decides the pending transition, as far as the budget goes.
    pub(super) fn check(
        &mut self,
        forecaster: &mut dyn Forecaster<E, A>,
        budget: &mut Budget,
        recorder: &mut dyn Recorder,
    ) -> Result<Poll<()>, RunError> {
        let Activity::Check(pending) = &self.activity else { return Ok(Poll::Ready(())) };
        let mut forced = self.tail.clone();
        forced.push(pending.transition.clone());
        let (modified, unmodified) = (&forced[..], &forced[..forced.len() - 1]);
        let c = &self.config;
        let (updates, draw) = (self.updates, pending.draw);
        // Streams of the unmodified future where they are to be others.
        let other = |paired: bool| if paired { draw } else { !draw };
        let (agent, replay, batch, seed) = (&self.agent, &self.replay, c.batch, c.seed);
        let world = c.practice.then(|| self.world.world().model());
        let job = |forced, updates, version| ForecastJob {
            agent,
            replay,
            forced,
            updates,
            batch,
            seed,
            carry: Carry { target: c.copy_target, optimizer: c.copy_optimizer },
            version,
            practice: world.as_ref().map(|world| Practice {
                world,
                observation: &self.observation,
                ended: pending.raw.end.is_some(),
                reward_model: &self.reward_model,
                reward_updates: c.practice_reward_updates,
                epsilon: c.practice_epsilon,
            }),
        };
        // Nothing has been learned and nothing is drawn differently. Practice begins where the step ended, so
        // there the unmodified future is another one for every transition.
        let valid = |r: &Reusable<A>| {
            let learned = r.updates != updates || r.pushed != replay.pushed() || r.tail != unmodified;
            c.own_streams && !c.practice && !learned
        };
        self.reusable.take_if(|r| !valid(r));
        let reused = self.reusable.is_some();
        let trained = if c.against == Against::Forecast { c.forecast } else { 0 };
        let both = [job(modified, c.forecast, draw), job(unmodified, trained, other(c.paired_batches))];
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
        let cost = jobs.iter().map(|job| u64::from(job.value_updates()) + u64::from(job.reward_updates())).sum();

        let judge = Judge { value: &self.agent, reward: &self.reward_model, config: &self.config };
        let Starts { resets, weight, current } = self.starts(draw, pending.raw.end);
        let count = resets.len() as u32;
        let has_current = current.is_some();
        let mut starts = resets;
        starts.extend(current);
        let mut rated = rate(&futures[0], &judge, starts);
        let modified_current = has_current.then(|| rated.pop()).flatten();
        let modified_record = summarise(&rated, weight, modified_current.as_ref(), futures[0].digest());

        let Starts { resets, current, .. } = self.starts(other(c.paired_rollouts), pending.raw.end);
        let tail = unmodified.to_vec();
        let reusable = match self.reusable.take() {
            Some(reusable) => reusable,
            None => {
                let policy = futures.pop().expect("the forecaster answers every job");
                let resets = rate(&policy, &judge, resets);
                Reusable { updates, pushed: replay.pushed(), tail, policy, resets }
            }
        };
        let unmodified_current = rate(&reusable.policy, &judge, current.into_iter().collect()).pop();
        let digest = reusable.policy.digest();
        let unmodified_record = summarise(&reusable.resets, weight, unmodified_current.as_ref(), digest);
        self.spend_rating(count, budget);
        let verdict = self.decide(&modified_record, &unmodified_record)?;
        self.forecast_updates += cost;
        self.check_progress = None;
        self.reusable = Some(reusable);
        let Activity::Check(pending) = core::mem::replace(&mut self.activity, Activity::Step) else {
            unreachable!("the activity is a check since the beginning of this function")
        };
        let disposition = Disposition::new(verdict, &self.config, pending.predicted);
        let decision = Decision {
            subject: Subject::Transition,
            verdict,
            futures: Some((modified_record, unmodified_record)),
            replaced: if let Disposition::StoreAs(reward) = disposition { Some(reward) } else { None },
            updates,
            cost,
            reused,
        };
        self.tell_check(&pending, decision, recorder);
        self.finish_step(*pending, Some(verdict), disposition, recorder)?;
        Ok(Poll::Ready(()))
    }

    /// The scheme `each-step`: stores the transition, makes one update, rates the greedy
    /// policies after and before it by the values before it, and takes the update back if it made the policy
    /// worse: parameters, target network and optimisers of both networks.
    fn check_update(
        &mut self,
        pending: Pending<A::Action>,
        budget: &mut Budget,
        recorder: &mut dyn Recorder,
    ) -> Result<(), RunError> {
        let (transition, raw, predicted) = (pending.transition.clone(), pending.raw, pending.predicted);
        self.store(transition, Disposition::Store);
        let before = (self.agent.clone(), self.reward_model.clone(), self.losses.clone());
        let updates = self.updates;
        let updated = self.learn()?;
        if updated {
            if !self.agent.is_finite() {
                return Err(self.not_finite("a parameter"));
            }
            let judge = Judge { value: &before.0, reward: &before.1, config: &self.config };
            let future = |policy: &A, draw: u64| {
                let Starts { resets, weight, current } = self.starts(draw, raw.end);
                let count = resets.len() as u32;
                let rated = rate(policy, &judge, resets);
                let current = rate(policy, &judge, current.into_iter().collect()).pop();
                (summarise(&rated, weight, current.as_ref(), policy.digest()), count)
            };
            let other = if self.config.paired_rollouts { pending.draw } else { !pending.draw };
            let ((after, count), (former, _)) = (future(&self.agent, pending.draw), future(&before.0, other));
            let futures = (after, former);
            self.spend_rating(count, budget);
            let verdict = self.decide(&futures.0, &futures.1)?;
            if verdict == Verdict::Refuse {
                (self.agent, self.reward_model, self.losses) = before;
                self.updates = updates;
                self.dropped += 1;
            }
            let (subject, futures) = (Subject::Update, Some(futures));
            let decision = Decision { subject, verdict, futures, replaced: None, updates, cost: 0, reused: false };
            self.tell_check(&pending, decision, recorder);
        }
        self.tell_step(&pending.transition, raw, predicted, updated, true, recorder);
        self.end_step(raw, false, recorder);
        Ok(())
    }

    /// Starts of the rollouts that rate a future, with the random numbers that `draw` names. `end` says
    /// whether the episode ended with the step.
    fn starts(&self, draw: u64, end: Option<EpisodeEnd>) -> Starts<E> {
        let rollouts = Rng::stream(self.config.seed, Purpose::Rollout, draw);
        let model = self.full.model();
        let deterministic = model.spec().deterministic;
        let wanted = self.config.rollouts;
        let (count, weight) = if deterministic { (wanted.min(1), wanted) } else { (wanted, 1) };
        let resets = (0..count).map(|i| Start::reset(&model, rollouts.child(u64::from(i)))).collect();
        let current = (self.config.current_rollout && end != Some(EpisodeEnd::Terminated)).then(|| Start {
            world: self.world.world().model(),
            // The state after the transition is what the learner saw, also where its model would show another.
            observation: self.observation.clone(),
            frame: Some(self.world.frame()),
            rng: rollouts.child(u64::from(self.config.rollouts)),
            from: StartState::Current,
            end,
        });
        Starts { resets, weight, current }
    }

    /// One row through two networks costs about a thirtieth of an update.
    fn spend_rating(&self, resets: u32, budget: &mut Budget) {
        budget.spend(1 + 2 * (resets + 1) * (1 + self.config.rollout_steps / 32));
    }

    fn decide(&self, modified: &FutureRecord, unmodified: &FutureRecord) -> Result<Verdict, RunError> {
        let (fm, fu) = (modified.utility, unmodified.utility);
        if !(fm.is_finite() && fu.is_finite()) {
            return Err(self.not_finite("the utility of a future"));
        }
        Ok(decide(fm, fu, self.config.tolerance))
    }

    /// Counts a decision and records it.
    fn tell_check(&mut self, pending: &Pending<A::Action>, decision: Decision, recorder: &mut dyn Recorder) {
        let Decision { subject, verdict, futures, replaced, updates, cost, reused } = decision;
        self.checks += 1;
        self.refusals += u32::from(verdict == Verdict::Refuse);
        let utilities = futures.as_ref().map(|(modified, unmodified)| (modified.utility, unmodified.utility));
        let (modified, unmodified) = futures.unzip();
        let (transition, raw) = (&pending.transition, pending.raw);
        recorder.record(&Event::Check(Box::new(CheckRecord {
            arm: self.arm,
            number: self.checks,
            step: self.step,
            updates,
            before: pending.before.clone(),
            action: transition.action.value(),
            after: self.world.frame(),
            end: raw.end,
            reward_raw: raw.reward,
            reward: transition.reward,
            predicted: pending.predicted,
            threshold: Trigger::new(&self.config).threshold(),
            subject,
            modified,
            unmodified,
            margin: utilities.map(|(fm, fu)| fm - fu),
            verdict,
            replaced,
            tie: utilities.is_some_and(|(fm, fu)| fm == fu),
            cost,
            reused,
            performance: raw.performance,
            hack: raw.reward != raw.performance,
        })));
    }
}
