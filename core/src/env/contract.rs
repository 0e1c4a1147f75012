//! The rules every environment keeps, as a suite that any implementation can run on itself.
//!
//! ```
//! use mcvl_core::env::{box_moving::{BoxMoving, Variant}, contract};
//! contract::check(&BoxMoving::new(Variant::Full, true), 10).unwrap();
//! ```

use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;
use core::fmt;

use super::{Action, ActionSpec, EnvSpec, Environment, EpisodeEnd};
use crate::rng::Rng;

/// A rule that an environment breaks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Which rule.
    pub rule: &'static str,
    /// What was seen.
    pub seen: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.rule, self.seen)
    }
}

impl core::error::Error for Violation {}

/// What an episode looked like: reward, performance, end and observation of every step.
type Trace = Vec<(f32, f32, Option<EpisodeEnd>, Vec<f32>)>;

fn play<E: Environment>(world: &mut E, rng: &mut Rng, actions: &mut Rng, limit: usize) -> Trace {
    let mut observation = vec![f32::NAN; world.spec().observation.width];
    let mut trace = Vec::new();
    for _ in 0..limit {
        let action = E::Action::sample(&world.spec().actions, actions);
        // What is not written by this very step shows.
        observation.fill(f32::NAN);
        let step = world.step(&action, rng, &mut observation);
        trace.push((step.reward, step.performance, step.end, observation.clone()));
        if step.end.is_some() {
            break;
        }
    }
    trace
}

/// Plays `episodes` random episodes of copies of `world`, and as many of copies of its [model](Environment::model), and
/// checks the rules of both: futures are rated in the model, which has a spec of its own.
///
/// # Errors
/// The first [`Violation`]: observations must be written whole, finite, and 0 or 1 where the spec says
/// binary; observations and actions of a world and its model have the same shape; the same seed gives the same
/// episode; a fork continues like its original; a truncation comes at exactly the step limit; a deterministic
/// world draws nothing; reset forgets the episode before.
pub fn check<E: Environment>(world: &E, episodes: u64) -> Result<(), Violation> {
    play_by_the_rules(world, episodes)?;
    let (spec, model) = (world.spec(), world.model());
    if (model.spec().observation, &model.spec().actions) != (spec.observation, &spec.actions) {
        let seen = alloc::format!("{:?}", model.spec());
        return Err(Violation { rule: "a world and its model have the same observations and actions", seen });
    }
    play_by_the_rules(&model, episodes)
        .map_err(|Violation { rule, seen }| Violation { rule, seen: alloc::format!("{seen}, in its model") })
}

/// Checks a world's spec alone.
///
/// # Errors
/// The first [`Violation`]: there are actions (at most 256 numbered ones), of the world's own kind and with bounds of which
/// the lower is below the upper; the observation, the step limit and the reward scale are above 0.
pub fn spec<E: Environment>(world: &E) -> Result<(), Violation> {
    of_spec(world.spec(), E::Action::is_of(&world.spec().actions))
}

/// `own`: the actions are of the kind of the world's.
fn of_spec(spec: &EnvSpec, own: bool) -> Result<(), Violation> {
    let fail = |rule, seen| Err(Violation { rule, seen });
    let (actions, width) = (spec.actions.features(), spec.observation.width);
    if actions == 0 || width == 0 || spec.max_steps == 0 {
        let seen = alloc::format!("{actions} actions, {width} entries, {} steps", spec.max_steps);
        return fail("actions, observation and step limit are not empty", seen);
    }
    if actions > 256 && matches!(spec.actions, ActionSpec::Discrete(_)) {
        return fail("actions are numbered in one byte", alloc::format!("{actions} actions"));
    }
    if !(spec.reward_scale.is_finite() && spec.reward_scale > 0.0) {
        return fail("the reward scale is positive", alloc::format!("{}", spec.reward_scale));
    }
    if let ActionSpec::Continuous { low, high, .. } = spec.actions
        && !(low.is_finite() && high.is_finite() && low < high)
    {
        return fail("the lower bound of actions is below the upper one, both finite", alloc::format!("{low}, {high}"));
    }
    if !own {
        return fail("the spec has the world's own kind of action", alloc::format!("{actions} of another kind"));
    }
    Ok(())
}

