//! Adam and its relatives, with the target network's moving average in the same pass over memory.
//!
//! With gradient `g`, per element and step `t` (Kingma and Ba 2015, in the form of the common
//! frameworks):
//! ```text
//! p ← p − lr·wd·p                                (AdamW only)
//! m ← β1·m + (1 − β1)·g,   v ← β2·v + (1 − β2)·g²
//! w = v, or with AMSGrad w ← max(w, v)
//! p ← p − lr/(1 − β1ᵗ) · m / (√w/√(1 − β2ᵗ) + ε)
//! target ← target + τ·(p − target)
//! ```
//! Moments that decay below 1e-30 (`m`) or 1e-36 (`v`) become zero: they are far below what any update
//! resolves, and would turn into denormal numbers, on which processors are a hundred times slower.
//!
//! A parameter whose gradient was always zero has zero moments; without weight decay its step leaves
//! every bit as it is, and so does the moving average, whose start equals it. So first-layer rows that
//! were never active are skipped, unless somebody sets parameters or average by hand ([`Adam::touch_all`]).

use alloc::vec;
use alloc::vec::Vec;
use core::ops::Range;
use serde::{Deserialize, Serialize};

use super::buffer::Buffer;
use super::gemm::lanes;
use super::isa::{self, Isa, Lanes};
use crate::config::{Config, Optimizer};

/// Decay of the first moment.
pub const BETA1: f64 = 0.9;
/// Decay of the second moment.
pub const BETA2: f64 = 0.999;
/// Added to the root of the second moment.
pub const EPSILON: f32 = 1e-8;

/// Settings of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdamConfig {
    /// Which of the family.
    pub kind: Optimizer,
    /// Learning rate.
    pub lr: f32,
    /// Decoupled weight decay; used by the AdamW kinds.
    pub weight_decay: f32,
    /// Clip of each gradient element; 0 = none.
    pub clip: f32,
}

impl AdamConfig {
    /// The optimiser that a configuration describes, with this learning rate.
    pub fn of(config: &Config, lr: f32) -> Self {
        Self { kind: config.optimizer, lr, weight_decay: config.weight_decay, clip: config.gradient_clip }
    }
}

/// What is constant over one step.
#[derive(Clone, Copy)]
pub struct Constants {
    keep1: f32,
    add1: f32,
    keep2: f32,
    add2: f32,
    rate: f32,
    root: f32,
    shrink: f32,
    clip: f32,
    tau: f32,
}

/// A range of everything that the step reads and writes; all slices have one length, or are empty
/// where they do not apply.
pub struct State<'a> {
    pub(super) params: &'a mut [f32],
    pub(super) grads: &'a [f32],
    pub(super) m: &'a mut [f32],
    pub(super) v: &'a mut [f32],
    pub(super) max_v: &'a mut [f32],
    pub(super) target: &'a mut [f32],
}

/// Optimiser state of one network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Adam {
    config: AdamConfig,
    m: Buffer,
    v: Buffer,
    max_v: Buffer,
    power1: f64,
    power2: f64,
    steps: u64,
    /// Parameters per row of the first layer, and which rows ever had a gradient; empty: all live.
    row: usize,
    live: Vec<bool>,
}

impl Adam {
    /// State for `params` parameters. `rows` and `row` are the number and length of the first-layer
    /// rows that may stay without gradient for ever (0: none).
    pub fn new(config: AdamConfig, params: usize, rows: usize, row: usize) -> Self {
        let max = if config.amsgrad() { params } else { 0 };
        let skip = config.decay() == 0.0;
        Self {
            config,
            m: Buffer::zeros(params),
            v: Buffer::zeros(params),
            max_v: Buffer::zeros(max),
            power1: 1.0,
            power2: 1.0,
            steps: 0,
            row,
            live: if skip { vec![false; rows] } else { Vec::new() },
        }
    }

    /// The same optimiser before its first step. Which rows had a gradient stays known: their moving
    /// averages may have parted from their parameters.
    pub fn restarted(&self) -> Self {
        let (params, max) = (self.m.len(), self.max_v.len());
        let (m, v, max_v) = (Buffer::zeros(params), Buffer::zeros(params), Buffer::zeros(max));
        let (row, live) = (self.row, self.live.clone());
        Self { config: self.config, m, v, max_v, power1: 1.0, power2: 1.0, steps: 0, row, live }
    }

