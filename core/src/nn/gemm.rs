//! The only matrix products. Each output sums its terms in ascending order of the reduction index,
//! starting from its bias or from zero, without fused multiply-add: tile sizes and vector widths change
//! the speed and no bit. [`super::isa`] compiles these loops for each vector unit.
//!
//! # Zeros left out
//! Behind a ReLU about half of the left factors are zero, and so are as many derivatives on the way back.
//! [`Factors::Sparse`] leaves terms out that are zero in all rows of a tile: a zero times a finite number is a zero,
//! which changes no bit of a sum unless that is -0. No sum is: -0 comes only from adding two of them, and a sum starts
//! from +0 or from a bias, which is not -0 at first nor after any step of the optimiser, for the same reason. (Where a
//! weight is not finite, the learner has diverged, and only then do vector units of different tiles differ.)
//!
//! How many rows a tile has is a matter of the machine. Observations of one world are alike, so units are mostly active
//! in all rows or in none: in the paper's worlds six rows together use 46 to 88 % of the terms where each alone uses 43
//! to 63 %. With 8 lanes and 16 registers tiles of six rows pay, since what is loaded serves all of them; with 32
//! registers or with 4 lanes one row at a time, whose sums fill the registers, is faster.

use alloc::vec::Vec;
use core::array::from_fn;

use arrayvec::ArrayVec;

use super::buffer::Buffer;
use super::isa::{Baseline, Lanes, One};

/// Chains that [`super::isa::probe`] runs side by side: enough to hide every latency, few enough for 16 registers.
const PROBE_CHAINS: usize = 14;
/// Lanes of [`super::isa::probe`]: those chains in the widest vectors.
pub const PROBE_LANES: usize = 16 * PROBE_CHAINS;

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

/// What is known about the left matrix of a product. Results do not depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Factors {
    /// Few zeros.
    Dense,
    /// Many zeros, worth looking for.
    Sparse,
}

/// What becomes of a sum.
#[derive(Clone, Copy)]
pub enum Finish<'a> {
    /// It stays.
    Plain,
    /// Zero if it is negative; what is not a number stays one.
    Relu,
    /// Zero where this matrix of the same shape is not positive: the derivative of a ReLU whose outputs
    /// it holds.
    Where(&'a [f32]),
}

impl Finish<'_> {
    /// On the sums that were stored at `at`. In memory and not in registers: a choice between the two is
    /// what keeps compilers from holding the sums in registers at all.
    #[inline(always)]
    fn apply<L: Lanes>(self, sums: &mut [f32], at: usize) {
        match self {
            Finish::Plain => {}
            Finish::Relu => L::relu_all(sums),
            Finish::Where(active) => L::keep(sums, &active[at..at + sums.len()]),
        }
    }
}

/// Where a product goes, and what surrounds it.
pub struct Output<'a> {
    /// Receives `rows · cols` numbers, row-major.
    pub data: &'a mut [f32],
    /// First term of every sum, one per column; zero without.
    pub bias: Option<&'a [f32]>,
    /// Last thing done to every sum.
    pub finish: Finish<'a>,
}

/// Numbers in a vector.
pub(super) const fn lanes<L: Lanes>() -> usize {
    size_of::<L::Vector>() / size_of::<f32>()
}

#[inline(always)]
pub(super) fn load<L: Lanes, const VECTORS: usize>(from: &[f32]) -> [L::Vector; VECTORS] {
    let mut all = [L::splat(0.0); VECTORS];
    for (v, vector) in all.iter_mut().enumerate() {
        *vector = L::load(&from[v * lanes::<L>()..]);
    }
    all
}

#[inline(always)]
pub(super) fn store<L: Lanes, const VECTORS: usize>(vectors: &[L::Vector; VECTORS], to: &mut [f32]) {
    for (v, vector) in vectors.iter().enumerate() {
        L::store(*vector, &mut to[v * lanes::<L>()..]);
    }
}

/// First terms of the sums of columns `j..`.
#[inline(always)]
fn start<L: Lanes, const VECTORS: usize>(bias: Option<&[f32]>, j: usize) -> [L::Vector; VECTORS] {
    match bias {
        Some(bias) => load::<L, VECTORS>(&bias[j..]),
        None => [L::splat(0.0); VECTORS],
    }
}

