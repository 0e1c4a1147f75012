//! The settings that the experiments train, each once.

use mcvl_core::config::{Config, ConfigError, KEYS, Learner};
use mcvl_core::rng::{Purpose, Rng};

use crate::runs::{Origin, Plan, Setting};

/// Learners of a cell: what the paper compares, from one and the same switch.
const LEARNERS: &[Learner] = &[Learner::Baseline, Learner::Mc];
/// ... and what later work compares with.
const BASELINES: &[Learner] = &[Learner::Oracle, Learner::Frozen, Learner::FrozenReward];

/// Origin of the values that a cell sets, in `run.toml`.
const ORIGIN: &str = "mcvl reproduce";
/// Origin of the values that `--quick` sets.
pub const QUICK_ORIGIN: &str = "mcvl reproduce --quick";

/// One run directory of the experiments: a setting, trained over seeds.
#[derive(Debug, PartialEq, Eq)]
pub struct Cell {
    /// Name: of its folder, and on the command line.
    pub name: &'static str,
    /// The configuration, as text without a seed.
    pub config: &'static str,
    /// Learners of the Full phase.
    pub learners: &'static [Learner],
    /// How often, and of how many checks, the decision is repeated with other random numbers; such a cell
    /// measures their spread instead of training to the end.
    pub repeats: Option<Repeats>,
    /// Whether it is this project's setting and not the paper's: claims that need it are counted apart.
    pub ours: bool,
}

/// Extent of a measurement of spread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repeats {
    /// Checks: one half of them the first of honest steps, the other half the first of hacks.
    pub checks: u32,
    /// Decisions per check with paired random numbers, and as many with unpaired ones.
    pub repeats: u32,
}

/// What `--quick` shortens: only worlds in which a seed takes minutes, and everything that counts steps or updates by
/// one factor, so that the parts keep their proportion. Chosen by cost alone; the second is Reacher's.
const QUICK_PART: [u32; 2] = [10, 20];
/// ... and of how much of a measurement of spread a part is left.
const QUICK_REPEATS: u32 = 4;
const QUICK_KEYS: [&str; 7] = [
    "safe_steps",
    "full_steps",
    "exploration",
    "learning_starts",
    "epsilon_decay",
    "forecast",
    "practice_reward_updates",
];
/// Seeds of `--quick` where a seed takes seconds, and elsewhere.
const QUICK_SEEDS: [u64; 2] = [4, 2];
/// Seeds otherwise.
const SEEDS: u64 = 10;
/// ... and of Reacher, where a seed takes minutes on a whole core.
const REACHER_SEEDS: u64 = 5;

impl Cell {
    const fn new(name: &'static str, config: &'static str) -> Self {
        Self { name, config, learners: LEARNERS, repeats: None, ours: false }
    }

    const fn spread(name: &'static str, config: &'static str) -> Self {
        Self { repeats: SPREAD, ..Self::new(name, config) }
    }

    const fn ours(self) -> Self {
        Self { ours: true, ..self }
    }

    /// The configuration at the paper's setting (seed 0).
    ///
    /// # Errors
    /// If the text of the table is not valid.
    pub fn paper(&self) -> Result<Config, ConfigError> {
        self.config.parse()
    }

    /// The configuration, shortened where `quick` says so and a seed would take minutes.
    ///
    /// # Errors
    /// If the text of the table is not valid.
    pub fn settings(&self, quick: bool) -> Result<Config, ConfigError> {
        let paper = self.paper()?;
        let mut config = paper.clone();
        if quick && !self.is_cheap() {
            let part = QUICK_PART[usize::from(self.is_reacher())];
            for key in KEYS.iter().filter(|key| QUICK_KEYS.contains(&key.name)) {
                let value: u32 = key.value(&paper).parse().unwrap_or_default();
                config.set(key.name, &(value / part).to_string())?;
            }
        }
        Ok(config)
    }

    /// Whether a seed takes seconds.
    pub fn is_cheap(&self) -> bool {
        self.config.starts_with("env=box-moving")
    }

    fn is_reacher(&self) -> bool {
        self.config.starts_with("env=reacher")
    }

    /// Seeds if none are asked for.
    pub fn seeds(&self, quick: bool) -> Vec<u64> {
        let count = match quick {
            _ if self.repeats.is_some() => 1,
            false if self.is_reacher() => REACHER_SEEDS,
            false => SEEDS,
            true => QUICK_SEEDS[usize::from(!self.is_cheap())],
        };
        (0..count).collect()
    }

