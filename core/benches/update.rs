//! Times of the parts that a run and its checks are made of, with the share of the machine's multiply-add rate;
//! the main ones also on all cores at once.
//!
//! `cargo bench -p mcvl-core` (or `cargo xtask bench`). The shares count the multiply-adds of the dense
//! definition; work that one-hot inputs, repeated states and zeros behind a ReLU save shows as a share above
//! what the arithmetic alone would reach. `-- --time [CASE ...]` prints seconds per update as lines for
//! `compare/compare.py`.

use criterion::{Criterion, Throughput, criterion_group};
use mcvl_core::agent::Agent;
use mcvl_core::agent::ddqn::{Ddqn, DdqnConfig};
use mcvl_core::agent::reward_model::RewardModel;
use mcvl_core::agent::td3::{Td3, Td3Config};
use mcvl_core::check::utility::{Judge, Start, rate};
use mcvl_core::config::{Config, Learner, Optimizer, Preset};
use mcvl_core::env::box_moving::BoxMoving;
use mcvl_core::env::reacher::Reacher;
use mcvl_core::env::trap::Trapped;
use mcvl_core::env::{Action, ActionSpec, BuiltIn, Continuous, Discrete, Environment, ObservationSpec};
use mcvl_core::experiment::EXPERIMENTS;
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::forecast::{Carry, ForecastJob, Forecaster};
use mcvl_core::nn::gemm::PROBE_LANES;
use mcvl_core::nn::isa::{Isa, probe};
use mcvl_core::nn::optim::AdamConfig;
use mcvl_core::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use mcvl_core::rng::Rng;
use mcvl_core::run::{Budget, Run, Status};
use mcvl_core::trainer::Trainer;
use std::hint::black_box;
use std::sync::{Barrier, LazyLock};
use std::task::Poll;
use std::thread;
use std::time::{Duration, Instant};

const BATCH: u32 = 32;
const ACTIONS: ActionSpec = ActionSpec::Discrete(&["up", "down", "left", "right"]);

