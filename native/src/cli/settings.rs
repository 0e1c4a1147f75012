//! The settings of a run and where each comes from. Stronger layers come later:
//! defaults < preset < `--quick` < `--config` file < environment variables < flags.

use std::env;
use std::path::{Path, PathBuf};

use mcvl::runs::{Origin, Setting};
use mcvl::worlds;
use mcvl_core::config::{Config, ConfigError, KEYS, Preset, nearest};

use super::{Usage, terminal::Terminal, usage};

/// Prefix of environment variables: `MCVL_THRESHOLD=0.1`.
const PREFIX: &str = "MCVL_";

/// What `--quick` sets: a run of seconds that shows every part at work. It is not the paper's setting.
pub const QUICK: &[(&str, &str)] = &[
    ("safe_steps", "300"),
    ("full_steps", "300"),
    ("exploration", "50"),
    // As many as the exploration steps, also in Reacher.
    ("learning_starts", "0"),
    ("epsilon_decay", "200"),
    ("forecast", "200"),
    ("practice_reward_updates", "200"),
    ("evaluations", "10"),
];

/// Origin of those values in `run.toml`.
pub const QUICK_ORIGIN: &str = "flag --quick";

/// A value that somebody gave, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Given {
    /// The setting.
    pub key: String,
    /// Its value as text.
    pub value: String,
    /// Where it was given, in words.
    pub from: String,
}

impl Given {
    /// By a flag of its own.
    pub fn flag(key: &str, value: String) -> Self {
        Self { key: key.to_owned(), value, from: format!("flag --{key}") }
    }
}

/// What the command line says about settings.
#[derive(Debug, Default)]
pub struct Request<'a> {
    /// The environment.
    pub env: &'a str,
    /// `--preset`.
    pub preset: Option<Preset>,
    /// `--quick`.
    pub quick: bool,
    /// `--config`.
    pub file: Option<&'a Path>,
    /// All flags that set a key.
    pub flags: Vec<Given>,
}

/// Settings with their origin.
#[derive(Debug)]
pub struct Resolved {
    /// The configuration.
    pub config: Config,
    /// What was given by file, environment and flags, weakest first: it differs from defaults by intent.
    pub given: Vec<Given>,
    /// Value and origin of every setting.
    pub settings: Vec<(String, Setting)>,
}

/// Puts the layers together.
///
/// # Errors
/// Unknown keys, values that do not fit, keys given twice in one layer.
pub fn resolve(request: &Request<'_>, terminal: &Terminal) -> anyhow::Result<Resolved> {
    let variables =
        environment(env::vars_os().map(|(name, value)| (name.into_string(), value.into_string())), terminal)?;
    resolve_layers(request, variables)
}

fn resolve_layers(request: &Request<'_>, variables: Vec<Given>) -> anyhow::Result<Resolved> {
    let mut given = match request.file {
        Some(path) => file(path)?,
        None => Vec::new(),
    };
    given.extend(variables);
    let from_layers = take(&mut given, "preset");
    if let Some(other) = take(&mut given, "env").filter(|other| other.value != request.env) {
        usage!(
            "env: {} from {}, but {} on the command line: leave one of them out",
            other.value,
            other.from,
            request.env
        );
    }
    let preset = match (request.preset, from_layers) {
        (Some(preset), _) => preset,
        (None, Some(given)) => {
            super::preset(&given.value).map_err(|why| Usage(format!("preset: {why} ({})", given.from)))?
        }
        (None, None) => Preset::Paper,
    };
    if let Some(given) = request.flags.iter().find(|given| given.key == "preset") {
        usage!("preset: it decides every default, so it has a flag of its own: --preset {}", given.value);
    }
    check_once(&request.flags)?;
    given.extend(request.flags.iter().cloned());

    let mut config = Config::new(request.env, preset)?;
    let mut origins: Vec<(String, String)> = Vec::new();
    if preset != Preset::Paper {
        let paper = Config::new(request.env, Preset::Paper)?;
        let changed = KEYS.iter().filter(|key| key.value(&config) != key.value(&paper));
        origins.extend(changed.map(|key| (key.name.to_owned(), format!("preset {}", preset.name()))));
    }
    let simulator = worlds::default_simulator(request.env);
    if simulator != config.physics {
        config.physics = simulator;
        origins.push(("physics".to_owned(), "default (MuJoCo is linked)".to_owned()));
    }
    let quick = if request.quick { QUICK } else { &[] };
    let quick = quick.iter().map(|(key, value)| Given {
        key: (*key).to_owned(),
        value: (*value).to_owned(),
        from: QUICK_ORIGIN.to_owned(),
    });
    for value in quick.chain(given.iter().cloned()) {
        config.set(&value.key, &value.value).map_err(|error| explain(error, &value.from))?;
        origins.push((value.key, value.from));
    }
    config.validate()?;
    config.check_read()?;
    worlds::available(&config).map_err(|error| Usage(error.to_string()))?;
    let origin = |key: &str| match origins.iter().rev().find(|(name, _)| name == key) {
        Some((_, from)) => Origin(from.clone()),
        None => Origin::default_value(),
    };
    let settings = KEYS
        .iter()
        .map(|key| (key.name.to_owned(), Setting { value: key.value(&config), from: origin(key.name) }))
        .collect();
    Ok(Resolved { config, given, settings })
}

