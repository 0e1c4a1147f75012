//! The kernels without a device; futures of a device against the processor's.

use std::sync::Arc;
use std::task::Poll;
use std::thread;
use std::time::Duration;

use mcvl_core::agent::td3::Td3Config;
use mcvl_core::config::Optimizer;
use mcvl_core::env::reacher::Reacher;
use mcvl_core::env::{ActionSpec, ObservationSpec};
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::forecast::{Carry, ForecastError, Forecaster};
use mcvl_core::nn::mlp::Scratch;
use mcvl_core::nn::optim::{Adam, AdamConfig};
use mcvl_core::nn::rows::Rows;
use mcvl_core::record::Event;
use mcvl_core::replay::{Minibatch, Transition, draw_slots};
use mcvl_core::rng::Rng;
use mcvl_core::run::{Budget, Run, Status};

use super::super::forecaster::{GpuForecaster, OnDevice};
use super::super::tests::{device, layouts};
use super::super::worker::Work;
use super::super::{Gpu, Seat};
use super::*;

#[test]
fn kernels_are_valid_and_their_structs_are_ours() {
    let kernels = layouts(SOURCE);
    assert_eq!(kernels["Product"], Product::layout());
    assert_eq!(kernels["Step"], Step::layout());
    assert_eq!(kernels["Job"], Job::layout());
    assert_eq!(kernels["Operation"], Operation::layout());
    assert_eq!(kernels["Update"], Update::layout());
    let constants = [
        ("THREADS", THREADS),
        ("SAMPLES", SAMPLES),
        ("TILE_ROWS", TILE_ROWS),
        ("TILE_COLUMNS", TILE_COLUMNS),
        ("PRODUCTS", PRODUCTS as u32),
        ("STEPS", STEPS as u32),
    ];
    for (name, value) in constants {
        assert!(SOURCE.contains(&format!("const {name} = {value}u;")), "{name} = {value}");
    }
    for (number, name) in ENTRIES.iter().enumerate() {
        assert!(SOURCE.contains(&format!("fn {name}(@builtin")), "{name}");
        assert!(UPDATE.iter().any(|dispatch| dispatch.entry as usize == number), "{name} is used");
    }
}

#[test]
fn an_update_has_every_product_and_every_step_once() {
    let mut used = [0; PRODUCTS];
    let mut steps = [0; STEPS];
    for Dispatch { entry, operation: Operation { first, parts }, .. } in UPDATE {
        let parts = if entry == Entry::Loss { 4 } else { parts };
        for at in first as usize..(first + parts) as usize {
            match entry {
                Entry::Gather => {}
                Entry::Step => steps[at] += 1,
                _ => used[at] += 1,
            }
        }
    }
    assert_eq!((used, steps), ([1; PRODUCTS], [1; STEPS]));
}

const ACTIONS: ActionSpec = ActionSpec::Continuous { names: &["a", "b"], low: -1.0, high: 2.0 };

fn settings(hidden: usize) -> Td3Config {
    Td3Config {
        hidden,
        layers: 2,
        gamma: 0.9,
        tau: 0.05,
        policy_noise: 0.2,
        noise_clip: 0.3,
        exploration_noise: 0.1,
        policy_delay: 2,
        adam: AdamConfig { kind: Optimizer::Adam, lr: 1e-3, weight_decay: 0.0, clip: 0.0 },
    }
}

/// A world without rules: random numbers, of which some end the episode.
struct Small {
    agent: Td3<2>,
    replay: ReplayBuffer<Continuous<2>>,
    surprise: [Transition<Continuous<2>>; 2],
}

