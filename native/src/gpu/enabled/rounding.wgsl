// Arithmetic that rounds as a processor does (the operators of Rust), where the compiler of a device would fuse a
// product with the sum it goes into, and where its quotients and roots are only near. What a device needs is found
// out when it is opened (arithmetic.rs). Stands in front of the kernels that use it.

/// Products are kept from being fused.
override GUARDED: bool = false;
/// Quotients and roots are rounded to the nearest number from an approximation; needs a true `fma`.
override CORRECTED: bool = false;

/// -0, of which a compiler knows nothing: a product plus it, rounded once, is the rounded product.
var<private> negative_zero: f32;

fn times(a: f32, b: f32) -> f32 {
    if GUARDED {
        return fma(a, b, negative_zero);
    }
    return a * b;
}

fn times4(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    if GUARDED {
        return fma(a, b, vec4<f32>(negative_zero));
    }
    return a * b;
}

/// Powers of two that keep remainders away from where numbers lose digits: 2³², 2⁻³², 2⁶⁰ and 2⁻³⁰.
const QUOTIENT_UP = 4294967296.0;
const QUOTIENT_DOWN = 2.3283064365386963e-10;
const ROOT_UP = 1152921504606846976.0;
const ROOT_DOWN = 9.313225746154785e-10;

/// The next number towards zero, and the next one away from it.
fn below(x: vec4<f32>) -> vec4<f32> {
    return bitcast<vec4<f32>>(bitcast<vec4<u32>>(x) - vec4<u32>(1u));
}

fn above(x: vec4<f32>) -> vec4<f32> {
    return bitcast<vec4<f32>>(bitcast<vec4<u32>>(x) + vec4<u32>(1u));
}

/// `a / b` for positive `b`. Corrected: a step of Newton's, and of the three numbers there the one with the smallest
/// remainder, which `fma` gives exactly. Right where the device's `1 / b` is off by up to three units in the last
/// place, |a| ≥ 1e-33, |a / b| ≥ 1.2e-38, and 2³² |a / b| is a number.
fn quotient4(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    if CORRECTED {
        let up = a * QUOTIENT_UP;
        let inverse = 1.0 / b;
        let guess = up * inverse;
        let near = fma(fma(-b, guess, up), inverse, guess);
        let left = abs(fma(-b, near, up));
        let nearer = select(near, below(near), abs(fma(-b, below(near), up)) < left);
        let nearest = select(nearer, above(near), abs(fma(-b, above(near), up)) < left);
        return select(nearest * QUOTIENT_DOWN, a, a == vec4<f32>(0.0));
    }
    return a / b;
}

/// The root of `x ≥ 0`. Corrected: a step of Newton's, and the number between whose products with its neighbours `x`
/// lies (Tuckerman's test). Right where the device's `inverseSqrt` is off by up to four units in the last place, and
/// 1e-36 ≤ x ≤ 1e20 or x = 0.
fn root4(x: vec4<f32>) -> vec4<f32> {
    if CORRECTED {
        let up = x * ROOT_UP;
        let inverse = inverseSqrt(up);
        let guess = up * inverse;
        let near = fma(fma(-guess, guess, up), 0.5 * inverse, guess);
        let lower = select(near, below(near), fma(-near, below(near), up) <= vec4<f32>(0.0));
        let nearest = select(lower, above(near), fma(-near, above(near), up) > vec4<f32>(0.0));
        return select(nearest * ROOT_DOWN, x, x == vec4<f32>(0.0));
    }
    return sqrt(x);
}
