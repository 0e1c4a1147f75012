//! Runs made up for the tests of this folder: plausible numbers, and films that the real world played.

use std::path::PathBuf;

use mcvl_core::config::{Config, Preset};
use mcvl_core::digest::Digest;
use mcvl_core::env::box_moving::{BoxMoving, Variant};
use mcvl_core::env::reacher::{Button, ClosedForm, OBSERVATION, Reacher};
use mcvl_core::env::{ActionValue, Continuous, Discrete, EnvSpec, Environment};
use mcvl_core::record::{
    Arm, CheckRecord, EndRecord, EvaluationRecord, Film, FutureRecord, StartState, Subject, Verdict,
};
use mcvl_core::rng::{Purpose, Rng};

use crate::runs::{RunSet, SeedRun};

/// How the checked learner of a made-up seed ends; the plain one is always hacked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// At the best policy that does not hack.
    Intended,
    /// A hack slipped through, and it was hacked too.
    Missed,
    /// It refused honest transitions and kept the Safe policy.
    Stuck,
}

const POINTS: u32 = 50;
const STEPS: u32 = 1000;

/// The configuration of all made-up runs.
pub fn config() -> Config {
    Config::new("box-moving", Preset::Paper).expect("the experiment exists")
}

/// Facts of the world of all made-up runs.
pub fn spec() -> EnvSpec {
    BoxMoving::new(Variant::Full, true).spec().clone()
}

/// A run directory with one seed per outcome.
pub fn set(outcomes: &[Outcome]) -> RunSet {
    let seeds: Vec<SeedRun> =
        outcomes.iter().enumerate().map(|(index, outcome)| seed(index as u64, *outcome)).collect();
    let planned = seeds.iter().map(|seed| seed.seed).collect();
    RunSet { path: PathBuf::from("runs/box-moving"), config: config(), planned, seeds }
}

/// Ten seeds: eight as intended, one that missed a hack, one that stayed at the Safe policy.
pub fn ten() -> RunSet {
    let mut outcomes = [Outcome::Intended; 10];
    outcomes[3] = Outcome::Missed;
    outcomes[7] = Outcome::Stuck;
    set(&outcomes)
}

/// One seed with its three legs.
pub fn seed(seed: u64, outcome: Outcome) -> SeedRun {
    let mc_end = match outcome {
        Outcome::Intended => (49.0, 49.0),
        Outcome::Missed => (201.0, -49.0),
        Outcome::Stuck => (25.0, 25.0),
    };
    let mut rng = Rng::stream(seed, Purpose::Application, 1);
    let mut evaluations = leg(Arm::Safe, (0.0, 0.0), (25.0, 25.0), &mut rng);
    evaluations.extend(leg(Arm::Baseline, (25.0, 25.0), (201.0, -49.0), &mut rng));
    evaluations.extend(leg(Arm::Mc, (25.0, 25.0), mc_end, &mut rng));
    let arms = [Arm::Safe, Arm::Baseline, Arm::Mc];
    SeedRun {
        seed,
        path: PathBuf::from(format!("runs/box-moving/seed-{seed}")),
        evaluations,
        learner: Vec::new(),
        episodes: Vec::new(),
        checks: decisions(outcome),
        unchecked_hacks: Some(if outcome == Outcome::Missed { 7 } else { 0 }),
        ends: arms.map(|arm| EndRecord { arm, steps: STEPS, updates: 1900, digest: "00ff".into() }).into(),
        complete: true,
    }
}

/// A curve that moves from one pair (return, performance) to another at a random time.
fn leg(arm: Arm, from: (f64, f64), to: (f64, f64), rng: &mut Rng) -> Vec<EvaluationRecord> {
    let middle = 8.0 + 20.0 * rng.uniform_f64();
    let point = |index: u32| {
        let share = ((f64::from(index) - middle) / 6.0).clamp(0.0, 1.0);
        let between = |a: f64, b: f64| (a + (b - a) * share).round();
        EvaluationRecord {
            arm,
            step: index * STEPS / POINTS,
            observed_return: between(from.0, to.0),
            performance: between(from.1, to.1),
            length: 100.0,
        }
    };
    (0..=POINTS).map(point).collect()
}

fn decisions(outcome: Outcome) -> Vec<CheckRecord> {
    let mut checks: Vec<CheckRecord> = (1..=12).map(|number| check(number, true, Verdict::Refuse)).collect();
    checks[4] = check(5, false, Verdict::Accept);
    if outcome != Outcome::Intended {
        let wrong = if outcome == Outcome::Missed { (true, Verdict::Accept) } else { (false, Verdict::Refuse) };
        checks[8] = check(9, wrong.0, wrong.1);
        checks[8].tie = outcome == Outcome::Missed;
    }
    for check in &mut checks {
        *check = check.without_films();
    }
    checks
}

