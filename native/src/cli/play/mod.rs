//! `mcvl play`: a world in the user's hands, and at the end what the observed reward did not tell.

mod screen;

use std::io::{self, BufRead, ErrorKind, IsTerminal as _, Write as _};

use clap::Args;
use mcvl::report::claims::plural;
use mcvl::report::film;
use mcvl::worlds;
use mcvl_core::config::{Config, KEYS, Preset, expected_one_of};
use mcvl_core::env::{ActionSpec, Discrete, EpisodeEnd, Frame};
use mcvl_core::experiment::{EXPERIMENTS, Experiment, Optima};
use mcvl_core::play::{Play, Score};
use mcvl_core::record::Arm;
use serde_json::json;

use super::settings::{self, Given};
use super::terminal::{Terminal, wrap};
use super::{Done, WIDTH, usage};

/// Name of the Safe world, beside the variants of the Full one.
const SAFE: &str = "safe";

/// Settings that a world without a learner depends on.
const OF_WORLDS: [&str; 6] = ["variant", "map", "supervisors", "supervisors_safe", "trap", "seed"];

const HELP: &str = "\
Keys: arrows or w a s d act, q ends.

Where stdin is no terminal it is read for actions: words (up down left right)
or their first letters (uudu), until the episode is over or q comes.

Examples:
  mcvl play rocks-and-diamonds
  mcvl play absent-supervisor --variant walls-removed --seed 3
  mcvl play tomato-watering --set map=original
  mcvl play absent-supervisor --variant safe --set supervisors=12
  echo ddd | mcvl play absent-supervisor
  (echo down; yes down up) | mcvl play box-moving --json";

/// «Environments: ...»: those that can be driven by numbered actions.
fn playable() -> String {
    let is_numbered = |experiment: &&Experiment| {
        let config = Config::new(experiment.name, Preset::Paper).expect("the table has its name");
        matches!(worlds::spec(&config).actions, ActionSpec::Discrete(_))
    };
    let names: Vec<&str> = EXPERIMENTS.iter().filter(is_numbered).map(|experiment| experiment.name).collect();
    wrap(&format!("Environments: {}.", names.join(", ")), 0, WIDTH)
}

/// Arguments of `mcvl play`.
#[derive(Args)]
#[command(after_help = format!("{}\n\n{HELP}", playable()))]
pub struct PlayArgs {
    /// Environment, one with numbered actions (see below)
    env: String,
    /// World: safe, or a variant of the Full world [default: full]
    #[arg(long, value_name = "NAME")]
    variant: Option<String>,
    /// Seed of what is left to chance [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Set one value of the world: variant, map, supervisors, supervisors_safe, trap or seed (`mcvl
    /// train --help` has their meaning); may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = settings::assignment)]
    set: Vec<Given>,
    /// Print the episode as JSON
    #[arg(long)]
    json: bool,
}

/// Plays an episode.
pub fn play(arguments: &PlayArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let mut game = Game::new(arguments)?;
    let mut done = Done::Well;
    let on_screen = io::stdin().is_terminal() && io::stdout().is_terminal() && !arguments.json;
    if on_screen {
        done = screen::play(&mut game, terminal)?;
    } else {
        if !arguments.json {
            writeln!(terminal.out, "{}", game.title(terminal, WIDTH))?;
            draw(&game.play.frame(), terminal)?;
        }
        game.read(io::stdin().lock(), terminal, arguments.json)?;
    }
    if arguments.json {
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&game.json())?)?;
        return Ok(done);
    }
    game.result(terminal)?;
    Ok(done)
}

fn draw(frame: &Frame, terminal: &mut Terminal) -> io::Result<()> {
    writeln!(terminal.out)?;
    for row in film::board(frame, terminal.color) {
        writeln!(terminal.out, "{}", format!("  {row}").trim_end())?;
    }
    writeln!(terminal.out)
}

/// An episode that is played.
struct Game {
    experiment: &'static Experiment,
    config: Config,
    /// Name of the world: safe, or the variant.
    variant: String,
    play: Play,
    names: &'static [&'static str],
    actions: Vec<&'static str>,
    rewards: Vec<f32>,
    /// Steps whose observed reward was not what they were worth.
    fakes: u64,
}

/// (observed return, performance) of a route.
type Outcome = (f64, f64);

/// What a word or key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Input {
    Act(Discrete),
    Quit,
}

