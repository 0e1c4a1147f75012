//! How fast this machine is: every part that a run spends its time in, in every built-in world, on one core
//! and on all.
//!
//! A figure is the median over the calls made in a given time; on several cores, the sum of the medians of
//! threads that start together. What each thread works on is its own.

mod gpu;

use std::hint::black_box;
use std::sync::{Barrier, Mutex};
use std::task::Poll;
use std::thread;
use std::time::{Duration, Instant};

use mcvl_core::agent::Agent;
use mcvl_core::agent::ddqn::Ddqn;
use mcvl_core::agent::reward_model::RewardModel;
use mcvl_core::agent::td3::Td3;
use mcvl_core::check::utility::{Judge, Start, rate};
use mcvl_core::config::{Config, ConfigError, Learner, Preset};
use mcvl_core::env::reacher::{self, ClosedForm, Reacher};
use mcvl_core::env::trap::Trapped;
use mcvl_core::env::{Action, BuiltIn as _, Environment, EpisodeEnd, Step};
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::forecast::{Carry, ForecastJob, Forecaster as _};
use mcvl_core::nn::gemm::PROBE_LANES;
use mcvl_core::nn::isa::{Isa, probe};
use mcvl_core::record::Event;
use mcvl_core::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use mcvl_core::rng::Rng;
use mcvl_core::run::{Budget, Run, Status};
use serde::Serialize;

pub use gpu::{JOBS, Throughput};

use crate::mujoco;

/// Updates of the measured forecasts in gridworlds: those of a check in Box Moving, and the paper's for others.
const FORECASTS: [u32; 2] = [500, 5000];
/// The same in Reacher, where an update takes milliseconds: the 10,000 of a check would take a minute.
const FORECASTS_REACHER: [u32; 1] = [50];
/// Experience behind the measured updates: what a run has after its random steps.
const TRANSITIONS: u32 = 1000;
/// Rounds of the probe per call.
const PROBE_ROUNDS: usize = 20_000;

/// Something that is done again and again.
pub struct Case<'a> {
    /// What is done, as one thing.
    pub name: String,
    /// Multiply-adds of one, by the dense definition, where its time goes into them.
    pub work: Option<u64>,
    worker: Worker<'a>,
}

/// Makes what one thread calls.
type Worker<'a> = Box<dyn Fn() -> Call<'a> + Sync + 'a>;
/// Does some of it and says how much it did in which time.
type Call<'a> = Box<dyn FnMut() -> Sample + 'a>;

/// Things done, and the time that it took.
struct Sample {
    count: f64,
    time: Duration,
}

/// The sample of `count` calls of `once`.
fn timed(count: u32, mut once: impl FnMut()) -> Sample {
    let start = Instant::now();
    (0..count).for_each(|_| once());
    Sample { count: f64::from(count), time: start.elapsed() }
}

/// Figures of one core and of all.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rates {
    /// Per second on one core.
    pub one: f64,
    /// Per second on all cores together.
    pub all: f64,
}

impl Case<'_> {
    /// Measures for about `time` on one core and as long on `threads` threads.
    pub fn rates(&self, threads: usize, time: Duration) -> Rates {
        let one = self.rate(1, time, median);
        Rates { one, all: if threads == 1 { one } else { self.rate(threads, time, median) } }
    }

    /// Rate of all threads together; `of` makes one figure of the rates of a thread's calls.
    fn rate(&self, threads: usize, time: Duration, of: fn(&mut [f64]) -> f64) -> f64 {
        let barrier = Barrier::new(threads);
        let thread = || {
            let mut call = (self.worker)();
            // The first call fills caches and allocates.
            call();
            barrier.wait();
            let start = Instant::now();
            let mut rates = Vec::new();
            while rates.is_empty() || start.elapsed() < time {
                let Sample { count, time } = call();
                rates.push(count / time.as_secs_f64().max(f64::MIN_POSITIVE));
            }
            of(&mut rates)
        };
        thread::scope(|scope| {
            let threads: Vec<_> = (0..threads).map(|_| scope.spawn(thread)).collect();
            threads.into_iter().map(|thread| thread.join().expect("a measurement does not panic")).sum()
        })
    }
}

