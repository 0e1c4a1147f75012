//! The loop as a whole, on Box Moving with short legs.

mod chance;
mod continuous;
mod forced;
mod learners;
mod misfits;
mod practice;
mod schemes;
mod switches;

use super::*;
use crate::env::box_moving::{BoxMoving, Variant};
use crate::forecast::cpu::CpuForecaster;
use crate::forecast::{Carry, ForecastJob};
use crate::record::{CheckRecord, FutureRecord, StartState};
use crate::run::Run;
use alloc::string::{String, ToString};
use core::task::Poll;

/// A short run that meets hacks; with `scheme=all` every step is checked.
const SHORT: &str = "env=box-moving safe_steps=300 full_steps=80 exploration=60 epsilon_decay=200 forecast=20 rollouts=3 evaluations=10";

fn config(more: &str) -> Config {
    let mut config: Config = SHORT.parse().unwrap();
    for (key, value) in more.split_whitespace().filter_map(|pair| pair.split_once('=')) {
        config.set(key, value).unwrap();
    }
    config
}

fn trainer(config: &Config) -> Trainer<BoxMoving, Ddqn> {
    let flag = config.flag;
    Trainer::gridworld(config.clone(), BoxMoving::new(Variant::Safe, flag), BoxMoving::new(Variant::Full, flag))
}

/// Every event of a run polled with this budget; `between` is called after every poll.
fn events<E: Environment<Action = A::Action>, A: Agent>(
    mut trainer: Trainer<E, A>,
    budget: u32,
    mut between: impl FnMut(&mut Trainer<E, A>),
) -> Vec<Event> {
    let mut events = Vec::new();
    let mut forecaster = CpuForecaster::default();
    loop {
        let status = trainer.poll(&mut forecaster, Budget(budget), &mut |event: &Event| events.push(event.clone()));
        between(&mut trainer);
        if status.unwrap() == Status::Done {
            return events;
        }
    }
}

fn checks(events: &[Event]) -> Vec<CheckRecord> {
    let check = |event: &Event| if let Event::Check(check) = event { Some((**check).clone()) } else { None };
    events.iter().filter_map(check).collect()
}

/// Modified and unmodified future of a check that has them.
fn futures(check: &CheckRecord) -> (&FutureRecord, &FutureRecord) {
    let (modified, unmodified, margin) = check.futures().expect("a check with forecasts");
    assert_eq!(margin, modified.utility - unmodified.utility);
    (modified, unmodified)
}

/// Without what the way of computing may change: the cost.
fn decisions(events: &[Event]) -> Vec<Event> {
    let mut events = events.to_vec();
    for event in &mut events {
        if let Event::Check(check) = event {
            (check.cost, check.reused) = (0, false);
        }
    }
    events
}

#[test]
fn polls_of_any_size_give_the_same_events() {
    let whole = events(trainer(&config("")), u32::MAX, |_| {});
    assert!(!checks(&whole).is_empty());
    for budget in [1, 7, 1000] {
        assert_eq!(events(trainer(&config("")), budget, |_| {}), whole, "budget {budget}");
    }
}

#[test]
fn the_reused_future_changes_no_bit() {
    let reused = events(trainer(&config("scheme=all")), 1, |_| {});
    let fresh = events(trainer(&config("scheme=all")), 1, Trainer::forget_forecast);
    let count = checks(&reused).iter().filter(|check| check.reused).count();
    assert!(count >= 3, "the run meets reuse: {count}");
    assert!(checks(&fresh).iter().all(|check| !check.reused && check.cost == 40));
    assert!(checks(&reused).iter().all(|check| check.cost == if check.reused { 20 } else { 40 }));
    assert_eq!(decisions(&reused), decisions(&fresh));
}

/// Box Moving that does not say that it is deterministic.
#[derive(Clone)]
struct Modest {
    inner: BoxMoving,
    spec: EnvSpec,
}

impl Modest {
    fn new(variant: Variant) -> Self {
        let inner = BoxMoving::new(variant, true);
        Self { spec: EnvSpec { deterministic: false, ..inner.spec().clone() }, inner }
    }
}

impl Environment for Modest {
    type Action = Discrete;
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }
    fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
        self.inner.reset(rng, observation);
    }
    fn step(&mut self, action: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
        self.inner.step(action, rng, observation)
    }
    fn frame(&self) -> Frame {
        self.inner.frame()
    }
}

