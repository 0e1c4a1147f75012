//! The vector unit in use: chosen at run time, the same bits from each.
//!
//! Kernels are written once as plain loops over fixed-length arrays (`*_body`, always inlined). Here
//! they are compiled again for wider vector units of x86-64 and the widest that the machine has is
//! called. On other targets the compile target decides (NEON, wasm SIMD128 or scalar).
//!
//! # Why the unsafe code is sound
//! A function compiled for a vector unit may run only where that unit exists. An [`Isa`] above the
//! baseline can be made only by [`Isa::supported`], which asks the processor; every call below is
//! guarded by matching on such a value. The intrinsics work on values, not on pointers.
#![allow(unsafe_code)]

use core::sync::atomic::{AtomicU8, Ordering};

use super::gemm::{self, Factors, Matrix, Output, Work};
use super::ones::{self, Visits};
use super::optim::{self, Constants, State};
use super::rows::Rows;

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

/// Numbers side by side, and what plain loops do not become. Compilers keep the sums of a product in
/// registers only if they are vectors in the source; square roots are not in `core` (these are exact, that
/// is correctly rounded, on every target); bit masks have instructions of their own.
pub(super) trait Lanes {
    /// As many numbers as a vector of this unit has.
    type Vector: Copy;
    /// One number in every lane.
    fn splat(x: f32) -> Self::Vector;
    /// The first numbers of `from`.
    fn load(from: &[f32]) -> Self::Vector;
    /// Writes to the first numbers of `to`.
    fn store(x: Self::Vector, to: &mut [f32]);
    /// Elementwise sum.
    fn add(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `sum + a · b`, both rounded.
    fn add_product(sum: Self::Vector, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// Elementwise square root.
    fn sqrt(x: Self::Vector) -> Self::Vector;
    /// Zero in place of what is below zero; what is not a number stays one.
    fn relu(x: Self::Vector) -> Self::Vector;
    /// The same of numbers in memory. A plain loop: written with vectors, it drives the sums of a product, which were
    /// stored just before, out of their registers (a tile of six rows takes 1.08 of its time).
    #[inline(always)]
    fn relu_all(sums: &mut [f32]) {
        sums.iter_mut().for_each(|sum| *sum = One::relu(*sum));
    }
    /// Zero where `active` is not above zero.
    #[inline(always)]
    fn keep(sums: &mut [f32], active: &[f32]) {
        for (sum, active) in sums.iter_mut().zip(active) {
            *sum = if *active > 0.0 { *sum } else { 0.0 };
        }
    }
    /// Bit `l` is set where number `l` is not zero; what is not a number is not zero.
    fn nonzero(x: &[f32; 16]) -> u32;
    /// Writes a square of as many rows as lanes with rows for columns; rows are `stride` and `to_stride` apart.
    fn transpose(from: &[f32], stride: usize, to: &mut [f32], to_stride: usize);
}

/// Four lanes: the compile target's own vectors.
pub(super) struct Baseline;

#[cfg(target_arch = "aarch64")]
use core::arch::aarch64::{
    float32x4_t as Four, vaddq_f32, vbicq_u32, vcltzq_f32, vmulq_f32, vreinterpretq_f32_u32, vreinterpretq_u32_f32,
    vsqrtq_f32,
};
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
use core::arch::wasm32::{
    f32x4_add, f32x4_gt, f32x4_lt, f32x4_mul, f32x4_splat, f32x4_sqrt, v128 as Four, v128_and, v128_andnot,
};
#[cfg(target_arch = "x86_64")]
use core::arch::x86_64::{__m128 as Four, _mm_add_ps, _mm_max_ps, _mm_mul_ps, _mm_setzero_ps, _mm_sqrt_ps};
#[cfg(target_arch = "x86_64")]
use core::arch::x86_64::{
    __m256, __m512, _CMP_NEQ_UQ, _mm256_add_ps, _mm256_cmp_ps, _mm256_max_ps, _mm256_movemask_ps, _mm256_mul_ps,
    _mm256_permute2f128_ps, _mm256_set1_ps, _mm256_setzero_ps, _mm256_shuffle_ps, _mm256_sqrt_ps, _mm256_unpackhi_ps,
    _mm256_unpacklo_ps, _mm512_add_ps, _mm512_cmp_ps_mask, _mm512_max_ps, _mm512_mul_ps, _mm512_set1_ps,
    _mm512_setzero_ps, _mm512_sqrt_ps,
};
/// No vectors at all.
#[cfg(not(any(
    target_arch = "x86_64",
    target_arch = "aarch64",
    all(target_arch = "wasm32", target_feature = "simd128")
)))]
type Four = [f32; 4];

