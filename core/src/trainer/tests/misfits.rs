//! Worlds and learners of an application that do not fit together are told at once, and who is at fault.

use super::*;

/// A world of nothing, with a spec of its own and a model that may see more.
#[derive(Clone)]
struct Odd {
    spec: EnvSpec,
    model_width: usize,
    /// Steps after which it pays what is no number.
    pays: u32,
    /// ... is worth what is no number.
    worth: u32,
    made: u32,
}

fn odd(width: usize, actions: &'static [&'static str]) -> Odd {
    let spec = EnvSpec {
        name: "odd",
        observation: ObservationSpec { width, binary: false },
        actions: ActionSpec::Discrete(actions),
        max_steps: 5,
        reward_scale: 1.0,
        deterministic: true,
        legend: &[],
    };
    Odd { spec, model_width: width, pays: u32::MAX, worth: u32::MAX, made: 0 }
}

impl Environment for Odd {
    type Action = Discrete;
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }
    fn reset(&mut self, _rng: &mut Rng, observation: &mut [f32]) {
        observation.fill(0.0);
        self.made = 0;
    }
    fn step(&mut self, _action: &Discrete, _rng: &mut Rng, observation: &mut [f32]) -> Step {
        self.made += 1;
        observation[0] = 0.5;
        let performance = if self.made >= self.worth { f32::INFINITY } else { 0.0 };
        let reward = if self.made >= self.pays { f32::NAN } else { 0.0 };
        let end = (self.made == self.spec.max_steps).then_some(EpisodeEnd::Truncated);
        Step { reward, performance, end }
    }
    fn model(&self) -> Self {
        let mut model = self.clone();
        model.spec.observation.width = self.model_width;
        model
    }
}

const TWO: &[&str] = &["left", "right"];

fn custom() -> Config {
    let mut config = Config::custom(crate::config::Preset::Paper);
    for (key, value) in [("safe_steps", "40"), ("full_steps", "10"), ("exploration", "20"), ("hidden", "8")] {
        config.set(key, value).unwrap();
    }
    config
}

#[test]
#[should_panic(expected = "the Safe world: actions, observation and step limit are not empty")]
fn a_world_without_actions() {
    Trainer::gridworld(custom(), odd(3, &[]), odd(3, &[]));
}

#[test]
#[should_panic(expected = "the Full world: the spec has the world's own kind of action")]
fn a_world_with_actions_of_another_kind() {
    let mut full = odd(3, TWO);
    full.spec.actions = ActionSpec::Continuous { names: &["force"], low: -1.0, high: 1.0 };
    Trainer::gridworld(custom(), odd(3, TWO), full);
}

#[test]
#[should_panic(expected = "the Safe world and the model of the Full world have other observations or actions")]
fn a_model_that_sees_more() {
    Trainer::gridworld(custom(), odd(3, TWO), Odd { model_width: 4, ..odd(3, TWO) });
}

#[test]
#[should_panic(expected = "does not hold together: its networks are for other observations or actions")]
fn a_learner_of_another_world() {
    let (config, world) = (custom(), odd(3, TWO));
    let agent = Ddqn::configured(&config, odd(4, TWO).spec());
    let reward = RewardModel::configured(&config, world.spec());
    Trainer::new(config, world.clone(), world, agent, reward);
}

/// A learner of binary observations waits for entries that are 1 before it moves their weights.
#[test]
#[should_panic(expected = "does not hold together: its networks are for other observations or actions")]
fn a_learner_of_binary_observations_in_a_world_of_numbers() {
    let (config, world) = (custom(), odd(3, TWO));
    let mut binary = world.spec().clone();
    binary.observation.binary = true;
    let agent = Ddqn::configured(&config, &binary);
    let reward = RewardModel::configured(&config, world.spec());
    Trainer::new(config, world.clone(), world, agent, reward);
}

/// How a run with this Safe world ends; asked again, it says the same.
fn failure(safe: Odd) -> String {
    let full = Odd { spec: safe.spec.clone(), ..odd(3, TWO) };
    // Evaluation plays in the Safe world as well; its first point is before the first step.
    let mut t = Trainer::gridworld(custom(), safe, full);
    let mut forecaster = CpuForecaster::default();
    let error = (0..100).find_map(|_| t.poll(&mut forecaster, Budget(10), &mut ()).err()).expect("it ends");
    assert_eq!(t.poll(&mut forecaster, Budget(10), &mut ()), Err(error.clone()));
    error.to_string()
}

#[test]
fn a_world_that_pays_no_number_is_at_fault() {
    let fault = "of the safe leg: the world is at fault, not the learner (`env::contract::check` finds such steps)";
    let [pays, worth] = [failure(Odd { pays: 3, ..odd(3, TWO) }), failure(Odd { worth: 3, ..odd(3, TWO) })];
    assert_eq!(pays, alloc::format!("the world's reward is not a finite number at step 0 {fault}"));
    assert_eq!(worth, alloc::format!("the world's performance is not a finite number at step 0 {fault}"));
}

#[test]
fn numbers_in_an_observation_that_is_called_binary_are_told() {
    let mut world = odd(3, TWO);
    world.spec.observation.binary = true;
    let said = "the world's observation has entries other than 0 and 1 at step 1 of the safe leg, though its spec says \
                `binary: true`: say `binary: false` of a world that observes numbers";
    assert_eq!(failure(world), said);
}

/// Answers an action of another world.
#[test]
#[should_panic(expected = "the learner chose #7, which its world does not offer")]
fn a_learner_that_chooses_what_is_not_offered() {
    assert!(is_offered(&Discrete(1), &odd(3, TWO).spec.actions));
    is_offered(&Discrete(7), &odd(3, TWO).spec.actions);
}
