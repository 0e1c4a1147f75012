//! A 64-bit digest of bits (FNV-1a): how golden values, verdicts and states are compared across
//! targets. It detects differences, it is no protection against an adversary.

use serde::{Deserialize, Serialize};

/// Running FNV-1a digest over 64-bit words fed byte by byte in little-endian order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    /// Feeds raw bytes.
    pub fn bytes(mut self, bytes: &[u8]) -> Self {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
        self
    }

    /// Feeds an integer.
    pub fn u64(self, value: u64) -> Self {
        self.bytes(&value.to_le_bytes())
    }

    /// Feeds the bits of a number; `-0.0` and `0.0` differ, every NaN payload counts.
    pub fn f64(self, value: f64) -> Self {
        self.u64(value.to_bits())
    }

    /// Feeds the bits of every number of a slice.
    pub fn f32s(mut self, values: &[f32]) -> Self {
        for value in values {
            self = self.bytes(&value.to_bits().to_le_bytes());
        }
        self
    }

    /// The digest so far.
    pub fn finish(self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::Digest;

    #[test]
    fn published_vectors_of_fnv1a() {
        assert_eq!(Digest::default().finish(), 0xcbf2_9ce4_8422_2325);
        assert_eq!(Digest::default().bytes(b"a").finish(), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(Digest::default().bytes(b"foobar").finish(), 0x8594_4171_f739_67e8);
    }

    #[test]
    fn a_bit_counts() {
        let one = Digest::default().f32s(&[0.0]).finish();
        assert_ne!(one, Digest::default().f32s(&[-0.0]).finish());
    }
}
