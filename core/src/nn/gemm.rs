//! The only matrix products. Each output sums its terms in ascending order of the reduction index,
//! starting from its bias or from zero, without fused multiply-add: tile sizes and vector widths change
//! the speed and no bit. [`super::isa`] compiles these loops for each vector unit.

/// Lanes of [`super::isa::probe`]: enough independent chains to hide every latency.
pub const PROBE_LANES: usize = 192;

/// A row-major matrix in a slice.
#[derive(Clone, Copy)]
pub struct Matrix<'a> {
    /// `rows · cols` numbers.
    pub data: &'a [f32],
    /// Number of rows.
    pub rows: usize,
    /// Number of columns: the distance from row to row.
    pub cols: usize,
}

impl<'a> Matrix<'a> {
    /// A view of the first `rows · cols` numbers of `data`.
    ///
    /// # Panics
    /// If `data` is shorter.
    pub fn new(data: &'a [f32], rows: usize, cols: usize) -> Self {
        Self { data: &data[..rows * cols], rows, cols }
    }
}

/// Where a product goes, and what surrounds it.
pub struct Output<'a> {
    /// Receives `rows · cols` numbers, row-major.
    pub data: &'a mut [f32],
    /// First term of every sum, one per column; zero without.
    pub bias: Option<&'a [f32]>,
    /// Replace negative results by zero; what is not a number stays one.
    pub relu: bool,
}

/// One tile: `ROWS` rows of A times `COLS` columns of B.
#[inline(always)]
fn tile<const ROWS: usize, const COLS: usize>(a: Matrix<'_>, b: Matrix<'_>, out: &mut Output<'_>, i: usize, j: usize) {
    let k = a.cols;
    let rows: [&[f32]; ROWS] = core::array::from_fn(|r| &a.data[(i + r) * k..(i + r) * k + k]);
    let start: [f32; COLS] = match out.bias {
        Some(bias) => bias[j..j + COLS].try_into().expect("a full tile"),
        None => [0.0; COLS],
    };
    let mut sums = [start; ROWS];
    // An index over several rows at once; iterators over each would be checked one by one.
    #[allow(clippy::needless_range_loop)]
    for kk in 0..k {
        let line: &[f32; COLS] = b.data[kk * b.cols + j..kk * b.cols + j + COLS].try_into().expect("a full tile");
        for r in 0..ROWS {
            let factor = rows[r][kk];
            for l in 0..COLS {
                sums[r][l] += factor * line[l];
            }
        }
    }
    for (r, sum) in sums.iter().enumerate() {
        let line = &mut out.data[(i + r) * b.cols + j..(i + r) * b.cols + j + COLS];
        line.copy_from_slice(sum);
        if out.relu {
            for value in line {
                *value = if *value < 0.0 { 0.0 } else { *value };
            }
        }
    }
}

/// All rows of one stripe of columns. Narrow stripes take many rows at once: each sum is a chain, and
/// only independent chains keep the machine busy.
#[inline(always)]
fn stripe<const COLS: usize>(a: Matrix<'_>, b: Matrix<'_>, out: &mut Output<'_>, j: usize) {
    let mut i = 0;
    if COLS <= 4 {
        while i + 8 <= a.rows {
            tile::<8, COLS>(a, b, out, i, j);
            i += 8;
        }
    }
    while i + 4 <= a.rows {
        tile::<4, COLS>(a, b, out, i, j);
        i += 4;
    }
    if i + 2 <= a.rows {
        tile::<2, COLS>(a, b, out, i, j);
        i += 2;
    }
    if i < a.rows {
        tile::<1, COLS>(a, b, out, i, j);
    }
}

/// `C = start + A·B` with A `[m, k]`, B `[k, n]`, C `[m, n]`, in stripes of `WIDE` columns.
#[inline(always)]
pub(super) fn product_body<const WIDE: usize>(a: Matrix<'_>, b: Matrix<'_>, mut c: Output<'_>) {
    assert_eq!(a.cols, b.rows, "inner sizes of a product agree");
    let mut j = 0;
    while j + WIDE <= b.cols {
        stripe::<WIDE>(a, b, &mut c, j);
        j += WIDE;
    }
    while j + 16 <= b.cols {
        stripe::<16>(a, b, &mut c, j);
        j += 16;
    }
    while j + 4 <= b.cols {
        stripe::<4>(a, b, &mut c, j);
        j += 4;
    }
    if j + 2 <= b.cols {
        stripe::<2>(a, b, &mut c, j);
        j += 2;
    }
    if j < b.cols {
        stripe::<1>(a, b, &mut c, j);
    }
}

