// What a device makes of a product that goes into a sum, of a product, of a quotient and of a root (twin:
// native/src/gpu/enabled/arithmetic.rs, which compares).

@group(0) @binding(0) var<storage, read> operands: array<vec4<f32>>;
/// Per operand: x·y + z, y·w, z/w and √|z|. No product is used twice: compilers fuse those that are used once.
@group(0) @binding(1) var<storage, read_write> found: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> zero: f32;

@compute @workgroup_size(64)
fn arithmetic(@builtin(global_invocation_id) id: vec3<u32>) {
    negative_zero = zero;
    if id.x >= arrayLength(&operands) {
        return;
    }
    let given = operands[id.x];
    var sum = given.z;
    sum += times(given.x, given.y);
    let quotient = quotient4(given.zzzz, given.wwww).x;
    found[id.x] = vec4<f32>(sum, times(given.y, given.w), quotient, root4(abs(given.zzzz)).x);
}