#[test]
fn equal_rollouts_made_once_change_no_bit() {
    let config = config("evaluation_episodes=4");
    let once = events(trainer(&config), u32::MAX, |_| {});
    let modest = Trainer::gridworld(config, Modest::new(Variant::Safe), Modest::new(Variant::Full));
    let all = events(modest, u32::MAX, |_| {});
    assert!(checks(&once).iter().all(|check| futures(check).0.rollouts.len() >= 3));
    assert_eq!(once, all);
}

/// Box Moving whose model of itself has no fake reward.
#[derive(Clone)]
struct Disillusioned {
    inner: BoxMoving,
    model: Variant,
}

impl Environment for Disillusioned {
    type Action = Discrete;
    fn spec(&self) -> &EnvSpec {
        self.inner.spec()
    }
    fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
        self.inner.reset(rng, observation);
    }
    fn step(&mut self, action: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
        self.inner.step(action, rng, observation)
    }
    fn model(&self) -> Self {
        let (box_cell, agent) = (self.inner.box_cell(), self.inner.agent_cell());
        let inner = BoxMoving::at(self.model, true, box_cell, agent).unwrap();
        Self { inner, model: self.model }
    }
    fn frame(&self) -> Frame {
        self.inner.frame()
    }
}

#[test]
fn futures_are_rated_in_the_model_of_the_world() {
    let world = |variant, model| Disillusioned { inner: BoxMoving::new(variant, true), model };
    let full = world(Variant::Full, Variant::NoHack);
    let trainer = Trainer::gridworld(config("scheme=all"), world(Variant::Safe, Variant::Safe), full);
    let checks = checks(&events(trainer, u32::MAX, |_| {}));
    assert_eq!(checks.len(), 80);
    // `$` marks the fake reward, unless the agent stands in front of it.
    let fake = |frame: &Frame| frame.seen.contains('$');
    assert!(checks.iter().any(|check| fake(&check.before)), "the real world has it");
    let films: Vec<_> = checks.iter().map(futures).flat_map(|(m, u)| m.films.iter().chain(&u.films)).collect();
    for start in [StartState::Reset, StartState::Current] {
        assert!(films.iter().any(|film| film.start == start));
    }
    // A film of the current state begins with what the learner saw.
    let seen = |start| usize::from(start == StartState::Current);
    assert!(films.iter().all(|film| !film.frames[seen(film.start)..].iter().any(fake)), "the model has not");
}

#[test]
fn the_two_futures_differ_only_in_the_forced_transition() {
    // Without forecast updates both futures are the live learner: equal in every respect, a tie, accepted.
    let none = checks(&events(trainer(&config("forecast=0 scheme=all")), u32::MAX, |_| {}));
    assert_eq!(none.len(), 80);
    for check in &none {
        assert_eq!(check.modified, check.unmodified);
        assert!(check.tie && check.verdict == Verdict::Accept && check.cost == 0);
    }
    // With them, the forced transition is what makes them differ.
    let some = checks(&events(trainer(&config("")), u32::MAX, |_| {}));
    assert!(some.iter().map(futures).all(|(modified, unmodified)| modified.digest != unmodified.digest));
    // Forcing a transition through an empty difference: a job without it twice gives one future twice.
    let t = trained();
    let job = |forced| ForecastJob::<BoxMoving, _> {
        agent: &t.agent,
        replay: &t.replay,
        forced,
        updates: 30,
        batch: 32,
        seed: 1,
        carry: Carry::ALL,
        version: 5,
        practice: None,
    };
    let extra = [t.replay.get(0)];
    let jobs = [job(&[]), job(&extra), job(&[])];
    let mut forecaster = CpuForecaster::default();
    let Poll::Ready(Ok(futures)) = forecaster.poll(&jobs, &mut Budget(u32::MAX)) else { panic!("90 updates") };
    assert_eq!(futures[0].digest(), futures[2].digest());
    assert_ne!(futures[0].digest(), futures[1].digest());
}

/// A trainer at the switch.
fn trained() -> Trainer<BoxMoving, Ddqn> {
    let mut t = trainer(&config(""));
    while t.poll(&mut CpuForecaster::default(), Budget(u32::MAX), &mut ()).unwrap() != Status::Switch {}
    t
}

#[test]
fn a_check_leaves_the_learner_as_it_is() {
    for more in ["", "practice=true practice_reward_updates=20"] {
        check_leaves_the_learner(more);
    }
}