/// Bits of a mask.
pub(super) const WORD: usize = u64::BITS as usize;
/// Terms of a mask, one number each.
type Word = [f32; WORD];
/// Words of a row that are used before the next ones, where a tile is one row: its stripe is so wide that more rows of
/// the right matrix than these would not stay in the first cache. Tiles of several rows have narrow stripes.
const fn words(rows: usize) -> usize {
    if rows == 1 { 1 } else { WORDS }
}
/// The most words that are used before the next ones.
const WORDS: usize = 2;

/// Columns for which the products are compiled once more: units of a layer of the paper's learners in gridworlds.
const UNITS: usize = 128;

/// Bit `l` is set where number `l` of one of the rows is not zero.
#[inline(always)]
fn mask<L: Lanes, const ROWS: usize>(rows: [&Word; ROWS]) -> u64 {
    let mut mask = 0;
    for i in 0..WORD / 16 {
        // Loops and no `from_fn`, which would become a function of its own without this vector unit.
        let mut bits = [0; 16];
        for row in rows {
            for (bits, x) in bits.iter_mut().zip(&row[16 * i..16 * i + 16]) {
                *bits |= x.to_bits();
            }
        }
        let mut any = [0.0; 16];
        for (any, bits) in any.iter_mut().zip(bits) {
            // Without the sign: both zeros are zero.
            *any = f32::from_bits(bits & !(1 << 31));
        }
        mask |= u64::from(L::nonzero(&any)) << (16 * i);
    }
    mask
}

/// A block of terms of the sums of some rows.
struct Terms<'a> {
    /// Columns of the product.
    cols: usize,
    /// The first terms of all, in the first block: a bias or zeros.
    begin: Option<Option<&'a [f32]>>,
    /// What is done to the sums after the last block.
    finish: Option<Finish<'a>>,
}

impl<'a> Terms<'a> {
    /// A block of the terms of `out`.
    #[inline(always)]
    fn block(out: &Output<'a>, first: bool, last: bool, cols: usize) -> Self {
        Self { cols, begin: first.then_some(out.bias), finish: last.then_some(out.finish) }
    }
}

/// The left factors of some rows, without terms that are zero in all of them.
trait Left<const ROWS: usize> {
    /// Adds the terms to the sums of the columns `j..` of `right`, a block of rows.
    fn add<L: Lanes, const VECTORS: usize>(&self, right: Matrix<'_>, j: usize, sums: &mut [[L::Vector; VECTORS]; ROWS]);
}

/// A row: word by word, with the terms of each that are not zero. Where the compiler knows the distance of the right
/// matrix's rows (`COLS`, zero where it does not), it need not ask for every one whether it is there.
struct Row<'a, const COLS: usize> {
    words: &'a [Word],
    masks: &'a [u64],
}

impl<const COLS: usize> Left<1> for Row<'_, COLS> {
    #[inline(always)]
    fn add<L: Lanes, const VECTORS: usize>(&self, right: Matrix<'_>, j: usize, sums: &mut [[L::Vector; VECTORS]; 1]) {
        let width = VECTORS * lanes::<L>();
        for (word, (row, &mask)) in self.words.iter().zip(self.masks).enumerate() {
            let mut mask = mask;
            while mask != 0 {
                // At most 63, which the compiler is told.
                let k = mask.trailing_zeros() as usize % WORD;
                mask &= mask - 1;
                let term = WORD * word + k;
                let line = match COLS {
                    0 => &right.data[term * right.cols + j..][..width],
                    _ => &right.data.as_chunks::<COLS>().0[term][j..][..width],
                };
                let line = load::<L, VECTORS>(line);
                let factor = L::splat(row[k]);
                for (sum, right) in sums[0].iter_mut().zip(line) {
                    *sum = L::add_product(*sum, factor, right);
                }
            }
        }
    }
}

/// A term of several rows: the factor of each, and where the right factors begin.
#[derive(Clone, Copy)]
struct Term<const ROWS: usize> {
    factors: [f32; ROWS],
    right: u32,
}

/// As many terms as are used before the next ones.
type List<const ROWS: usize> = ArrayVec<Term<ROWS>, { WORDS * WORD }>;