/// Checks that no two flags set the same key.
///
/// # Errors
/// The first key that is given twice.
pub fn check_once(flags: &[Given]) -> anyhow::Result<()> {
    for (index, flag) in flags.iter().enumerate() {
        if let Some(other) = flags[..index].iter().find(|other| other.key == flag.key) {
            usage!("{}: given twice, by {} and by {}", flag.key, other.from, flag.from);
        }
    }
    Ok(())
}

/// Says where the value came from, unless that is what the user just typed.
fn explain(error: ConfigError, from: &str) -> anyhow::Error {
    if from.starts_with("flag") { error.into() } else { Usage(format!("{error} ({from})")).into() }
}

fn take(given: &mut Vec<Given>, key: &str) -> Option<Given> {
    let last = given.iter().rev().find(|value| value.key == key).cloned();
    given.retain(|value| value.key != key);
    last
}

/// Variables of this project that are no settings: what the build script tells the program (`cargo run`
/// hands it on), and what the tests are told.
const OWN: [&str; 3] = ["build_", "bin", "golden_dir"];

/// Settings among the environment variables.
fn environment(
    variables: impl Iterator<Item = (Result<String, std::ffi::OsString>, Result<String, std::ffi::OsString>)>,
    terminal: &Terminal,
) -> anyhow::Result<Vec<Given>> {
    let names: Vec<&str> = KEYS.iter().map(|key| key.name).chain(["preset", "env"]).collect();
    let mut given = Vec::new();
    for (name, value) in variables {
        let Some(key) = name.as_deref().ok().and_then(|name| name.strip_prefix(PREFIX)).map(str::to_lowercase) else {
            continue;
        };
        if names.contains(&key.as_str()) {
            let Ok(value) = value else { usage!("{PREFIX}{}: its value is no text", key.to_uppercase()) };
            given.push(Given { from: format!("environment variable {PREFIX}{}", key.to_uppercase()), key, value });
        } else if let Some(near) = nearest(&key, &names) {
            let (key, near) = (key.to_uppercase(), near.to_uppercase());
            usage!("environment variable {PREFIX}{key}: no such setting, did you mean `{PREFIX}{near}`?");
        } else if !OWN.iter().any(|own| key.starts_with(own)) {
            terminal.note(format_args!("note: {PREFIX}{} is no setting of mcvl and is ignored", key.to_uppercase()));
        }
    }
    given.sort_by(|a, b| a.key.cmp(&b.key));
    Ok(given)
}

/// Settings of a `--config` file: TOML with `key = value`.
fn file(path: &Path) -> anyhow::Result<Vec<Given>> {
    let name = path.display();
    let text = std::fs::read_to_string(path).map_err(|error| Usage(format!("--config {name}: {error}")))?;
    let table: toml::Table = text.parse().map_err(|error| Usage(format!("--config {name}: {error}")))?;
    if table.contains_key("settings") && table.contains_key("seeds") {
        usage!("--config {name}: this is the run.toml of a run, no file of settings; --resume goes on with its run");
    }
    let given = table.into_iter().map(|(key, value)| {
        let value = match value {
            toml::Value::String(text) => text,
            toml::Value::Integer(_) | toml::Value::Float(_) | toml::Value::Boolean(_) => value.to_string(),
            _ => usage!("--config {name}: {key} has to be one value, like `{key} = 1` or `{key} = \"text\"`"),
        };
        Ok(Given { key, value, from: format!("file {name}") })
    });
    given.collect()
}

/// Parses `--set key=value`.
pub fn assignment(text: &str) -> Result<Given, String> {
    match text.split_once('=') {
        Some((key, value)) if !key.is_empty() => {
            Ok(Given { key: key.trim().to_owned(), value: value.trim().to_owned(), from: "flag --set".to_owned() })
        }
        _ => Err(format!("`{text}` is not of the form key=value")),
    }
}

/// Seeds, ascending; by a name of its own, since clap takes a `Vec` for an argument that is repeated.
pub type SeedList = Vec<u64>;

/// Parses `--seeds`: `0..10` (the end is left out), `1,5,9`, or a mixture.
pub fn seeds(text: &str) -> Result<SeedList, String> {
    let wrong = || format!("`{text}` is no list of seeds: write 0..10 (0 to 9) or 1,5,9");
    let mut seeds = Vec::new();
    for part in text.split(',') {
        match part.split_once("..") {
            Some((first, end)) => {
                let (first, end): (u64, u64) = (first.parse().map_err(|_| wrong())?, end.parse().map_err(|_| wrong())?);
                if end.saturating_sub(first) > 100_000 {
                    return Err(format!("`{text}` are more than 100000 seeds"));
                }
                seeds.extend(first..end);
            }
            None => seeds.push(part.parse().map_err(|_| wrong())?),
        }
    }
    seeds.sort_unstable();
    seeds.dedup();
    if seeds.is_empty() { Err(wrong()) } else { Ok(seeds) }
}

