//! Products with the left matrix transposed: gradients of weights.

use super::super::isa::{Baseline, Lanes, One};
use super::{Factors, Matrix, Terms, WORD, Work, lanes, load, sparse_rows, store, transpose_part};

/// One tile of `Aᵀ·B`: `ROWS` columns of A, some vectors of columns of B, reduction over their rows.
#[inline(always)]
fn tile_transposed<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    a: Matrix<'_>,
    b: Matrix<'_>,
    out: &mut [f32],
    i: usize,
    j: usize,
) {
    let mut sums = [[L::splat(0.0); VECTORS]; ROWS];
    for (left, right) in a.data.chunks_exact(a.cols).zip(b.data.chunks_exact(b.cols)) {
        let factors: &[f32; ROWS] = left[i..i + ROWS].try_into().expect("a full tile");
        let line = load::<L, VECTORS>(&right[j..j + VECTORS * lanes::<L>()]);
        for (factor, sums) in factors.iter().zip(&mut sums) {
            let factor = L::splat(*factor);
            for (sum, right) in sums.iter_mut().zip(line) {
                *sum = L::add_product(*sum, factor, right);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        store::<L, VECTORS>(sums, &mut out[(i + r) * b.cols + j..]);
    }
}

#[inline(always)]
fn stripe_transposed<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    a: Matrix<'_>,
    b: Matrix<'_>,
    out: &mut [f32],
    j: usize,
) {
    let mut i = 0;
    while i + ROWS <= a.cols {
        tile_transposed::<L, ROWS, VECTORS>(a, b, out, i, j);
        i += ROWS;
    }
    while i + 4 <= a.cols {
        tile_transposed::<L, 4, VECTORS>(a, b, out, i, j);
        i += 4;
    }
    while i < a.cols {
        tile_transposed::<L, 1, VECTORS>(a, b, out, i, j);
        i += 1;
    }
}

/// As [`sparse`], with the columns of A for its rows. Columns that are all zero take no time: the units that are
/// inactive in every sample.
#[inline(always)]
fn sparse_transposed<L: Lanes, const ROWS: usize, const VECTORS: usize, const LAST: usize>(
    a: Matrix<'_>,
    b: Matrix<'_>,
    out: &mut [f32],
    work: &mut Work,
) -> usize {
    let whole = b.cols - b.cols % 32;
    for k in (0..a.rows).step_by(WORD) {
        let end = a.rows.min(k + WORD);
        let right = Matrix { data: &b.data[k * b.cols..end * b.cols], rows: end - k, cols: b.cols };
        let terms = Terms { cols: b.cols, begin: (k == 0).then_some(None), finish: None };
        // A row each, the samples side by side.
        let factors = work.columns(end - k);
        for first in (0..a.cols).step_by(WORD) {
            let last = a.cols.min(first + WORD);
            transpose_part::<L>(&a.data[k * a.cols + first..], [end - k, last - first], a.cols, factors);
            // The rows that are not all zero.
            let (mut active, mut count) = ([0; WORD], 0);
            for (i, row) in factors.iter().enumerate().take(last - first) {
                if row.iter().any(|x| *x != 0.0) {
                    active[count] = i;
                    count += 1;
                } else if k == 0 {
                    out[(first + i) * b.cols..(first + i) * b.cols + whole].fill(0.0);
                }
            }
            let row = |i: usize| core::slice::from_ref(&factors[active[i]]);
            sparse_rows::<L, ROWS, VECTORS, LAST>(&terms, right, count, row, |i| first + active[i], out);
        }
    }
    whole
}

/// `C = Aᵀ·B` with A `[k, m]`, B `[k, n]`, C `[m, n]`: the gradient of a weight matrix. Stripes as in
/// [`product_body`].
#[inline(always)]
pub(in crate::nn) fn product_transposed_body<
    L: Lanes,
    const DROWS: usize,
    const DENSE: usize,
    const ROWS: usize,
    const SPARSE: usize,
    const LAST: usize,
>(
    factors: Factors,
    a: Matrix<'_>,
    b: Matrix<'_>,
    out: &mut [f32],
    work: &mut Work,
) {
    assert_eq!(a.rows, b.rows, "inner sizes of a product agree");
    let mut j = 0;
    if factors == Factors::Sparse && b.cols >= 32 {
        j = sparse_transposed::<L, ROWS, SPARSE, LAST>(a, b, out, work);
    }
    while j + DENSE * lanes::<L>() <= b.cols {
        stripe_transposed::<L, DROWS, DENSE>(a, b, out, j);
        j += DENSE * lanes::<L>();
    }
    while j + lanes::<L>() <= b.cols {
        stripe_transposed::<L, 8, 1>(a, b, out, j);
        j += lanes::<L>();
    }
    while j + lanes::<Baseline>() <= b.cols {
        stripe_transposed::<Baseline, 8, 1>(a, b, out, j);
        j += lanes::<Baseline>();
    }
    while j < b.cols {
        stripe_transposed::<One, 8, 1>(a, b, out, j);
        j += 1;
    }
}
