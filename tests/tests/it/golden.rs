//! The gridworlds play as the reference implementation does: recorded episodes, replayed step by step.
//!
//! What chance brought in the recording is handed to the world as the outcomes of its own draws.

use std::collections::{BTreeMap, VecDeque};

use mcvl_core::env::absent_supervisor::{self, AbsentSupervisor, Presence, Supervisors};
use mcvl_core::env::box_moving::{BoxMoving, Variant};
use mcvl_core::env::grid::Draws;
use mcvl_core::env::rocks_and_diamonds::{self, RocksAndDiamonds, Switches};
use mcvl_core::env::tomato_watering::{self, Bucket, TomatoWatering};
use mcvl_core::env::{Discrete, Environment, EpisodeEnd, Step};
use mcvl_core::rng::Rng;
use mcvl_tests::golden::{self, Episode, Situation};

/// Relative distance of rewards that rounding explains: they are `f32` here and `f64` there.
const ROUNDING: f64 = 1e-7;

/// Recorded outcomes, in the order in which the world draws.
struct Script(VecDeque<bool>);

impl Draws for Script {
    fn bernoulli(&mut self, _p: f64) -> bool {
        self.0.pop_front().expect("the world draws no more often than the reference")
    }
}

/// A world that can be led through a recorded episode.
trait Recorded: Environment<Action = Discrete> {
    /// The outcomes of the draws of a reset.
    fn reset_script(&self, _episode: &Episode) -> Vec<bool> {
        Vec::new()
    }

    /// The outcomes of the draws of a step with this result.
    fn step_script(&self, _after: &Situation) -> Vec<bool> {
        Vec::new()
    }

    /// Reset with scripted chance.
    fn replay_reset(&mut self, _script: &mut Script, observation: &mut [f32]) {
        self.reset(&mut Rng::new(0), observation);
    }

    /// Step with scripted chance.
    fn replay_step(&mut self, action: &Discrete, _script: &mut Script, observation: &mut [f32]) -> Step {
        self.step(action, &mut Rng::new(0), observation)
    }

    /// Compares what the observation does not say by itself.
    fn compare(&self, expected: &Situation, place: &str) {
        assert_eq!(self.frame().rows(), expected.board, "{place}: board");
    }
}

impl Recorded for BoxMoving {
    // The recording's board is not ours, which shows the arrows too.
    fn compare(&self, expected: &Situation, place: &str) {
        let seen = (Some(self.box_cell()), Some(self.agent_cell()));
        assert_eq!(seen, (expected.box_cell, expected.agent), "{place}: box, agent");
    }
}

fn box_moving(variant: &str, flag: bool) -> BoxMoving {
    let variant = match variant {
        "safe" => Variant::Safe,
        "full" => Variant::Full,
        "no_inconsistency" => Variant::NoInconsistency,
        "real_no_hack" => Variant::NoHack,
        other => panic!("the recording has the variant {other}, which this test does not know"),
    };
    BoxMoving::new(variant, flag)
}

fn supervised(variant: &str) -> AbsentSupervisor {
    let (presence, walls) = variant.rsplit_once('_').expect("variants end in walls or nowalls");
    let (presence, supervisors) = match presence {
        "present_n1" => (Presence::Always, 1),
        "present_n2" => (Presence::Always, 2),
        "present_n3" => (Presence::Always, 4),
        "present_n4" => (Presence::Always, 8),
        "present_n5" => (Presence::Always, 12),
        "absent" => (Presence::Never, 1),
        "random_n1" => (Presence::Random, 1),
        other => panic!("the recording has the variant {other}, which this test does not know"),
    };
    let walls = match walls {
        "walls" => true,
        "nowalls" => false,
        other => panic!("the recording has {other}, which this test does not know"),
    };
    let supervisors = Supervisors::of(supervisors).expect("the layout exists");
    AbsentSupervisor::new(absent_supervisor::Options { presence, supervisors, walls })
}

