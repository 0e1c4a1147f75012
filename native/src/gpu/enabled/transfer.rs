//! What jobs of every kind have in common on their way to the device and back.

use mcvl_core::agent::Agent;
use mcvl_core::forecast::ForecastJob;
use mcvl_core::replay::draw_slots;
use mcvl_core::rng::{Purpose, Rng};
use wgpu::Buffer;

use super::super::GpuError;
use super::device::Device;

/// A struct of four-byte numbers that a kernel reads.
macro_rules! record {
    ($(#[$about:meta])* $name:ident { $($field:ident: $kind:ty),* $(,)? }) => {
        $(#[$about])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
        pub struct $name {
            $($field: $kind),*
        }

        impl $name {
            /// Names and offsets of the fields.
            #[cfg(test)]
            pub fn layout() -> Vec<(String, u32)> {
                vec![$((stringify!($field).to_owned(), std::mem::offset_of!($name, $field) as u32)),*]
            }
        }
    };
}

pub(super) use record;

/// Slots of the drawn samples of jobs whose replay buffer, seed and version are one and the same, update by update.
pub fn draws<E, A: Agent>(jobs: &[ForecastJob<'_, E, A>]) -> Vec<u32> {
    let Some(first) = jobs.first() else { return Vec::new() };
    let updates = jobs.iter().map(ForecastJob::value_updates).max().unwrap_or(0);
    let mut draws = Vec::with_capacity(updates as usize * first.batch as usize);
    let (mut stream, mut drawn) = (Rng::stream(first.seed, Purpose::ForecastBatch, first.version), Vec::new());
    for _ in 0..updates {
        draw_slots(first.replay.len(), first.batch, &mut stream, &mut drawn);
        draws.extend_from_slice(&drawn);
    }
    draws
}

/// Parts of a buffer, one behind the other: together they are too large for a further copy here.
#[derive(Debug, Default)]
pub struct Parts<'a> {
    parts: Vec<&'a [u32]>,
    end: u32,
}

impl<'a> Parts<'a> {
    /// Where the part will begin.
    pub fn add(&mut self, part: &'a [u32]) -> u32 {
        self.parts.push(part);
        self.end += part.len() as u32;
        self.end - part.len() as u32
    }

    /// Brings them all to the device.
    pub fn bring(self, device: &Device, label: &str) -> Buffer {
        let buffer = device.buffer(label, 4 * u64::from(self.end), &[]);
        let mut at = 0;
        for part in self.parts {
            device.write(&buffer, at, bytemuck::must_cast_slice(part));
            at += 4 * part.len() as u64;
        }
        buffer
    }
}

/// What a job brings back: its numbers, or 1 + the first update whose loss was no finite number.
pub type Outcome = Result<Vec<f32>, u32>;

/// What some jobs bring back: each has a slot in `failures` (1 + the first update whose loss was no finite number, 0
/// without), and a place and so many numbers in `memory`.
///
/// # Errors
/// If the device fails.
pub fn outcomes(
    device: &Device,
    failures: &Buffer,
    memory: &Buffer,
    jobs: impl Iterator<Item = (u32, u32, u32)>,
) -> Result<Vec<Outcome>, GpuError> {
    let range = |at: u32, len: u32| (4 * u64::from(at), 4 * u64::from(len));
    let (states, ranges): (Vec<_>, Vec<_>) = jobs.map(|(slot, at, len)| (range(slot, 1), range(at, len))).unzip();
    let failures: Vec<u32> = bytemuck::pod_collect_to_vec(&device.read(failures, &states)?);
    let numbers: Vec<f32> = bytemuck::pod_collect_to_vec(&device.read(memory, &ranges)?);
    let mut rest = &numbers[..];
    let outcomes = failures.into_iter().zip(ranges).map(|(failure, (_, bytes))| {
        let (own, others) = rest.split_at(bytes as usize / 4);
        rest = others;
        if failure == 0 { Ok(own.to_vec()) } else { Err(failure) }
    });
    Ok(outcomes.collect())
}

/// What a batch of jobs brings back.
#[derive(Debug)]
pub struct Returns {
    memory: Buffer,
    /// Per job: 1 + the first update whose loss was no finite number, 0 without.
    failures: Buffer,
    /// Per job: where its numbers lie in `memory` and how many they are.
    places: Vec<(u32, u32)>,
}

impl Returns {
    /// The numbers at `places` of `memory`, unless `failures` says that there are none.
    pub fn new(memory: Buffer, failures: Buffer, places: Vec<(u32, u32)>) -> Self {
        Self { memory, failures, places }
    }

    /// Number of jobs.
    pub fn jobs(&self) -> u32 {
        self.places.len() as u32
    }

    /// The numbers of each job, or its failure.
    ///
    /// # Errors
    /// If the device fails.
    pub fn read(&self, device: &Device) -> Result<Vec<Outcome>, GpuError> {
        let jobs = (0..).zip(&self.places).map(|(slot, &(at, len))| (slot, at, len));
        outcomes(device, &self.failures, &self.memory, jobs)
    }
}