fn check_leaves_the_learner(more: &str) {
    let mut t = trainer(&config(more));
    while t.poll(&mut CpuForecaster::default(), Budget(u32::MAX), &mut ()).unwrap() != Status::Switch {}
    let mut forecaster = CpuForecaster::default();
    while !matches!(t.activity, Activity::Check(_)) {
        t.poll(&mut forecaster, Budget(1), &mut ()).unwrap();
    }
    let before = (t.agent.digest(), t.reward_model.digest(), t.replay.clone(), t.explore_rng.clone(), t.updates);
    let world = (t.world.clone(), t.world_rng.clone(), t.observation.clone());
    let mut polls = 0;
    while matches!(t.activity, Activity::Check(_)) && t.check_progress.is_none_or(|p| p < 0.9) {
        t.poll(&mut forecaster, Budget(1), &mut ()).unwrap();
        if matches!(t.activity, Activity::Check(_)) {
            let now = (t.agent.digest(), t.reward_model.digest(), t.replay.clone(), t.explore_rng.clone(), t.updates);
            assert_eq!(now, before);
            assert_eq!((t.world.clone(), t.world_rng.clone(), t.observation.clone()), world);
            polls += 1;
        }
    }
    assert!(polls >= 30, "the forecasts take many polls: {polls}");
}

#[test]
fn refused_transitions_are_not_stored_and_reset_the_world() {
    let mut seen = 0;
    let mut last = (0, 0);
    let mut t = trained();
    let mut forecaster = CpuForecaster::default();
    while t.status() != Status::Done {
        let mut refused = None;
        let mut note = |event: &Event| {
            if let Event::Step(step) = event {
                refused = Some(!step.stored);
            }
        };
        t.poll(&mut forecaster, Budget(1), &mut note).unwrap();
        let now = (t.replay.pushed(), t.updates);
        match refused {
            Some(true) => {
                seen += 1;
                assert_eq!(now, last, "neither stored nor learned");
                assert_eq!((t.world().box_cell(), t.world().agent_cell(), t.episode.length), (2, 2, 0));
            }
            Some(false) => assert_eq!(now, (last.0 + 1, last.1 + 1)),
            None => {}
        }
        last = now;
    }
    assert!(seen > 0, "the run refuses something");
}

#[test]
fn baseline_and_checking_learner_share_everything_up_to_the_first_refusal() {
    let run = |agent| {
        let mut t = trained();
        t.choose(agent).unwrap();
        events(t, u32::MAX, |_| {})
    };
    let steps = |events: Vec<Event>| -> Vec<StepRecord> {
        events.into_iter().filter_map(|event| if let Event::Step(step) = event { Some(step) } else { None }).collect()
    };
    let (baseline, mc) = (steps(run(Learner::Baseline)), steps(run(Learner::Mc)));
    let first = mc.iter().position(|step| !step.stored).expect("a refusal");
    let shared = |steps: &[StepRecord]| -> Vec<(u32, f32, f32)> {
        steps[..first].iter().map(|s| (s.step, s.reward, s.predicted)).collect()
    };
    assert!(first > 0);
    assert_eq!(shared(&baseline), shared(&mc));
}

#[test]
fn performance_is_never_an_input() {
    /// Box Moving that lies about performance.
    #[derive(Clone)]
    struct Liar(BoxMoving);
    impl Environment for Liar {
        type Action = Discrete;
        fn spec(&self) -> &EnvSpec {
            self.0.spec()
        }
        fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
            self.0.reset(rng, observation);
        }
        fn step(&mut self, action: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
            Step { performance: 1e6, ..self.0.step(action, rng, observation) }
        }
    }
    let ends = |events: &[Event]| -> Vec<Event> {
        events.iter().filter(|event| matches!(event, Event::End(_))).cloned().collect()
    };
    let honest = events(trainer(&config("")), u32::MAX, |_| {});
    let world = |variant| Liar(BoxMoving::new(variant, true));
    let lied = events(Trainer::gridworld(config(""), world(Variant::Safe), world(Variant::Full)), u32::MAX, |_| {});
    assert_eq!(ends(&honest), ends(&lied));
    let margins = |events: &[Event]| -> Vec<f64> { checks(events).iter().map(|check| check.margin.unwrap()).collect() };
    assert_eq!(margins(&honest), margins(&lied));
}

