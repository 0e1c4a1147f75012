//! What stands in for MuJoCo where this program is not linked to it: the same face, and no value.

use mcvl_core::env::reacher::{Motion, Physics};
use serde::{Deserialize, Serialize};

use super::{Library, MujocoError};

/// The arm of Reacher in MuJoCo. There is none in this build.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Mujoco {}

impl Mujoco {
    /// A simulation at rest.
    ///
    /// # Errors
    /// Always: this program was built without MuJoCo.
    pub fn new() -> Result<Self, MujocoError> {
        Err(MujocoError::Disabled)
    }
}

/// The library that this program is linked to.
///
/// # Errors
/// Always: this program was built without MuJoCo.
pub fn library() -> Result<Library, MujocoError> {
    Err(MujocoError::Disabled)
}

impl Physics for Mujoco {
    fn begin(&mut self, _start: &Motion) {
        match *self {}
    }

    fn advance(&mut self, _command: [f64; 2]) {
        match *self {}
    }

    fn motion(&self) -> Motion {
        match *self {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_build_without_mujoco_says_how_to_get_it() {
        for error in [library().unwrap_err(), Mujoco::new().unwrap_err()] {
            let text = error.to_string();
            assert!(text.contains("cargo xtask setup") && text.contains("--features mujoco"), "{text}");
        }
    }
}