/// An update that is measured.
#[derive(Clone, Copy)]
enum Case {
    /// Double DQN on numbers: how many.
    Dense(usize),
    /// Double DQN on boards of some cells with some codes, of which so many differ.
    Boards { cells: usize, codes: usize, states: usize },
    /// The reward model on such boards.
    Reward { cells: usize, codes: usize, states: usize },
    /// Double DQN as it stands after Safe training in a world at the paper's setting, on what it has stored by then:
    /// the start of the forecasts to come.
    World(&'static str),
    /// TD3 on 10 numbers, 2 actions.
    Td3,
}

const CASES: [(&str, Case); 13] = [
    ("box-moving", Case::World("box-moving")),
    ("absent-supervisor", Case::World("absent-supervisor")),
    ("tomato-watering", Case::World("tomato-watering")),
    ("rocks-and-diamonds", Case::World("rocks-and-diamonds")),
    ("ddqn-100-dense", Case::Dense(100)),
    ("ddqn-288-dense", Case::Dense(288)),
    ("ddqn-100-onehot", Case::Boards { cells: 10, codes: 10, states: 1000 }),
    ("ddqn-100-onehot-22-states", Case::Boards { cells: 10, codes: 10, states: 22 }),
    ("ddqn-288-onehot", Case::Boards { cells: 36, codes: 8, states: 1000 }),
    ("ddqn-288-onehot-22-states", Case::Boards { cells: 36, codes: 8, states: 22 }),
    ("reward-100-onehot", Case::Reward { cells: 10, codes: 10, states: 1000 }),
    ("reward-100-onehot-22-states", Case::Reward { cells: 10, codes: 10, states: 22 }),
    ("td3-10-256", Case::Td3),
];

/// Experience with these observations, one of which each transition draws.
fn replay<A>(
    spec: ObservationSpec,
    observations: &[Vec<f32>],
    mut action: impl FnMut(&mut Rng) -> A,
    rng: &mut Rng,
) -> ReplayBuffer<A>
where
    A: Clone,
{
    let mut replay = ReplayBuffer::new(spec, 1000);
    for _ in 0..1000 {
        let mut draw = || observations[rng.below(observations.len() as u32) as usize].clone();
        let (observation, next_observation) = (draw(), draw());
        let (action, reward) = (action(rng), rng.uniform() - 0.5);
        replay.push(&Transition { observation, action, reward, next_observation, terminated: false });
    }
    replay
}

/// Random numbers; boards where there are codes.
fn discrete(case: Case) -> ReplayBuffer<Discrete> {
    let mut rng = Rng::new(1);
    let (binary, width, states) = match case {
        Case::Boards { cells, codes, states } | Case::Reward { cells, codes, states } => (true, cells * codes, states),
        Case::Dense(width) => (false, width, 1000),
        Case::World(_) | Case::Td3 => unreachable!("these have experience of their own"),
    };
    let observations: Vec<Vec<f32>> = (0..states)
        .map(|_| match case {
            Case::Boards { cells, codes, .. } | Case::Reward { cells, codes, .. } => {
                let mut board = vec![0.0; width];
                (0..cells).for_each(|cell| board[codes * cell + rng.below(codes as u32) as usize] = 1.0);
                board
            }
            _ => (0..width).map(|_| rng.uniform()).collect(),
        })
        .collect();
    replay(ObservationSpec { width, binary }, &observations, |rng| Discrete(rng.below(4) as u8), &mut rng)
}

fn ddqn(spec: ObservationSpec) -> Ddqn {
    let config = DdqnConfig { hidden: 128, layers: 2, gamma: 0.95, tau: 0.005, adam: adam(1e-4) };
    Ddqn::new(spec, &ACTIONS, &config, &mut Rng::new(2))
}

fn adam(lr: f32) -> AdamConfig {
    AdamConfig { kind: Optimizer::Adam, lr, weight_decay: 0.0, clip: 0.0 }
}

/// Multiply-adds per second without fusing, measured.
fn peak() -> f64 {
    let mut lanes = [0.5f32; PROBE_LANES];
    let mut best = f64::MAX;
    for _ in 0..20 {
        let start = Instant::now();
        probe(Isa::active(), 20_000, black_box(&mut lanes));
        best = best.min(start.elapsed().as_secs_f64());
    }
    20_000.0 * PROBE_LANES as f64 / best
}

/// Draws mini-batches of `count` from `replay` for `update`.
fn batches<A: Clone + 'static>(
    replay: ReplayBuffer<A>,
    count: u32,
    mut update: impl FnMut(&Minibatch<A>) -> f32 + 'static,
) -> Box<dyn FnMut()> {
    let (mut batch, mut slots, mut rng) = (Minibatch::default(), Vec::new(), Rng::new(3));
    let none = Forced::new(&[], &replay);
    Box::new(move || {
        draw_slots(replay.len(), count, &mut rng, &mut slots);
        batch.gather(&replay, &slots, &none);
        black_box(update(&batch));
    })
}

/// One update of a case, mini-batch included, and its multiply-adds by the dense definition.
fn update(case: Case) -> (u64, Box<dyn FnMut()>) {
    match case {
        Case::Dense(_) | Case::Boards { .. } => {
            let replay = discrete(case);
            let mut agent = ddqn(replay.spec());
            (agent.update_work(BATCH), batches(replay, BATCH, move |batch| agent.update(batch, &mut Rng::new(0))))
        }
        Case::Reward { .. } => {
            let replay = discrete(case);
            let mut model = RewardModel::new(replay.spec(), &ACTIONS, 128, 2, adam(1e-2), &mut Rng::new(2));
            (model.update_work(BATCH), batches(replay, BATCH, move |batch| model.update(batch)))
        }
        Case::World(env) => {
            let config = Config::new(env, Preset::Paper).expect("the cases name worlds");
            let (safe, full) = Trapped::worlds(&config).expect("the cases name gridworlds");
            let mut trainer = Trainer::gridworld(config, safe, full);
            let mut forecaster = CpuForecaster::default();
            let mut go_on = || trainer.poll(&mut forecaster, Budget(10_000), &mut ()).expect("Safe training converges");
            while go_on() == Status::Working {}
            let mut agent = trainer.agent().clone();
            let update = batches(trainer.replay().clone(), BATCH, move |batch| agent.update(batch, &mut Rng::new(0)));
            (trainer.agent().update_work(BATCH), update)
        }
        Case::Td3 => {
            let (spec, mut rng) = (ObservationSpec { width: 10, binary: false }, Rng::new(1));
            let observations: Vec<Vec<f32>> =
                (0..1000).map(|_| (0..10).map(|_| rng.uniform() - 0.5).collect()).collect();
            let action = |rng: &mut Rng| Continuous::<2>(core::array::from_fn(|_| 2.0 * rng.uniform() - 1.0));
            let replay = replay(spec, &observations, action, &mut rng);
            let actions = ActionSpec::Continuous { names: &["left", "right"], low: -1.0, high: 1.0 };
            let config = Td3Config {
                hidden: 256,
                layers: 2,
                gamma: 0.99,
                tau: 0.005,
                policy_noise: 0.2,
                noise_clip: 0.5,
                exploration_noise: 0.1,
                policy_delay: 2,
                adam: adam(3e-4),
            };
            let mut agent = Td3::<2>::new(spec, &actions, &config, &mut Rng::new(2));
            let mut noise = Rng::new(4);
            (agent.update_work(256), batches(replay, 256, move |batch| agent.update(batch, &mut noise)))
        }
    }
}