#[test]
fn the_exploration_schedule_is_that_of_the_settings() {
    let mut t = trainer(&config(""));
    let mut epsilon = |arm, step| {
        (t.arm, t.step) = (arm, step);
        t.epsilon()
    };
    assert_eq!(epsilon(Arm::Safe, 0), 1.0);
    assert_eq!(epsilon(Arm::Safe, 60), 1.0);
    assert!((epsilon(Arm::Safe, 160) - 0.525).abs() < 1e-6);
    assert_eq!(epsilon(Arm::Safe, 260), 0.05);
    assert_eq!(epsilon(Arm::Safe, 299), 0.05);
    assert_eq!(epsilon(Arm::Mc, 0), 1.0);
    t.config.epsilon_restart = false;
    (t.arm, t.step) = (Arm::Mc, 0);
    assert_eq!(t.epsilon(), 0.05);
}

#[test]
fn evaluations_are_evenly_spread_and_touch_nothing_live() {
    let all = events(trainer(&config("")), u32::MAX, |_| {});
    let points = |arm| -> Vec<u32> {
        let of = |event: &Event| if let Event::Evaluation(e) = event { (e.arm == arm).then_some(e.step) } else { None };
        all.iter().filter_map(of).collect()
    };
    assert_eq!(points(Arm::Safe), [0, 30, 60, 90, 120, 150, 180, 210, 240, 270, 300]);
    assert_eq!(points(Arm::Mc), [0, 8, 16, 24, 32, 40, 48, 56, 64, 72, 80]);
    let steps = |events: &[Event]| -> Vec<Event> {
        events.iter().filter(|event| matches!(event, Event::Step(_))).cloned().collect()
    };
    let fewer = events(trainer(&config("evaluations=2")), u32::MAX, |_| {});
    assert_eq!(steps(&all), steps(&fewer));
}

#[test]
fn evaluations_that_do_not_divide_a_leg_come_no_earlier_than_their_share_of_it() {
    let due = |more: &str| -> Vec<u32> {
        let mut t = trainer(&config(more));
        t.arm = Arm::Mc;
        (0..=t.steps()).filter(|step| t.evaluation_due(*step)).collect()
    };
    // Every 2.5 steps.
    assert_eq!(due("full_steps=25 evaluations=10"), [0, 3, 5, 8, 10, 13, 15, 18, 20, 23, 25]);
    // More points than steps: after each one.
    assert_eq!(due("full_steps=3 evaluations=10"), [0, 1, 2, 3]);
}

/// Losses of the update that led from `before` to the replay buffer of `after`, made once more.
fn losses(before: &Trainer<BoxMoving, Ddqn>, after: &Trainer<BoxMoving, Ddqn>) -> (f64, f64) {
    let (replay, seed, draw) = (&after.replay, before.config.seed, before.updates);
    let (mut slots, mut batch) = (Vec::new(), Minibatch::default());
    draw_slots(replay.len(), before.config.batch, &mut Rng::stream(seed, Purpose::Batch, draw), &mut slots);
    batch.gather(replay, &slots, &Forced::new(&[], replay));
    let value = before.agent.clone().update(&batch, &mut Rng::stream(seed, Purpose::Update, draw));
    (f64::from(value), f64::from(before.reward_model.clone().update(&batch)))
}

#[test]
fn the_losses_of_an_evaluation_are_the_means_of_the_updates_since_the_last() {
    for agent in ["baseline", "frozen-reward"] {
        let mut t = trainer(&config(&alloc::format!("agent={agent}")));
        let (mut value, mut reward) = (Vec::new(), Vec::new());
        let mut seen = 0;
        while t.status() != Status::Done {
            let before = t.clone();
            let mut told = None;
            let mut note = |event: &Event| {
                if let Event::Learner(learner) = event {
                    told = Some(learner.clone());
                }
            };
            t.poll(&mut CpuForecaster::default(), Budget(1), &mut note).unwrap();
            if t.updates > before.updates {
                let (of_value, of_reward) = losses(&before, &t);
                value.push(of_value);
                if t.arm != Arm::FrozenReward {
                    reward.push(of_reward);
                }
            }
            let mean = |losses: &mut Vec<f64>| {
                let count = losses.len().max(1) as f64;
                losses.drain(..).sum::<f64>() / count
            };
            if let Some(told) = told {
                assert_eq!((told.arm, told.step, told.updates), (t.arm, t.step, t.updates));
                seen += u32::from(value.len() > 1);
                let means = (mean(&mut value), mean(&mut reward));
                assert_eq!((told.value_loss, told.reward_loss), means, "{agent}, {:?} step {}", t.arm, t.step);
            }
        }
        // 8 of the 10 points of Safe training come after updates, and all 10 of the Full leg.
        assert_eq!(seen, 18, "{agent}");
    }
}

