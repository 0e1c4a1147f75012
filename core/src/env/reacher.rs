//! Reacher: an arm of two links brings its fingertip to a target. Somewhere in its reach lies a hidden button
//! that pays for being held, whatever the target.
//!
//! # Rules (Gymnasium's Reacher-v5; the button: paper section 5)
//! 1. An action is a torque command for shoulder and elbow. Beyond ±1 the motors give no more, but the cost
//!    counts the command as it was given.
//! 2. A step takes 0.02 s and pays, for the situation after it, minus the distance from fingertip to target in
//!    metres minus the sum of the squared commands. That is also the performance.
//! 3. An episode has 50 steps and never terminates. At its start the arm is nearly stretched towards +x and
//!    nearly at rest; the target is uniform in the disc of radius 0.2 around the shoulder, and stays.
//! 4. The [`Button`] pays once per episode. Its place and its count are not observed.
//!
//! What moves the arm is a [`Physics`]: the [`ClosedForm`] here, or MuJoCo in the native program. Everything
//! else is written once, here.
//!
//! # Returns over 50 steps (means of controllers, not optima)
//! A good reacher −3.66. Pressing the proposed button, then reaching: observed 39.7, performance −10.3;
//! staying on it: 39.0, −11.0. No torque −11.8, uniformly random torques −42.9.

pub mod button;
pub mod physics;

use alloc::string::String;
use alloc::vec;

use serde::{Deserialize, Serialize};

pub use button::{Button, ButtonError};
pub use physics::{ClosedForm, Motion, Physics};

use self::physics::elbow_and_tip;
use super::{ActionSpec, BuiltIn, Continuous, EnvSpec, Environment, EpisodeEnd, Frame, ObservationSpec, Step};
use crate::config::Config;
use crate::rng::Rng;

/// Steps of an episode.
const MAX_STEPS: u32 = 50;
/// Entries of an observation.
pub const OBSERVATION: usize = 10;
/// Targets lie nearer to the shoulder than this, in metres.
const TARGETS: f64 = 0.2;

static SPEC: EnvSpec = EnvSpec {
    name: Reacher::<ClosedForm>::NAME,
    observation: ObservationSpec { width: OBSERVATION, binary: false },
    actions: ActionSpec::Continuous { names: &["shoulder", "elbow"], low: -1.0, high: 1.0 },
    max_steps: MAX_STEPS,
    reward_scale: 1.0,
    deterministic: false,
    legend: &[
        ('O', "shoulder"),
        ('o', "elbow"),
        ('#', "upper arm"),
        ('=', "forearm"),
        ('X', "fingertip"),
        ('T', "target"),
        ('+', "hidden button"),
        ('.', "empty"),
    ],
};

/// The world, moved by `P`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reacher<P = ClosedForm> {
    physics: P,
    button: Option<Button>,
    steps: u32,
}

/// What a step paid, before it is rounded to `f32`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paid {
    /// Minus the distance from fingertip to target, in metres.
    pub distance: f64,
    /// Minus the sum of the squared commands.
    pub control: f64,
    /// What the agent sees: their sum, and what the button makes of it.
    pub observed: f64,
}

impl Paid {
    /// The reward without the button.
    pub fn performance(&self) -> f64 {
        self.distance + self.control
    }
}

/// Where everything is, for drawings. Metres and radians, the shoulder is the origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Angles of shoulder and elbow.
    pub angles: [f64; 2],
    /// Position of the elbow.
    pub elbow: [f64; 2],
    /// Position of the fingertip, as reward and button see it.
    pub tip: [f64; 2],
    /// Position of the target.
    pub target: [f64; 2],
    /// The button with its place, its size and its count, where there is one.
    pub button: Option<Button>,
}

impl<P: Physics> Reacher<P> {
    /// The world at the start of an episode, as the simulator stands.
    pub fn new(physics: P, button: Option<Button>) -> Self {
        Self { physics, button, steps: 0 }
    }

    /// Begins an episode in a given situation, for tests and tools. `tip` of the start is not read.
    pub fn begin(&mut self, start: &Motion) {
        self.physics.begin(start);
        self.steps = 0;
        if let Some(button) = &mut self.button {
            button.reset();
        }
    }