impl<const ROWS: usize> Term<ROWS> {
    /// Lists the terms that are not zero in all of some rows; their right factors are `cols` apart. Their bits are set
    /// in `active`.
    #[inline(always)]
    fn list<L: Lanes>(rows: [&[Word]; ROWS], cols: usize, list: &mut List<ROWS>, active: &mut [u64; WORDS]) {
        list.clear();
        for word in 0..rows[0].len() {
            let words = rows.map(|row| &row[word]);
            let mut mask = mask::<L, ROWS>(words);
            active[word] |= mask;
            while mask != 0 {
                let k = mask.trailing_zeros() as usize % WORD;
                mask &= mask - 1;
                list.push(Self { factors: words.map(|row| row[k]), right: ((WORD * word + k) * cols) as u32 });
            }
        }
    }
}

/// Several rows, all those of a list or the first: the factors of a term side by side, one term after the other.
struct Rows<'a, const ROWS: usize>(&'a [Term<ROWS>]);

impl<const ROWS: usize, const OF: usize> Left<ROWS> for Rows<'_, OF> {
    #[inline(always)]
    fn add<L: Lanes, const VECTORS: usize>(
        &self,
        right: Matrix<'_>,
        j: usize,
        sums: &mut [[L::Vector; VECTORS]; ROWS],
    ) {
        let right = &right.data[j..];
        for term in self.0 {
            let at = term.right as usize;
            let line = load::<L, VECTORS>(&right[at..at + VECTORS * lanes::<L>()]);
            for (factor, sums) in term.factors.iter().zip(&mut *sums) {
                let factor = L::splat(*factor);
                for (sum, right) in sums.iter_mut().zip(line) {
                    *sum = L::add_product(*sum, factor, right);
                }
            }
        }
    }
}

/// Working memory of products. What it holds between them is of no account.
#[derive(Clone, Debug, Default)]
pub struct Work {
    /// Columns of a left matrix as rows, zero beyond the first `samples` numbers of each.
    columns: Vec<Word>,
    samples: usize,
    /// A right matrix with rows for columns.
    transposed: Buffer,
}

impl Work {
    /// Room for as many columns as a word has bits, of `samples` numbers each; the rest of each is zero.
    fn columns(&mut self, samples: usize) -> &mut [Word] {
        if samples < self.samples {
            self.columns.clear();
        }
        self.samples = samples;
        self.columns.resize(WORD, [0.0; WORD]);
        &mut self.columns
    }
}

/// Adds the terms to the sums of the columns `j..` of the rows `at` of `out`. Their right factors are the columns `from..`
/// of `right`.
// A function of its own in wasm: compilers of browsers allot registers better in small functions, and sooner.
#[cfg_attr(target_arch = "wasm32", inline(never))]
#[cfg_attr(not(target_arch = "wasm32"), inline(always))]
fn sparse_tile<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    terms: &Terms<'_>,
    left: &impl Left<ROWS>,
    (right, from): (Matrix<'_>, usize),
    at: [usize; ROWS],
    out: &mut [f32],
    j: usize,
) {
    let places = at.map(|row| row * terms.cols + j);
    let mut sums = [[L::splat(0.0); VECTORS]; ROWS];
    match terms.begin {
        Some(bias) => sums = [start::<L, VECTORS>(bias, j); ROWS],
        None => {
            for (sums, &at) in sums.iter_mut().zip(&places) {
                *sums = load::<L, VECTORS>(&out[at..at + VECTORS * lanes::<L>()]);
            }
        }
    }
    left.add::<L, VECTORS>(right, from, &mut sums);
    for (sums, &at) in sums.iter().zip(&places) {
        let line = &mut out[at..at + VECTORS * lanes::<L>()];
        store::<L, VECTORS>(sums, line);
        if let Some(finish) = terms.finish {
            finish.apply::<L>(line, at);
        }
    }
}

/// The same for as many columns as stripes of `VECTORS` vectors and of `LAST` for 32 columns take.
#[inline(always)]
fn sparse_stripes<L: Lanes, const ROWS: usize, const VECTORS: usize, const LAST: usize>(
    terms: &Terms<'_>,
    left: &impl Left<ROWS>,
    right: Matrix<'_>,
    at: [usize; ROWS],
    out: &mut [f32],
) {
    let whole = terms.cols - terms.cols % 32;
    let width = VECTORS * lanes::<L>();
    let mut j = 0;
    while j + width <= whole {
        sparse_tile::<L, ROWS, VECTORS>(terms, left, (right, j), at, out, j);
        j += width;
    }
    if width > 32 {
        while j + 32 <= whole {
            sparse_tile::<L, ROWS, LAST>(terms, left, (right, j), at, out, j);
            j += 32;
        }
    }
}