/// A check with films. Refused means that the modified future heads for the fake reward.
pub fn check(number: u32, hack: bool, verdict: Verdict) -> CheckRecord {
    let (room, down) = if hack { ((2, 3), true) } else { ((0, 0), true) };
    let mut world = BoxMoving::at(Variant::Full, true, room.0, room.1).expect("inside");
    let before = world.frame();
    let action = Discrete(u8::from(down));
    let step = world.step(&action, &mut Rng::new(0), &mut [0.0; 11]);
    let hacking = verdict == Verdict::Refuse;
    let modified = future(&world, if hacking { "ddud" } else { "uudu" });
    let unmodified = future(&world, "uudu");
    CheckRecord {
        arm: Arm::Mc,
        number,
        step: 37 * number,
        updates: 900 + 37 * u64::from(number),
        before,
        action: ActionValue::Discrete(action.0),
        after: world.frame(),
        end: step.end,
        reward_raw: step.reward,
        reward: spec().scaled(step.reward),
        predicted: 0.0173,
        threshold: 0.05,
        subject: Subject::Transition,
        margin: Some(modified.utility - unmodified.utility),
        modified: Some(modified),
        unmodified: Some(unmodified),
        verdict,
        replaced: None,
        tie: false,
        cost: 1000,
        reused: number > 1,
        performance: step.performance,
        hack,
    }
}

/// A check of the scheme `discard`: refused without a forecast.
pub fn discard(number: u32, hack: bool) -> CheckRecord {
    let bare = check(number, hack, Verdict::Refuse);
    CheckRecord { modified: None, unmodified: None, margin: None, cost: 0, reused: false, ..bare }
}

/// A check of the scheme `each-step`: of the update after a step.
pub fn update(number: u32, verdict: Verdict) -> CheckRecord {
    CheckRecord { subject: Subject::Update, cost: 0, reused: false, ..check(number, true, verdict) }
}

/// Facts of the world of [`reach`].
pub fn reach_spec() -> EnvSpec {
    Reacher::new(ClosedForm::default(), None).spec().clone()
}

/// A refused check of Reacher: one future sweeps to the hidden button, the other to the target.
pub fn reach(number: u32) -> CheckRecord {
    let mut world = Reacher::new(ClosedForm::default(), Some(Button::proposal()));
    world.reset(&mut Rng::new(u64::from(number)), &mut [0.0; OBSERVATION]);
    let sweep = |goal: [f64; 2]| FutureRecord {
        utility: -3.5 * goal[0],
        performance: -8.0,
        digest: "00ff".into(),
        rollouts: vec![-3.5 * goal[0]; 3],
        films: vec![swing(&world, goal)],
    };
    let (modified, unmodified) = (sweep([1.6, 1.2]), sweep([0.7, -0.9]));
    let mut film = modified.films[0].clone();
    let (before, after) = (film.frames.remove(30), film.frames.remove(30));
    CheckRecord {
        before,
        after,
        action: film.actions.remove(30),
        margin: Some(modified.utility - unmodified.utility),
        modified: Some(modified),
        unmodified: Some(unmodified),
        ..check(number, true, Verdict::Refuse)
    }
}

/// An episode in which the motors pull both angles to a goal, as springs with friction would.
fn swing(start: &Reacher, goal: [f64; 2]) -> Film {
    let mut world = start.clone();
    let (mut frames, mut actions, mut performance) = (vec![world.frame()], Vec::new(), Vec::new());
    for _ in 0..50 {
        let motion = world.motion();
        let pull = |joint: usize| 0.5 * (goal[joint] - motion.angles[joint]) - 0.1 * motion.velocities[joint];
        let action = [0, 1].map(|joint| pull(joint).clamp(-1.0, 1.0) as f32);
        let step = world.step(&Continuous(action), &mut Rng::new(0), &mut [0.0; OBSERVATION]);
        frames.push(world.frame());
        actions.push(ActionValue::Continuous(action.to_vec()));
        performance.push(step.performance);
    }
    let predicted = performance.clone();
    Film { start: StartState::Reset, frames, actions, predicted, performance, bootstrap: 0.0, utility: -3.5 * goal[0] }
}

fn future(current: &BoxMoving, script: &str) -> FutureRecord {
    let start = BoxMoving::new(Variant::Full, true);
    let films = vec![film(&start, script, StartState::Reset), film(current, script, StartState::Current)];
    let mut rollouts = vec![films[0].utility; 20];
    rollouts.push(films[1].utility);
    FutureRecord {
        utility: rollouts.iter().sum::<f64>() / rollouts.len() as f64,
        performance: films.iter().flat_map(|film| &film.performance).map(|&p| f64::from(p)).sum::<f64>() / 2.0,
        digest: format!("{:016x}", Digest::default().bytes(script.as_bytes()).finish()),
        rollouts,
        films,
    }
}

/// Plays a script whose last two actions repeat.
fn film(start: &BoxMoving, script: &str, from: StartState) -> Film {
    let mut world = start.clone();
    let letters: Vec<char> = script.chars().collect();
    let (mut frames, mut actions, mut steps) = (vec![world.frame()], Vec::new(), Vec::new());
    for index in 0..30 {
        let letter = if index < 4 { letters[index] } else { letters[2 + index % 2] };
        let action = Discrete(u8::from(letter == 'd'));
        steps.push(world.step(&action, &mut Rng::new(0), &mut [0.0; 11]));
        frames.push(world.frame());
        actions.push(ActionValue::Discrete(action.0));
    }
    let predicted: Vec<f32> = steps.iter().map(|step| 0.2 * step.performance).collect();
    let mut discount = 1.0;
    let mut utility = 0.0;
    for reward in &predicted {
        utility += discount * f64::from(*reward);
        discount *= 0.95;
    }
    let bootstrap = discount * 2.0 * f64::from(predicted.iter().sum::<f32>()).signum();
    let performance = steps.iter().map(|step| step.performance).collect();
    Film { start: from, frames, actions, predicted, performance, bootstrap, utility: utility + bootstrap }
}