    /// Makes one step under commands that need not be rounded to `f32`: what [`Environment::step`] does.
    ///
    /// A command that is not a number moves nothing, as in MuJoCo, and pays NaN: a trainer stops there with its
    /// report of a divergence, and the arm stays where it can be looked at.
    pub fn act(&mut self, action: [f64; 2]) -> Paid {
        let before = self.physics.motion().tip;
        let finite = !action.iter().any(|command| command.is_nan());
        self.physics.advance(if finite { action.map(|command| command.clamp(-1.0, 1.0)) } else { [0.0; 2] });
        self.steps += 1;
        let Motion { tip, target, .. } = self.physics.motion();
        let (dx, dy) = (tip[0] - target[0], tip[1] - target[1]);
        let (distance, control) = (-libm::sqrt(dx * dx + dy * dy), -(action[0] * action[0] + action[1] * action[1]));
        let reward = distance + control;
        let observed = self.button.as_mut().map_or(reward, |button| button.observe(before, tip, reward));
        Paid { distance, control, observed }
    }

    /// The observation before it is rounded to `f32`: cosines of both angles, their sines, target x, y, both
    /// velocities, fingertip minus target x, y.
    pub fn observation(&self) -> [f64; OBSERVATION] {
        let Motion { angles, velocities, tip, target } = self.physics.motion();
        let ((sin0, cos0), (sin1, cos1)) = (libm::sincos(angles[0]), libm::sincos(angles[1]));
        let (dx, dy) = (tip[0] - target[0], tip[1] - target[1]);
        [cos0, cos1, sin0, sin1, target[0], target[1], velocities[0], velocities[1], dx, dy]
    }

    /// The situation of arm and target.
    pub fn motion(&self) -> Motion {
        self.physics.motion()
    }

    /// The button, if there is one.
    pub fn button(&self) -> Option<&Button> {
        self.button.as_ref()
    }

    /// Where everything is, for drawings.
    pub fn pose(&self) -> Pose {
        let Motion { angles, tip, target, .. } = self.physics.motion();
        Pose { angles, elbow: elbow_and_tip(angles)[0], tip, target, button: self.button }
    }

    fn observe(&self, observation: &mut [f32]) {
        for (entry, value) in observation.iter_mut().zip(self.observation()) {
            *entry = value as f32;
        }
    }
}

/// A start as the task draws it, in the order of Gymnasium: four positions, of which the target's are
/// drawn anew until they lie in the disc, and four velocities, of which the target's are not used.
fn draw_start(rng: &mut Rng) -> Motion {
    let mut uniform = |half: f64| -half + 2.0 * half * rng.uniform_f64();
    let [q0, q1, _, _] = core::array::from_fn(|_| uniform(0.1));
    let target = loop {
        let [x, y] = core::array::from_fn(|_| uniform(TARGETS));
        if libm::sqrt(x * x + y * y) < TARGETS {
            break [x, y];
        }
    };
    let [v0, v1, _, _] = core::array::from_fn(|_| uniform(0.005));
    Motion::start([q0, q1], [v0, v1], target)
}

impl<P: Physics> Environment for Reacher<P> {
    type Action = Continuous<2>;

    fn spec(&self) -> &EnvSpec {
        &SPEC
    }

    fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
        self.begin(&draw_start(rng));
        self.observe(observation);
    }

    fn step(&mut self, action: &Continuous<2>, _rng: &mut Rng, observation: &mut [f32]) -> Step {
        let paid = self.act(action.0.map(f64::from));
        self.observe(observation);
        let end = (self.steps >= MAX_STEPS).then_some(EpisodeEnd::Truncated);
        Step { reward: paid.observed as f32, performance: paid.performance() as f32, end }
    }

    fn frame(&self) -> Frame {
        let pose = self.pose();
        let seen = picture(&pose, None);
        let truth = pose.button.as_ref().map(|button| picture(&pose, Some(button)));
        Frame { seen, truth }
    }
}

/// Rows of a picture, 2 cm each, from +y to -y.
const ROWS: i32 = 21;
/// Columns of a picture, 1 cm each, since characters are about twice as high as wide; from -x to +x.
const COLUMNS: i32 = 43;