/// Columns of a panel, at most.
const PANEL: usize = 16;
/// Tiles whose terms are listed before a panel is made.
const GROUPS: usize = 16;
/// So many tiles are worth a panel of rows as they are; one of columns is made for fewer.
const PANELS_FROM: usize = 3;
/// So few rows are no tile: each is computed alone, or both in a tile of two where there is a panel.
const FEW: usize = 2;

/// Some rows and their places.
#[inline(always)]
fn gather<'a, const ROWS: usize>(
    row: impl Fn(usize) -> &'a [Word],
    at: impl Fn(usize) -> usize,
) -> ([&'a [Word]; ROWS], [usize; ROWS]) {
    let (mut rows, mut places) = ([&[][..]; ROWS], [0; ROWS]);
    for (r, (words, place)) in rows.iter_mut().zip(&mut places).enumerate() {
        (*words, *place) = (row(r), at(r));
    }
    (rows, places)
}

/// Where the right factors of a block of terms are.
#[derive(Clone, Copy)]
enum Right<'a> {
    /// A row for every term.
    Rows(Matrix<'a>),
    /// A column for every term, from this one on.
    Columns(Matrix<'a>, usize),
}

impl Right<'_> {
    /// Writes the right factors of the columns `j..` of the product side by side, those of all terms whose bit is set.
    #[inline(always)]
    fn write<L: Lanes, const VECTORS: usize>(self, active: &[u64; WORDS], j: usize, panel: &mut [f32]) {
        let (side, width) = (lanes::<L>(), VECTORS * lanes::<L>());
        for (word, &mask) in active.iter().enumerate() {
            let mut mask = mask;
            while mask != 0 {
                let k = mask.trailing_zeros() as usize % WORD;
                let term = WORD * word + k;
                match self {
                    Right::Rows(Matrix { data, cols, .. }) => {
                        mask &= mask - 1;
                        let line = load::<L, VECTORS>(&data[term * cols + j..]);
                        store::<L, VECTORS>(&line, &mut panel[term * width..]);
                    }
                    Right::Columns(Matrix { data, cols, .. }, first) => {
                        // All of a square at once.
                        let square = k - k % side;
                        mask &= !(((1 << side) - 1) << square);
                        let term = WORD * word + square;
                        for v in 0..VECTORS {
                            let from = &data[(j + v * side) * cols + first + term..];
                            L::transpose(from, cols, &mut panel[term * width + v * side..], width);
                        }
                    }
                }
            }
        }
    }
}

/// As [`sparse_stripes`], for several tiles of rows. For each stripe the right factors that any of them needs are
/// written side by side: rows of a matrix that are a power of two apart share few places of the first cache, and would
/// drive one another out.
#[inline(always)]
fn sparse_panels<'a, L: Lanes, const ROWS: usize, const VECTORS: usize>(
    terms: &Terms<'_>,
    right: Right<'_>,
    count: usize,
    row: impl Fn(usize) -> &'a [Word],
    at: impl Fn(usize) -> usize,
    out: &mut [f32],
) {
    let (width, groups) = (VECTORS * lanes::<L>(), count.div_ceil(ROWS));
    const { assert!(ROWS == 1 || VECTORS * lanes::<L>() <= PANEL && 32 % (VECTORS * lanes::<L>()) == 0) };
    let mut lists: [List<ROWS>; GROUPS] = from_fn(|_| List::new());
    let (mut places, mut active) = ([[0; ROWS]; GROUPS], [0; WORDS]);
    for g in 0..groups {
        // Where rows are missing, the last one is computed again.
        let place = |r: usize| (g * ROWS + r).min(count - 1);
        let rows;
        (rows, places[g]) = gather(|r| row(place(r)), |r| at(place(r)));
        Term::list::<L>(rows, width, &mut lists[g], &mut active);
    }
    let mut panel = [0.0; WORDS * WORD * PANEL];
    let mut j = 0;
    while j + width <= terms.cols - terms.cols % 32 {
        right.write::<L, VECTORS>(&active, j, &mut panel);
        let right = (Matrix { data: &panel, rows: WORDS * WORD, cols: width }, 0);
        for g in 0..groups {
            let left = Rows(&lists[g]);
            if count - g * ROWS <= FEW {
                let places = [places[g][0], places[g][1 % ROWS]];
                sparse_tile::<L, FEW, VECTORS>(terms, &left, right, places, out, j);
            } else {
                sparse_tile::<L, ROWS, VECTORS>(terms, &left, right, places[g], out, j);
            }
        }
        j += width;
    }
}

