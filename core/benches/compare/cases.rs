//! Updates that are measured: by the benchmarks, and by the comparison with other programs.

use mcvl_core::agent::Agent;
use mcvl_core::agent::ddqn::{Ddqn, DdqnConfig};
use mcvl_core::agent::reward_model::RewardModel;
use mcvl_core::agent::td3::{Td3, Td3Config};
use mcvl_core::config::{Config, Optimizer, Preset};
use mcvl_core::env::trap::Trapped;
use mcvl_core::env::{ActionSpec, Continuous, Discrete, ObservationSpec};
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::nn::optim::AdamConfig;
use mcvl_core::replay::{Forced, Minibatch, ReplayBuffer, Transition, draw_slots};
use mcvl_core::rng::Rng;
use mcvl_core::run::{Budget, Status};
use mcvl_core::trainer::Trainer;

/// An update, which returns its loss.
pub type Update = Box<dyn FnMut() -> f32>;

/// Samples of a mini-batch, except for TD3.
pub const BATCH: u32 = 32;
const ACTIONS: ActionSpec = ActionSpec::Discrete(&["up", "down", "left", "right"]);

/// An update that is measured.
#[derive(Clone, Copy)]
pub enum Case {
    /// Double DQN on numbers: how many.
    Dense(usize),
    /// Double DQN on boards of some cells with some codes, of which so many differ.
    Boards { cells: usize, codes: usize, states: usize },
    /// The reward model on such boards.
    Reward { cells: usize, codes: usize, states: usize },
    /// Double DQN as it stands after Safe training in a world at the paper's setting, on what it has stored by then:
    /// the start of the forecasts to come.
    World(&'static str),
    /// TD3 on 10 numbers, 2 actions.
    Td3,
}

/// What is measured, by name.
pub const CASES: [(&str, Case); 13] = [
    ("box-moving", Case::World("box-moving")),
    ("absent-supervisor", Case::World("absent-supervisor")),
    ("tomato-watering", Case::World("tomato-watering")),
    ("rocks-and-diamonds", Case::World("rocks-and-diamonds")),
    ("ddqn-100-dense", Case::Dense(100)),
    ("ddqn-288-dense", Case::Dense(288)),
    ("ddqn-100-onehot", Case::Boards { cells: 10, codes: 10, states: 1000 }),
    ("ddqn-100-onehot-22-states", Case::Boards { cells: 10, codes: 10, states: 22 }),
    ("ddqn-288-onehot", Case::Boards { cells: 36, codes: 8, states: 1000 }),
    ("ddqn-288-onehot-22-states", Case::Boards { cells: 36, codes: 8, states: 22 }),
    ("reward-100-onehot", Case::Reward { cells: 10, codes: 10, states: 1000 }),
    ("reward-100-onehot-22-states", Case::Reward { cells: 10, codes: 10, states: 22 }),
    ("td3-10-256", Case::Td3),
];

/// Experience with these observations, one of which each transition draws.
fn replay<A>(
    spec: ObservationSpec,
    observations: &[Vec<f32>],
    mut action: impl FnMut(&mut Rng) -> A,
    rng: &mut Rng,
) -> ReplayBuffer<A>
where
    A: Clone,
{
    let mut replay = ReplayBuffer::new(spec, 1000);
    for _ in 0..1000 {
        let mut draw = || observations[rng.below(observations.len() as u32) as usize].clone();
        let (observation, next_observation) = (draw(), draw());
        let (action, reward) = (action(rng), rng.uniform() - 0.5);
        replay.push(&Transition { observation, action, reward, next_observation, terminated: false });
    }
    replay
}

/// Random numbers; boards where there are codes.
pub fn discrete(case: Case) -> ReplayBuffer<Discrete> {
    let mut rng = Rng::new(1);
    let (binary, width, states) = match case {
        Case::Boards { cells, codes, states } | Case::Reward { cells, codes, states } => (true, cells * codes, states),
        Case::Dense(width) => (false, width, 1000),
        Case::World(_) | Case::Td3 => unreachable!("these have experience of their own"),
    };
    let observations: Vec<Vec<f32>> = (0..states)
        .map(|_| match case {
            Case::Boards { cells, codes, .. } | Case::Reward { cells, codes, .. } => {
                let mut board = vec![0.0; width];
                (0..cells).for_each(|cell| board[codes * cell + rng.below(codes as u32) as usize] = 1.0);
                board
            }
            _ => (0..width).map(|_| rng.uniform()).collect(),
        })
        .collect();
    replay(ObservationSpec { width, binary }, &observations, |rng| Discrete(rng.below(4) as u8), &mut rng)
}

/// A learner of the paper's sizes.
pub fn ddqn(spec: ObservationSpec) -> Ddqn {
    let config = DdqnConfig { hidden: 128, layers: 2, gamma: 0.95, tau: 0.005, adam: adam(1e-4) };
    Ddqn::new(spec, &ACTIONS, &config, &mut Rng::new(2))
}

fn adam(lr: f32) -> AdamConfig {
    AdamConfig { kind: Optimizer::Adam, lr, weight_decay: 0.0, clip: 0.0 }
}

/// Draws mini-batches of `count` from `replay` for `update`.
fn batches<A: Clone + 'static>(
    replay: ReplayBuffer<A>,
    count: u32,
    mut update: impl FnMut(&Minibatch<A>) -> f32 + 'static,
) -> Update {
    let (mut batch, mut slots, mut rng) = (Minibatch::default(), Vec::new(), Rng::new(3));
    let none = Forced::new(&[], &replay);
    Box::new(move || {
        draw_slots(replay.len(), count, &mut rng, &mut slots);
        batch.gather(&replay, &slots, &none);
        update(&batch)
    })
}

