//! What forecasts are forced to train on, and when the unmodified future of a check is used again.

use super::*;
use crate::forecast::ForecastError;

type Transitions = Vec<Transition<Discrete>>;

/// The reference, noting what each of its jobs is forced to train on.
#[derive(Default)]
struct Noting {
    inner: CpuForecaster<BoxMoving, Ddqn>,
    forced: Vec<Transitions>,
}

impl Forecaster<BoxMoving, Ddqn> for Noting {
    fn poll(
        &mut self,
        jobs: &[ForecastJob<'_, BoxMoving, Ddqn>],
        budget: &mut Budget,
    ) -> Poll<Result<Vec<Ddqn>, ForecastError>> {
        self.forced = jobs.iter().map(|job| job.forced.to_vec()).collect();
        self.inner.poll(jobs, budget)
    }
    fn progress(&self) -> f32 {
        Forecaster::<BoxMoving, Ddqn>::progress(&self.inner)
    }
    fn cancel(&mut self) {
        Forecaster::<BoxMoving, Ddqn>::cancel(&mut self.inner);
    }
}

/// Follows a run of the way `episode` and compares what its forecasts are forced to train on with the transitions that
/// were accepted since the last reset. Gives how many of them were appended in each check, and how many checks came
/// right after a refusal.
fn appended(more: &str) -> (Vec<usize>, u32) {
    let mut t = trainer(&config(&alloc::format!("hidden=32 forced=episode {more}")));
    let mut forecaster = Noting::default();
    let (mut accepted, mut lengths) = (Transitions::new(), Vec::new());
    let (mut refused, mut after_refusals) = (false, 0);
    while t.status() != Status::Done {
        let pending = if let Activity::Check(p) = &t.activity { Some(p.transition.clone()) } else { None };
        let (mut stored, mut reset, mut check) = (false, false, None);
        let mut note = |event: &Event| match event {
            Event::Step(step) => stored = step.stored,
            Event::Check(record) => check = Some(record.clone()),
            Event::Episode(_) | Event::Start(_) => reset = true,
            _ => {}
        };
        t.poll(&mut forecaster, Budget(1), &mut note).unwrap();
        if let Some(pending) = pending {
            let tail = &accepted[accepted.len().saturating_sub(10)..];
            let modified = [tail, &[pending]].concat();
            let expected = [&modified[..], tail];
            assert_eq!(forecaster.forced, expected[..forecaster.forced.len()], "{more}, step {}", t.step);
            if check.is_some() {
                lengths.push(tail.len());
                after_refusals += u32::from(refused);
            }
        }
        if let Some(check) = &check {
            refused = check.verdict == Verdict::Refuse;
        }
        // What is stored under another reward is none of them.
        if stored && check.is_none_or(|check| check.replaced.is_none()) {
            accepted.push(t.replay.get(t.replay.len() - 1));
        }
        if reset {
            accepted.clear();
        }
    }
    (lengths, after_refusals)
}

#[test]
fn at_most_ten_accepted_transitions_of_the_episode_are_forced() {
    for more in ["scheme=all", "scheme=all reset_on_refusal=false", "scheme=punish threshold=0 reset_on_refusal=false"]
    {
        let (lengths, after_refusals) = appended(more);
        assert_eq!(lengths.len(), 80, "every step is checked");
        for length in 0..=10 {
            assert!(lengths.contains(&length), "{more}: {length} in {lengths:?}");
        }
        assert!(after_refusals > 0, "{more}");
    }
}

#[test]
fn a_future_is_reused_only_where_it_would_be_the_same() {
    for (more, reuse) in [
        // After a refusal the episode begins anew, without what was forced.
        ("forced=episode", None),
        ("forced=episode reset_on_refusal=false", Some(true)),
        // A refusal is followed by an update like any other step.
        ("update_on_refusal=true", Some(false)),
    ] {
        let config = config(&alloc::format!("hidden=32 full_steps=40 scheme=all {more}"));
        let reused = events(trainer(&config), 1, |_| {});
        let fresh = events(trainer(&config), 1, Trainer::forget_forecast);
        let refusals = checks(&reused).iter().filter(|check| check.verdict == Verdict::Refuse).count();
        assert!(refusals > 0, "{more}");
        if let Some(reuse) = reuse {
            assert_eq!(checks(&reused).iter().any(|check| check.reused), reuse, "{more}");
        }
        assert!(checks(&fresh).iter().all(|check| !check.reused));
        assert_eq!(decisions(&reused), decisions(&fresh), "{more}");
    }
}
