//! Times of the parts that a check is made of, with the share of the machine's multiply-add rate.
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
use mcvl_core::config::{Config, Learner, Optimizer};
use mcvl_core::env::box_moving::BoxMoving;
use mcvl_core::env::{ActionSpec, Continuous, Discrete, ObservationSpec};
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::forecast::{Carry, ForecastJob, Forecaster};
use mcvl_core::nn::gemm::PROBE_LANES;
use mcvl_core::nn::isa::{Isa, probe};
use mcvl_core::nn::optim::AdamConfig;
use mcvl_core::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use mcvl_core::rng::Rng;
use mcvl_core::run::{Budget, Run, Status};
use std::hint::black_box;
use std::sync::LazyLock;
use std::task::Poll;
use std::time::Instant;

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
    /// TD3 on 10 numbers, 2 actions.
    Td3,
}

const CASES: [(&str, Case); 9] = [
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
        Case::Td3 => unreachable!("TD3 has other actions"),
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

/// Forecasts of a check in Box Moving and of the largest in the paper.
fn forecasts(c: &mut Criterion) {
    let replay = discrete(Case::Boards { cells: 10, codes: 10, states: 22 });
    let agent = ddqn(replay.spec());
    let forced = [replay.get(0)];
    let mut group = c.benchmark_group("forecast");
    group.sample_size(10);
    for updates in [500, 5_000] {
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
        group.bench_function(format!("{updates} updates"), |b| {
            b.iter(|| {
                let done = CpuForecaster::default().poll(std::slice::from_ref(&job), &mut Budget(u32::MAX));
                assert!(matches!(black_box(done), Poll::Ready(Ok(_))), "a forecast of finite numbers is finite");
            })
        });
    }
    group.finish();
}

/// Box Moving up to its switch, and 100 checked steps from there.
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

criterion_group!(benches, updates, forecasts, box_moving);

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
