//! SPIR-V of kernels in which a workgroup shares its part of the buffers with nobody.
//!
//! WGSL's `storageBarrier` orders memory within a workgroup, but naga's SPIR-V asks for the whole device: at each of
//! them a card then waits for its second cache and forgets its first one. Here the same barriers reach as far as WGSL
//! says. (In Metal they do so anyway; for DirectX naga writes the wide ones, and they stay.) Loops are not counted and
//! indices not bounded either.

use std::borrow::Cow;

use naga::ShaderStage;
use naga::back::{PipelineConstants, pipeline_constants, spv};
use naga::valid::{Capabilities, ValidationFlags, Validator};

/// Opcode of a barrier: operands are the scope of execution, the scope of memory, and what memory.
const CONTROL_BARRIER: u32 = 224;
/// Words before the first instruction.
const HEADER: usize = 5;

/// The compute kernel `entry` of a WGSL source with the given overrides, for descriptors numbered as in the source.
///
/// # Errors
/// What is wrong with the source.
pub fn spirv(source: &str, entry: &str, constants: &[(&str, f64)]) -> Result<Vec<u32>, String> {
    let module = naga::front::wgsl::parse_str(source).map_err(|error| error.emit_to_string(source))?;
    let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
    let info = validator.validate(&module).map_err(|error| error.emit_to_string(source))?;
    let constants: PipelineConstants = constants.iter().map(|&(name, value)| (name.to_owned(), value)).collect();
    let chosen = Some((ShaderStage::Compute, entry));
    let (module, info) = pipeline_constants::process_overrides(&module, &info, chosen, &constants)
        .map_err(|error| format!("{entry}: {error}"))?;
    let options = spv::Options {
        flags: spv::WriterFlags::empty(),
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        force_loop_bounding: false,
        emit_int_div_checks: false,
        ..spv::Options::default()
    };
    let pipeline = spv::PipelineOptions { shader_stage: ShaderStage::Compute, entry_point: entry.to_owned() };
    let mut words =
        spv::write_vec(&module, &info, &options, Some(&pipeline)).map_err(|error| format!("{entry}: {error}"))?;
    narrow(&mut words);
    Ok(words)
}

/// Gives every barrier the scope of its execution for its memory too.
fn narrow(words: &mut [u32]) {
    let mut at = HEADER;
    while let Some(&first) = words.get(at) {
        let (length, opcode) = ((first >> 16) as usize, first & 0xffff);
        if opcode == CONTROL_BARRIER {
            words[at + 2] = words[at + 1];
        }
        at += length.max(1);
    }
}

/// The same as what wgpu takes.
pub fn module<'a>(label: &'a str, words: &'a [u32]) -> wgpu::ShaderModuleDescriptorPassthrough<'a> {
    // The size of a workgroup stands in the module.
    let entry = wgpu::PassthroughShaderEntryPoint { name: Cow::Borrowed(label), workgroup_size: (0, 0, 0) };
    wgpu::ShaderModuleDescriptorPassthrough {
        label: Some(label),
        entry_points: Cow::Owned(vec![entry]),
        spirv: Some(Cow::Borrowed(words)),
        ..wgpu::ShaderModuleDescriptorPassthrough::default()
    }
}
