//! Episodes and rollouts of worlds that draw have random numbers of their own each.

use super::*;
use crate::config::Preset;

/// A world in which each step pays, and is worth, what is drawn.
#[derive(Clone)]
struct Lottery(u32);

impl Lottery {
    const STEPS: u32 = 4;
    const SPEC: EnvSpec = EnvSpec {
        name: "lottery",
        observation: ObservationSpec { width: 1, binary: false },
        actions: ActionSpec::Discrete(&["play", "play on"]),
        max_steps: Self::STEPS,
        reward_scale: 0.001,
        deterministic: false,
        legend: &[],
    };

    /// What the steps of an episode pay with these random numbers.
    fn payments(mut rng: Rng) -> Vec<f32> {
        (0..Self::STEPS).map(|_| rng.below(1000) as f32).collect()
    }
}

impl Environment for Lottery {
    type Action = Discrete;
    fn spec(&self) -> &EnvSpec {
        &Self::SPEC
    }
    fn reset(&mut self, _: &mut Rng, observation: &mut [f32]) {
        self.0 = 0;
        observation[0] = 0.0;
    }
    fn step(&mut self, _: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
        self.0 += 1;
        observation[0] = self.0 as f32;
        let reward = rng.below(1000) as f32;
        Step { reward, performance: reward, end: (self.0 == Self::STEPS).then_some(EpisodeEnd::Truncated) }
    }
}

const EPISODES: u32 = 3;
const ROLLOUTS: u32 = 2;

fn lottery() -> Vec<Event> {
    contract::check(&Lottery(0), 3).unwrap();
    let mut config = Config::custom(Preset::Paper);
    let short = "safe_steps=40 full_steps=8 exploration=20 hidden=4 evaluations=2 scheme=all forecast=1 \
                 reset_on_refusal=false seed=5";
    let own = alloc::format!("evaluation_episodes={EPISODES} rollouts={ROLLOUTS} rollout_steps={}", Lottery::STEPS);
    for (key, value) in short.split(' ').chain(own.split(' ')).filter_map(|pair| pair.split_once('=')) {
        config.set(key, value).unwrap();
    }
    events(Trainer::gridworld(config, Lottery(0), Lottery(0)), u32::MAX, |_| {})
}

fn sum(payments: &[f32]) -> f64 {
    payments.iter().map(|paid| f64::from(*paid)).sum()
}

#[test]
fn each_episode_of_an_evaluation_has_its_own_chances() {
    let mut points = Vec::new();
    for event in lottery() {
        let Event::Evaluation(point) = event else { continue };
        let leg = u64::from(point.arm != Arm::Safe);
        let stream = Rng::stream(5, Purpose::Evaluate, leg << 32 | u64::from(point.step));
        let returns: Vec<f64> = (0..EPISODES).map(|i| sum(&Lottery::payments(stream.child(u64::from(i))))).collect();
        assert!(returns[0] != returns[1] && returns[1] != returns[2] && returns[0] != returns[2]);
        let mean = returns.iter().sum::<f64>() / f64::from(EPISODES);
        assert_eq!((point.observed_return, point.performance), (mean, mean), "step {}", point.step);
        assert_eq!(point.length, f64::from(Lottery::STEPS));
        assert!(!points.contains(&mean), "another point has other episodes");
        points.push(mean);
    }
    // Before the first step and twice in each leg.
    assert_eq!(points.len(), 6);
}

#[test]
fn each_rollout_of_a_future_has_its_own_chances() {
    let checks = checks(&lottery());
    assert_eq!(checks.len(), 8);
    for check in &checks {
        let stream = Rng::stream(5, Purpose::Rollout, check.updates);
        let mut worth: Vec<Vec<f32>> = (0..=ROLLOUTS).map(|i| Lottery::payments(stream.child(u64::from(i)))).collect();
        let different = (1..worth.len()).all(|i| worth[..i].iter().all(|other| *other != worth[i]));
        assert!(different, "{worth:?}");
        // The last one goes on from the current state, to the end of its episode.
        let left = (Lottery::STEPS - (check.step - 1) % Lottery::STEPS - 1) as usize;
        worth[ROLLOUTS as usize].truncate(left);
        let mean = worth.iter().map(|worth| sum(worth)).sum::<f64>() / f64::from(ROLLOUTS + 1);
        let (modified, unmodified) = futures(check);
        for future in [modified, unmodified] {
            assert_eq!(future.performance, mean, "step {}", check.step);
            let current = future.films.iter().find(|film| film.start == StartState::Current).unwrap();
            assert_eq!(current.performance, worth[ROLLOUTS as usize]);
        }
    }
    assert!(checks.iter().any(|check| check.updates != checks[0].updates), "not all are of one stream");
}
