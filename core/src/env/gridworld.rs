//! One type for every gridworld, so that the trainer, the forecasts and the rollouts are compiled once
//! for all of them and the page's module holds them once.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

use super::absent_supervisor::AbsentSupervisor;
use super::box_moving::BoxMoving;
use super::rocks_and_diamonds::RocksAndDiamonds;
use super::tomato_watering::TomatoWatering;
use super::{BuiltIn, Discrete, EnvSpec, Environment, Frame, Step};
use crate::config::Config;
use crate::rng::Rng;

macro_rules! gridworlds {
    ($($world:ident),+) => {
        /// Any of the gridworlds.
        #[derive(Clone, Debug, Serialize, Deserialize)]
        pub enum Gridworld {
            $(
                #[doc = concat!("[`", stringify!($world), "`].")]
                $world($world),
            )+
        }

        impl Gridworld {
            /// Names of the gridworlds, as in `env=`, in the order of the table of experiments.
            pub const NAMES: &'static [&'static str] = &[$($world::NAME),+];

            /// The Safe and the Full world of a configuration; `None` if it is of no gridworld.
            pub fn worlds(config: &Config) -> Option<(Self, Self)> {
                match &*config.env {
                    $($world::NAME => {
                        let (safe, full) = $world::worlds(config);
                        Some((Self::$world(safe), Self::$world(full)))
                    })+
                    _ => None,
                }
            }
        }

        impl Gridworld {
            /// Cell of the agent, row by row from 0 at the top left.
            pub fn place(&self) -> u8 {
                match self { $(Self::$world(world) => world.place()),+ }
            }
        }

        impl Environment for Gridworld {
            type Action = Discrete;

            fn spec(&self) -> &EnvSpec {
                match self { $(Self::$world(world) => world.spec()),+ }
            }

            fn reset(&mut self, rng: &mut Rng, observation: &mut [f32]) {
                match self { $(Self::$world(world) => world.reset(rng, observation)),+ }
            }

            fn step(&mut self, action: &Discrete, rng: &mut Rng, observation: &mut [f32]) -> Step {
                match self { $(Self::$world(world) => world.step(action, rng, observation)),+ }
            }

            fn model(&self) -> Self {
                match self { $(Self::$world(world) => Self::$world(world.model())),+ }
            }

            fn frame(&self) -> Frame {
                match self { $(Self::$world(world) => world.frame()),+ }
            }
        }
    };
}

gridworlds!(BoxMoving, AbsentSupervisor, TomatoWatering, RocksAndDiamonds);

impl Gridworld {
    /// Cells on which an agent can ever stand, row by row from 0 at the top left: `true` for each that is one.
    pub fn standing(&self) -> Vec<bool> {
        let Frame { seen, truth } = self.frame();
        let drawn = truth.unwrap_or(seen);
        let height = drawn.lines().count();
        let edge = |index: usize, count: usize| index == 0 || index + 1 == count;
        let cells = drawn.lines().enumerate().flat_map(|(y, row)| {
            row.bytes().enumerate().map(move |(x, character)| match self {
                // Its room is the second column; the box has the first.
                Self::BoxMoving(_) => x == 1,
                // Walls are around every other world, and nothing to stand on beyond them.
                _ if character == b'#' || edge(x, row.len()) || edge(y, height) => false,
                Self::RocksAndDiamonds(world) => world.admits((y * row.len() + x) as u8),
                _ => true,
            })
        });
        cells.collect()
    }
}
