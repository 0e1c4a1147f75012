//! The handle through which the page holds a run: text in, text out, nothing decided here.
//!
//! Structured values cross as JSON: one string per call is cheaper than an object per event, and the
//! page reads exactly what the native program writes to its logs.
#![forbid(unsafe_code)]

use mcvl_core::config::{Config, ConfigError, KEYS, Learner, Preset};
use mcvl_core::env::{ActionSpec, Continuous, Discrete};
use mcvl_core::exact;
use mcvl_core::experiment::{EXPERIMENTS, Experiment};
use mcvl_core::play::Play;
use mcvl_core::record::{Arm, Event};
use mcvl_core::run::{Budget, Run, Status, Task};
use mcvl_core::token::{Token, decision_digest};
use serde::Serialize;
use serde_json::{Map, Value, json};
use wasm_bindgen::prelude::*;

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_namespace = console, js_name = error)]
    fn console_error(text: &str);
}

/// Shows the message of a panic in the console: the trap that follows it has none.
#[wasm_bindgen(start)]
pub fn show_panics() {
    std::panic::set_hook(Box::new(|panic| console_error(&panic.to_string())));
}

/// Digest of every stage of core's arithmetic, as a JSON object of hexadecimal numbers.
#[wasm_bindgen]
pub fn digests() -> String {
    let digests = exact::digests().into_iter();
    let map: Map<String, Value> =
        digests.map(|(stage, digest)| (stage.into(), format!("{digest:016x}").into())).collect();
    text(&map)
}

/// The experiments whose worlds are here as a JSON array: `name` (the value of `env`), `title`, `task` and `hack` in
/// words.
#[wasm_bindgen]
pub fn experiments() -> String {
    let here = |experiment: &&Experiment| Config::new(experiment.name, Preset::Paper).is_ok_and(|c| Play::offers(&c));
    let rows = EXPERIMENTS.iter().filter(here).map(|experiment| {
        json!({
            "name": experiment.name,
            "title": experiment.title,
            "task": experiment.task,
            "hack": experiment.hack,
        })
    });
    text(&rows.collect::<Vec<Value>>())
}

/// Why the world of a configuration text can be driven but is not trained here, in words; none where it is trained.
///
/// # Errors
/// If the text is no configuration, or its world is not here; the message says what would be.
#[wasm_bindgen]
pub fn untrained(configuration: &str) -> Result<Option<String>, JsError> {
    let config = offered(configuration)?;
    Ok((!Run::offers(&config)).then(|| {
        format!(
            "Trained natively: `mcvl train {} --preset small`; here you can drive the arm, which its equations move, and \
             watch recorded runs (open a tape, or `mcvl serve RUN`).",
            config.env
        )
    }))
}

/// What a replay token names, as a JSON object: `configuration` and `number` of the check.
///
/// # Errors
/// If the text is no token, or was cut or altered.
#[wasm_bindgen(js_name = readToken)]
pub fn read_token(token: &str) -> Result<String, JsError> {
    let token: Token = token.parse().map_err(|error: String| JsError::new(&error))?;
    Ok(text(&json!({ "configuration": token.config.to_string(), "number": token.number })))
}

/// A run and the events that the page has not read yet.
#[wasm_bindgen(js_name = Run)]
pub struct Handle {
    run: Run,
    events: Vec<Event>,
    /// Digests of all decisions so far, for tokens.
    decisions: Vec<u64>,
}

#[wasm_bindgen(js_class = Run)]
impl Handle {
    /// A run from its configuration text, for example `env=box-moving seed=7`.
    ///
    /// # Errors
    /// If the text is no configuration; the message says what would be.
    #[wasm_bindgen(constructor)]
    pub fn new(configuration: &str) -> Result<Handle, JsError> {
        let config = offered(configuration)?;
        if !Run::offers(&config) {
            let env = &config.env;
            return Err(JsError::new(&format!("env: {env} is not trained on the page; `mcvl train {env}` trains it")));
        }
        Ok(Self { run: Run::new(&config), events: Vec::new(), decisions: Vec::new() })
    }

    /// Does a bounded amount of work and returns `working`, `switch` or `done`.
    ///
    /// # Errors
    /// If training diverged: the run is then of no further use.
    pub fn poll(&mut self, budget: u32) -> Result<String, JsError> {
        let Self { run, events, decisions } = self;
        run.poll(Budget(budget), &mut |event: &Event| {
            if let Event::Check(check) = event {
                decisions.push(decision_digest(&text(&check.without_films())));
            }
            events.push(event.clone());
        })?;
        Ok(self.status())
    }

