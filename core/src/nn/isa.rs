//! The vector unit in use: chosen at run time, the same bits from each.
//!
//! Kernels are written once as plain loops over fixed-length arrays (`*_body`, always inlined). Here
//! they are compiled again for wider vector units of x86-64 and the widest that the machine has is
//! called. On other targets the compile target decides (NEON, wasm SIMD128 or scalar).
//!
//! # Why the unsafe code is sound
//! A function compiled for a vector unit may run only where that unit exists. An [`Isa`] above the
//! baseline can be made only by [`Isa::supported`], which asks the processor; every call below is
//! guarded by matching on such a value. The square-root intrinsics work on values, not on pointers.
#![allow(unsafe_code)]

use core::sync::atomic::{AtomicU8, Ordering};

use super::gemm::{self, Matrix, Output};
use super::optim::{self, Constants, State};

/// A vector unit that this machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isa(Level);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Level {
    Baseline,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

#[cfg(target_arch = "x86_64")]
cpufeatures::new!(avx2, "avx2");
#[cfg(target_arch = "x86_64")]
cpufeatures::new!(avx512, "avx512f", "avx512bw", "avx512dq", "avx512vl", "fma");

/// Position in `Isa::supported` plus one of a forced choice; 0 = the widest.
static FORCED: AtomicU8 = AtomicU8::new(0);

impl Isa {
    /// What every machine of the compile target has.
    pub const BASELINE: Isa = Isa(Level::Baseline);

    /// The vector units of this machine, the narrowest first.
    pub fn supported() -> impl Iterator<Item = Isa> {
        #[cfg(target_arch = "x86_64")]
        let wide = [
            avx2::get().then_some(Isa(Level::Avx2)),
            // The compiler takes AVX-512 to imply fma, so it is asked for as well (and no
            // code here fuses). AVX-512 machines have AVX2; asking for both keeps the order by width.
            (avx2::get() && avx512::get()).then_some(Isa(Level::Avx512)),
        ];
        #[cfg(not(target_arch = "x86_64"))]
        let wide: [Option<Isa>; 0] = [];
        core::iter::once(Self::BASELINE).chain(wide.into_iter().flatten())
    }

    /// The vector unit in use: the widest, unless [`Isa::force`] chose another.
    pub fn active() -> Isa {
        match FORCED.load(Ordering::Relaxed) {
            0 => Self::supported().last().unwrap_or(Self::BASELINE),
            n => Self::supported().nth(usize::from(n) - 1).unwrap_or(Self::BASELINE),
        }
    }

    /// Uses the named vector unit from now on in this process. No result depends on the choice.
    ///
    /// # Errors
    /// The names that this machine has, if `name` is none of them.
    pub fn force(name: &str) -> Result<(), alloc::string::String> {
        match Self::supported().position(|isa| isa.name() == name) {
            Some(n) => {
                FORCED.store(n as u8 + 1, Ordering::Relaxed);
                Ok(())
            }
            None => {
                let names: alloc::vec::Vec<&str> = Self::supported().map(Isa::name).collect();
                Err(crate::config::expected_one_of(name, &names))
            }
        }
    }

    /// Name for people and settings.
    pub fn name(self) -> &'static str {
        match self.0 {
            Level::Baseline if cfg!(target_arch = "x86_64") => "sse2",
            Level::Baseline if cfg!(target_arch = "aarch64") => "neon",
            Level::Baseline if cfg!(all(target_arch = "wasm32", target_feature = "simd128")) => "simd128",
            Level::Baseline => "scalar",
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => "avx512",
        }
    }
}

/// Square roots, which `core` does not offer on floats: exact (correctly rounded) on every target.
pub(super) trait Lanes {
    /// Elementwise square root.
    fn sqrt(x: [f32; 16]) -> [f32; 16];
}

/// The compile target's own vectors.
pub(super) struct Baseline;

impl Lanes for Baseline {
    #[inline(always)]
    fn sqrt(x: [f32; 16]) -> [f32; 16] {
        #[cfg(target_arch = "x86_64")]
        {
            use core::arch::x86_64::{__m128, _mm_sqrt_ps};
            // SAFETY: both types are 64 bytes of plain numbers; SSE is part of x86-64.
            unsafe {
                let parts: [__m128; 4] = core::mem::transmute(x);
                core::mem::transmute(parts.map(|part| _mm_sqrt_ps(part)))
            }
        }
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        {
            use core::arch::wasm32::{f32x4_sqrt, v128};
            // SAFETY: both types are 64 bytes of plain numbers; the whole module needs SIMD128.
            unsafe {
                let parts: [v128; 4] = core::mem::transmute(x);
                core::mem::transmute(parts.map(|part| f32x4_sqrt(part)))
            }
        }
        #[cfg(target_arch = "aarch64")]
        {
            use core::arch::aarch64::{float32x4_t, vsqrtq_f32};
            // SAFETY: both types are 64 bytes of plain numbers; NEON is part of AArch64.
            unsafe {
                let parts: [float32x4_t; 4] = core::mem::transmute(x);
                core::mem::transmute(parts.map(|part| vsqrtq_f32(part)))
            }
        }
        #[cfg(not(any(
            target_arch = "x86_64",
            target_arch = "aarch64",
            all(target_arch = "wasm32", target_feature = "simd128")
        )))]
        {
            x.map(libm::sqrtf)
        }
    }
}

