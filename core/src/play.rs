//! A built-in world without a learner: whoever holds it acts in it, step by step.
//!
//! ```
//! use mcvl_core::{config::Config, env::Discrete, play::Play, record::Arm};
//! let config: Config = "env=box-moving".parse().unwrap();
//! let mut play = Play::new(&config, Arm::Mc);
//! while play.step(Discrete(1)).is_some() {}
//! // One fake +5 on the way down, then bumping into the end of the room.
//! assert_eq!((play.score().observed_return, play.score().performance), (4.0, -1.0));
//! ```

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;
use core::any::Any;

use crate::config::Config;
use crate::env::gridworld::Gridworld;
use crate::env::reacher::{Pose, Reacher};
use crate::env::trap::Trapped;
use crate::env::{Action, ActionValue, BuiltIn, EnvSpec, Environment, EpisodeEnd, Frame, Step};
use crate::record::Arm;
use crate::rng::{Purpose, Rng};

/// Sums over the episode so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// Sum of observed rewards, raw.
    pub observed_return: f64,
    /// Sum of hidden rewards, raw.
    pub performance: f64,
    /// Steps made.
    pub steps: u32,
    /// How the episode ended, if it did.
    pub end: Option<EpisodeEnd>,
}

/// An episode in a built-in world.
pub struct Play {
    world: Box<dyn World>,
    rng: Rng,
    observation: Vec<f32>,
    score: Score,
}

/// A world whose type is not named.
trait World: Send {
    fn spec(&self) -> &EnvSpec;
    fn frame(&self) -> Frame;
    fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]);
    /// `None` if there is no such action.
    fn step(&mut self, action: &ActionValue, rng: &mut Rng, observation: &mut [f32]) -> Option<Step>;
    /// The world itself, for what only some worlds have.
    fn as_any(&self) -> &dyn Any;
}

impl<E: Environment + Send + 'static> World for E {
    fn spec(&self) -> &EnvSpec {
        Environment::spec(self)
    }

    fn frame(&self) -> Frame {
        Environment::frame(self)
    }

    fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
        Environment::reset(self, rng, observation);
    }

    fn step(&mut self, action: &ActionValue, rng: &mut Rng, observation: &mut [f32]) -> Option<Step> {
        let action = E::Action::from_value(action, &Environment::spec(self).actions)?;
        Some(Environment::step(self, &action, rng, observation))
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// Built-in worlds of one type, by their names, and how the world of a leg begins.
type Worlds = (&'static [&'static str], fn(&Config, Arm) -> Box<dyn World>);

/// Every built-in world, in the order of the table of experiments. They are here in every build: without a learner
/// they are small, also those that the build does not train in.
static WORLDS: &[Worlds] = &[
    (Gridworld::NAMES, |config, leg| of_leg(Trapped::worlds(config).expect("the table has this world"), leg)),
    (&[<Reacher as BuiltIn>::NAME], |config, leg| of_leg(Reacher::worlds(config), leg)),
];

fn of_leg<E: Environment + Send + 'static>((safe, full): (E, E), leg: Arm) -> Box<dyn World> {
    Box::new(if leg == Arm::Safe { safe } else { full })
}

impl Play {
    /// Whether the bare world of a configuration is here: every built-in one is, also where
    /// [`Run::offers`](crate::run::Run::offers) no training in it.
    pub fn offers(config: &Config) -> bool {
        Self::find(config).is_some()
    }

