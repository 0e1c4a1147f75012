//! DDQN learners that train side by side on a device: one dispatch trains all of them, each from where it stands. They
//! come and go between dispatches.

use std::ops::Range;
use std::sync::Arc;

use wgpu::{BindGroup, BindGroupLayout, Buffer, CommandEncoder, ComputePipeline};

use super::super::GpuError;
use super::arena::Arena;
use super::ddqn::{GROUPS, Job, LANES, Packed, SOURCE, Span};
use super::device::{Binding, Device};
use super::transfer::{Outcome, outcomes};

/// Learners at once at most. More wait: they fill any card.
pub const SLOTS: u32 = 4096;
/// Bytes of one of the two large buffers at most, where the device would take more.
pub const LARGEST: u64 = 2 << 30;
/// Numbers in each of them at first.
const BEGIN: u32 = 4 << 20;

/// Learners of one check on the device.
#[derive(Debug)]
pub struct Check {
    jobs: Vec<Arc<Packed>>,
    slots: Vec<u32>,
    memory: Range<u32>,
    data: Range<u32>,
}

/// The kernel with its buffers.
#[derive(Debug)]
pub struct Pool {
    pipeline: ComputePipeline,
    layout: BindGroupLayout,
    memory: Arena,
    data: Arena,
    jobs: Buffer,
    failures: Buffer,
    spans: Buffer,
    bindings: Option<BindGroup>,
    /// Free slots, the lowest last.
    free: Vec<u32>,
    /// What each slot does in the next dispatch.
    next: Vec<Span>,
}

impl Pool {
    /// Builds the kernel, with as many groups to a workgroup as the device should have.
    pub fn new(device: &Device) -> Self {
        let kinds = [Binding::Read, Binding::Read, Binding::Write, Binding::Write, Binding::Read];
        let layout = device.layout("ddqn", &kinds);
        let groups = (device.workgroup() / LANES).clamp(1, GROUPS);
        let [guarded, corrected] = device.arithmetic().options();
        let constants = [("THREADS", f64::from(groups * LANES)), guarded, corrected];
        let pipeline = device.tight_pipeline("ddqn", SOURCE, &constants, &layout);
        let most = most(device);
        let sized = |label, bytes: usize| device.buffer(label, u64::from(SLOTS) * bytes as u64, &[]);
        Self {
            pipeline,
            layout,
            memory: Arena::new(device, "ddqn memory", BEGIN.min(most)),
            data: Arena::new(device, "ddqn data", BEGIN.min(most)),
            jobs: sized("ddqn jobs", size_of::<Job>()),
            failures: sized("ddqn failures", size_of::<u32>()),
            spans: sized("ddqn spans", size_of::<Span>()),
            bindings: None,
            free: (0..SLOTS).rev().collect(),
            next: vec![Span::new(0, 0); SLOTS as usize],
        }
    }

    /// Brings the jobs of one check to the device; `None` as long as there is no room for them.
    ///
    /// # Errors
    /// If the device fails.
    pub fn admit(&mut self, device: &Device, jobs: &[Arc<Packed>]) -> Result<Option<Check>, GpuError> {
        let sum = |parts: &[&[u32]]| parts.iter().map(|part| part.len() as u32).sum::<u32>();
        let shared = jobs.first().map_or([&[][..]; 4], |job| job.shared());
        let needed = [
            jobs.iter().map(|job| job.size()).sum(),
            sum(&shared) + jobs.iter().map(|job| sum(&job.own())).sum::<u32>(),
        ];
        if self.free.len() < jobs.len() {
            return Ok(None);
        }
        let mut taken = [0..0, 0..0];
        for (index, count) in needed.into_iter().enumerate() {
            let arena = if index == 0 { &mut self.memory } else { &mut self.data };
            let mut range = arena.take(count);
            if range.is_none() && arena.grow(device, count, most(device))? {
                self.bindings = None;
                range = arena.take(count);
            }
            let Some(range) = range else {
                self.memory.give(taken[0].clone());
                return Ok(None);
            };
            taken[index] = range;
        }
        let [memory, data] = taken;
        let (mut place, mut at) = (memory.start, data.start);
        let mut bring = |part: &[u32]| {
            device.write(self.data.buffer(), 4 * u64::from(at), bytemuck::must_cast_slice(part));
            at += part.len() as u32;
            at - part.len() as u32
        };
        let shared = shared.map(&mut bring);
        let mut slots = Vec::new();
        for job in jobs {
            let slot = self.free.pop().expect("there are enough");
            slots.push(slot);
            let placed = job.placed(place, shared, job.own().map(&mut bring));
            let at = |bytes: usize| u64::from(slot) * bytes as u64;
            device.write(self.memory.buffer(), 4 * u64::from(place), bytemuck::must_cast_slice(job.numbers()));
            device.write(&self.jobs, at(size_of::<Job>()), bytemuck::bytes_of(&placed));
            device.write(&self.failures, at(size_of::<u32>()), &[0; 4]);
            place += job.size();
        }
        Ok(Some(Check { jobs: jobs.to_vec(), slots, memory, data }))
    }

