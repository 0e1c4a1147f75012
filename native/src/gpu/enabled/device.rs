//! One device: how it is opened, what is allocated there, and how it fails.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use bytemuck::Pod;
use wgpu::{
    Adapter, Backends, BindGroupLayout, Buffer, BufferUsages, CommandEncoder, CommandEncoderDescriptor,
    ComputePipeline, DeviceType, Instance, InstanceDescriptor, Limits, MapMode, PipelineCompilationOptions, PollError,
    PollType, Queue, ShaderSource,
};

use super::super::{AdapterInfo, GpuError};
use super::arithmetic::Arithmetic;
use super::tight;

/// A slice of work takes a fraction of a second; a device that needs this long does not answer.
const PATIENCE: Duration = Duration::from_secs(60);

/// Turns of all loops together after which software devices end every loop of an invocation, whatever its condition
/// (Mesa's llvmpipe, `LP_MAX_TGSI_LOOP_ITERATIONS`): what comes out then is wrong without a word.
const SOFTWARE_LOOPS: u32 = 65_535;

/// Kernels as SPIR-V of our own, see [`tight`].
const PASSTHROUGH: wgpu::Features = wgpu::Features::PASSTHROUGH_SHADERS;

/// Distance of the records that dispatches choose from: what every device takes.
pub const DYNAMIC_STEP: u32 = 256;

/// What kernels do with a buffer.
#[derive(Clone, Copy, Debug)]
pub enum Binding {
    /// They read it.
    Read,
    /// They read and write it.
    Write,
    /// They read the record that each dispatch chooses, see [`Device::records`].
    Record,
}

/// An open device.
#[derive(Debug)]
pub struct Device {
    info: AdapterInfo,
    arithmetic: Arithmetic,
    /// Invocations that a workgroup should have at most.
    workgroup: u32,
    /// Bytes that one buffer can have.
    largest: u64,
    /// Whether kernels go through Vulkan.
    vulkan: bool,
    /// Whether kernels can be SPIR-V of our own, see [`tight`].
    tight: bool,
    device: wgpu::Device,
    queue: Queue,
    /// What the device complained about since it was asked last.
    complaint: Arc<Mutex<Option<GpuError>>>,
}

fn all() -> Vec<Adapter> {
    // Never dropped: a driver that is unloaded takes along what a thread that used it still calls when it ends
    // (seen with NVIDIA's).
    static INSTANCE: OnceLock<Instance> = OnceLock::new();
    let instance = INSTANCE.get_or_init(|| Instance::new(InstanceDescriptor::new_without_display_handle()));
    pollster::block_on(instance.enumerate_adapters(Backends::all()))
}

fn about(adapter: &Adapter) -> AdapterInfo {
    let info = adapter.get_info();
    let driver = [info.driver.as_str(), info.driver_info.as_str()].join(" ");
    AdapterInfo {
        name: info.name,
        driver: format!("{:?}, {}", info.backend, driver.trim()),
        software: info.device_type == DeviceType::Cpu,
    }
}

/// The adapters of this machine, the most powerful kind first.
///
/// # Errors
/// None in this build.
pub fn adapters() -> Result<Vec<AdapterInfo>, GpuError> {
    Ok(sorted().iter().map(about).collect())
}

fn sorted() -> Vec<Adapter> {
    let mut adapters = all();
    adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
        DeviceType::DiscreteGpu => 0,
        DeviceType::VirtualGpu => 1,
        DeviceType::IntegratedGpu => 2,
        DeviceType::Other => 3,
        DeviceType::Cpu => 4,
    });
    adapters
}