#[test]
fn safe_training_updates_after_exploration_and_full_from_its_first_step() {
    let all = events(trainer(&config("agent=baseline")), u32::MAX, |_| {});
    let updates: Vec<u64> =
        all.iter().filter_map(|event| if let Event::End(end) = event { Some(end.updates) } else { None }).collect();
    assert_eq!(updates, [300 - 60, 300 - 60 + 80]);
}

#[test]
fn the_release_preset_runs() {
    let mut release: Config = "env=box-moving preset=release".parse().unwrap();
    for (key, value) in [("safe_steps", "300"), ("full_steps", "80"), ("forecast", "20"), ("exploration", "60")] {
        release.set(key, value).unwrap();
    }
    let all = events(trainer(&release), u32::MAX, |_| {});
    let checks = checks(&all);
    assert!(!checks.is_empty());
    // Refusals still update: one update per step that finds a full mini-batch.
    let Some(Event::End(end)) = all.last() else { panic!("a finished run") };
    assert_eq!(end.updates, 300 - 60 + 80);
}

#[test]
fn a_last_update_that_diverges_is_an_error_too() {
    // One update: its loss is finite, what it makes of the parameters is not.
    let mut t = trainer(&config("lr=1e38 lr_reward=1e38 exploration=100 safe_steps=101 full_steps=0"));
    t.agent.online_mut().params_mut()[0] = f32::MAX;
    let error = loop {
        match t.poll(&mut CpuForecaster::default(), Budget(100), &mut ()) {
            Ok(status) => assert_ne!(status, Status::Done, "the parameters are not finite"),
            Err(error) => break error,
        }
    };
    assert!(error.to_string().contains("is not a finite number"), "{error}");
}

#[test]
fn a_checked_transition_that_truncates_is_rated_by_its_value() {
    // A hundred steps without a refusal: the check of the last one finds an ended episode.
    let all = events(trainer(&config("scheme=all full_steps=100 forecast=0 agent=mc")), u32::MAX, |_| {});
    let last = checks(&all).pop().expect("every step is checked");
    assert_eq!((last.step, last.end), (100, Some(EpisodeEnd::Truncated)));
    let film = futures(&last).0.films.last().unwrap();
    assert_eq!((film.start, film.actions.len(), film.frames.len()), (StartState::Current, 0, 1));
    assert_eq!(film.bootstrap, film.utility);
}

#[test]
fn divergence_is_an_error_and_not_a_result() {
    let config = config("lr=1e30 agent=baseline");
    let mut t = trainer(&config);
    let error = loop {
        match t.poll(&mut CpuForecaster::default(), Budget(100), &mut ()) {
            Ok(status) => assert_ne!(status, Status::Done, "a learning rate of 1e30 diverges"),
            Err(error) => break error,
        }
    };
    assert!(error.to_string().contains("lower the learning rates"), "{error}");
    assert_eq!(t.poll(&mut CpuForecaster::default(), Budget(100), &mut ()), Err(error.clone()), "it stays an error");
    let bytes = postcard::to_allocvec(&t).unwrap();
    let mut back: Trainer<BoxMoving, Ddqn> = postcard::from_bytes(&bytes).unwrap();
    assert_eq!(back.poll(&mut CpuForecaster::default(), Budget(100), &mut ()), Err(error));
}

#[test]
fn a_run_resumes_to_the_last_bit_wherever_it_stood() {
    let config = config("scheme=all full_steps=20");
    let mut straight = Vec::new();
    let mut run = Run::new(&config);
    while run.poll(Budget(1000), &mut |event: &Event| straight.push(event.clone())).unwrap() != Status::Done {}
    let mut rng = Rng::new(1);
    for _ in 0..20 {
        let mut resumed = Vec::new();
        let mut run = Run::new(&config);
        loop {
            // Twenty interruptions, at polls of random length.
            let budget = Budget(1 + rng.below(400));
            let status = run.poll(budget, &mut |event: &Event| resumed.push(event.clone())).unwrap();
            run = Run::resume(&run.snapshot()).unwrap();
            if status == Status::Done {
                break;
            }
        }
        assert_eq!(resumed, straight);
    }
}

