//! Runs with their types erased: every world, resuming, checks made anew.

use super::*;
use crate::config::Preset;
use crate::env::{ActionSpec, Discrete, EpisodeEnd, ObservationSpec, Step};
use crate::experiment::EXPERIMENTS;
use crate::record::Event;
use crate::rng::Rng;
use alloc::string::ToString;
use serde::Deserialize;

fn finish(mut run: Run) -> Vec<Event> {
    let mut events = Vec::new();
    while run.poll(Budget(u32::MAX), &mut |event: &Event| events.push(event.clone())).unwrap() != Status::Done {}
    events
}

#[test]
fn every_experiment_has_its_world() {
    let names = FAMILIES.iter().flat_map(|family| family.names.iter().copied());
    assert!(names.eq(EXPERIMENTS.iter().map(|experiment| experiment.name)));
    for experiment in EXPERIMENTS {
        let run = Run::new(&Config::new(experiment.name, Preset::Paper).unwrap());
        assert_eq!(run.spec().name, experiment.name);
    }
}

#[test]
fn a_check_can_be_made_anew_with_other_streams() {
    let text = "env=tomato-watering safe_steps=60 full_steps=40 exploration=30 forecast=20 rollouts=4 \
                rollout_steps=10 evaluations=2 evaluation_episodes=2 hidden=8 scheme=all";
    let mut run = Run::new(&text.parse().unwrap());
    assert!(run.redrawn(1, true).is_none(), "no check is under way");
    while run.progress().check.is_none() {
        run.poll(Budget(1), &mut ()).unwrap();
    }
    let decide = |mut run: Run| {
        let mut found = None;
        while found.is_none() {
            let mut keep = |event: &Event| {
                if let Event::Check(check) = event {
                    found = Some((**check).clone());
                }
            };
            run.poll(Budget(1), &mut keep).unwrap();
        }
        found.unwrap()
    };
    let own = decide(run.clone());
    // Also where the forecasts have begun.
    run.poll(Budget(5), &mut ()).unwrap();
    assert_eq!(decide(run.redrawn(run.progress().updates, true).unwrap()), own);
    let other = decide(run.redrawn(7, true).unwrap());
    assert_ne!(other.modified, own.modified);
    assert_ne!(decide(run.redrawn(7, false).unwrap()).unmodified, other.unmodified);
}

/// A corridor of an application, to whose right end it pays to go. Its state says nothing of the shape.
#[derive(Clone, Serialize, Deserialize)]
struct Corridor<const CELLS: usize, const ACTIONS: usize> {
    cell: usize,
    steps: u32,
}

impl<const CELLS: usize, const ACTIONS: usize> Corridor<CELLS, ACTIONS> {
    const SPEC: EnvSpec = EnvSpec {
        name: "corridor",
        observation: ObservationSpec { width: CELLS, binary: true },
        actions: ActionSpec::Discrete(["left", "right", "wait"].split_at(ACTIONS).0),
        max_steps: 20,
        reward_scale: 1.0,
        deterministic: true,
        legend: &[],
    };

    fn show(&self, observation: &mut [f32]) {
        observation.fill(0.0);
        observation[self.cell] = 1.0;
    }
}

impl<const CELLS: usize, const ACTIONS: usize> Environment for Corridor<CELLS, ACTIONS> {
    type Action = Discrete;
    fn spec(&self) -> &EnvSpec {
        &Self::SPEC
    }
    fn reset(&mut self, _: &mut Rng, observation: &mut [f32]) {
        (self.cell, self.steps) = (2, 0);
        self.show(observation);
    }
    fn step(&mut self, action: &Discrete, _: &mut Rng, observation: &mut [f32]) -> Step {
        self.cell = if action.0 == 0 { self.cell.saturating_sub(1) } else { (self.cell + 1).min(4) };
        self.steps += 1;
        self.show(observation);
        let reward = f32::from(u8::from(self.cell == 4));
        let end = (self.steps == Self::SPEC.max_steps).then_some(EpisodeEnd::Truncated);
        Step { reward, performance: reward, end }
    }
}