impl Lanes for Baseline {
    type Vector = Four;

    #[inline(always)]
    fn splat(x: f32) -> Four {
        // SAFETY: both types are 16 bytes of plain numbers.
        unsafe { core::mem::transmute::<[f32; 4], Four>([x; 4]) }
    }

    #[inline(always)]
    fn load(from: &[f32]) -> Four {
        let lanes: &[f32; 4] = from[..4].try_into().expect("4 lanes");
        // SAFETY: both types are 16 bytes of plain numbers.
        unsafe { core::mem::transmute::<[f32; 4], Four>(*lanes) }
    }

    #[inline(always)]
    fn store(x: Four, to: &mut [f32]) {
        let lanes: &mut [f32; 4] = (&mut to[..4]).try_into().expect("4 lanes");
        // SAFETY: both types are 16 bytes of plain numbers.
        *lanes = unsafe { core::mem::transmute::<Four, [f32; 4]>(x) };
    }

    #[inline(always)]
    fn add(a: Four, b: Four) -> Four {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: SSE is part of x86-64.
        unsafe {
            _mm_add_ps(a, b)
        }
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        {
            f32x4_add(a, b)
        }
        #[cfg(target_arch = "aarch64")]
        // SAFETY: NEON is part of AArch64.
        unsafe {
            vaddq_f32(a, b)
        }
        #[cfg(not(any(
            target_arch = "x86_64",
            target_arch = "aarch64",
            all(target_arch = "wasm32", target_feature = "simd128")
        )))]
        {
            core::array::from_fn(|l| a[l] + b[l])
        }
    }

    #[inline(always)]
    fn add_product(sum: Four, a: Four, b: Four) -> Four {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: SSE is part of x86-64.
        unsafe {
            _mm_add_ps(sum, _mm_mul_ps(a, b))
        }
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        {
            f32x4_add(sum, f32x4_mul(a, b))
        }
        #[cfg(target_arch = "aarch64")]
        // SAFETY: NEON is part of AArch64.
        unsafe {
            vaddq_f32(sum, vmulq_f32(a, b))
        }
        #[cfg(not(any(
            target_arch = "x86_64",
            target_arch = "aarch64",
            all(target_arch = "wasm32", target_feature = "simd128")
        )))]
        {
            core::array::from_fn(|l| sum[l] + a[l] * b[l])
        }
    }

    #[inline(always)]
    fn sqrt(x: Four) -> Four {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: SSE is part of x86-64.
        unsafe {
            _mm_sqrt_ps(x)
        }
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        {
            f32x4_sqrt(x)
        }
        #[cfg(target_arch = "aarch64")]
        // SAFETY: NEON is part of AArch64.
        unsafe {
            vsqrtq_f32(x)
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

    #[inline(always)]
    fn relu(x: Four) -> Four {
        #[cfg(target_arch = "x86_64")]
        // The second one where they are equal or one is not a number.
        // SAFETY: SSE is part of x86-64.
        unsafe {
            _mm_max_ps(_mm_setzero_ps(), x)
        }
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        {
            v128_andnot(x, f32x4_lt(x, f32x4_splat(0.0)))
        }
        #[cfg(target_arch = "aarch64")]
        // SAFETY: NEON is part of AArch64.
        unsafe {
            vreinterpretq_f32_u32(vbicq_u32(vreinterpretq_u32_f32(x), vcltzq_f32(x)))
        }
        #[cfg(not(any(
            target_arch = "x86_64",
            target_arch = "aarch64",
            all(target_arch = "wasm32", target_feature = "simd128")
        )))]
        {
            x.map(One::relu)
        }
    }

    // For wasm the plain loops become branches, which half of the sums take.
    #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
    #[inline(always)]
    fn relu_all(sums: &mut [f32]) {
        let (whole, rest) = sums.as_chunks_mut::<4>();
        for lanes in whole {
            Self::store(Self::relu(Self::load(lanes)), lanes);
        }
        rest.iter_mut().for_each(|sum| *sum = One::relu(*sum));
    }

    #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
    #[inline(always)]
    fn keep(sums: &mut [f32], active: &[f32]) {
        let ((whole, rest), (active, last)) = (sums.as_chunks_mut::<4>(), active.as_chunks::<4>());
        for (lanes, active) in whole.iter_mut().zip(active) {
            let positive = f32x4_gt(Self::load(active), f32x4_splat(0.0));
            Self::store(v128_and(Self::load(lanes), positive), lanes);
        }
        One::keep(rest, last);
    }

    #[inline(always)]
    fn nonzero(x: &[f32; 16]) -> u32 {
        #[cfg(target_arch = "x86_64")]
        {
            use core::arch::x86_64::{__m128, _mm_cmpneq_ps, _mm_movemask_ps, _mm_setzero_ps};
            // SAFETY: both types are 64 bytes of plain numbers; SSE is part of x86-64.
            let masks = unsafe {
                let parts: [__m128; 4] = core::mem::transmute(*x);
                parts.map(|part| _mm_movemask_ps(_mm_cmpneq_ps(part, _mm_setzero_ps())) as u32)
            };
            masks[0] | masks[1] << 4 | masks[2] << 8 | masks[3] << 12
        }
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        {
            use core::arch::wasm32::{f32x4_ne, i32x4_bitmask, v128};
            // SAFETY: both types are 64 bytes of plain numbers; the whole module needs SIMD128.
            let parts: [v128; 4] = unsafe { core::mem::transmute(*x) };
            let masks = parts.map(|part| u32::from(i32x4_bitmask(f32x4_ne(part, f32x4_splat(0.0)))));
            masks[0] | masks[1] << 4 | masks[2] << 8 | masks[3] << 12
        }
        #[cfg(not(any(target_arch = "x86_64", all(target_arch = "wasm32", target_feature = "simd128"))))]
        {
            (0..16).fold(0, |mask, l| mask | u32::from(x[l] != 0.0) << l)
        }
    }

    #[inline(always)]
    fn transpose(from: &[f32], stride: usize, to: &mut [f32], to_stride: usize) {
        gemm::square::<4>(from, stride, to, to_stride);
    }
}

