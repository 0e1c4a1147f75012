//! Reacher in closed form moves as MuJoCo does: recorded trajectories, replayed step by step. MuJoCo itself
//! is held against the same trajectories in `native`, where it is linked.

use mcvl_core::env::reacher::{Button, ClosedForm, Reacher};
use mcvl_tests::reacher::{Differences, Moment, from_recordings, trajectories};

#[test]
fn golden_trajectories_in_closed_form() {
    // The button pays, but it moves nothing: physics, observation and performance are those without one.
    for button in [None, Some(Button::proposal())] {
        let [free, limited] = from_recordings(&Reacher::new(ClosedForm::default(), button)).unwrap();
        println!("closed form, elbow free:   {free}");
        println!("closed form, elbow's limit: {limited}");
        assert!(free.largest() < 1e-9, "{free}");
        assert!(limited.largest() < 1e-6, "{limited}");
    }
}

#[test]
fn golden_trajectories_are_many_and_use_the_limit() {
    let all = trajectories().unwrap();
    assert!(all.len() >= 20 && all.iter().all(|trajectory| trajectory.actions.len() == 50));
    let limited = all.iter().filter(|trajectory| trajectory.touches_joint1_limit).count();
    assert!(limited > 0 && limited < all.len());
    assert!(all.iter().any(|trajectory| trajectory.actions.iter().flatten().any(|command| command.abs() > 1.0)));
}

#[test]
fn what_is_no_number_is_infinitely_far() {
    let moment = |x: f64| Moment {
        positions: [0.0, 1.0, 0.0, 0.0],
        velocities: [0.0, x, 0.0, 100.0],
        observation: [0.5; 10],
        reward: [0.0; 3],
        tip: [0.1, 0.2],
    };
    let mut differences = Differences::default();
    differences.count(&moment(2.0), &moment(1.0));
    assert_eq!((differences.velocities, differences.largest()), (1.0, 1.0));
    differences.count(&moment(f64::NAN), &moment(0.0));
    differences.count(&moment(1.0), &moment(1.0));
    assert_eq!(differences.largest(), f64::INFINITY);
    assert_eq!(Differences::default().and(&differences), differences);
}
