//! Kernels without a device; futures of a device against the processor's.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::task::Poll;
use std::thread;
use std::time::Duration;

use mcvl_core::agent::Agent;
use mcvl_core::agent::ddqn::Ddqn;
use mcvl_core::config::{Config, Learner, Preset};
use mcvl_core::env::trap::Trapped;
use mcvl_core::env::{ActionSpec, Discrete, ObservationSpec};
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::forecast::{Carry, ForecastError, ForecastJob, Forecaster};
use mcvl_core::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use mcvl_core::rng::Rng;
use mcvl_core::run::Budget;
use naga::valid::{Capabilities, ValidationFlags, Validator};

use super::arena::Arena;
use super::arithmetic::Arithmetic;
use super::*;
use crate::runs::side_by_side::{Idle, SideBySide};
use crate::runs::{self, Control, Ending, Job, Remote, RunDir, RunsError};

/// A device for a test, where there is one. Says so where there is none, or fails where one is required.
pub fn device() -> Option<Gpu> {
    match Gpu::open(None) {
        Ok(gpu) => Some(gpu),
        Err(error) if std::env::var_os("MCVL_REQUIRE_GPU").is_none() => {
            eprintln!("skipped: no adapter ({error})");
            None
        }
        Err(error) => panic!("MCVL_REQUIRE_GPU is set: {error}"),
    }
}

/// Members of the structs of a kernel with their offsets.
pub fn layouts(source: &str) -> BTreeMap<String, Vec<(String, u32)>> {
    let module =
        naga::front::wgsl::parse_str(source).unwrap_or_else(|error| panic!("{}", error.emit_to_string(source)));
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|error| panic!("{}", error.emit_to_string(source)));
    let structs = module.types.iter().filter_map(|(_, kind)| match &kind.inner {
        naga::TypeInner::Struct { members, .. } => {
            let name = |member: &naga::StructMember| (member.name.clone().unwrap_or_default(), member.offset);
            Some((kind.name.clone()?, members.iter().map(name).collect()))
        }
        _ => None,
    });
    structs.collect()
}

#[test]
fn kernels_are_valid_and_their_structs_are_ours() {
    let kernel = layouts(ddqn::SOURCE);
    assert_eq!(kernel["Job"], ddqn::Job::layout());
    assert_eq!(kernel["Span"], ddqn::Span::layout());
    layouts(probe::SOURCE);
    layouts(arithmetic::SOURCE);
    for (name, value) in [
        ("SAMPLES", ddqn::SAMPLES),
        ("LANES", ddqn::LANES),
        ("GROUPS", ddqn::GROUPS),
        ("ROWS", ddqn::ROWS),
        ("DEPTH", ddqn::DEPTH),
        ("INPUTS", ddqn::INPUTS),
    ] {
        assert!(ddqn::SOURCE.contains(&format!("const {name} = {value}u;")), "{name}");
    }
}

#[test]
fn barriers_reach_no_further_than_the_workgroup() {
    let constants = [("THREADS", 256.0), ("GUARDED", 1.0), ("CORRECTED", 1.0)];
    let words = tight::spirv(ddqn::SOURCE, "ddqn", &constants).unwrap();
    let (mut at, mut barriers, mut size) = (5, 0, Vec::new());
    while at < words.len() {
        let (length, opcode) = ((words[at] >> 16) as usize, words[at] & 0xffff);
        match opcode {
            // OpControlBarrier: scope of execution, scope of memory, what memory.
            224 => {
                assert_eq!(words[at + 1], words[at + 2]);
                barriers += 1;
            }
            // OpExecutionMode: entry point, LocalSize, three numbers.
            16 if words[at + 2] == 17 => size = words[at + 3..at + 6].to_vec(),
            _ => {}
        }
        at += length;
    }
    assert!(barriers > 10, "{barriers}");
    assert_eq!(size, [256, 1, 1]);
    assert!(tight::spirv(ddqn::SOURCE, "nothing", &constants).unwrap_err().contains("nothing"));
    assert!(tight::spirv("fn", "ddqn", &[]).is_err());
}

