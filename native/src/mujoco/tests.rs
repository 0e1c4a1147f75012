//! MuJoCo moves the arm as it was recorded, as core's closed form does, and without hidden state.

use mcvl_core::env::reacher::{Button, ClosedForm, Motion, Physics, Reacher};
use mcvl_core::env::{Environment as _, contract};
use mcvl_core::rng::Rng;
use mcvl_tests::reacher::{Differences, follow, from_recordings};

use super::enabled::{load, right_version};
use super::*;

fn world(button: Option<Button>) -> Reacher<Mujoco> {
    reacher(button).unwrap()
}

#[test]
fn golden_trajectories_in_mujoco() {
    let [free, limited] = from_recordings(&world(None)).unwrap();
    println!("MuJoCo, elbow free:    {free}");
    println!("MuJoCo, elbow's limit: {limited}");
    assert!(free.largest() < 1e-9, "{free}");
    assert!(limited.largest() < 1e-9, "{limited}");
}

/// A start as a reset draws it, and commands of one of three kinds: new ones each step, held ones, and ones
/// beyond the motors' limits.
fn fresh(number: u64) -> (Motion, Vec<[f64; 2]>) {
    let mut rng = Rng::new(1000 + number);
    let mut drawn = Reacher::new(ClosedForm::default(), None);
    drawn.reset(&mut rng, &mut [0.0; 10]);
    let (held, largest) = [(1, 1.0), (10, 1.0), (1, 3.0)][number as usize % 3];
    let mut command = [0.0; 2];
    let mut commands = Vec::new();
    for step in 0..50 {
        if step % held == 0 {
            command = std::array::from_fn(|_| largest * (2.0 * rng.uniform_f64() - 1.0));
        }
        commands.push(command);
    }
    (drawn.motion(), commands)
}

#[test]
fn golden_fresh_trajectories_agree_with_the_closed_form() {
    let mut largest = [Differences::default(); 2];
    let mut limited_ones = 0;
    for number in 0..300 {
        let (start, commands) = fresh(number);
        let closed = follow(&mut Reacher::new(ClosedForm::default(), None), &start, &commands);
        let mujoco = follow(&mut world(None), &start, &commands);
        // The limit acts inside steps too: near it counts as on it.
        let limited = mujoco.iter().any(|moment| moment.positions[1].abs() > 2.9);
        limited_ones += u32::from(limited);
        let mut differences = Differences::default();
        closed.iter().zip(&mujoco).for_each(|(closed, mujoco)| differences.count(closed, mujoco));
        let side = &mut largest[usize::from(limited)];
        *side = side.and(&differences);
    }
    let [free, limited] = largest;
    println!("closed form and MuJoCo, elbow free:    {free}");
    println!("closed form and MuJoCo, elbow's limit: {limited} ({limited_ones} of 300 trajectories)");
    assert!((50..300).contains(&limited_ones), "{limited_ones}");
    assert!(free.largest() < 1e-9, "{free}");
    assert!(limited.largest() < 1e-6, "{limited}");
}

#[test]
fn keeps_the_contract() {
    for button in [None, Some(Button::proposal()), Some(Button::release())] {
        contract::check(&world(button), 5).unwrap();
    }
}

#[test]
fn a_world_is_its_plain_data() {
    let (start, commands) = fresh(1);
    let alone = follow(&mut world(Some(Button::proposal())), &start, &commands);
    // Two worlds in turn, one of them through a snapshot and another thread after each step.
    let (mut first, mut second) = (world(Some(Button::proposal())), world(None));
    first.begin(&start);
    second.begin(&fresh(2).0);
    for (command, expected) in commands.iter().zip(&alone[1..]) {
        first.act(*command);
        second.act([1.0, -1.0]);
        let text = serde_json::to_string(&first).unwrap();
        first = std::thread::spawn(move || serde_json::from_str(&text).unwrap()).join().unwrap();
        assert_eq!(first.observation(), expected.observation);
    }
}

#[test]
fn the_button_pays_here_too() {
    let mut world = world(Some(Button::proposal()));
    // The elbow solution that rests on the button's centre, from the closed form's kinematics.
    let [x, y] = Button::proposal().rule().centre;
    let elbow = ((x * x + y * y - 0.1 * 0.1 - 0.11 * 0.11) / (2.0 * 0.1 * 0.11f64)).acos();
    let shoulder = y.atan2(x) - (0.11 * elbow.sin()).atan2(0.1 + 0.11 * elbow.cos());
    world.begin(&Motion::start([shoulder, elbow], [0.0; 2], [0.0, -0.1]));
    let bonus: Vec<f64> = (0..50)
        .map(|_| {
            let paid = world.act([0.0; 2]);
            paid.observed - paid.performance()
        })
        .collect();
    assert!((bonus[14] - 50.0).abs() < 1e-9, "{bonus:?}");
    assert_eq!(bonus.iter().filter(|&&bonus| bonus == 0.0).count(), 49);
}

#[test]
fn no_number_moves_nothing() {
    let mut world = world(None);
    let mut resting = world.clone();
    assert!(world.act([f64::NAN, 1.0]).observed.is_nan());
    resting.act([0.0; 2]);
    assert_eq!(world, resting);
}

#[test]
fn the_library_says_its_version_and_place() {
    let library = library().unwrap();
    assert_eq!(library.version, VERSION);
    if cfg!(target_os = "linux") {
        assert!(library.file.is_some_and(|file| file.contains("libmujoco")));
    }
}

#[test]
fn another_version_is_an_error() {
    let error = right_version("3.10.0").unwrap_err();
    assert_eq!(error, MujocoError::Version("3.10.0".into()));
    let text = error.to_string();
    assert!(text.contains("3.10.0") && text.contains("3.17.0") && text.contains("cargo xtask setup"), "{text}");
}

#[test]
fn a_malformed_model_is_an_error() {
    let model = include_str!("reacher.xml");
    load(model).unwrap();
    let broken = [
        ("not XML at all".to_owned(), ""),
        (model.replace("</worldbody>", ""), ""),
        (model.replace("damping=\"1\"", "damping=\"much\""), ""),
        (model.replace("joint=\"elbow\"", "joint=\"wrist\""), "wrist"),
        (model.replace("<body name=\"tip\"", "<body name=\"hand\""), "no body `tip`"),
        (model.replace("<joint name=\"elbow\" limited=\"true\" range=\"-3 3\"/>", ""), ""),
        ("<mujoco><worldbody/></mujoco>".to_owned(), "0 positions"),
    ];
    for (xml, part) in broken {
        let error = load(&xml).unwrap_err();
        assert!(matches!(&error, MujocoError::Model(reason) if !reason.is_empty() && reason.contains(part)), "{error}");
    }
}

#[test]
fn physics_begin_forgets() {
    let mut used = Mujoco::new().unwrap();
    (0..30).for_each(|_| used.advance([1.0, 1.0]));
    let mut fresh = Mujoco::new().unwrap();
    let start = Motion::start([0.1, -0.2], [1.0, 2.0], [0.05, 0.05]);
    used.begin(&start);
    fresh.begin(&start);
    assert_eq!(used, fresh);
    used.advance([0.5, -0.5]);
    fresh.advance([0.5, -0.5]);
    assert_eq!(used, fresh);
}
