//! Whether a device computes as the processor does, and what that takes (`rounding.wgsl`).

use mcvl_core::rng::Rng;
use wgpu::PipelineCompilationOptions;

use super::super::GpuError;
use super::device::Device;

/// What stands in front of kernels that compute as the processor does.
macro_rules! exactly {
    ($kernel:literal) => {
        concat!(include_str!("rounding.wgsl"), "\n", include_str!($kernel))
    };
}

pub(super) use exactly;

/// The kernel that tries.
pub const SOURCE: &str = exactly!("arithmetic.wgsl");
/// Numbers that are tried.
const TRIALS: usize = 1 << 14;
/// `workgroup_size` of the kernel.
const THREADS: usize = 64;

/// How kernels compute on a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Arithmetic {
    /// Products are kept from being fused with the sum that they go into.
    pub guarded: bool,
    /// Quotients and roots are corrected.
    pub corrected: bool,
    /// All trials gave the bits of the processor, on an interface whose compilers do not change the order of sums: Vulkan's.
    /// Metal's and DirectX's may, where nothing forbids it to them, and no whole job was compared there yet.
    pub exact: bool,
}

impl Arithmetic {
    /// What a kernel is built with.
    pub fn options(self) -> [(&'static str, f64); 2] {
        [("GUARDED", f64::from(u8::from(self.guarded))), ("CORRECTED", f64::from(u8::from(self.corrected)))]
    }

    /// What gives the bits of the processor on this device, of the little that is needed; where nothing does, the plain
    /// operators. Products are left unguarded in software alone: what a card's compiler fuses in one kernel, it need not
    /// in another.
    ///
    /// # Errors
    /// If the device fails.
    pub fn find(device: &Device) -> Result<Self, GpuError> {
        let trials = trials();
        for (guarded, corrected) in [(false, false), (true, false), (true, true)] {
            let found = Self { guarded, corrected, exact: true };
            if (guarded || device.info().software) && found.differing(device, &trials)? == [0; 4] {
                return Ok(Self { exact: device.is_vulkan(), ..found });
            }
        }
        Ok(Self::default())
    }

    /// Of how many trials each result is another than the processor's.
    ///
    /// # Errors
    /// If the device fails.
    pub fn differing(self, device: &Device, trials: &[[f32; 4]]) -> Result<[usize; 4], GpuError> {
        let options =
            PipelineCompilationOptions { constants: &self.options(), ..PipelineCompilationOptions::default() };
        let pipeline = device.pipeline("arithmetic", SOURCE, options);
        let bytes = size_of_val(trials) as u64;
        let given = device.buffer("operands", bytes, bytemuck::cast_slice(trials));
        let found = device.buffer("results", bytes, &[]);
        let zero = device.uniform("negative zero", 4);
        device.write(&zero, 0, bytemuck::bytes_of(&-0.0f32));
        let bindings = device.bind("arithmetic", &pipeline.get_bind_group_layout(0), &[&given, &found, &zero]);
        let mut commands = device.commands("arithmetic");
        let mut pass = commands
            .begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("arithmetic"), timestamp_writes: None });
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(trials.len().div_ceil(THREADS) as u32, 1, 1);
        drop(pass);
        device.run(commands)?;
        let found: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&device.read(&found, &[(0, bytes)])?);
        let mut differing = [0; 4];
        for (&[x, y, z, w], found) in trials.iter().zip(&found) {
            let product = x * y;
            let own = [z + product, y * w, z / w, z.abs().sqrt()];
            for (count, (own, found)) in differing.iter_mut().zip(own.iter().zip(found)) {
                *count += usize::from(own.to_bits() != found.to_bits());
            }
        }
        Ok(differing)
    }
}

/// Operands of the sizes that occur in training: factors whose product is near to what is added, numerators like
/// steps of the optimiser, radicands like second moments, denominators like their roots. Zeros are among them, and the
/// hardest of roots and quotients; numbers below the normal ones, which a device may take for zero, are not.
pub fn trials() -> Vec<[f32; 4]> {
    let mut rng = Rng::new(1);
    let mut number = |low: i32, high: i32| {
        let size = low as f32 + (high - low) as f32 * rng.uniform();
        let sign = if rng.below(2) == 0 { -1.0 } else { 1.0 };
        if rng.below(64) == 0 { 0.0 * sign } else { sign * (1.0 + rng.uniform()) * size.exp2() }
    };
    let mut trials = Vec::with_capacity(TRIALS);
    for trial in 0..TRIALS {
        let (x, y) = (number(-20, 4), number(-20, 4));
        // Every other time a number like a step of the optimiser.
        let mut z = if trial % 2 == 0 { -(x * y) * (1.0 + number(-24, -1)) } else { number(-109, 60) };
        let mut w = number(-29, 8).abs().max(1e-9);
        if trial % 16 == 0 {
            // Mantissas of ones: their roots and quotients lie next to the middle between two numbers.
            z = f32::from_bits(z.to_bits() | 0x7f_ffff);
            w = f32::from_bits(w.to_bits() | 0x7f_ffff);
        }
        trials.push([x, y, z, w]);
    }
    trials
}