impl Small {
    fn new(width: usize, config: &Td3Config, seed: u64) -> Self {
        let spec = ObservationSpec { width, binary: false };
        let mut rng = Rng::new(seed);
        let mut transition = |terminated: bool| {
            let mut numbers = |count: usize| (0..count).map(|_| 2.0 * rng.uniform() - 1.0).collect::<Vec<f32>>();
            let (observation, next_observation, rest) = (numbers(width), numbers(width), numbers(3));
            let action = Continuous([0.5 + 1.5 * rest[0], 0.5 + 1.5 * rest[1]]);
            Transition { observation, action, reward: rest[2], next_observation, terminated }
        };
        let mut replay = ReplayBuffer::new(spec, 100);
        // More than it holds, so that observations were forgotten and their numbers used again.
        (0..130).for_each(|i| replay.push(&transition(i % 7 == 3)));
        // One whose first observation is in the buffer, and one that ends an episode.
        let known = Transition { observation: replay.get(5).observation, reward: 3.0, ..transition(false) };
        let surprise = [known, transition(true)];
        let mut agent = Td3::new(spec, &ACTIONS, config, &mut rng);
        // A learner in the middle of its life: moments, and target networks behind.
        let (mut slots, mut batch, none) = (Vec::new(), Minibatch::default(), Forced::new(&[], &replay));
        for _ in 0..7 {
            draw_slots(replay.len(), 16, &mut rng, &mut slots);
            batch.gather(&replay, &slots, &none);
            agent.update(&batch, &mut rng);
        }
        Self { agent, replay, surprise }
    }

    /// The two futures of a check, of which one has `forced` surprising transitions.
    fn jobs(&self, updates: u32, batch: u32, forced: usize, seed: u64) -> [ForecastJob<'_, Reacher, Td3<2>>; 2] {
        let job = |forced| ForecastJob {
            agent: &self.agent,
            replay: &self.replay,
            forced,
            updates,
            batch,
            seed,
            carry: Carry::ALL,
            version: 5,
            practice: None,
        };
        [job(&self.surprise[..forced]), job(&[])]
    }
}

type Jobs<'a> = [ForecastJob<'a, Reacher, Td3<2>>];

fn finish(forecaster: &mut dyn Forecaster<Reacher, Td3<2>>, jobs: &Jobs<'_>) -> Result<Vec<Td3<2>>, ForecastError> {
    loop {
        if let Poll::Ready(result) = forecaster.poll(jobs, &mut Budget(1_000_000)) {
            return result;
        }
        thread::sleep(Duration::from_millis(1));
    }
}

fn here(jobs: &Jobs<'_>) -> Vec<Td3<2>> {
    finish(&mut CpuForecaster::default(), jobs).unwrap()
}

fn there(gpu: &Gpu, jobs: &Jobs<'_>) -> Vec<Td3<2>> {
    finish(&mut GpuForecaster::new(gpu.desk.clone(), Arc::default()), jobs).unwrap()
}

/// What updates changed is the same but for a small part: the actor's tangent is the kernels' own, and a card may also
/// fuse and divide as it likes.
#[track_caller]
fn assert_same(gpu: &Gpu, start: &Td3<2>, own: &Td3<2>, other: &Td3<2>) {
    assert_eq!(own.updates(), other.updates());
    let [start_numbers, own_numbers, other_numbers] =
        [start, own, other].map(|agent| agent.numbers().collect::<Vec<_>>());
    let mean =
        |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / a.len() as f64;
    let (apart, moved) = (mean(&own_numbers, &other_numbers), mean(&own_numbers, &start_numbers));
    let most = own_numbers.iter().zip(&other_numbers).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    println!("mean distance {apart:.1e} of {moved:.1e} moved, largest {most:.1e}");
    assert!(other_numbers.iter().all(|number| number.is_finite()));
    assert_eq!(own.optimizers().map(Adam::steps), other.optimizers().map(Adam::steps));
    let share = if gpu.adapter().software { 1e-4 } else { 0.02 };
    assert!(apart <= share * moved, "mean distance {apart} of {moved} moved, largest {most}");
}

