//! TD3 does what its definition says, and learns.

use super::*;
use crate::config::Optimizer;
use crate::replay::{Forced, ReplayBuffer, Transition};

const SPEC: ObservationSpec = ObservationSpec { width: 3, binary: false };
const ACTIONS: ActionSpec = ActionSpec::Continuous { names: &["a", "b"], low: -1.0, high: 3.0 };

fn config(hidden: usize) -> Td3Config {
    Td3Config {
        hidden,
        layers: 2,
        gamma: 0.5,
        tau: 0.25,
        policy_noise: 0.0,
        noise_clip: 0.5,
        exploration_noise: 0.1,
        policy_delay: 2,
        adam: AdamConfig { kind: Optimizer::Adam, lr: 1e-3, weight_decay: 0.0, clip: 0.0 },
    }
}

fn agent(config: &Td3Config) -> Td3<2> {
    Td3::new(SPEC, &ACTIONS, config, &mut Rng::new(1))
}

/// Transitions with random numbers; the third one terminates.
fn transitions(count: usize) -> Vec<Transition<Continuous<2>>> {
    let mut rng = Rng::new(5);
    let mut numbers = || (0..3).map(|_| rng.uniform() - 0.5).collect::<Vec<f32>>();
    let all: Vec<_> = (0..count).map(|_| (numbers(), numbers(), numbers())).collect();
    all.into_iter()
        .enumerate()
        .map(|(i, (observation, action, next_observation))| Transition {
            observation,
            reward: action[2],
            action: Continuous([action[0], action[1]]),
            next_observation,
            terminated: i == 2,
        })
        .collect()
}

fn batch(transitions: &[Transition<Continuous<2>>]) -> Minibatch<Continuous<2>> {
    let mut replay = ReplayBuffer::new(SPEC, 1000);
    transitions.iter().for_each(|t| replay.push(t));
    let slots: Vec<u32> = (0..replay.len()).collect();
    let mut batch = Minibatch::default();
    batch.gather(&replay, &slots, &Forced::new(&[], &replay));
    batch
}

fn run(network: &Mlp, input: &[f32]) -> Vec<f32> {
    let mut rows = Rows::new(ObservationSpec { width: input.len(), binary: false });
    rows.push_observation(input);
    network.forward(&rows, &mut Scratch::default()).to_vec()
}

/// Value of an action by a critic.
fn q(critic: &Mlp, observation: &[f32], action: &[f32]) -> f32 {
    run(critic, &[observation, action].concat())[0]
}

/// An action by an actor, by the definition: the middle of the range is 1, half of it 2.
fn pi(actor: &Mlp, observation: &[f32]) -> Vec<f32> {
    run(actor, observation).iter().map(|z| 1.0 + 2.0 * libm::tanhf(*z)).collect()
}

/// A critic whose value is the action's first number (as far as the ReLUs pass it: shifted by 10).
fn reads_first_number(critic: &mut Mlp) {
    let hidden = critic.sizes()[1];
    let params = critic.params_mut();
    params.fill(0.0);
    params[3 * hidden] = 1.0; // Input 3 is the action's first number.
    params[5 * hidden] = 10.0; // Bias of the first unit.
    let second = 6 * hidden;
    params[second] = 1.0;
    let third = second + (hidden + 1) * hidden;
    params[third] = 1.0;
    params[third + hidden] = -10.0;
}