/// One update of a case, mini-batch included, and its multiply-adds by the dense definition.
pub fn update(case: Case) -> (u64, Update) {
    match case {
        Case::Dense(_) | Case::Boards { .. } => {
            let replay = discrete(case);
            let mut agent = ddqn(replay.spec());
            (agent.update_work(BATCH), batches(replay, BATCH, move |batch| agent.update(batch, &mut Rng::new(0))))
        }
        Case::Reward { .. } => {
            let replay = discrete(case);
            let mut model = RewardModel::new(replay.spec(), &ACTIONS, 128, 2, adam(1e-2), &mut Rng::new(2));
            (model.update_work(BATCH), batches(replay, BATCH, move |batch| model.update(batch)))
        }
        Case::World(env) => {
            let config = Config::new(env, Preset::Paper).expect("the cases name worlds");
            let (safe, full) = Trapped::worlds(&config).expect("the cases name gridworlds");
            let mut trainer = Trainer::gridworld(config, safe, full);
            let mut forecaster = CpuForecaster::default();
            let mut go_on = || trainer.poll(&mut forecaster, Budget(10_000), &mut ()).expect("Safe training converges");
            while go_on() == Status::Working {}
            let mut agent = trainer.agent().clone();
            let update = batches(trainer.replay().clone(), BATCH, move |batch| agent.update(batch, &mut Rng::new(0)));
            (trainer.agent().update_work(BATCH), update)
        }
        Case::Td3 => {
            let (spec, mut rng) = (ObservationSpec { width: 10, binary: false }, Rng::new(1));
            let observations: Vec<Vec<f32>> =
                (0..1000).map(|_| (0..10).map(|_| rng.uniform() - 0.5).collect()).collect();
            let action = |rng: &mut Rng| Continuous::<2>(core::array::from_fn(|_| 2.0 * rng.uniform() - 1.0));
            let replay = replay(spec, &observations, action, &mut rng);
            let actions = ActionSpec::Continuous { names: &["left", "right"], low: -1.0, high: 1.0 };
            let config = Td3Config {
                hidden: 256,
                layers: 2,
                gamma: 0.99,
                tau: 0.005,
                policy_noise: 0.2,
                noise_clip: 0.5,
                exploration_noise: 0.1,
                policy_delay: 2,
                adam: adam(3e-4),
            };
            let mut agent = Td3::<2>::new(spec, &actions, &config, &mut Rng::new(2));
            let mut noise = Rng::new(4);
            (agent.update_work(256), batches(replay, 256, move |batch| agent.update(batch, &mut noise)))
        }
    }
}