#[test]
fn a_software_device_has_the_processors_bits_but_for_the_tangent() {
    let Some(gpu) = device() else { return };
    if !gpu.adapter().software {
        return;
    }
    for (width, hidden, batch) in [(3, 5, 8), (10, 70, 40)] {
        // An actor whose tangent is that of zero, and that does not move.
        let mut small = Small::new(width, &Td3Config { policy_delay: 1_000, ..settings(hidden) }, 3);
        let actor = small.agent.actor_mut().params_mut();
        let last = actor.len() - 2 * hidden - 2;
        actor[last..].fill(0.0);
        let mut jobs = small.jobs(30, batch, 2, 11);
        // Target networks that equal the live ones: their actor has no tangent either.
        jobs.iter_mut().for_each(|job| job.carry = Carry { target: false, optimizer: true });
        for (own, other) in here(&jobs).iter().zip(there(&gpu, &jobs)) {
            let all = |agent: &Td3<2>| serde_json::to_string(agent).unwrap();
            assert_eq!(all(own), all(&other));
            assert_ne!(own.digest(), small.agent.digest());
        }
    }
}

#[test]
fn futures_of_a_device_are_the_processors() {
    let Some(gpu) = device() else { return };
    let clipped = AdamConfig { kind: Optimizer::AdamWAmsGrad, lr: 1e-3, weight_decay: 0.01, clip: 0.02 };
    let cases = [
        // Less than a tile, and several of them with a rest.
        (3, settings(5), 8, 0),
        (3, settings(5), 8, 1),
        (10, Td3Config { policy_delay: 3, ..settings(70) }, 40, 2),
        (10, Td3Config { policy_delay: 1, adam: clipped, ..settings(33) }, 64, 1),
    ];
    for (width, config, batch, forced) in cases {
        let small = Small::new(width, &config, 3);
        for updates in [0, 1, 6] {
            let jobs = small.jobs(updates, batch, forced, 11);
            let (own, other) = (here(&jobs), there(&gpu, &jobs));
            for (a, b) in own.iter().zip(&other) {
                assert_same(&gpu, &small.agent, a, b);
                assert_eq!(b.digest() == small.agent.digest(), updates == 0);
            }
            assert_eq!(own[0].digest() == own[1].digest(), updates == 0 || forced == 0);
        }
    }
}

#[test]
fn what_a_forecast_does_not_carry_stays_behind() {
    let Some(gpu) = device() else { return };
    let small = Small::new(4, &settings(12), 5);
    let mut digests = Vec::new();
    for (target, optimizer) in [(true, true), (true, false), (false, true), (false, false)] {
        let mut jobs = small.jobs(3, 16, 1, 2);
        jobs.iter_mut().for_each(|job| job.carry = Carry { target, optimizer });
        let (own, other) = (here(&jobs), there(&gpu, &jobs));
        own.iter().zip(&other).for_each(|(a, b)| assert_same(&gpu, &small.agent, a, b));
        digests.push(own[0].digest());
    }
    digests.dedup();
    assert_eq!(digests.len(), 4);
}

#[test]
fn learners_drift_apart_by_nothing_or_little() {
    let Some(gpu) = device() else { return };
    let small = Small::new(10, &settings(24), 7);
    let jobs = small.jobs(200, 32, 1, 4);
    let (own, other) = (here(&jobs), there(&gpu, &jobs));
    own.iter().zip(&other).for_each(|(a, b)| assert_same(&gpu, &small.agent, a, b));
}

/// What came of a job.
type Outcome = (Arc<Packed>, Result<Vec<f32>, ForecastError>);

/// Hands in jobs of several learners at once.
fn together(gpu: &Gpu, packed: Vec<Packed>) -> Vec<Outcome> {
    let packed: Vec<_> = packed.into_iter().map(Arc::new).collect();
    let tickets = gpu.desk.order(packed.iter().cloned().map(Work::Td3).collect());
    while !tickets.iter().all(|ticket| ticket.is_ready()) {
        gpu.wait(Duration::from_millis(10));
    }
    packed.into_iter().zip(&tickets).map(|(packed, ticket)| (packed, ticket.take().unwrap())).collect()
}

