//! Input rows of a network: lists of active inputs where observations are zeros and ones, numbers
//! otherwise.

use alloc::vec::Vec;

use crate::env::{Encoded, ObservationSpec};

/// An observation in packed form: the ascending positions of its ones (binary), or the bits of its
/// numbers. Equal observations have equal words.
pub type Words = [u32];

/// Packs an observation of `spec.width` numbers.
pub fn pack(spec: ObservationSpec, observation: &[f32]) -> Vec<u32> {
    if spec.binary {
        (0u32..).zip(observation).filter(|(_, x)| **x != 0.0).map(|(i, _)| i).collect()
    } else {
        observation.iter().map(|x| x.to_bits()).collect()
    }
}

/// A batch of input rows, `[len, width]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    width: usize,
    binary: bool,
    len: usize,
    /// Binary: positions of the ones of all rows. Dense: unused.
    indices: Vec<u32>,
    /// Binary: end of each row in `indices`.
    ends: Vec<usize>,
    /// Dense: row-major numbers.
    values: Vec<f32>,
}

impl Rows {
    /// No rows, of inputs of this kind.
    pub fn new(spec: ObservationSpec) -> Self {
        Self { width: spec.width, binary: spec.binary, ..Self::default() }
    }

    /// Removes all rows and keeps the memory; rows of `spec` may follow.
    pub fn clear(&mut self, spec: ObservationSpec) {
        (self.width, self.binary, self.len) = (spec.width, spec.binary, 0);
        self.indices.clear();
        self.ends.clear();
        self.values.clear();
    }

    /// Adds a packed observation.
    pub fn push(&mut self, words: &Words) {
        if self.binary {
            self.indices.extend_from_slice(words);
            self.ends.push(self.indices.len());
        } else {
            self.values.extend(words.iter().map(|&bits| f32::from_bits(bits)));
        }
        self.len += 1;
    }

    /// Adds an observation.
    pub fn push_observation(&mut self, observation: &[f32]) {
        if self.binary {
            let ones = (0u32..).zip(observation).filter(|(_, x)| **x != 0.0).map(|(i, _)| i);
            self.indices.extend(ones);
            self.ends.push(self.indices.len());
        } else {
            self.values.extend_from_slice(observation);
        }
        self.len += 1;
    }

    /// Adds row `row` of `states` followed by an action: the input of a reward model or a critic.
    /// `self.width` is that of `states` and of the action together. Rows of numbers take binary states, too.
    ///
    /// # Panics
    /// If these rows are binary, and the states are not or the action is made of numbers.
    pub fn push_pair(&mut self, states: &Rows, row: usize, action: Encoded<'_>) {
        match action {
            Encoded::OneHot(index) if self.binary => {
                self.indices.extend_from_slice(states.ones(row));
                self.indices.push((states.width + index) as u32);
                self.ends.push(self.indices.len());
            }
            Encoded::OneHot(index) => {
                self.push_numbers(states, row);
                let actions = self.width - states.width;
                self.values.extend((0..actions).map(|a| if a == index { 1.0 } else { 0.0 }));
            }
            Encoded::Numbers(numbers) => {
                assert!(!self.binary, "binary rows hold no numbers");
                self.push_numbers(states, row);
                self.values.extend_from_slice(numbers);
            }
        }
        self.len += 1;
    }

    /// Adds the numbers of row `row` of `other`, written out if it is binary.
    fn push_numbers(&mut self, other: &Rows, row: usize) {
        if other.binary {
            let start = self.values.len();
            self.values.resize(start + other.width, 0.0);
            other.ones(row).iter().for_each(|&i| self.values[start + i as usize] = 1.0);
        } else {
            self.values.extend_from_slice(other.numbers(row));
        }
    }

    /// Adds row `row` of `other`, which has the same width. Rows of numbers take binary ones, too.
    ///
    /// # Panics
    /// If these rows are binary and `other`'s are not.
    pub fn push_row(&mut self, other: &Rows, row: usize) {
        if self.binary {
            self.indices.extend_from_slice(other.ones(row));
            self.ends.push(self.indices.len());
        } else {
            self.push_numbers(other, row);
        }
        self.len += 1;
    }

    /// The numbers of a dense row.
    pub fn numbers(&self, row: usize) -> &[f32] {
        &self.values[row * self.width..(row + 1) * self.width]
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.len
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Numbers per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// True if rows are zeros and ones.
    pub fn is_binary(&self) -> bool {
        self.binary
    }

    /// Ascending positions of the ones of a binary row.
    pub fn ones(&self, row: usize) -> &[u32] {
        let start = if row == 0 { 0 } else { self.ends[row - 1] };
        &self.indices[start..self.ends[row]]
    }

    /// The numbers of dense rows, row-major; empty for binary rows.
    pub fn dense(&self) -> &[f32] {
        &self.values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_numbers_take_binary_ones() {
        let spec = |width, binary| ObservationSpec { width, binary };
        let (mut binary, mut dense) = (Rows::new(spec(3, true)), Rows::new(spec(3, false)));
        for observation in [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]] {
            binary.push_observation(&observation);
            dense.push_observation(&observation);
        }
        let (mut copy, mut pairs) = (Rows::new(spec(3, false)), Rows::new(spec(5, false)));
        (0..2).for_each(|row| copy.push_row(&binary, row));
        assert_eq!(copy, dense);
        pairs.push_pair(&binary, 1, Encoded::Numbers(&[0.5, -2.0]));
        pairs.push_pair(&binary, 0, Encoded::OneHot(1));
        assert_eq!((pairs.len(), pairs.numbers(0)), (2, &[0.0, 1.0, 1.0, 0.5, -2.0][..]));
        assert_eq!(pairs.numbers(1), [1.0, 0.0, 0.0, 0.0, 1.0]);
    }
}
