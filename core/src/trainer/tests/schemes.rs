//! The schemes that checking is compared with (paper section 5.3), on Box Moving with short legs.

use super::*;
use crate::check::utility::{Judge, rate};
use crate::record::Subject;

/// Learner's state that an update changes.
fn parameters(t: &Trainer<BoxMoving, Ddqn>) -> (Vec<f32>, Vec<f32>, u64) {
    (t.agent.online().params().to_vec(), t.agent.target().params().to_vec(), t.reward_model.digest())
}

/// Polls to the end and hands every step with its check, if it had one, to `look`, together with the trainer
/// as it was before the step and is after it.
fn follow(
    more: &str,
    mut look: impl FnMut(&Trainer<BoxMoving, Ddqn>, &StepRecord, Option<&CheckRecord>, &Trainer<BoxMoving, Ddqn>),
) {
    let mut t = trainer(&config(more));
    while t.poll(&mut CpuForecaster::default(), Budget(u32::MAX), &mut ()).unwrap() != Status::Switch {}
    let mut forecaster = CpuForecaster::default();
    let mut before = t.clone();
    let mut check = None;
    while t.status() != Status::Done {
        let mut step = None;
        let mut note = |event: &Event| match event {
            Event::Check(record) => check = Some(record.clone()),
            Event::Step(record) => step = Some(record.clone()),
            _ => {}
        };
        t.poll(&mut forecaster, Budget(1), &mut note).unwrap();
        if let Some(step) = step {
            look(&before, &step, check.take().as_deref(), &t);
        }
        if !matches!(t.activity, Activity::Check(_)) {
            before = t.clone();
        }
    }
}

#[test]
fn discarding_drops_what_would_be_checked_and_forecasts_nothing() {
    let (mut dropped, mut kept) = (0, 0);
    follow("scheme=discard", |before, step, check, after| {
        let surprising = (step.reward - step.predicted).abs() >= 0.05;
        assert_eq!((step.checked, step.stored, check.is_some()), (surprising, !surprising, surprising));
        if let Some(check) = check {
            dropped += 1;
            assert_eq!((check.verdict, check.cost, check.futures()), (Verdict::Refuse, 0, None));
            assert_eq!((check.number, check.step), (dropped, step.step));
            assert!(check.sentence().ends_with("DISCARDED without a forecast"));
            assert_eq!((after.replay.pushed(), parameters(after)), (before.replay.pushed(), parameters(before)));
            assert_eq!((after.world().box_cell(), after.world().agent_cell(), after.episode.length), (2, 2, 0));
        } else {
            kept += 1;
            assert_eq!(after.replay.pushed(), before.replay.pushed() + 1);
        }
        assert_eq!(after.forecast_updates, 0);
    });
    assert!(dropped > 0 && kept > 0, "{dropped} {kept}");
}

#[test]
fn each_step_keeps_no_update_that_makes_the_policy_worse() {
    let (mut taken_back, mut kept) = (0, 0);
    follow("scheme=each-step", |before, step, check, after| {
        let check = check.expect("every update is judged");
        assert_eq!((check.subject, check.cost, step.stored), (Subject::Update, 0, true));
        assert_eq!(after.replay.pushed(), before.replay.pushed() + 1, "every transition is stored");
        let (after_update, before_update) = futures(check);
        assert_eq!(before_update.digest, alloc::format!("{:016x}", before.agent.digest()));
        assert_ne!(after_update.digest, before_update.digest);
        // The judge is the learner before the update.
        let judge = Judge { value: &before.agent, reward: &before.reward_model, config: &before.config };
        let rated =
            rate(&before.agent, &judge, alloc::vec![crate::check::utility::Start::reset(&before.full, Rng::new(0))]);
        assert_eq!(rated[0].utility, before_update.rollouts[0]);
        if check.verdict == Verdict::Refuse {
            taken_back += 1;
            assert!(check.margin.unwrap() < 0.0 && !check.wrong());
            assert_eq!(parameters(after), parameters(before));
            assert_eq!((after.updates, after.dropped), (before.updates, before.dropped + 1));
            let moments = |t: &Trainer<BoxMoving, Ddqn>| postcard::to_allocvec(&(&t.agent, &t.reward_model)).unwrap();
            assert_eq!(moments(after), moments(before), "the optimisers too");
        } else {
            kept += 1;
            assert_ne!(parameters(after).0, parameters(before).0);
            assert_eq!((after.updates, after.dropped), (before.updates + 1, before.dropped));
        }
    });
    assert!(taken_back > 0 && kept > 0, "{taken_back} {kept}");
}

