// What a device makes of a product that goes into a sum, of a quotient and of a root (twin:
// native/src/gpu/enabled/arithmetic.rs, which compares).

@group(0) @binding(0) var<storage, read> operands: array<vec4<f32>>;
/// Per operand: x·y + z, x·y, z/w and √|z|.
@group(0) @binding(1) var<storage, read_write> found: array<vec4<f32>>;
/// Negative zero.
@group(0) @binding(2) var<uniform> zero: f32;

@compute @workgroup_size(64)
fn arithmetic(@builtin(global_invocation_id) id: vec3<u32>) {
    nothing = zero;
    if id.x >= arrayLength(&operands) {
        return;
    }
    let given = operands[id.x];
    let product = times(given.x, given.y);
    found[id.x] = vec4<f32>(product + given.z, product, quotient4(given.zzzz, given.wwww).x, root4(abs(given.zzzz)).x);
}