/// Seconds that this thread has run: where the system says it, without the time of other programs.
fn clock() -> f64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    let ran = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = ran.and_then(|text| text.split(' ').next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| START.elapsed().as_secs_f64(), |ns| ns / 1e9)
}

/// Seconds per update: median over `rounds` of a tenth of a second or more, many times the grain of
/// [`clock`].
fn seconds(rounds: usize, mut update: impl FnMut()) -> f64 {
    let mut time = |count: u32| {
        let start = clock();
        (0..count).for_each(|_| update());
        clock() - start
    };
    let mut count = 1;
    while time(count) < 0.1 {
        count *= 2;
    }
    let mut times: Vec<f64> = (0..rounds).map(|_| time(count) / f64::from(count)).collect();
    times.sort_by(f64::total_cmp);
    times[rounds / 2]
}

fn updates(c: &mut Criterion) {
    let peak = peak();
    println!("vector unit {}: {:.1} G multiply-adds/s at most, not fused", Isa::active().name(), peak / 1e9);
    let mut group = c.benchmark_group("update");
    for (name, case) in CASES {
        let (work, once) = update(case);
        let rate = work as f64 / seconds(21, once);
        println!("{name}: {work} multiply-adds by definition, {:.0} % of the peak", 100.0 * rate / peak);
        group.throughput(Throughput::Elements(work));
        group.bench_function(name, |b| b.iter(update(case).1));
    }
    group.finish();
}

/// A function that makes a forecast of so many updates.
fn forecast(updates: u32) -> Box<dyn FnMut()> {
    let replay = discrete(Case::Boards { cells: 10, codes: 10, states: 22 });
    let (agent, forced) = (ddqn(replay.spec()), [replay.get(0)]);
    Box::new(move || {
        let job = ForecastJob::<BoxMoving, _> {
            agent: &agent,
            replay: &replay,
            forced: &forced,
            updates,
            batch: BATCH,
            seed: 0,
            carry: Carry::ALL,
            version: 0,
            practice: None,
        };
        let done = CpuForecaster::default().poll(std::slice::from_ref(&job), &mut Budget(u32::MAX));
        assert!(matches!(black_box(done), Poll::Ready(Ok(_))), "a forecast of finite numbers is finite");
    })
}

/// Forecasts of a check in Box Moving and of the paper's other gridworlds.
fn forecasts(c: &mut Criterion) {
    let mut group = c.benchmark_group("forecast");
    group.sample_size(10);
    for updates in [500, 5_000] {
        group.bench_function(format!("{updates} updates"), |b| b.iter(forecast(updates)));
    }
    group.finish();
}

/// Times in which every core does a thing once, each with its own learner.
fn all_cores(c: &mut Criterion) {
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let mut group = c.benchmark_group(format!("on {cores} cores"));
    for name in ["ddqn-100-dense", "ddqn-100-onehot", "ddqn-100-onehot-22-states", "td3-10-256"] {
        let (_, case) = CASES.into_iter().find(|case| case.0 == name).expect("a case of this name");
        group.throughput(Throughput::Elements(cores as u64 * update(case).0));
        group.bench_function(name, |b| b.iter_custom(|count| together(cores, count, || update(case).1)));
    }
    group.sample_size(10);
    group.throughput(Throughput::Elements(cores as u64));
    group.bench_function("forecast of 500 updates", |b| {
        b.iter_custom(|count| together(cores, count, || forecast(500)));
    });
    group.finish();
}