#[test]
fn bytes_that_are_no_snapshot_are_answered() {
    let mut run = Run::new(&config(""));
    run.poll(Budget(500), &mut ()).unwrap();
    let good = run.snapshot();
    let answer = |bytes: &[u8]| -> String { Run::resume(bytes).err().map_or_else(String::new, |e| e.to_string()) };
    assert_eq!(answer(&good), "");
    assert_eq!(answer(b""), "not a snapshot of a run");
    assert_eq!(answer(b"{\"json\": true}"), "not a snapshot of a run");
    assert!(answer(&good[..20]).contains("cut off"));
    assert!(answer(&good[..good.len() - 1]).contains("cut off"));
    assert!(answer(&[&good[..], b"x"].concat()).contains("1 bytes too many"));
    for at in [30, 100, good.len() / 2, good.len() - 1] {
        let mut altered = good.clone();
        altered[at] ^= 1;
        assert!(answer(&altered).contains("altered"), "byte {at}");
    }
    let mut newer = good.clone();
    newer[8] = 9;
    let versions = alloc::format!("format version 9, this program reads version {}", crate::run::SNAPSHOT_VERSION);
    assert!(answer(&newer).contains(&versions));
}

#[test]
fn the_reward_model_and_value_that_rate_are_the_current_ones() {
    // Also where the forecasts changed a reward model of their own.
    for more in ["", "practice=true practice_reward_updates=15"] {
        let mut t = trainer(&config(more));
        let mut forecaster = CpuForecaster::default();
        let mut check = None;
        let (value, reward) = loop {
            let current = (t.agent.clone(), t.reward_model.clone());
            let mut note = |event: &Event| {
                if let Event::Check(record) = event {
                    check = Some(record.clone());
                }
            };
            t.poll(&mut forecaster, Budget(1), &mut note).unwrap();
            if check.is_some() {
                break current;
            }
        };
        let check = check.unwrap();
        let (modified, unmodified) = futures(&check);
        assert_ne!(modified.digest, unmodified.digest, "futures that differ would rate differently");
        for film in [&modified.films[0], &unmodified.films[0]] {
            let mut world = BoxMoving::new(Variant::Full, true);
            let mut observation = alloc::vec![0.0; 11];
            world.reset(&mut Rng::new(0), &mut observation);
            let (mut scratch, mut numbers) = (Scratch::default(), Vec::new());
            let seen = |observation: &[f32]| {
                let mut rows = Rows::new(t.world.spec().observation);
                rows.push_observation(observation);
                rows
            };
            for (action, predicted) in film.actions.iter().zip(&film.predicted) {
                let ActionValue::Discrete(index) = *action else { panic!("{action:?}") };
                reward.predict(&seen(&observation), &[Discrete(index)], &mut scratch, &mut numbers);
                assert_eq!(numbers[0], *predicted);
                world.step(&Discrete(index), &mut Rng::new(0), &mut observation);
            }
            // The value of what the future would do there, discounted by 30 steps.
            let discount = (0..30).fold(1.0, |product, _| product * f64::from(0.95f32));
            let last = [0, 1].map(|action| {
                value.values(&seen(&observation), &[Discrete(action)], &mut scratch, &mut numbers);
                discount * f64::from(numbers[0])
            });
            assert!(last.contains(&film.bootstrap), "{} is none of {last:?}", film.bootstrap);
        }
    }
}

/// Box Moving whose observations hold no number in one place after so many steps of it.
#[derive(Clone)]
struct Blind {
    inner: BoxMoving,
    from: u32,
    made: u32,
}

impl Environment for Blind {
    type Action = Discrete;
    fn spec(&self) -> &EnvSpec {
        self.inner.spec()
    }
    fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
        self.inner.reset(rng, observation);
        if self.from == 0 {
            observation[3] = f32::NAN;
        }
    }
    fn step(&mut self, action: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
        let step = self.inner.step(action, rng, observation);
        self.made += 1;
        if self.made >= self.from {
            observation[3] = f32::NAN;
        }
        step
    }
}

#[test]
fn an_observation_that_is_no_number_is_an_error_and_no_endless_check() {
    // A transition with it equals no other, itself included: a forecaster would take each poll's for a new one.
    for (safe, full) in [(0, 0), (5, 0), (u32::MAX, 0), (u32::MAX, 20)] {
        let world = |variant, from| Blind { inner: BoxMoving::new(variant, true), from, made: 0 };
        let (safe, full) = (world(Variant::Safe, safe), world(Variant::Full, full));
        let mut t = Trainer::gridworld(config("scheme=all"), safe, full);
        let mut forecaster = CpuForecaster::default();
        let error = (0..20_000).find_map(|_| t.poll(&mut forecaster, Budget(10), &mut ()).err());
        let error = error.expect("it ends").to_string();
        assert!(error.contains("the world's observation is not a finite number"), "{error}");
    }
}
