//! Recorded trajectories of Reacher (see `tests/data/README.md`), and how far a simulator is from them.

use std::fmt;

use anyhow::{Result, ensure};
use mcvl_core::env::reacher::{Motion, OBSERVATION, Physics, Reacher};
use serde::Deserialize;

use crate::golden::lines;

/// One recorded trajectory. Units: metres, radians, seconds.
#[derive(Debug, Deserialize)]
pub struct Trajectory {
    /// Its name.
    pub id: String,
    /// Whether the elbow's limit acted at the end of some step.
    pub touches_joint1_limit: bool,
    /// Shoulder, elbow, target x, y at the start.
    pub qpos0: [f64; 4],
    /// Their velocities.
    pub qvel0: [f64; 4],
    /// The first observation.
    pub obs0: [f64; OBSERVATION],
    /// The fingertip at the start.
    pub fingertip0: [f64; 3],
    /// Commands of every step, not clipped.
    pub actions: Vec<[f64; 2]>,
    /// Positions after every step.
    pub qpos: Vec<[f64; 4]>,
    /// Velocities after every step.
    pub qvel: Vec<[f64; 4]>,
    /// Observations after every step.
    pub obs: Vec<[f64; OBSERVATION]>,
    /// Rewards.
    pub reward: Vec<f64>,
    /// Their part for the distance.
    pub reward_dist: Vec<f64>,
    /// Their part for the commands.
    pub reward_ctrl: Vec<f64>,
    /// Positions of the fingertip as the simulator reported them.
    pub fingertip: Vec<[f64; 3]>,
}

/// Every recorded trajectory.
///
/// # Errors
/// If the file is not there or cannot be understood, or a trajectory is not complete.
pub fn trajectories() -> Result<Vec<Trajectory>> {
    let all: Vec<Trajectory> = lines("reacher_golden.jsonl.gz", |line| serde_json::from_str(line).map(Some))?;
    for t in &all {
        let lengths = [t.qpos.len(), t.qvel.len(), t.obs.len(), t.reward.len(), t.reward_dist.len()];
        let lengths = lengths.into_iter().chain([t.reward_ctrl.len(), t.fingertip.len()]);
        let steps = t.actions.len();
        ensure!(steps > 0 && lengths.into_iter().all(|length| length == steps), "{} is not complete", t.id);
    }
    Ok(all)
}

/// A world's way through a trajectory, in the recording's terms.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Shoulder, elbow, target x, y.
    pub positions: [f64; 4],
    /// Velocities of shoulder and elbow; the target's are 0.
    pub velocities: [f64; 4],
    /// Observation.
    pub observation: [f64; OBSERVATION],
    /// Reward and its parts for distance and commands; none at the start.
    pub reward: [f64; 3],
    /// The reported fingertip.
    pub tip: [f64; 2],
}

/// Leads a world from a start through a series of commands: what it shows at the start and after each step.
pub fn follow<P: Physics>(world: &mut Reacher<P>, start: &Motion, actions: &[[f64; 2]]) -> Vec<Moment> {
    let moment = |world: &Reacher<P>, reward| {
        let Motion { angles: [q0, q1], velocities: [v0, v1], tip, target: [x, y] } = world.motion();
        let (positions, velocities) = ([q0, q1, x, y], [v0, v1, 0.0, 0.0]);
        Moment { positions, velocities, observation: world.observation(), reward, tip }
    };
    world.begin(start);
    let mut moments = vec![moment(world, [0.0; 3])];
    for action in actions {
        let paid = world.act(*action);
        moments.push(moment(world, [paid.performance(), paid.distance, paid.control]));
    }
    moments
}

/// Largest differences, each relative to the larger of 1 and the reference. A value that is no number counts
/// as infinitely far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Differences {
    /// Of angles and target.
    pub positions: f64,
    /// Of velocities.
    pub velocities: f64,
    /// Of observations.
    pub observation: f64,
    /// Of the reward and its parts.
    pub reward: f64,
    /// Of the fingertip.
    pub tip: f64,
}

fn raise(largest: &mut f64, pairs: impl IntoIterator<Item = (f64, f64)>) {
    for (value, reference) in pairs {
        let difference = (value - reference).abs() / reference.abs().max(1.0);
        // `max` would pass over what is no number.
        *largest = if difference.is_nan() { f64::INFINITY } else { largest.max(difference) };
    }
}

impl Differences {
    /// Takes in a moment and its reference.
    pub fn count(&mut self, moment: &Moment, reference: &Moment) {
        raise(&mut self.positions, moment.positions.into_iter().zip(reference.positions));
        raise(&mut self.velocities, moment.velocities.into_iter().zip(reference.velocities));
        raise(&mut self.observation, moment.observation.into_iter().zip(reference.observation));
        raise(&mut self.reward, moment.reward.into_iter().zip(reference.reward));
        raise(&mut self.tip, moment.tip.into_iter().zip(reference.tip));
    }

    /// Takes in another's.
    #[must_use]
    pub fn and(&self, other: &Self) -> Self {
        Self {
            positions: self.positions.max(other.positions),
            velocities: self.velocities.max(other.velocities),
            observation: self.observation.max(other.observation),
            reward: self.reward.max(other.reward),
            tip: self.tip.max(other.tip),
        }
    }

    /// The largest of all.
    pub fn largest(&self) -> f64 {
        [self.positions, self.velocities, self.observation, self.reward, self.tip].into_iter().fold(0.0, f64::max)
    }
}

impl fmt::Display for Differences {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { positions, velocities, observation, reward, tip } = self;
        write!(
            f,
            "positions {positions:.1e}, velocities {velocities:.1e}, observation {observation:.1e}, reward \
             {reward:.1e}, fingertip {tip:.1e}"
        )
    }
}

impl Trajectory {
    /// The situation at its start.
    pub fn start(&self) -> Motion {
        let ([q0, q1, x, y], [v0, v1, ..]) = (self.qpos0, self.qvel0);
        Motion::start([q0, q1], [v0, v1], [x, y])
    }

    /// How far a world is from the recording.
    pub fn differences<P: Physics>(&self, world: &mut Reacher<P>) -> Differences {
        let moments = follow(world, &self.start(), &self.actions);
        let flat = |[x, y, _]: [f64; 3]| [x, y];
        let first = Moment {
            positions: self.qpos0,
            velocities: self.qvel0,
            observation: self.obs0,
            reward: [0.0; 3],
            tip: flat(self.fingertip0),
        };
        let steps = (0..self.actions.len()).map(|t| Moment {
            positions: self.qpos[t],
            velocities: self.qvel[t],
            observation: self.obs[t],
            reward: [self.reward[t], self.reward_dist[t], self.reward_ctrl[t]],
            tip: flat(self.fingertip[t]),
        });
        let mut differences = Differences::default();
        for (moment, reference) in moments.iter().zip(std::iter::once(first).chain(steps)) {
            differences.count(moment, &reference);
        }
        differences
    }
}

/// Largest differences of a world from all recordings, without and with the elbow's limit.
///
/// # Errors
/// If the recordings cannot be read.
pub fn from_recordings<P: Physics>(world: &Reacher<P>) -> Result<[Differences; 2]> {
    let mut largest = [Differences::default(); 2];
    for trajectory in trajectories()? {
        let side = &mut largest[usize::from(trajectory.touches_joint1_limit)];
        *side = side.and(&trajectory.differences(&mut world.clone()));
    }
    Ok(largest)
}