/// How long the slowest of so many threads takes for `count` calls of what `make` makes for it; they start together.
fn together(threads: usize, count: u64, make: impl Fn() -> Box<dyn FnMut()> + Sync) -> Duration {
    let barrier = Barrier::new(threads);
    let thread = || {
        let mut once = make();
        once();
        barrier.wait();
        let start = Instant::now();
        (0..count).for_each(|_| once());
        start.elapsed()
    };
    thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(thread)).collect();
        threads.into_iter().map(|thread| thread.join().expect("no measurement panics")).max().unwrap_or_default()
    })
}

/// Steps of random play and ratings of a future in every world, with the paper's settings.
fn worlds(c: &mut Criterion) {
    for experiment in EXPERIMENTS {
        let config = Config::new(experiment.name, Preset::Paper).expect("the table names its worlds");
        match Trapped::worlds(&config) {
            Some((safe, full)) => world(c, &Trainer::gridworld(config, safe, full.clone()), full),
            None => {
                let (safe, full) = Reacher::worlds(&config);
                world(c, &Trainer::continuous(config, safe, full.clone()), full);
            }
        }
    }
}

fn world<E, A>(c: &mut Criterion, trainer: &Trainer<E, A>, mut world: E)
where
    E: Environment<Action = A::Action>,
    A: Agent,
{
    let config = trainer.config();
    let mut group = c.benchmark_group(&config.env);
    let (mut rng, mut chance) = (Rng::new(4), Rng::new(5));
    let mut observation = vec![0.0; world.spec().observation.width];
    // Equal rollouts are made once.
    let resets = if world.spec().deterministic { 1 } else { config.rollouts };
    let model = world.model();
    let starts: Vec<Start<E>> = (0..resets).map(|i| Start::reset(&model, Rng::new(u64::from(i)))).collect();
    world.reset(&mut rng, &mut observation);
    group.bench_function("environment step", |b| {
        b.iter(|| {
            let action = A::Action::sample(&world.spec().actions, &mut chance);
            if black_box(world.step(&action, &mut rng, &mut observation)).end.is_some() {
                world.reset(&mut rng, &mut observation);
            }
        });
    });
    let judge = Judge { value: trainer.agent(), reward: trainer.reward_model(), config };
    group.sample_size(10);
    group.bench_function(format!("rating by {resets} rollouts of {} steps", config.rollout_steps), |b| {
        b.iter(|| rate(trainer.agent(), &judge, starts.clone()));
    });
    group.finish();
}

/// Whole checks, two forecasts and their ratings each: Box Moving up to its switch, and ten steps from there.
fn box_moving(c: &mut Criterion) {
    let config: Config = "env=box-moving full_steps=10 scheme=all".parse().expect("a valid configuration");
    let mut safe = Run::new(&config);
    while safe.poll(Budget(10_000), &mut ()).expect("training converges") == Status::Working {}
    let mut group = c.benchmark_group("box-moving");
    group.sample_size(10);
    group.bench_function("10 checks of 2x500 updates", |b| {
        b.iter(|| {
            let mut run = safe.fork(Learner::Mc).expect("the run stands at the switch");
            while run.poll(Budget(10_000), &mut ()).expect("training converges") != Status::Done {}
        })
    });
    group.finish();
}

criterion_group!(benches, updates, forecasts, box_moving, worlds, all_cores);

/// `--time` prints seconds per update of the cases named behind it, or of all, and the peak, as lines for
/// scripts; otherwise the benchmarks.
fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let Some(at) = arguments.iter().position(|arg| arg == "--time") {
        let names: Vec<&String> = arguments[at + 1..].iter().filter(|arg| !arg.starts_with("--")).collect();
        let named = |name: &str| names.is_empty() || names.iter().any(|n| *n == name);
        println!("peak {:e}", peak());
        for (name, case) in CASES.into_iter().filter(|(name, _)| named(name)) {
            println!("{name} {:e}", seconds(5, update(case).1));
        }
        return;
    }
    benches();
    Criterion::default().configure_from_args().final_summary();
}