    /// Steps made.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Its settings.
    pub fn config(&self) -> AdamConfig {
        self.config
    }

    /// First moments, second moments and, for AMSGrad, the largest second moments so far (empty otherwise), in
    /// the layout of the parameters.
    pub fn moments(&self) -> (&[f32], &[f32], &[f32]) {
        (&self.m, &self.v, &self.max_v)
    }

    /// Takes over what `steps` further steps, made elsewhere, left of the moments (as [`Adam::moments`] gives them).
    ///
    /// # Panics
    /// If there are more or fewer moments than before.
    pub fn take_over(&mut self, steps: u32, moments: [&[f32]; 3]) {
        for (own, new) in [&mut self.m, &mut self.v, &mut self.max_v].into_iter().zip(moments) {
            own.copy_from_slice(new);
        }
        self.steps += u64::from(steps);
        for _ in 0..steps {
            self.power1 *= BETA1;
            self.power2 *= BETA2;
        }
    }

    /// Whether rows of the first layer are skipped until they have a gradient, as only binary observations allow.
    pub(crate) fn skips_rows(&self) -> bool {
        !self.live.is_empty()
    }

    /// Whether first-layer row `index` may change: it had a gradient once, or rows are not told apart.
    pub fn is_live(&self, index: usize) -> bool {
        self.live.get(index).is_none_or(|live| *live)
    }

    /// What corrects the bias of the moments in each of the steps to come.
    pub fn corrections(&self) -> Corrections {
        Corrections { lr: self.config.lr, power1: self.power1, power2: self.power2 }
    }

    /// Notes that first-layer row `index` has a gradient now.
    pub fn touch(&mut self, index: u32) {
        if let Some(live) = self.live.get_mut(index as usize) {
            *live = true;
        }
    }

    /// Steps over every row from here on: for parameters that no longer are those of their moving average.
    pub fn touch_all(&mut self) {
        self.live.fill(true);
    }

    /// One step on `params`, and `target += tau · (params − target)` where a target is given.
    /// All slices have the length the state was made for.
    pub fn step(&mut self, params: &mut [f32], grads: &[f32], mut target: Option<(&mut [f32], f32)>) {
        self.steps += 1;
        let mut corrections = self.corrections();
        let [rate, root] = corrections.advance();
        (self.power1, self.power2) = (corrections.power1, corrections.power2);
        let constants = Constants {
            keep1: BETA1 as f32,
            add1: (1.0 - BETA1) as f32,
            keep2: BETA2 as f32,
            add2: (1.0 - BETA2) as f32,
            rate,
            root,
            shrink: self.config.shrink(),
            clip: if self.config.clip > 0.0 { self.config.clip } else { f32::INFINITY },
            tau: target.as_ref().map_or(0.0, |t| t.1),
        };
        let isa = Isa::active();
        for range in ranges(&self.live, self.row, params.len()) {
            let state = State {
                params: &mut params[range.clone()],
                grads: &grads[range.clone()],
                m: &mut self.m[range.clone()],
                v: &mut self.v[range.clone()],
                max_v: if self.max_v.is_empty() { &mut [] } else { &mut self.max_v[range.clone()] },
                target: match &mut target {
                    Some((target, _)) => &mut target[range],
                    None => &mut [],
                },
            };
            isa::optimise(isa, &constants, state);
        }
    }
}

/// Bias corrections of consecutive steps: `[lr/(1 − β1ᵗ), 1/√(1 − β2ᵗ)]` for the next `t`, and so on.
#[derive(Clone, Copy, Debug)]
pub struct Corrections {
    lr: f32,
    power1: f64,
    power2: f64,
}

impl Corrections {
    /// Those of the next step.
    pub fn advance(&mut self) -> [f32; 2] {
        self.power1 *= BETA1;
        self.power2 *= BETA2;
        [(f64::from(self.lr) / (1.0 - self.power1)) as f32, (1.0 / libm::sqrt(1.0 - self.power2)) as f32]
    }
}

