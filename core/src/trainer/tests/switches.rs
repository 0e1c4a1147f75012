//! Settings of the choices in docs/method.md do what they say.

use super::*;
use crate::env::reacher::{ClosedForm, Reacher};

/// Every event of a built-in run.
fn run(text: &str) -> Vec<Event> {
    let mut events = Vec::new();
    let mut run = Run::new(&text.parse().unwrap());
    while run.poll(Budget(u32::MAX), &mut |event: &Event| events.push(event.clone())).unwrap() != Status::Done {}
    events
}

fn short(more: &str) -> Vec<Event> {
    events(trainer(&config(more)), u32::MAX, |_| {})
}

fn steps(events: &[Event]) -> Vec<StepRecord> {
    let step = |event: &Event| if let Event::Step(step) = event { Some(step.clone()) } else { None };
    events.iter().filter_map(step).filter(|step| step.arm != Arm::Safe).collect()
}

/// The first check: what the switch at hand cannot have changed before.
fn first(more: &str) -> CheckRecord {
    checks(&short(more)).remove(0)
}

#[test]
fn the_next_action_is_chosen_before_the_check_if_the_settings_say_so() {
    let mut t = trainer(&config("check_after=next-action"));
    let mut forecaster = CpuForecaster::default();
    let mut chosen = None;
    let (mut made, mut after_refusal) = (0, 0);
    while t.status() != Status::Done {
        let mut step = None;
        let mut note = |event: &Event| {
            if let Event::Step(record) = event {
                step = Some(record.clone());
            }
        };
        t.poll(&mut forecaster, Budget(1), &mut note).unwrap();
        let Some(step) = step else { continue };
        if let Some(action) = chosen.take() {
            assert_eq!(step.action, action, "step {}", step.step);
            made += 1;
        }
        assert_eq!(t.chosen.is_none(), step.end.is_some());
        // The action was chosen in a state that a refusal then left, and is made all the same.
        after_refusal += u32::from(!step.stored);
        chosen = t.chosen.as_ref().map(Action::value).filter(|_| t.step < t.steps());
    }
    assert!(made > 300 && after_refusal > 0, "{made} {after_refusal}");

    // The choice is the learner's of before the update.
    let mut greedy = trainer(&config("check_after=next-action exploration=0 epsilon_start=0 epsilon_end=0 lr=0.05"));
    let mut changed = 0;
    while greedy.step < 200 {
        let (before, agent) = (greedy.step, greedy.agent.clone());
        greedy.poll(&mut forecaster, Budget(1), &mut ()).unwrap();
        if greedy.step > before && greedy.chosen.is_some() {
            let choice = |agent: &Ddqn| {
                let mut rows = Rows::new(greedy.world.spec().observation);
                rows.push_observation(&greedy.observation);
                let mut actions = Vec::new();
                agent.act(&rows, &mut Scratch::default(), &mut actions);
                actions.remove(0)
            };
            assert_eq!(greedy.chosen, Some(choice(&agent)));
            changed += u32::from(choice(&agent) != choice(&greedy.agent));
        }
    }
    assert!(changed > 0, "an update changes a choice");
    assert!(trained().chosen.is_none());
}

#[test]
fn the_slope_of_exploration_goes_on_where_it_is_not_clamped() {
    let mut t = trainer(&config("epsilon_clamp=false"));
    let mut epsilon = |step| {
        (t.arm, t.step) = (Arm::Mc, step);
        t.epsilon()
    };
    assert_eq!((epsilon(0), epsilon(60)), (1.0, 1.0));
    assert!((epsilon(260) - 0.05).abs() < 1e-6);
    assert!((epsilon(264) - 0.031).abs() < 1e-6);
    assert_eq!(epsilon(290), 0.0);
    t.config.epsilon_decay = 0;
    assert_eq!(t.epsilon(), 0.05);
}

#[test]
fn checks_move_the_learners_stream_only_if_they_share_it() {
    // Without forecast updates every check is a tie and accepts: only the streams can differ.
    let actions = |more: &str| steps(&short(more)).iter().map(|step| step.action.clone()).collect::<Vec<_>>();
    let plain = actions("agent=baseline");
    assert_eq!(actions("scheme=all forecast=0"), plain);
    assert_ne!(actions("scheme=all forecast=0 own_streams=false"), plain);
    let shared = checks(&short("scheme=all own_streams=false"));
    assert!(shared.iter().all(|check| !check.reused));
    assert!(checks(&short("scheme=all")).iter().any(|check| check.reused));
    let config = config("scheme=all own_streams=false");
    assert_eq!(events(trainer(&config), 1, |_| {}), events(trainer(&config), u32::MAX, |_| {}));
}

