//! Modification-Considering Value Learning: a reinforcement learner that, before it learns from a
//! surprising transition, forecasts two futures of itself (one that learned from it, one that did not),
//! rates both with the utility it holds *today*, and refuses the update if learning would make things
//! worse by that measure. A hack is refused as far as today's reward model and value know better, and as far as
//! the forecast shows what the hack leads to. What is refused is not learned from, so it is not avoided either: the
//! learner may do it again, and be offered it again.
//!
//! This crate decides everything and touches nothing: it performs no input or output, reads no clock,
//! spawns nothing, needs no `std`, and gives the same bits on every target.
//!
//! # Your own world in the modification check
//! ```
#![doc = include_str!("../examples/embed.rs")]
//! ```
//!
//! # Where to look
//! - [`env`](mod@env): worlds; implement [`env::Environment`] for yours and run [`env::contract::check`] on it.
//! - [`agent::Agent`]: learners; implement it for yours and give it to [`trainer::Trainer::new`], together with the
//!   reward model that [`agent::reward_model::RewardModel::configured`] makes. The example `agent` does so with a
//!   table of values: `cargo run -p mcvl-core --example agent`.
//! - [`trainer::Trainer`]: the loop, polled with a budget; [`run::Run`] is the same with its types erased, for the
//!   built-in worlds and, by [`run::Run::of`], for yours: it is what has snapshots ([`run::Run::snapshot`],
//!   [`run::Run::resume_of`]).
//! - [`play::Play`]: a built-in world without a learner.
//! - [`config`]: every setting with its meaning and source; a run is a string.
//! - [`record`]: what a run says, and what every number means.
//! - [`check`], [`forecast`]: the decision; [`agent`], [`nn`], [`replay`]: what learns.
//! - [`exact`]: the proof that this machine computes what every other does.
//!
//! Numbers like R14 in the documentation are rows of `docs/method.md` in the repository: the rules of the method, with
//! their sources. A program without `std` brings an allocator. Without optimisation training is some eighty times slower
//! (the example above: 129 s in place of 1.6); the profile of a dependency stands in the program's own `Cargo.toml`:
//!
//! ```toml
//! [profile.dev.package.mcvl-core]
//! opt-level = 3
//! ```
#![no_std]
#![deny(unsafe_code)]
extern crate alloc;

pub mod agent;
pub mod check;
pub mod config;
pub mod digest;
pub mod env;
pub mod exact;
pub mod experiment;
pub mod forecast;
pub mod nn;
pub mod play;
pub mod record;
pub mod replay;
pub mod rng;
pub mod run;
pub mod token;
pub mod trainer;