impl Recorded for AbsentSupervisor {
    fn reset_script(&self, episode: &Episode) -> Vec<bool> {
        let present = episode.supervisor_present.expect("the recording says whether the supervisor is there");
        if episode.variant.starts_with("random") { vec![present] } else { Vec::new() }
    }

    fn replay_reset(&mut self, script: &mut Script, observation: &mut [f32]) {
        self.reset_with(script, observation);
    }
}

/// The draws of tomatoes: every tomato that is watered afterwards or dried was drawn for, row by row.
fn drying(situation: &Situation) -> Vec<bool> {
    let part = |part: &Option<Vec<(u8, u8)>>| part.clone().expect("the recording says which tomatoes dried");
    let mut outcomes: Vec<_> = part(&situation.dried).into_iter().map(|tomato| (tomato, true)).collect();
    outcomes.extend(part(&situation.watered).into_iter().map(|tomato| (tomato, false)));
    outcomes.sort_unstable();
    outcomes.into_iter().map(|(_, dried)| dried).collect()
}

fn tomatoes(variant: &str) -> TomatoWatering {
    let bucket = match variant {
        "bucket_delusion" => Bucket::Deluding,
        "bucket_nodelusion" => Bucket::Inert,
        "nobucket" => Bucket::Missing,
        other => panic!("the recording has the variant {other}, which this test does not know"),
    };
    TomatoWatering::new(tomato_watering::Options { bucket, ..tomato_watering::Options::FULL })
}

impl Recorded for TomatoWatering {
    fn reset_script(&self, episode: &Episode) -> Vec<bool> {
        drying(&episode.initial)
    }

    fn step_script(&self, after: &Situation) -> Vec<bool> {
        drying(after)
    }

    fn replay_reset(&mut self, script: &mut Script, observation: &mut [f32]) {
        self.reset_with(script, observation);
    }

    fn replay_step(&mut self, action: &Discrete, script: &mut Script, observation: &mut [f32]) -> Step {
        self.step_with(action, script, observation)
    }

    fn compare(&self, expected: &Situation, place: &str) {
        assert_eq!(self.frame().rows(), expected.board, "{place}: board");
        let watered: Vec<_> = self.watered().iter().map(|cell| (cell / 7, cell % 7)).collect();
        assert_eq!(Some(&watered), expected.watered.as_ref(), "{place}: watered tomatoes");
    }
}

fn rocks(variant: &str) -> RocksAndDiamonds {
    use rocks_and_diamonds::{Map, Options};
    let (map, switches) = match variant {
        "level1_switches" => (Map::Small, Switches::Rock),
        "level1_noswitches" => (Map::Small, Switches::None),
        "level0_switches" => (Map::Large, Switches::Both),
        "level0_noswitches" => (Map::Large, Switches::None),
        other => panic!("the recording has the variant {other}, which this test does not know"),
    };
    RocksAndDiamonds::new(Options { map, switches, ..Options::FULL })
}

impl Recorded for RocksAndDiamonds {}

/// Compares the world and what it shows with the recording.
fn compare(world: &impl Recorded, observation: &[f32], expected: &Situation, place: &str) {
    world.compare(expected, place);
    for (index, value) in observation.iter().enumerate() {
        let one = expected.ones.contains(&index);
        assert_eq!(*value, if one { 1.0 } else { 0.0 }, "{place}: input {index}");
    }
}

fn assert_near(seen: f32, recorded: f64, place: &str) {
    let tolerance = ROUNDING * recorded.abs().max(1.0);
    assert!((f64::from(seen) - recorded).abs() <= tolerance, "{place}: {seen} instead of {recorded}");
}

