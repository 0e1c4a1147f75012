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

use mcvl_core::agent::Agent as _;
use mcvl_core::agent::ddqn::Ddqn;
use mcvl_core::agent::reward_model::RewardModel;
use mcvl_core::config::{Config, ConfigError, Learner, Preset};
use mcvl_core::env::box_moving::BoxMoving;
use mcvl_core::env::reacher::{Button, ClosedForm, Reacher};
use mcvl_core::env::{Action, Discrete, Environment, EpisodeEnd};
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::forecast::{Carry, ForecastJob, Forecaster as _};
use mcvl_core::nn::gemm::PROBE_LANES;
use mcvl_core::nn::isa::{Isa, probe};
use mcvl_core::play::Play;
use mcvl_core::record::{Arm, Event};
use mcvl_core::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use mcvl_core::rng::Rng;
use mcvl_core::run::{Budget, Run, Status};
use serde::Serialize;

pub use gpu::{JOBS, Throughput};

use crate::mujoco;

/// Updates of the measured forecast: those of a check in Box Moving.
const FORECAST: u32 = 500;
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

/// A world with learners of the paper's sizes and some experience.
pub struct Bench {
    config: Config,
    agent: Ddqn,
    model: RewardModel,
    replay: ReplayBuffer<Discrete>,
    /// One surprise, as a check forces it into the mini-batches of a forecast.
    surprise: Transition<Discrete>,
    /// A run with its first check under way; each thread takes a copy.
    checking: Mutex<Run>,
}

impl Bench {
    /// Prepares the world of this name.
    ///
    /// # Errors
    /// If there is none.
    ///
    /// # Panics
    /// If a few steps of training diverge with the paper's settings.
    pub fn new(env: &str) -> Result<Self, ConfigError> {
        let config = Config::new(env, Preset::Paper)?;
        let mut play = Play::new(&config, Arm::Safe);
        let agent = Ddqn::configured(&config, play.spec());
        let model = RewardModel::configured(&config, play.spec());
        let mut replay = ReplayBuffer::new(play.spec().observation, TRANSITIONS);
        let mut rng = Rng::new(1);
        let mut surprise = None;
        for _ in 0..TRANSITIONS {
            let transition = random_step(&mut play, &mut rng);
            replay.push(&transition);
            surprise = Some(transition);
        }
        Ok(Self {
            checking: Mutex::new(checking(&config)?),
            config,
            agent,
            model,
            replay,
            surprise: surprise.expect("a step"),
        })
    }

