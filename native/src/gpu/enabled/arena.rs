//! A buffer of which parts are taken and given back.

use std::ops::Range;

use wgpu::Buffer;

use super::super::GpuError;
use super::device::Device;

/// Numbers of four bytes in one buffer, taken in ranges.
#[derive(Debug)]
pub struct Arena {
    label: &'static str,
    buffer: Buffer,
    size: u32,
    /// What is free: ranges in order, no two of which touch.
    free: Vec<Range<u32>>,
}

impl Arena {
    /// One of so many numbers.
    pub fn new(device: &Device, label: &'static str, size: u32) -> Self {
        let buffer = device.buffer(label, 4 * u64::from(size), &[]);
        Self { label, buffer, size, free: std::iter::once(0..size).collect() }
    }

    /// The buffer.
    pub fn buffer(&self) -> &Buffer {
        &self.buffer
    }

    /// Takes so many numbers; `None` if no free range has them.
    pub fn take(&mut self, count: u32) -> Option<Range<u32>> {
        let index = self.free.iter().position(|range| range.end - range.start >= count)?;
        let range = &mut self.free[index];
        let taken = range.start..range.start + count;
        range.start = taken.end;
        if range.start == range.end {
            self.free.remove(index);
        }
        Some(taken)
    }

    /// Gives a range back.
    pub fn give(&mut self, range: Range<u32>) {
        if range.start == range.end {
            return;
        }
        let index = self.free.partition_point(|free| free.start < range.start);
        self.free.insert(index, range);
        self.free.dedup_by(|next, before| {
            let touch = before.end == next.start;
            if touch {
                before.end = next.end;
            }
            touch
        });
    }

    /// Becomes so large that `count` more numbers have a place, of at most `most` numbers; what lies there stays where it is.
    /// False, with nothing changed, if that is too small.
    ///
    /// # Errors
    /// If the device fails.
    pub fn grow(&mut self, device: &Device, count: u32, most: u32) -> Result<bool, GpuError> {
        // What is free at the end counts, so that an empty one takes whatever fits in all.
        let used = self.free.last().filter(|last| last.end == self.size).map_or(self.size, |last| last.start);
        let Some(needed) = used.checked_add(count).filter(|needed| *needed <= most) else { return Ok(false) };
        let size = needed.max(self.size.saturating_mul(2)).min(most);
        let buffer = device.buffer(self.label, 4 * u64::from(size), &[]);
        let mut commands = device.commands(self.label);
        commands.copy_buffer_to_buffer(&self.buffer, 0, &buffer, 0, 4 * u64::from(self.size));
        device.run(commands)?;
        self.buffer = buffer;
        let more = self.size..size;
        self.size = size;
        self.give(more);
        Ok(true)
    }
}
