//! Forecasts that practise in the transition model (docs/method.md R27).

use super::*;
use crate::forecast::{Carry, Practice};
use alloc::rc::Rc;
use core::cell::RefCell;

const PRACTICE: &str = "practice=true practice_reward_updates=15";

/// Box Moving that tells a log where it is stepped, and pays what nobody should look at.
#[derive(Clone)]
struct Watched {
    world: BoxMoving,
    log: Rc<RefCell<Vec<String>>>,
}

impl Environment for Watched {
    type Action = Discrete;
    fn spec(&self) -> &EnvSpec {
        self.world.spec()
    }
    fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
        self.log.borrow_mut().push("reset".to_string());
        self.world.reset(rng, observation);
    }
    fn step(&mut self, action: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
        self.log.borrow_mut().push(alloc::format!("{}{}", self.world.box_cell(), self.world.agent_cell()));
        Step { reward: f32::NAN, performance: f32::NAN, ..self.world.step(action, rng, observation) }
    }
}

/// Futures of jobs with these forced transitions that all practise from one state, in one forecaster.
fn futures_of(
    t: &Trainer<BoxMoving, Ddqn>,
    forced: &[&[Transition<Discrete>]],
    world: &Watched,
    ended: bool,
) -> Vec<Ddqn> {
    let mut observation = alloc::vec![0.0; 11];
    let mut shown = world.world.clone();
    shown.step(&Discrete(0), &mut Rng::new(0), &mut observation);
    let jobs: Vec<_> = forced
        .iter()
        .map(|forced| ForecastJob {
            agent: &t.agent,
            replay: &t.replay,
            forced,
            updates: 30,
            batch: 32,
            seed: 1,
            carry: Carry::ALL,
            version: 5,
            practice: Some(Practice {
                world,
                observation: &observation,
                ended,
                reward_model: &t.reward_model,
                reward_updates: 40,
                epsilon: 0.5,
            }),
        })
        .collect();
    match CpuForecaster::default().poll(&jobs, &mut Budget(u32::MAX)) {
        Poll::Ready(Ok(futures)) => futures,
        _ => panic!("the budget suffices, and the rewards of the world are not looked at"),
    }
}

fn watched(box_cell: u8, agent: u8) -> Watched {
    Watched { world: BoxMoving::at(Variant::Full, true, box_cell, agent).unwrap(), log: Rc::default() }
}

#[test]
fn no_future_leaks_into_another_or_into_the_learner() {
    let t = trained();
    let before = (t.agent.digest(), t.reward_model.digest(), t.replay.clone());
    let surprise = Transition { reward: 5.0, ..t.replay.get(0) };
    let world = watched(2, 1);
    let alone = |forced: &[Transition<Discrete>]| futures_of(&t, &[forced], &watched(2, 1), false)[0].digest();
    let together = futures_of(&t, &[&[], core::slice::from_ref(&surprise), &[]], &world, false);
    let digests: Vec<u64> = together.iter().map(Agent::digest).collect();
    assert_eq!(digests[0], digests[2]);
    assert_ne!(digests[0], digests[1]);
    assert_eq!(digests[..2], [alone(&[]), alone(&[surprise])]);
    assert_eq!((t.agent.digest(), t.reward_model.digest(), t.replay.clone()), before);
    assert_eq!((world.world.box_cell(), world.world.agent_cell()), (2, 1));
}

#[test]
fn practice_begins_where_the_step_ended_and_makes_one_step_per_update() {
    let t = trained();
    for (ended, first) in [(false, "31"), (true, "reset")] {
        let world = watched(3, 1);
        futures_of(&t, &[&[]], &world, ended);
        let log = world.log.borrow();
        assert_eq!(log[0], first);
        assert_eq!(log.iter().filter(|entry| *entry != "reset").count(), 30);
    }
    // An episode of practice ends after its hundred steps, and another one begins.
    let mut world = watched(2, 2);
    let mut observation = [0.0; 11];
    (0..90).for_each(|_| _ = world.step(&Discrete(0), &mut Rng::new(0), &mut observation));
    world.log.borrow_mut().clear();
    futures_of(&t, &[&[]], &world, false);
    assert_eq!(world.log.borrow().iter().position(|entry| entry == "reset"), Some(10));
}

#[test]
fn a_practising_run_is_polled_and_resumes_to_the_last_bit() {
    let config = config(&alloc::format!("{PRACTICE} scheme=all full_steps=12"));
    let whole = events(trainer(&config), u32::MAX, |_| {});
    assert_eq!(events(trainer(&config), 1, |_| {}), whole);
    let mut rng = Rng::new(3);
    let mut resumed = Vec::new();
    let mut run = Run::new(&config);
    while run.poll(Budget(1 + rng.below(200)), &mut |event: &Event| resumed.push(event.clone())).unwrap()
        != Status::Done
    {
        // Also in the middle of a check, whose forecasts are then made again.
        run = Run::resume(&run.snapshot()).unwrap();
    }
    assert_eq!(resumed, whole);
}

#[test]
fn a_poll_does_no_more_than_its_budget() {
    let mut t = trained();
    t.config.set("practice", "true").unwrap();
    t.config.set("practice_reward_updates", "15").unwrap();
    let mut forecaster = CpuForecaster::default();
    let mut polls = 0;
    while t.checks == 0 {
        let checking = matches!(t.activity, Activity::Check(_));
        t.poll(&mut forecaster, Budget(1), &mut ()).unwrap();
        polls += u32::from(checking);
    }
    // Two futures of 15 updates of a reward model and 20 of the learner; the rating comes with the last one.
    assert_eq!(polls, 2 * (15 + 20));
}

#[test]
fn practice_is_never_reused_and_its_cost_is_counted() {
    let all =
        checks(&events(trainer(&config(&alloc::format!("{PRACTICE} scheme=all full_steps=40"))), u32::MAX, |_| {}));
    assert_eq!(all.len(), 40);
    assert!(all.iter().all(|check| !check.reused && check.cost == 2 * (15 + 20)));
    assert!(all.iter().any(|check| check.verdict == Verdict::Refuse), "the checks after it could have reused");
    // A future without updates neither trains nor practises.
    let none = checks(&events(trainer(&config(&alloc::format!("{PRACTICE} scheme=all forecast=0"))), u32::MAX, |_| {}));
    assert!(none.iter().all(|check| check.tie && check.cost == 0 && check.modified == check.unmodified));
}

#[test]
fn practice_changes_both_futures() {
    let first = |more: &str| checks(&events(trainer(&config(more)), u32::MAX, |_| {})).remove(0);
    let (plain, practised) = (first(""), first(PRACTICE));
    assert_eq!((plain.step, plain.predicted, plain.updates), (practised.step, practised.predicted, practised.updates));
    assert_ne!(futures(&plain).0.digest, futures(&practised).0.digest);
    assert_ne!(futures(&plain).1.digest, futures(&practised).1.digest);
}