impl Device {
    /// Opens the adapter whose name contains `wanted` in any case, or the most powerful one.
    pub fn open(wanted: Option<&str>) -> Result<Self, GpuError> {
        let adapters = sorted();
        let fits = |adapter: &&Adapter| {
            wanted.is_none_or(|part| about(adapter).to_string().to_lowercase().contains(&part.to_lowercase()))
        };
        let adapter = adapters.iter().find(fits).ok_or_else(|| GpuError::NoAdapter {
            wanted: wanted.map(str::to_owned),
            found: adapters.iter().map(|adapter| about(adapter).to_string()).collect(),
        })?;
        // What the kernels need is little; the sizes of buffers are the adapter's own.
        let (offered, least) = (adapter.limits(), Limits::downlevel_defaults());
        let limits = Limits {
            max_buffer_size: offered.max_buffer_size,
            max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size,
            max_compute_invocations_per_workgroup: offered.max_compute_invocations_per_workgroup,
            max_compute_workgroup_size_x: offered.max_compute_workgroup_size_x,
            max_storage_buffers_per_shader_stage: offered.max_storage_buffers_per_shader_stage,
            ..least.or_worse_values_from(&offered)
        };
        // SPIR-V is Vulkan's.
        let vulkan = adapter.get_info().backend == wgpu::Backend::Vulkan;
        let tight = vulkan && adapter.features().contains(PASSTHROUGH);
        let required_features = if tight { PASSTHROUGH } else { wgpu::Features::empty() };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("mcvl"),
            required_features,
            required_limits: limits,
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| GpuError::NoDevice(error.to_string()))?;
        let complaint = Arc::new(Mutex::new(None));
        let note = |complaint: &Mutex<Option<GpuError>>, error| {
            // The first one is the cause.
            complaint.lock().expect("nobody panics while noting").get_or_insert(error);
        };
        let noted = complaint.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let text = error.to_string();
            note(
                &noted,
                match error {
                    wgpu::Error::OutOfMemory { .. } => GpuError::Memory(text),
                    _ => GpuError::Lost(text),
                },
            );
        }));
        let noted = complaint.clone();
        device.set_device_lost_callback(move |reason, text| {
            note(&noted, GpuError::Lost(format!("{text} ({reason:?})")));
        });
        let info = about(adapter);
        // Software takes up one invocation after the other, and at each barrier all of them again.
        let limits = device.limits();
        let most = limits.max_compute_invocations_per_workgroup.min(limits.max_compute_workgroup_size_x);
        let workgroup = if info.software { 0 } else { most };
        let largest = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size);
        let plain = Self {
            info,
            arithmetic: Arithmetic::default(),
            workgroup,
            largest,
            vulkan,
            tight,
            device,
            queue,
            complaint,
        };
        let arithmetic = Arithmetic::find(&plain)?;
        Ok(Self { arithmetic, ..plain })
    }

    /// Whether kernels go through Vulkan.
    pub fn is_vulkan(&self) -> bool {
        self.vulkan
    }

    /// How kernels compute here.
    pub fn arithmetic(&self) -> Arithmetic {
        self.arithmetic
    }

    /// Invocations that a workgroup should have at most; kernels with fewer take their least.
    pub fn workgroup(&self) -> u32 {
        self.workgroup
    }

    /// The same device with kernels as cards have them: large workgroups, and products kept from being fused.
    #[cfg(test)]
    pub fn like_a_card(self) -> Self {
        let arithmetic = Arithmetic { guarded: true, ..self.arithmetic };
        Self { workgroup: u32::MAX, arithmetic, ..self }
    }

    /// The adapter.
    pub fn info(&self) -> &AdapterInfo {
        &self.info
    }

    /// Turns of loops that one invocation may make, where there is a limit.
    pub fn loop_limit(&self) -> Option<u32> {
        self.info.software.then_some(SOFTWARE_LOOPS)
    }

    /// Bytes that one buffer can have.
    pub fn largest_buffer(&self) -> u64 {
        self.largest
    }

    /// The same device with kernels as wgpu writes them.
    #[cfg(test)]
    pub fn loose(self) -> Self {
        Self { tight: false, ..self }
    }

    /// The same device with less memory.
    #[cfg(test)]
    pub fn with_buffers_of(self, largest: u64) -> Self {
        Self { largest, ..self }
    }

    /// A pipeline of one kernel; its bindings are those that the kernel declares.
    pub fn pipeline(&self, name: &str, source: &str, options: PipelineCompilationOptions<'_>) -> ComputePipeline {
        let source = ShaderSource::Wgsl(source.into());
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(name), source });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(name),
            layout: None,
            module: &module,
            entry_point: Some(name),
            compilation_options: options,
            cache: None,
        })
    }

    /// A pipeline of a kernel in which a workgroup shares its part of the buffers with nobody; its overrides are
    /// `constants`.
    pub fn tight_pipeline(
        &self,
        name: &str,
        source: &str,
        constants: &[(&str, f64)],
        layout: &BindGroupLayout,
    ) -> ComputePipeline {
        // What naga does not write here, wgpu may, or it says why.
        let words = if self.tight { tight::spirv(source, name, constants).ok() } else { None };
        let (module, constants) = match &words {
            // SAFETY: the words are those of naga for a valid kernel, but for the scope of barriers, which is enough
            // where no workgroup reads what another one writes. Its loops end, and its indices stay within the buffers
            // and the workgroup's arrays: the one kernel that comes here, ddqn.wgsl, has them from the sizes and offsets
            // that ddqn.rs and pool.rs make of the buffers themselves, for settings that `ddqn::supports` let pass.
            Some(words) => {
                (unsafe { self.device.create_shader_module_passthrough(tight::module(name, words)) }, &[][..])
            }
            None => {
                let source = ShaderSource::Wgsl(source.into());
                let descriptor = wgpu::ShaderModuleDescriptor { label: Some(name), source };
                (self.device.create_shader_module(descriptor), constants)
            }
        };
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(name),
            bind_group_layouts: &[Some(layout)],
            immediate_size: 0,
        });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(name),
            layout: Some(&layout),
            module: &module,
            entry_point: Some(name),
            compilation_options: PipelineCompilationOptions { constants, ..PipelineCompilationOptions::default() },
            cache: None,
        })
    }

    /// Pipelines of the entry points of one module, which have their bindings in common.
    pub fn pipelines<const N: usize>(
        &self,
        label: &str,
        source: &str,
        entries: [&str; N],
        layouts: &[&BindGroupLayout],
    ) -> [ComputePipeline; N] {
        let source = ShaderSource::Wgsl(source.into());
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label), source });
        let layouts: Vec<_> = layouts.iter().copied().map(Some).collect();
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(label),
            bind_group_layouts: &layouts,
            immediate_size: 0,
        });
        entries.map(|name| {
            self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(name),
                layout: Some(&layout),
                module: &module,
                entry_point: Some(name),
                compilation_options: PipelineCompilationOptions::default(),
                cache: None,
            })
        })
    }

    /// Bindings 0, 1, and so on of a group.
    pub fn layout(&self, label: &str, bindings: &[Binding]) -> BindGroupLayout {
        let kind = |binding| match binding {
            Binding::Read => (wgpu::BufferBindingType::Storage { read_only: true }, false),
            Binding::Write => (wgpu::BufferBindingType::Storage { read_only: false }, false),
            Binding::Record => (wgpu::BufferBindingType::Uniform, true),
        };
        let entries: Vec<_> = (0..)
            .zip(bindings)
            .map(|(number, &binding)| {
                let (ty, has_dynamic_offset) = kind(binding);
                wgpu::BindGroupLayoutEntry {
                    binding: number,
                    visibility: wgpu::ShaderStages::COMPUTE,
                    ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None },
                    count: None,
                }
            })
            .collect();
        self.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
    }

    /// A buffer of records of which each dispatch chooses one; they lie [`DYNAMIC_STEP`] bytes apart.
    pub fn records<T: Pod>(&self, label: &str, records: impl IntoIterator<Item = T>) -> Buffer {
        let mut bytes = Vec::new();
        for record in records {
            bytes.extend_from_slice(bytemuck::bytes_of(&record));
            bytes.resize(bytes.len().next_multiple_of(DYNAMIC_STEP as usize), 0);
        }
        let buffer = self.uniform(label, bytes.len() as u64);
        self.write(&buffer, 0, &bytes);
        buffer
    }

    /// Buffers of records as bindings 0, 1, and so on.
    pub fn bind_records(&self, label: &str, layout: &BindGroupLayout, buffers: &[&Buffer]) -> wgpu::BindGroup {
        let size = wgpu::BufferSize::new(u64::from(DYNAMIC_STEP));
        let entries: Vec<_> = (0..)
            .zip(buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry {
                binding,
                resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset: 0, size }),
            })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
    }

    /// A buffer of zeros with these numbers at its beginning.
    pub fn buffer(&self, label: &str, bytes: u64, content: &[u8]) -> Buffer {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        let size = bytes.max(content.len() as u64).next_multiple_of(4).max(4);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        });
        self.write(&buffer, 0, content);
        buffer
    }

    /// A buffer for the few numbers that change from dispatch to dispatch.
    pub fn uniform(&self, label: &str, bytes: u64) -> Buffer {
        let usage = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes,
            usage,
            mapped_at_creation: false,
        })
    }

    /// Writes bytes into a buffer, before whatever is submitted next.
    pub fn write(&self, buffer: &Buffer, offset: u64, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.queue.write_buffer(buffer, offset, bytes);
        }
    }

    /// Buffers as bindings 0, 1, and so on.
    pub fn bind(&self, label: &str, layout: &BindGroupLayout, buffers: &[&Buffer]) -> wgpu::BindGroup {
        let entries: Vec<_> = (0..)
            .zip(buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
    }

    /// An empty list of commands.
    pub fn commands(&self, label: &str) -> CommandEncoder {
        self.device.create_command_encoder(&CommandEncoderDescriptor { label: Some(label) })
    }

    /// Submits commands and waits until they are done.
    ///
    /// # Errors
    /// If the device complains, is lost or takes too long.
    pub fn run(&self, commands: CommandEncoder) -> Result<(), GpuError> {
        let submission = self.queue.submit([commands.finish()]);
        self.wait(Some(submission))
    }

    fn wait(&self, submission_index: Option<wgpu::SubmissionIndex>) -> Result<(), GpuError> {
        // A driver that says the device is lost ends in a panic within wgpu 30 (`Device::poll`), after the complaint.
        let poll = || self.device.poll(PollType::Wait { submission_index, timeout: Some(PATIENCE) });
        let result = catch_unwind(AssertUnwindSafe(poll));
        if let Some(complaint) = self.complaint.lock().expect("nobody panics while noting").take() {
            return Err(complaint);
        }
        match result {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(PollError::Timeout)) => Err(GpuError::Lost(format!("no answer for {} s", PATIENCE.as_secs()))),
            Ok(Err(error)) => Err(GpuError::Lost(error.to_string())),
            Err(_) => Err(GpuError::Lost("the driver gave it up, as printed above".to_owned())),
        }
    }

    /// Numbers of a buffer: ranges of it, in bytes, one after the other.
    ///
    /// # Errors
    /// See [`Device::run`].
    pub fn read(&self, buffer: &Buffer, ranges: &[(u64, u64)]) -> Result<Vec<u8>, GpuError> {
        let bytes: u64 = ranges.iter().map(|(_, len)| len).sum();
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let size = bytes;
        let copy = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size,
            usage,
            mapped_at_creation: false,
        });
        let mut commands = self.commands("read back");
        let mut at = 0;
        for &(from, len) in ranges {
            commands.copy_buffer_to_buffer(buffer, from, &copy, at, len);
            at += len;
        }
        self.run(commands)?;
        let mapped = Arc::new(Mutex::new(None));
        let answer = mapped.clone();
        copy.slice(..).map_async(MapMode::Read, move |result| {
            *answer.lock().expect("nobody panics while noting") = Some(result);
        });
        self.wait(None)?;
        let result = mapped.lock().expect("nobody panics while noting").take();
        match result {
            Some(Ok(())) => {}
            Some(Err(error)) => return Err(GpuError::Lost(error.to_string())),
            None => return Err(GpuError::Lost("a buffer cannot be read".to_owned())),
        }
        let view = copy.slice(..).get_mapped_range().map_err(|error| GpuError::Lost(error.to_string()))?;
        Ok(view.to_vec())
    }

    /// Ends the device's life, as a driver that resets does.
    #[cfg(test)]
    pub fn destroy(&self) {
        self.device.destroy();
    }
}
