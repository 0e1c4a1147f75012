//! The learners that the checking one is compared with, on Box Moving with short legs.

use super::*;

/// Box Moving that says something else of rewards or of performance.
#[derive(Clone)]
struct Says {
    world: BoxMoving,
    reward: Option<f32>,
    performance: Option<f32>,
}

impl Environment for Says {
    type Action = Discrete;
    fn spec(&self) -> &EnvSpec {
        self.world.spec()
    }
    fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
        self.world.reset(rng, observation);
    }
    fn step(&mut self, action: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
        let step = self.world.step(action, rng, observation);
        let reward = self.reward.unwrap_or(step.reward);
        Step { reward, performance: self.performance.unwrap_or(step.performance), ..step }
    }
}

/// Events of a run whose Full world says these rewards and performances in place of its own.
fn told(agent: &str, reward: Option<f32>, performance: Option<f32>) -> Vec<Event> {
    let says = |variant, reward, performance| Says { world: BoxMoving::new(variant, true), reward, performance };
    let full = says(Variant::Full, reward, performance);
    let config = config(&alloc::format!("agent={agent}"));
    events(Trainer::gridworld(config, says(Variant::Safe, None, None), full), u32::MAX, |_| {})
}

/// Parameters at the end of each leg and what was predicted on the way: all that a learner is.
fn learned(events: &[Event]) -> Vec<(String, Vec<u32>)> {
    let mut legs = Vec::new();
    let mut predicted = Vec::new();
    for event in events {
        match event {
            Event::Step(step) => predicted.push(step.predicted.to_bits()),
            Event::End(end) => legs.push((end.digest.clone(), core::mem::take(&mut predicted))),
            _ => {}
        }
    }
    assert_eq!(legs.len(), 2);
    legs
}

#[test]
fn only_the_oracle_learns_from_performance() {
    for agent in Learner::NAMES {
        let same = learned(&told(agent, None, None)) == learned(&told(agent, None, Some(3.0)));
        assert_eq!(same, *agent != "oracle", "{agent}");
    }
}

#[test]
fn the_oracle_is_paid_performance_and_nothing_else() {
    let (honest, generous) = (told("oracle", None, None), told("oracle", Some(7.0), None));
    assert_eq!(learned(&honest), learned(&generous));
    let paid = |event: &Event| match event {
        Event::Step(step) if step.arm == Arm::Oracle => Some((step.reward_raw, step.performance, step.reward)),
        _ => None,
    };
    let steps: Vec<_> = honest.iter().filter_map(paid).collect();
    assert_eq!(steps.len(), 80);
    assert!(steps.iter().all(|(raw, performance, scaled)| raw == performance && *scaled == 0.2 * raw));
    assert!(steps.iter().any(|step| step.0 != 0.0));
    // Its evaluations are of the world as it is: what everybody would be paid there.
    let returns = |events: &[Event]| -> Vec<f64> {
        let of = |event: &Event| match event {
            Event::Evaluation(point) if point.arm == Arm::Oracle => Some(point.observed_return),
            _ => None,
        };
        events.iter().filter_map(of).collect()
    };
    assert!(returns(&generous).iter().all(|observed| *observed == 700.0));
    assert!(returns(&honest).iter().all(|observed| *observed != 700.0));
}

#[test]
fn the_frozen_learner_stays_what_it_was_at_the_switch() {
    let events = told("frozen", None, None);
    let ends: Vec<_> =
        events.iter().filter_map(|event| if let Event::End(end) = event { Some(end.clone()) } else { None }).collect();
    assert_eq!((&ends[0].digest, ends[0].updates), (&ends[1].digest, ends[1].updates));
    assert_eq!((ends[1].arm, ends[1].steps), (Arm::Frozen, 80));
    // It explores as the plain learner does while all is random.
    let actions = |events: &[Event]| -> Vec<_> {
        let of = |event: &Event| match event {
            Event::Step(step) if step.arm != Arm::Safe => Some(step.action.clone()),
            _ => None,
        };
        events.iter().filter_map(of).take(60).collect()
    };
    assert_eq!(actions(&events), actions(&told("baseline", None, None)));
}

#[test]
fn a_frozen_reward_model_takes_the_place_of_rewards() {
    // What the Full world pays makes no difference.
    assert_eq!(learned(&told("frozen-reward", None, None)), learned(&told("frozen-reward", Some(9.0), None)));
    let mut t = trained();
    t.choose(Learner::FrozenReward).unwrap();
    let (model, policy, pushed) = (t.reward_model.digest(), t.agent.digest(), t.replay.pushed());
    let mut predicted = Vec::new();
    let mut note = |event: &Event| {
        if let Event::Step(step) = event {
            assert!(step.stored && !step.checked);
            predicted.push(step.predicted);
        }
    };
    while t.poll(&mut CpuForecaster::default(), Budget(u32::MAX), &mut note).unwrap() != Status::Done {}
    assert_eq!(t.reward_model.digest(), model);
    assert_ne!(t.agent.digest(), policy);
    assert_eq!(t.replay.pushed(), pushed + 80);
    let stored: Vec<f32> = (t.replay.len() - 80..t.replay.len()).map(|slot| t.replay.get(slot).reward).collect();
    assert_eq!(stored, predicted);
}

#[test]
fn every_learner_is_polled_and_resumes_to_the_last_bit() {
    for agent in Learner::NAMES {
        let config = config(&alloc::format!("agent={agent} full_steps=25 forecast=10"));
        let whole = events(trainer(&config), u32::MAX, |_| {});
        let mut resumed = Vec::new();
        let mut run = Run::new(&config);
        while run.poll(Budget(31), &mut |event: &Event| resumed.push(event.clone())).unwrap() != Status::Done {
            run = Run::resume(&run.snapshot()).unwrap();
        }
        assert_eq!(resumed, whole, "{agent}");
    }
}