#[test]
fn learners_of_different_sizes_train_side_by_side() {
    let Some(gpu) = device() else { return };
    let sizes = [(3, 5, 2, 7, 8), (10, 40, 1, 4, 33), (6, 66, 3, 6, 16)];
    let learners = sizes.map(|(width, hidden, policy_delay, updates, batch)| {
        (Small::new(width, &Td3Config { policy_delay, ..settings(hidden) }, 1), updates, batch)
    });
    let jobs = learners.each_ref().map(|(small, updates, batch)| small.jobs(*updates, *batch, 1, 3));
    let results = together(&gpu, jobs.iter().flat_map(|jobs| pack(jobs)).collect());
    for ((jobs, (small, ..)), results) in jobs.iter().zip(&learners).zip(results.chunks(2)) {
        for (own, (packed, values)) in here(jobs).iter().zip(results) {
            let other = small.agent.for_forecast(Carry::ALL).finished(packed, values.as_ref().unwrap());
            assert_same(&gpu, &small.agent, own, &other);
        }
    }
}

#[test]
fn a_loss_that_is_no_number_is_told_with_its_update() {
    let Some(gpu) = device() else { return };
    let mut small = Small::new(3, &settings(5), 1);
    small.surprise[0].reward = f32::INFINITY;
    let jobs = small.jobs(4, 8, 1, 3);
    let failure = Err(ForecastError::NotFinite { update: 1 });
    assert_eq!(finish(&mut CpuForecaster::default(), &jobs).map(drop), failure);
    assert_eq!(finish(&mut GpuForecaster::new(gpu.desk.clone(), Arc::default()), &jobs).map(drop), failure);
    // Its neighbours do not notice. A reward in the buffer is seen when it is drawn.
    let results = together(&gpu, pack(&jobs));
    assert_eq!(results[0].1, Err(ForecastError::NotFinite { update: 1 }));
    assert!(results[1].1.is_ok());
    let transition = Transition { reward: f32::MAX, ..small.replay.get(0) };
    small.replay.push(&transition);
    let jobs = &small.jobs(60, 8, 0, 3)[..1];
    let failure = finish(&mut CpuForecaster::default(), jobs).map(drop).unwrap_err();
    assert!(matches!(failure, ForecastError::NotFinite { update: 2.. }), "{failure:?}");
    assert_eq!(together(&gpu, pack(jobs))[0].1, Err(failure));
}

/// Units in the last place of `near` from there to `x`.
fn ulps(x: f32, near: f32) -> u32 {
    x.to_bits().abs_diff(near.to_bits())
}

#[test]
fn the_tangent_is_nearly_that_of_the_processor() {
    let Some(gpu) = device() else { return };
    let device = Device::open(None).unwrap();
    let source = format!(
        "{SOURCE}\n@compute @workgroup_size(1) fn tangents(@builtin(workgroup_id) group: vec3<u32>) {{\n\
         memory[group.x] = tangent(memory[group.x]);\n}}\n"
    );
    let layouts = [
        device.layout("tangents", &[Binding::Read, Binding::Read, Binding::Write, Binding::Write]),
        device.layout("no numbers", &[Binding::Record, Binding::Record]),
    ];
    let [pipeline] = device.pipelines("tangents", &source, ["tangents"], &layouts.each_ref());
    let mut points: Vec<f32> = (-6_000..=6_000).map(|i| i as f32 * 0.002).collect();
    points.extend((0..30).flat_map(|i| [1.0, -1.3].map(|x: f32| x / (1u32 << i) as f32)));
    points.extend([1e-30, 100.0, -1e30, f32::INFINITY, f32::NEG_INFINITY]);
    let memory = device.buffer("points", 0, bytemuck::cast_slice(&points));
    // One job, unused: bindings have at least the size of what they hold.
    let jobs = device.buffer("no jobs", size_of::<Job>() as u64, &[]);
    let (data, failures) = (device.buffer("no data", 4, &[]), device.buffer("no failures", 4, &[]));
    let none = device.records("nothing", [Operation::default()]);
    let buffers = device.bind("tangents", &layouts[0], &[&jobs, &data, &memory, &failures]);
    let numbers = device.bind_records("nothing", &layouts[1], &[&none, &none]);
    let mut commands = device.commands("tangents");
    {
        let mut pass = commands.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &buffers, &[]);
        pass.set_bind_group(1, &numbers, &[0, 0]);
        pass.dispatch_workgroups(points.len() as u32, 1, 1);
    }
    device.run(commands).unwrap();
    let bytes = device.read(&memory, &[(0, 4 * points.len() as u64)]).unwrap();
    let values: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
    let most = points.iter().zip(&values).map(|(x, y)| ulps(*y, squashed(*x))).max().unwrap();
    println!("the tangent is off by at most {most} ulp");
    assert!(most <= if gpu.adapter().software { 3 } else { 8 }, "{most} ulp");
}