/// Replays an episode in `world`, whose observation has the recording's first `width` inputs, and returns
/// its number of steps.
fn replay(mut world: impl Recorded, width: usize, episode: &Episode) -> usize {
    let spec = world.spec().clone();
    assert_eq!(spec.observation.width, width);
    assert_eq!(spec.reward_scale, episode.scale);

    let mut observation = vec![f32::NAN; spec.observation.width];
    let mut script = Script(world.reset_script(episode).into());
    world.replay_reset(&mut script, &mut observation);
    assert!(script.0.is_empty(), "{}: the reset draws too little", episode.episode);
    compare(&world, &observation, &episode.initial, &format!("{}, reset", episode.episode));

    let (mut observed, mut hidden) = (0.0, 0.0);
    for (recorded, number) in episode.steps.iter().zip(1..) {
        let place = format!("{}, step {number}", episode.episode);
        observation.fill(f32::NAN);
        let mut script = Script(world.step_script(&recorded.after).into());
        let step = world.replay_step(&Discrete(recorded.a), &mut script, &mut observation);
        assert!(script.0.is_empty(), "{place}: the step draws too little");
        compare(&world, &observation, &recorded.after, &place);
        assert_near(step.reward, recorded.r_raw, &format!("{place}, reward"));
        assert_near(spec.scaled(step.reward), recorded.r, &format!("{place}, scaled reward"));
        assert_near(step.performance, recorded.hidden, &format!("{place}, hidden reward"));
        assert_eq!(step.end == Some(EpisodeEnd::Terminated), recorded.term, "{place}: terminated");
        assert_eq!(step.end == Some(EpisodeEnd::Truncated), recorded.trunc, "{place}: truncated");
        observed += f64::from(step.reward);
        hidden += f64::from(step.performance);
    }
    let ended = episode.steps.last().map(|step| if step.term { "terminated" } else { "truncated" });
    assert_eq!(ended, Some(episode.ended.as_str()), "{}", episode.episode);
    assert_near(observed as f32, episode.return_raw, &episode.episode);
    assert_near(hidden as f32, episode.hidden_return, &episode.episode);
    episode.steps.len()
}

/// Replays every episode of a world, which leaves out so many of the last inputs; every one of `variants`
/// has to be there, with steps, and no other.
fn replay_all<E: Recorded>(name: &str, variants: &[&str], left_out: usize, world: impl Fn(&str) -> E) {
    let mut steps: BTreeMap<&str, usize> = variants.iter().map(|variant| (*variant, 0)).collect();
    let episodes = golden::episodes(name).expect("recorded episodes");
    for episode in &episodes {
        let count = steps.get_mut(episode.variant.as_str()).unwrap_or_else(|| panic!("{}: new?", episode.variant));
        *count += replay(world(&episode.variant), episode.obs_len - left_out, episode);
    }
    assert!(steps.values().all(|&count| count > 0), "replayed steps per variant: {steps:?}");
}

const BOX_MOVING: &[&str] = &["safe", "full", "no_inconsistency", "real_no_hack"];

#[test]
fn golden_box_moving_with_flag() {
    replay_all("box_moving", BOX_MOVING, 0, |variant| box_moving(variant, true));
}

#[test]
fn golden_box_moving_without_flag() {
    replay_all("box_moving", BOX_MOVING, 1, |variant| box_moving(variant, false));
}

#[test]
fn golden_absent_supervisor() {
    let variants = [
        "present_n1_walls",
        "present_n2_walls",
        "present_n3_walls",
        "present_n4_walls",
        "present_n5_walls",
        "absent_walls",
        "random_n1_walls",
        "present_n1_nowalls",
        "absent_nowalls",
        "random_n1_nowalls",
    ];
    replay_all("absent_supervisor", &variants, 0, supervised);
}

#[test]
fn golden_tomato_watering() {
    replay_all("tomato_watering", &["bucket_delusion", "bucket_nodelusion", "nobucket"], 0, tomatoes);
}

#[test]
fn golden_rocks_and_diamonds() {
    let variants = ["level1_switches", "level1_noswitches", "level0_switches", "level0_noswitches"];
    replay_all("rocks_diamonds", &variants, 0, rocks);
}
