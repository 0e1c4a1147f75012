//! Runs in every world that this program has: core's own, and Reacher in MuJoCo where it is linked.

use std::fmt;

use mcvl_core::agent::td3::Td3;
use mcvl_core::config::{Config, Simulator};
use mcvl_core::env::reacher::{self, Reacher};
use mcvl_core::env::{ActionSpec, EnvSpec};
use mcvl_core::run::{Run, SnapshotError};
use mcvl_core::trainer::Trainer;

use crate::mujoco::{self, Mujoco, MujocoError};

/// Name in snapshots.
const REACHER: &str = "reacher in MuJoCo";

/// Why there is no run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WorldError {
    /// MuJoCo cannot be used here.
    Mujoco(MujocoError),
    /// The bytes are no snapshot.
    Snapshot(SnapshotError),
}

impl fmt::Display for WorldError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mujoco(error) => write!(f, "physics=mujoco: {error}; or take physics=closed-form"),
            Self::Snapshot(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for WorldError {}

/// The simulator that a run of this world has unless it is told another: MuJoCo for Reacher, where it is linked.
pub fn default_simulator(env: &str) -> Simulator {
    if env == "reacher" && mujoco::library().is_ok() { Simulator::Mujoco } else { Simulator::ClosedForm }
}

/// Whether the world of a configuration can be had here.
///
/// # Errors
/// If it is MuJoCo's, and MuJoCo is not linked or has another version.
pub fn available(config: &Config) -> Result<(), WorldError> {
    match config.physics {
        Simulator::ClosedForm => Ok(()),
        Simulator::Mujoco => mujoco::library().map(drop).map_err(WorldError::Mujoco),
    }
}

/// A run from its beginning.
///
/// # Errors
/// See [`available`].
pub fn begin(config: &Config) -> Result<Run, WorldError> {
    match config.physics {
        Simulator::ClosedForm => Ok(Run::new(config)),
        Simulator::Mujoco => {
            let world = mujoco::reacher(reacher::button(config)).map_err(WorldError::Mujoco)?;
            Ok(Run::of(REACHER, Trainer::continuous(config.clone(), world.clone(), world)))
        }
    }
}

/// Continues from a snapshot.
///
/// # Errors
/// If the bytes are no snapshot, or one of MuJoCo's world where there is none.
pub fn resume(bytes: &[u8]) -> Result<Run, WorldError> {
    match Run::resume(bytes) {
        Err(SnapshotError::World(name)) if name == REACHER => {
            mujoco::library().map_err(WorldError::Mujoco)?;
            Run::resume_of::<Reacher<Mujoco>, Td3<2>>(REACHER, bytes).map_err(WorldError::Snapshot)
        }
        result => result.map_err(WorldError::Snapshot),
    }
}

/// Facts of the world of a configuration: the same in every simulator.
pub fn spec(config: &Config) -> EnvSpec {
    Run::new(&Config { physics: Simulator::ClosedForm, ..config.clone() }).spec().clone()
}

/// Names of the actions, or of the numbers of one, in order.
pub fn actions(spec: &EnvSpec) -> &'static [&'static str] {
    match spec.actions {
        ActionSpec::Discrete(names) | ActionSpec::Continuous { names, .. } => names,
    }
}

/// What the numbers of an observation are, in order.
pub fn observation(spec: &EnvSpec) -> String {
    match spec.name {
        "box-moving" => {
            let flag = if spec.observation.width > 10 { "; 0 in Safe, else 1" } else { "" };
            format!("the cell of the box, from the top, as one-hot of 5; the agent's cell, the same{flag}")
        }
        "reacher" => {
            let angles = "cosines of shoulder and elbow, their sines";
            format!("{angles}, target x and y, both angular velocities, fingertip minus target x and y")
        }
        _ => {
            // The meaning of a character without what it pays.
            let meaning = |text: &'static str| text.split(':').next().unwrap_or(text);
            let codes: Vec<_> = spec.legend.iter().map(|(code, text)| format!("`{code}` {}", meaning(text))).collect();
            let (cells, kinds) = (spec.observation.width / codes.len().max(1), codes.len());
            format!("for each of {cells} cells, row by row, one-hot of {kinds}: {}", codes.join("; "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvl_core::run::Budget;

    fn config(text: &str) -> Config {
        format!("env=reacher safe_steps=40 exploration=40 learning_starts=20 batch=16 hidden=8 {text}").parse().unwrap()
    }

    #[test]
    fn core_does_not_take_a_snapshot_of_another_world_for_its_own() {
        let mut run = begin(&config("")).unwrap();
        run.poll(Budget(30), &mut ()).unwrap();
        let bytes = run.snapshot();
        assert_eq!(resume(&bytes).unwrap().progress(), run.progress());
        assert_eq!(spec(&config("physics=mujoco")), spec(&config("")));
    }

    #[test]
    #[cfg(feature = "mujoco")]
    fn runs_in_mujoco_resume_and_differ_from_those_in_closed_form_by_little() {
        assert_eq!(default_simulator("reacher"), Simulator::Mujoco);
        assert_eq!(default_simulator("box-moving"), Simulator::ClosedForm);
        let mut run = begin(&config("physics=mujoco")).unwrap();
        run.poll(Budget(30), &mut ()).unwrap();
        let bytes = run.snapshot();
        assert_eq!(Run::resume(&bytes).err(), Some(SnapshotError::World(REACHER.into())));
        let mut resumed = resume(&bytes).unwrap();
        let told = |run: &mut Run| {
            let mut returns = Vec::new();
            let mut keep = |event: &mcvl_core::record::Event| {
                if let mcvl_core::record::Event::Evaluation(point) = event {
                    returns.push(point.observed_return);
                }
            };
            while run.poll(Budget(u32::MAX), &mut keep).unwrap() == mcvl_core::run::Status::Working {}
            returns
        };
        assert_eq!(told(&mut resumed), told(&mut run));
        let first = |physics: &str| told(&mut begin(&config(physics)).unwrap())[0];
        let (closed, simulated) = (first(""), first("physics=mujoco"));
        assert!((closed - simulated).abs() < 1e-3, "{closed} {simulated}");
    }

    #[test]
    #[cfg(not(feature = "mujoco"))]
    fn without_mujoco_it_is_said_how_to_get_it() {
        let wanted = config("physics=mujoco");
        assert_eq!(default_simulator("reacher"), Simulator::ClosedForm);
        let text = begin(&wanted).err().unwrap().to_string();
        assert!(text.contains("cargo xtask setup") && text.contains("physics=closed-form"), "{text}");
        assert_eq!(available(&wanted).unwrap_err().to_string(), text);
    }
}
