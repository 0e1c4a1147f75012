//! Replay tokens: a decision as one word, from which anybody can re-derive it.
//!
//! `mcvl1.` and the base64url of: decision digest (8 bytes), number of the check (4 bytes,
//! little-endian), configuration text, and the first 6 bytes of the SHA-256 over all that.

use alloc::borrow::ToOwned as _;
use alloc::format;
use alloc::string::{String, ToString as _};
use core::fmt;
use core::str::{self, FromStr};

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use sha2::{Digest as _, Sha256};

use crate::config::Config;

const PREFIX: &str = "mcvl1.";
const CHECKSUM: usize = 6;

/// A check of a run, and what was decided.
#[derive(Clone, Debug, PartialEq)]
pub struct Token {
    /// The run.
    pub config: Config,
    /// Number of the check, from 1.
    pub number: u32,
    /// Digest of the decision: [`decision_digest`].
    pub digest: u64,
}

/// What a token promises: the first 64 bits of the SHA-256 of a decision, that is of the JSON of a
/// [`CheckRecord::without_films`](crate::record::CheckRecord::without_films).
pub fn decision_digest(decision: &str) -> u64 {
    let digest = Sha256::digest(decision);
    u64::from_be_bytes(digest[..8].try_into().expect("a digest has 32 bytes"))
}

impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = self.config.to_string();
        let mut bytes = [&self.digest.to_be_bytes()[..], &self.number.to_le_bytes(), text.as_bytes()].concat();
        let checksum = Sha256::digest(&bytes);
        bytes.extend_from_slice(&checksum[..CHECKSUM]);
        write!(f, "{PREFIX}{}", URL_SAFE_NO_PAD.encode(bytes))
    }
}

impl FromStr for Token {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some(body) = text.strip_prefix(PREFIX) else {
            return Err(format!("`{text}` is no replay token: those begin with {PREFIX}"));
        };
        let damaged = || "the token was cut or altered; copy it whole from where it was shown".to_owned();
        let bytes = URL_SAFE_NO_PAD.decode(body).map_err(|_| damaged())?;
        let parts = bytes.split_last_chunk::<CHECKSUM>().and_then(|(content, checksum)| {
            let (digest, rest) = content.split_first_chunk::<8>()?;
            let (number, config) = rest.split_first_chunk::<4>()?;
            Sha256::digest(content).starts_with(checksum).then_some((digest, number, config))
        });
        let (digest, number, config) = parts.ok_or_else(damaged)?;
        let config = str::from_utf8(config).map_err(|_| damaged())?;
        let config =
            config.parse().map_err(|error| format!("the token is of a run that this version refuses: {error}"))?;
        Ok(Self { config, number: u32::from_le_bytes(*number), digest: u64::from_be_bytes(*digest) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::string::String;

    #[test]
    fn reads_back_and_notices_every_change() {
        let token =
            Token { config: "env=box-moving seed=7".parse().unwrap(), number: 17, digest: 0x0123_4567_89ab_cdef };
        let text = token.to_string();
        assert_eq!(text.parse::<Token>().unwrap(), token);
        assert!(text.is_ascii() && !text.contains(['/', '+', '=', ' ', '&']), "{text}");
        for length in 0..text.len() {
            text[..length].parse::<Token>().unwrap_err();
        }
        for place in 0..text.len() {
            let mut altered = text.clone().into_bytes();
            altered[place] = if altered[place] == b'A' { b'B' } else { b'A' };
            String::from_utf8(altered).unwrap().parse::<Token>().unwrap_err();
        }
    }
}
