//! Times of the parts that a check is made of.
fn main() {}