fn median(rates: &mut [f64]) -> f64 {
    rates.sort_by(f64::total_cmp);
    rates[rates.len() / 2]
}

fn best(rates: &mut [f64]) -> f64 {
    rates.iter().copied().fold(0.0, f64::max)
}

/// The most multiply-adds per second that can be had without fusing: what the shares refer to.
pub fn peak(threads: usize, time: Duration) -> Rates {
    let worker = || -> Call<'static> {
        let mut lanes = [0.5f32; PROBE_LANES];
        Box::new(move || {
            let sample = timed(1, || probe(Isa::active(), PROBE_ROUNDS, black_box(&mut lanes)));
            Sample { count: (PROBE_ROUNDS * PROBE_LANES) as f64, ..sample }
        })
    };
    let case = Case { name: "multiply-add".to_owned(), work: None, worker: Box::new(worker) };
    Rates { one: case.rate(1, time, best), all: case.rate(threads, time, best) }
}

/// A built-in world with what is measured in it.
pub enum World {
    /// A gridworld, and a run with its first check under way, of which each thread takes a copy.
    Gridworld(Box<Bench<Trapped, Ddqn>>, Mutex<Run>),
    /// Reacher in closed form.
    Reacher(Box<Bench<Reacher, Td3<2>>>),
}

impl World {
    /// Prepares the world of this name.
    ///
    /// # Errors
    /// If there is none.
    ///
    /// # Panics
    /// If a few steps of training diverge with the paper's settings.
    pub fn new(env: &str) -> Result<Self, ConfigError> {
        let config = Config::new(env, Preset::Paper)?;
        Ok(match Trapped::worlds(&config) {
            Some((_, world)) => {
                let agent = Ddqn::configured(&config, world.spec());
                let checking = Mutex::new(checking(&config)?);
                Self::Gridworld(Box::new(Bench::new(config, world, agent)), checking)
            }
            None => {
                let (_, world) = Reacher::worlds(&config);
                let agent = Td3::configured(&config, world.spec());
                Self::Reacher(Box::new(Bench::new(config, world, agent)))
            }
        })
    }

    /// Everything that is measured here.
    pub fn cases(&self) -> Vec<Case<'_>> {
        match self {
            Self::Gridworld(bench, checking) => {
                let mut cases = bench.cases(&FORECASTS, |batch| bench.agent.update_work(batch));
                let practice = if bench.config.practice { " + practice" } else { "" };
                let name = format!("check of 2 x {}{practice}", bench.config.forecast);
                cases.push(Case { name, work: None, worker: Box::new(|| check(checking)) });
                let worker = Box::new(|| steps(bench.world.clone()));
                cases.push(Case { name: "environment step".into(), work: None, worker });
                cases
            }
            Self::Reacher(bench) => {
                let mut cases = bench.cases(&FORECASTS_REACHER, |batch| bench.agent.update_work(batch));
                cases.extend(simulators(&bench.config));
                cases
            }
        }
    }
}

/// A world with learners of the paper's sizes and some experience.
pub struct Bench<E, A: Agent> {
    config: Config,
    world: E,
    agent: A,
    model: RewardModel,
    replay: ReplayBuffer<A::Action>,
    /// One surprise, as a check forces it into the mini-batches of a forecast.
    surprise: Transition<A::Action>,
}

