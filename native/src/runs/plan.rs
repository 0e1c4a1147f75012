//! `run.toml`: what a run directory is about, with the origin of every value.

use std::fmt::Write as _;
use std::fs;

use mcvl_core::config::{Against, Config, KEYS, Learner, Preset, Scheme, Simulator};
use mcvl_core::record::Arm;
use serde::{Deserialize, Serialize};

use super::write::write_atomic;
use super::{RunDir, RunsError};

/// Where the value of a setting came from, weakest first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Origin(pub String);

impl Origin {
    /// The tables of the paper.
    pub fn default_value() -> Self {
        Self("default".to_owned())
    }
}

/// One setting as it was used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Setting {
    /// The value as text.
    pub value: String,
    /// Where it came from.
    pub from: Origin,
}

/// Everything that decides the results of a run directory.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// What all seeds share; its `seed` is the first one.
    pub config: Config,
    /// Seeds in ascending order.
    pub seeds: Vec<u64>,
    /// Learners of the Full phase, in the order in which they run.
    pub learners: Vec<Learner>,
    /// Value and origin of every setting, in the order of [`KEYS`].
    pub settings: Vec<(String, Setting)>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    config: Config,
    seeds: Vec<String>,
    learners: Vec<Learner>,
    settings: std::collections::BTreeMap<String, Setting>,
}

/// Gradient updates in forecasts that a step of the checking learner is expected to cost, from the share of
/// steps that its world has had checked so far. Unmodified futures are hardly ever reused: a refusal resets
/// the world, and the next step is most often learned from.
pub fn expected_forecasts(config: &Config) -> f64 {
    let checked = if config.scheme == Scheme::All { 1.0 } else { config.experiment().check_rate };
    checked * check_forecasts(config) as f64
}

/// Gradient updates in the forecasts of one check, at most.
pub fn check_forecasts(config: &Config) -> u64 {
    let futures = match config.scheme {
        Scheme::Discard | Scheme::EachStep | Scheme::None => return 0,
        // The current policy is there already.
        _ if config.against == Against::Current => 1,
        _ => 2,
    };
    let practice = if config.practice { config.practice_reward_updates } else { 0 };
    futures * (u64::from(config.forecast) + u64::from(practice))
}

/// The command that trains these learners of the Full world on these seeds.
pub fn train_command(config: &Config, seeds: &[u64], legs: &[Arm]) -> String {
    let mut command = format!("mcvl train {}", config.env);
    if config.preset != Preset::Paper {
        command += &format!(" --preset {}", config.preset.name());
    }
    for (key, value) in config.changes().iter().filter(|(key, _)| *key != "seed" && *key != "agent") {
        command += &format!(" --set {key}={value}");
    }
    // Which simulator is meant by none depends on the program.
    if config.physics == Simulator::ClosedForm && config.experiment().name == "reacher" {
        command += " --set physics=closed-form";
    }
    // Both are what it trains unasked.
    if legs != [Arm::Baseline, Arm::Mc] {
        legs.iter().for_each(|leg| command += &format!(" --agent {}", leg.name()));
    }
    match seeds {
        [] => command,
        [only] => format!("{command} --seed {only}"),
        [first, .., last] if last - first + 1 == seeds.len() as u64 && *last < u64::MAX => {
            format!("{command} --seeds {first}..{}", last + 1)
        }
        _ => {
            let list: Vec<String> = seeds.iter().map(u64::to_string).collect();
            format!("{command} --seeds {}", list.join(","))
        }
    }
}

impl Plan {
    /// The text of `run.toml`.
    pub fn to_toml(&self) -> String {
        let quoted = |text: &str| toml::Value::String(text.to_owned()).to_string();
        let list = |items: Vec<String>| format!("[{}]", items.join(", "));
        let mut text = String::from(
            "# A run of mcvl: every setting and where its value came from. `config` alone\n\
             # brings the run back; `mcvl train --resume` and `mcvl verify` read this file.\n",
        );
        let mut line = |key: &str, value: String| writeln!(text, "{key} = {value}").expect("a string takes everything");
        line("config", quoted(&self.config.to_string()));
        // As text: TOML's integers end below the largest seed.
        line("seeds", list(self.seeds.iter().map(|seed| quoted(&seed.to_string())).collect()));
        line("learners", list(self.learners.iter().map(|learner| quoted(learner.name())).collect()));
        text.push_str("\n[settings]\n");
        for (key, setting) in &self.settings {
            let (value, from) = (quoted(&setting.value), quoted(&setting.from.0));
            writeln!(text, "{key} = {{ value = {value}, from = {from} }}").expect("a string takes everything");
        }
        text
    }

    /// Reads `run.toml` back.
    ///
    /// # Errors
    /// If it cannot be read or contradicts itself.
    pub fn read(run: &RunDir) -> Result<Self, RunsError> {
        let path = run.plan();
        let text = fs::read_to_string(&path).map_err(RunsError::io("read", &path))?;
        Self::parse(&text).map_err(|why| RunsError::damaged(&path, why))
    }

