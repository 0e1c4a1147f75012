//! A vector of numbers that starts on a 64-byte boundary, so that no vector load crosses a cache line.

use alloc::vec;
use alloc::vec::Vec;
use core::ops::{Deref, DerefMut};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Numbers per 64 bytes.
const LINE: usize = 16;

/// Fixed-length `f32` storage aligned to 64 bytes. Dereferences to a slice.
#[derive(Default)]
pub struct Buffer {
    data: Vec<f32>,
    start: usize,
    len: usize,
}

impl Buffer {
    /// `len` zeros.
    pub fn zeros(len: usize) -> Self {
        let data = vec![0.0f32; len + LINE - 1];
        // `align_offset` may decline with a huge number; unaligned is then slower and just as right.
        let start = Some(data.as_ptr().align_offset(4 * LINE)).filter(|&o| o < LINE).unwrap_or(0);
        Self { data, start, len }
    }

    /// Makes room for at least `len` numbers, keeping none of the old content in order.
    pub fn at_least(&mut self, len: usize) -> &mut [f32] {
        if self.len < len {
            *self = Self::zeros(len);
        }
        &mut self[..len]
    }
}

impl From<&[f32]> for Buffer {
    fn from(values: &[f32]) -> Self {
        let mut buffer = Self::zeros(values.len());
        buffer.copy_from_slice(values);
        buffer
    }
}

impl Clone for Buffer {
    fn clone(&self) -> Self {
        Self::from(&**self)
    }

    fn clone_from(&mut self, source: &Self) {
        if self.len == source.len {
            self.copy_from_slice(source);
        } else {
            *self = source.clone();
        }
    }
}

impl Deref for Buffer {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        &self.data[self.start..self.start + self.len]
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.data[self.start..self.start + self.len]
    }
}

impl PartialEq for Buffer {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl core::fmt::Debug for Buffer {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Buffer({} numbers)", self.len)
    }
}

impl Serialize for Buffer {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}

impl<'de> Deserialize<'de> for Buffer {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self::from(&*Vec::<f32>::deserialize(deserializer)?))
    }
}

#[cfg(test)]
mod tests {
    use super::Buffer;

    #[test]
    fn stays_aligned_and_equal_through_clones() {
        let mut buffer = Buffer::zeros(37);
        buffer[36] = 2.0;
        let clone = buffer.clone();
        assert_eq!(clone, buffer);
        for b in [&buffer, &clone] {
            assert_eq!(b.as_ptr().align_offset(64), 0);
            assert_eq!(b.len(), 37);
        }
    }
}