#[test]
fn an_update_that_was_taken_back_is_not_tried_again() {
    // Two attempts from one learner have different mini-batches.
    let mut t = trained();
    let before = (t.agent.clone(), t.reward_model.clone());
    let mut attempt = |dropped| {
        (t.agent, t.reward_model) = before.clone();
        (t.updates, t.dropped) = (0, dropped);
        assert!(t.learn().unwrap());
        t.agent.digest()
    };
    assert_ne!(attempt(0), attempt(1));
    assert_eq!(attempt(1), attempt(1));
}

#[test]
fn refused_transitions_are_stored_under_another_reward() {
    for (more, wanted) in
        [("scheme=punish", Some(-2.0)), ("scheme=punish punishment=-0.5", Some(-0.5)), ("scheme=store-predicted", None)]
    {
        let mut refused = 0;
        follow(more, |before, step, check, after| {
            assert!(step.stored);
            assert_eq!(
                (after.replay.pushed(), after.updates),
                (before.replay.pushed() + 1, before.updates + 1),
                "{more}"
            );
            let last = after.replay.get(after.replay.len() - 1);
            let Some(check) = check.filter(|check| check.verdict == Verdict::Refuse) else {
                assert_eq!(last.reward, step.reward);
                assert!(check.is_none_or(|check| check.replaced.is_none()));
                return;
            };
            refused += 1;
            assert_eq!(last.reward, wanted.unwrap_or(step.predicted), "{more}");
            assert_eq!(check.replaced, Some(last.reward));
            assert_ne!(last.reward, check.reward, "the record keeps what was received");
            assert_eq!(after.episode.length, 0, "a refusal resets");
        });
        assert!(refused > 0, "{more}");
    }
}

#[test]
fn without_a_scheme_the_checking_learner_is_the_plain_one() {
    let steps = |more: &str| -> Vec<(u32, f32, f32, bool, bool)> {
        let step = |event: &Event| match event {
            Event::Step(s) => Some((s.step, s.reward, s.predicted, s.checked, s.stored)),
            _ => None,
        };
        events(trainer(&config(more)), u32::MAX, |_| {}).iter().filter_map(step).collect()
    };
    let none = steps("scheme=none");
    assert_eq!(none, steps("agent=baseline"));
    assert!(none.iter().all(|step| !step.3 && step.4));
    assert_ne!(none, steps(""), "the run has something to check");
}

#[test]
fn every_scheme_is_polled_and_resumes_to_the_last_bit() {
    for scheme in crate::config::Scheme::NAMES {
        let config = config(&alloc::format!("scheme={scheme} full_steps=25 forecast=10"));
        let whole = events(trainer(&config), u32::MAX, |_| {});
        let mut resumed = Vec::new();
        let mut run = Run::new(&config);
        loop {
            let status = run.poll(Budget(7), &mut |event: &Event| resumed.push(event.clone())).unwrap();
            if status == Status::Done {
                break;
            }
            // A forecast of 20 updates is begun anew by an interruption, so not every poll has one.
            if run.progress().check.is_none() {
                run = Run::resume(&run.snapshot()).unwrap();
            }
        }
        assert_eq!(resumed, whole, "{scheme}");
    }
}