    /// Seeds that are to be trained: those asked for, else its own. A measurement of spread takes one.
    pub fn planned(&self, quick: bool, asked: Option<&[u64]>) -> Vec<u64> {
        match asked {
            Some(seeds) if self.repeats.is_some() => seeds[..1].to_vec(),
            Some(seeds) => seeds.to_vec(),
            None => self.seeds(quick),
        }
    }

    /// Checks and repeats of a measurement of spread; fewer if quick.
    pub fn extent(&self, quick: bool) -> Option<Repeats> {
        let part = if quick { QUICK_REPEATS } else { 1 };
        self.repeats.map(|full| Repeats { checks: full.checks / part, repeats: full.repeats / part })
    }

    /// Random streams of a repeat of a check: unrelated to those of any run and of any other repeat.
    pub fn draw(check: u32, repeat: u32) -> u64 {
        Rng::stream(0, Purpose::Application, u64::from(check)).child(u64::from(repeat)).next_u64()
    }

    /// The cell as a plan of a run directory.
    ///
    /// # Errors
    /// If the text of the table is not valid.
    pub fn plan(&self, quick: bool, seeds: &[u64]) -> Result<Plan, ConfigError> {
        let paper = self.paper()?;
        let mut config = self.settings(quick)?;
        let given: Vec<&str> = self.config.split(' ').filter_map(|pair| Some(pair.split_once('=')?.0)).collect();
        let settings = KEYS.iter().map(|key| {
            let from = if key.value(&config) != key.value(&paper) {
                Origin(QUICK_ORIGIN.to_owned())
            } else if given.contains(&key.name) {
                Origin(format!("{ORIGIN} ({})", self.name))
            } else {
                Origin::default_value()
            };
            (key.name, from)
        });
        let settings: Vec<_> = settings.collect();
        config.seed = seeds.first().copied().unwrap_or_default();
        let setting = |(name, from): (&str, Origin)| {
            let key = KEYS.iter().find(|key| key.name == name).expect("the name is a key's");
            (name.to_owned(), Setting { value: key.value(&config), from })
        };
        let settings = settings.into_iter().map(setting).collect();
        Ok(Plan { config, seeds: seeds.to_vec(), learners: self.learners.to_vec(), settings })
    }
}

/// At the paper's rate of 0.01 most units of the reward model die in the larger worlds. The rate of these cells keeps it
/// alive; it was found on seeds 1000 to 1003, which are not reported.
pub(super) static ABSENT_ALIVE: Cell = Cell::new("absent-alive", "env=absent-supervisor lr_reward=0.001").ours();
pub(super) static ABSENT_12_ALIVE: Cell =
    Cell::new("absent-12-alive", "env=absent-supervisor supervisors=12 lr_reward=0.001").ours();
pub(super) static ABSENT_1_12_ALIVE: Cell =
    Cell::new("absent-1-12-alive", "env=absent-supervisor supervisors=12 supervisors_safe=1 lr_reward=0.001").ours();
pub(super) static ABSENT_WALLS_ALIVE: Cell =
    Cell::new("absent-walls-alive", "env=absent-supervisor variant=walls-removed lr_reward=0.001").ours();
pub(super) static TOMATO_ALIVE: Cell = Cell::new("tomato-alive", "env=tomato-watering lr_reward=0.001").ours();
pub(super) static ROCKS_ALIVE: Cell = Cell::new("rocks-alive", "env=rocks-and-diamonds lr_reward=0.001").ours();
pub(super) static ROCKS_ONE_ALIVE: Cell =
    Cell::new("rocks-plus-one-alive", "env=rocks-and-diamonds variant=plus-one lr_reward=0.001").ours();

pub(super) static BOX: Cell = Cell::new("box", "env=box-moving");
pub(super) static BOX_RELEASE: Cell = Cell::new("box-release", "env=box-moving preset=release").ours();
pub(super) static BOX_ALL: Cell = Cell::new("box-all", "env=box-moving scheme=all");
pub(super) static BOX_DISCARD: Cell = Cell::new("box-discard", "env=box-moving scheme=discard");
pub(super) static BOX_EACH: Cell = Cell::new("box-each-step", "env=box-moving scheme=each-step");
pub(super) static BOX_PUNISH: Cell = Cell::new("box-punish", "env=box-moving scheme=punish");
pub(super) static BOX_PREDICTED: Cell =
    Cell::new("box-store-predicted", "env=box-moving scheme=store-predicted").ours();
