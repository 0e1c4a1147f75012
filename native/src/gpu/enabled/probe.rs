//! What a device can do at most: multiply-adds, and bytes moved within its memory.

use std::time::{Duration, Instant};

use super::super::{GpuError, Peak};
use super::device::Device;

/// The kernel.
pub const SOURCE: &str = include_str!("probe.wgsl");
/// `THREADS` of the kernel.
pub const THREADS: u32 = 128;
/// Multiply-adds of one invocation in one round.
const LANES: u64 = 32;
/// Rounds of one dispatch: below the turns of loops that software devices make.
const ROUNDS: u32 = 16_384;
/// Bytes that are copied at once.
const COPY: u64 = 64 << 20;

/// Measures the device whose name contains `adapter`, for about twice this time.
///
/// # Errors
/// If there is no such device, or it fails.
pub fn peak(adapter: Option<&str>, time: Duration) -> Result<Peak, GpuError> {
    let device = Device::open(adapter)?;
    let pipeline = device.pipeline("probe", SOURCE, wgpu::PipelineCompilationOptions::default());
    let rounds = device.uniform("probe rounds", 4);
    device.write(&rounds, 0, bytemuck::bytes_of(&ROUNDS));
    let multiply_adds = fastest(time, |groups| {
        let sums = device.buffer("probe sums", 4 * u64::from(groups * THREADS), &[]);
        let bindings = device.bind("probe", &pipeline.get_bind_group_layout(0), &[&sums, &rounds]);
        let mut commands = device.commands("probe");
        let mut pass =
            commands.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("probe"), timestamp_writes: None });
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(groups, 1, 1);
        drop(pass);
        device.run(commands)?;
        Ok(u64::from(groups) * u64::from(THREADS) * u64::from(ROUNDS) * LANES)
    })?;
    let bytes = COPY.min(device.largest_buffer() / 2);
    let [from, to] = ["copy from", "copy to"].map(|label| device.buffer(label, bytes, &[]));
    let bytes_moved = fastest(time, |copies| {
        let mut commands = device.commands("copy");
        (0..copies).for_each(|_| commands.copy_buffer_to_buffer(&from, 0, &to, 0, bytes));
        device.run(commands)?;
        Ok(2 * bytes * u64::from(copies))
    })?;
    Ok(Peak { multiply_adds, bytes_moved })
}

/// The best rate of a piece of work whose size doubles until it takes long enough to be timed.
fn fastest(time: Duration, mut work: impl FnMut(u32) -> Result<u64, GpuError>) -> Result<f64, GpuError> {
    let begun = Instant::now();
    let (mut size, mut best) = (1, 0.0f64);
    loop {
        let start = Instant::now();
        let done = work(size)? as f64;
        let taken = start.elapsed();
        best = best.max(done / taken.as_secs_f64());
        if begun.elapsed() >= time {
            return Ok(best);
        }
        if taken < time / 8 {
            size = (size * 2).min(1 << 15);
        }
    }
}
