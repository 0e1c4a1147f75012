//! Bytes with a header that says what they are: a snapshot, or a forecast on its way to and from somebody else.
//!
//! Magic, version, length, digest; then the world's name, which says which types follow. The digest finds accidents;
//! it is no protection against an adversary.

use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::{SNAPSHOT_VERSION, SnapshotError};
use crate::digest::Digest;

/// First bytes of what is sealed here.
pub(crate) type Magic = [u8; 8];

/// Bytes before the payload: magic, version, length, digest.
const HEADER: usize = 8 + 4 + 8 + 8;

/// `state` of a world of this name, under a header.
pub(crate) fn seal(magic: &Magic, name: &str, state: &[u8]) -> Vec<u8> {
    let mut payload = Vec::with_capacity(1 + name.len() + state.len());
    payload.push(name.len() as u8);
    payload.extend_from_slice(name.as_bytes());
    payload.extend_from_slice(state);
    let mut bytes = Vec::with_capacity(HEADER + payload.len());
    bytes.extend_from_slice(magic);
    bytes.extend_from_slice(&SNAPSHOT_VERSION.to_le_bytes());
    bytes.extend_from_slice(&(payload.len() as u64).to_le_bytes());
    bytes.extend_from_slice(&Digest::default().bytes(&payload).finish().to_le_bytes());
    bytes.extend_from_slice(&payload);
    bytes
}

/// A number of the header.
fn number(bytes: &[u8], range: core::ops::Range<usize>) -> u64 {
    let mut word = [0; 8];
    word[..range.len()].copy_from_slice(&bytes[range]);
    u64::from_le_bytes(word)
}

/// The digest in the header of sealed bytes, which names them.
pub(crate) fn digest(sealed: &[u8]) -> u64 {
    number(sealed, 20..HEADER)
}

/// The world's name and the state in sealed bytes.
pub(crate) fn open<'a>(magic: &Magic, bytes: &'a [u8]) -> Result<(&'a str, &'a [u8]), SnapshotError> {
    let damaged = |why: String| SnapshotError::Damaged(why);
    let found = bytes.len() as u64;
    if bytes.len() < HEADER {
        return Err(if magic.starts_with(&bytes[..bytes.len().min(8)]) && !bytes.is_empty() {
            SnapshotError::Truncated { found, expected: HEADER as u64 }
        } else {
            SnapshotError::Unrecognised
        });
    }
    if &bytes[..8] != magic {
        return Err(SnapshotError::Unrecognised);
    }
    let version = number(bytes, 8..12) as u32;
    if version != SNAPSHOT_VERSION {
        return Err(SnapshotError::Version { found: version, expected: SNAPSHOT_VERSION });
    }
    let expected = number(bytes, 12..20).saturating_add(HEADER as u64);
    if found < expected {
        return Err(SnapshotError::Truncated { found, expected });
    }
    let payload = &bytes[HEADER..];
    if found > expected {
        return Err(damaged(format!("{} bytes too many", found - expected)));
    }
    if Digest::default().bytes(payload).finish() != digest(bytes) {
        return Err(damaged("its bytes were altered".to_owned()));
    }
    let (name, state) = payload
        .split_first()
        .and_then(|(&len, rest)| rest.split_at_checked(usize::from(len)))
        .ok_or_else(|| damaged("it names no world".to_owned()))?;
    let name = core::str::from_utf8(name).map_err(|_| damaged("it names no world".to_owned()))?;
    Ok((name, state))
}

/// A value from its binary form, all of it.
pub(crate) fn decode<T: serde::de::DeserializeOwned>(state: &[u8]) -> Result<T, SnapshotError> {
    let (value, rest): (T, _) = postcard::take_from_bytes(state)
        .map_err(|error| SnapshotError::Damaged(format!("its content makes no sense: {error}")))?;
    if !rest.is_empty() {
        return Err(SnapshotError::Damaged("its parts do not belong together".to_owned()));
    }
    Ok(value)
}

/// The binary form of a value.
pub(crate) fn encode(value: &impl serde::Serialize) -> Vec<u8> {
    postcard::to_allocvec(value).expect("plain data has a binary form")
}
