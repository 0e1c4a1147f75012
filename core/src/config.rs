//! A run of a built-in world is a string: the `key=value` text that is the settings of the command line, the link of
//! the page and the header of every log. Same text, same run, same bytes.
//!
//! [`KEYS`] is the one table of settings: name, meaning, range, value of each preset and its source.
//!
//! ```
//! use mcvl_core::config::Config;
//! let config: Config = "env=box-moving seed=7 threshold=0.1".parse().unwrap();
//! assert_eq!(config.to_string(), "env=box-moving seed=7 threshold=0.1");
//! let error = "env=box-moving treshold=0.1".parse::<Config>().unwrap_err();
//! assert!(error.to_string().contains("did you mean `threshold`"));
//! // All settings: name, value at the preset `paper`, meaning, range.
//! for key in mcvl_core::config::KEYS {
//!     println!("{}={}  {} [{}]", key.name, key.paper, key.help, key.range());
//! }
//! ```

use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::fmt;
use core::str::FromStr;

use crate::env::grid::MAX_CELLS;
use crate::env::trap::{Trap, Trapped};
use crate::experiment::{self, Experiment, Optima};

mod nearest;

pub use nearest::{expected_one_of, nearest};

/// Most weights between hidden layers: some 16 times the largest network of the paper.
const MOST_PARAMETERS: u64 = 2_000_000;
/// Most hidden activations of one batch.
const MOST_ACTIVATIONS: u64 = 20_000_000;

/// A setting that is not as it should be: which, and what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfigError {
    /// The key, where one is concerned.
    pub key: String,
    /// What is wrong and what would be right.
    pub message: String,
}

impl ConfigError {
    fn new(key: &str, message: String) -> Self {
        Self { key: key.to_owned(), message }
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl core::error::Error for ConfigError {}

/// A value with a fixed set of names.
macro_rules! names {
    ($(#[$doc:meta])* $type:ident { $($(#[$vdoc:meta])* $variant:ident = $name:literal),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum $type { $($(#[$vdoc])* $variant),+ }

        impl $type {
            /// Every name.
            pub const NAMES: &'static [&'static str] = &[$($name),+];
            /// Every value, in the order of their names.
            pub const ALL: &'static [Self] = &[$($type::$variant),+];

            /// The name in settings.
            pub fn name(self) -> &'static str {
                match self { $($type::$variant => $name),+ }
            }
        }

        impl Value for $type {
            fn parse(text: &str) -> Result<Self, String> {
                match text {
                    $($name => Ok($type::$variant),)+
                    _ => Err(expected_one_of(text, Self::NAMES)),
                }
            }
            fn format(&self) -> String { self.name().to_owned() }
        }
    };
}

names! {
    /// Which source the defaults come from.
    Preset {
        /// The submission's tables.
        Paper = "paper",
        /// The authors' public release of 2026.
        Release = "release",
        /// A setting of this project that shows the effect within minutes; for worlds whose paper setting
        /// takes days.
        Small = "small",
    }
}

names! {
    /// The learner of the Full phase.
    Learner {
        /// Modification-considering: checks surprising transitions before learning from them.
        Mc = "mc",
        /// The plain learner.
        Baseline = "baseline",
        /// The plain learner in a world that pays the hidden performance.
        Oracle = "oracle",
        /// The plain learner that learns nothing more in the Full phase.
        Frozen = "frozen",
        /// The plain learner with the reward model of Safe training in place of the received rewards, and no check.
        FrozenReward = "frozen-reward",
    }
}

names! {
    /// What the checking learner does with surprising transitions (paper section 5.3).
    Scheme {
        /// Checks those whose received and predicted reward differ by the threshold or more.
        ByReward = "by-reward",
        /// Checks every one.
        All = "all",
        /// Drops what `by-reward` would check, without any forecast.
        Discard = "discard",
        /// Stores all, and keeps an update only if the policy after it is not rated worse than the one before.
        EachStep = "each-step",
        /// As `by-reward`, but a refused transition is stored with a punishment as its reward.
        Punish = "punish",
        /// As `punish`, with the predicted reward in its place.
        StorePredicted = "store-predicted",
        /// Checks nothing.
        None = "none",
    }
}

names! {
    /// What moves the arm of Reacher.
    Simulator {
        /// The equations of motion, in core.
        ClosedForm = "closed-form",
        /// MuJoCo, where the native program is linked to it.
        Mujoco = "mujoco",
    }
}

names! {
    /// Optimiser of both networks.
    Optimizer {
        /// Adam.
        Adam = "adam",
        /// Adam with decoupled weight decay.
        AdamW = "adamw",
        /// Adam with the maximum of the second moments.
        AmsGrad = "amsgrad",
        /// Decoupled weight decay and the maximum of the second moments.
        AdamWAmsGrad = "adamw-amsgrad",
    }
}

names! {
    /// Where the reward model's mini-batch comes from.
    RewardBatch {
        /// The value function's mini-batch.
        Same = "same",
        /// A draw of its own.
        Separate = "separate",
    }
}

names! {
    /// Transitions appended to every mini-batch of a forecast.
    Forced {
        /// The checked transition, in the modified future only.
        Transition = "transition",
        /// The last accepted transitions of the episode (at most ten) in both futures, and the checked
        /// one in the modified future.
        Episode = "episode",
    }
}

names! {
    /// When the transition of a step is checked and learned from.
    CheckAfter {
        /// Right after the environment's step.
        Step = "step",
        /// After the next action has been chosen, which is then made even if a refusal has reset the
        /// environment (the order of the paper's algorithm 5).
        NextAction = "next-action",
    }
}

names! {
    /// What the future that learned from a transition is compared with.
    Against {
        /// A future that learned without it.
        Forecast = "forecast",
        /// Today's policy, which has not trained on.
        Current = "current",
    }
}

names! {
    /// Value at the end of a rated rollout.
    FinalValue {
        /// Live value of the last state and the forecast policy's action there (paper, equation 2).
        Live = "live",
        /// Maximum over actions of the live target network (TD3: its value at the target actor's action).
        TargetMax = "target-max",
    }
}

/// Text form of a setting's type.
pub(crate) trait Value: Sized {
    fn parse(text: &str) -> Result<Self, String>;
    fn format(&self) -> String;
}

macro_rules! plain_value {
    ($($type:ty: $what:literal),+) => { $(
        impl Value for $type {
            fn parse(text: &str) -> Result<Self, String> {
                text.parse().map_err(|_| format!("`{text}` is not {}", $what))
            }
            fn format(&self) -> String { self.to_string() }
        }
    )+ };
}
plain_value!(u32: "a whole number from 0 to 4294967295", u64: "a whole number from 0 to 18446744073709551615");

impl Value for f32 {
    fn parse(text: &str) -> Result<Self, String> {
        match text.parse::<f32>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(format!("`{text}` is not a finite number")),
        }
    }
    fn format(&self) -> String {
        self.to_string()
    }
}

