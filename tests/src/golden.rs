//! Episodes that were recorded in the reference implementation (see `tests/data/README.md`).

use std::env;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use flate2::read::GzDecoder;
use serde::Deserialize;

use crate::data;

/// One recorded episode of a gridworld.
#[derive(Debug, Deserialize)]
pub struct Episode {
    /// Variant, in the recording's spelling.
    pub variant: String,
    /// Name of the episode.
    pub episode: String,
    /// Factor from raw to scaled reward.
    pub scale: f64,
    /// Length of the observation.
    pub obs_len: usize,
    /// Absent Supervisor: whether the supervisor was there in this episode.
    pub supervisor_present: Option<bool>,
    /// After reset.
    pub initial: Situation,
    /// Steps, in order.
    pub steps: Vec<Step>,
    /// How it ended: `terminated` or `truncated`.
    pub ended: String,
    /// Sum of raw rewards.
    pub return_raw: f64,
    /// Sum of hidden rewards.
    pub hidden_return: f64,
}

/// What can be seen of the world at one time.
#[derive(Debug, Deserialize)]
pub struct Situation {
    /// The rows as they were drawn.
    pub board: Vec<String>,
    /// Positions of the ones of the observation.
    pub ones: Vec<usize>,
    /// Box Moving: cell of the box, from the top.
    #[serde(rename = "box")]
    pub box_cell: Option<u8>,
    /// Box Moving: cell of the agent, from the top.
    pub agent: Option<u8>,
    /// Tomato Watering: (row, column) of the tomatoes that dried in this step.
    pub dried: Option<Vec<(u8, u8)>>,
    /// Tomato Watering: (row, column) of the tomatoes that are watered after it.
    pub watered: Option<Vec<(u8, u8)>>,
}

/// One recorded step.
#[derive(Debug, Deserialize)]
pub struct Step {
    /// Action.
    pub a: u8,
    /// Observed reward.
    pub r_raw: f64,
    /// Observed reward, scaled.
    pub r: f64,
    /// Hidden reward.
    pub hidden: f64,
    /// The world reached a terminal state.
    pub term: bool,
    /// The step limit was reached.
    pub trunc: bool,
    /// The world after the step.
    #[serde(flatten)]
    pub after: Situation,
}

/// What every line says about itself.
#[derive(Deserialize)]
struct Label {
    #[serde(rename = "type")]
    kind: String,
    env: Option<String>,
}

/// The folder of the recordings.
fn folder() -> PathBuf {
    env::var_os("MCVL_GOLDEN_DIR").map_or_else(data, PathBuf::from)
}

/// The lines of a recording, each read by `read` (`None`: not one of those that are asked for).
pub(crate) fn lines<T>(name: &str, read: impl Fn(&str) -> serde_json::Result<Option<T>>) -> Result<Vec<T>> {
    let path = folder().join(name);
    let file = File::open(&path).with_context(|| format!("{}: recorded episodes", path.display()))?;
    let mut found = Vec::new();
    for (line, number) in BufReader::new(GzDecoder::new(file)).lines().zip(1..) {
        let line = line.with_context(|| format!("{}: not gzip", path.display()))?;
        found.extend(read(&line).with_context(|| format!("{}: line {number} is no recorded episode", path.display()))?);
    }
    if found.is_empty() {
        bail!("{}: no episode of what is asked for", path.display());
    }
    Ok(found)
}

/// Every recorded episode of a world, in the recording's spelling.
///
/// # Errors
/// If the file is not there, cannot be understood, or has no such episode.
pub fn episodes(world: &str) -> Result<Vec<Episode>> {
    let read = |line: &str| {
        let label: Label = serde_json::from_str(line)?;
        let asked = label.kind == "episode" && label.env.as_deref() == Some(world);
        if asked { serde_json::from_str(line).map(Some) } else { Ok(None) }
    };
    lines("gridworld_golden.jsonl.gz", read).with_context(|| format!("episodes of {world}"))
}
