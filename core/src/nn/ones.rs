//! The first layer on inputs of zeros and ones, forwards and backwards: products that are sums of rows.

use alloc::vec::Vec;

use super::gemm::{Matrix, WORD, lanes, load, store};
use super::isa::{Lanes, One};
use super::rows::Rows;

/// A row of zeros and ones in the order in which its sums are made.
#[derive(Clone, Copy, Debug)]
struct Visit {
    /// Which row of the batch.
    row: usize,
    /// Its first ones that are those of the row before it, too.
    shared: usize,
}

/// The rows of a batch in an order in which neighbours begin alike: what their sums have in common is summed once.
#[derive(Clone, Debug, Default)]
pub struct Visits {
    visits: Vec<Visit>,
    /// The first ones behind what all rows share, and the row.
    keys: Vec<(u64, u32)>,
}

/// Ones of a key.
const KEY: usize = 4;

impl Visits {
    /// The order for a batch of zeros and ones.
    pub(super) fn order(&mut self, rows: &Rows) -> &Self {
        let alike = |a: &[u32], b: &[u32]| a.iter().zip(b).take_while(|(a, b)| a == b).count();
        let first = if rows.is_empty() { &[] } else { rows.ones(0) };
        let all = (1..rows.len()).map(|row| alike(first, rows.ones(row))).min().unwrap_or(0);
        self.keys.clear();
        self.keys.extend((0..rows.len()).map(|row| {
            let mut ones = rows.ones(row)[all..].iter();
            // Positions beyond 16 bits share keys, which costs time alone.
            let key =
                (0..KEY).fold(0, |key, _| key << 16 | ones.next().map_or(0, |&one| u64::from((one + 1) & 0xffff)));
            (key, row as u32)
        }));
        self.keys.sort_unstable();
        self.visits.clear();
        let mut last: &[u32] = &[];
        self.visits.extend(self.keys.iter().map(|&(_, row)| {
            let ones = rows.ones(row as usize);
            let shared = alike(last, ones);
            last = ones;
            Visit { row: row as usize, shared }
        }));
        self
    }
}

/// Sums that are kept for rows to come, besides the bias.
const KEPT: usize = 7;

/// Adds the columns `j..` of the rows that are one.
#[inline(always)]
fn add_rows<L: Lanes, const VECTORS: usize>(
    mut sums: [L::Vector; VECTORS],
    weights: Matrix<'_>,
    ones: &[u32],
    j: usize,
) -> [L::Vector; VECTORS] {
    for &one in ones {
        let at = one as usize * weights.cols + j;
        let row = &weights.data[at..at + VECTORS * lanes::<L>()];
        for (v, sum) in sums.iter_mut().enumerate() {
            *sum = L::add(*sum, L::load(&row[v * lanes::<L>()..]));
        }
    }
    sums
}

#[inline(always)]
fn sum_block<L: Lanes, const VECTORS: usize>(
    weights: Matrix<'_>,
    (rows, visits): (&Rows, &[Visit]),
    bias: &[f32],
    out: &mut [f32],
    j: usize,
) {
    let width = VECTORS * lanes::<L>();
    // Sums of the first ones, each entry of more of them than the one before: where in the row, and the sums.
    let mut kept = [(0, load::<L, VECTORS>(&bias[j..])); 1 + KEPT];
    let mut last = 0;
    for (visit, next) in visits.iter().zip(visits.iter().skip(1).map(|next| next.shared).chain([0])) {
        while kept[last].0 > visit.shared {
            last -= 1;
        }
        let (mut done, mut sums) = kept[last];
        let ones = rows.ones(visit.row);
        if next > done && last < KEPT {
            sums = add_rows::<L, VECTORS>(sums, weights, &ones[done..next], j);
            done = next;
            last += 1;
            kept[last] = (done, sums);
        }
        sums = add_rows::<L, VECTORS>(sums, weights, &ones[done..], j);
        let line = &mut out[visit.row * weights.cols + j..][..width];
        store::<L, VECTORS>(&sums.map(L::relu), line);
    }
}

/// `out[row] = relu(bias + Σ weights[one])` over the ascending ones of every row of a batch. The same bits as the product
/// with the inputs written out, in whatever order the rows are visited.
#[inline(always)]
pub(super) fn sum_rows_body<L: Lanes, const VECTORS: usize>(
    weights: Matrix<'_>,
    rows: &Rows,
    visits: &Visits,
    bias: &[f32],
    out: &mut [f32],
) {
    let batch = (rows, &visits.visits[..]);
    let mut j = 0;
    while j + VECTORS * lanes::<L>() <= weights.cols {
        sum_block::<L, VECTORS>(weights, batch, bias, out, j);
        j += VECTORS * lanes::<L>();
    }
    while j + lanes::<L>() <= weights.cols {
        sum_block::<L, 1>(weights, batch, bias, out, j);
        j += lanes::<L>();
    }
    while j < weights.cols {
        sum_block::<One, 1>(weights, batch, bias, out, j);
        j += 1;
    }
}

#[inline(always)]
fn marked_block<L: Lanes, const VECTORS: usize>(rows: Matrix<'_>, marks: &[u64], out: &mut [f32], j: usize) {
    let mut sums = [L::splat(0.0); VECTORS];
    for (word, &mask) in marks.iter().enumerate() {
        let mut mask = mask;
        while mask != 0 {
            let at = (WORD * word + mask.trailing_zeros() as usize) * rows.cols + j;
            mask &= mask - 1;
            let row = &rows.data[at..at + VECTORS * lanes::<L>()];
            for (v, sum) in sums.iter_mut().enumerate() {
                *sum = L::add(*sum, L::load(&row[v * lanes::<L>()..]));
            }
        }
    }
    store::<L, VECTORS>(&sums, &mut out[j..]);
}

