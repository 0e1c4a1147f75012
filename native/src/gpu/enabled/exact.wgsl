// Arithmetic that rounds as a processor does (twin: the operators of Rust), where the compiler of a device would fuse
// a product with the sum it goes into, and where its quotients and roots are only near. Which of it a device needs
// is found out when it is opened (arithmetic.rs). Stands in front of the kernels that use it.

/// Products are kept from being fused.
override GUARDED: bool = false;
/// Quotients and roots are rounded to the nearest number from an approximation; needs a true `fma`.
override CORRECTED: bool = false;

/// Negative zero, of which a compiler knows nothing: what a rounded product plus it is, is that product.
var<private> nothing: f32;

fn times(a: f32, b: f32) -> f32 {
    if GUARDED {
        return fma(a, b, nothing);
    }
    return a * b;
}

fn times4(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    if GUARDED {
        return fma(a, b, vec4<f32>(nothing));
    }
    return a * b;
}

/// Powers of two that keep remainders away from where numbers lose digits: 2³², 2⁻³², 2⁴⁰ and 2⁻²⁰.
const QUOTIENT_UP = 4294967296.0;
const QUOTIENT_DOWN = 2.3283064365386963e-10;
const ROOT_UP = 1099511627776.0;
const ROOT_DOWN = 9.5367431640625e-7;

/// `a / b` for positive `b`. Corrected: two steps towards the nearest number, with the remainder that `fma` gives
/// exactly (Markstein 1990); right for 1e-35 ≤ |a| ≤ 1e20 where the quotient is not below 1e-38.
fn quotient4(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    if CORRECTED {
        let near = 1.0 / b;
        let inverse = fma(fma(-b, near, vec4<f32>(1.0)), near, near);
        let up = a * QUOTIENT_UP;
        let first = up * inverse;
        let second = fma(fma(-b, first, up), inverse, first);
        let third = fma(fma(-b, second, up), inverse, second);
        return select(third * QUOTIENT_DOWN, a, a == vec4<f32>(0.0));
    }
    return a / b;
}

/// The root of `x ≥ 0`. Corrected: likewise; right for 1e-36 ≤ x ≤ 1e20, and for zero.
fn root4(x: vec4<f32>) -> vec4<f32> {
    if CORRECTED {
        let up = x * ROOT_UP;
        let near = inverseSqrt(up);
        let guess = up * near;
        let rough = 0.5 * near;
        let half = fma(fma(-guess, rough, vec4<f32>(0.5)), rough, rough);
        let first = fma(fma(-guess, guess, up), half, guess);
        let second = fma(fma(-first, first, up), half, first);
        return select(second * ROOT_DOWN, x, x == vec4<f32>(0.0));
    }
    return sqrt(x);
}