impl PlayArgs {
    /// The configuration of the world, and the name of the world in it: safe, or the variant.
    fn world(&self) -> anyhow::Result<(Config, String)> {
        let mut given = self.set.clone();
        given.extend(self.variant.as_ref().map(|variant| Given::flag("variant", variant.clone())));
        given.extend(self.seed.map(|seed| Given::flag("seed", seed.to_string())));
        settings::check_once(&given)?;
        let mut config = Config::new(&self.env, Preset::Paper)?;
        let variants = config.experiment().variants;
        let mut name = config.variant.clone();
        for Given { key, value, .. } in &given {
            let is_setting = KEYS.iter().map(|key| key.name).chain(["env", "preset"]).any(|name| name == key);
            if is_setting && !OF_WORLDS.contains(&key.as_str()) {
                usage!("{key}: no world that is played depends on it; known here are {}", OF_WORLDS.join(", "));
            }
            if key == "variant" {
                if value != SAFE && !variants.contains(&value.as_str()) {
                    let names: Vec<&str> = [SAFE].into_iter().chain(variants.iter().copied()).collect();
                    usage!("variant: {}", expected_one_of(value, &names));
                }
                name.clone_from(value);
            }
            if key != "variant" || value != SAFE {
                config.set(key, value)?;
            }
        }
        config.validate()?;
        let unread =
            if name == SAFE { ("trap", "the Full world has it") } else { ("supervisors_safe", "they watch safe") };
        if given.iter().any(|given| given.key == unread.0) {
            usage!("{}: {}, not {name}; leave it out", unread.0, unread.1);
        }
        Ok((config, name))
    }
}

impl Game {
    fn new(arguments: &PlayArgs) -> anyhow::Result<Self> {
        let (config, variant) = arguments.world()?;
        let play = Play::new(&config, if variant == SAFE { Arm::Safe } else { Arm::Baseline });
        let ActionSpec::Discrete(names) = play.spec().actions else {
            usage!("mcvl play drives worlds with numbered actions; {} takes torques", arguments.env);
        };
        Ok(Self {
            experiment: config.experiment(),
            config,
            variant,
            play,
            names,
            actions: Vec::new(),
            rewards: Vec::new(),
            fakes: 0,
        })
    }

    fn score(&self) -> Score {
        self.play.score()
    }

    /// Whether the episode is over.
    fn is_over(&self) -> bool {
        self.score().end.is_some()
    }

    /// Makes a step; its reward, or nothing if the episode is over.
    fn act(&mut self, action: Discrete) -> Option<f32> {
        let before = self.score().performance;
        let reward = self.play.step(action)?.reward;
        // The difference of two sums is beside the reward by their rounding.
        self.fakes += u64::from((f64::from(reward) - (self.score().performance - before)).abs() > 1e-6);
        self.actions.push(self.names[usize::from(action.0)]);
        self.rewards.push(reward);
        Some(reward)
    }

    /// Best returns in this world, where they are known: without the hack, and with it.
    fn routes(&self) -> Option<Optima> {
        let known = self.config.optima()?;
        let safe = Optima { intended: known.safe_best, hackable: false, hacking: None, ..known };
        Some(if self.variant == SAFE { safe } else { known })
    }

    /// World, variant, seed, what else was set, and the task.
    fn title(&self, terminal: &Terminal, width: usize) -> String {
        let title = terminal.paint(1, self.experiment.title);
        let task = wrap(&format!("Task: {}.", self.experiment.task), 0, width);
        let set: String = (self.config.changes().into_iter())
            .filter(|(key, _)| !["variant", "seed"].contains(key))
            .map(|(key, value)| format!(", {key}={value}"))
            .collect();
        format!("{title} ({}), seed {}{set}\n{task}", self.variant, self.config.seed)
    }

    /// Reads actions until the episode is over or nobody wants to go on; each step is a line.
    fn read(&mut self, mut input: impl BufRead, terminal: &mut Terminal, silent: bool) -> anyhow::Result<()> {
        let mut line = String::new();
        for number in 1.. {
            line.clear();
            if self.is_over() {
                break;
            }
            match input.read_line(&mut line) {
                Ok(0) => break,
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::InvalidData => {
                    usage!("line {number} of stdin is no text: write actions by their names");
                }
                Err(error) => return Err(error.into()),
            }
            for word in line.split_whitespace() {
                let Some(inputs) = inputs(word, self.names) else {
                    let names = self.names.join(", ");
                    usage!("line {number} of stdin: `{word}` is no action; there are {names}, their first letters, q");
                };
                for input in inputs {
                    let Input::Act(action) = input else { return Ok(()) };
                    let Some(reward) = self.act(action) else { return Ok(()) };
                    if !silent {
                        let (step, name) = (self.score().steps, self.names[usize::from(action.0)]);
                        let sum = amount(self.score().observed_return);
                        let reward = amount(f64::from(reward));
                        writeln!(terminal.out, "{step:>4} {name:<6} reward {reward:>6}  return {sum:>7}")?;
                    }
                }
            }
        }
        Ok(())
    }

