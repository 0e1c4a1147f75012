// Independent chains of multiply-adds, nothing else (twin: `probe_body` in core/src/nn/gemm.rs): what a device can do at
// most. A compiler of the device may fuse them.

const THREADS = 128u;

struct Rounds {
    count: u32,
}

@group(0) @binding(0) var<storage, read_write> sums: array<f32>;
@group(0) @binding(1) var<uniform> rounds: Rounds;

@compute @workgroup_size(THREADS)
fn probe(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let at = group.x * THREADS + thread;
    var a = vec4<f32>(sums[at]);
    var b = a + 1.0;
    var c = a + 2.0;
    var d = a + 3.0;
    var e = a + 4.0;
    var f = a + 5.0;
    var g = a + 6.0;
    var h = a + 7.0;
    for (var round = 0u; round < rounds.count; round += 1u) {
        a = a * 0.999 + 0.001;
        b = b * 0.999 + 0.001;
        c = c * 0.999 + 0.001;
        d = d * 0.999 + 0.001;
        e = e * 0.999 + 0.001;
        f = f * 0.999 + 0.001;
        g = g * 0.999 + 0.001;
        h = h * 0.999 + 0.001;
    }
    let sum = a + b + c + d + e + f + g + h;
    sums[at] = sum.x + sum.y + sum.z + sum.w;
}
