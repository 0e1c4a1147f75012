//! Typed events: everything a run says to the outside, and what every number in it means.
//!
//! A [`Recorder`] receives events and can influence nothing. Fields that hold the hidden truth
//! (`performance`, `hack`) exist only here: no agent, reward model, trigger or utility reads them.
//! Rewards are *raw* where the name says so (the environment's own unit) and otherwise *scaled*
//! (raw times the environment's factor), which is the unit in which the learner works.
//!
//! As JSON, fields are named as here, but for `observed_return`, which is `return`. Numbers are written so that they read
//! back exactly; serde_json reads them so with its feature `float_roundtrip`.

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

use crate::config::Learner;
use crate::env::{ActionValue, EpisodeEnd, Frame};

/// Receives the events of a run. `()` drops them.
pub trait Recorder {
    /// Called once per event, in order.
    fn record(&mut self, event: &Event);
}

impl Recorder for () {
    fn record(&mut self, _event: &Event) {}
}

impl<F: FnMut(&Event)> Recorder for F {
    fn record(&mut self, event: &Event) {
        self(event);
    }
}

/// A leg of the comparison: the Safe training that all share, then one learner in the Full world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Arm {
    /// Training in the Safe world, shared by the learners that continue from its snapshot.
    Safe,
    /// The plain learner in the Full world: no check.
    Baseline,
    /// The learner with the modification check in the Full world.
    Mc,
    /// The plain learner in the Full world that pays it the hidden performance: `reward_raw`, `reward` and the return
    /// of its training episodes are of what it is paid. Its evaluations are in the Full world
    /// as it is.
    Oracle,
    /// The learner of Safe training, acting and exploring in the Full world without any update.
    Frozen,
    /// The plain learner in the Full world with every new transition stored under the reward that the reward
    /// model of Safe training predicts; that model is not trained on.
    FrozenReward,
}

impl Arm {
    /// Every leg, in the order in which they are told.
    pub const ALL: [Arm; 6] = [Arm::Safe, Arm::Baseline, Arm::Mc, Arm::Oracle, Arm::Frozen, Arm::FrozenReward];

    /// The leg in which a learner trains.
    pub fn of(learner: Learner) -> Self {
        match learner {
            Learner::Mc => Arm::Mc,
            Learner::Baseline => Arm::Baseline,
            Learner::Oracle => Arm::Oracle,
            Learner::Frozen => Arm::Frozen,
            Learner::FrozenReward => Arm::FrozenReward,
        }
    }

    /// The name used in files, on the command line and in links.
    pub fn name(self) -> &'static str {
        match self {
            Arm::Safe => "safe",
            Arm::Baseline => "baseline",
            Arm::Mc => "mc",
            Arm::Oracle => "oracle",
            Arm::Frozen => "frozen",
            Arm::FrozenReward => "frozen-reward",
        }
    }
}

/// One event of a run. The `kind` tag names it in JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Event {
    /// A leg begins.
    Start(StartRecord),
    /// One environment step of the learner.
    Step(StepRecord),
    /// An episode of the learner ended (also where a refusal cut it off).
    Episode(EpisodeRecord),
    /// An evaluation point: greedy episodes in a clone of the leg's environment.
    Evaluation(EvaluationRecord),
    /// State of the learner at an evaluation point.
    Learner(LearnerRecord),
    /// A modification check was decided.
    Check(Box<CheckRecord>),
    /// A leg is finished.
    End(EndRecord),
}

/// A leg begins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StartRecord {
    /// Which leg.
    pub arm: Arm,
    /// Planned environment steps.
    pub steps: u32,
}

/// A leg is finished.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EndRecord {
    /// Which leg.
    pub arm: Arm,
    /// Environment steps made.
    pub steps: u32,
    /// Gradient updates of the live learner since the start of Safe training, without those taken back.
    pub updates: u64,
    /// Digest of the learner's parameters, hexadecimal (16 digits).
    pub digest: String,
}

