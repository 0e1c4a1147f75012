//! The hidden button of Reacher: a small disc that pays for holding the fingertip in it. Nothing that the
//! agent sees says where it is, whether it is held or whether it was pressed.

use core::fmt;

use serde::{Deserialize, Serialize};

use super::MAX_STEPS;
use super::physics::{FOREARM, UPPER_ARM};

/// Where a button is and what it takes to press it. Lengths are in metres, the shoulder is the origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rule {
    /// Centre, at most [`REACH`] from the shoulder.
    pub centre: [f64; 2],
    /// The fingertip is inside where it is nearer to the centre than this; above 0.
    pub radius: f64,
    /// Steps inside that press it, 1 to 50.
    pub hold: u32,
    /// Whether leaving it begins the count anew.
    pub consecutive: bool,
    /// Which fingertip counts for a step: the one after the movement, or the one before it.
    pub after_step: bool,
    /// What pressing pays, once per episode, raw.
    pub bonus: f64,
    /// Whether the bonus takes the place of the step's reward instead of being added to it.
    pub replaces_reward: bool,
}

/// The farthest that the fingertip can be from the shoulder, in metres.
pub const REACH: f64 = UPPER_ARM + FOREARM;

impl Rule {
    /// This project's button: every property that the paper states, at a place
    /// which a good reacher crosses when the target is near it, and random torques practically never hold.
    pub const PROPOSAL: Self = Self {
        centre: [-0.09, 0.10],
        radius: 0.03,
        hold: 15,
        consecutive: true,
        after_step: true,
        bonus: 50.0,
        replaces_reward: false,
    };

    /// The button of the authors' release: beside the stretched start pose, counted before the movement and
    /// over the whole episode, and paid in place of the reward.
    pub const RELEASE: Self = Self {
        centre: [0.20787346, 0.0270863],
        radius: 0.01,
        hold: 15,
        consecutive: false,
        after_step: false,
        bonus: 50.0,
        replaces_reward: true,
    };
}

/// Why there can be no such button.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum ButtonError {
    /// A length or the bonus is not a finite number.
    NotFinite,
    /// The radius is not above 0.
    Radius(f64),
    /// The centre is this far from the shoulder, more than [`REACH`].
    OutOfReach(f64),
    /// It takes no step at all, or more than an episode has.
    Hold(u32),
}

impl fmt::Display for ButtonError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "a button's centre, radius and bonus have to be finite numbers"),
            Self::Radius(radius) => write!(f, "a button of radius {radius} cannot be entered: take one above 0"),
            Self::OutOfReach(distance) => {
                write!(f, "the button's centre is {distance} m from the shoulder, and the arm reaches {REACH:.2} m")
            }
            Self::Hold(steps) => write!(f, "a button is held for 1 to {MAX_STEPS} steps, not for {steps}"),
        }
    }
}

impl core::error::Error for ButtonError {}

/// A button and how far the episode has come with it. Plain data: a fork or a snapshot of a world has its own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Button {
    rule: Rule,
    held: u32,
    pressed: bool,
}

impl Button {
    /// A button by its rule, not touched yet.
    ///
    /// # Errors
    /// If no fingertip could ever press it, or its numbers are none.
    pub fn new(rule: Rule) -> Result<Self, ButtonError> {
        let [x, y] = rule.centre;
        if ![x, y, rule.radius, rule.bonus].iter().all(|number| number.is_finite()) {
            return Err(ButtonError::NotFinite);
        }
        if rule.radius <= 0.0 {
            return Err(ButtonError::Radius(rule.radius));
        }
        let distance = libm::sqrt(x * x + y * y);
        if distance > REACH {
            return Err(ButtonError::OutOfReach(distance));
        }
        if !(1..=MAX_STEPS).contains(&rule.hold) {
            return Err(ButtonError::Hold(rule.hold));
        }
        Ok(Self::untouched(rule))
    }

    const fn untouched(rule: Rule) -> Self {
        Self { rule, held: 0, pressed: false }
    }

    /// [`Rule::PROPOSAL`].
    pub const fn proposal() -> Self {
        Self::untouched(Rule::PROPOSAL)
    }

    /// [`Rule::RELEASE`].
    pub const fn release() -> Self {
        Self::untouched(Rule::RELEASE)
    }

    /// Its rule.
    pub fn rule(&self) -> &Rule {
        &self.rule
    }

    /// Steps counted in this episode (since it was last left, where they have to be consecutive).
    pub fn held(&self) -> u32 {
        self.held
    }

    /// Whether it paid in this episode.
    pub fn pressed(&self) -> bool {
        self.pressed
    }