/// 256-bit vectors.
#[cfg(target_arch = "x86_64")]
struct Avx2;

#[cfg(target_arch = "x86_64")]
impl Lanes for Avx2 {
    #[inline(always)]
    fn sqrt(x: [f32; 16]) -> [f32; 16] {
        use core::arch::x86_64::{__m256, _mm256_sqrt_ps};
        // SAFETY: both types are 64 bytes of plain numbers; only code compiled for AVX2 names this type.
        unsafe {
            let parts: [__m256; 2] = core::mem::transmute(x);
            core::mem::transmute([_mm256_sqrt_ps(parts[0]), _mm256_sqrt_ps(parts[1])])
        }
    }
}

/// 512-bit vectors.
#[cfg(target_arch = "x86_64")]
struct Avx512;

#[cfg(target_arch = "x86_64")]
impl Lanes for Avx512 {
    #[inline(always)]
    fn sqrt(x: [f32; 16]) -> [f32; 16] {
        use core::arch::x86_64::{__m512, _mm512_sqrt_ps};
        // SAFETY: both types are 64 bytes of plain numbers; only code compiled for AVX-512 names this type.
        unsafe {
            core::mem::transmute::<__m512, [f32; 16]>(_mm512_sqrt_ps(core::mem::transmute::<[f32; 16], __m512>(x)))
        }
    }
}

/// Compiles one kernel for every vector unit and calls the one of an [`Isa`].
macro_rules! kernel {
    ($(#[$doc:meta])* $name:ident($($arg:ident: $type:ty),* $(,)?),
     baseline: $baseline:expr, avx2: $avx2:expr, avx512: $avx512:expr) => {
        $(#[$doc])*
        #[inline]
        pub fn $name(isa: Isa, $($arg: $type),*) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            fn wide($($arg: $type),*) { $avx2($($arg),*) }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,avx512f,avx512bw,avx512dq,avx512vl")]
            fn widest($($arg: $type),*) { $avx512($($arg),*) }

            match isa.0 {
                Level::Baseline => $baseline($($arg),*),
                // SAFETY: this value exists only where the processor said that it has AVX2.
                #[cfg(target_arch = "x86_64")]
                Level::Avx2 => unsafe { wide($($arg),*) },
                // SAFETY: this value exists only where the processor said that it has AVX-512.
                #[cfg(target_arch = "x86_64")]
                Level::Avx512 => unsafe { widest($($arg),*) },
            }
        }
    };
}

kernel!(
    /// `C = start + A·B`, see [`gemm`].
    product(a: Matrix<'_>, b: Matrix<'_>, c: Output<'_>),
    baseline: gemm::product_body::<8>, avx2: gemm::product_body::<16>, avx512: gemm::product_body::<64>
);
kernel!(
    /// `C = Aᵀ·B`, see [`gemm`].
    product_transposed(a: Matrix<'_>, b: Matrix<'_>, c: &mut [f32]),
    baseline: gemm::product_transposed_body::<8>, avx2: gemm::product_transposed_body::<16>,
    avx512: gemm::product_transposed_body::<64>
);
kernel!(
    /// `out = bias + Σ rows[index]`, see [`gemm`].
    sum_rows(rows: Matrix<'_>, indices: &[u32], bias: &[f32], out: &mut [f32]),
    baseline: gemm::sum_rows_body::<16>, avx2: gemm::sum_rows_body::<32>, avx512: gemm::sum_rows_body::<64>
);
kernel!(
    /// `rows[index] += add` for every index, see [`gemm`].
    add_to_rows(rows: &mut [f32], indices: &[u32], add: &[f32]),
    baseline: gemm::add_to_rows_body, avx2: gemm::add_to_rows_body, avx512: gemm::add_to_rows_body
);
kernel!(
    /// One step of the optimiser over a range of parameters, see [`optim`].
    optimise(constants: &Constants, state: State<'_>),
    baseline: optim::step_body::<Baseline>, avx2: optim::step_body::<Avx2>, avx512: optim::step_body::<Avx512>
);

kernel!(
    /// `out = aᵀ`, see [`gemm`].
    transpose(a: Matrix<'_>, out: &mut [f32]),
    baseline: gemm::transpose_body, avx2: gemm::transpose_body, avx512: gemm::transpose_body
);
kernel!(
    /// The most multiply-adds that can be had, see [`gemm`].
    probe(rounds: usize, x: &mut [f32; gemm::PROBE_LANES]),
    baseline: gemm::probe_body, avx2: gemm::probe_body, avx512: gemm::probe_body
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_units_are_answered() {
        let error = Isa::force("avx1024").unwrap_err();
        assert!(error.contains("`avx1024` is none of"), "{error}");
    }

    #[test]
    fn square_roots_are_those_of_libm() {
        let x: [f32; 16] = core::array::from_fn(|i| 0.1 * i as f32 + 1e-3 * (i * i) as f32);
        assert_eq!(Baseline::sqrt(x).map(f32::to_bits), x.map(|v| libm::sqrtf(v).to_bits()));
    }
}