impl Value for bool {
    fn parse(text: &str) -> Result<Self, String> {
        match text {
            "true" | "on" | "yes" | "1" => Ok(true),
            "false" | "off" | "no" | "0" => Ok(false),
            _ => Err(expected_one_of(text, &["true", "false"])),
        }
    }
    fn format(&self) -> String {
        self.to_string()
    }
}

impl Value for String {
    fn parse(text: &str) -> Result<Self, String> {
        Ok(text.to_owned())
    }
    fn format(&self) -> String {
        self.clone()
    }
}

impl Value for Option<Trap> {
    fn parse(text: &str) -> Result<Self, String> {
        if text == "none" { Ok(None) } else { Trap::parse(text).map(Some) }
    }
    fn format(&self) -> String {
        self.map_or("none".to_owned(), |trap| trap.to_string())
    }
}

/// One setting.
pub struct Key {
    /// Name in the text form.
    pub name: &'static str,
    /// Meaning, with unit and range.
    pub help: &'static str,
    /// Value of the preset `paper`, before the experiment's own.
    pub paper: &'static str,
    /// Value of the preset `release` where it differs.
    pub release: Option<&'static str>,
    /// Where the value comes from (P: paper, A: authors' release, own: a choice of this project).
    pub source: &'static str,
    get: fn(&Config) -> String,
    set: fn(&mut Config, &str) -> Result<(), String>,
    allowed: fn(&Config) -> bool,
    range: &'static str,
}

impl Key {
    /// The allowed values in words.
    pub fn range(&self) -> &'static str {
        self.range
    }

    /// The value in a configuration.
    pub fn value(&self, config: &Config) -> String {
        (self.get)(config)
    }
}