impl AdamConfig {
    /// Whether the largest second moment so far divides.
    pub fn amsgrad(&self) -> bool {
        matches!(self.kind, Optimizer::AmsGrad | Optimizer::AdamWAmsGrad)
    }

    /// Factor of a parameter before its step: decoupled weight decay.
    pub fn shrink(&self) -> f32 {
        1.0 - self.lr * self.decay()
    }

    /// Weight decay in force.
    fn decay(&self) -> f32 {
        match self.kind {
            Optimizer::AdamW | Optimizer::AdamWAmsGrad => self.weight_decay,
            Optimizer::Adam | Optimizer::AmsGrad => 0.0,
        }
    }
}

/// The parameters to step over: runs of live first-layer rows, and everything behind the first layer's
/// weights.
fn ranges(live: &[bool], row: usize, params: usize) -> impl Iterator<Item = Range<usize>> + '_ {
    let weights = live.len() * row;
    let mut next = 0;
    let runs = core::iter::from_fn(move || {
        let first = next + live[next..].iter().position(|&l| l)?;
        let end = live[first..].iter().position(|&l| !l).map_or(live.len(), |n| first + n);
        next = end;
        Some(first * row..end * row)
    });
    runs.chain(core::iter::once(weights..params))
}

/// One step over a range, `N` elements at a time.
#[inline(always)]
pub(super) fn step_body<L: Lanes, const N: usize>(c: &Constants, s: State<'_>) {
    match (s.max_v.is_empty(), s.target.is_empty()) {
        (true, true) => step_kind::<L, N, false, false>(c, s),
        (true, false) => step_kind::<L, N, false, true>(c, s),
        (false, true) => step_kind::<L, N, true, false>(c, s),
        (false, false) => step_kind::<L, N, true, true>(c, s),
    }
}

#[inline(always)]
fn step_kind<L: Lanes, const N: usize, const MAX: bool, const TARGET: bool>(c: &Constants, s: State<'_>) {
    // A copy, which no store to the state can change.
    let c = &{ *c };
    let len = s.params.len();
    let whole = len - len % N;
    let (mut none, mut none_either) = ([0.0f32; N], [0.0f32; N]);
    let (p, g) = (s.params.as_chunks_mut::<N>().0, s.grads.as_chunks::<N>().0);
    let (m, v) = (s.m.as_chunks_mut::<N>().0, s.v.as_chunks_mut::<N>().0);
    let (w, t) = (s.max_v.as_chunks_mut::<N>().0, s.target.as_chunks_mut::<N>().0);
    let count = p.len();
    // Asked once, and not of every access in the loop.
    assert!(g.len() == count && m.len() == count && v.len() == count, "all slices have one length");
    assert!((!MAX || w.len() == count) && (!TARGET || t.len() == count), "all slices have one length");
    for i in 0..count {
        let w = if MAX { &mut w[i] } else { &mut none };
        let t = if TARGET { &mut t[i] } else { &mut none_either };
        step_lanes::<L, N, MAX, TARGET>(c, &mut p[i], &g[i], &mut m[i], &mut v[i], w, t);
    }
    if whole == len {
        return;
    }
    // The rest, padded to a full set of lanes.
    let load = |from: &[f32]| -> [f32; N] {
        let mut lanes = [0.0; N];
        if !from.is_empty() {
            lanes[..len - whole].copy_from_slice(&from[whole..]);
        }
        lanes
    };
    let (mut p, g, mut m, mut v) = (load(s.params), load(s.grads), load(s.m), load(s.v));
    let (mut w, mut t) = (load(s.max_v), load(s.target));
    step_lanes::<L, N, MAX, TARGET>(c, &mut p, &g, &mut m, &mut v, &mut w, &mut t);
    let store = |to: &mut [f32], lanes: &[f32; N]| {
        if !to.is_empty() {
            to[whole..].copy_from_slice(&lanes[..len - whole]);
        }
    };
    store(s.params, &p);
    store(s.m, &m);
    store(s.v, &v);
    store(s.max_v, &w);
    store(s.target, &t);
}