/// The sums of some rows of the output, those at `at`, whose factors are `rows`: many with panels, others in tiles, and
/// few one by one.
#[inline(always)]
fn sparse_rows<'a, L: Lanes, const ROWS: usize, const VECTORS: usize, const LAST: usize>(
    terms: &Terms<'_>,
    right: Matrix<'_>,
    count: usize,
    row: impl Fn(usize) -> &'a [Word],
    at: impl Fn(usize) -> usize,
    out: &mut [f32],
) {
    let mut masks = [0; WORDS];
    let mut list = List::new();
    let mut i = 0;
    while i < count {
        let left = count - i;
        if ROWS > 1 && left >= PANELS_FROM * ROWS {
            let rows = left.min(GROUPS * ROWS);
            sparse_panels::<L, ROWS, VECTORS>(terms, Right::Rows(right), rows, |r| row(i + r), |r| at(i + r), out);
            i += rows;
            continue;
        }
        if ROWS == 1 || left <= FEW {
            let words = row(i);
            let masks = &mut masks[..words.len()];
            masks.iter_mut().zip(words).for_each(|(mask, word)| *mask = self::mask::<L, 1>([word]));
            let at = [at(i)];
            match (ROWS, terms.cols) {
                (1, UNITS) => {
                    sparse_stripes::<L, 1, VECTORS, LAST>(terms, &Row::<UNITS> { words, masks }, right, at, out);
                }
                (1, _) => sparse_stripes::<L, 1, VECTORS, LAST>(terms, &Row::<0> { words, masks }, right, at, out),
                (_, UNITS) => sparse_stripes::<L, 1, LAST, LAST>(terms, &Row::<UNITS> { words, masks }, right, at, out),
                _ => sparse_stripes::<L, 1, LAST, LAST>(terms, &Row::<0> { words, masks }, right, at, out),
            }
            i += 1;
            continue;
        }
        // Where rows are missing, the last one is computed again.
        let place = |r: usize| (i + r).min(count - 1);
        let (rows, places) = gather(|r| row(place(r)), |r| at(place(r)));
        Term::list::<L>(rows, terms.cols, &mut list, &mut [0; WORDS]);
        sparse_stripes::<L, ROWS, VECTORS, LAST>(terms, &Rows::<ROWS>(&list), right, places, out);
        i += ROWS;
    }
}

/// Sums without the terms that are zero in all rows of a tile, in all columns but the last, fewer than 32; returns how
/// many columns have theirs.
#[inline(always)]
fn sparse<L: Lanes, const ROWS: usize, const VECTORS: usize, const LAST: usize>(
    a: Matrix<'_>,
    b: Matrix<'_>,
    out: &mut Output<'_>,
) -> usize {
    let words = words(ROWS);
    for k in (0..a.cols).step_by(words * WORD) {
        let end = a.cols.min(k + words * WORD);
        let right = Matrix { data: &b.data[k * b.cols..end * b.cols], rows: end - k, cols: b.cols };
        let terms = Terms::block(out, k == 0, end == a.cols, b.cols);
        if (end - k).is_multiple_of(WORD) {
            let row = |i: usize| a.data[i * a.cols + k..i * a.cols + end].as_chunks::<WORD>().0;
            sparse_rows::<L, ROWS, VECTORS, LAST>(&terms, right, a.rows, row, |i| i, out.data);
        } else {
            // What is missing of the last word is zero.
            for i in 0..a.rows {
                let mut row = [[0.0; WORD]; WORDS];
                row.as_flattened_mut()[..end - k].copy_from_slice(&a.data[i * a.cols + k..i * a.cols + end]);
                let words = &row[..(end - k).div_ceil(WORD)];
                sparse_rows::<L, 1, LAST, LAST>(&terms, right, 1, |_| words, |_| i, out.data);
            }
        }
    }
    b.cols - b.cols % 32
}