    /// Whether a fingertip there is inside.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        let (dx, dy) = (x - self.rule.centre[0], y - self.rule.centre[1]);
        libm::sqrt(dx * dx + dy * dy) < self.rule.radius
    }

    /// An episode begins.
    pub fn reset(&mut self) {
        *self = Self::untouched(self.rule);
    }

    /// A step led from one fingertip to another: counts it, and makes the observed reward of the step out of
    /// the one without a button.
    pub fn observe(&mut self, before: [f64; 2], after: [f64; 2], reward: f64) -> f64 {
        let inside = self.contains(if self.rule.after_step { after } else { before });
        self.held = match inside {
            true => self.held.saturating_add(1),
            false if self.rule.consecutive => 0,
            false => self.held,
        };
        if self.pressed || self.held < self.rule.hold {
            return reward;
        }
        self.pressed = true;
        if self.rule.replaces_reward { self.rule.bonus } else { reward + self.rule.bonus }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::string::ToString;
    use alloc::vec::Vec;

    const IN: [f64; 2] = [-0.09, 0.11];
    const OUT: [f64; 2] = [0.2, 0.0];

    /// Observed rewards of steps that end inside or outside, each worth -1 without the button.
    fn rewards(button: &mut Button, inside: impl IntoIterator<Item = bool>) -> Vec<f64> {
        let place = |inside| if inside { IN } else { OUT };
        let mut before = OUT;
        let step = |inside| {
            let after = place(inside);
            let reward = button.observe(before, after, -1.0);
            before = after;
            reward
        };
        inside.into_iter().map(step).collect()
    }

    #[test]
    fn fifteen_consecutive_steps_pay_once() {
        let mut button = Button::proposal();
        let seen = rewards(&mut button, [true; 50]);
        assert_eq!(seen[14], 49.0);
        assert_eq!(seen.iter().filter(|&&reward| reward == -1.0).count(), 49);
        assert!(button.pressed());
        // Leaving and holding again pays nothing in the same episode, and again in the next.
        assert!(rewards(&mut button, (0..50).map(|t| t > 5)).iter().all(|&reward| reward == -1.0));
        button.reset();
        assert_eq!((button.held(), button.pressed()), (0, false));
        assert_eq!(rewards(&mut button, [true; 15])[14], 49.0);
    }

    #[test]
    fn leaving_begins_the_count_anew() {
        let mut button = Button::proposal();
        // 14 steps, one outside, 14 steps, one outside: never 15 in a row.
        assert!(rewards(&mut button, (1..=30).map(|t| t % 15 != 0)).iter().all(|&reward| reward == -1.0));
        assert_eq!(button.held(), 0);
        let seen = rewards(&mut button, [true; 15]);
        assert_eq!((seen[13], seen[14]), (-1.0, 49.0));
        // A new episode in the middle of a hold.
        button.reset();
        rewards(&mut button, [true; 10]);
        button.reset();
        assert_eq!(rewards(&mut button, [true; 14]), [-1.0; 14]);
    }

    #[test]
    fn the_release_counts_cumulatively_before_the_step_and_sets_the_reward() {
        let rule = Rule { centre: Rule::PROPOSAL.centre, radius: Rule::PROPOSAL.radius, ..Rule::RELEASE };
        let mut button = Button::new(rule).unwrap();
        // Every second step ends inside; the step behind it is counted. The 15th such step is number 30.
        let seen = rewards(&mut button, (0..50).map(|t| t % 2 == 0));
        assert_eq!(seen.iter().position(|&reward| reward == 50.0), Some(29));
        assert_eq!(seen.iter().filter(|&&reward| reward == -1.0).count(), 49);
        // The first step begins outside.
        button.reset();
        let seen = rewards(&mut button, [true; 20]);
        assert_eq!(seen.iter().position(|&reward| reward == 50.0), Some(15));
        assert_eq!((Button::release().rule().radius, Button::release().rule().hold), (0.01, 15));
    }

    #[test]
    fn the_edge_is_outside() {
        let rule = Rule { centre: [0.125, 0.0], radius: 0.0625, ..Rule::PROPOSAL };
        let button = Button::new(rule).unwrap();
        assert!(!button.contains([0.1875, 0.0]) && button.contains([0.1874, 0.0]));
        assert!(!button.contains([f64::NAN, 0.0]));
    }

    #[test]
    fn impossible_buttons_are_refused() {
        let at = |centre| Rule { centre, ..Rule::PROPOSAL };
        let error = |rule| Button::new(rule).unwrap_err().to_string();
        assert!(error(at([0.2, 0.1])).contains("the arm reaches 0.21 m"), "{}", error(at([0.2, 0.1])));
        for radius in [0.0, -0.01] {
            assert!(error(Rule { radius, ..Rule::PROPOSAL }).contains("radius"));
        }
        for rule in [at([f64::NAN, 0.0]), at([0.0, f64::INFINITY]), Rule { radius: f64::NAN, ..Rule::PROPOSAL }] {
            assert_eq!(Button::new(rule), Err(ButtonError::NotFinite));
        }
        assert_eq!(Button::new(Rule { bonus: f64::NAN, ..Rule::PROPOSAL }), Err(ButtonError::NotFinite));
        for hold in [0, 51] {
            assert_eq!(Button::new(Rule { hold, ..Rule::PROPOSAL }), Err(ButtonError::Hold(hold)));
        }
        for rule in [Rule::PROPOSAL, Rule::RELEASE] {
            assert_eq!(Button::new(rule).unwrap().rule(), &rule);
        }
    }
}
