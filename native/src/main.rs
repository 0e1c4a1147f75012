//! The command `mcvl`.
fn main() {}