impl<E, A> Bench<E, A>
where
    E: Environment<Action = A::Action> + Sync,
    A: Agent<Action: Sync> + Sync,
{
    fn new(config: Config, world: E, agent: A) -> Self {
        let model = RewardModel::configured(&config, world.spec());
        let mut replay = ReplayBuffer::new(world.spec().observation, TRANSITIONS);
        let mut walk = Walk::new(world.clone());
        for _ in 0..TRANSITIONS {
            replay.push(&walk.transition());
        }
        let surprise = walk.transition();
        Self { config, world, agent, model, replay, surprise }
    }

    /// What every world has; `work` gives the multiply-adds of an update on so many transitions.
    fn cases(&self, forecasts: &[u32], work: impl Fn(u32) -> u64) -> Vec<Case<'_>> {
        let batch = self.config.batch;
        let case = |name: String, work, worker| Case { name, work, worker };
        let mut cases = vec![
            case("value update".into(), Some(work(batch)), Box::new(|| self.value_update()) as Worker<'_>),
            case("reward update".into(), Some(self.model.update_work(batch)), Box::new(|| self.reward_update())),
        ];
        for &updates in forecasts {
            let worker = Box::new(move || self.forecast(updates));
            cases.push(case(
                format!("forecast of {updates} updates"),
                Some(u64::from(updates) * work(batch + 1)),
                worker,
            ));
        }
        let (rollouts, steps) = (self.starts().len(), self.config.rollout_steps);
        cases.push(case(format!("rating by {rollouts} x {steps} steps"), None, Box::new(|| self.rating())));
        cases
    }

    /// A function that draws the next mini-batch.
    fn batches(&self) -> impl FnMut(&mut Minibatch<A::Action>) + '_ {
        let (mut slots, mut rng) = (Vec::new(), Rng::new(2));
        let none = Forced::new(&[], &self.replay);
        move |batch| {
            draw_slots(self.replay.len(), self.config.batch, &mut rng, &mut slots);
            batch.gather(&self.replay, &slots, &none);
        }
    }

    fn value_update(&self) -> Call<'_> {
        let (mut agent, mut batch, mut draw) = (self.agent.clone(), Minibatch::default(), self.batches());
        let mut rng = Rng::new(3);
        Box::new(move || {
            timed(20, || {
                draw(&mut batch);
                black_box(agent.update(&batch, &mut rng));
            })
        })
    }

    fn reward_update(&self) -> Call<'_> {
        let (mut model, mut batch, mut draw) = (self.model.clone(), Minibatch::default(), self.batches());
        Box::new(move || {
            timed(20, || {
                draw(&mut batch);
                black_box(model.update(&batch));
            })
        })
    }

    fn forecast(&self, updates: u32) -> Call<'_> {
        let mut forecaster = CpuForecaster::default();
        Box::new(move || {
            let jobs = [ForecastJob::<E, _> {
                agent: &self.agent,
                replay: &self.replay,
                forced: std::slice::from_ref(&self.surprise),
                updates,
                batch: self.config.batch,
                seed: 0,
                carry: Carry::ALL,
                version: 0,
                practice: None,
            }];
            timed(1, || {
                let done = forecaster.poll(&jobs, &mut Budget(u32::MAX));
                assert!(matches!(black_box(done), Poll::Ready(Ok(_))), "a forecast of finite numbers is finite");
            })
        })
    }

    /// Where the rollouts of a check begin: fresh resets, equal ones once, and the state after the step, for
    /// which another reset stands in.
    fn starts(&self) -> Vec<Start<E>> {
        let resets = if self.world.spec().deterministic { self.config.rollouts.min(1) } else { self.config.rollouts };
        let model = self.world.model();
        let count = u64::from(resets) + u64::from(self.config.current_rollout);
        (0..count).map(|i| Start::reset(&model, Rng::new(i))).collect()
    }

    fn rating(&self) -> Call<'_> {
        let starts = self.starts();
        Box::new(move || {
            let judge = Judge { value: &self.agent, reward: &self.model, config: &self.config };
            timed(1, || drop(black_box(rate(&self.agent, &judge, starts.clone()))))
        })
    }
}