macro_rules! keys {
    ($($name:ident: $type:ty = $paper:literal $(| $release:literal)?, $help:literal, $source:literal,
       |$value:ident| $allowed:expr, $range:literal;)+) => {
        /// A complete configuration of a run. Parsed from its text it is valid; after [`Config::set`], which checks
        /// one value alone, and after fields were set by hand, [`Config::validate`] has to say that it still is before
        /// it is used. Field documentation: [`KEYS`], or `mcvl train --help`.
        #[derive(Clone, Debug, PartialEq)]
        #[allow(missing_docs)] // The documentation of each field is its row in the table below.
        pub struct Config {
            pub env: String,
            pub preset: Preset,
            $(pub $name: $type,)+
        }

        /// Every setting but `env` and `preset`, in the order of the canonical text.
        pub static KEYS: &[Key] = &[$(Key {
            name: stringify!($name),
            help: $help,
            paper: $paper,
            release: keys!(@release $($release)?),
            source: $source,
            get: |config| config.$name.format(),
            set: |config, text| { config.$name = Value::parse(text)?; Ok(()) },
            allowed: |config| { let $value = &config.$name; $allowed },
            range: $range,
        }),+];

        impl Config {
            /// The table's values of the preset `paper`, before those of an experiment.
            fn table(env: &str) -> Self {
                Self {
                    env: env.to_owned(),
                    preset: Preset::Paper,
                    $($name: <$type as Value>::parse($paper).expect("the table of settings is valid"),)+
                }
            }
        }
    };
    (@release) => { None };
    (@release $release:literal) => { Some($release) };
}