/// `out = Σ rows[r]` over the rows whose bit is set in `marks`, in ascending order: the first layer's gradient for an
/// input of zeros and ones, where the marks are the samples in which it is one.
#[inline(always)]
pub(super) fn sum_marked_body<L: Lanes, const WIDE: usize>(rows: Matrix<'_>, marks: &[u64], out: &mut [f32]) {
    let mut j = 0;
    while j + WIDE * lanes::<L>() <= rows.cols {
        marked_block::<L, WIDE>(rows, marks, out, j);
        j += WIDE * lanes::<L>();
    }
    while j + lanes::<L>() <= rows.cols {
        marked_block::<L, 1>(rows, marks, out, j);
        j += lanes::<L>();
    }
    while j < rows.cols {
        marked_block::<One, 1>(rows, marks, out, j);
        j += 1;
    }
}

#[cfg(test)]
mod tests {
    use alloc::vec;
    use alloc::vec::Vec;

    use super::super::gemm::{Factors, Finish, Output};
    use super::super::isa::{self, Isa};
    use super::*;
    use crate::env::ObservationSpec;
    use crate::rng::Rng;

    fn random(count: usize, rng: &mut Rng) -> Vec<f32> {
        (0..count).map(|_| rng.uniform() - 0.5).collect()
    }

    fn bits(values: &[f32]) -> Vec<u32> {
        values.iter().map(|x| x.to_bits()).collect()
    }

    /// A batch of these rows, and the same written out.
    fn batch(width: usize, lists: &[Vec<u32>]) -> (Rows, Vec<f32>) {
        let mut rows = Rows::new(ObservationSpec { width, binary: true });
        let mut dense = vec![0.0; lists.len() * width];
        for (row, list) in lists.iter().enumerate() {
            rows.push(list);
            list.iter().for_each(|&one| dense[row * width + one as usize] = 1.0);
        }
        (rows, dense)
    }

    #[test]
    fn sums_of_rows_equal_the_product_with_ones_and_zeros() {
        let mut rng = Rng::new(4);
        // Rows that begin alike, up to all of a row and deeper than is kept, that repeat, and that are empty.
        let stairs: Vec<Vec<u32>> = (0..12).map(|n| (0..n).chain([40 + n]).collect()).collect();
        let some: Vec<Vec<u32>> =
            (0..45).map(|_| (0..288).filter(|one| one % 6 == 0 || rng.below(8) == 0).collect()).collect();
        let far = vec![vec![1, 70_000], vec![1, 70_001], vec![1 + 65_536], vec![]];
        let cases = [
            (11, 128, vec![vec![2u32, 7, 10]]),
            (288, 70, vec![vec![0, 5, 6, 287], vec![0, 5], vec![0, 5, 6], vec![], vec![0, 5, 6, 287]]),
            (60, 128, stairs.iter().chain(stairs.iter().rev()).cloned().collect()),
            (288, 133, some),
            (70_002, 9, far),
            (9, 3, vec![vec![]]),
            (9, 3, vec![]),
        ];
        for (width, n, lists) in cases {
            let (weights, bias) = (random(width * n, &mut rng), random(n, &mut rng));
            let (rows, input) = batch(width, &lists);
            let mut visits = Visits::default();
            visits.order(&rows);
            let (count, weights) = (lists.len(), Matrix::new(&weights, width, n));
            for isa in Isa::supported() {
                let (mut dense, mut sparse) = (vec![0.0; count * n], vec![f32::NAN; count * n]);
                let out = Output { data: &mut dense, bias: Some(&bias), finish: Finish::Relu };
                isa::product(isa, Factors::Dense, Matrix::new(&input, count, width), weights, out);
                isa::sum_rows(isa, weights, &rows, &visits, &bias, &mut sparse);
                assert_eq!(bits(&dense), bits(&sparse), "{isa:?} {width} {n}");
            }
        }
    }

    #[test]
    fn neighbours_begin_alike() {
        let lists = [vec![0, 1, 5, 9], vec![0, 1, 6], vec![0, 1, 5, 8], vec![0, 1, 6, 7]];
        let mut visits = Visits::default();
        visits.order(&batch(10, &lists).0);
        let order: Vec<_> = visits.visits.iter().map(|visit| (visit.row, visit.shared)).collect();
        assert_eq!(order, [(2, 0), (0, 3), (1, 2), (3, 3)]);
    }

    #[test]
    fn marked_rows_are_summed_in_order() {
        let mut rng = Rng::new(6);
        for (count, n) in [(3, 128), (70, 45), (64, 3)] {
            let rows = random(count * n, &mut rng);
            let marks: Vec<u64> = (0..count.div_ceil(WORD)).map(|_| rng.next_u64()).collect();
            let marked = |r: usize| r < count && marks[r / WORD] >> (r % WORD) & 1 == 1;
            let marks: Vec<u64> =
                (0..marks.len()).map(|w| (0..WORD).filter(|b| marked(WORD * w + b)).map(|b| 1 << b).sum()).collect();
            let expected: Vec<f32> =
                (0..n).map(|c| (0..count).filter(|&r| marked(r)).fold(0.0, |sum, r| sum + rows[r * n + c])).collect();
            for isa in Isa::supported() {
                let mut out = vec![f32::NAN; n];
                isa::sum_marked(isa, Matrix::new(&rows, count, n), &marks, &mut out);
                assert_eq!(bits(&out), bits(&expected), "{isa:?} {count} {n}");
            }
        }
    }
}
