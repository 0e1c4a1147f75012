//! Everything on a fresh machine: build, train the main experiment, write its report, serve the page.

use anyhow::{Result, bail};

use crate::setup::Purpose;
use crate::{mujoco, process, setup, web};

/// Where the demonstration's runs lie.
const RUNS: &str = "runs/demo";
/// Its report.
const REPORT: &str = "runs/demo/report.html";
/// Exit code of `mcvl` for an assertion that does not hold.
const DOES_NOT_HOLD: i32 = 1;

/// Runs the demonstration; fails if the experiment's claims do not hold.
pub fn demo(seeds: &str, serve_page: bool) -> Result<()> {
    setup::ensure(Purpose::Web)?;
    setup::offer_mujoco();
    let mut build = process::cargo();
    process::run(build.args(["build", "--release", "--package", "mcvl-native"]).args(mujoco::features()))?;
    web::build()?;

    let mcvl = || process::command(process::program("release", "mcvl"));
    let mut train = mcvl();
    train.args(["train", "box-moving", "--seeds", seeds, "-o", RUNS, "--overwrite", "--assert-claims"]);
    let trained = process::status(&mut train)?;
    // Claims that do not hold still get their report: it shows why.
    if !trained.success() && trained.code() != Some(DOES_NOT_HOLD) {
        bail!("training did not finish: `mcvl train` ended with {trained}");
    }
    process::run(mcvl().args(["report", RUNS, "-o", REPORT]))?;
    eprintln!("demo: the report is {REPORT}; it opens from disk");
    if !trained.success() {
        bail!("the experiment's claims do not hold: see the summary above and {REPORT}");
    }
    if serve_page { process::run(mcvl().args(["serve", RUNS])) } else { Ok(()) }
}