keys! {
    agent: Learner = "mc", "Learner of the Full phase: mc (with the modification check), baseline (without), oracle (paid the hidden performance), frozen (no updates) or frozen-reward (learns from the reward model of Safe training).", "P; A (oracle, frozen, frozen-reward)", |_v| true, "mc, baseline, oracle, frozen or frozen-reward";
    scheme: Scheme = "by-reward", "What is done about surprising transitions: check them (by-reward) or all, discard them, check each update instead (each-step), store refused ones with another reward (punish, store-predicted), or none.", "P section 5.3", |_v| true, "by-reward, all, discard, each-step, punish, store-predicted or none";
    punishment: f32 = "-2", "Reward with which scheme=punish stores a refused transition, scaled.", "A (P: large and negative)", |_v| true, "a finite number";
    seed: u64 = "0", "Seed of everything random.", "own", |_v| true, "0 to 18446744073709551615";
    variant: String = "full", "World of the Full phase, by name; `mcvl envs` lists them.", "P", |_v| true, "a variant of the environment";
    map: String = "small", "Room of Tomato Watering and of Rocks and Diamonds: small (the authors') or original (AI Safety Gridworlds).", "A (P names none)", |_v| true, "a map of the environment";
    physics: Simulator = "closed-form", "What moves the arm of Reacher: its equations (closed-form) or MuJoCo (mujoco; native builds with that feature, which then take it by default). They agree to 1e-6, not to the last bit.", "own", |_v| true, "closed-form or mujoco";
    flag: bool = "true", "Observe whether the world is Safe or Full (Box Moving: one more input).", "A", |_v| true, "true or false";
    supervisors: u32 = "1", "Cells that show the supervisor (Absent Supervisor); 1 where its walls are removed.", "P table 2", |v| matches!(v, 1 | 2 | 4 | 8 | 12), "1, 2, 4, 8 or 12";
    supervisors_safe: u32 = "0", "The same in Safe training; 0 for as many as in the Full phase (Absent Supervisor).", "own", |v| matches!(v, 0 | 1 | 2 | 4 | 8 | 12), "0, 1, 2, 4, 8 or 12";
    trap: Option<Trap> = "none", "Trap in the Full world, as CELL:REWARD: an agent that stands on the cell after a step (row by row from 0 at the top left) is also paid this raw reward, which is worth nothing.", "own", |v| v.is_none_or(|trap| usize::from(trap.cell) < MAX_CELLS && trap.reward.abs() <= 1000.0), "none, or a cell and a reward from -1000 to 1000";
    safe_steps: u32 = "10000", "Environment steps of Safe training.", "P table 1", |v| *v <= 100_000_000, "0 to 100000000";
    full_steps: u32 = "10000", "Environment steps of the Full phase.", "P table 1", |v| *v <= 100_000_000, "0 to 100000000";
    replay: u32 = "10000", "Capacity of the replay buffer, transitions; the oldest leaves first.", "P table 1", |v| (1..=10_000_000).contains(v), "1 to 10000000";
    exploration: u32 = "1000", "First steps of a phase with uniformly random actions; Safe training updates after them, or as learning_starts says. With epsilon_restart=false, make safe_steps at least as many: what is left of them falls into the Full phase, where every step of it may be checked.", "P table 1, A", |_v| true, "0 or more";
    learning_starts: u32 = "0", "Steps of Safe training before its first update; 0 for the exploration steps. Keep it below safe_steps: else the Full phase, whose checks begin at once, starts with untrained networks.", "A", |_v| true, "0 or more";
    epsilon_start: f32 = "1", "Probability of a random action when the exploration steps end and the decay begins.", "P table 1", |v| (0.0..=1.0).contains(v), "0 to 1";
    epsilon_end: f32 = "0.05", "Probability of a random action at last.", "P table 1", |v| (0.0..=1.0).contains(v), "0 to 1";
    epsilon_decay: u32 = "8000", "Steps of the linear decay that follows the exploration steps.", "A", |_v| true, "0 or more";
    epsilon_clamp: bool = "true" | "false", "Stay at epsilon_end after the decay (false: the slope goes on, down to 0).", "own; A", |_v| true, "true or false";
    epsilon_restart: bool = "true", "Restart the exploration schedule at the switch to Full.", "A", |_v| true, "true or false";
    batch: u32 = "32", "Mini-batch size, drawn uniformly without replacement; no update while fewer are stored.", "P table 1", |v| (1..=4096).contains(v), "1 to 4096";
    gamma: f32 = "0.95", "Discount, per step.", "P table 1", |v| (0.0..=1.0).contains(v), "0 to 1";
    tau: f32 = "0.005", "Share of the live parameters that enters the target network after every update (TD3: after every policy_delay-th).", "P table 1, A", |v| (0.0..=1.0).contains(v), "0 to 1";
    lr: f32 = "0.0001", "Learning rate of the value function, and of TD3's actor.", "P table 1", |v| *v > 0.0, "above 0";
    lr_reward: f32 = "0.01", "Learning rate of the reward model.", "P table 1", |v| *v > 0.0, "above 0";
    exploration_noise: f32 = "0.1", "Standard deviation of the noise on exploring actions, in halves of their range (TD3).", "P", |v| *v >= 0.0, "0 or more";
    policy_noise: f32 = "0.01", "Standard deviation of the noise on target actions, in halves of their range (TD3).", "P", |v| *v >= 0.0, "0 or more";
    noise_clip: f32 = "0.5", "Bound of that noise (TD3).", "CleanRL", |v| *v >= 0.0, "0 or more";
    policy_delay: u32 = "2", "Updates of the critics per step of the actor and of the target networks (TD3).", "P", |v| *v >= 1, "1 or more";
    optimizer: Optimizer = "adam" | "adamw-amsgrad", "Optimiser of both networks (moments 0.9 and 0.999, epsilon 1e-8).", "P table 1; A", |_v| true, "adam, adamw, amsgrad or adamw-amsgrad";
    weight_decay: f32 = "0" | "0.01", "Decoupled weight decay (adamw).", "P; A (framework default)", |v| (0.0..=1.0).contains(v), "0 to 1";
    gradient_clip: f32 = "0" | "100", "Each gradient element is clipped to this magnitude; 0 switches it off.", "P; A", |v| *v >= 0.0, "0 or more";
    hidden: u32 = "128", "Units per hidden layer of both networks.", "P table 1", |v| (1..=4096).contains(v), "1 to 4096";
    layers: u32 = "2", "Hidden layers of both networks.", "P table 1", |v| (1..=8).contains(v), "1 to 8";
    reward_batch: RewardBatch = "same" | "separate", "Mini-batch of the reward model: the value function's, or a draw of its own.", "P; A", |_v| true, "same or separate";
    shared_weights: bool = "false" | "true", "Start every seed from the weights of seed 0.", "own; A", |_v| true, "true or false";
    threshold: f32 = "0.05" | "0.25", "Least |reward - predicted| that is checked, scaled reward.", "P table 1; A", |v| *v >= 0.0, "0 or more";
    threshold_inclusive: bool = "true", "A deviation that equals the threshold is checked too (>=), so that threshold=0 checks all (false: only larger ones, >).", "own", |_v| true, "true or false";
    check_after: CheckAfter = "step", "A transition is checked and learned from right after its step, or after the next action has been chosen (next-action).", "own; P algorithm 5: next-action", |_v| true, "step or next-action";
    own_streams: bool = "true", "Checks draw from random streams of their own (false: each takes its seed from the exploration's, which thereby moves, and no future is reused).", "own", |_v| true, "true or false";
    forecast: u32 = "5000", "Gradient updates per forecast (l).", "P table 1", |v| *v <= 10_000_000, "0 to 10000000";
    forced: Forced = "transition" | "episode", "What every mini-batch of a forecast contains besides its draw.", "P; A", |_v| true, "transition or episode";
    practice: bool = "false", "Forecasts also practise: each update is followed by a step in a copy of the world, from the state after the checked step on, stored in a copy of the replay buffer with the reward that a copy of the reward model predicts.", "P table 1; procedure A", |_v| true, "true or false";
    practice_reward_updates: u32 = "10000", "Updates of that copy of the reward model before a forecast practises.", "A", |v| *v <= 10_000_000, "0 to 10000000";
    practice_epsilon: f32 = "0.5", "Probability of a random action in practice.", "A", |v| (0.0..=1.0).contains(v), "0 to 1";
    copy_target: bool = "true", "A forecast starts with the live target network (false: with a copy of the live parameters).", "A", |_v| true, "true or false";
    copy_optimizer: bool = "true", "A forecast starts with the moments of the live optimiser (false: with none).", "A", |_v| true, "true or false";
    against: Against = "forecast", "What the future that learned from a transition is compared with: a forecast without it, or the current policy.", "P algorithm 5 (appendix C: current misses)", |_v| true, "forecast or current";
    paired_batches: bool = "true", "Both forecasts draw the same mini-batches and, where they practise, the same steps (false: the unmodified one has random streams of its own).", "P appendix C", |_v| true, "true or false";
    paired_rollouts: bool = "true", "Both futures are rated with the same random numbers.", "P appendix C", |_v| true, "true or false";
    rollout_steps: u32 = "30", "Steps of a rollout that rates a future (h).", "P table 1", |v| *v <= 100_000, "0 to 100000";
    rollouts: u32 = "20", "Rollouts per future from fresh resets (k); with 0 the current state alone is rated, and a step that ends its episode for good is a tie.", "P table 1", |v| *v <= 100_000, "0 to 100000";
    current_rollout: bool = "true", "Rate each future also from the state after the checked transition.", "P appendix C; A means to, and never does", |_v| true, "true or false";
    discount_utility: bool = "true", "Discount the rewards of a rollout and its final value (false: sum them as they are).", "P equation 2", |_v| true, "true or false";
    final_value: FinalValue = "live" | "target-max", "Value at the end of a rollout.", "P equation 2; A", |_v| true, "live or target-max";
    tolerance: f32 = "0.000001", "A future is worse only if its utility is lower by more than this.", "A", |v| *v >= 0.0, "0 or more";
    reset_on_refusal: bool = "true", "A refusal resets the environment.", "P algorithm 5", |_v| true, "true or false";
    update_on_refusal: bool = "false" | "true", "A step whose transition was refused still updates from the replay buffer.", "P algorithm 5; A", |_v| true, "true or false";
    evaluations: u32 = "50", "Evaluation points per phase, besides the one before its first step.", "A", |v| (1..=100_000).contains(v), "1 to 100000";
    evaluation_episodes: u32 = "20", "Greedy episodes per evaluation point.", "A", |v| (1..=100_000).contains(v), "1 to 100000";
}