#[test]
fn the_loss_is_that_of_clipped_double_q() {
    let mut agent = agent(&config(16));
    // Targets that differ from the live networks, so that every role shows.
    for (seed, learned) in [(11, 0), (12, 1)] {
        agent.critics[learned].target = Mlp::new(&[5, 16, 16, 1], &mut Rng::new(seed));
    }
    agent.actor.target = Mlp::new(&[3, 16, 16, 2], &mut Rng::new(13));
    let samples = transitions(6);
    // The second critic is moved to the level of the first, so that each is the smaller one somewhere.
    let gap = |agent: &Td3<2>, t: &Transition<Continuous<2>>| {
        let action = pi(&agent.actor.target, &t.next_observation);
        let [a, b] = [0, 1].map(|i| q(&agent.critics[i].target, &t.next_observation, &action));
        a - b
    };
    let level = samples.iter().map(|t| gap(&agent, t)).sum::<f32>() / 6.0;
    *agent.critics[1].target.params_mut().last_mut().unwrap() += level;
    let mut smaller = [0, 0];
    let expected: f32 = samples
        .iter()
        .map(|t| {
            let action = pi(&agent.actor.target, &t.next_observation);
            let [a, b] = [0, 1].map(|i| q(&agent.critics[i].target, &t.next_observation, &action));
            smaller[usize::from(b < a)] += 1;
            let y = t.reward + if t.terminated { 0.0 } else { 0.5 * a.min(b) };
            let error = |i: usize| q(&agent.critics[i].live, &t.observation, &t.action.0) - y;
            (error(0) * error(0) + error(1) * error(1)) / 6.0
        })
        .sum();
    let loss = agent.update(&batch(&samples), &mut Rng::new(0));
    assert!((loss - expected).abs() < 1e-5 * expected.abs(), "{loss} {expected}");
    assert!(smaller[0] > 0 && smaller[1] > 0, "each critic is the smaller one somewhere: {smaller:?}");
}

#[test]
fn the_value_of_the_targets_is_that_of_the_target_actors_action() {
    let mut agent = agent(&config(16));
    for (seed, learned) in [(11, 0), (12, 1)] {
        agent.critics[learned].target = Mlp::new(&[5, 16, 16, 1], &mut Rng::new(seed));
    }
    agent.actor.target = Mlp::new(&[3, 16, 16, 2], &mut Rng::new(13));
    let mut rows = Rows::new(SPEC);
    let samples = transitions(4);
    samples.iter().for_each(|t| rows.push_observation(&t.observation));
    let mut values = vec![9.0];
    agent.target_values(&rows, &mut Scratch::default(), &mut values);
    let by = |critic: &Mlp, actor: &Mlp| -> Vec<f32> {
        samples.iter().map(|t| q(critic, &t.observation, &pi(actor, &t.observation))).collect()
    };
    let near = |expected: Vec<f32>| values.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-5);
    assert_eq!(values.len(), 4);
    let [first, second] = &agent.critics;
    assert!(near(by(&first.target, &agent.actor.target)), "{values:?}");
    // Every other reading of it gives something else.
    for (critic, actor) in [
        (&first.live, &agent.actor.target),
        (&first.target, &agent.actor.live),
        (&first.live, &agent.actor.live),
        (&second.target, &agent.actor.target),
    ] {
        assert!(!near(by(critic, actor)));
    }
}

#[test]
fn target_actions_are_smoothed_by_clipped_noise_within_the_bounds() {
    // A thousand times the clip: every draw ends at a bound of the noise, 0.5 halves = 1 to either side.
    let mut agent = agent(&Td3Config { policy_noise: 500.0, gamma: 1.0, ..config(8) });
    for critic in &mut agent.critics {
        reads_first_number(&mut critic.target);
    }
    for (bias, low, high) in [(0.0, 0.0, 2.0), (20.0, 2.0, 3.0)] {
        // An actor of its bias alone: tanh(0) is the middle of the range, tanh(20) its upper end.
        let params = agent.actor.target.params_mut();
        params.fill(0.0);
        let last = params.len() - 2;
        params[last..].fill(bias);
        let samples = transitions(40);
        let mut work = Work::default();
        agent.targets(&batch(&samples), &mut Rng::new(3), &mut work);
        let (mut lows, mut highs) = (0, 0);
        for (t, y) in samples.iter().zip(&work.targets) {
            let added = y - t.reward;
            match () {
                () if t.terminated => assert_eq!(added, 0.0),
                () if (added - low).abs() < 1e-5 => lows += 1,
                () if (added - high).abs() < 1e-5 => highs += 1,
                () => panic!("{added} is neither {low} nor {high}"),
            }
        }
        assert!(lows > 8 && highs > 8, "{lows} {highs}");
    }
}