/// One tile of `Aᵀ·B`: `ROWS` columns of A, `COLS` columns of B, reduction over their rows.
#[inline(always)]
fn tile_transposed<const ROWS: usize, const COLS: usize>(
    a: Matrix<'_>,
    b: Matrix<'_>,
    out: &mut [f32],
    i: usize,
    j: usize,
) {
    let mut sums = [[0.0f32; COLS]; ROWS];
    for (left, right) in a.data.chunks_exact(a.cols).zip(b.data.chunks_exact(b.cols)) {
        let factors: &[f32; ROWS] = left[i..i + ROWS].try_into().expect("a full tile");
        let line: &[f32; COLS] = right[j..j + COLS].try_into().expect("a full tile");
        for r in 0..ROWS {
            for l in 0..COLS {
                sums[r][l] += factors[r] * line[l];
            }
        }
    }
    for (r, sum) in sums.iter().enumerate() {
        out[(i + r) * b.cols + j..(i + r) * b.cols + j + COLS].copy_from_slice(sum);
    }
}

#[inline(always)]
fn stripe_transposed<const COLS: usize>(a: Matrix<'_>, b: Matrix<'_>, out: &mut [f32], j: usize) {
    let mut i = 0;
    while i + 4 <= a.cols {
        tile_transposed::<4, COLS>(a, b, out, i, j);
        i += 4;
    }
    while i < a.cols {
        tile_transposed::<1, COLS>(a, b, out, i, j);
        i += 1;
    }
}

/// `C = Aᵀ·B` with A `[k, m]`, B `[k, n]`, C `[m, n]`: the gradient of a weight matrix.
#[inline(always)]
pub(super) fn product_transposed_body<const WIDE: usize>(a: Matrix<'_>, b: Matrix<'_>, out: &mut [f32]) {
    assert_eq!(a.rows, b.rows, "inner sizes of a product agree");
    let mut j = 0;
    while j + WIDE <= b.cols {
        stripe_transposed::<WIDE>(a, b, out, j);
        j += WIDE;
    }
    while j + 16 <= b.cols {
        stripe_transposed::<16>(a, b, out, j);
        j += 16;
    }
    while j + 4 <= b.cols {
        stripe_transposed::<4>(a, b, out, j);
        j += 4;
    }
    while j < b.cols {
        stripe_transposed::<1>(a, b, out, j);
        j += 1;
    }
}

#[inline(always)]
fn sum_block<const COLS: usize>(rows: Matrix<'_>, indices: &[u32], bias: &[f32], out: &mut [f32], j: usize) {
    let mut sum: [f32; COLS] = bias[j..j + COLS].try_into().expect("a full block");
    for &index in indices {
        let at = index as usize * rows.cols + j;
        let row: &[f32; COLS] = rows.data[at..at + COLS].try_into().expect("a full block");
        for l in 0..COLS {
            sum[l] += row[l];
        }
    }
    for l in 0..COLS {
        out[j + l] = if sum[l] < 0.0 { 0.0 } else { sum[l] };
    }
}

/// `out = relu(bias + Σ rows[index])`: the first layer on an input of zeros and ones, whose ones stand
/// at `indices` (ascending). The same bits as the product with the input written out.
#[inline(always)]
pub(super) fn sum_rows_body<const WIDE: usize>(rows: Matrix<'_>, indices: &[u32], bias: &[f32], out: &mut [f32]) {
    let mut j = 0;
    while j + WIDE <= rows.cols {
        sum_block::<WIDE>(rows, indices, bias, out, j);
        j += WIDE;
    }
    while j < rows.cols {
        sum_block::<1>(rows, indices, bias, out, j);
        j += 1;
    }
}

/// `rows[index] += add` for every index: the first layer's gradient for one input row.
#[inline(always)]
pub(super) fn add_to_rows_body(rows: &mut [f32], indices: &[u32], add: &[f32]) {
    for &index in indices {
        let at = index as usize * add.len();
        for (sum, x) in rows[at..at + add.len()].iter_mut().zip(add) {
            *sum += x;
        }
    }
}

/// Independent chains of a multiplication and an addition, for measuring what the machine can do at most
/// without fusing them: `rounds` passes over the lanes of `x`, two operations per lane and pass.
#[inline(always)]
pub(super) fn probe_body(rounds: usize, x: &mut [f32; PROBE_LANES]) {
    let mut lanes = *x;
    for _ in 0..rounds {
        for lane in &mut lanes {
            *lane = *lane * 0.999 + 0.001;
        }
    }
    *x = lanes;
}