/// Settings, whether this run reads them, what does, and what is here instead.
type Reader<'a> = (&'static [&'static str], bool, &'static str, &'a str);

impl Config {
    /// The configuration of an experiment with the values of a preset.
    ///
    /// # Errors
    /// If no experiment has this name, or it has no such preset.
    pub fn new(env: &str, preset: Preset) -> Result<Self, ConfigError> {
        let Some(experiment) = experiment::find(env) else {
            let names: Vec<&str> = experiment::EXPERIMENTS.iter().map(|e| e.name).collect();
            return Err(ConfigError::new("env", format!("env: {}", expected_one_of(env, &names))));
        };
        if preset == Preset::Small && experiment.small.is_empty() {
            let names: Vec<&str> =
                experiment::EXPERIMENTS.iter().filter(|e| !e.small.is_empty()).map(|e| e.name).collect();
            let message =
                format!("preset: {env} has no preset `small`, only {}; use paper or release", names.join(", "));
            return Err(ConfigError::new("preset", message));
        }
        Ok(Self::of(experiment, preset))
    }

    /// The configuration for a world that an application brings itself: the preset's table without an
    /// experiment's own values, which is DDQN's for gridworlds. A world of continuous actions wants what Reacher has
    /// (`Config::new("reacher", preset)`; paper, appendix F): `epsilon_start=0` and `epsilon_end=0` (noise explores),
    /// other values of `gamma`, `batch`, `hidden`, `lr` and `lr_reward`, and `rollout_steps` of an episode. Its `env` is `custom`, and its text comes back through serde alone: a text that is
    /// [parsed](str::parse) is to be run by a program that has no world but the built-in ones.
    pub fn custom(preset: Preset) -> Self {
        Self::of(&experiment::CUSTOM, preset)
    }

    fn of(experiment: &Experiment, preset: Preset) -> Self {
        let mut config = Self::table(experiment.name);
        config.preset = preset;
        if preset == Preset::Release {
            for key in KEYS {
                if let Some(text) = key.release {
                    (key.set)(&mut config, text).expect("the table of settings is valid");
                }
            }
        }
        let own = match preset {
            Preset::Paper => &[],
            Preset::Release => experiment.release,
            Preset::Small => experiment.small,
        };
        for row in experiment.paper.iter().chain(own) {
            config.set(row.key, row.value).expect("the table of experiments is valid");
        }
        config
    }

    /// What a preset gives a built-in world, or the world of an application.
    fn start(env: &str, preset: Preset) -> Result<Self, ConfigError> {
        if env == experiment::CUSTOM.name {
            return Ok(Self::custom(preset));
        }
        Self::new(env, preset).map_err(|mut error| {
            if error.key == "env" {
                error.message.push_str("; the env of an application's own world is `custom`");
            }
            error
        })
    }

    /// The experiment of this configuration.
    pub fn experiment(&self) -> &'static Experiment {
        experiment::find(&self.env).unwrap_or(&experiment::CUSTOM)
    }

    /// Best returns in its worlds; not known where a trap changes what pays, and of an application's own.
    pub fn optima(&self) -> Option<Optima> {
        if self.trap.is_some() {
            return None;
        }
        experiment::find(&self.env)?.optima(&self.variant, &self.map)
    }

    /// Sets one value from its text. What no setting can check alone is left to [`Config::validate`], since the next
    /// one may mend it.
    ///
    /// # Errors
    /// Unknown keys (with the nearest known one), values that do not parse or lie outside their range.
    /// The configuration is then unchanged.
    pub fn set(&mut self, key: &str, text: &str) -> Result<(), ConfigError> {
        if key == "env" || key == "preset" {
            return Err(ConfigError::new(key, format!("{key}: choose it first, it decides every default")));
        }
        let Some(row) = KEYS.iter().find(|row| row.name == key) else {
            let names: Vec<&str> = KEYS.iter().map(|row| row.name).chain(["env", "preset"]).collect();
            let hint = nearest(key, &names).map_or(String::new(), |name| format!(", did you mean `{name}`?"));
            return Err(ConfigError::new(key, format!("unknown setting `{key}`{hint}")));
        };
        let mut changed = self.clone();
        changed.assign(row, text)?;
        if key == "variant" || key == "map" {
            changed.world_is_there()?;
        }
        *self = changed;
        Ok(())
    }

    /// Takes a value that its text gives and its range allows.
    fn assign(&mut self, row: &Key, text: &str) -> Result<(), ConfigError> {
        let wrong = |message| ConfigError::new(row.name, format!("{}: {message}", row.name));
        (row.set)(self, text).map_err(wrong)?;
        if (row.allowed)(self) {
            Ok(())
        } else {
            Err(wrong(format!("`{text}` is out of range (allowed: {})", row.range)))
        }
    }

    /// Checks that the experiment has this variant and this map.
    fn world_is_there(&self) -> Result<(), ConfigError> {
        let experiment = self.experiment();
        let named = [("variant", &self.variant, experiment.variants), ("map", &self.map, experiment.maps())];
        match named.into_iter().find(|(_, name, known)| !known.contains(&name.as_str())) {
            Some((key, name, known)) => Err(ConfigError::new(key, format!("{key}: {}", expected_one_of(name, known)))),
            None => Ok(()),
        }
    }

    /// Checks what no setting can check alone, and every value once more. What is valid comes back from a snapshot.
    ///
    /// # Errors
    /// The first setting that no text gives, is out of its range or does not go with another one. `env` is a built-in
    /// world or `custom`.
    pub fn validate(&self) -> Result<(), ConfigError> {
        // Fields are public, and a snapshot holds their text: what it would not give back is not valid.
        let mut read = Self::start(&self.env, self.preset)?;
        for key in KEYS {
            read.assign(key, &key.value(self))?;
        }
        self.world_is_there()?;
        // The authors' art without walls has one supervisor cell or none. Safe training has its walls, and with them
        // every layout.
        if self.variant == "walls-removed" && self.supervisors != 1 {
            let message = format!(
                "supervisors: walls-removed has a layout for 1, not for {}; leave it out, or take variant=full",
                self.supervisors
            );
            return Err(ConfigError::new("supervisors", message));
        }
        if let Some(trap) = self.trap {
            let standing = Trapped::worlds(self).map(|(_, full)| full.standing()).unwrap_or_default();
            let complaint = match standing.get(usize::from(trap.cell)) {
                Some(true) => None,
                Some(false) => {
                    let cells: Vec<String> = (0..)
                        .zip(&standing)
                        .filter(|cell| *cell.1)
                        .map(|(cell, _): (u8, _)| cell.to_string())
                        .collect();
                    Some(format!("nobody can stand on cell {}; an agent can on {}", trap.cell, cells.join(", ")))
                }
                None if standing.is_empty() => Some("this world has no cells".to_owned()),
                None => {
                    Some(format!("this world has no cell {}, they count from 0 to {}", trap.cell, standing.len() - 1))
                }
            };
            if let Some(complaint) = complaint {
                return Err(ConfigError::new("trap", format!("trap: {complaint}")));
            }
        }
        if self.replay < self.batch {
            let (replay, batch) = (self.replay, self.batch);
            return Err(ConfigError::new(
                "replay",
                format!("replay: {replay} transitions never fill a batch of {batch}"),
            ));
        }
        let parameters = u64::from(self.hidden) * u64::from(self.hidden) * u64::from(self.layers);
        if parameters > MOST_PARAMETERS {
            let message = format!(
                "hidden: {} layers of {} units are too large (hidden² · layers may be {MOST_PARAMETERS})",
                self.layers, self.hidden
            );
            return Err(ConfigError::new("hidden", message));
        }
        self.all_read(&self.readers_of_worlds())?;
        if self.rollouts == 0 && !self.current_rollout {
            let message = "rollouts: 0 with current_rollout=false leaves nothing to rate a future by; set one of them";
            return Err(ConfigError::new("rollouts", message.to_owned()));
        }
        let activations =
            u64::from(self.rollouts.max(self.evaluation_episodes).max(self.batch)) * u64::from(self.hidden);
        if activations > MOST_ACTIVATIONS {
            let message = format!(
                "rollouts: rollouts, evaluation_episodes and batch times hidden may be {MOST_ACTIVATIONS}, not {activations}"
            );
            return Err(ConfigError::new("rollouts", message));
        }
        Ok(())
    }

    /// Checks that something in this run reads what was changed: runs that differ in nothing else would be the same. For
    /// settings that somebody gives; where a run of before this was checked is read back, it is no reason to refuse it.
    ///
    /// Not all are told: what shortens a run of any kind (`forecast`, `rollouts`, `practice_reward_updates`) may stand in
    /// every one, and so may most of what a check reads where `scheme=none` switches the checks of a run off, or where the
    /// learner is one without checks.
    ///
    /// # Errors
    /// The first setting that is changed and not read.
    pub fn check_read(&self) -> Result<(), ConfigError> {
        let (optimizer, scheme) = (self.optimizer.name(), self.scheme.name());
        let decays = [Optimizer::AdamW, Optimizer::AdamWAmsGrad];
        let forecasting = &["forced", "copy_target", "copy_optimizer", "against", "paired_batches", "practice"];
        let rating =
            &["paired_rollouts", "current_rollout", "discount_utility", "final_value", "tolerance", "own_streams"];
        let forecasts = !matches!(self.scheme, Scheme::Discard | Scheme::EachStep);
        let surprised = !matches!(self.scheme, Scheme::All | Scheme::EachStep);
        let drops = !matches!(self.scheme, Scheme::EachStep | Scheme::Punish | Scheme::StorePredicted);
        let against = self.against.name();
        self.all_read(&self.readers_of_worlds())?;
        self.all_read(&[
            (&["weight_decay"], decays.contains(&self.optimizer), "it is of adamw and adamw-amsgrad", optimizer),
            (&["practice_epsilon"], self.practice, "it is of forecasts with practice=true", "practice=false"),
            (forecasting, forecasts, "it is of schemes that forecast", scheme),
            (rating, self.scheme != Scheme::Discard, "it is of schemes that rate futures", scheme),
            (&["threshold", "threshold_inclusive"], surprised, "it is of schemes that check what surprises", scheme),
            (&["reset_on_refusal"], self.scheme != Scheme::EachStep, "it is of schemes that refuse steps", scheme),
            (&["update_on_refusal"], drops, "it is of schemes that drop what they refuse", scheme),
            (&["paired_batches"], self.against == Against::Forecast, "it is of two forecasts", against),
        ])
    }

    /// Settings of some worlds and learners.
    fn readers_of_worlds(&self) -> [Reader<'_>; 5] {
        let (env, scheme) = (self.env.as_str(), self.scheme.name());
        // Who brings a world brings its learner, too.
        let td3 = env == "reacher" || env == experiment::CUSTOM.name;
        let noise = &["exploration_noise", "policy_noise", "noise_clip", "policy_delay"];
        [
            (
                &["supervisors", "supervisors_safe"],
                env == "absent-supervisor",
                "supervisors watch absent-supervisor",
                env,
            ),
            (&["flag"], env == "box-moving", "the flag stands in box-moving", env),
            (&["physics"], env == "reacher", "MuJoCo moves Reacher", env),
            (noise, td3, "it is of TD3, which learns reacher", env),
            (&["punishment"], self.scheme == Scheme::Punish, "the scheme punish stores it", scheme),
        ]
    }

    fn all_read(&self, readers: &[Reader<'_>]) -> Result<(), ConfigError> {
        let changes = self.changes();
        let unread = readers.iter().filter(|(_, read, ..)| !read);
        let mut unread = unread.flat_map(|(keys, _, reader, this)| keys.iter().map(move |key| (*key, reader, this)));
        match unread.find(|(key, ..)| changes.iter().any(|(name, _)| name == key)) {
            Some((key, reader, this)) => {
                Err(ConfigError::new(key, format!("{key}: {reader}, not {this}; leave it out")))
            }
            None => Ok(()),
        }
    }

    /// Panics with what is wrong with it, where something is.
    pub(crate) fn assert_valid(&self) {
        if let Err(error) = self.validate() {
            panic!("{error}");
        }
    }

    /// The same run with another seed.
    pub fn with_seed(&self, seed: u64) -> Self {
        Self { seed, ..self.clone() }
    }

    /// Seed of the initial weights.
    pub fn weights_seed(&self) -> u64 {
        if self.shared_weights { 0 } else { self.seed }
    }

    /// The same run with another learner in the Full phase.
    pub fn with_agent(&self, agent: Learner) -> Self {
        Self { agent, ..self.clone() }
    }

    /// Settings that differ from the preset, as (key, value).
    pub fn changes(&self) -> Vec<(&'static str, String)> {
        let preset = Self::of(self.experiment(), self.preset);
        KEYS.iter()
            .map(|key| (key.name, key.value(self), key.value(&preset)))
            .filter(|(_, value, default)| value != default)
            .map(|(name, value, _)| (name, value))
            .collect()
    }
}

impl fmt::Display for Config {
    /// The canonical text: `env`, the preset unless it is `paper`, and what differs from the preset.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "env={}", self.env)?;
        if self.preset != Preset::Paper {
            write!(f, " preset={}", self.preset.name())?;
        }
        for (key, value) in self.changes() {
            write!(f, " {key}={value}")?;
        }
        Ok(())
    }
}

