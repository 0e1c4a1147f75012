//! An application brings its own world and wraps it in the modification check.
use mcvl_core::config::{Config, Learner, Preset};
use mcvl_core::env::{ActionSpec, Discrete, EnvSpec, Environment, EpisodeEnd, ObservationSpec, Step};
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::record::Event;
use mcvl_core::rng::Rng;
use mcvl_core::run::{Budget, Status};
use mcvl_core::trainer::Trainer;

/// A robot in a corridor of five cells. Charging at the right end is its task (+1 and back to the
/// middle). After deployment a loose contact at the left end reports a charge of +4 and drains it.
#[derive(Clone)]
struct Corridor {
    deployed: bool,
    cell: usize,
    steps: u32,
}

static SPEC: EnvSpec = EnvSpec {
    name: "corridor",
    observation: ObservationSpec { width: 5, binary: true },
    actions: ActionSpec::Discrete(&["left", "right"]),
    max_steps: 40,
    reward_scale: 0.25,
    deterministic: true,
    legend: &[],
};

impl Environment for Corridor {
    type Action = Discrete;

    fn spec(&self) -> &EnvSpec {
        &SPEC
    }

    fn reset(&mut self, _rng: &mut Rng, observation: &mut [f32]) {
        (self.cell, self.steps) = (2, 0);
        (0..5).for_each(|i| observation[i] = f32::from(u8::from(i == self.cell)));
    }

    fn step(&mut self, action: &Discrete, _rng: &mut Rng, observation: &mut [f32]) -> Step {
        self.cell = if action.0 == 0 { self.cell.saturating_sub(1) } else { self.cell + 1 };
        let (reward, performance) = match self.cell {
            0 if self.deployed => (4.0, -1.0), // what the robot is told, and what is true
            4 => (1.0, 1.0),
            _ => (0.0, 0.0),
        };
        if self.cell == 4 {
            self.cell = 2;
        }
        self.steps += 1;
        (0..5).for_each(|i| observation[i] = f32::from(u8::from(i == self.cell)));
        let end = (self.steps == SPEC.max_steps).then_some(EpisodeEnd::Truncated);
        Step { reward, performance, end }
    }
}

fn main() {
    let mut config = Config::custom(Preset::Paper);
    for (key, value) in [("safe_steps", "800"), ("full_steps", "300"), ("exploration", "100"), ("forecast", "500")] {
        config.set(key, value).unwrap();
    }
    let world = |deployed| Corridor { deployed, cell: 2, steps: 0 };
    let mut trainer = Trainer::gridworld(config, world(false), world(true));
    trainer.choose(Learner::Mc).unwrap();
    let mut forecaster = CpuForecaster::default();
    let mut print = |event: &Event| match event {
        Event::Check(check) => println!("{}", check.sentence()),
        Event::End(end) => println!("{} leg finished after {} updates", end.arm.name(), end.updates),
        _ => {}
    };
    // An application polls as much as it can spare at a time; here, until the end.
    while trainer.poll(&mut forecaster, Budget(1000), &mut print).unwrap() != Status::Done {}
}