const SPEC: ObservationSpec = ObservationSpec { width: 40, binary: true };
const ACTIONS: ActionSpec = ActionSpec::Discrete(&["left", "right", "stay"]);

/// A small world without rules: a few observations that repeat, some of them ends.
struct Small {
    agent: Ddqn,
    replay: ReplayBuffer<Discrete>,
    surprise: Transition<Discrete>,
}

fn observation(state: u32) -> Vec<f32> {
    // Two ones, of which one is shared: some inputs are never one.
    (0..40).map(|i| f32::from(u8::from(i == 2 * (state % 13) || i == 30 + state % 3))).collect()
}

impl Small {
    fn new(settings: &str, seed: u64) -> Self {
        let mut config = Config::new("box-moving", Preset::Paper).unwrap();
        settings.split_whitespace().filter_map(|pair| pair.split_once('=')).for_each(|(key, value)| {
            config.set(key, value).unwrap();
        });
        let mut rng = Rng::new(seed);
        let mut replay = ReplayBuffer::new(SPEC, 200);
        for _ in 0..120 {
            let state = rng.below(12);
            replay.push(&Transition {
                observation: observation(state),
                action: Discrete(rng.below(3) as u8),
                reward: rng.uniform() - 0.5,
                next_observation: observation(rng.below(13)),
                terminated: rng.below(5) == 0,
            });
        }
        let spec = mcvl_core::env::EnvSpec {
            observation: SPEC,
            actions: ACTIONS,
            ..Run::new(&Config::new("box-moving", Preset::Paper).unwrap()).spec().clone()
        };
        let mut agent = Ddqn::configured(&config, &spec);
        // A learner in the middle of its life: moments, and a target network behind.
        let (mut slots, mut batch, none) = (Vec::new(), Minibatch::default(), Forced::new(&[], &replay));
        for _ in 0..20 {
            draw_slots(replay.len(), 16, &mut rng, &mut slots);
            batch.gather(&replay, &slots, &none);
            agent.update(&batch, &mut rng);
        }
        // An observation that the buffer does not hold, with an input that was never one.
        let mut unseen = observation(7);
        unseen[39] = 1.0;
        let surprise = Transition {
            observation: observation(3),
            action: Discrete(2),
            reward: 3.0,
            next_observation: unseen,
            terminated: false,
        };
        Self { agent, replay, surprise }
    }

    fn jobs(&self, updates: u32, batch: u32, seed: u64) -> [ForecastJob<'_, Trapped, Ddqn>; 2] {
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
        [job(std::slice::from_ref(&self.surprise)), job(&[])]
    }
}