#[test]
fn actor_and_targets_move_at_every_second_update() {
    let mut agent = agent(&config(8));
    let batch = batch(&transitions(8));
    for update in 1..=4 {
        let before = agent.clone();
        agent.update(&batch, &mut Rng::new(0));
        let moved = |a: &Mlp, b: &Mlp| a != b;
        assert!(moved(&agent.critics[0].live, &before.critics[0].live));
        assert!(moved(&agent.critics[1].live, &before.critics[1].live));
        let moves = update % 2 == 0;
        assert_eq!(moved(&agent.actor.live, &before.actor.live), moves);
        for (now, was) in [
            (&agent.actor, &before.actor),
            (&agent.critics[0], &before.critics[0]),
            (&agent.critics[1], &before.critics[1]),
        ] {
            let follows = if moves { 0.25 } else { 0.0 };
            for ((new, old), live) in now.target.params().iter().zip(was.target.params()).zip(now.live.params()) {
                assert!((new - (old + follows * (live - old))).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn the_actors_gradient_matches_finite_differences() {
    let mut agent = agent(&Td3Config { policy_delay: 1, ..config(10) });
    let before = agent.actor.live.clone();
    let samples = transitions(5);
    agent.update(&batch(&samples), &mut Rng::new(0));
    // The first critic has not moved since the actor's backward pass.
    let gradient = agent.work.actor_gradient.values().to_vec();
    let critic = agent.critic(0);
    let loss = |actor: &Mlp| -> f64 {
        let values = samples.iter().map(|t| f64::from(q(critic, &t.observation, &pi(actor, &t.observation))));
        -values.sum::<f64>() / 5.0
    };
    let (mut checked, mut largest) = (0, 0.0f32);
    for index in (0..before.params().len()).step_by(3) {
        let mut changed = before.clone();
        let h = 1e-2;
        changed.params_mut()[index] = before.params()[index] + h;
        let up = loss(&changed);
        changed.params_mut()[index] = before.params()[index] - h;
        let slope = (up - loss(&changed)) / (2.0 * f64::from(h));
        let found = gradient[index];
        assert!((f64::from(found) - slope).abs() < 1e-3 + 0.03 * slope.abs(), "{index}: {found} {slope}");
        checked += 1;
        largest = largest.max(found.abs());
    }
    assert!(checked > 50 && largest > 5e-3, "{checked} {largest}");
}

#[test]
fn a_forecast_counts_its_own_updates_and_takes_along_what_it_is_told_to() {
    let mut agent = agent(&config(8));
    let batch = batch(&transitions(8));
    (0..5).for_each(|_| _ = agent.update(&batch, &mut Rng::new(0)));
    let copy = agent.for_forecast(Carry::ALL);
    assert_eq!((agent.updates(), copy.updates()), (5, 0));
    assert_eq!(copy.digest(), agent.digest());
    // The live learner's next update moves its actor, the copy's first does not.
    let next = |mut agent: Td3<2>| {
        agent.update(&batch, &mut Rng::new(0));
        agent.actor.live
    };
    assert_ne!(next(agent.clone()), agent.actor.live);
    assert_eq!(next(copy.clone()), agent.actor.live);
    assert_eq!(copy.critics[0].target, agent.critics[0].target);
    assert_ne!(agent.critics[0].target, agent.critics[0].live);
    assert_eq!(agent.for_forecast(Carry { target: false, optimizer: true }).critics[0].target, agent.critics[0].live);
    let restarted = agent.for_forecast(Carry { target: true, optimizer: false });
    assert_eq!((agent.critics[1].optimizer.steps(), restarted.critics[1].optimizer.steps()), (5, 0));
}

#[test]
fn learns_where_the_reward_is_best() {
    // One state; the reward is the closer to 0 the nearer the action is to (0.5, 2); every episode ends.
    let mut agent = agent(&Td3Config { adam: AdamConfig { lr: 3e-3, ..config(32).adam }, tau: 0.01, ..config(32) });
    let mut rng = Rng::new(2);
    let samples: Vec<_> = (0..128)
        .map(|_| {
            let action = Continuous::<2>::sample(&ACTIONS, &mut rng);
            let [a, b] = action.0;
            Transition {
                observation: vec![1.0, 0.0, 0.0],
                reward: -(a - 0.5) * (a - 0.5) - (b - 2.0) * (b - 2.0),
                action,
                next_observation: vec![1.0, 0.0, 0.0],
                terminated: true,
            }
        })
        .collect();
    let batch = batch(&samples);
    for _ in 0..1200 {
        agent.update(&batch, &mut rng);
    }
    let best = pi(&agent.actor.live, &[1.0, 0.0, 0.0]);
    assert!((best[0] - 0.5).abs() < 0.15 && (best[1] - 2.0).abs() < 0.15, "{best:?}");
}

#[test]
fn explores_uniformly_or_around_the_actor_within_the_bounds() {
    let mut agent = agent(&config(8));
    agent.actor.live.params_mut().fill(0.0);
    let mut rows = Rows::new(SPEC);
    rows.push_observation(&[0.1, 0.2, 0.3]);
    let (mut rng, mut scratch) = (Rng::new(4), Scratch::default());
    let mut draw = |epsilon| -> (f32, f32, f32) {
        let drawn: Vec<f32> =
            (0..2000).flat_map(|_| agent.explore(&rows, &ACTIONS, epsilon, &mut rng, &mut scratch).0).collect();
        let mean = drawn.iter().sum::<f32>() / 4000.0;
        let spread = (drawn.iter().map(|x| (x - mean) * (x - mean)).sum::<f32>() / 4000.0).sqrt();
        (mean, spread, drawn.iter().fold(f32::NEG_INFINITY, |a, &b| a.max(b)))
    };
    // Noise of 0.1 halves of the range, 0.2; uniform over 4 has a standard deviation of 4/√12.
    let (mean, spread, _) = draw(0.0);
    assert!((mean - 1.0).abs() < 0.02 && (spread - 0.2).abs() < 0.01, "{mean} {spread}");
    let (mean, spread, most) = draw(1.0);
    assert!((mean - 1.0).abs() < 0.1 && (spread - 1.1547).abs() < 0.05 && most <= 3.0, "{mean} {spread} {most}");
    agent.actor.live.params_mut().fill(5.0);
    let at_bound = agent.explore(&rows, &ACTIONS, 0.0, &mut rng, &mut scratch);
    assert!(at_bound.0.iter().all(|x| *x <= 3.0));
}

#[test]
fn fits_worlds_of_its_observations_and_actions() {
    let spec = |width, actions| EnvSpec {
        name: "arm",
        observation: ObservationSpec { width, binary: false },
        actions,
        max_steps: 10,
        reward_scale: 1.0,
        deterministic: true,
        legend: &[],
    };
    let agent = agent(&config(4));
    assert!(agent.fits(&spec(3, ACTIONS)) && !agent.fits(&spec(4, ACTIONS)));
    assert!(!agent.fits(&spec(3, ActionSpec::Continuous { names: &["a"], low: -1.0, high: 3.0 })));
    assert!(!agent.fits(&spec(3, ActionSpec::Continuous { names: &["a", "b"], low: -1.0, high: 1.0 })));
}

#[test]
fn updates_made_elsewhere_are_taken_over() {
    let batch = batch(&transitions(8));
    let (mut rng, mut trained) = (Rng::new(3), agent(&config(4)));
    trained.update(&batch, &mut rng);
    let mut other = trained.clone();
    for _ in 0..4 {
        trained.update(&batch, &mut rng);
    }
    other.take_over(4, &trained.numbers().collect::<Vec<_>>());
    assert_eq!(other.updates(), 5);
    assert_eq!(other.optimizers().map(Adam::steps), trained.optimizers().map(Adam::steps));
    // From there on they are the same learner.
    let mut same = rng.clone();
    trained.update(&batch, &mut rng);
    other.update(&batch, &mut same);
    assert!(other.numbers().eq(trained.numbers()));
}
