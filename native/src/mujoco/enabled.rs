//! The arm of Reacher, moved by MuJoCo.
//!
//! A [`Mujoco`] is plain data: all that MuJoCo carries from one step to the next. Each thread has one
//! workspace of MuJoCo's, into which a step puts the data and from which it takes them back, so forks are
//! copies and snapshots need nothing of the library.

use std::cell::RefCell;
use std::fs;
use std::sync::{Arc, OnceLock};

use mcvl_core::env::reacher::{Motion, Physics};
use mujoco_rs::mujoco_version;
use mujoco_rs::wrappers::{MjData, MjModel, MjtObjBase};
use serde::{Deserialize, Serialize};

use super::{Library, MujocoError, VERSION};

/// Simulator steps of one environment step.
const FRAMES: u32 = 2;
/// Coordinates of the model: shoulder, elbow, target x, target y.
const COORDINATES: usize = 4;

/// The arm of Reacher in MuJoCo. Every one of them has a library of the right version behind it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "State", into = "State")]
pub struct Mujoco(State);

/// What MuJoCo carries from one step to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct State {
    positions: [f64; COORDINATES],
    velocities: [f64; COORDINATES],
    /// Where the solver of the elbow's limit begins: it stops at a tolerance, so its start shows in the last
    /// digits.
    warm_start: [f64; COORDINATES],
    /// The fingertip as MuJoCo reports it.
    tip: [f64; 2],
}

impl From<Mujoco> for State {
    fn from(physics: Mujoco) -> Self {
        physics.0
    }
}

impl TryFrom<State> for Mujoco {
    type Error = MujocoError;

    /// # Errors
    /// If the library cannot be used where a snapshot is read.
    fn try_from(state: State) -> Result<Self, MujocoError> {
        model()?;
        Ok(Self(state))
    }
}

/// A model that MuJoCo accepted, and the fingertip's number in it.
#[derive(Debug)]
pub(super) struct Model {
    compiled: Arc<MjModel>,
    tip: usize,
}

type Workspace = MjData<Arc<MjModel>>;

thread_local! {
    static WORKSPACE: RefCell<Option<Workspace>> = const { RefCell::new(None) };
}

/// The library that this program is linked to.
///
/// # Errors
/// If it has another version than the program was built for.
pub fn library() -> Result<Library, MujocoError> {
    let version = right_version(mujoco_version())?.to_owned();
    // Linux lists what a process has loaded, with its path at the end of the line.
    let maps = fs::read_to_string("/proc/self/maps").unwrap_or_default();
    let line = maps.lines().find(|line| line.contains("libmujoco"));
    let file = line.and_then(|line| line.find('/').map(|start| line[start..].to_owned()));
    Ok(Library { version, file })
}

/// A version, if it is the right one.
pub(super) fn right_version(found: &str) -> Result<&str, MujocoError> {
    if found == VERSION { Ok(found) } else { Err(MujocoError::Version(found.to_owned())) }
}

/// Compiles a model and sees to it that it is an arm with a target.
pub(super) fn load(xml: &str) -> Result<Model, MujocoError> {
    // The bindings end the program at the first model of a library with another layout.
    right_version(mujoco_version())?;
    let compiled = MjModel::from_xml_string(xml).map_err(|error| MujocoError::Model(error.to_string()))?;
    let sizes = compiled.ffi();
    let sizes = [sizes.nq, sizes.nv, sizes.nu].map(i64::from);
    if sizes != [4, 4, 2] {
        let [positions, velocities, motors] = sizes;
        let reason =
            format!("it has {positions} positions, {velocities} velocities and {motors} motors instead of 4, 4 and 2");
        return Err(MujocoError::Model(reason));
    }
    let tip = compiled.name_to_id(MjtObjBase::mjOBJ_BODY, "tip");
    let tip = tip.ok_or_else(|| MujocoError::Model("it has no body `tip`".into()))?;
    Ok(Model { compiled: Arc::new(compiled), tip })
}

/// The model of Reacher, compiled once.
fn model() -> Result<&'static Model, MujocoError> {
    static MODEL: OnceLock<Result<Model, MujocoError>> = OnceLock::new();
    MODEL.get_or_init(|| load(include_str!("reacher.xml"))).as_ref().map_err(Clone::clone)
}

/// Works with this thread's workspace.
fn with_workspace<T>(work: impl FnOnce(&mut Workspace) -> T) -> T {
    WORKSPACE.with_borrow_mut(|workspace| {
        work(workspace.get_or_insert_with(|| {
            let model = model().expect("a `Mujoco` is made only where the model was");
            MjData::new(Arc::clone(&model.compiled))
        }))
    })
}

impl Mujoco {
    /// A simulation at rest: the arm stretched towards +x.
    ///
    /// # Errors
    /// If the library has another version than the program was built for.
    pub fn new() -> Result<Self, MujocoError> {
        model()?;
        let mut physics = Self(State::default());
        physics.begin(&Motion::start([0.0; 2], [0.0; 2], [0.1, -0.1]));
        Ok(physics)
    }

    /// Takes from the workspace what the next step needs.
    fn keep(&mut self, workspace: &Workspace) {
        self.0.positions.copy_from_slice(workspace.qpos());
        self.0.velocities.copy_from_slice(workspace.qvel());
        self.0.warm_start.copy_from_slice(workspace.qacc_warmstart());
        let tip = model().expect("the workspace has a model").tip;
        let [x, y, _] = workspace.xpos()[tip];
        self.0.tip = [x, y];
    }
}

impl Physics for Mujoco {
    fn begin(&mut self, start: &Motion) {
        let ([q0, q1], [v0, v1], [x, y]) = (start.angles, start.velocities, start.target);
        with_workspace(|workspace| {
            workspace.reset();
            workspace.qpos_mut().copy_from_slice(&[q0, q1, x, y]);
            workspace.qvel_mut().copy_from_slice(&[v0, v1, 0.0, 0.0]);
            workspace.forward();
            self.keep(workspace);
        });
    }

    fn advance(&mut self, command: [f64; 2]) {
        with_workspace(|workspace| {
            workspace.qpos_mut().copy_from_slice(&self.0.positions);
            workspace.qvel_mut().copy_from_slice(&self.0.velocities);
            workspace.qacc_warmstart_mut().copy_from_slice(&self.0.warm_start);
            workspace.ctrl_mut().copy_from_slice(&command);
            (0..FRAMES).for_each(|_| workspace.step());
            self.keep(workspace);
        });
    }

    fn motion(&self) -> Motion {
        let State { positions: [q0, q1, x, y], velocities: [v0, v1, ..], tip, .. } = self.0;
        Motion { angles: [q0, q1], velocities: [v0, v1], tip, target: [x, y] }
    }
}