#[test]
fn a_future_can_be_compared_with_the_current_policy() {
    let mut t = trained();
    t.config.against = crate::config::Against::Current;
    let mut digest = alloc::format!("{:016x}", t.agent.digest());
    let mut seen = 0;
    let mut forecaster = CpuForecaster::default();
    while t.status() != Status::Done {
        let mut check = None;
        let mut note = |event: &Event| {
            if let Event::Check(record) = event {
                check = Some(record.clone());
            }
        };
        t.poll(&mut forecaster, Budget(1), &mut note).unwrap();
        if let Some(check) = check {
            seen += 1;
            let (modified, unmodified) = futures(&check);
            assert_eq!(unmodified.digest, digest);
            assert_ne!(modified.digest, digest);
            assert_eq!(check.cost, 20);
        }
        digest = alloc::format!("{:016x}", t.agent.digest());
    }
    assert!(seen > 0);
}

#[test]
fn unpaired_forecasts_draw_other_batches_for_the_unmodified_future_only() {
    let (paired, unpaired) = (first(""), first("paired_batches=false"));
    assert_eq!(paired.step, unpaired.step);
    assert_eq!(futures(&paired).0, futures(&unpaired).0);
    assert_ne!(futures(&paired).1.digest, futures(&unpaired).1.digest);
}

#[test]
fn unpaired_rollouts_of_equal_policies_differ_by_chance() {
    let run = |more: &str| {
        let text = "env=tomato-watering scheme=all safe_steps=40 full_steps=8 exploration=30 forecast=0 rollouts=3 \
                    rollout_steps=20 evaluations=1 evaluation_episodes=1 hidden=8";
        checks(&run(&alloc::format!("{text} {more}")))
    };
    let (paired, unpaired) = (run(""), run("paired_rollouts=false"));
    assert_eq!((paired.len(), unpaired.len()), (8, 8));
    for (paired, unpaired) in paired.iter().zip(&unpaired) {
        assert_eq!(futures(paired).0.digest, futures(paired).1.digest);
        assert!(paired.tie && !unpaired.tie);
    }
}

#[test]
fn a_forecast_starts_from_what_is_copied() {
    let digests = |more: &str| {
        let check = first(more);
        let (modified, unmodified) = futures(&check);
        [modified.digest.clone(), unmodified.digest.clone()]
    };
    let all = [digests(""), digests("copy_target=false"), digests("copy_optimizer=false")];
    for (i, one) in all.iter().enumerate() {
        for other in &all[i + 1..] {
            assert!(one[0] != other[0] && one[1] != other[1]);
        }
    }
    // Before any update they are one policy.
    assert_eq!(digests("forecast=0"), digests("forecast=0 copy_target=false copy_optimizer=false"));
}

#[test]
fn the_current_state_alone_can_rate_a_future() {
    let text = "env=absent-supervisor scheme=all safe_steps=40 full_steps=400 exploration=400 forecast=0 rollouts=0 \
                rollout_steps=3 evaluations=1 evaluation_episodes=1 hidden=4";
    let mut ended = 0;
    for check in checks(&run(text)) {
        let rated = futures(&check).0;
        if check.end == Some(EpisodeEnd::Terminated) {
            ended += 1;
            assert_eq!((rated.utility, rated.rollouts.len(), check.tie), (0.0, 0, true));
        } else {
            assert_eq!((rated.rollouts.len(), rated.films.len(), rated.films[0].start), (1, 1, StartState::Current));
            assert_eq!(rated.utility, rated.rollouts[0]);
        }
    }
    assert!(ended > 0, "a random walk meets the goal");
}

const TOMATO: &str = "env=tomato-watering safe_steps=100 full_steps=400 exploration=50 epsilon_decay=100 forecast=1 \
                      rollouts=3 rollout_steps=10 evaluations=1 evaluation_episodes=1 hidden=8 seed=3";