/// One environment step of the learner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepRecord {
    /// Which leg.
    pub arm: Arm,
    /// Steps made in this leg, this one included (1-based).
    pub step: u32,
    /// The action.
    pub action: ActionValue,
    /// Observed reward, raw.
    pub reward_raw: f32,
    /// Hidden reward of the step, raw: what the designer wants. Never an input to the learner.
    pub performance: f32,
    /// Observed reward, scaled.
    pub reward: f32,
    /// Reward predicted for (state, action) by the current reward model, scaled.
    pub predicted: f32,
    /// Whether the scheme had something to decide: the transition, or with `each-step` the update after it.
    pub checked: bool,
    /// Whether the transition was stored, be it under another reward ([`CheckRecord::replaced`]).
    pub stored: bool,
    /// How the episode ended with this step, if it did.
    pub end: Option<EpisodeEnd>,
}

/// An episode of the learner ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRecord {
    /// Which leg.
    pub arm: Arm,
    /// Step of the leg with which it ended.
    pub step: u32,
    /// Sum of observed rewards, raw.
    #[serde(rename = "return")]
    pub observed_return: f64,
    /// Sum of hidden rewards, raw.
    pub performance: f64,
    /// Steps in the episode.
    pub length: u32,
    /// True where a refusal reset the environment before the episode's own end.
    pub cut: bool,
}

/// Greedy evaluation: means over the episodes, raw units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluationRecord {
    /// Which leg.
    pub arm: Arm,
    /// Steps made in this leg (0 = before the first).
    pub step: u32,
    /// Mean over episodes of the sum of observed rewards, raw.
    #[serde(rename = "return")]
    pub observed_return: f64,
    /// Mean over episodes of the sum of hidden rewards, raw.
    pub performance: f64,
    /// Mean episode length in steps.
    pub length: f64,
}

/// State of the learner at an evaluation point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearnerRecord {
    /// Which leg.
    pub arm: Arm,
    /// Steps made in this leg.
    pub step: u32,
    /// Gradient updates since the start of Safe training.
    pub updates: u64,
    /// Probability of a random action at the next step.
    pub epsilon: f32,
    /// Transitions in the replay buffer.
    pub replay: u32,
    /// Mean loss of the value function since the last point (0 without updates).
    pub value_loss: f64,
    /// Mean squared error of the reward model since the last point, scaled units (0 without its updates).
    pub reward_loss: f64,
    /// Share of first-layer units of the reward model that are inactive on every stored observation
    /// and action that was sampled since the last point: 1 means the model is dead. 0 without its updates.
    pub dead_units: f64,
}

/// What the check decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Learning from the transition does not make the future worse: learn from it.
    Accept,
    /// The future that learned from it is worse by today's utility: refuse.
    Refuse,
}

/// From where a rollout that rates a future started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartState {
    /// A reset of a copy of the environment.
    Reset,
    /// The state after the checked transition.
    Current,
}

/// One rollout of a forecast policy, as pictures and numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Film {
    /// From where it started.
    pub start: StartState,
    /// The start and the situation after every step: `actions.len() + 1` frames.
    pub frames: Vec<Frame>,
    /// Actions of the forecast policy.
    pub actions: Vec<ActionValue>,
    /// Reward that the *current* reward model predicts for each step, scaled.
    pub predicted: Vec<f32>,
    /// Hidden reward of each step, raw: the truth that the check does not see.
    pub performance: Vec<f32>,
    /// Discounted value that the *current* value function gives to the last state.
    pub bootstrap: f64,
    /// Utility of this rollout.
    pub utility: f64,
}

/// One of the two forecast futures of a check.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FutureRecord {
    /// Mean utility over the rollouts: F_m or F_u, in scaled reward units.
    pub utility: f64,
    /// Utility of every rollout: the resets in order, then the current state where it is rated.
    pub rollouts: Vec<f64>,
    /// Mean hidden performance per rollout over the rated horizon, raw: the truth, for people only.
    pub performance: f64,
    /// Digest of the forecast policy's parameters, hexadecimal.
    pub digest: String,
    /// The first reset rollout and, where rated, the one from the current state. Left out of the
    /// lines of a ledger; tapes hold them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub films: Vec<Film>,
}

/// What a check decided about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Subject {
    /// Learning from the transition of the step.
    #[default]
    Transition,
    /// The update that followed the step, whatever mini-batch it had (scheme `each-step`). The two futures
    /// are then the policies after it (modified) and before it (unmodified).
    Update,
}

impl Subject {
    fn is_transition(&self) -> bool {
        *self == Subject::Transition
    }
}

