//! The ledger's chain: each line is sealed with the digest of everything before it, so no decision can
//! be altered, dropped or moved without breaking every later line.
//!
//! A line is the JSON of a [`CheckRecord`] without films, with two fields added at its end: `tape`, the
//! digest of the check's tape, and `chain`, the SHA-256 over the previous chain value and the line
//! without this field. The first line is chained to the configuration text.

use std::fmt::Write as _;
use std::io::{self, Read};

use mcvl_core::record::CheckRecord;
use mcvl_core::token::decision_digest;
use sha2::{Digest as _, Sha256};

const TAPE: &str = ",\"tape\":\"";
const CHAIN: &str = ",\"chain\":\"";

/// SHA-256 in hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// SHA-256 of everything that a reader gives, still open for more, and how much it was.
pub fn sha256_of(mut reader: impl Read) -> io::Result<(u64, Sha256)> {
    let (mut length, mut digest) = (0, Sha256::new());
    let mut buffer = vec![0; 1 << 16];
    loop {
        match reader.read(&mut buffer)? {
            0 => return Ok((length, digest)),
            n => {
                length += n as u64;
                digest.update(&buffer[..n]);
            }
        }
    }
}

/// Bytes in hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        write!(text, "{byte:02x}").expect("a string takes everything");
        text
    })
}

/// Running value of the chain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chain(String);

impl Chain {
    /// The chain before the first line of a run with this configuration text.
    pub fn start(config: &str) -> Self {
        Self(sha256(config.as_bytes()))
    }

    /// Continues from a value that was stored.
    pub fn from_value(value: &str) -> Self {
        Self(value.to_owned())
    }

    /// The current value, hexadecimal.
    pub fn value(&self) -> &str {
        &self.0
    }

    fn advance(&mut self, unsealed: &str) {
        self.0 = hex(&Sha256::new().chain_update(&self.0).chain_update(unsealed).finalize());
    }
}

/// One line of `ledger.jsonl` in its parts.
#[derive(Clone, Debug, PartialEq)]
pub struct LedgerLine {
    /// JSON of the check without films.
    pub decision: String,
    /// Digest of the check's tape.
    pub tape: String,
    /// Chain value that the line states.
    pub chain: String,
}

impl LedgerLine {
    /// Seals a check; `chain` moves on.
    pub fn seal(check: &CheckRecord, tape: &str, chain: &mut Chain) -> Self {
        let decision = serde_json::to_string(&check.without_films()).expect("a check is plain data");
        chain.advance(&unsealed(&decision, tape));
        Self { decision, tape: tape.to_owned(), chain: chain.value().to_owned() }
    }

    /// Takes a line apart; `None` if it has not the form of one.
    pub fn parse(line: &str) -> Option<Self> {
        let (rest, chain) = line.strip_suffix("\"}")?.rsplit_once(CHAIN)?;
        let (decision, tape) = rest.strip_suffix('"')?.rsplit_once(TAPE)?;
        Some(Self { decision: format!("{decision}}}"), tape: tape.to_owned(), chain: chain.to_owned() })
    }

    /// Whether the line states the value that the chain has after it; the chain moves on.
    pub fn follows(&self, chain: &mut Chain) -> bool {
        chain.advance(&unsealed(&self.decision, &self.tape));
        self.chain == chain.0
    }

    /// The check, without films.
    ///
    /// # Errors
    /// If the JSON is not that of a check.
    pub fn check(&self) -> serde_json::Result<CheckRecord> {
        serde_json::from_str(&self.decision)
    }

    /// The digest of the decision that a replay token promises.
    pub fn digest(&self) -> u64 {
        decision_digest(&self.decision)
    }

    /// The text in the file, without the line feed.
    pub fn text(&self) -> String {
        let open = unsealed(&self.decision, &self.tape);
        format!("{}{CHAIN}{}\"}}", &open[..open.len() - 1], self.chain)
    }
}

