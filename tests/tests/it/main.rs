//! Tests that need more than one room, in one program.

mod cli;
mod cli_docs;
mod cli_errors;
mod cli_gpu;
mod cli_reading;
mod cli_resume;
mod cli_targets;
mod export;
mod golden;
mod golden_reacher;
mod page;
mod play;
mod reproduce;
mod serve;
mod tidy;
mod wasm;