/// One tile: `ROWS` rows of A times some vectors of columns of B.
#[inline(always)]
fn tile<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    a: Matrix<'_>,
    b: Matrix<'_>,
    out: &mut Output<'_>,
    i: usize,
    j: usize,
) {
    let k = a.cols;
    let mut rows = [&[][..]; ROWS];
    for (r, row) in rows.iter_mut().enumerate() {
        *row = &a.data[(i + r) * k..(i + r) * k + k];
    }
    let mut sums = [start::<L, VECTORS>(out.bias, j); ROWS];
    for (kk, right) in b.data.chunks_exact(b.cols).enumerate().take(k) {
        let line = load::<L, VECTORS>(&right[j..j + VECTORS * lanes::<L>()]);
        for (row, sums) in rows.iter().zip(&mut sums) {
            let factor = L::splat(row[kk]);
            for (sum, right) in sums.iter_mut().zip(line) {
                *sum = L::add_product(*sum, factor, right);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        let at = (i + r) * b.cols + j;
        let line = &mut out.data[at..at + VECTORS * lanes::<L>()];
        store::<L, VECTORS>(sums, line);
        out.finish.apply::<L>(line, at);
    }
}

/// All rows of one stripe of columns, `ROWS` at once. Narrow stripes take many: each sum is a chain, and only
/// independent chains keep the machine busy.
#[inline(always)]
fn stripe<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    a: Matrix<'_>,
    b: Matrix<'_>,
    out: &mut Output<'_>,
    j: usize,
) {
    let mut i = 0;
    while i + ROWS <= a.rows {
        tile::<L, ROWS, VECTORS>(a, b, out, i, j);
        i += ROWS;
    }
    while i + 4 <= a.rows {
        tile::<L, 4, VECTORS>(a, b, out, i, j);
        i += 4;
    }
    while i < a.rows {
        tile::<L, 1, VECTORS>(a, b, out, i, j);
        i += 1;
    }
}

/// `C = start + A·B` with A `[m, k]`, B `[k, n]`, C `[m, n]`, in tiles of so many rows and vectors: `DROWS` and
/// `DENSE` of dense factors, `ROWS` and `SPARSE` of others, and `LAST` vectors for 32 columns.
#[inline(always)]
pub(super) fn product_body<
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
    mut c: Output<'_>,
) {
    assert_eq!(a.cols, b.rows, "inner sizes of a product agree");
    let mut j = 0;
    if factors == Factors::Sparse && b.cols >= 32 {
        debug_assert!(c.bias.is_none_or(|bias| bias.iter().all(|b| b.to_bits() != 1 << 31)), "no bias is -0");
        j = sparse::<L, ROWS, SPARSE, LAST>(a, b, &mut c);
    }
    while j + DENSE * lanes::<L>() <= b.cols {
        stripe::<L, DROWS, DENSE>(a, b, &mut c, j);
        j += DENSE * lanes::<L>();
    }
    while j + lanes::<L>() <= b.cols {
        stripe::<L, 8, 1>(a, b, &mut c, j);
        j += lanes::<L>();
    }
    while j + lanes::<Baseline>() <= b.cols {
        stripe::<Baseline, 8, 1>(a, b, &mut c, j);
        j += lanes::<Baseline>();
    }
    if j + 2 <= b.cols {
        stripe::<One, 4, 2>(a, b, &mut c, j);
        j += 2;
    }
    if j < b.cols {
        stripe::<One, 8, 1>(a, b, &mut c, j);
    }
}

/// `C = start + A·Bᵀ` with A `[m, k]`, B `[n, k]`, C `[m, n]`: the gradient of a layer's inputs. The same tiles.
#[inline(always)]
pub(super) fn product_by_transposed_body<
    L: Lanes,
    const DROWS: usize,
    const DENSE: usize,
    const ROWS: usize,
    const SPARSE: usize,
    const LAST: usize,