    /// The next dispatch trains a check for the updates `first..first + count`.
    pub fn plan(&mut self, check: &Check, first: u32, count: u32) {
        check.slots.iter().for_each(|slot| self.next[*slot as usize] = Span::new(first, count));
    }

    /// Commands for everything that was planned.
    pub fn encode(&mut self, device: &Device, commands: &mut CommandEncoder) {
        let Some(last) = self.next.iter().rposition(|span| *span != Span::new(0, 0)) else { return };
        device.write(&self.spans, 0, bytemuck::must_cast_slice(&self.next[..=last]));
        self.next[..=last].fill(Span::new(0, 0));
        let bindings = self.bindings.get_or_insert_with(|| {
            let buffers = [&self.jobs, self.data.buffer(), self.memory.buffer(), &self.failures, &self.spans];
            device.bind("ddqn", &self.layout, &buffers)
        });
        let mut pass =
            commands.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("ddqn"), timestamp_writes: None });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &*bindings, &[]);
        pass.dispatch_workgroups(last as u32 + 1, 1, 1);
    }

    /// What the jobs of some checks bring back: parameters, target and moments; check by check, job by job.
    ///
    /// # Errors
    /// If the device fails.
    pub fn results(&self, device: &Device, checks: &[&Check]) -> Result<Vec<Outcome>, GpuError> {
        let jobs = checks.iter().flat_map(|check| {
            let mut place = check.memory.start;
            check.jobs.iter().zip(&check.slots).map(move |(job, slot)| {
                let at = place;
                place += job.size();
                (*slot, at, job.numbers().len() as u32)
            })
        });
        outcomes(device, &self.failures, self.memory.buffer(), jobs)
    }

    /// Whether there is nobody.
    pub fn is_empty(&self) -> bool {
        self.free.len() == SLOTS as usize
    }

    /// Makes room.
    pub fn release(&mut self, check: Check) {
        let Check { slots, memory, data, .. } = check;
        self.memory.give(memory);
        self.data.give(data);
        self.free.extend(slots);
        // The lowest first: a dispatch has as many workgroups as its last slot says.
        self.free.sort_unstable_by(|a, b| b.cmp(a));
    }
}

impl Check {
    /// Updates of its longest job.
    pub fn updates(&self) -> u32 {
        self.jobs.iter().map(|job| job.updates()).max().unwrap_or(0)
    }

    /// Updates that one dispatch may make, where the device has a limit on their loops.
    pub fn longest_slice(&self, limit: Option<u32>) -> u32 {
        let loops = || self.jobs.iter().map(|job| job.loops()).max().unwrap_or(1);
        limit.map_or(u32::MAX, |limit| (limit / loops()).max(1))
    }
}

/// Numbers of four bytes that one of the two large buffers has at most.
fn most(device: &Device) -> u32 {
    (device.largest_buffer().min(LARGEST) / 4) as u32
}