/// One lane: what is left of a row.
pub(super) struct One;

impl Lanes for One {
    type Vector = f32;

    #[inline(always)]
    fn splat(x: f32) -> f32 {
        x
    }

    #[inline(always)]
    fn load(from: &[f32]) -> f32 {
        from[0]
    }

    #[inline(always)]
    fn store(x: f32, to: &mut [f32]) {
        to[0] = x;
    }

    #[inline(always)]
    fn add(a: f32, b: f32) -> f32 {
        a + b
    }

    #[inline(always)]
    fn add_product(sum: f32, a: f32, b: f32) -> f32 {
        sum + a * b
    }

    #[inline(always)]
    fn sqrt(x: f32) -> f32 {
        libm::sqrtf(x)
    }

    #[inline(always)]
    fn relu(x: f32) -> f32 {
        if x < 0.0 { 0.0 } else { x }
    }

    #[inline(always)]
    fn nonzero(x: &[f32; 16]) -> u32 {
        Baseline::nonzero(x)
    }

    #[inline(always)]
    fn transpose(from: &[f32], _stride: usize, to: &mut [f32], _to_stride: usize) {
        to[0] = from[0];
    }
}

/// 256-bit vectors.
#[cfg(target_arch = "x86_64")]
pub(super) struct Avx2;

// SAFETY of this block: vectors and arrays of one length are the same plain numbers, and only code compiled
// for AVX2 names this type.
#[cfg(target_arch = "x86_64")]
impl Lanes for Avx2 {
    type Vector = __m256;

    #[inline(always)]
    fn splat(x: f32) -> __m256 {
        unsafe { _mm256_set1_ps(x) }
    }

    #[inline(always)]
    fn load(from: &[f32]) -> __m256 {
        let lanes: &[f32; 8] = from[..8].try_into().expect("8 lanes");
        unsafe { core::mem::transmute::<[f32; 8], __m256>(*lanes) }
    }

    #[inline(always)]
    fn store(x: __m256, to: &mut [f32]) {
        let lanes: &mut [f32; 8] = (&mut to[..8]).try_into().expect("8 lanes");
        *lanes = unsafe { core::mem::transmute::<__m256, [f32; 8]>(x) };
    }