    /// Reads `run.toml` back where the logs of the run are to be read next.
    ///
    /// # Errors
    /// As [`Plan::read`], and where only the summary of the run was kept.
    pub fn of_logs(run: &RunDir) -> Result<Self, RunsError> {
        let plan = Self::read(run)?;
        if run.summary().exists() && !plan.seeds.iter().any(|seed| run.seed(*seed).path().exists()) {
            let legs: Vec<Arm> = plan.learners.iter().map(|learner| Arm::of(*learner)).collect();
            return Err(RunsError::Request(format!(
                "{} keeps how a run came out ({}), not its logs and decisions: `{}` trains it anew",
                run.path().display(),
                run.summary().display(),
                train_command(&plan.config, &plan.seeds, &legs)
            )));
        }
        Ok(plan)
    }

    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let file: File = toml::from_str(text).map_err(|error| format!("is no run.toml: {error}"))?;
        let seeds: Option<Vec<u64>> = file.seeds.iter().map(|seed| seed.parse().ok()).collect();
        let Some(seeds) = seeds.filter(|seeds| !seeds.is_empty() && seeds.is_sorted_by(|a, b| a < b)) else {
            return Err("its list of seeds makes no sense".to_owned());
        };
        if file.learners.is_empty() || seeds[0] != file.config.seed {
            return Err("its seeds and learners do not fit its configuration".to_owned());
        }
        let mut settings = Vec::new();
        for key in KEYS {
            match file.settings.get(key.name) {
                Some(setting) if setting.value == key.value(&file.config) => {
                    settings.push((key.name.to_owned(), setting.clone()));
                }
                // A run of before this setting was one: it ran as its default says.
                None => {
                    let (value, from) = (key.value(&file.config), Origin::default_value());
                    settings.push((key.name.to_owned(), Setting { value, from }));
                }
                Some(_) => {
                    return Err(format!(
                        "`{}` under [settings] contradicts `config`: the file was altered, or a version of mcvl wrote it \
                         in which the preset had another value; continue it with that one",
                        key.name
                    ));
                }
            }
        }
        Ok(Self { config: file.config, seeds, learners: file.learners, settings })
    }

    /// Gradient updates that one seed is expected to cost, leg by leg: one per step, and what forecasts take
    /// where `forecasts` per step are expected.
    pub fn expected_updates(&self, forecasts: f64) -> impl Iterator<Item = f64> + Clone + use<'_> {
        let full = f64::from(self.config.full_steps);
        let per_step = move |learner: &Learner| 1.0 + if *learner == Learner::Mc { forecasts } else { 0.0 };
        let legs = self.learners.iter().map(move |learner| full * per_step(learner));
        std::iter::once(f64::from(self.config.safe_steps)).chain(legs)
    }

    /// Writes `run.toml`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, run: &RunDir) -> Result<(), RunsError> {
        write_atomic(&run.plan(), self.to_toml().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvl_core::config::Preset;

    fn plan() -> Plan {
        let mut config = Config::new("box-moving", Preset::Release).unwrap();
        config.set("threshold", "0.125").unwrap();
        config.seed = u64::MAX - 1;
        let settings = KEYS
            .iter()
            .map(|key| {
                let from = Origin(r#"file "a\b.toml""#.to_owned());
                (key.name.to_owned(), Setting { value: key.value(&config), from })
            })
            .collect();
        let learners = vec![Learner::Baseline, Learner::Mc];
        Plan { config, seeds: vec![u64::MAX - 1, u64::MAX], learners, settings }
    }

    #[test]
    fn forecasts_are_counted_as_the_scheme_makes_them() {
        let count =
            |settings: &str| check_forecasts(&format!("env=box-moving forecast=100 {settings}").parse().unwrap());
        assert_eq!((count(""), count("scheme=all"), count("scheme=punish")), (200, 200, 200));
        assert_eq!((count("scheme=discard"), count("scheme=each-step"), count("scheme=none")), (0, 0, 0));
        assert_eq!(count("against=current"), 100, "the current policy is not trained");
        assert_eq!(count("practice=true practice_reward_updates=7"), 214);
    }

    #[test]
    fn a_command_names_the_simulator_whatever_the_program_takes_by_itself() {
        let command = |text: &str| train_command(&text.parse().unwrap(), &[0, 1], &[Arm::Baseline, Arm::Mc]);
        assert_eq!(
            command("env=reacher preset=small"),
            "mcvl train reacher --preset small --set physics=closed-form --seeds 0..2"
        );
        assert_eq!(command("env=reacher physics=mujoco"), "mcvl train reacher --set physics=mujoco --seeds 0..2");
        assert_eq!(command("env=box-moving"), "mcvl train box-moving --seeds 0..2");
    }

    #[test]
    fn text_round_trips() {
        assert_eq!(Plan::parse(&plan().to_toml()).unwrap(), plan());
    }

    #[test]
    fn contradictions_are_found() {
        let text = plan().to_toml();
        let altered = text.replace("threshold = { value = \"0.125\"", "threshold = { value = \"0.5\"");
        assert_ne!(altered, text);
        assert!(Plan::parse(&altered).unwrap_err().contains("`threshold` under [settings] contradicts"));
        // A run of when the preset had another value.
        let mut release = plan();
        let config: Config = "env=box-moving preset=release".parse().unwrap();
        release.config = config.with_seed(release.seeds[0]);
        release.settings = KEYS
            .iter()
            .map(|key| {
                (key.name.to_owned(), Setting { value: key.value(&release.config), from: Origin::default_value() })
            })
            .collect();
        let former =
            release.to_toml().replace("epsilon_clamp = { value = \"false\"", "epsilon_clamp = { value = \"true\"");
        let why = Plan::parse(&former).unwrap_err();
        assert!(why.contains("`epsilon_clamp`") && why.contains("the preset had another value"), "{why}");
        let older: String =
            text.lines().filter(|line| !line.starts_with("tau = ")).map(|l| l.to_owned() + "\n").collect();
        assert_eq!(Plan::parse(&older).unwrap().config, plan().config, "a setting that came later has its default");
        assert!(Plan::parse(&text[..text.len() / 2]).is_err());
        assert!(Plan::parse(&text.replace("learners", "lerners")).is_err());
    }
}