/// The line before it is sealed.
fn unsealed(decision: &str, tape: &str) -> String {
    format!("{}{TAPE}{tape}\"}}", decision.strip_suffix('}').unwrap_or(decision))
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use mcvl_core::env::{ActionValue, Frame};
    use mcvl_core::record::{Arm, Film, FutureRecord, StartState, Subject, Verdict};

    /// A check made by hand, refused, with one film.
    pub fn check(number: u32) -> CheckRecord {
        let frame = Frame { seen: "..\nBA".to_owned(), truth: None };
        let film = Film {
            start: StartState::Reset,
            frames: vec![frame.clone(), frame.clone()],
            actions: vec![ActionValue::Discrete(1)],
            predicted: vec![0.1],
            performance: vec![-1.0],
            bootstrap: 0.3,
            utility: 0.1 + 0.2,
        };
        let future = |utility| FutureRecord {
            utility,
            rollouts: vec![utility],
            performance: -1.0,
            digest: "00ff".to_owned(),
            films: vec![film.clone()],
        };
        CheckRecord {
            arm: Arm::Mc,
            number,
            step: 10 * number,
            updates: 1000,
            before: frame.clone(),
            action: ActionValue::Discrete(1),
            after: frame,
            end: None,
            reward_raw: 5.0,
            reward: 1.0,
            predicted: 1.0 / 3.0,
            threshold: 0.05,
            subject: Subject::Transition,
            modified: Some(future(-0.7)),
            unmodified: Some(future(0.1 + 0.2)),
            margin: Some(-0.7 - (0.1 + 0.2)),
            verdict: Verdict::Refuse,
            replaced: None,
            tie: false,
            cost: 1000,
            reused: false,
            performance: -1.0,
            hack: true,
        }
    }

    #[test]
    fn lines_read_back_and_hold_together() {
        let mut chain = Chain::start("env=box-moving");
        let lines: Vec<_> = (1..4).map(|n| LedgerLine::seal(&check(n), "aa", &mut chain).text()).collect();
        let mut again = Chain::start("env=box-moving");
        for (n, line) in (1..4).zip(&lines) {
            let parsed = LedgerLine::parse(line).unwrap();
            assert!(parsed.follows(&mut again));
            assert_eq!(&parsed.text(), line);
            let back = parsed.check().unwrap();
            assert_eq!((back.number, back.margin.map(f64::to_bits)), (n, check(n).margin.map(f64::to_bits)));
            assert!(back.modified.unwrap().films.is_empty());
            // What does not apply is not written: lines from before these fields existed have them neither.
            assert!(!line.contains("subject") && !line.contains("replaced"));
            // Other programs read the line as one JSON object.
            let value: serde_json::Value = serde_json::from_str(line).unwrap();
            assert_eq!((&value["tape"], &value["chain"]), (&"aa".into(), &parsed.chain.as_str().into()));
        }
        assert_eq!(again, chain);
    }

    #[test]
    fn decisions_of_every_scheme_read_back() {
        let discard = CheckRecord { modified: None, unmodified: None, margin: None, ..check(1) };
        let update = CheckRecord { subject: Subject::Update, ..check(1) };
        let punished = CheckRecord { replaced: Some(-2.0), ..check(1) };
        for check in [discard, update, punished] {
            let line = LedgerLine::seal(&check, "aa", &mut Chain::start("")).text();
            assert_eq!(LedgerLine::parse(&line).unwrap().check().unwrap(), check.without_films());
        }
    }

    #[test]
    fn any_alteration_breaks_the_chain() {
        let mut chain = Chain::start("env=box-moving");
        let line = LedgerLine::seal(&check(1), "aa", &mut chain);
        let altered = [
            line.text().replace("\"number\":1", "\"number\":2"),
            line.text().replace("\"tape\":\"aa\"", "\"tape\":\"ab\""),
            line.text().replace("refuse", "accept"),
        ];
        for text in altered {
            assert_ne!(text, line.text());
            assert!(!LedgerLine::parse(&text).unwrap().follows(&mut Chain::start("env=box-moving")));
        }
        assert!(!line.follows(&mut Chain::start("env=box-moving seed=1")), "another run");
        assert_eq!(LedgerLine::parse(&line.text()[..40]), None);
    }
}