    #[inline(always)]
    fn add(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_add_ps(a, b) }
    }

    #[inline(always)]
    fn add_product(sum: __m256, a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_add_ps(sum, _mm256_mul_ps(a, b)) }
    }

    #[inline(always)]
    fn sqrt(x: __m256) -> __m256 {
        unsafe { _mm256_sqrt_ps(x) }
    }

    #[inline(always)]
    fn relu(x: __m256) -> __m256 {
        // The second one where they are equal or one is not a number.
        unsafe { _mm256_max_ps(_mm256_setzero_ps(), x) }
    }

    #[inline(always)]
    fn nonzero(x: &[f32; 16]) -> u32 {
        unsafe {
            let [low, high]: [__m256; 2] = core::mem::transmute(*x);
            let low = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_NEQ_UQ>(low, _mm256_setzero_ps())) as u32;
            let high = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_NEQ_UQ>(high, _mm256_setzero_ps())) as u32;
            low | high << 8
        }
    }

    // Compilers make loads and stores of single numbers of the plain loops.
    #[inline(always)]
    fn transpose(from: &[f32], stride: usize, to: &mut [f32], to_stride: usize) {
        let rows: [__m256; 8] = core::array::from_fn(|r| Self::load(&from[r * stride..]));
        let columns = unsafe {
            // Pairs of rows, then fours, each in both halves of the vectors; then the halves.
            let pairs: [__m256; 8] = core::array::from_fn(|i| {
                let (a, b) = (rows[i / 2 * 2], rows[i / 2 * 2 + 1]);
                if i % 2 == 0 { _mm256_unpacklo_ps(a, b) } else { _mm256_unpackhi_ps(a, b) }
            });
            let fours: [__m256; 8] = core::array::from_fn(|i| {
                let (a, b) = (pairs[i / 4 * 4 + i % 4 / 2], pairs[i / 4 * 4 + i % 4 / 2 + 2]);
                if i % 2 == 0 { _mm256_shuffle_ps::<0x44>(a, b) } else { _mm256_shuffle_ps::<0xEE>(a, b) }
            });
            let columns: [__m256; 8] = core::array::from_fn(|i| {
                let (a, b) = (fours[i % 4], fours[i % 4 + 4]);
                if i < 4 { _mm256_permute2f128_ps::<0x20>(a, b) } else { _mm256_permute2f128_ps::<0x31>(a, b) }
            });
            columns
        };
        for (c, column) in columns.into_iter().enumerate() {
            Self::store(column, &mut to[c * to_stride..]);
        }
    }
}

/// 512-bit vectors.
#[cfg(target_arch = "x86_64")]
pub(super) struct Avx512;

// SAFETY of this block: vectors and arrays of one length are the same plain numbers, and only code compiled
// for AVX-512 names this type.
#[cfg(target_arch = "x86_64")]
impl Lanes for Avx512 {
    type Vector = __m512;

    #[inline(always)]
    fn splat(x: f32) -> __m512 {
        unsafe { _mm512_set1_ps(x) }
    }

    #[inline(always)]
    fn load(from: &[f32]) -> __m512 {
        let lanes: &[f32; 16] = from[..16].try_into().expect("16 lanes");
        unsafe { core::mem::transmute::<[f32; 16], __m512>(*lanes) }
    }

    #[inline(always)]
    fn store(x: __m512, to: &mut [f32]) {
        let lanes: &mut [f32; 16] = (&mut to[..16]).try_into().expect("16 lanes");
        *lanes = unsafe { core::mem::transmute::<__m512, [f32; 16]>(x) };
    }

    #[inline(always)]
    fn add(a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_add_ps(a, b) }
    }

    #[inline(always)]
    fn add_product(sum: __m512, a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_add_ps(sum, _mm512_mul_ps(a, b)) }
    }

    #[inline(always)]
    fn sqrt(x: __m512) -> __m512 {
        unsafe { _mm512_sqrt_ps(x) }
    }

    #[inline(always)]
    fn relu(x: __m512) -> __m512 {
        // The second one where they are equal or one is not a number.
        unsafe { _mm512_max_ps(_mm512_setzero_ps(), x) }
    }

    #[inline(always)]
    fn nonzero(x: &[f32; 16]) -> u32 {
        unsafe {
            let x = core::mem::transmute::<[f32; 16], __m512>(*x);
            u32::from(_mm512_cmp_ps_mask::<_CMP_NEQ_UQ>(x, _mm512_setzero_ps()))
        }
    }

    #[inline(always)]
    fn transpose(from: &[f32], stride: usize, to: &mut [f32], to_stride: usize) {
        gemm::square::<16>(from, stride, to, to_stride);
    }
}