/// A modification check, whole: what was offered, both futures, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CheckRecord {
    /// Which leg.
    pub arm: Arm,
    /// Number of the check in this leg, 1-based: the 17 of `RUN#17`.
    pub number: u32,
    /// Step of the leg that offered the transition.
    pub step: u32,
    /// Gradient updates of the learner when it was offered (the learner's version).
    pub updates: u64,
    /// The situation before the step.
    pub before: Frame,
    /// The action.
    pub action: ActionValue,
    /// The situation after the step.
    pub after: Frame,
    /// How the episode ended with the step, if it did.
    pub end: Option<EpisodeEnd>,
    /// Observed reward, raw.
    pub reward_raw: f32,
    /// Observed reward, scaled.
    pub reward: f32,
    /// Reward predicted by the current reward model, scaled.
    pub predicted: f32,
    /// Least deviation |reward − predicted| that is checked, scaled.
    pub threshold: f32,
    /// What was decided about. Not written for transitions.
    #[serde(default, skip_serializing_if = "Subject::is_transition")]
    pub subject: Subject,
    /// Future that learned from the transition. There is none, neither here nor in the next two fields,
    /// where the scheme refuses without a forecast (`discard`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub modified: Option<FutureRecord>,
    /// Future that did not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unmodified: Option<FutureRecord>,
    /// F_m − F_u: negative means that learning makes things worse.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub margin: Option<f64>,
    /// The decision.
    pub verdict: Verdict,
    /// Scaled reward with which the refused transition was stored (schemes `punish`, `store-predicted`);
    /// none where it was not stored, or was accepted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub replaced: Option<f32>,
    /// True where the two futures are rated exactly equal.
    pub tie: bool,
    /// Gradient updates that the forecasts cost, those of copies of the reward model included.
    pub cost: u64,
    /// True where the unmodified future was reused from the check before (nothing had been learned).
    pub reused: bool,
    /// Hidden reward of the step, raw.
    pub performance: f32,
    /// The truth: observed and hidden reward differ.
    pub hack: bool,
}

impl CheckRecord {
    /// The future with the modification, the one without it, and the margin; none where the scheme
    /// refuses without a forecast.
    pub fn futures(&self) -> Option<(&FutureRecord, &FutureRecord, f64)> {
        Some((self.modified.as_ref()?, self.unmodified.as_ref()?, self.margin?))
    }

    /// The decision alone: what a ledger has in a line and a token promises.
    #[must_use]
    pub fn without_films(&self) -> Self {
        let bare = |future: &FutureRecord| FutureRecord {
            films: Vec::new(),
            rollouts: future.rollouts.clone(),
            digest: future.digest.clone(),
            ..*future
        };
        Self {
            modified: self.modified.as_ref().map(bare),
            unmodified: self.unmodified.as_ref().map(bare),
            before: self.before.clone(),
            after: self.after.clone(),
            action: self.action.clone(),
            ..*self
        }
    }

    /// Whether the decision was wrong in truth: a hack accepted or an honest transition refused. There is
    /// no such truth about an update, whose mini-batch holds many transitions.
    pub fn wrong(&self) -> bool {
        self.subject == Subject::Transition && self.hack == (self.verdict == Verdict::Accept)
    }

    /// The decision in one sentence, for terminals, live regions and tables; rewards in it are scaled.
    pub fn sentence(&self) -> String {
        let surprise = alloc::format!("step {}: expected {:+.2}, got {:+.2}", self.step, self.predicted, self.reward);
        let Some((modified, unmodified, margin)) = self.futures() else {
            return alloc::format!("{surprise}: DISCARDED without a forecast");
        };
        let (fm, fu) = (modified.utility, unmodified.utility);
        if self.subject == Subject::Update {
            let verdict = if self.verdict == Verdict::Refuse { "DROPPED" } else { "kept" };
            return alloc::format!(
                "step {}: after the update {fm:.3}, before it {fu:.3} (margin {margin:+.3}): {verdict}",
                self.step
            );
        }
        let verdict = match (self.verdict, self.replaced) {
            (Verdict::Accept, _) => "accepted".into(),
            (Verdict::Refuse, None) => String::from("REFUSED"),
            (Verdict::Refuse, Some(reward)) => alloc::format!("REFUSED, stored as {reward:+.2}"),
        };
        alloc::format!("{surprise}; with it {fm:.3}, without it {fu:.3} (margin {margin:+.3}): {verdict}")
    }
}
