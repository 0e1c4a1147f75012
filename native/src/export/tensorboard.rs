//! Event files for TensorBoard: one run of TensorBoard per seed and leg, so that the legs of a seed lie
//! over each other.
//!
//! # Format
//! A file is a sequence of records: length of the data (u64), checksum of those 8 bytes (u32), data,
//! checksum of the data (u32); numbers are little-endian. A checksum is CRC-32C, rotated right by 15 bits
//! and shifted by a constant. The data is a protocol-buffers message of this shape; the first record has
//! the version and no summary:
//!
//! ```text
//! Event    { double wall_time = 1; int64 step = 2; string file_version = 3; Summary summary = 5; }
//! Summary  { repeated Value value = 1; }
//! Value    { string tag = 1; float simple_value = 2; }
//! ```
//! What the values mean is told in `docs/export.md`.

use std::time::{SystemTime, UNIX_EPOCH};

use crc::{CRC_32_ISCSI, Crc};
use mcvl_core::record::{Arm, Verdict};

use super::File;
use crate::runs::SeedRun;

/// TensorBoard reads files with `tfevents` in their name.
const NAME: &str = "events.out.tfevents.mcvl";
const VERSION: &str = "brain.Event:2";

/// The event files of some seeds. Times are not recorded: all events bear that of the run's start.
pub fn tensorboard(seeds: &[&SeedRun], started: SystemTime) -> Vec<File> {
    let time = started.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
    let mut files = Vec::new();
    for seed in seeds {
        let mut legs: Vec<Arm> = seed.evaluations.iter().map(|point| point.arm).collect();
        legs.dedup();
        for leg in legs {
            let path = format!("seed-{}/{}/{NAME}", seed.seed, leg.name());
            files.push(File::new(path, events(&points(seed, leg), time)));
        }
    }
    files
}