    fn find(config: &Config) -> Option<&'static Worlds> {
        WORLDS.iter().find(|(names, _)| names.contains(&&*config.env))
    }

    /// The first episode in the world of a leg; its chances follow from the seed of the configuration. Whatever
    /// simulator a configuration names, the closed form moves this world.
    ///
    /// # Panics
    /// If the configuration is not [valid](Config::validate). Unless [`Play::offers`] it: if it is [`Config::custom`].
    pub fn new(config: &Config, leg: Arm) -> Self {
        config.assert_valid();
        let (_, begin) = Self::find(config).expect("only built-in worlds have names");
        let world = begin(config, leg);
        let observation = vec![0.0; world.spec().observation.width];
        let rng = Rng::stream(config.seed, Purpose::Application, 0);
        let mut play = Self { world, rng, observation, score: Score::default() };
        play.restart();
        play
    }

    /// Begins the next episode.
    pub fn restart(&mut self) {
        self.world.reset(&mut self.rng, &mut self.observation);
        self.score = Score::default();
    }

    /// Makes one step; `None`, and nothing happens, if the episode is over.
    ///
    /// # Panics
    /// If there is no such action: of another kind, beyond the last one, or not of finite numbers.
    pub fn step(&mut self, action: impl Into<ActionValue>) -> Option<Step> {
        if self.score.end.is_some() {
            return None;
        }
        let action = action.into();
        let step = self.world.step(&action, &mut self.rng, &mut self.observation);
        let step = step.unwrap_or_else(|| panic!("{action:?} is no action here"));
        self.score.observed_return += f64::from(step.reward);
        self.score.performance += f64::from(step.performance);
        self.score.steps += 1;
        self.score.end = step.end;
        Some(step)
    }

    /// Facts of the world: names of actions, legend, sizes.
    pub fn spec(&self) -> &EnvSpec {
        self.world.spec()
    }

    /// The current situation.
    pub fn frame(&self) -> Frame {
        self.world.frame()
    }

    /// Where the arm, its target and the hidden button are, for drawings; only Reacher has them.
    pub fn pose(&self) -> Option<Pose> {
        (*self.world).as_any().downcast_ref::<Reacher>().map(Reacher::pose)
    }

    /// What a learner sees of it.
    pub fn observation(&self) -> &[f32] {
        &self.observation
    }

    /// The episode so far.
    pub fn score(&self) -> Score {
        self.score
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Preset;
    use crate::env::box_moving::{DEMONSTRATIONS, Variant};
    use crate::env::{ActionSpec, Continuous, Discrete};
    use crate::experiment::EXPERIMENTS;

    #[test]
    fn demonstrations_have_their_outcome() {
        let mut played = 0;
        for (variant, demo) in DEMONSTRATIONS {
            let mut config = Config::new("box-moving", Preset::Paper).unwrap();
            let leg = if *variant == Variant::Safe { Arm::Safe } else { Arm::Baseline };
            if leg != Arm::Safe {
                config.set("variant", demo.variant).unwrap();
            }
            let mut play = Play::new(&config, leg);
            while play.step(demo.action(play.score().steps as usize, &["up", "down"])).is_some() {}
            let score = play.score();
            assert_eq!((score.observed_return, score.performance), (demo.observed_return, demo.performance));
            assert_eq!((score.steps, score.end), (100, Some(EpisodeEnd::Truncated)));
            played += 1;
        }
        assert!(played > 5);
    }

    #[test]
    fn every_experiment_has_its_bare_world() {
        let names = WORLDS.iter().flat_map(|(names, _)| names.iter().copied());
        assert!(names.eq(EXPERIMENTS.iter().map(|experiment| experiment.name)));
        let mut config = Config::new("reacher", Preset::Paper).unwrap();
        assert!(Play::offers(&config) && !Play::offers(&Config::custom(Preset::Paper)));
        config.set("physics", "mujoco").unwrap();
        assert!(Play::offers(&config), "the closed form moves it");
        let closed = Config::new("reacher", Preset::Paper).unwrap();
        assert_eq!(Play::new(&config, Arm::Mc).pose(), Play::new(&closed, Arm::Mc).pose());
    }

    #[test]
    fn only_an_arm_has_a_pose_and_it_is_that_of_the_episode() {
        assert_eq!(Play::new(&Config::new("box-moving", Preset::Paper).unwrap(), Arm::Mc).pose(), None);
        let mut play = Play::new(&Config::new("reacher", Preset::Paper).unwrap(), Arm::Mc);
        let before = play.pose().unwrap();
        assert!(before.button.is_some_and(|button| !button.pressed()));
        play.step(Continuous([1.0, 0.0]));
        let after = play.pose().unwrap();
        assert!(after.angles[0] > before.angles[0] + 0.01, "the shoulder turns towards +y");
        let [tip, target] = [after.tip, after.target];
        let seen = [tip[0] - target[0], tip[1] - target[1]].map(|metres| metres as f32);
        assert_eq!((&play.observation()[8..], target), (&seen[..], before.target));
    }

    fn random(spec: &ActionSpec, rng: &mut Rng) -> ActionValue {
        match spec {
            ActionSpec::Discrete(_) => Discrete::sample(spec, rng).into(),
            ActionSpec::Continuous { .. } => Continuous::<2>::sample(spec, rng).into(),
        }
    }

    #[test]
    fn every_world_is_played_to_its_end_and_again() {
        for experiment in EXPERIMENTS {
            for leg in [Arm::Safe, Arm::Mc] {
                let mut config = Config::new(experiment.name, Preset::Paper).unwrap();
                config.seed = 5;
                let episode = |play: &mut Play| {
                    let mut actions = Rng::new(1);
                    let mut seen = vec![(play.frame(), play.observation().to_vec())];
                    let actions_of = play.spec().actions;
                    while play.step(random(&actions_of, &mut actions)).is_some() {
                        seen.push((play.frame(), play.observation().to_vec()));
                    }
                    assert_eq!(seen.len(), play.score().steps as usize + 1);
                    seen
                };
                let (mut play, mut same) = (Play::new(&config, leg), Play::new(&config, leg));
                let first = episode(&mut play);
                assert_eq!(first, episode(&mut same), "one seed, one episode");
                assert!(first.len() > 2 && !first[0].0.seen.is_empty(), "{}", experiment.name);
                let over = play.score();
                assert!(over.end.is_some() && play.step(random(&play.spec().actions, &mut Rng::new(0))).is_none());
                assert_eq!(play.score(), over);
                play.restart();
                assert_eq!(play.score(), Score::default());
                episode(&mut play);
            }
        }
    }
}