/// Compiles one kernel for every vector unit and calls the one of an [`Isa`].
macro_rules! kernel {
    ($(#[$doc:meta])* $name:ident($($arg:ident: $type:ty),* $(,)?),
     baseline: $baseline:expr, avx2: $avx2:expr, avx512: $avx512:expr) => {
        $(#[$doc])*
        // In wasm a function of its own: compilers of browsers allot registers better in small functions.
        #[cfg_attr(target_arch = "wasm32", inline(never))]
        #[cfg_attr(not(target_arch = "wasm32"), inline)]
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
    product(factors: Factors, a: Matrix<'_>, b: Matrix<'_>, c: Output<'_>),
    baseline: gemm::product_body::<Baseline, 4, 2, 1, 8, 8>, avx2: gemm::product_body::<Avx2, 6, 2, 6, 2, 4>,
    avx512: gemm::product_body::<Avx512, 4, 4, 1, 8, 2>
);
kernel!(
    /// `C = start + A·Bᵀ`, see [`gemm`].
    product_by_transposed(a: Matrix<'_>, b: Matrix<'_>, c: Output<'_>, work: &mut Work),
    baseline: gemm::product_by_transposed_body::<Baseline, 4, 2, 1, 8, 8>,
    avx2: gemm::product_by_transposed_body::<Avx2, 6, 2, 6, 2, 4>,
    avx512: gemm::product_by_transposed_body::<Avx512, 4, 4, 1, 8, 2>
);
kernel!(
    /// `C = Aᵀ·B`, see [`gemm`].
    product_transposed(factors: Factors, a: Matrix<'_>, b: Matrix<'_>, c: &mut [f32], work: &mut Work),
    baseline: gemm::product_transposed_body::<Baseline, 4, 2, 1, 8, 8>,
    avx2: gemm::product_transposed_body::<Avx2, 6, 2, 6, 2, 4>,
    avx512: gemm::product_transposed_body::<Avx512, 4, 4, 1, 8, 2>
);
kernel!(
    /// `out = relu(bias + Σ weights[one])`, see [`ones`].
    sum_rows(weights: Matrix<'_>, rows: &Rows, visits: &Visits, bias: &[f32], out: &mut [f32]),
    baseline: ones::sum_rows_body::<Baseline, 8>, avx2: ones::sum_rows_body::<Avx2, 8>,
    avx512: ones::sum_rows_body::<Avx512, 8>
);
kernel!(
    /// `out = Σ rows`, see [`gemm`].
    sum_columns(rows: Matrix<'_>, out: &mut [f32]),
    baseline: gemm::sum_columns_body, avx2: gemm::sum_columns_body, avx512: gemm::sum_columns_body
);
kernel!(
    /// `out = Σ rows[r]` over marked rows, see [`ones`].
    sum_marked(rows: Matrix<'_>, marks: &[u64], out: &mut [f32]),
    baseline: ones::sum_marked_body::<Baseline, 8>, avx2: ones::sum_marked_body::<Avx2, 8>,
    avx512: ones::sum_marked_body::<Avx512, 8>
);
kernel!(
    /// One step of the optimiser over a range of parameters, see [`optim`].
    optimise(constants: &Constants, state: State<'_>),
    baseline: optim::step_body::<Baseline, 4>, avx2: optim::step_body::<Avx2, 16>,
    avx512: optim::step_body::<Avx512, 16>
);

kernel!(
    /// The most multiply-adds that can be had, see [`gemm`].
    probe(rounds: usize, x: &mut [f32; gemm::PROBE_LANES]),
    baseline: gemm::probe_body::<Baseline>, avx2: gemm::probe_body::<Avx2>, avx512: gemm::probe_body::<Avx512>
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
    fn masks_name_what_is_not_zero() {
        let mut x = [1.0; 16];
        (x[0], x[3], x[9], x[15]) = (0.0, -0.0, f32::NAN, 0.0);
        assert_eq!(Baseline::nonzero(&x), 0b0111_1111_1111_0110);
    }

    #[test]
    fn square_roots_are_those_of_libm() {
        for i in 0..16 {
            let x: [f32; 4] = core::array::from_fn(|l| 0.1 * i as f32 + 1e-3 * (l * l) as f32);
            let mut roots = [0.0; 4];
            Baseline::store(Baseline::sqrt(Baseline::load(&x)), &mut roots);
            assert_eq!(roots.map(f32::to_bits), x.map(|v| libm::sqrtf(v).to_bits()));
        }
    }
}