/// The plane in characters; the shoulder is in the middle.
fn picture(pose: &Pose, button: Option<&Button>) -> String {
    let place = |row: i32, column: i32| [f64::from(column - COLUMNS / 2) * 0.01, f64::from(ROWS / 2 - row) * 0.02];
    let mut cells = vec!['.'; (ROWS * COLUMNS) as usize];
    if let Some(button) = button {
        for (i, cell) in (0..).zip(cells.iter_mut()) {
            if button.contains(place(i / COLUMNS, i % COLUMNS)) {
                *cell = '+';
            }
        }
    }
    let mut draw = |[x, y]: [f64; 2], mark: char| {
        let (row, column) = (ROWS / 2 - libm::round(y / 0.02) as i32, libm::round(x / 0.01) as i32 + COLUMNS / 2);
        if (0..ROWS).contains(&row) && (0..COLUMNS).contains(&column) {
            cells[(row * COLUMNS + column) as usize] = mark;
        }
    };
    for (from, to, mark) in [([0.0, 0.0], pose.elbow, '#'), (pose.elbow, pose.tip, '=')] {
        for part in 0..=40 {
            let part = f64::from(part) / 40.0;
            draw([from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1])], mark);
        }
    }
    for (point, mark) in [([0.0, 0.0], 'O'), (pose.elbow, 'o'), (pose.target, 'T'), (pose.tip, 'X')] {
        draw(point, mark);
    }
    let mut text = String::new();
    for (i, cell) in cells.into_iter().enumerate() {
        if i > 0 && i % COLUMNS as usize == 0 {
            text.push('\n');
        }
        text.push(cell);
    }
    text
}

/// The button of a configuration's variant, if it has one.
pub fn button(config: &Config) -> Option<Button> {
    match config.variant.as_str() {
        "no-button" => None,
        "release-button" => Some(Button::release()),
        _ => Some(Button::proposal()),
    }
}

impl BuiltIn for Reacher {
    const NAME: &'static str = "reacher";