/// Values that belong to one step, with their tags: what stands before the slash makes the group.
type Point = (u32, Vec<(&'static str, f64)>);

/// Everything that is shown of a leg, by step.
fn points(seed: &SeedRun, leg: Arm) -> Vec<Point> {
    let mut points: Vec<Point> = Vec::new();
    let checks: Vec<_> = seed.checks.iter().filter(|check| check.arm == leg).collect();
    // Both lists are in the order of steps, so each check is counted once.
    let (mut open, mut so_far, mut refused) = (checks.iter().peekable(), 0u32, 0u32);
    for point in seed.evaluations.iter().filter(|point| point.arm == leg) {
        while let Some(check) = open.next_if(|check| check.step <= point.step) {
            so_far += 1;
            refused += u32::from(check.verdict == Verdict::Refuse);
        }
        let values = [
            ("evaluation/return", point.observed_return),
            ("evaluation/performance", point.performance),
            ("evaluation/length", point.length),
            ("check/checks", f64::from(so_far)),
            ("check/refusals", f64::from(refused)),
        ];
        points.push((point.step, values.into()));
    }
    for state in seed.learner.iter().filter(|state| state.arm == leg) {
        let values = [
            ("learner/epsilon", f64::from(state.epsilon)),
            ("learner/value_loss", state.value_loss),
            ("learner/reward_loss", state.reward_loss),
            ("learner/dead_units", state.dead_units),
            ("learner/replay", f64::from(state.replay)),
        ];
        points.push((state.step, values.into()));
    }
    for episode in seed.episodes.iter().filter(|episode| episode.arm == leg) {
        let values = [("episode/return", episode.observed_return), ("episode/performance", episode.performance)];
        points.push((episode.step, values.into()));
    }
    let margins = checks.iter().filter_map(|check| Some((check.step, vec![("check/margin", check.margin?)])));
    points.extend(margins);
    points.sort_by_key(|(step, _)| *step);
    points
}

/// A whole event file.
fn events(points: &[Point], time: f64) -> Vec<u8> {
    let mut file = Vec::new();
    let event = || Message::default().double(1, time);
    record(&mut file, &event().bytes(3, VERSION.as_bytes()));
    for (step, values) in points {
        let value = |(tag, value): &(&str, f64)| Message::default().bytes(1, tag.as_bytes()).float(2, *value as f32);
        let summary = values.iter().fold(Message::default(), |summary, entry| summary.bytes(1, &value(entry).0));
        record(&mut file, &event().integer(2, u64::from(*step)).bytes(5, &summary.0));
    }
    file
}

fn record(file: &mut Vec<u8>, Message(data): &Message) {
    let length = (data.len() as u64).to_le_bytes();
    for part in [&length[..], data] {
        file.extend_from_slice(part);
        file.extend_from_slice(&masked_checksum(part).to_le_bytes());
    }
}

fn masked_checksum(data: &[u8]) -> u32 {
    static CASTAGNOLI: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);
    CASTAGNOLI.checksum(data).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// A protocol-buffers message under construction: each field is a key (number and kind) and a value.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    /// Seven bits per byte, the lowest first; the top bit says that more follow.
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn field(mut self, number: u64, kind: u64, fixed: &[u8]) -> Self {
        self.varint(number << 3 | kind);
        self.0.extend_from_slice(fixed);
        self
    }

    fn integer(self, number: u64, value: u64) -> Self {
        let mut message = self.field(number, 0, &[]);
        message.varint(value);
        message
    }

    fn double(self, number: u64, value: f64) -> Self {
        self.field(number, 1, &value.to_le_bytes())
    }

    /// Text, or a message in the message.
    fn bytes(self, number: u64, value: &[u8]) -> Self {
        let mut message = self.field(number, 2, &[]);
        message.varint(value.len() as u64);
        message.0.extend_from_slice(value);
        message
    }

    fn float(self, number: u64, value: f32) -> Self {
        self.field(number, 5, &value.to_le_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::samples;

    #[test]
    fn every_point_has_the_checks_up_to_its_step() {
        let mut seed = samples::seed(0, samples::Outcome::Missed);
        // Two at one step, one at the step of a point, the last behind all points.
        let steps = [5, 5, 20, 21, 400, 401, 402, 403, 404, 405, 1000, 1001];
        seed.checks.iter_mut().zip(steps).for_each(|(check, step)| check.step = step);
        let counted = |tag: &str, leg: Arm| {
            let points = points(&seed, leg);
            let of = |(step, values): &Point| Some((*step, values.iter().find(|value| value.0 == tag)?.1));
            points.iter().filter_map(of).collect::<Vec<_>>()
        };
        for (step, count) in counted("check/checks", Arm::Mc) {
            assert_eq!(count, steps.iter().filter(|at| **at <= step).count() as f64, "{step}");
        }
        let refused = counted("check/refusals", Arm::Mc);
        assert_eq!((refused[0], refused[1], refused[50]), ((0, 0.0), (20, 3.0), (1000, 9.0)));
        assert!(counted("check/checks", Arm::Baseline).iter().all(|(_, count)| *count == 0.0));
    }

    #[test]
    fn messages_have_the_published_encoding() {
        // The examples of the format's description: 150 as field 1, "testing" as field 2.
        assert_eq!(Message::default().integer(1, 150).0, [0x08, 0x96, 0x01]);
        assert_eq!(Message::default().bytes(2, b"testing").0, b"\x12\x07testing");
        assert_eq!(Message::default().float(2, 1.0).0, [0x15, 0, 0, 0x80, 0x3f]);
        assert_eq!(Message::default().double(1, 1.0).0, [0x09, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f]);
    }

    #[test]
    fn checksums_are_castagnoli_and_masked() {
        // The check value of CRC-32C, masked by hand: 0xe3069283 rotated right by 15 is 0x2507c60d.
        assert_eq!(masked_checksum(b"123456789"), 0x2507_c60du32.wrapping_add(0xa282_ead8));
    }
}