#[inline(always)]
fn step_lanes<L: Lanes, const N: usize, const MAX: bool, const TARGET: bool>(
    c: &Constants,
    p: &mut [f32; N],
    g: &[f32; N],
    m: &mut [f32; N],
    v: &mut [f32; N],
    w: &mut [f32; N],
    t: &mut [f32; N],
) {
    let (mut moment, mut square) = (*m, *v);
    for l in 0..N {
        // Written as selections, so that it vectorises and a NaN gradient stays one.
        let low = if g[l] < -c.clip { -c.clip } else { g[l] };
        let gradient = if low > c.clip { c.clip } else { low };
        let a = c.keep1 * moment[l] + c.add1 * gradient;
        let b = c.keep2 * square[l] + c.add2 * (gradient * gradient);
        moment[l] = if a < 1e-30 && a > -1e-30 { 0.0 } else { a };
        square[l] = if b < 1e-36 { 0.0 } else { b };
    }
    let mut under = square;
    if MAX {
        for l in 0..N {
            w[l] = if square[l] > w[l] { square[l] } else { w[l] };
        }
        under = *w;
    }
    let mut root = [0.0; N];
    for l in (0..N).step_by(lanes::<L>()) {
        L::store(L::sqrt(L::load(&under[l..])), &mut root[l..]);
    }
    for l in 0..N {
        let denominator = root[l] * c.root + EPSILON;
        let value = p[l] * c.shrink - c.rate * moment[l] / denominator;
        p[l] = value;
        if TARGET {
            t[l] += c.tau * (value - t[l]);
        }
    }
    *m = moment;
    *v = square;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    fn adam(kind: Optimizer, params: usize) -> Adam {
        Adam::new(AdamConfig { kind, lr: 0.1, weight_decay: 0.01, clip: 0.0 }, params, 0, 0)
    }

    #[test]
    fn hand_computed_steps() {
        // g = 2, then g = -1, from p = 1. First step: m/(1-β1) = g, √(v/(1-β2)) = |g|: p moves by lr.
        let mut p = [1.0f32];
        let mut a = adam(Optimizer::Adam, 1);
        a.step(&mut p, &[2.0], None);
        assert!((p[0] - 0.9).abs() < 1e-6, "{}", p[0]);
        // m = 0.9·0.2 - 0.1 = 0.08, v = 0.999·0.004 + 0.001 = 0.004996;
        // m̂ = 0.08/0.19, v̂ = 0.004996/0.001999; step = 0.1·0.4210526/1.5809016 = 0.0266337.
        a.step(&mut p, &[-1.0], None);
        assert!((p[0] - 0.873_366).abs() < 2e-6, "{}", p[0]);

        // Decoupled decay: before the same first step p shrinks by lr·wd = 0.001.
        let mut p = [1.0f32];
        adam(Optimizer::AdamW, 1).step(&mut p, &[2.0], None);
        assert!((p[0] - 0.899).abs() < 1e-6, "{}", p[0]);

        // AMSGrad keeps the larger second moment: after g = 2 a zero gradient lowers v but not its maximum:
        // m = 0.18, w = 0.004; step = 0.1·(0.18/0.19)/√(0.004/0.001999) = 0.0669722.
        let mut p = [1.0f32];
        let mut a = adam(Optimizer::AmsGrad, 1);
        a.step(&mut p, &[2.0], None);
        a.step(&mut p, &[0.0], None);
        assert!((p[0] - (0.9 - 0.066_972)).abs() < 2e-6, "{}", p[0]);

        // Both: shrunk before each of the same two steps.
        let mut p = [1.0f32];
        let mut a = adam(Optimizer::AdamWAmsGrad, 1);
        a.step(&mut p, &[2.0], None);
        assert!((p[0] - 0.899).abs() < 1e-6, "{}", p[0]);
        a.step(&mut p, &[0.0], None);
        assert!((p[0] - (0.899 * 0.999 - 0.066_972)).abs() < 2e-6, "{}", p[0]);
    }

    #[test]
    fn clips_each_element() {
        let (mut clipped, mut small) = ([0.0f32; 3], [0.0f32; 3]);
        let config = AdamConfig { kind: Optimizer::Adam, lr: 0.1, weight_decay: 0.0, clip: 1.0 };
        let (mut a, mut b) = (Adam::new(config, 3, 0, 0), Adam::new(config, 3, 0, 0));
        for g in [[5.0, -7.0, 0.5], [0.2, 0.1, -3.0]] {
            a.step(&mut clipped, &g, None);
            b.step(&mut small, &g.map(|x: f32| x.clamp(-1.0, 1.0)), None);
        }
        assert_eq!(clipped, small);
    }

    #[test]
    fn target_follows_in_the_same_pass() {
        let (mut p, mut t) = ([1.0f32; 20], [3.0f32; 20]);
        adam(Optimizer::Adam, 20).step(&mut p, &[2.0; 20], Some((&mut t, 0.25)));
        assert!(t.iter().all(|x| (x - (3.0 + 0.25 * (0.9 - 3.0))).abs() < 1e-5), "{t:?}");
    }

    #[test]
    fn skipping_dead_rows_changes_no_bit() {
        // Five rows of three, of which only rows 1 and 3 ever have a gradient, and two biases.
        let mut rng = Rng::new(5);
        let start: [f32; 17] = core::array::from_fn(|_| rng.uniform());
        let (mut a, mut b) = ((start, start), (start, start));
        let config = AdamConfig { kind: Optimizer::Adam, lr: 0.01, weight_decay: 0.0, clip: 0.0 };
        let mut all = Adam::new(config, 17, 0, 0);
        let mut some = Adam::new(config, 17, 5, 3);
        for step in 0..50 {
            let row = if step % 2 == 0 { 1 } else { 3 };
            let mut grads = [0.0f32; 17];
            (3 * row..3 * row + 3).chain(15..17).for_each(|i| grads[i] = rng.uniform() - 0.5);
            some.touch(row as u32);
            all.step(&mut a.0, &grads, Some((&mut a.1, 0.005)));
            some.step(&mut b.0, &grads, Some((&mut b.1, 0.005)));
        }
        assert_eq!(a, b);
        assert_ne!(a.0[3], start[3]);
    }

    #[test]
    fn a_restarted_optimiser_steps_as_a_new_one_and_moves_every_average() {
        for kind in [Optimizer::Adam, Optimizer::AmsGrad] {
            let config = AdamConfig { kind, lr: 0.1, weight_decay: 0.0, clip: 0.0 };
            let mut used = Adam::new(config, 4, 2, 2);
            used.touch(1);
            let (mut p, mut t) = ([1.0f32; 4], [1.0f32; 4]);
            (0..5).for_each(|_| used.step(&mut p, &[0.0, 0.0, 2.0, -1.0], Some((&mut t, 0.1))));
            let mut restarted = used.restarted();
            assert_eq!(restarted.steps(), 0);
            let mut fresh = Adam::new(config, 4, 0, 0);
            let (mut p2, mut t2) = (p, t);
            // A gradient nowhere: only the averages move, also in the row that had gradients before.
            restarted.step(&mut p, &[0.0; 4], Some((&mut t, 0.1)));
            fresh.step(&mut p2, &[0.0; 4], Some((&mut t2, 0.1)));
            assert_eq!((p, t), (p2, t2));
            let before = t[2];
            restarted.step(&mut p, &[0.0, 0.0, 1.0, 1.0], Some((&mut t, 0.1)));
            fresh.step(&mut p2, &[0.0, 0.0, 1.0, 1.0], Some((&mut t2, 0.1)));
            assert_eq!((p, t), (p2, t2));
            assert_ne!(t[2], before);
        }
    }

    #[test]
    fn moments_never_become_denormal() {
        let mut p = [1.0f32];
        let mut a = adam(Optimizer::Adam, 1);
        a.step(&mut p, &[1e-3], None);
        for _ in 0..2_000 {
            a.step(&mut p, &[0.0], None);
            assert!(a.m[0] == 0.0 || a.m[0].is_normal());
        }
        assert_eq!(a.m[0], 0.0);
    }
}