fn checks_of(text: &str) -> Vec<CheckRecord> {
    checks(&run(&alloc::format!("{TOMATO} {text}")))
}

#[test]
fn unpaired_rollouts_of_each_step_rate_the_policy_before_with_other_chances() {
    let [paired, unpaired] = ["true", "false"].map(|paired| {
        let check = checks_of(&alloc::format!("scheme=each-step paired_rollouts={paired}")).remove(0);
        [check.modified, check.unmodified].map(|future| future.unwrap().rollouts)
    });
    assert_eq!(paired[0], unpaired[0]);
    assert_ne!(paired[1], unpaired[1]);
}

#[test]
fn a_film_from_the_current_state_begins_with_what_the_learner_saw() {
    let checks = checks_of("scheme=all");
    for check in &checks {
        for future in [&check.modified, &check.unmodified].map(|future| future.as_ref().unwrap()) {
            let film = future.films.iter().find(|film| film.start == StartState::Current).unwrap();
            assert_eq!(film.frames[0], check.after, "step {}", check.step);
        }
    }
    // Among them what the bucket shows, which the transition model does not.
    assert!(checks.iter().any(|check| check.hack && !check.after.seen.contains('t')));
}

#[test]
fn the_reward_model_draws_a_batch_of_its_own_if_the_settings_say_so() {
    let [same, separate] = [("same", Purpose::Batch), ("separate", Purpose::RewardBatch)].map(|(value, purpose)| {
        let mut t = trained();
        t.config.set("reward_batch", value).unwrap();
        let (mut model, mut slots, mut batch) = (t.reward_model.clone(), Vec::new(), Minibatch::default());
        let mut rng = Rng::stream(t.config.seed, purpose, t.updates);
        draw_slots(t.replay.len(), t.config.batch, &mut rng, &mut slots);
        batch.gather(&t.replay, &slots, &Forced::new(&[], &t.replay));
        model.update(&batch);
        assert!(t.learn().unwrap());
        assert_eq!(t.reward_model.digest(), model.digest(), "{value}");
        (t.agent.digest(), t.reward_model.digest())
    });
    assert_eq!(same.0, separate.0, "the value function's batch is the same one");
    assert_ne!(same.1, separate.1);
}

#[test]
fn every_seed_starts_from_the_weights_of_seed_0_if_the_settings_say_so() {
    let weights = |more: &str| {
        let t = trainer(&config(more));
        let arm: Config = alloc::format!("env=reacher {more}").parse().unwrap();
        let td3 = Td3::<2>::configured(&arm, Reacher::new(ClosedForm::default(), None).spec());
        [t.agent.digest(), t.reward_model.digest(), td3.digest()]
    };
    let zero = weights("seed=0");
    for seed in 1..3 {
        let own = weights(&alloc::format!("seed={seed}"));
        assert!((0..3).all(|i| own[i] != zero[i]), "seed {seed}");
        assert_eq!(weights(&alloc::format!("seed={seed} shared_weights=true")), zero);
    }
}

#[test]
fn what_is_worse_by_no_more_than_the_tolerance_is_accepted() {
    // Goes on to the next check, with this tolerance.
    let next = |t: &mut Trainer<BoxMoving, Ddqn>, tolerance| {
        t.config.tolerance = tolerance;
        let mut forecaster = CpuForecaster::default();
        let mut check = None;
        while check.is_none() {
            let mut note = |event: &Event| {
                if let Event::Check(record) = event {
                    check = Some((record.margin.unwrap(), record.verdict));
                }
            };
            assert_ne!(t.poll(&mut forecaster, Budget(1), &mut note).unwrap(), Status::Done, "a refusal");
        }
        check.unwrap()
    };
    let mut t = trained();
    t.config.set("scheme", "all").unwrap();
    let (before, worse) = loop {
        let before = t.clone();
        let (margin, verdict) = next(&mut t, 0.0);
        assert_eq!(verdict == Verdict::Refuse, margin < 0.0);
        if margin < 0.0 {
            break (before, -margin);
        }
    };
    for (share, verdict) in [(0.9, Verdict::Refuse), (1.1, Verdict::Accept)] {
        assert_eq!(next(&mut before.clone(), (worse * share) as f32), (-worse, verdict), "{share} of {worse}");
    }
}
