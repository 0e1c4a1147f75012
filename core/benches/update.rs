//! Times of the parts that a check is made of, with the share of the machine's multiply-add rate.
//!
//! `cargo bench -p mcvl-core` (or `cargo xtask bench`). The shares count the multiply-adds of the dense
//! definition; work that one-hot inputs and repeated states save shows as a share above what the
//! arithmetic alone would reach.

use criterion::{Criterion, Throughput, criterion_group};
use mcvl_core::agent::Agent;
use mcvl_core::agent::ddqn::{Ddqn, DdqnConfig};
use mcvl_core::agent::reward_model::RewardModel;
use mcvl_core::config::{Config, Learner, Optimizer};
use mcvl_core::env::reacher::{Button, ClosedForm, Reacher};
use mcvl_core::env::{Action as _, ActionSpec, Continuous, Discrete, Environment as _, ObservationSpec};
use mcvl_core::nn::gemm::PROBE_LANES;
use mcvl_core::nn::isa::{Isa, probe};
use mcvl_core::nn::optim::AdamConfig;
use mcvl_core::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use mcvl_core::rng::Rng;
use mcvl_core::run::{Budget, Run, Status};
use std::hint::black_box;
use std::time::Instant;

const BATCH: u32 = 32;
const ACTIONS: ActionSpec = ActionSpec::Discrete(&["up", "down", "left", "right"]);

/// Experience of random boards with `cells` cells of ten codes; `states` different boards.
fn replay(binary: bool, cells: usize, states: usize) -> ReplayBuffer<Discrete> {
    let spec = ObservationSpec { width: 10 * cells, binary };
    let mut rng = Rng::new(1);
    let boards: Vec<Vec<f32>> = (0..states)
        .map(|_| {
            let mut board = vec![0.0; spec.width];
            (0..cells).for_each(|cell| board[10 * cell + rng.below(10) as usize] = 1.0);
            board
        })
        .collect();
    let mut replay = ReplayBuffer::new(spec, 1000);
    for _ in 0..1000 {
        let mut board = || boards[rng.below(states as u32) as usize].clone();
        let (observation, next_observation) = (board(), board());
        let action = Discrete(rng.below(4) as u8);
        let reward = rng.uniform();
        replay.push(&Transition { observation, action, reward, next_observation, terminated: false });
    }
    replay
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

/// The measured updates: name, one-hot or dense input, cells of ten codes, distinct states.
const CASES: [(&str, bool, usize, usize); 5] = [
    ("100-dense", false, 10, 1000),
    ("100-onehot", true, 10, 1000),
    ("100-onehot-22-states", true, 10, 22),
    ("290-onehot", true, 29, 1000),
    ("290-onehot-22-states", true, 29, 22),
];

/// One update of a case, mini-batch included, and its multiply-adds by the dense definition.
fn update((_, binary, cells, states): (&str, bool, usize, usize)) -> (u64, impl FnMut()) {
    let replay = replay(binary, cells, states);
    let config = DdqnConfig { hidden: 128, layers: 2, gamma: 0.95, tau: 0.005, adam: adam(1e-4) };
    let mut agent = Ddqn::new(replay.spec(), &ACTIONS, &config, &mut Rng::new(2));
    let work = agent.update_work(BATCH);
    let (mut batch, mut slots, mut rng) = (Minibatch::default(), Vec::new(), Rng::new(3));
    let none = Forced::new(&[], &replay);
    let update = move || {
        draw_slots(replay.len(), BATCH, &mut rng, &mut slots);
        batch.gather(&replay, &slots, &none);
        black_box(agent.update(&batch, &mut Rng::new(0)));
    };
    (work, update)
}

/// Seconds per update: median over batches of 200.
fn seconds(mut update: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..21)
        .map(|_| {
            let start = Instant::now();
            (0..200).for_each(|_| update());
            start.elapsed().as_secs_f64() / 200.0
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[10]
}

fn updates(c: &mut Criterion) {
    let peak = peak();
    println!("vector unit {}: {:.1} G multiply-adds/s at most, not fused", Isa::active().name(), peak / 1e9);
    let mut group = c.benchmark_group("ddqn-update");
    for case in CASES {
        let (work, once) = update(case);
        let rate = work as f64 / seconds(once);
        println!("{}: {work} multiply-adds by definition, {:.0} % of the peak", case.0, 100.0 * rate / peak);
        group.throughput(Throughput::Elements(work));
        group.bench_function(case.0, |b| b.iter(update(case).1));
    }
    group.finish();
}

fn reward_model(c: &mut Criterion) {
    for (name, states) in [("reward-update/100-onehot", 1000), ("reward-update/100-onehot-22-states", 22)] {
        let replay = replay(true, 10, states);
        let mut model = RewardModel::new(replay.spec(), &ACTIONS, 128, 2, adam(1e-2), &mut Rng::new(2));
        let (mut batch, mut slots, mut rng) = (Minibatch::default(), Vec::new(), Rng::new(3));
        let none = Forced::new(&[], &replay);
        c.bench_function(name, |b| {
            b.iter(|| {
                draw_slots(replay.len(), BATCH, &mut rng, &mut slots);
                batch.gather(&replay, &slots, &none);
                black_box(model.update(&batch));
            })
        });
    }
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

/// An episode of Reacher in closed form, reset included.
fn reacher(c: &mut Criterion) {
    let mut world = Reacher::new(ClosedForm::default(), Some(Button::proposal()));
    let spec = world.spec().clone();
    let (mut rng, mut observation) = (Rng::new(1), vec![0.0; spec.observation.width]);
    let mut group = c.benchmark_group("reacher");
    group.throughput(Throughput::Elements(u64::from(spec.max_steps)));
    group.bench_function("episode in closed form", |b| {
        b.iter(|| {
            world.reset(&mut rng, &mut observation);
            for _ in 0..spec.max_steps {
                let action = Continuous::sample(&spec.actions, &mut rng);
                black_box(world.step(&action, &mut rng, &mut observation));
            }
        })
    });
    group.finish();
}

criterion_group!(benches, updates, reward_model, box_moving, reacher);

/// `--time` prints seconds per update of every case and the peak as lines for scripts; otherwise the
/// benchmarks.
fn main() {
    if std::env::args().any(|arg| arg == "--time") {
        println!("peak {:e}", peak());
        CASES.into_iter().for_each(|case| println!("{} {:e}", case.0, seconds(update(case).1)));
        return;
    }
    benches();
    Criterion::default().configure_from_args().final_summary();
}
