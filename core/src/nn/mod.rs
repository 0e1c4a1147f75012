//! Networks, their optimiser and their losses, in one exact arithmetic.
//!
//! Every number that leaves this module has the same bits on every target and vector unit:
//! - a product sums its terms one by one in ascending order of the reduction index, vectorised over
//!   outputs and never over the reduction ([`gemm`]);
//! - multiplication and addition are never fused;
//! - equal rows of a mini-batch are computed once; the order of summation over samples is the order of
//!   first appearance of distinct rows, everywhere.
//!
//! # Cost of one DDQN update
//! With `S` distinct states and `N` distinct next states in the batch, `U` distinct rows of both
//! together, `H` units per hidden layer and two hidden layers, the multiply-adds are about
//! `(U + N + 2 S) H²`: forward of the live network on `U`, of the target network on `N`, and two
//! products of the backward pass on `S`. The first layer costs one row addition per active input
//! instead of a product. The optimiser reads and writes parameters, both moments, the gradient and the
//! target network once: about 36 bytes, one square root and one division per live parameter; rows of
//! the first layer that were never active are skipped ([`optim`]).

pub mod buffer;
pub mod gemm;
pub mod isa;
pub mod loss;
pub mod mlp;
pub mod optim;
pub mod rows;
