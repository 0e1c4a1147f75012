//! Box Moving plays as the reference implementation does: recorded episodes, replayed step by step.

use std::collections::BTreeMap;

use mcvl_core::env::box_moving::{BoxMoving, Variant};
use mcvl_core::env::{Discrete, Environment, EpisodeEnd};
use mcvl_core::rng::Rng;
use mcvl_tests::golden::{self, Episode, Situation};

/// Our name of a recorded variant.
fn variant(name: &str) -> Variant {
    match name {
        "safe" => Variant::Safe,
        "full" => Variant::Full,
        "no_inconsistency" => Variant::NoInconsistency,
        "real_no_hack" => Variant::NoHack,
        other => panic!("the recording has the variant {other}, which this test does not know"),
    }
}

/// Compares the world and what it shows with the recording.
fn compare(world: &BoxMoving, observation: &[f32], expected: &Situation, place: &str) {
    assert_eq!((world.box_cell(), world.agent_cell()), (expected.box_cell, expected.agent), "{place}: box, agent");
    for (index, value) in observation.iter().enumerate() {
        let one = expected.ones.contains(&index);
        assert_eq!(*value, if one { 1.0 } else { 0.0 }, "{place}: input {index}");
    }
}

/// Replays an episode and returns its number of steps.
fn replay(episode: &Episode, flag: bool) -> usize {
    let mut world = BoxMoving::new(variant(&episode.variant), flag);
    let spec = world.spec().clone();
    assert_eq!(spec.observation.width, if flag { episode.obs_len } else { episode.obs_len - 1 });
    assert_eq!(spec.reward_scale, episode.scale);

    let mut rng = Rng::new(0);
    let mut observation = vec![f32::NAN; spec.observation.width];
    world.reset(&mut rng, &mut observation);
    compare(&world, &observation, &episode.initial, &format!("{}, reset", episode.episode));

    let (mut observed, mut hidden) = (0.0, 0.0);
    for (recorded, number) in episode.steps.iter().zip(1..) {
        let place = format!("{}, step {number}", episode.episode);
        observation.fill(f32::NAN);
        let step = world.step(&Discrete(recorded.a), &mut rng, &mut observation);
        compare(&world, &observation, &recorded.after, &place);
        assert_eq!(f64::from(step.reward), recorded.r_raw, "{place}: reward");
        assert_eq!(spec.scaled(step.reward), recorded.r as f32, "{place}: scaled reward");
        assert_eq!(f64::from(step.performance), recorded.hidden, "{place}: hidden reward");
        assert_eq!(step.end == Some(EpisodeEnd::Terminated), recorded.term, "{place}: terminated");
        assert_eq!(step.end == Some(EpisodeEnd::Truncated), recorded.trunc, "{place}: truncated");
        observed += f64::from(step.reward);
        hidden += f64::from(step.performance);
    }
    let ended = episode.steps.last().map(|step| if step.term { "terminated" } else { "truncated" });
    assert_eq!(ended, Some(episode.ended.as_str()), "{}", episode.episode);
    assert_eq!((observed, hidden), (episode.return_raw, episode.hidden_return), "{}", episode.episode);
    episode.steps.len()
}

/// Replays everything; every variant has to be there, with steps.
fn replay_all(flag: bool) {
    let mut steps = BTreeMap::from([("safe", 0), ("full", 0), ("no_inconsistency", 0), ("real_no_hack", 0)]);
    for episode in golden::box_moving().expect("recorded episodes") {
        let count = steps.get_mut(episode.variant.as_str()).unwrap_or_else(|| panic!("{}: new?", episode.variant));
        *count += replay(&episode, flag);
    }
    assert!(steps.values().all(|&count| count > 0), "replayed steps per variant: {steps:?}");
}

#[test]
fn golden_box_moving_with_flag() {
    replay_all(true);
}

#[test]
fn golden_box_moving_without_flag() {
    replay_all(false);
}