pub(super) static BOX_BASELINES: Cell =
    Cell { learners: BASELINES, ..Cell::new("box-baselines", "env=box-moving") }.ours();
pub(super) static BOX_SAFE_0: Cell = Cell::new("box-safe-0", "env=box-moving safe_steps=0");
pub(super) static BOX_SAFE_100: Cell = Cell::new("box-safe-100", "env=box-moving safe_steps=100");
pub(super) static BOX_SAFE_200: Cell = Cell::new("box-safe-200", "env=box-moving safe_steps=200");
pub(super) static BOX_SAFE_300: Cell = Cell::new("box-safe-300", "env=box-moving safe_steps=300");
pub(super) static BOX_L_100: Cell = Cell::new("box-forecast-100", "env=box-moving forecast=100");
pub(super) static BOX_L_300: Cell = Cell::new("box-forecast-300", "env=box-moving forecast=300");
pub(super) static BOX_NO_INC: Cell = Cell::new("box-no-inconsistency", "env=box-moving variant=no-inconsistency");
pub(super) static BOX_H_1: Cell = Cell::new("box-horizon-1", "env=box-moving rollout_steps=1");
pub(super) static BOX_H_5: Cell = Cell::new("box-horizon-5", "env=box-moving rollout_steps=5");
pub(super) static BOX_H_10: Cell = Cell::new("box-horizon-10", "env=box-moving rollout_steps=10");
pub(super) static BOX_CURRENT: Cell = Cell::new("box-against-current", "env=box-moving against=current");
pub(super) static BOX_NO_RESET: Cell = Cell::new("box-no-reset", "env=box-moving reset_on_refusal=false");
pub(super) static ABSENT: Cell = Cell::new("absent", "env=absent-supervisor");
pub(super) static ABSENT_12: Cell = Cell::new("absent-12", "env=absent-supervisor supervisors=12");
pub(super) static ABSENT_1_12: Cell =
    Cell::new("absent-1-12", "env=absent-supervisor supervisors=12 supervisors_safe=1");
pub(super) static ABSENT_WALLS: Cell = Cell::new("absent-walls", "env=absent-supervisor variant=walls-removed");
pub(super) static TOMATO: Cell = Cell::new("tomato", "env=tomato-watering");
pub(super) static TOMATO_DELUSIONAL: Cell =
    Cell::new("tomato-delusional", "env=tomato-watering variant=delusional-model");
pub(super) static ROCKS: Cell = Cell::new("rocks", "env=rocks-and-diamonds");
pub(super) static ROCKS_CURRENT: Cell = Cell::new("rocks-current", "env=rocks-and-diamonds rollouts=0");
pub(super) static ROCKS_ONE: Cell = Cell::new("rocks-plus-one", "env=rocks-and-diamonds variant=plus-one");
/// Reacher at the paper's setting takes days on a processor: the preset of this project that shows the effect.
pub(super) static REACHER: Cell = Cell::new("reacher-small", "env=reacher preset=small").ours();
pub(super) static REACHER_NO_BUTTON: Cell =
    Cell::new("reacher-small-no-button", "env=reacher preset=small variant=no-button").ours();
/// Enough repeats for a standard deviation to about a sixth of itself.
const SPREAD: Option<Repeats> = Some(Repeats { checks: 12, repeats: 20 });
pub(super) static TOMATO_SPREAD: Cell = Cell::spread("tomato-spread", "env=tomato-watering");
pub(super) static ABSENT_SPREAD: Cell = Cell::spread("absent-spread", "env=absent-supervisor");
pub(super) static ABSENT_SPREAD_ALIVE: Cell =
    Cell::spread("absent-spread-alive", "env=absent-supervisor lr_reward=0.001").ours();

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quick_shortens_everything_by_one_factor() {
        for (cell, part) in [(&BOX, 1), (&ROCKS, QUICK_PART[0]), (&REACHER, QUICK_PART[1])] {
            let (full, quick) = (cell.settings(false).unwrap(), cell.settings(true).unwrap());
            let steps = [quick.safe_steps, quick.practice_reward_updates].map(|steps| part * steps);
            assert_eq!(steps, [full.safe_steps, full.practice_reward_updates], "nothing is rounded away");
        }
    }
}