>(
    a: Matrix<'_>,
    b: Matrix<'_>,
    c: Output<'_>,
    work: &mut Work,
) {
    assert_eq!(a.cols, b.cols, "inner sizes of a product agree");
    debug_assert!(c.bias.is_none_or(|bias| bias.iter().all(|b| b.to_bits() != 1 << 31)), "no bias is -0");
    if ROWS == 1 || a.rows <= FEW || !a.cols.is_multiple_of(WORD) || !b.rows.is_multiple_of(32) {
        let columns = work.transposed.at_least(b.rows * b.cols);
        transpose_body::<L>(b, columns);
        let columns = Matrix::new(columns, b.cols, b.rows);
        // Of a few terms none is worth looking for.
        let factors = if a.cols < 16 { Factors::Dense } else { Factors::Sparse };
        product_body::<L, DROWS, DENSE, ROWS, SPARSE, LAST>(factors, a, columns, c);
        return;
    }
    // Each panel is transposed where it is made.
    for k in (0..a.cols).step_by(words(ROWS) * WORD) {
        let end = a.cols.min(k + words(ROWS) * WORD);
        let terms = Terms::block(&c, k == 0, end == a.cols, b.rows);
        let row = |i: usize| a.data[i * a.cols + k..i * a.cols + end].as_chunks::<WORD>().0;
        for i in (0..a.rows).step_by(GROUPS * ROWS) {
            let rows = (a.rows - i).min(GROUPS * ROWS);
            let right = Right::Columns(b, k);
            sparse_panels::<L, ROWS, SPARSE>(&terms, right, rows, |r| row(i + r), |r| i + r, c.data);
        }
    }
}

/// Writes `rows` by `cols` numbers of `from`, whose rows are `stride` apart, with rows for columns.
#[inline(always)]
fn transpose_part<L: Lanes>(from: &[f32], [rows, cols]: [usize; 2], stride: usize, to: &mut [Word]) {
    let side = lanes::<L>();
    let (whole_rows, whole_cols) = (rows - rows % side, cols - cols % side);
    let flat = to.as_flattened_mut();
    for r in (0..whole_rows).step_by(side) {
        for c in (0..whole_cols).step_by(side) {
            L::transpose(&from[r * stride + c..], stride, &mut flat[c * WORD + r..], WORD);
        }
    }
    for r in 0..rows {
        for c in if r < whole_rows { whole_cols..cols } else { 0..cols } {
            flat[c * WORD + r] = from[r * stride + c];
        }
    }
}

/// Independent chains of a multiplication and an addition, for measuring what the machine can do at most
/// without fusing them: `rounds` passes over the lanes of `x`, two operations per lane and pass.
#[inline(always)]
pub(super) fn probe_body<L: Lanes>(rounds: usize, x: &mut [f32; PROBE_LANES]) {
    let (factor, one) = (L::splat(0.999), L::splat(0.001));
    for part in x.chunks_exact_mut(PROBE_CHAINS * lanes::<L>()) {
        let mut chains = load::<L, PROBE_CHAINS>(part);
        for _ in 0..rounds {
            for chain in &mut chains {
                *chain = L::add_product(one, *chain, factor);
            }
        }
        store::<L, PROBE_CHAINS>(&chains, part);
    }
}

/// `out[c] = Σ_r a[r, c]`, rows in order: the gradient of a bias.
#[inline(always)]
pub(super) fn sum_columns_body(a: Matrix<'_>, out: &mut [f32]) {
    out.fill(0.0);
    for row in a.data.chunks_exact(a.cols) {
        for (sum, x) in out.iter_mut().zip(row) {
            *sum += x;
        }
    }
}

/// `out[c, r] = a[r, c]`, in square blocks.
#[inline(always)]
pub(super) fn transpose_body<L: Lanes>(a: Matrix<'_>, out: &mut [f32]) {
    let (rows, cols, side) = (a.rows, a.cols, lanes::<L>());
    let (whole_rows, whole_cols) = (rows - rows % side, cols - cols % side);
    for c in (0..whole_cols).step_by(side) {
        for r in (0..whole_rows).step_by(side) {
            L::transpose(&a.data[r * cols + c..], cols, &mut out[c * rows + r..], rows);
        }
    }
    for r in 0..rows {
        for c in if r < whole_rows { whole_cols..cols } else { 0..cols } {
            out[c * rows + r] = a.data[r * cols + c];
        }
    }
}

/// [`Lanes::transpose`] for `SIDE` lanes, left to the compiler.
#[inline(always)]
pub(super) fn square<const SIDE: usize>(from: &[f32], stride: usize, to: &mut [f32], to_stride: usize) {
    let block: [[f32; SIDE]; SIDE] = from_fn(|i| from[i * stride..i * stride + SIDE].try_into().expect("a full block"));
    for j in 0..SIDE {
        let column: [f32; SIDE] = from_fn(|i| block[i][j]);
        to[j * to_stride..j * to_stride + SIDE].copy_from_slice(&column);
    }
}

mod transposed;
pub(super) use transposed::product_transposed_body;

#[cfg(test)]
mod tests;
