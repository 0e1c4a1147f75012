//! Modification-Considering Value Learning.
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
pub mod record;
pub mod replay;
pub mod rng;
pub mod run;
pub mod trainer;