/// A run in the corridor, at the beginning of its first check.
fn corridor() -> Run {
    let mut config = Config::custom(Preset::Paper);
    let short = "safe_steps=60 full_steps=20 exploration=40 forecast=10 rollouts=2 hidden=8 scheme=all evaluations=2";
    for (key, value) in short.split_whitespace().filter_map(|pair| pair.split_once('=')) {
        config.set(key, value).unwrap();
    }
    let world = Corridor::<5, 2> { cell: 2, steps: 0 };
    let mut run = Run::of("corridor", Trainer::gridworld(config, world.clone(), world));
    while run.progress().check.is_none() {
        run.poll(Budget(1), &mut ()).unwrap();
    }
    run
}

#[test]
fn a_check_made_anew_stays_one_of_its_run() {
    let redrawn = corridor().redrawn(7, true).unwrap();
    let resumed = Run::resume_of::<Corridor<5, 2>, Ddqn>("corridor", &redrawn.snapshot()).unwrap();
    assert_eq!(finish(resumed), finish(redrawn));
    // Those of built-in worlds can go elsewhere, as before.
    let text = "env=box-moving safe_steps=60 full_steps=5 exploration=40 forecast=10 hidden=8 scheme=all";
    let mut run = Run::new(&text.parse().unwrap());
    while run.progress().check.is_none() {
        run.poll(Budget(1), &mut ()).unwrap();
    }
    let mut redrawn = run.redrawn(7, true).unwrap();
    redrawn.forecast_elsewhere().unwrap();
    redrawn.poll(Budget(1), &mut ()).unwrap();
    assert!(redrawn.take_job().is_some());
}

#[test]
fn a_snapshot_of_a_world_of_another_shape_is_answered() {
    let bytes = corridor().snapshot();
    Run::resume_of::<Corridor<5, 2>, Ddqn>("corridor", &bytes).unwrap();
    let wider = Run::resume_of::<Corridor<6, 2>, Ddqn>("corridor", &bytes).err().unwrap();
    let shapes = "the snapshot does not fit its world: its observations are 5 zeros and ones, those of its world here \
                  are 6 zeros and ones";
    assert_eq!(wider.to_string(), shapes);
    let more = Run::resume_of::<Corridor<5, 3>, Ddqn>("corridor", &bytes).err().unwrap();
    assert!(matches!(&more, SnapshotError::Changed(why) if why.starts_with("its networks are for other")), "{more}");
}

#[test]
fn every_variant_runs_and_resumes_to_the_last_bit() {
    for experiment in EXPERIMENTS {
        let pairs = experiment.maps().iter().flat_map(|map| experiment.variants.iter().map(move |v| (map, v)));
        for (map, variant) in pairs {
            let mut config = Config::new(experiment.name, Preset::Paper).unwrap();
            let short = "practice_reward_updates=4 scheme=all safe_steps=60 full_steps=6 exploration=30 \
                         learning_starts=30 batch=16 forecast=3 rollouts=2 \
                         rollout_steps=4 evaluations=2 evaluation_episodes=2 hidden=8";
            for (key, value) in short.split_whitespace().filter_map(|pair| pair.split_once('=')) {
                config.set(key, value).unwrap();
            }
            config.set("variant", variant).unwrap();
            config.set("map", map).unwrap();
            let mut run = Run::new(&config);
            let mut ignore = |_: &Event| {};
            while run.progress().arm == Arm::Safe || run.progress().step < 3 {
                run.poll(Budget(1), &mut ignore).unwrap();
            }
            let resumed = Run::resume(&run.snapshot()).unwrap();
            let rest = finish(resumed);
            assert!(rest.iter().any(|event| matches!(event, Event::Check(_))), "{config}");
            assert_eq!(finish(run), rest, "{config}");
        }
    }
}