/// Parses `reproduce --seeds`: as [`seeds`], but a number alone is how many, from 0 on; one seed is `3..4`.
pub fn seeds_or_count(text: &str) -> Result<SeedList, String> {
    match text.parse::<u64>() {
        Ok(0) => Err("0 seeds are none: write 10 for the first ten, or 0..1 for seed 0 alone".to_owned()),
        Ok(count) => seeds(&format!("0..{count}")),
        Err(_) => seeds(text),
    }
}

/// Every setting with its meaning and default, for the long help.
pub fn list() -> String {
    let mut text = String::from(
        "Settings (--set key=value, MCVL_KEY=value, or a --config file), with defaults,\n\
         [what is allowed] and (where the default comes from: P the paper, A the\n\
         authors' release, CleanRL its TD3, own a choice of this project):\n",
    );
    for key in KEYS {
        let meaning =
            super::terminal::wrap(&format!("{} [{}] ({})", key.help, key.range(), key.source), 6, super::WIDTH);
        text.push_str(&format!("  {}={}\n{meaning}\n", key.name, key.paper));
    }
    text.push_str("Environments have defaults of their own: `mcvl train ENV --dry-run` shows them.\n--quick sets:");
    for (key, value) in QUICK {
        text.push_str(&format!("\n  {key}={value}"));
    }
    text
}

/// Where a run goes that names no directory.
pub fn default_directory(env: &str) -> PathBuf {
    Path::new("runs").join(env)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::terminal::Color;

    fn given(key: &str, value: &str, from: &str) -> Given {
        Given { key: key.to_owned(), value: value.to_owned(), from: from.to_owned() }
    }

    fn origin(resolved: &Resolved, key: &str) -> (String, String) {
        let (_, setting) = resolved.settings.iter().find(|(name, _)| name == key).unwrap();
        (setting.value.clone(), setting.from.0.clone())
    }

    #[test]
    fn stronger_layers_win_and_say_so() {
        let flags = vec![given("gamma", "0.5", "flag --set")];
        let request = Request { env: "box-moving", preset: Some(Preset::Release), quick: true, file: None, flags };
        let variables =
            vec![given("gamma", "0.4", "environment variable MCVL_GAMMA"), given("forecast", "7", "variable")];
        let resolved = resolve_layers(&request, variables).unwrap();
        assert_eq!(origin(&resolved, "gamma"), ("0.5".to_owned(), "flag --set".to_owned()));
        assert_eq!(origin(&resolved, "forecast"), ("7".to_owned(), "variable".to_owned()));
        assert_eq!(origin(&resolved, "safe_steps"), ("300".to_owned(), "flag --quick".to_owned()));
        assert_eq!(origin(&resolved, "threshold"), ("0.25".to_owned(), "preset release".to_owned()));
        assert_eq!(origin(&resolved, "tau"), ("0.005".to_owned(), "default".to_owned()));
    }

    #[test]
    fn mistakes_are_named_with_their_place() {
        let message = |flags, variables| {
            let request = Request { env: "box-moving", flags, ..Request::default() };
            resolve_layers(&request, variables).unwrap_err().to_string()
        };
        let twice = vec![given("gamma", "1", "flag --set"), given("gamma", "1", "flag --set")];
        assert_eq!(message(twice, Vec::new()), "gamma: given twice, by flag --set and by flag --set");
        let variable = vec![given("gamma", "2", "environment variable MCVL_GAMMA")];
        let expected = "gamma: `2` is out of range (allowed: 0 to 1) (environment variable MCVL_GAMMA)";
        assert_eq!(message(Vec::new(), variable), expected);
        let terminal = Terminal::new(Color::Never, true, false);
        let variables = [(Ok("MCVL_TRESHOLD".to_owned()), Ok("1".to_owned()))];
        let error = environment(variables.into_iter(), &terminal).unwrap_err().to_string();
        assert!(error.ends_with("did you mean `MCVL_THRESHOLD`?"), "{error}");
    }

    #[test]
    fn lists_of_seeds() {
        assert_eq!(seeds("0..3").unwrap(), [0, 1, 2]);
        assert_eq!(seeds("9,1,5,1").unwrap(), [1, 5, 9]);
        assert_eq!(seeds("7,0..2").unwrap(), [0, 1, 7]);
        for bad in ["", "a", "3..3", "1,", "-1", "0..9999999999"] {
            assert!(seeds(bad).is_err(), "{bad}");
        }
    }
}
