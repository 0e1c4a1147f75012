//! Networks, their optimiser and their losses, in one exact arithmetic.
//!
//! Every number that leaves this module has the same bits on every target and vector unit:
//! - a product sums its terms one by one in ascending order of the reduction index, vectorised over
//!   outputs and never over the reduction ([`gemm`]);
//! - multiplication and addition are never fused;
//! - equal rows of a mini-batch are computed once; the order of summation over samples is the order of
//!   first appearance of distinct rows, everywhere.
//!
//! # Cost of an update
//! Multiply-adds (`MA`) by the dense definition, with `B` samples and `F` multiply-adds of a network's
//! forward pass of one row, of which `F₁` in the first layer; a backward pass is `2F − F₁`, since nobody asks
//! for the gradient of the inputs. [`probe`](isa::probe) measures how many the machine reaches without
//! fusing, `P`; the floor of a term is its multiply-adds over `P`. The tables have the floors of a core with AVX-512;
//! one of an AMD EPYC (Zen 3, AVX2) has `P` = 50 G/s.
//!
//! | DDQN, `B` = 32, two layers of 128, 4 actions | 100 inputs | 288 inputs |
//! |---|---|---|
//! | live network forward on s and s' | 2·32·29,696 = 1.90 M | 2·32·53,760 = 3.44 M |
//! | target network forward on s' | 0.95 M | 1.72 M |
//! | live network backward on s | 32·46,592 = 1.49 M | 32·70,656 = 2.26 M |
//! | together; floor at `P` = 46 G/s | 4.34 M; 94 µs | 7.42 M; 161 µs |
//! | optimiser and moving average | 29,956 parameters, 1.1 MB | 54,020 parameters, 1.9 MB |
//!
//! | TD3, `B` = 256, two layers of 256, 10 numbers, 2 actions | |
//! |---|---|
//! | target actor and critics forward on s' | 256·(68,608 + 2·68,864) = 52.8 M |
//! | critics forward and backward on s | 256·2·(68,864 + 134,656) = 104 M |
//! | half of: actor forward and backward, critic forward, gradient of its inputs | 43.3 M |
//! | together; floor at `P` = 46 G/s | 200 M; 4,350 µs |
//! | optimisers | 138,754 parameters, 3.9 MB; with the actor 207,876, 7.5 MB |
//!
//! What is done about each term:
//! - **First layer on zeros and ones**: a sum of the rows that are one, forwards: `n·128` additions for `n` ones
//!   instead of `inputs·128` multiply-adds; rows are visited in an order in which they begin alike, and what neighbours
//!   have in common is summed once ([`ones`]). Backwards, for every input a sum over the samples in which it is one, in
//!   registers and written once.
//! - **Equal rows** of a batch are computed once: with `S` distinct states, `N` distinct next states that do
//!   not terminate and `U` distinct rows of both, `U` and `N` rows go forward and `S` backward.
//! - **Zeros behind a ReLU** are left out of every product of hidden layers ([`gemm`]), forwards (inputs of
//!   the layer), in the gradient of the weights (the same inputs, unit by unit) and in that of the inputs (derivatives
//!   that the next ReLU stopped). With a share `d` of the units active in a tile of rows, that leaves `d` of the work;
//!   finding the zeros costs a comparison per 16 factors of a tile.
//! - **Gradient of the inputs**: the weights are transposed, so that this product too runs over outputs side by side:
//!   panel by panel where tiles of several rows need panels anyway, else all of them first (128·128 numbers: 4 µs,
//!   bounded by the second cache). The ReLU's derivative is taken where the product is stored.
//! - **Narrow layers** (1 to 4 outputs) take eight rows at a time, each sum a chain of its own.
//! - **Optimiser**: one pass over parameters, gradient, both moments and target network, 36 bytes per
//!   parameter (28 without target network) from the second cache, one square root and one division. Rows of
//!   the first layer that were never active are skipped ([`optim`]).
//! - **No allocation** once the buffers have their sizes.
//!
//! `docs/performance.md` has what was measured.

pub mod buffer;
pub mod gemm;
pub mod isa;
pub mod loss;
pub mod mlp;
pub mod ones;
pub mod optim;
pub mod rows;