    /// Where the run stands: `working`, `switch` or `done`.
    pub fn status(&self) -> String {
        let name = match self.run.status() {
            Status::Working => "working",
            Status::Switch => "switch",
            Status::Done => "done",
        };
        name.into()
    }

    /// The events since the last call, oldest first, as a JSON array.
    pub fn events(&mut self) -> String {
        text(&core::mem::take(&mut self.events))
    }

    /// The replay token of a check of this run, if it was made: `mcvl replay` and the page take it.
    pub fn token(&self, number: u32) -> Option<String> {
        let digest = *self.decisions.get(number.checked_sub(1)? as usize)?;
        Some(Token { config: self.run.config().clone(), number, digest }.to_string())
    }

    /// Figures for progress displays, as a JSON object.
    pub fn progress(&self) -> String {
        let progress = self.run.progress();
        text(&json!({
            "arm": progress.arm,
            "step": progress.step,
            "steps": progress.steps,
            "updates": progress.updates,
            "checks": progress.checks,
            "refusals": progress.refusals,
            "forecast_updates": progress.forecast_updates,
            "check": progress.check,
        }))
    }

    /// The situation of the live world: `seen`, and `truth` where it differs, rows separated by line feeds.
    pub fn frame(&self) -> String {
        text(&self.run.frame())
    }

    /// Facts of the world that a drawing needs, as a JSON object: core's `EnvSpec`.
    pub fn world(&self) -> String {
        text(self.run.spec())
    }

    /// What a run of this world costs, in words.
    pub fn cost(&self) -> String {
        self.run.config().experiment().cost.into()
    }

    /// The canonical text of the run: the same text gives the same run here and natively.
    pub fn configuration(&self) -> String {
        self.run.config().to_string()
    }

    /// Every setting of the run as a JSON array: its name, its value, the value of an untouched run of this
    /// world, meaning and range in words, and the source.
    ///
    /// # Errors
    /// Never, as long as the run's own world and preset exist.
    pub fn settings(&self) -> Result<String, JsError> {
        settings(self.run.config())
    }

    /// A copy that continues from the switch with another learner, `mc` or `baseline`. Both share the
    /// Safe training that is already done.
    ///
    /// # Errors
    /// If there is no such learner, or the run is past the switch.
    pub fn fork(&self, agent: &str) -> Result<Handle, JsError> {
        let run = self.run.fork(learner(agent)?).ok_or_else(|| {
            JsError::new("fork: the run is past the switch to the Full world; fork it while its status is `switch`")
        })?;
        Ok(Self { run, events: Vec::new(), decisions: Vec::new() })
    }

    /// Lets other modules train the futures: during a check there are jobs to take, and polls do nothing until the
    /// future of each is handed back.
    #[wasm_bindgen(js_name = forecastElsewhere)]
    pub fn forecast_elsewhere(&mut self) {
        // Every run here is of a built-in world.
        let _ = self.run.forecast_elsewhere();
    }

    /// Trains the futures itself from here on; a forecast under way begins again.
    #[wasm_bindgen(js_name = forecastHere)]
    pub fn forecast_here(&mut self) {
        self.run.forecast_here();
    }

    /// The next job of the check under way, for a [`Forecast`]; each once.
    #[wasm_bindgen(js_name = takeJob)]
    pub fn take_job(&mut self) -> Option<Vec<u8>> {
        self.run.take_job()
    }

    /// Takes the future of one of its jobs.
    ///
    /// # Errors
    /// If the bytes are none that this run waits for; nothing is changed then.
    #[wasm_bindgen(js_name = handBack)]
    pub fn hand_back(&mut self, future: &[u8]) -> Result<(), JsError> {
        Ok(self.run.hand_back(future)?)
    }
}

/// A future that a run of another module lets train here.
#[wasm_bindgen]
pub struct Forecast {
    task: Task,
}

#[wasm_bindgen]
impl Forecast {
    /// Opens a job that a run gave.
    ///
    /// # Errors
    /// If the bytes are no job; the message says why.
    #[wasm_bindgen(constructor)]
    pub fn new(job: &[u8]) -> Result<Forecast, JsError> {
        Ok(Self { task: Task::open(job)? })
    }

    /// Does a bounded amount of work; the future, as bytes, once it is trained.
    pub fn poll(&mut self, budget: u32) -> Option<Vec<u8>> {
        self.task.poll(Budget(budget))
    }
}

/// An episode that a person drives in the Full world of a run: nobody learns.
#[wasm_bindgen]
pub struct Drive {
    play: Play,
    config: Config,
}