    /// Everything that is measured here.
    pub fn cases(&self) -> Vec<Case<'_>> {
        let batch = self.config.batch;
        let forced = self.agent.update_work(batch + 1);
        let case = |name: String, work, worker| Case { name, work, worker };
        let practice = if self.config.practice { " with practice" } else { "" };
        vec![
            case("value update".into(), Some(self.agent.update_work(batch)), Box::new(|| self.value_update())),
            case("reward update".into(), Some(self.model.update_work(batch)), Box::new(|| self.reward_update())),
            case(
                format!("forecast of {FORECAST} updates"),
                Some(u64::from(FORECAST) * forced),
                Box::new(|| self.forecast()),
            ),
            case(format!("check of 2 x {} updates{practice}", self.config.forecast), None, Box::new(|| self.check())),
            case("environment step".into(), None, Box::new(|| self.environment())),
        ]
    }

    /// A function that draws the next mini-batch.
    fn batches(&self) -> impl FnMut(&mut Minibatch<Discrete>) + '_ {
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

    fn forecast(&self) -> Call<'_> {
        let mut forecaster = CpuForecaster::default();
        Box::new(move || {
            let jobs = [ForecastJob::<BoxMoving, _> {
                agent: &self.agent,
                replay: &self.replay,
                forced: std::slice::from_ref(&self.surprise),
                updates: FORECAST,
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

    fn check(&self) -> Call<'_> {
        let begun = self.checking.lock().expect("nobody panics while copying").clone();
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

    fn environment(&self) -> Call<'_> {
        let mut play = Play::new(&self.config, Arm::Mc);
        let (actions, mut rng) = (play.spec().actions, Rng::new(4));
        Box::new(move || {
            timed(1000, || {
                if black_box(play.step(Discrete::sample(&actions, &mut rng))).is_none() {
                    play.restart();
                }
            })
        })
    }
}

/// Steps of Reacher, moved by each simulator that this program has.
pub fn reacher<'a>() -> Vec<Case<'a>> {
    let button = Some(Button::proposal());
    let closed: Worker<'a> = Box::new(move || steps(Reacher::new(ClosedForm::default(), button)));
    let mut cases = vec![Case { name: "step in closed form".to_owned(), work: None, worker: closed }];
    if let Ok(world) = mujoco::reacher(button) {
        let worker: Worker<'a> = Box::new(move || steps(world.clone()));
        cases.push(Case { name: "step in MuJoCo".to_owned(), work: None, worker });
    }
    cases
}

/// Random play in a world, resets included.
fn steps<'a, E: Environment + 'a>(mut world: E) -> Call<'a> {
    let (actions, mut rng, mut chance) = (world.spec().actions, Rng::new(4), Rng::new(5));
    let mut observation = vec![0.0; world.spec().observation.width];
    world.reset(&mut rng, &mut observation);
    Box::new(move || {
        timed(1000, || {
            let action = E::Action::sample(&actions, &mut chance);
            if black_box(world.step(&action, &mut rng, &mut observation)).end.is_some() {
                world.reset(&mut rng, &mut observation);
            }
        })
    })
}

/// A step of random play as a transition; the next episode begins behind the end of one.
fn random_step(play: &mut Play, rng: &mut Rng) -> Transition<Discrete> {
    if play.score().end.is_some() {
        play.restart();
    }
    let observation = play.observation().to_vec();
    let actions = play.spec().actions;
    let action = Discrete::sample(&actions, rng);
    let step = play.step(action).expect("the episode is not over");
    Transition {
        observation,
        action,
        reward: play.spec().scaled(step.reward),
        next_observation: play.observation().to_vec(),
        terminated: step.end == Some(EpisodeEnd::Terminated),
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

    #[test]
    fn every_simulator_of_reacher_is_measured() {
        let cases = reacher();
        let names: Vec<&str> = cases.iter().map(|case| case.name.as_str()).collect();
        let expected = ["step in closed form", "step in MuJoCo"];
        assert_eq!(names, expected[..1 + usize::from(cfg!(feature = "mujoco"))]);
        for case in &cases {
            let Sample { count, time } = (case.worker)()();
            assert!(count >= 1.0 && time > Duration::ZERO, "{}", case.name);
        }
    }

    #[test]
    fn every_case_does_what_it_says() {
        let bench = Bench::new("box-moving").unwrap();
        assert_eq!(bench.replay.len(), TRANSITIONS);
        let cases = bench.cases();
        let names: Vec<&str> = cases.iter().map(|case| case.name.as_str()).collect();
        let expected = ["value update", "reward update", "forecast of 500 updates", "check of 2 x 500 updates"];
        assert_eq!(names[..4], expected);
        // 11 inputs, two layers of 128 units, 2 actions: F = 18048, of which 1408 in the first layer.
        assert_eq!(cases[0].work, Some(32 * (5 * 18048 - 1408)));
        for case in &cases {
            let Sample { count, time } = (case.worker)()();
            assert!(count >= 1.0 && time > Duration::ZERO, "{}", case.name);
        }
        // The measured check is a whole one: two forecasts, neither of them reused.
        let mut checks = Vec::new();
        let mut run = bench.checking.lock().unwrap().clone();
        let mut watch = |event: &Event| {
            if let Event::Check(check) = event {
                checks.push((check.number, check.cost, check.reused));
            }
        };
        while run.poll(Budget(u32::MAX), &mut watch).unwrap() != Status::Done {}
        assert_eq!(checks, [(1, 1000, false)]);
        assert!(Bench::new("box-movin").is_err());
    }
}