/// The rules of one world, whatever its model is.
fn play_by_the_rules<E: Environment>(world: &E, episodes: u64) -> Result<(), Violation> {
    spec(world)?;
    let fail = |rule, seen| Err(Violation { rule, seen });
    let spec = world.spec().clone();
    let width = spec.observation.width;
    let limit = spec.max_steps as usize + 1;
    for seed in 0..episodes {
        let mut rng = Rng::new(seed);
        let mut first = vec![f32::NAN; width];
        let mut original = world.clone();
        original.reset(&mut rng, &mut first);
        let after_reset = rng.clone();
        let fork = original.clone();
        let trace = play(&mut original, &mut rng, &mut Rng::new(!seed), limit);

        for (observation, t) in core::iter::once(&first).chain(trace.iter().map(|s| &s.3)).zip(0..) {
            let valid = |x: &f32| if spec.observation.binary { *x == 0.0 || *x == 1.0 } else { x.is_finite() };
            if let Some(i) = observation.iter().position(|x| !valid(x)) {
                let seen = alloc::format!("entry {i} is {} after step {t}", observation[i]);
                return fail("observations are written whole, finite, and 0 or 1 where binary", seen);
            }
        }
        if let Some(t) = trace.iter().position(|s| !(s.0.is_finite() && s.1.is_finite())) {
            return fail("reward and performance are finite", alloc::format!("step {}", t + 1));
        }
        match trace.last().map(|s| s.2) {
            Some(Some(EpisodeEnd::Truncated)) if trace.len() != spec.max_steps as usize => {
                return fail("truncation comes at the step limit", alloc::format!("after {} steps", trace.len()));
            }
            Some(Some(_)) if trace.len() <= spec.max_steps as usize => {}
            _ => return fail("an episode ends by the step limit", alloc::format!("still running after {limit} steps")),
        }
        if spec.deterministic && (after_reset != Rng::new(seed) || rng != after_reset) {
            return fail("a deterministic world draws no random number", alloc::format!("seed {seed}"));
        }
        // The step at which another episode goes another way.
        let departs = |other: &Trace| trace.iter().zip(other).take_while(|(one, other)| one == other).count() + 1;
        let seen = |other: &Trace| alloc::format!("seed {seed}, from step {} on", departs(other));
        let mut forked = fork;
        let other = play(&mut forked, &mut after_reset.clone(), &mut Rng::new(!seed), limit);
        if other != trace {
            return fail("a fork continues like its original", seen(&other));
        }
        // The same object, used again: nothing of the episode before may remain.
        let mut rng = Rng::new(seed);
        let mut again = vec![f32::NAN; width];
        original.reset(&mut rng, &mut again);
        let rule = "reset forgets the episode before; one seed, one episode";
        if again != first {
            return fail(rule, alloc::format!("seed {seed}, the first observation differs"));
        }
        let other = play(&mut original, &mut rng, &mut Rng::new(!seed), limit);
        if other != trace {
            return fail(rule, seen(&other));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::box_moving::{BoxMoving, Variant};
    use crate::env::{Discrete, Step};
    use alloc::rc::Rc;
    use alloc::string::ToString;
    use core::cell::Cell;

    /// Box Moving with one rule broken.
    #[derive(Clone)]
    struct Broken {
        inner: BoxMoving,
        spec: EnvSpec,
        fault: &'static str,
        episodes: u32,
        /// Steps of this world and all its copies.
        shared: Rc<Cell<u32>>,
    }

    impl Environment for Broken {
        type Action = Discrete;
        fn spec(&self) -> &EnvSpec {
            &self.spec
        }
        fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
            self.episodes += 1;
            self.inner.reset(rng, observation);
            if self.fault == "draws" {
                rng.next_u64();
            }
            if self.fault == "unwritten" {
                observation[0] = f32::NAN;
            }
            if self.fault == "remembers" && self.episodes > 1 {
                observation[0] = 1.0;
            }
        }
        fn model(&self) -> Self {
            let mut model = self.clone();
            model.spec.observation.width += usize::from(self.fault == "other model");
            if self.fault == "model draws" {
                model.fault = "draws";
            }
            model
        }
        fn step(&mut self, action: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
            let before = observation[1];
            let mut step = self.inner.step(action, rng, observation);
            if self.fault == "endless" {
                step.end = None;
            }
            if self.fault == "half" {
                observation[1] = 0.5;
            }
            if self.fault == "forgets the last" && step.end.is_some() {
                observation[1] = before;
            }
            if self.fault == "unpayable" {
                step.reward = f32::INFINITY;
            }
            if self.fault == "worth nothing known" {
                step.performance = f32::NAN;
            }
            self.shared.set(self.shared.get() + 1);
            if self.fault == "shares" {
                step.reward = self.shared.get() as f32;
            }
            step
        }
    }

    #[test]
    fn every_broken_rule_is_found() {
        let inner = BoxMoving::new(Variant::Full, true);
        let (spec_of, shared) = (inner.spec().clone(), Rc::default());
        let broken = |fault| Broken {
            inner: inner.clone(),
            spec: spec_of.clone(),
            fault,
            episodes: 0,
            shared: Rc::clone(&shared),
        };
        for (fault, word) in [
            ("draws", "draws no random number"),
            ("unwritten", "written whole"),
            ("half", "0 or 1"),
            ("forgets the last", "written whole"),
            ("endless", "ends by the step limit"),
            ("unpayable", "reward and performance are finite"),
            ("worth nothing known", "reward and performance are finite"),
            ("shares", "a fork continues like its original"),
            ("remembers", "reset forgets"),
            ("other model", "and its model"),
        ] {
            let violation = check(&broken(fault), 3).unwrap_err();
            assert!(violation.rule.contains(word), "{fault}: {violation}");
        }
        let violation = check(&broken("model draws"), 3).unwrap_err();
        assert_eq!(violation.to_string(), "a deterministic world draws no random number: seed 0, in its model");
        let mut short = broken("none");
        short.spec.max_steps = 120;
        assert!(check(&short, 1).unwrap_err().rule.contains("step limit"));
        check(&broken("none"), 3).unwrap();
        let of = |actions| {
            let mut world = broken("none");
            world.spec.actions = actions;
            spec(&world).unwrap_err().to_string()
        };
        assert_eq!(of(ActionSpec::Discrete(&["on"; 257])), "actions are numbered in one byte: 257 actions");
        let mut many = broken("none");
        many.spec.actions = ActionSpec::Discrete(&["on"; 256]);
        spec(&many).unwrap();
        for scale in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut world = broken("none");
            world.spec.reward_scale = scale;
            let violation = spec(&world).unwrap_err().to_string();
            assert_eq!(violation, alloc::format!("the reward scale is positive: {scale}"));
        }
        let names: &[&str] = &["force"];
        let backwards = of(ActionSpec::Continuous { names, low: 1.0, high: -1.0 });
        assert_eq!(backwards, "the lower bound of actions is below the upper one, both finite: 1, -1");
        assert!(of(ActionSpec::Continuous { names, low: -1.0, high: 1.0 }).contains("own kind of action"));
    }
}