#[wasm_bindgen]
impl Drive {
    /// The first episode in the world of a configuration text.
    ///
    /// # Errors
    /// If the text is no configuration; the message says what would be.
    #[wasm_bindgen(constructor)]
    pub fn new(configuration: &str) -> Result<Drive, JsError> {
        let config = offered(configuration)?;
        Ok(Self { play: Play::new(&config, Arm::Baseline), config })
    }

    /// Makes a step and gives its observed reward, raw; none if the episode is over.
    ///
    /// # Errors
    /// If there is no such action.
    pub fn act(&mut self, action: u8) -> Result<Option<f32>, JsError> {
        match self.play.spec().actions {
            ActionSpec::Discrete(names) if usize::from(action) < names.len() => {
                Ok(self.play.step(Discrete(action)).map(|step| step.reward))
            }
            _ => Err(JsError::new(&format!("action {action}: this world has no such action"))),
        }
    }

    /// Makes a step with two torques, as [`act`](Drive::act) does with a numbered action.
    ///
    /// # Errors
    /// If this world has no torques, or these are no finite numbers.
    pub fn turn(&mut self, shoulder: f32, elbow: f32) -> Result<Option<f32>, JsError> {
        match self.play.spec().actions {
            ActionSpec::Continuous { .. } if shoulder.is_finite() && elbow.is_finite() => {
                Ok(self.play.step(Continuous([shoulder, elbow])).map(|step| step.reward))
            }
            _ => Err(JsError::new(&format!("torques {shoulder} and {elbow}: this world has no such action"))),
        }
    }

    /// What the driver may know of the episode so far, as a JSON object: the `frame`, or the `pose` of an arm in metres.
    /// Its `button` is hidden until it has paid or the episode has `ended`.
    pub fn state(&self, ended: bool) -> String {
        let score = self.play.score();
        let ended = ended || score.end.is_some();
        let pose = self.play.pose().map(|pose| {
            let button = pose.button.filter(|button| ended || button.pressed()).map(|button| *button.rule());
            json!({
                "elbow": pose.elbow,
                "tip": pose.tip,
                "target": pose.target,
                "button": button.map(|rule| json!({ "centre": rule.centre, "radius": rule.radius })),
            })
        });
        text(&json!({
            // The truth of a picture has the button.
            "frame": pose.is_none().then(|| self.play.frame()),
            "pose": pose,
            "return": score.observed_return,
            "step": score.steps,
            "steps": self.play.spec().max_steps,
            "over": score.end.is_some(),
        }))
    }

    /// What the observed return did not tell, and the best routes, as a JSON object: pairs of observed return
    /// and performance, `null` where there is none or none is known.
    pub fn result(&self) -> String {
        let score = self.play.score();
        let optima = self.config.optima();
        text(&json!({
            "driver": [score.observed_return, score.performance],
            "intended": optima.map(|optima| [optima.intended; 2]),
            "hack": optima.and_then(|optima| optima.hacking),
            "hackable": self.config.trap.is_some() || optima.is_some_and(|optima| optima.hackable),
            "deterministic": self.play.spec().deterministic,
        }))
    }

    /// Facts of the world that a drawing needs, as a JSON object: core's `EnvSpec`.
    pub fn world(&self) -> String {
        text(self.play.spec())
    }

    /// The canonical text of the run whose world this is.
    pub fn configuration(&self) -> String {
        self.config.to_string()
    }

    /// What a run of this world costs, in words.
    pub fn cost(&self) -> String {
        self.config.experiment().cost.into()
    }

    /// Every setting of the run whose world this is, as a run says its own.
    ///
    /// # Errors
    /// Never, as long as the run's own world and preset exist.
    pub fn settings(&self) -> Result<String, JsError> {
        settings(&self.config)
    }
}

/// A configuration whose world is here.
fn offered(configuration: &str) -> Result<Config, JsError> {
    let config: Config = configuration.parse()?;
    if !Play::offers(&config) {
        return Err(JsError::new(&format!("env: {} is not on the page", config.env)));
    }
    Ok(config)
}

/// Every setting of a configuration as a JSON array.
fn settings(config: &Config) -> Result<String, JsError> {
    let untouched = Config::new(&config.env, config.preset)?;
    let settings: Vec<Value> = KEYS
        .iter()
        .map(|key| {
            json!({
                "name": key.name,
                "value": key.value(config),
                "standard": key.value(&untouched),
                "help": key.help,
                "range": key.range(),
                "source": key.source,
            })
        })
        .collect();
    Ok(text(&settings))
}

/// The learner of this name, by the rules of the configuration text.
fn learner(name: &str) -> Result<Learner, ConfigError> {
    let mut config: Config = "env=box-moving".parse()?;
    config.set("agent", name)?;
    Ok(config.agent)
}

/// A value as JSON text.
fn text(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("records have text keys and no other way to fail")
}
