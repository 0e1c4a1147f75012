//! Reacher in MuJoCo's physics, where this program is linked to MuJoCo (the cargo feature `mujoco`). Without
//! it everything here has the same face, and the errors say how to get it.
//!
//! [`Mujoco`] is a [`Physics`](mcvl_core::env::reacher::Physics) like core's closed form: observation, reward,
//! button and episodes are core's, and one and the same for both.

#[cfg(any(test, not(feature = "mujoco")))]
mod disabled;
#[cfg(feature = "mujoco")]
mod enabled;
#[cfg(all(test, feature = "mujoco"))]
mod tests;

use std::fmt;

use mcvl_core::env::reacher::{Button, Reacher};

#[cfg(not(feature = "mujoco"))]
pub use disabled::{Mujoco, library};
#[cfg(feature = "mujoco")]
pub use enabled::{Mujoco, library};

/// The version of MuJoCo that this program works with, and no other: the layout of its data changes with each.
pub const VERSION: &str = "3.17.0";

/// Why there is no simulation by MuJoCo.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum MujocoError {
    /// This program was built without it.
    Disabled,
    /// The library that was found has this version instead of [`VERSION`].
    Version(String),
    /// The model cannot be used, for this reason.
    Model(String),
}

impl fmt::Display for MujocoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Disabled => write!(
                f,
                "this program was built without MuJoCo: `cargo xtask setup` fetches the library, then build with \
                 `--features mujoco`"
            ),
            Self::Version(found) => write!(
                f,
                "the library of MuJoCo has version {found}, this program works with {VERSION} only: `cargo xtask \
                 setup` fetches it; see that LD_LIBRARY_PATH names no other"
            ),
            Self::Model(reason) => write!(f, "MuJoCo cannot use the model of Reacher: {reason}"),
        }
    }
}

impl std::error::Error for MujocoError {}

/// Where the library of MuJoCo is and which version it has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Library {
    /// Its version.
    pub version: String,
    /// Its file, where the system says so.
    pub file: Option<String>,
}

/// Reacher, moved by MuJoCo.
///
/// # Errors
/// If this program is not linked to MuJoCo, or to another version.
pub fn reacher(button: Option<Button>) -> Result<Reacher<Mujoco>, MujocoError> {
    Ok(Reacher::new(Mujoco::new()?, button))
}
