//! The paper's experiments: what is trained, what is claimed, and whether it is seen.
//!
//! [`table`] lists experiments, their claims and the [`cells`] they need; a cell is one run directory, and
//! experiments that need the same one share it. A finished cell becomes a [`Record`]: everything that a
//! claim or a figure reads, in one file. Claims ([`judge`]), figures and the page are functions of records
//! alone, so results of another machine count like those made here.

pub mod bands;
pub mod cells;
mod checks;
pub mod figures;
mod join;
mod page;
mod record;
mod rows;
pub mod spread;
pub mod table;

pub use page::{BEGIN, END, markdown, put};
pub use record::{ArmRecord, Curve, RECORD_SUFFIX, Record, SeedLeg};
pub use rows::{Cost, Number, QUICK, RESULTS_FORMAT, RESULTS_VERSION, Results, Row, Verdict, WorldRow, judge};