/// The processor's tangent: an actor of a single number, with an action from -1 to 1.
fn squashed(x: f32) -> f32 {
    const UNIT: ActionSpec = ActionSpec::Continuous { names: &["a"], low: -1.0, high: 1.0 };
    let spec = ObservationSpec { width: 1, binary: false };
    let mut agent = Td3::<1>::new(spec, &UNIT, &settings(1), &mut Rng::new(1));
    let parameters = agent.actor_mut().params_mut();
    parameters.fill(0.0);
    *parameters.last_mut().unwrap() = x;
    let (mut rows, mut actions) = (Rows::new(spec), Vec::new());
    rows.push_observation(&[0.0]);
    agent.act(&rows, &mut Scratch::default(), &mut actions);
    actions[0].0[0]
}

#[test]
fn a_run_of_reacher_decides_there_as_here() {
    let Some(gpu) = device() else { return };
    let config: Config = "env=reacher safe_steps=40 full_steps=30 exploration=40 learning_starts=20 batch=16 hidden=8 \
                          forecast=5 threshold=0 rollouts=2 rollout_steps=3 evaluations=1"
        .parse()
        .unwrap();
    let told = |equip: bool| {
        let mut run = Run::new(&config);
        let seat = equip.then(|| gpu.equip(&mut run).expect("TD3 can be had there"));
        let mut events = Vec::new();
        while run.poll(Budget(1_000), &mut |event: &Event| events.push(event.clone())).unwrap() != Status::Done {
            while seat.as_ref().is_some_and(Seat::waits) {
                gpu.wait(Duration::from_millis(10));
            }
        }
        events
    };
    let (own, other) = (told(false), told(true));
    assert!(own.iter().filter(|event| matches!(event, Event::Check(_))).count() > 5);
    let verdicts = |events: &[Event]| {
        let verdict =
            |event: &Event| if let Event::Check(check) = event { Some((check.step, check.verdict)) } else { None };
        events.iter().filter_map(verdict).collect::<Vec<_>>()
    };
    assert_eq!(verdicts(&own), verdicts(&other));
}

#[test]
fn what_the_kernels_do_not_have_is_said() {
    let config = |text: &str| -> Config { format!("env=reacher {text}").parse().unwrap() };
    assert_eq!(supports(&config("")), Ok(()));
    for (text, word) in [("layers=3", "layers = 3"), ("forecast=1000000", "forecast = 1000000")] {
        let why = supports(&config(text)).unwrap_err();
        assert!(why.contains(word), "{why}");
    }
    let Some(gpu) = device() else { return };
    assert_eq!(gpu.supports(&config("")), Ok(()));
    assert!(gpu.equip(&mut Run::new(&config(""))).is_some());
    assert!(gpu.equip(&mut Run::new(&config("layers=3"))).is_none());
}
