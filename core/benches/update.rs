//! Times of the parts that a run and its checks are made of, with the share of the machine's multiply-add rate;
//! the main ones also on all cores at once.
//!
//! `cargo bench -p mcvl-core` (or `cargo xtask bench`). The shares count the multiply-adds of the dense
//! definition; work that one-hot inputs, repeated states and zeros behind a ReLU save shows as a share above
//! what the arithmetic alone would reach.

#[path = "compare/cases.rs"]
mod cases;

use cases::{BATCH, CASES, Case, ddqn, discrete, update};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mcvl_core::agent::Agent;
use mcvl_core::check::utility::{Judge, Start, rate};
use mcvl_core::config::{Config, Learner, Preset};
use mcvl_core::env::box_moving::BoxMoving;
use mcvl_core::env::reacher::Reacher;
use mcvl_core::env::trap::Trapped;
use mcvl_core::env::{Action, BuiltIn, Environment};
use mcvl_core::experiment::EXPERIMENTS;
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::forecast::{Carry, ForecastJob, Forecaster};
use mcvl_core::nn::gemm::PROBE_LANES;
use mcvl_core::nn::isa::{Isa, probe};
use mcvl_core::rng::Rng;
use mcvl_core::run::{Budget, Run, Status};
use mcvl_core::trainer::Trainer;
use std::hint::black_box;
use std::sync::{Barrier, LazyLock};
use std::task::Poll;
use std::thread;
use std::time::{Duration, Instant};

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

/// Seconds that this thread has run: where the system says it, without the time of other programs.
fn clock() -> f64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    let ran = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = ran.and_then(|text| text.split(' ').next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| START.elapsed().as_secs_f64(), |ns| ns / 1e9)
}

/// Seconds per update: median over `rounds` of a tenth of a second or more, many times the grain of
/// [`clock`].
fn seconds<T>(rounds: usize, mut update: impl FnMut() -> T) -> f64 {
    let mut time = |count: u32| {
        let start = clock();
        (0..count).for_each(|_| _ = black_box(update()));
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
fn together<T>(threads: usize, count: u64, make: impl Fn() -> Box<dyn FnMut() -> T> + Sync) -> Duration {
    let barrier = Barrier::new(threads);
    let thread = || {
        let mut once = make();
        once();
        barrier.wait();
        let start = Instant::now();
        (0..count).for_each(|_| _ = black_box(once()));
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
criterion_main!(benches);