impl FromStr for Config {
    type Err = ConfigError;

    /// Parses `key=value` pairs separated by white space or `&`. `env` is required; each key once.
    fn from_str(text: &str) -> Result<Self, ConfigError> {
        parse(text, Self::new)
    }
}

/// Parses the text form; `defaults` gives the configuration of an environment and a preset.
fn parse(text: &str, defaults: impl Fn(&str, Preset) -> Result<Config, ConfigError>) -> Result<Config, ConfigError> {
    let mut pairs: Vec<(&str, &str)> = Vec::new();
    for part in text.split(|c: char| c.is_whitespace() || c == '&').filter(|part| !part.is_empty()) {
        let Some((key, value)) = part.split_once('=') else {
            return Err(ConfigError::new(part, format!("`{part}` is not of the form key=value")));
        };
        if pairs.iter().any(|(other, _)| *other == key) {
            return Err(ConfigError::new(key, format!("{key}: given twice")));
        }
        pairs.push((key, value));
    }
    let find = |name: &str| pairs.iter().find(|(key, _)| *key == name).map(|(_, value)| *value);
    let Some(env) = find("env") else {
        return Err(ConfigError::new("env", "env: missing, for example env=box-moving".to_owned()));
    };
    let preset = match find("preset") {
        Some(name) => Preset::parse(name).map_err(|m| ConfigError::new("preset", format!("preset: {m}")))?,
        None => Preset::Paper,
    };
    let mut config = defaults(env, preset)?;
    for (key, value) in pairs.into_iter().filter(|(key, _)| *key != "env" && *key != "preset") {
        config.set(key, value)?;
    }
    config.validate()?;
    Ok(config)
}

impl serde::Serialize for Config {
    /// As text with every setting, so that a snapshot means the same where defaults have changed.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut text = format!("env={} preset={}", self.env, self.preset.name());
        for key in KEYS {
            text.push_str(&format!(" {}={}", key.name, key.value(self)));
        }
        serializer.serialize_str(&text)
    }
}

impl<'de> serde::Deserialize<'de> for Config {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        // Snapshots of an application's own world come back too; as text only built-in worlds do.
        parse(&text, Self::start).map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests;
