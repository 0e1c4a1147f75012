//! Evaluations: how the policy does by then, told to the recorder and to nobody else.

use alloc::vec::Vec;

use super::{Trainer, is_offered};
use crate::agent::Agent;
use crate::check::utility::Start;
use crate::env::{Environment, EpisodeEnd};
use crate::record::{Arm, EvaluationRecord, Event, LearnerRecord, Recorder};
use crate::rng::{Purpose, Rng};
use crate::run::{Budget, RunError, WORLD_PERFORMANCE, WORLD_REWARD};

impl<E: Environment<Action = A::Action>, A: Agent> Trainer<E, A> {
    /// Greedy episodes in clones of the leg's world, in step; nothing live is touched.
    pub(super) fn evaluate(&mut self, budget: &mut Budget, recorder: &mut dyn Recorder) -> Result<(), RunError> {
        // The loss of the last update was finite before its step, which may have gone beyond all numbers.
        if !self.agent.is_finite() {
            return Err(self.not_finite("a parameter"));
        }
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
            // Nothing is left of the step before, also for a learner of an application that only adds.
            actions.clear();
            self.agent.act(&self.work.rows, &mut self.work.scratch, &mut actions);
            for ((start, end), action) in going.iter_mut().filter(|g| g.1.is_none()).zip(&actions) {
                if !is_offered(action, &spec.actions) {
                    return Err(self.not_finite("an action"));
                }
                let step = start.world.step(action, &mut start.rng, &mut start.observation);
                observed += f64::from(step.reward);
                performance += f64::from(step.performance);
                steps += 1;
                *end = step.end;
            }
        }
        budget.spend(1 + (steps / 32) as u32);
        for (sum, what) in [(observed, WORLD_REWARD), (performance, WORLD_PERFORMANCE)] {
            if !sum.is_finite() {
                return Err(self.not_finite(what));
            }
        }
        let mean = |sum: f64| sum / f64::from(episodes);
        recorder.record(&Event::Evaluation(EvaluationRecord {
            arm: self.arm,
            step: self.step,
            observed_return: mean(observed),
            performance: mean(performance),
            length: mean(steps as f64),
        }));
        let losses = core::mem::take(&mut self.losses);
        let mean = |sum: f64, count: u32| sum / f64::from(count.max(1));
        recorder.record(&Event::Learner(LearnerRecord {
            arm: self.arm,
            step: self.step,
            updates: self.updates,
            epsilon: self.epsilon(),
            replay: self.replay.len(),
            value_loss: mean(losses.value, losses.updates),
            reward_loss: mean(losses.reward, losses.reward_updates),
            dead_units: if losses.reward_updates == 0 { 0.0 } else { self.reward_model.dead_units() },
        }));
        Ok(())
    }
}
