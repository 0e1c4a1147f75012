//! Records the tapes that come with the page: trains their runs and writes the decisions they show. Derives them again.

use std::time::Instant;

use anyhow::{Result, bail};

use crate::page::Page;
use crate::process::{cargo, command, program, root, run};
use crate::{mujoco, web};

/// A tape of the page, and the run that it is from.
struct Recording {
    name: &'static str,
    env: &'static str,
    /// What differs from the paper's setting of the world, as arguments of `mcvl train`.
    settings: &'static [&'static str],
    seed: u64,
    /// The checks that the tape has.
    checks: &'static [u32],
}

impl Recording {
    /// A name for its run, and for none that differs.
    fn run(&self) -> String {
        let settings: Vec<&str> = self.settings.iter().copied().filter(|argument| !argument.starts_with('-')).collect();
        [&[self.env, "seed", &self.seed.to_string()], &settings[..]].concat().join("-")
    }
}

/// One of every world, and what goes wrong. All are quick but those of the larger worlds, which take up to an hour.
const RECORDINGS: &[Recording] = &[
    Recording { name: "tape", env: "box-moving", settings: &[], seed: 0, checks: &[2] },
    // At the paper's rate its reward model dies (below), and so do the decisions: see docs/results.md.
    Recording {
        name: "tapes/absent-supervisor",
        env: "absent-supervisor",
        settings: &["--set", "lr_reward=0.001"],
        seed: 0,
        checks: &[1, 2, 3, 4],
    },
    Recording { name: "tapes/tomato-watering", env: "tomato-watering", settings: &[], seed: 0, checks: &[8, 94, 98] },
    // Seed 0 ends in the hack, as some others do: the page says so beside the link and the verdict.
    Recording {
        name: "tapes/rocks-and-diamonds",
        env: "rocks-and-diamonds",
        settings: &[],
        seed: 3,
        checks: &[1, 3, 7, 8],
    },
    Recording {
        name: "tapes/reacher",
        env: "reacher",
        settings: &["--preset", "small", "--set", "physics=closed-form"],
        seed: 0,
        checks: &[3, 5],
    },
    Recording { name: "tapes/dead-model", env: "absent-supervisor", settings: &[], seed: 1, checks: &[246, 285] },
    Recording { name: "tapes/late-hack", env: "rocks-and-diamonds", settings: &[], seed: 2, checks: &[4, 17] },
    Recording {
        name: "tapes/small-bait",
        env: "rocks-and-diamonds",
        settings: &["--set", "variant=plus-one", "--set", "lr_reward=0.001"],
        seed: 0,
        checks: &[12, 13],
    },
    Recording {
        name: "tapes/twelve-supervisors",
        env: "absent-supervisor",
        settings: &["--set", "supervisors=12", "--set", "lr_reward=0.001"],
        seed: 3,
        checks: &[25, 29],
    },
    Recording {
        name: "tapes/open-walls",
        env: "absent-supervisor",
        settings: &["--set", "variant=walls-removed", "--set", "lr_reward=0.001"],
        seed: 1,
        checks: &[18, 22],
    },
    Recording {
        name: "tapes/short-forecast",
        env: "box-moving",
        settings: &["--set", "forecast=100"],
        seed: 2,
        checks: &[24, 39, 41],
    },
    Recording {
        name: "tapes/short-rollouts",
        env: "box-moving",
        settings: &["--set", "rollout_steps=1"],
        seed: 8,
        checks: &[22, 23],
    },
    Recording {
        name: "tapes/no-reset",
        env: "box-moving",
        settings: &["--set", "reset_on_refusal=false"],
        seed: 1,
        checks: &[4, 12],
    },
    Recording {
        name: "tapes/no-upbringing",
        env: "box-moving",
        settings: &["--set", "safe_steps=0"],
        seed: 0,
        checks: &[7, 41],
    },
    Recording {
        name: "tapes/wrong-refusal",
        env: "box-moving",
        settings: &["--set", "variant=no-inconsistency"],
        seed: 1,
        checks: &[2, 60],
    },
];

/// The recordings of these names, or all.
fn chosen(names: &[String]) -> Result<Vec<&'static Recording>> {
    let known: Vec<&str> = RECORDINGS.iter().map(|recording| recording.name).collect();
    if let Some(name) = names.iter().find(|name| !known.contains(&name.as_str())) {
        bail!("{name}: no such tape; there are {}", known.join(", "));
    }
    let wanted = |recording: &&Recording| names.is_empty() || names.iter().any(|name| name == recording.name);
    Ok(RECORDINGS.iter().filter(wanted).collect())
}

/// Records the tapes of these names anew, or all; a run that is there is continued.
pub fn record(names: &[String]) -> Result<()> {
    let recordings = chosen(names)?;
    run(cargo().args(["build", "--release", "--package", "mcvl-native"]).args(mujoco::features()))?;
    for recording in recordings {
        let folder = root().join("runs/tapes").join(recording.run());
        let mut train = command(program("release", "mcvl"));
        if folder.exists() {
            train.args(["train", "--resume", "-o"]).arg(&folder);
        } else {
            train.args(["train", recording.env, "--seed", &recording.seed.to_string(), "-o"]).arg(&folder);
            train.args(recording.settings);
        }
        run(&mut train)?;
        let mut export = command(program("release", "mcvl"));
        export.arg("export").arg(&folder).args(["--to", "tape", "--overwrite", "-o"]);
        export.arg(root().join("www").join(recording.name).with_extension("json"));
        for check in recording.checks {
            export.args(["--check", &check.to_string()]);
        }
        run(&mut export)?;
    }
    // Browsers that kept the page take the new ones.
    let www = root().join("www");
    if www.join("pkg").is_dir() { web::name_build(&www) } else { Ok(()) }
}

/// Longest time that deriving a tape again may take, milliseconds.
const PATIENCE: u64 = 3 * 3_600_000;

/// Derives the decisions of these tapes again in a browser, or of all that the page can train; fails where one is not
/// what was recorded, to the last bit.
pub fn derive(names: &[String]) -> Result<()> {
    let recordings = chosen(names)?;
    let page = Page::serve()?;
    let mut equal = true;
    for recording in recordings {
        if recording.env == "reacher" {
            println!("{}: an arm is not trained on the page; `mcvl verify` does that to its run", recording.name);
            continue;
        }
        let began = Instant::now();
        let seen = page.drive(&[
            format!("patience:{PATIENCE}"),
            page.go(&format!("?tape={}.json", recording.name)),
            "until:return /about \\d+ (s|min|h)/.test(document.getElementById('again').textContent)".into(),
            "eval:document.getElementById('again').click(); return document.getElementById('again').textContent".into(),
            "until:return document.getElementById('status').textContent.includes('came out again')".into(),
            "eval:return document.getElementById('status').textContent".into(),
        ])?;
        let text = |index: usize| seen[index].as_str().unwrap_or_default();
        let count = recording.checks.len();
        equal &= text(5).contains(&format!(" {count} of {count} recorded decisions came out again"));
        println!("{}: {:.0} s. {} {}", recording.name, began.elapsed().as_secs_f64(), text(3), text(5));
    }
    if !equal {
        bail!("not every recorded decision came out again");
    }
    Ok(())
}