    /// The last board, the hidden score, and how it compares.
    fn result(&self, terminal: &mut Terminal) -> io::Result<()> {
        let frame = self.play.frame();
        draw(&frame, terminal)?;
        if let Some(truth) = frame.truth {
            writeln!(terminal.out, "In truth:")?;
            draw(&Frame { seen: truth, truth: None }, terminal)?;
        }
        let score = self.score();
        let end = match score.end {
            Some(EpisodeEnd::Terminated) => format!("The episode ended after {} steps.", score.steps),
            Some(EpisodeEnd::Truncated) => format!("The episode is over: {} steps are all there are.", score.steps),
            None => format!("Stopped after {} of at most {} steps.", score.steps, self.play.spec().max_steps),
        };
        writeln!(terminal.out, "{end}\n\n{:<22}{:>9}{:>9}", "", "observed", "hidden")?;
        let routes = self.routes();
        let hack = match routes {
            Some(Optima { hackable: false, .. }) => "there is none",
            _ => "not known",
        };
        let rows = [
            ("you", Some((score.observed_return, score.performance)), ""),
            ("intended, at best", routes.map(|routes| (routes.intended, routes.intended)), "not known"),
            ("the hack", routes.and_then(|routes| routes.hacking), hack),
        ];
        for (name, outcome, otherwise) in rows {
            match outcome {
                Some((observed, hidden)) => {
                    writeln!(terminal.out, "  {name:<20}{:>9}{:>9}", amount(observed), amount(hidden))?;
                }
                None => writeln!(terminal.out, "  {name:<20}{otherwise:>18}")?,
            }
        }
        if routes.is_some() && !self.play.spec().deterministic {
            writeln!(terminal.out, "  (the routes on average: this world has chance in it)")?;
        }
        let verdict = self.verdict();
        writeln!(terminal.out, "\n{}", wrap(&verdict, 0, WIDTH))
    }

    /// What became of the player's reward, in words.
    fn verdict(&self) -> String {
        let score = self.score();
        let fake = score.observed_return - score.performance;
        let size = amount(fake.abs());
        let size = size.trim_start_matches('+');
        // Sums of rewards like 0.02 end a little beside their decimal value.
        if fake.abs() >= 0.005 {
            let advice = "A learner that takes this reward at its word learns to do it again.";
            return match fake > 0.0 {
                true => format!("{size} of the observed reward was fake: paid, but not wanted. {advice}"),
                false => format!("What you did was worth {size} more than it paid."),
            };
        }
        if self.fakes > 0 {
            let some = plural(self.fakes, "reward");
            return format!(
                "What you were paid is in sum what it was worth, but {some} of it were fake and cancel out."
            );
        }
        let mut text = String::from("What you were paid is what it was worth: no reward was fake.");
        if let Some(routes) = self.routes().filter(|_| self.is_over()) {
            let share = 100.0 * score.performance.max(0.0) / routes.intended;
            text += &format!(" It is {share:.0} % of what the intended route brings.");
        }
        text
    }

    fn json(&self) -> serde_json::Value {
        let score = self.score();
        let routes = self.routes();
        let outcome = |(observed, hidden): Outcome| json!({ "return": observed, "performance": hidden });
        // Sums and single rewards with the digits that they have where they are written down.
        let decimal = |value: f64| (1e6 * value).round() / 1e6;
        json!({
            "env": self.experiment.name,
            "variant": self.variant,
            "seed": self.config.seed,
            "config": self.config.to_string(),
            "steps": score.steps,
            "end": score.end,
            "actions": self.actions,
            "rewards": self.rewards.iter().map(|reward| decimal(f64::from(*reward))).collect::<Vec<_>>(),
            "return": decimal(score.observed_return),
            "performance": decimal(score.performance),
            "intended": routes.map(|routes| outcome((routes.intended, routes.intended))),
            "hack": routes.and_then(|routes| routes.hacking).map(outcome),
        })
    }
}

/// What a word asks for: the name of an action, or letters with which names begin.
fn inputs(word: &str, names: &[&str]) -> Option<Vec<Input>> {
    let word = word.to_lowercase();
    let act = |index: usize| Input::Act(Discrete(index as u8));
    if word == "quit" {
        return Some(vec![Input::Quit]);
    }
    if let Some(index) = names.iter().position(|name| *name == word) {
        return Some(vec![act(index)]);
    }
    let letter = |letter: char| match names.iter().position(|name| name.starts_with(letter)) {
        Some(index) => Some(act(index)),
        None => (letter == 'q').then_some(Input::Quit),
    };
    word.chars().map(letter).collect()
}

/// A raw reward with its sign and at most two decimals.
fn amount(value: f64) -> String {
    let text = format!("{value:+.2}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "+0".to_owned() } else { short.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_and_letters_are_actions() {
        let names = ["up", "down", "left", "right"];
        let act = |index| Input::Act(Discrete(index));
        assert_eq!(inputs("down", &names).unwrap(), [act(1)]);
        assert_eq!(inputs("UdlR", &names).unwrap(), [act(0), act(1), act(2), act(3)]);
        assert_eq!(inputs("duq", &names).unwrap(), [act(1), act(0), Input::Quit]);
        assert_eq!(inputs("quit", &names).unwrap(), [Input::Quit]);
        assert_eq!((inputs("dx", &names), inputs("left", &names[..2])), (None, None));
    }

    #[test]
    fn amounts_are_short() {
        let texts = [5.0, -49.0, 0.0, -0.001, 0.1599999, 14.19, 100.0].map(amount);
        assert_eq!(texts, ["+5", "-49", "+0", "+0", "+0.16", "+14.19", "+100"]);
    }
}
