//! Tests of the products: every vector unit gives the bits of the definition.

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
fn plain(m: usize, n: usize, k: usize, a: impl Fn(usize, usize) -> f32, b: &[f32], bias: Option<&[f32]>) -> Vec<f32> {
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
    // One for all: nothing of a product shows in the next one.
    let mut work = Work::default();
    // The last ones have more rows than one panel serves, more terms than one block, and rows that fill no tile.
    let sizes = [(1, 1, 1), (3, 4, 5), (33, 128, 128), (7, 149, 11), (32, 2, 128)];
    for (m, n, k) in sizes.into_iter().chain([(65, 182, 70), (53, 96, 256), (104, 160, 192), (32, 128, 128)]) {
        let (mut a, b, mut bias) = (random(m * k, &mut rng), random(k * n, &mut rng), random(n, &mut rng));
        // Zeros of both signs, a row and a column of zeros, and a bias of zero.
        for (i, x) in a.iter_mut().enumerate() {
            if rng.bernoulli(0.5) || i / k == 2 || i % k == 3 {
                *x *= 0.0;
            }
        }
        bias[n / 2] = 0.0;
        let at: Vec<f32> = (0..k * m).map(|i| a[(i % m) * k + i / m]).collect();
        let expected = plain(m, n, k, |i, kk| a[i * k + kk], &b, Some(&bias));
        let expected_t = plain(m, n, k, |i, kk| a[i * k + kk], &b, None);
        let bt: Vec<f32> = (0..k * n).map(|i| b[(i % k) * n + i / k]).collect();
        for isa in Isa::supported() {
            let mut c = vec![f32::NAN; m * n];
            for factors in [Factors::Dense, Factors::Sparse] {
                let out = Output { data: &mut c, bias: Some(&bias), finish: Finish::Plain };
                isa::product(isa, factors, Matrix::new(&a, m, k), Matrix::new(&b, k, n), out);
                assert_eq!(bits(&c), bits(&expected), "{isa:?} {factors:?} {m} {n} {k}");
                isa::product_transposed(isa, factors, Matrix::new(&at, k, m), Matrix::new(&b, k, n), &mut c, &mut work);
                assert_eq!(bits(&c), bits(&expected_t), "{isa:?} {factors:?} {m} {n} {k} transposed");
            }
            let out = Output { data: &mut c, bias: Some(&bias), finish: Finish::Plain };
            isa::product_by_transposed(isa, Matrix::new(&a, m, k), Matrix::new(&bt, n, k), out, &mut work);
            assert_eq!(bits(&c), bits(&expected), "{isa:?} {m} {n} {k} by the transposed");
        }
    }
}

#[test]
fn what_is_done_last_is_done_once() {
    // Two blocks of terms, of which the first ends below zero; 97 rows leave one over behind a full set of tiles.
    const K: usize = 192;
    for (m, n) in [(3, 36), (3, 64), (7, 64), (97, 64)] {
        let (factors, sums) = ([1.0, 2.5, 4.0], [-64.0, 32.0, 128.0]);
        let a: Vec<f32> = (0..m * K).map(|i| if i % K < 128 { -1.0 } else { factors[i / K % 3] }).collect();
        let b = vec![1.0; K * n];
        let active: Vec<f32> = (0..m * n).map(|i| (i % 5) as f32 - 2.0).collect();
        let relu: Vec<f32> = (0..m * n).map(|i| f32::max(sums[i / n % 3], 0.0)).collect();
        let kept: Vec<f32> = (0..m * n).map(|i| if i % 5 > 2 { sums[i / n % 3] } else { 0.0 }).collect();
        let mut work = Work::default();
        for isa in Isa::supported() {
            for (finish, expected) in [(Finish::Relu, &relu), (Finish::Where(&active), &kept)] {
                for factors in [Factors::Dense, Factors::Sparse] {
                    let mut c = vec![f32::NAN; m * n];
                    let out = Output { data: &mut c, bias: None, finish };
                    isa::product(isa, factors, Matrix::new(&a, m, K), Matrix::new(&b, K, n), out);
                    assert_eq!(&c, expected, "{isa:?} {factors:?} {m} {n}");
                }
                let mut c = vec![f32::NAN; m * n];
                let out = Output { data: &mut c, bias: None, finish };
                isa::product_by_transposed(isa, Matrix::new(&a, m, K), Matrix::new(&b, n, K), out, &mut work);
                assert_eq!(&c, expected, "{isa:?} {m} {n} by the transposed");
            }
        }
    }
}