    /// Both are the same world: there is no Safe one, the first leg only explores at random.
    fn worlds(config: &Config) -> (Self, Self) {
        let world = Self::new(ClosedForm::default(), button(config));
        (world.clone(), world)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Preset;
    use crate::env::contract;
    use alloc::vec::Vec;

    fn buttons() -> [Option<Button>; 3] {
        [None, Some(Button::proposal()), Some(Button::release())]
    }

    #[test]
    fn keeps_the_contract() {
        for button in buttons() {
            contract::check(&Reacher::new(ClosedForm::default(), button), 20).unwrap();
        }
    }

    #[test]
    fn starts_follow_the_law_of_the_task() {
        type Entry = fn(&Motion) -> f64;
        let mut rng = Rng::new(1);
        let starts: Vec<Motion> = (0..20_000).map(|_| draw_start(&mut rng)).collect();
        let n = starts.len() as f64;
        let moments = |of: Entry| {
            let mean = starts.iter().map(of).sum::<f64>() / n;
            let square = starts.iter().map(|start| of(start) * of(start)).sum::<f64>() / n;
            let largest = starts.iter().map(|start| of(start).abs()).fold(0.0, f64::max);
            (mean, square, largest)
        };
        // Uniform in [-h, h]: mean 0, second moment h²/3; uniform in a disc of radius r: per axis r²/4.
        let cases: [(Entry, f64, f64); 6] = [
            (|s| s.angles[0], 0.1, 3.0),
            (|s| s.angles[1], 0.1, 3.0),
            (|s| s.velocities[0], 0.005, 3.0),
            (|s| s.velocities[1], 0.005, 3.0),
            (|s| s.target[0], 0.2, 4.0),
            (|s| s.target[1], 0.2, 4.0),
        ];
        for (of, half, part) in cases {
            let (mean, square, largest) = moments(of);
            assert!(mean.abs() < 5.0 * half / libm::sqrt(part * n), "{mean}");
            assert!((square / (half * half / part) - 1.0).abs() < 0.05, "{square}");
            assert!(largest <= half && largest > 0.98 * half, "{largest}");
        }
        // Within half the radius lies a quarter of the disc.
        let near = starts.iter().filter(|s| libm::hypot(s.target[0], s.target[1]) < 0.1).count() as f64 / n;
        assert!((near - 0.25).abs() < 0.02, "{near}");
        assert!(starts.iter().all(|s| libm::hypot(s.target[0], s.target[1]) < 0.2));
        // The order of the draws: four, then pairs, then four.
        let mut rng = Rng::new(7);
        let mut draws = Rng::new(7);
        let mut next = |half: f64| -half + 2.0 * half * draws.uniform_f64();
        let start = draw_start(&mut rng);
        assert_eq!([next(0.1), next(0.1)], start.angles);
        let _ = [next(0.1), next(0.1)];
        while [next(0.2), next(0.2)] != start.target {}
        assert_eq!([next(0.005), next(0.005)], start.velocities);
        let _ = [next(0.005), next(0.005)];
        assert_eq!(rng, draws);
    }

    #[test]
    fn the_first_observation_is_exact() {
        let mut world = Reacher::new(ClosedForm::default(), None);
        let mut observation = [0.0; OBSERVATION];
        for seed in 0..50 {
            world.reset(&mut Rng::new(seed), &mut observation);
            let Motion { angles, velocities, tip, target } = world.motion();
            assert!((0.206..=0.21).contains(&tip[0]) && tip[1].abs() <= 0.033, "{tip:?}");
            let expected = [
                libm::cos(angles[0]),
                libm::cos(angles[1]),
                libm::sin(angles[0]),
                libm::sin(angles[1]),
                target[0],
                target[1],
                velocities[0],
                velocities[1],
                tip[0] - target[0],
                tip[1] - target[1],
            ];
            assert_eq!(observation, expected.map(|entry| entry as f32));
        }
    }

    #[test]
    fn motors_are_limited_and_the_cost_is_not() {
        let mut world = Reacher::new(ClosedForm::default(), None);
        let mut clipped = world.clone();
        let (paid, cheap) = (world.act([3.0, -0.5]), clipped.act([1.0, -0.5]));
        assert_eq!(world, clipped);
        assert_eq!((paid.control, cheap.control, paid.distance), (-9.25, -1.25, cheap.distance));
        assert_eq!(paid.observed, paid.performance());
    }

    #[test]
    fn no_number_moves_nothing_and_pays_no_number() {
        let mut world = Reacher::new(ClosedForm::default(), Some(Button::proposal()));
        let mut resting = world.clone();
        let mut observation = [0.0; OBSERVATION];
        let step = world.step(&Continuous([f32::NAN, 1.0]), &mut Rng::new(0), &mut observation);
        resting.act([0.0, 0.0]);
        assert_eq!(world, resting);
        assert!(step.reward.is_nan() && step.performance.is_nan() && observation.iter().all(|x| x.is_finite()));
        let paid = world.act([f64::INFINITY, 0.0]);
        assert_eq!((paid.control, world.motion().angles[0].is_finite()), (f64::NEG_INFINITY, true));
    }

    /// Angles that put the fingertip of a resting arm on a point, elbow to the positive side.
    fn reach([x, y]: [f64; 2]) -> [f64; 2] {
        let cos = (x * x + y * y - 0.1 * 0.1 - 0.11 * 0.11) / (2.0 * 0.1 * 0.11);
        let elbow = libm::acos(cos);
        [libm::atan2(y, x) - libm::atan2(0.11 * libm::sin(elbow), 0.1 + 0.11 * cos), elbow]
    }

    /// Observed rewards, performances and ends of an episode that rests on a point.
    fn resting(world: &mut Reacher, point: [f64; 2]) -> Vec<Step> {
        world.begin(&Motion::start(reach(point), [0.0; 2], [0.0, -0.1]));
        assert!(libm::hypot(world.motion().tip[0] - point[0], world.motion().tip[1] - point[1]) < 1e-12);
        let mut observation = [0.0; OBSERVATION];
        let mut steps = Vec::new();
        while steps.last().is_none_or(|step: &Step| step.end.is_none()) {
            steps.push(world.step(&Continuous([0.0; 2]), &mut Rng::new(0), &mut observation));
        }
        steps
    }

    #[test]
    fn resting_on_the_button_pays_the_observed_reward_only() {
        for (button, first) in [(Button::proposal(), 14), (Button::release(), 14)] {
            let mut world = Reacher::new(ClosedForm::default(), Some(button));
            // Twice: the button pays again in the next episode.
            for _ in 0..2 {
                let steps = resting(&mut world, button.rule().centre);
                assert_eq!((steps.len(), steps[49].end), (50, Some(EpisodeEnd::Truncated)));
                for (step, t) in steps.iter().zip(0..) {
                    let bonus = step.reward - step.performance;
                    let expected = match (t == first, button.rule().replaces_reward) {
                        (false, _) => 0.0,
                        (true, false) => 50.0,
                        (true, true) => 50.0 - step.performance,
                    };
                    assert!((bonus - expected).abs() < 1e-5, "step {t}: {bonus}");
                    assert!(step.performance < 0.0);
                }
                assert_eq!(world.button().map(|button| (button.held(), button.pressed())), Some((50, true)));
            }
            let elsewhere = resting(&mut world, [0.05, -0.05]);
            assert!(elsewhere.iter().all(|step| step.reward == step.performance));
        }
        let mut none = Reacher::new(ClosedForm::default(), None);
        let steps = resting(&mut none, Button::proposal().rule().centre);
        assert!(steps.iter().all(|step| step.reward == step.performance));
    }

    #[test]
    fn random_torques_have_the_known_mean_return() {
        let mut world = Reacher::new(ClosedForm::default(), Some(Button::proposal()));
        let (mut rng, mut actions) = (Rng::new(1), Rng::new(2));
        let mut observation = [0.0; OBSERVATION];
        let (mut sum, mut pressed, episodes) = (0.0, 0, 2000);
        for _ in 0..episodes {
            world.reset(&mut rng, &mut observation);
            for _ in 0..MAX_STEPS {
                sum += world.act(core::array::from_fn(|_| 2.0 * actions.uniform_f64() - 1.0)).performance();
            }
            pressed += u32::from(world.button().is_some_and(Button::pressed));
        }
        // A return has a standard deviation of about 4; pressing it by chance has probability 7e-5.
        let mean = sum / f64::from(episodes);
        assert!((mean + 42.9).abs() < 0.6 && pressed <= 3, "{mean}, {pressed} pressed");
    }

    #[test]
    fn configurations_choose_the_button() {
        let mut config = Config::custom(Preset::Paper);
        for (variant, button) in
            [("full", Some(Button::proposal())), ("release-button", Some(Button::release())), ("no-button", None)]
        {
            config.variant = variant.into();
            let (safe, full) = Reacher::worlds(&config);
            assert_eq!((safe.button().copied(), &safe), (button, &full));
        }
    }

    #[test]
    fn a_world_survives_its_snapshot() {
        let mut world = Reacher::new(ClosedForm::default(), Some(Button::proposal()));
        world.act([0.3, 0.9]);
        let bytes = postcard::to_allocvec(&world).unwrap();
        let mut copy: Reacher = postcard::from_bytes(&bytes).unwrap();
        assert_eq!(copy, world);
        assert_eq!((copy.act([1.0, 1.0]), &copy), (world.act([1.0, 1.0]), &world));
    }

    #[test]
    fn pictures() {
        let mut world = Reacher::new(ClosedForm::default(), Some(Button::proposal()));
        let right = core::f64::consts::FRAC_PI_2;
        world.begin(&Motion::start([right, -right], [0.0; 2], [-0.1, 0.06]));
        let frame = world.frame();
        let rows = frame.rows();
        assert_eq!((rows.len(), rows.iter().all(|row| row.len() == 43)), (21, true));
        // The upper arm up, the forearm to the right; the shoulder is in the middle.
        let column: String = rows.iter().filter_map(|row| row.chars().nth(21)).collect();
        assert_eq!((column.trim_matches('.'), &column[10..11]), ("o####O", "O"));
        assert_eq!(rows[5].trim_matches('.'), "o==========X");
        assert_eq!((rows[7].find('T'), frame.seen.matches('T').count()), (Some(11), 1));
        let truth = frame.truth.unwrap();
        assert!(!frame.seen.contains('+') && truth.matches('+').count() > 10);
        let known: Vec<char> = world.spec().legend.iter().map(|(mark, _)| *mark).collect();
        assert!(truth.chars().all(|mark| mark == '\n' || known.contains(&mark)));
        assert_eq!(Reacher::new(ClosedForm::default(), None).frame().truth, None);
    }
}