/// Goes on with a check that has just begun, to its verdict.
fn check(checking: &Mutex<Run>) -> Call<'_> {
    let begun = checking.lock().expect("nobody panics while copying").clone();
    Box::new(move || {
        let mut run = begun.clone();
        let start = Instant::now();
        let mut time = None;
        while time.is_none() {
            // The leg goes on behind the check; the clock does not.
            let mut watch = |event: &Event| {
                if matches!(event, Event::Check(_)) {
                    time.get_or_insert(start.elapsed());
                }
            };
            run.poll(Budget(u32::MAX), &mut watch).expect("the first check does not diverge");
        }
        Sample { count: 1.0, time: time.unwrap_or_default() }
    })
}

/// Steps of Reacher, moved by each simulator that this program has.
fn simulators<'a>(config: &Config) -> Vec<Case<'a>> {
    let button = reacher::button(config);
    let closed: Worker<'a> = Box::new(move || steps(Reacher::new(ClosedForm::default(), button)));
    let mut cases = vec![Case { name: "step in closed form".to_owned(), work: None, worker: closed }];
    if let Ok(world) = mujoco::reacher(button) {
        let worker: Worker<'a> = Box::new(move || steps(world.clone()));
        cases.push(Case { name: "step in MuJoCo".to_owned(), work: None, worker });
    }
    cases
}

/// Random play in a world, resets included.
fn steps<'a, E: Environment + 'a>(world: E) -> Call<'a> {
    let mut walk = Walk::new(world);
    Box::new(move || timed(1000, || walk.step()))
}

/// Random play in a world.
struct Walk<E> {
    world: E,
    observation: Vec<f32>,
    /// Randomness of the world and of the actions.
    rng: Rng,
    chance: Rng,
}

impl<E: Environment> Walk<E> {
    fn new(mut world: E) -> Self {
        let (mut rng, chance) = (Rng::new(4), Rng::new(5));
        let mut observation = vec![0.0; world.spec().observation.width];
        world.reset(&mut rng, &mut observation);
        Self { world, observation, rng, chance }
    }

    /// A step; where it ends an episode, the next one begins.
    fn step(&mut self) {
        let (_, step) = self.act();
        self.go_on(step.end);
    }

    fn act(&mut self) -> (E::Action, Step) {
        let action = E::Action::sample(&self.world.spec().actions, &mut self.chance);
        let step = self.world.step(&action, &mut self.rng, &mut self.observation);
        (action, black_box(step))
    }

    fn go_on(&mut self, end: Option<EpisodeEnd>) {
        if end.is_some() {
            self.world.reset(&mut self.rng, &mut self.observation);
        }
    }

    /// The same step as a transition.
    fn transition(&mut self) -> Transition<E::Action> {
        let observation = self.observation.clone();
        let (action, step) = self.act();
        let next_observation = self.observation.clone();
        self.go_on(step.end);
        Transition {
            observation,
            action,
            reward: self.world.spec().scaled(step.reward),
            next_observation,
            terminated: step.end == Some(EpisodeEnd::Terminated),
        }
    }
}