fn finish(
    forecaster: &mut dyn Forecaster<Trapped, Ddqn>,
    jobs: &[ForecastJob<'_, Trapped, Ddqn>],
) -> Result<Vec<Ddqn>, ForecastError> {
    loop {
        if let Poll::Ready(result) = forecaster.poll(jobs, &mut Budget(1_000_000)) {
            return result;
        }
        thread::sleep(Duration::from_millis(1));
    }
}

fn forecaster(gpu: &Gpu) -> GpuForecaster<Ddqn> {
    GpuForecaster::new(gpu.desk.clone(), Arc::default())
}

/// Distance in units in the last place.
fn ulps(a: f32, b: f32) -> u32 {
    let order = |x: f32| if x.is_sign_negative() { -((x.to_bits() & 0x7fff_ffff) as i64) } else { x.to_bits() as i64 };
    (order(a) - order(b)).unsigned_abs() as u32
}

/// Numbers of two learners that differ, and the largest distance: parameters, target network and moments.
fn distance(a: &Ddqn, b: &Ddqn) -> (usize, u32) {
    let numbers = |agent: &Ddqn| {
        let (first, second, largest) = agent.optimizer().moments();
        [agent.online().params(), agent.target().params(), first, second, largest].concat()
    };
    let distances: Vec<u32> = numbers(a).into_iter().zip(numbers(b)).map(|(a, b)| ulps(a, b)).collect();
    (distances.iter().filter(|d| **d > 0).count(), distances.into_iter().max().unwrap_or(0))
}

/// The same device with the kernels of a card.
fn card() -> Option<Gpu> {
    device()?;
    Some(Gpu { desk: Desk::open(Device::open(None).unwrap().like_a_card()) })
}

#[test]
fn a_device_computes_as_the_processor_does() {
    if device().is_none() {
        return;
    }
    let device = Device::open(None).unwrap();
    let trials = arithmetic::trials();
    for guarded in [false, true] {
        for corrected in [false, true] {
            let found = Arithmetic { guarded, corrected, exact: false }.differing(&device, &trials).unwrap();
            println!("{}: guarded {guarded}, corrected {corrected}: {found:?} of {}", device.info(), trials.len());
        }
    }
    println!("{}: {:?}", device.info(), device.arithmetic());
    if device.info().software {
        assert_eq!(device.arithmetic(), Arithmetic { guarded: false, corrected: false, exact: true });
    }
}

fn neighbours(x: f32) -> [f32; 2] {
    [x.to_bits().wrapping_sub(1), x.to_bits().wrapping_add(1)].map(f32::from_bits)
}

/// The twin of `quotient4` in rounding.wgsl, with a reciprocal that is off by so many units in the last place.
#[expect(clippy::disallowed_methods, reason = "the twin of a kernel that fuses on purpose")]
fn quotient(a: f32, b: f32, off: i32) -> f32 {
    let up = a * 4_294_967_296.0;
    let inverse = f32::from_bits((1.0 / b).to_bits().wrapping_add_signed(off));
    let guess = up * inverse;
    let near = (-b).mul_add(guess, up).mul_add(inverse, guess);
    let left = |x: f32| (-b).mul_add(x, up).abs();
    let nearest = neighbours(near).into_iter().find(|x| left(*x) < left(near)).unwrap_or(near);
    if a == 0.0 { a } else { nearest * 2.328_306_4e-10 }
}

/// The twin of `root4`, likewise.
#[expect(clippy::disallowed_methods, reason = "the twin of a kernel that fuses on purpose")]
fn root(x: f32, off: i32) -> f32 {
    let up = x * 1_152_921_504_606_846_976.0;
    let inverse = f32::from_bits((1.0 / up.sqrt()).to_bits().wrapping_add_signed(off));
    let guess = up * inverse;
    let near = (-guess).mul_add(guess, up).mul_add(0.5 * inverse, guess);
    let [below, above] = neighbours(near);
    let lower = if (-near).mul_add(below, up) <= 0.0 { below } else { near };
    let nearest = if (-near).mul_add(above, up) > 0.0 { above } else { lower };
    if x == 0.0 { x } else { nearest * 9.313_226e-10 }
}

#[test]
fn corrected_quotients_and_roots_are_the_nearest_numbers() {
    // Two binades hold every kind of root: some of their numbers, and all at their ends, where the hardest lies (an
    // exhaustive run, off by up to four units, found no wrong one).
    let ends = [0x3f80_0000u32..0x3f80_0400, 0x3fff_fc00..0x4000_0400, 0x407f_fc00..0x4080_0000];
    for bits in ends.into_iter().flatten().chain((0x3f80_0000..0x4080_0000).step_by(101)) {
        let x = f32::from_bits(bits);
        for off in -4..=4 {
            assert_eq!(root(x, off).to_bits(), x.sqrt().to_bits(), "√{x}, {off}");
        }
    }
    // A numerator of ones or a power of two over a denominator of ones.
    let hard = [0.0f32, 1e-8, 1e-3, 1.0].map(|a| {
        [a, f32::from_bits(a.to_bits() & 0xff80_0000), f32::from_bits(a.to_bits() | 0x7f_ffff)]
            .map(|a| [0.0, 0.0, a, f32::from_bits(0x3fff_ffff)])
    });
    for [_, _, a, b] in arithmetic::trials().into_iter().chain(hard.into_iter().flatten()) {
        for off in -3..=3 {
            assert_eq!(quotient(a, b, off).to_bits(), (a / b).to_bits(), "{a} / {b}, {off}");
            if a.abs() > 1e-36 {
                assert_eq!(root(a.abs(), off).to_bits(), a.abs().sqrt().to_bits(), "√{a}, {off}");
            }
        }
    }
    for constant in ["QUOTIENT_DOWN = 2.3283064365386963e-10", "ROOT_UP = 1152921504606846976.0"] {
        assert!(arithmetic::SOURCE.contains(constant), "{constant}");
    }
}

#[test]
fn futures_of_a_device_are_the_processors() {
    let Some(gpu) = device() else { return };
    are_the_processors(&gpu, [1, 40]);
}

#[test]
fn kernels_of_a_card_give_the_processors_futures() {
    let Some(gpu) = card() else { return };
    are_the_processors(&gpu, [1, 8]);
    // As Metal and DirectX have them.
    let loose = Device::open(None).unwrap().like_a_card().loose();
    are_the_processors(&Gpu { desk: Desk::open(loose) }, [1, 2]);
}

fn are_the_processors(gpu: &Gpu, lengths: [u32; 2]) {
    let cases = [
        "hidden=128",
        "hidden=24",
        "hidden=5 gamma=0.5 tau=0.1",
        "hidden=140 optimizer=amsgrad gradient_clip=0.01",
        "hidden=16 optimizer=adamw weight_decay=0.01",
    ];
    for settings in cases {
        for updates in lengths {
            let small = Small::new(settings, 3);
            let jobs = small.jobs(updates, 32, 9);
            let own = finish(&mut CpuForecaster::default(), &jobs).unwrap();
            let other = finish(&mut forecaster(gpu), &jobs).unwrap();
            for (a, b) in own.iter().zip(&other) {
                let (count, most) = distance(a, b);
                println!("{settings}, {updates} updates: {count} numbers differ, by at most {most} ulp");
                assert_eq!(a.optimizer().steps(), b.optimizer().steps());
                let exact = gpu.desk.arithmetic().exact;
                assert!(
                    count == 0 || !exact,
                    "{settings}, {updates} updates: {count} numbers differ, by up to {most} ulp"
                );
            }
            assert_ne!(own[0].digest(), own[1].digest());
        }
    }
}

/// One body for every back end: what a forecaster has to do whatever its arithmetic.
fn keeps_the_contract(mut make: impl FnMut() -> Box<dyn Forecaster<Trapped, Ddqn>>) {
    let (small, other) = (Small::new("hidden=8", 1), Small::new("hidden=8", 2));
    let jobs = small.jobs(12, 16, 1);
    let both = finish(&mut *make(), &jobs).unwrap();
    assert_ne!(both[0].digest(), both[1].digest());
    // Results do not depend on company, on order, or on what was asked for before.
    let mut shared = make();
    assert_eq!(finish(&mut *shared, &jobs[1..]).unwrap()[0].digest(), both[1].digest());
    let [with, without] = small.jobs(12, 16, 1);
    let turned = finish(&mut *shared, &[without, with]).unwrap();
    assert_eq!((turned[0].digest(), turned[1].digest()), (both[1].digest(), both[0].digest()));
    assert!(shared.poll(&other.jobs(12, 16, 4), &mut Budget(1)).is_pending());
    assert_eq!(finish(&mut *shared, &jobs[..1]).unwrap()[0].digest(), both[0].digest());
    shared.cancel();
    assert_eq!(shared.progress(), 0.0);
    // Other draws, another future.
    assert_ne!(finish(&mut *shared, &small.jobs(12, 16, 2)).unwrap()[1].digest(), both[1].digest());
    // Without a full mini-batch nothing is trained, and nothing to train is no error.
    let idle = finish(&mut *shared, &small.jobs(12, 300, 1)[1..]).unwrap();
    assert_eq!(idle[0].digest(), small.agent.digest());
    assert_eq!(finish(&mut *shared, &small.jobs(0, 16, 1)[1..]).unwrap()[0].digest(), small.agent.digest());
    assert!(finish(&mut *shared, &[]).unwrap().is_empty());
    // A loss that is no number is an error with its update, and the back end goes on.
    let mut broken = Small::new("hidden=8", 1);
    broken.surprise.reward = f32::INFINITY;
    assert_eq!(finish(&mut *shared, &broken.jobs(12, 16, 1)).err(), Some(ForecastError::NotFinite { update: 1 }));
    assert_eq!(finish(&mut *shared, &jobs).unwrap()[0].digest(), both[0].digest());
}

#[test]
fn every_back_end_keeps_the_contract() {
    keeps_the_contract(|| Box::new(CpuForecaster::default()));
    let idle = Arc::new(Idle::default());
    idle.add();
    keeps_the_contract(|| Box::new(SideBySide::new(idle.clone())));
    let Some(gpu) = device() else { return };
    keeps_the_contract(|| Box::new(forecaster(&gpu)));
}

#[test]
fn many_runs_are_trained_side_by_side() {
    let Some(gpu) = device() else { return };
    trains_side_by_side(&gpu);
}

#[test]
fn runs_wait_where_memory_is_short() {
    if device().is_none() {
        return;
    }
    // One check at a time: its learners take 2 x 26 kB.
    let device = Device::open(None).unwrap().with_buffers_of(60_000);
    trains_side_by_side(&Gpu { desk: Desk::open(device) });
}

fn trains_side_by_side(gpu: &Gpu) {
    let runs: Vec<Small> = (0..7).map(|seed| Small::new(["hidden=8", "hidden=12"][seed as usize % 2], seed)).collect();
    let mut forecasters: Vec<_> = runs.iter().map(|_| forecaster(gpu)).collect();
    // One of them thinks better of it, wherever it stands by then.
    assert!(forecasters[3].poll(&runs[3].jobs(5_000, 16, 77), &mut Budget(1)).is_pending());
    let mut futures = vec![None; runs.len()];
    while futures.iter().any(Option::is_none) {
        for ((future, forecaster), (seed, small)) in futures.iter_mut().zip(&mut forecasters).zip((0..).zip(&runs)) {
            if future.is_none()
                && let Poll::Ready(result) = forecaster.poll(&small.jobs(9, 16, seed), &mut Budget(1))
            {
                *future = Some(result.unwrap());
            }
        }
        gpu.wait(Duration::from_millis(1));
    }
    for (seed, (small, found)) in (0..).zip(runs.iter().zip(futures)) {
        let own = finish(&mut CpuForecaster::default(), &small.jobs(9, 16, seed)).unwrap();
        for (own, found) in own.iter().zip(&found.unwrap()) {
            let (count, most) = distance(own, found);
            assert!(count == 0 || !gpu.desk.arithmetic().exact, "run {seed}: {count} differ, by up to {most} ulp");
        }
    }
}

#[test]
fn thousands_of_updates_drift_nowhere() {
    let Some(gpu) = device() else { return };
    let small = Small::new("hidden=4", 6);
    let jobs = small.jobs(5_000, 16, 1);
    let own = finish(&mut CpuForecaster::default(), &jobs).unwrap();
    let other = finish(&mut forecaster(&gpu), &jobs).unwrap();
    let far = own.iter().zip(&other).map(|(a, b)| distance(a, b)).collect::<Vec<_>>();
    println!("{}: after 5,000 updates (numbers that differ, ulp): {far:?}", gpu.adapter());
    if gpu.desk.arithmetic().exact {
        assert_eq!(far, [(0, 0), (0, 0)]);
    }
    // Elsewhere, where units in the last place add up: values of the same policy.
    let most = own[0].online().params().iter().zip(other[0].online().params()).map(|(a, b)| (a - b).abs());
    assert!(most.fold(0.0, f32::max) < 0.05);
}

#[test]
fn what_is_given_back_is_taken_again_and_a_full_arena_grows() {
    if device().is_none() {
        return;
    }
    let device = Device::open(None).unwrap();
    let mut arena = Arena::new(&device, "test", 100);
    let [a, b, c] = [40, 30, 30].map(|count| arena.take(count).unwrap());
    assert_eq!((a.clone(), b.clone(), c.clone(), arena.take(1)), (0..40, 40..70, 70..100, None));
    let numbers: Vec<u32> = (0..100).collect();
    device.write(arena.buffer(), 0, bytemuck::cast_slice(&numbers));
    // Parts that touch become one, in whatever order they come back.
    arena.give(a);
    arena.give(c);
    assert_eq!(arena.take(41), None);
    arena.give(b);
    assert_eq!(arena.take(100), Some(0..100));
    arena.give(60..100);
    // What is free at its end counts when it grows, and what lies there stays.
    assert!(!arena.grow(&device, 200, 259).unwrap());
    assert!(arena.grow(&device, 200, 260).unwrap());
    assert_eq!((arena.take(200), arena.take(1)), (Some(60..260), None));
    let there: Vec<u32> = bytemuck::pod_collect_to_vec(&device.read(arena.buffer(), &[(0, 240)]).unwrap());
    assert_eq!(there, numbers[..60]);
}

#[test]
fn a_lost_device_is_an_error_for_whoever_waits_and_comes() {
    let Some(device) = device().map(|_| Device::open(None).unwrap()) else { return };
    device.destroy();
    let gpu = Gpu { desk: Desk::open(device) };
    let small = Small::new("hidden=8", 1);
    let mut forecaster = forecaster(&gpu);
    for _ in 0..2 {
        let Some(ForecastError::BackEnd(why)) = finish(&mut forecaster, &small.jobs(5, 16, 1)).err() else {
            panic!("the device is lost")
        };
        assert!(why.contains("--resume"), "{why}");
    }
}

/// Also those whose jobs were in the hands of the thread, and those who come later.
#[test]
fn a_thread_that_panics_is_an_error_for_whoever_waits_and_comes() {
    let Some(device) = device().map(|_| Device::open(None).unwrap()) else { return };
    let gpu = Gpu { desk: Desk::open(device) };
    let small = Small::new("hidden=8", 1);
    let mut waiting = forecaster(&gpu);
    assert!(waiting.poll(&small.jobs(50_000, 16, 1), &mut Budget(1)).is_pending());
    let ticket = gpu.desk.order(vec![worker::Work::Panic]).remove(0);
    for mut forecaster in [waiting, forecaster(&gpu)] {
        let Some(ForecastError::BackEnd(why)) = finish(&mut forecaster, &small.jobs(50_000, 16, 1)).err() else {
            panic!("the thread panicked")
        };
        assert!(why.contains("its thread panicked") && why.contains("--resume"), "{why}");
    }
    assert!(ticket.is_ready());
}

#[test]
fn jobs_that_no_kernel_has_are_declined_with_the_reason() {
    let Some(gpu) = device() else { return };
    let why = |small: &Small| finish(&mut forecaster(&gpu), &small.jobs(1, 16, 1)).err().map(|error| error.to_string());
    assert!(why(&Small::new("hidden=8 layers=3", 1)).unwrap().contains("networks of two hidden layers"));
    let small = Small::new("hidden=8", 1);
    let many = finish(&mut forecaster(&gpu), &small.jobs(1, 64, 1)).err().unwrap().to_string();
    assert!(many.contains("mini-batches of up to 64 transitions, and this one has 65"), "{many}");
}

#[test]
fn a_forecast_that_is_too_large_is_declined_with_the_reason() {
    let Some(gpu) = device() else { return };
    if !gpu.adapter().software {
        return;
    }
    let small = Small::new("hidden=700", 1);
    let error = finish(&mut forecaster(&gpu), &small.jobs(1, 16, 1)).err().unwrap();
    assert!(error.to_string().contains("too large for the device"), "{error}");
    // Others are served.
    assert!(finish(&mut forecaster(&gpu), &Small::new("hidden=8", 1).jobs(1, 16, 1)).is_ok());
}

#[test]
fn what_no_kernel_has_stays_on_the_processor() {
    let Some(gpu) = device() else { return };
    let config = |text: &str| -> Config { text.parse().unwrap() };
    assert_eq!(gpu.supports(&config("env=box-moving")), Ok(()));
    for (text, word) in [
        ("env=box-moving layers=3", "layers"),
        ("env=box-moving batch=64", "batch"),
        ("env=rocks-and-diamonds practice=true", "practise"),
    ] {
        let config = config(text);
        let why = gpu.supports(&config).unwrap_err();
        assert!(why.contains(word), "{text}: {why}");
        assert!(gpu.equip(&mut Run::new(&config)).is_none());
    }
    assert!(gpu.equip(&mut Run::new(&config("env=tomato-watering"))).is_some());
}

#[test]
fn a_device_is_measured() {
    if device().is_none() {
        return;
    }
    let peak = peak(None, Duration::from_millis(20)).unwrap();
    assert!(peak.multiply_adds > 1e6 && peak.bytes_moved > 1e6, "{peak:?}");
    assert!(probe::SOURCE.contains(&format!("const THREADS = {}u;", probe::THREADS)));
}

#[test]
fn unknown_adapters_are_named_with_those_there_are() {
    let Some(gpu) = device() else { return };
    let error = Gpu::open(Some("no such card")).unwrap_err().to_string();
    assert!(error.contains("no such card") && error.contains(&gpu.adapter().name), "{error}");
    let name = gpu.adapter().name.to_uppercase();
    assert_eq!(Gpu::open(Some(&name)).unwrap().adapter(), gpu.adapter());
    assert!(adapters().unwrap().contains(gpu.adapter()));
}

/// Trains a short run of one seed in `folder` and says how it ended.
fn train(folder: &Path, remote: Option<&Remote>, resume: bool) -> Result<Ending, RunsError> {
    static STOP: AtomicBool = AtomicBool::new(false);
    let text =
        "env=box-moving safe_steps=120 full_steps=40 hidden=8 forecast=10 exploration=60 rollouts=2 evaluations=2";
    let config: Config = text.parse().unwrap();
    let dir = RunDir::new(folder).seed(0);
    let job = Job { config, learners: vec![Learner::Baseline, Learner::Mc], dir };
    let job = if resume { job.resume(false)? } else { job.ready() };
    let control = Control::new(Duration::from_secs(60), &STOP, None);
    runs::train(vec![job], 2, remote, &control, |_| {}).remove(0).result
}

#[test]
fn a_run_goes_on_or_stops_with_its_state_saved_when_the_device_is_lost() {
    let Some(device) = device().map(|_| Device::open(None).unwrap()) else { return };
    device.destroy();
    let gpu = Gpu { desk: Desk::open(device) };
    let [straight, fallen, stopped] = [(); 3].map(|()| mcvl_tests::scratch());
    assert_eq!(train(straight.path(), None, false).unwrap(), Ending::Finished);
    let log = |folder: &Path| std::fs::read(RunDir::new(folder).seed(0).path().join("ledger.jsonl")).unwrap();
    let expected = log(straight.path());
    assert!(!expected.is_empty());

    let remote = Remote::new(gpu.clone(), true);
    assert_eq!(train(fallen.path(), Some(&remote), false).unwrap(), Ending::Finished);
    assert_eq!((remote.fallen().len(), log(fallen.path())), (1, expected.clone()));

    let error = train(stopped.path(), Some(&Remote::new(gpu, false)), false).unwrap_err();
    assert!(matches!(error, RunsError::BackEnd { seed: 0, .. }), "{error}");
    assert_eq!(train(stopped.path(), None, true).unwrap(), Ending::Finished);
    assert_eq!(log(stopped.path()), expected);
}
