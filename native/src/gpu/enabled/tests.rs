//! Kernels without a device; futures of a device against the processor's.

use std::collections::BTreeMap;
use std::task::Poll;
use std::thread;
use std::time::Duration;

use mcvl_core::agent::Agent;
use mcvl_core::agent::ddqn::Ddqn;
use mcvl_core::config::{Config, Preset};
use mcvl_core::env::trap::Trapped;
use mcvl_core::env::{ActionSpec, Discrete, ObservationSpec};
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::forecast::{Carry, ForecastError, ForecastJob, Forecaster};
use mcvl_core::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use mcvl_core::rng::Rng;
use mcvl_core::run::Budget;
use naga::valid::{Capabilities, ValidationFlags, Validator};

use super::*;

/// A device for a test, where there is one. Says so where there is none, or fails where one is required.
fn device() -> Option<Gpu> {
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
fn layouts(source: &str) -> BTreeMap<String, Vec<(String, u32)>> {
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
    for (name, value) in [("SAMPLES", ddqn::SAMPLES), ("THREADS", ddqn::THREADS), ("TILE", ddqn::TILE)] {
        assert!(ddqn::SOURCE.contains(&format!("const {name} = {value}u;")), "{name}");
    }
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

/// Parameters that differ, and the largest distance.
fn distance(a: &Ddqn, b: &Ddqn) -> (usize, u32) {
    let pairs = a.online().params().iter().zip(b.online().params());
    let distances: Vec<u32> = pairs.map(|(a, b)| ulps(*a, *b)).collect();
    (distances.iter().filter(|d| **d > 0).count(), distances.into_iter().max().unwrap_or(0))
}

#[test]
fn futures_of_a_device_are_the_processors() {
    let Some(gpu) = device() else { return };
    let cases = [
        "hidden=128",
        "hidden=24",
        "hidden=5 gamma=0.5 tau=0.1",
        "hidden=140 optimizer=amsgrad gradient_clip=0.01",
        "hidden=16 optimizer=adamw weight_decay=0.01",
    ];
    for settings in cases {
        for updates in [1, 40] {
            let small = Small::new(settings, 3);
            let jobs = small.jobs(updates, 32, 9);
            let own = finish(&mut CpuForecaster::default(), &jobs).unwrap();
            let other = finish(&mut forecaster(&gpu), &jobs).unwrap();
            for (a, b) in own.iter().zip(&other) {
                let (count, most) = distance(a, b);
                println!("{settings}, {updates} updates: {count} parameters differ, by at most {most} ulp");
                assert!(count == 0, "{settings}, {updates} updates: {count} parameters differ, by up to {most} ulp");
            }
            assert_ne!(own[0].digest(), own[1].digest());
        }
    }
}