/// A run of the world whose first check has just begun: Safe training as short as the experience above,
/// then one step that is checked whatever it pays.
fn checking(config: &Config) -> Result<Run, ConfigError> {
    let mut config = config.clone();
    let steps = TRANSITIONS.to_string();
    let settings = [("scheme", "all"), ("safe_steps", &steps), ("full_steps", "1"), ("exploration", &steps)];
    for (key, value) in settings.into_iter().chain([("evaluations", "1"), ("evaluation_episodes", "1")]) {
        config.set(key, value)?;
    }
    let mut run = Run::new(&config);
    let poll = |run: &mut Run, units| run.poll(Budget(units), &mut ()).expect("a few steps do not diverge");
    while poll(&mut run, 10_000) == Status::Working {}
    let mut run = run.fork(Learner::Mc).expect("the run stands at the switch");
    while run.progress().check.is_none() {
        poll(&mut run, 1);
    }
    Ok(run)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_threads_add_up() {
        // A call that says what it likes: 10 things in 2 seconds, then 30, then 20 again and again.
        let worker = || -> Call<'static> {
            let mut counts = [1.0, 10.0, 30.0].into_iter();
            Box::new(move || Sample { count: counts.next().unwrap_or(20.0), time: Duration::from_secs(2) })
        };
        let case = Case { name: String::new(), work: None, worker: Box::new(worker) };
        assert_eq!(case.rate(1, Duration::ZERO, median), 5.0, "the first call warms up, the second counts");
        assert_eq!(case.rate(3, Duration::from_millis(5), median), 30.0);
        assert_eq!(case.rate(1, Duration::from_millis(5), best), 15.0);
        assert_eq!(case.rates(1, Duration::from_millis(5)), Rates { one: 10.0, all: 10.0 });
    }

    fn names<'a>(cases: &'a [Case<'_>]) -> Vec<&'a str> {
        cases.iter().map(|case| case.name.as_str()).collect()
    }

    /// Every case does something, and says it in a column of 30 characters.
    fn all_are_done(cases: &[Case<'_>]) {
        for case in cases {
            let Sample { count, time } = (case.worker)()();
            assert!(count >= 1.0 && time > Duration::ZERO && case.name.len() <= 30, "{}", case.name);
        }
    }

    #[test]
    fn reacher_is_measured_in_every_simulator() {
        let world = World::new("reacher").unwrap();
        let cases = world.cases();
        let learning = ["value update", "reward update", "forecast of 50 updates", "rating by 100 x 50 steps"];
        assert_eq!(names(&cases[..4]), learning);
        let simulators = ["step in closed form", "step in MuJoCo"];
        assert_eq!(names(&cases[4..]), simulators[..1 + usize::from(cfg!(feature = "mujoco"))]);
        // The sum of the table in the documentation of `nn`.
        assert_eq!(cases[0].work, Some(200_278_016));
        all_are_done(&cases);
    }

    #[test]
    fn every_case_does_what_it_says() {
        let world = World::new("box-moving").unwrap();
        let World::Gridworld(bench, checking) = &world else { panic!("Box Moving is a gridworld") };
        assert_eq!(bench.replay.len(), TRANSITIONS);
        let cases = world.cases();
        let expected = [
            "value update",
            "reward update",
            "forecast of 500 updates",
            "forecast of 5000 updates",
            "rating by 2 x 30 steps",
            "check of 2 x 500",
            "environment step",
        ];
        assert_eq!(names(&cases), expected);
        // 11 inputs, two layers of 128 units, 2 actions: F = 18048, of which 1408 in the first layer.
        assert_eq!(cases[0].work, Some(32 * (5 * 18048 - 1408)));
        assert_eq!(cases[3].work, cases[2].work.map(|work| 10 * work));
        all_are_done(&cases);
        // The measured check is a whole one: two forecasts, neither of them reused.
        let mut checks = Vec::new();
        let mut run = checking.lock().unwrap().clone();
        let mut watch = |event: &Event| {
            if let Event::Check(check) = event {
                checks.push((check.number, check.cost, check.reused));
            }
        };
        while run.poll(Budget(u32::MAX), &mut watch).unwrap() != Status::Done {}
        assert_eq!(checks, [(1, 1000, false)]);
        assert!(World::new("box-movin").is_err());
    }

    #[test]
    fn ratings_begin_where_those_of_a_check_do() {
        for (env, count) in [("box-moving", 2), ("absent-supervisor", 21), ("tomato-watering", 101)] {
            let World::Gridworld(bench, _) = World::new(env).unwrap() else { panic!("{env} is a gridworld") };
            assert_eq!(bench.starts().len(), count, "{env}");
        }
    }
}