/// `out[c, r] = a[r, c]`, in blocks of four by four.
#[inline(always)]
pub(super) fn transpose_body(a: Matrix<'_>, out: &mut [f32]) {
    const BLOCK: usize = 4;
    let (rows, cols) = (a.rows, a.cols);
    let (whole_rows, whole_cols) = (rows - rows % BLOCK, cols - cols % BLOCK);
    for c in (0..whole_cols).step_by(BLOCK) {
        for r in (0..whole_rows).step_by(BLOCK) {
            let block: [[f32; BLOCK]; BLOCK] = core::array::from_fn(|i| {
                let at = (r + i) * cols + c;
                a.data[at..at + BLOCK].try_into().expect("a full block")
            });
            for j in 0..BLOCK {
                let column: [f32; BLOCK] = core::array::from_fn(|i| block[i][j]);
                out[(c + j) * rows + r..(c + j) * rows + r + BLOCK].copy_from_slice(&column);
            }
        }
    }
    for r in 0..rows {
        for c in if r < whole_rows { whole_cols..cols } else { 0..cols } {
            out[c * rows + r] = a.data[r * cols + c];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::isa::{self, Isa};
    use crate::rng::Rng;
    use alloc::vec;
    use alloc::vec::Vec;

    fn random(len: usize, rng: &mut Rng) -> Vec<f32> {
        (0..len).map(|_| rng.uniform() - 0.5).collect()
    }

    fn bits(x: &[f32]) -> Vec<u32> {
        x.iter().map(|v| v.to_bits()).collect()
    }

    /// The definition, one output after the other.
    fn plain(
        m: usize,
        n: usize,
        k: usize,
        a: impl Fn(usize, usize) -> f32,
        b: &[f32],
        bias: Option<&[f32]>,
    ) -> Vec<f32> {
        let mut c = vec![0.0; m * n];
        for i in 0..m {
            for j in 0..n {
                let mut sum = bias.map_or(0.0, |bias| bias[j]);
                for kk in 0..k {
                    sum += a(i, kk) * b[kk * n + j];
                }
                c[i * n + j] = sum;
            }
        }
        c
    }

    #[test]
    fn every_vector_unit_gives_the_bits_of_the_definition() {
        let mut rng = Rng::new(3);
        assert!(Isa::supported().count() >= 1);
        for (m, n, k) in [(1, 1, 1), (3, 4, 5), (33, 128, 128), (7, 149, 11), (32, 2, 128), (64, 70, 33)] {
            let (a, b, bias) = (random(m * k, &mut rng), random(k * n, &mut rng), random(n, &mut rng));
            let at: Vec<f32> = (0..k * m).map(|i| a[(i % m) * k + i / m]).collect();
            let expected = plain(m, n, k, |i, kk| a[i * k + kk], &b, Some(&bias));
            let expected_t = plain(m, n, k, |i, kk| a[i * k + kk], &b, None);
            for isa in Isa::supported() {
                let mut c = vec![f32::NAN; m * n];
                let out = Output { data: &mut c, bias: Some(&bias), relu: false };
                isa::product(isa, Matrix::new(&a, m, k), Matrix::new(&b, k, n), out);
                assert_eq!(bits(&c), bits(&expected), "{isa:?} {m} {n} {k}");
                isa::product_transposed(isa, Matrix::new(&at, k, m), Matrix::new(&b, k, n), &mut c);
                assert_eq!(bits(&c), bits(&expected_t), "{isa:?} {m} {n} {k} transposed");
            }
        }
    }

    #[test]
    fn sums_of_rows_equal_the_product_with_ones_and_zeros() {
        let mut rng = Rng::new(4);
        for (width, n, indices) in [(11, 128, vec![2u32, 7, 10]), (288, 70, vec![0, 5, 6, 287]), (9, 3, vec![])] {
            let (weights, bias) = (random(width * n, &mut rng), random(n, &mut rng));
            let mut input = vec![0.0; width];
            indices.iter().for_each(|&i| input[i as usize] = 1.0);
            for isa in Isa::supported() {
                let (mut dense, mut sparse) = (vec![0.0; n], vec![0.0; n]);
                let out = Output { data: &mut dense, bias: Some(&bias), relu: true };
                isa::product(isa, Matrix::new(&input, 1, width), Matrix::new(&weights, width, n), out);
                isa::sum_rows(isa, Matrix::new(&weights, width, n), &indices, &bias, &mut sparse);
                assert_eq!(bits(&dense), bits(&sparse), "{isa:?}");
                let mut grads = vec![1.0; width * n];
                isa::add_to_rows(isa, &mut grads, &indices, &bias);
                for (row, chunk) in grads.chunks(n).enumerate() {
                    let active = indices.contains(&(row as u32));
                    assert!(chunk.iter().zip(&bias).all(|(g, b)| *g == if active { 1.0 + b } else { 1.0 }));
                }
            }
        }
    }

    #[test]
    fn transposes() {
        for (rows, cols) in [(2, 3), (8, 4), (13, 22), (128, 2), (1, 1)] {
            let a: Vec<f32> = (0..rows * cols).map(|i| i as f32).collect();
            for isa in Isa::supported() {
                let mut t = vec![-1.0; rows * cols];
                isa::transpose(isa, Matrix::new(&a, rows, cols), &mut t);
                assert!((0..rows * cols).all(|i| t[(i % cols) * rows + i / cols] == a[i]), "{rows} x {cols}");
            }
        }
    }
}
