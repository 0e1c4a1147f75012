//! The replay buffer: transitions in columns, equal observations stored once.

use alloc::boxed::Box;
use alloc::collections::BTreeMap;
use alloc::vec;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

use crate::env::ObservationSpec;
use crate::nn::rows::{self, Rows, Words};
use crate::rng::Rng;

/// One experience: what the learner stores and learns from. It has no field for performance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Transition<A> {
    /// Observation before the step.
    pub observation: Vec<f32>,
    /// Action taken.
    pub action: A,
    /// Observed reward, scaled.
    pub reward: f32,
    /// Observation after the step.
    pub next_observation: Vec<f32>,
    /// True where no value follows; a truncation is not terminal.
    pub terminated: bool,
}

/// Distinct observations with their number of uses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Observations {
    rows: Vec<Box<Words>>,
    uses: Vec<u32>,
    free: Vec<u32>,
    index: BTreeMap<Box<Words>, u32>,
}

impl Observations {
    fn new() -> Self {
        Self { rows: Vec::new(), uses: Vec::new(), free: Vec::new(), index: BTreeMap::new() }
    }

    /// The number of this observation, one use more.
    fn acquire(&mut self, words: Vec<u32>) -> u32 {
        if let Some(&id) = self.index.get(&*words) {
            self.uses[id as usize] += 1;
            return id;
        }
        let words = words.into_boxed_slice();
        let id = match self.free.pop() {
            Some(id) => {
                self.rows[id as usize] = words.clone();
                self.uses[id as usize] = 1;
                id
            }
            None => {
                self.rows.push(words.clone());
                self.uses.push(1);
                (self.rows.len() - 1) as u32
            }
        };
        self.index.insert(words, id);
        id
    }

    /// One use fewer; an unused observation is forgotten.
    fn release(&mut self, id: u32) {
        let uses = &mut self.uses[id as usize];
        *uses -= 1;
        if *uses == 0 {
            let words = core::mem::take(&mut self.rows[id as usize]);
            self.index.remove(&words);
            self.free.push(id);
        }
    }
}

/// A first-in, first-out store of transitions, from which mini-batches are drawn. Equal observations are stored once, with
/// an index from their words to their number; serde writes that, too, so the format has to be a binary one (postcard).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReplayBuffer<A> {
    spec: ObservationSpec,
    capacity: u32,
    observations: Observations,
    state: Vec<u32>,
    action: Vec<A>,
    reward: Vec<f32>,
    next: Vec<u32>,
    terminated: Vec<bool>,
    /// Slot that the next transition takes once the buffer is full.
    oldest: u32,
    /// Transitions ever stored.
    pushed: u64,
}

impl<A: Clone> ReplayBuffer<A> {
    /// An empty buffer for `capacity` transitions.
    ///
    /// # Panics
    /// If `capacity` is 0.
    pub fn new(spec: ObservationSpec, capacity: u32) -> Self {
        assert!(capacity > 0, "a replay buffer holds something");
        Self {
            spec,
            capacity,
            observations: Observations::new(),
            state: Vec::new(),
            action: Vec::new(),
            reward: Vec::new(),
            next: Vec::new(),
            terminated: Vec::new(),
            oldest: 0,
            pushed: 0,
        }
    }

    /// Stores a transition; the oldest leaves when the buffer is full.
    ///
    /// # Panics
    /// If an observation has not the width of the buffer's.
    pub fn push(&mut self, transition: &Transition<A>) {
        assert_eq!(transition.observation.len(), self.spec.width, "width of an observation");
        assert_eq!(transition.next_observation.len(), self.spec.width, "width of an observation");
        let state = self.observations.acquire(rows::pack(self.spec, &transition.observation));
        let next = self.observations.acquire(rows::pack(self.spec, &transition.next_observation));
        if self.len() < self.capacity {
            self.state.push(state);
            self.action.push(transition.action.clone());
            self.reward.push(transition.reward);
            self.next.push(next);
            self.terminated.push(transition.terminated);
        } else {
            let slot = self.oldest as usize;
            self.observations.release(self.state[slot]);
            self.observations.release(self.next[slot]);
            self.state[slot] = state;
            self.action[slot] = transition.action.clone();
            self.reward[slot] = transition.reward;
            self.next[slot] = next;
            self.terminated[slot] = transition.terminated;
            self.oldest = (self.oldest + 1) % self.capacity;
        }
        self.pushed += 1;
    }

    /// Transitions stored now.
    pub fn len(&self) -> u32 {
        self.reward.len() as u32
    }

    /// True while nothing is stored.
    pub fn is_empty(&self) -> bool {
        self.reward.is_empty()
    }

    /// Transitions ever stored: changes with every change of the content.
    pub fn pushed(&self) -> u64 {
        self.pushed
    }

    /// Kind of the observations.
    pub fn spec(&self) -> ObservationSpec {
        self.spec
    }

    /// Number of distinct observations stored.
    pub fn distinct(&self) -> usize {
        self.observations.index.len()
    }

    /// The columns as they are stored, for back ends that copy them.
    pub fn columns(&self) -> Columns<'_, A> {
        let (observations, state, action) = (&self.observations.rows, &self.state, &self.action);
        Columns { observations, state, action, reward: &self.reward, next: &self.next, terminated: &self.terminated }
    }

    /// The transition in slot `slot` (0 to `len() - 1`; order of slots is not order of age once the
    /// buffer is full).
    ///
    /// # Panics
    /// If there is no such slot.
    pub fn get(&self, slot: u32) -> Transition<A> {
        let slot = slot as usize;
        Transition {
            observation: self.unpack(self.state[slot]),
            action: self.action[slot].clone(),
            reward: self.reward[slot],
            next_observation: self.unpack(self.next[slot]),
            terminated: self.terminated[slot],
        }
    }

    fn unpack(&self, id: u32) -> Vec<f32> {
        let words = &self.observations.rows[id as usize];
        if self.spec.binary {
            let mut observation = vec![0.0; self.spec.width];
            words.iter().for_each(|&i| observation[i as usize] = 1.0);
            observation
        } else {
            words.iter().map(|&bits| f32::from_bits(bits)).collect()
        }
    }
}

/// The columns of a replay buffer, one entry per slot.
#[derive(Clone, Copy, Debug)]
pub struct Columns<'a, A> {
    /// Packed observations by number. A number that is not in use has no words.
    pub observations: &'a [Box<Words>],
    /// Number of the observation before the step.
    pub state: &'a [u32],
    /// Action taken.
    pub action: &'a [A],
    /// Observed reward, scaled.
    pub reward: &'a [f32],
    /// Number of the observation after the step.
    pub next: &'a [u32],
    /// True where no value follows.
    pub terminated: &'a [bool],
}

/// Draws `count` different slots of `0..len`, uniformly (Floyd's method: exactly `count` draws).
///
/// # Panics
/// If `count > len`.
pub fn draw_slots(len: u32, count: u32, rng: &mut Rng, slots: &mut Vec<u32>) {
    assert!(count <= len, "{count} different slots of {len}");
    slots.clear();
    for last in len - count..len {
        let slot = rng.below(last + 1);
        slots.push(if slots.contains(&slot) { last } else { slot });
    }
}

/// Transitions that every mini-batch of a forecast contains besides its draw, packed once, for a buffer as it is: after
/// a push they are to be packed anew.
#[derive(Clone, Debug)]
pub struct Forced<A> {
    /// Of the buffer, when they were packed.
    pushed: u64,
    transitions: Vec<Transition<A>>,
    /// Numbers of the observations: those of the buffer where it holds them, further ones otherwise.
    states: Vec<u32>,
    nexts: Vec<u32>,
    /// Observations that the buffer does not hold.
    extra: Vec<Vec<u32>>,
}

impl<A: Clone> Forced<A> {
    /// Packs `transitions` for mini-batches from `replay`.
    ///
    /// # Panics
    /// If an observation has not the width of those of the buffer.
    pub fn new(transitions: &[Transition<A>], replay: &ReplayBuffer<A>) -> Self {
        for transition in transitions {
            let widths = [transition.observation.len(), transition.next_observation.len()];
            assert_eq!(widths, [replay.spec.width; 2], "width of an observation");
        }
        let known = replay.observations.rows.len() as u32;
        let mut extra: Vec<Vec<u32>> = Vec::new();
        let mut number = |observation: &[f32]| {
            let words = rows::pack(replay.spec, observation);
            if let Some(&id) = replay.observations.index.get(&*words) {
                return id;
            }
            let position = extra.iter().position(|other| *other == words).unwrap_or_else(|| {
                extra.push(words);
                extra.len() - 1
            });
            known + position as u32
        };
        let states = transitions.iter().map(|t| number(&t.observation)).collect();
        let nexts = transitions.iter().map(|t| number(&t.next_observation)).collect();
        Self { pushed: replay.pushed, transitions: transitions.to_vec(), states, nexts, extra }
    }

    /// Number of transitions.
    pub fn len(&self) -> usize {
        self.transitions.len()
    }

    /// True without any.
    pub fn is_empty(&self) -> bool {
        self.transitions.is_empty()
    }

    /// The transitions with the numbers of their observations before and after the step. Numbers beyond the
    /// buffer's observations are those of [`Forced::extra`], in order.
    pub fn entries(&self) -> impl Iterator<Item = (&Transition<A>, u32, u32)> {
        self.transitions.iter().zip(&self.states).zip(&self.nexts).map(|((t, &state), &next)| (t, state, next))
    }

    /// Packed observations that the buffer does not hold.
    pub fn extra(&self) -> &[Vec<u32>] {
        &self.extra
    }
}

/// No row of the batch (a terminated transition's next state).
pub const NO_ROW: u32 = u32::MAX;

/// A mini-batch with equal observations gathered once. Reused from update to update.
///
/// Rows are numbered by first appearance: first the distinct states in sample order, then the distinct
/// next states that are no state of the batch.
#[derive(Clone, Debug)]
pub struct Minibatch<A> {
    /// Distinct observations.
    pub rows: Rows,
    /// How many rows, from the first, are states of a sample.
    pub states: usize,
    /// Distinct next observations of the samples that did not terminate, for the target network.
    pub next_rows: Rows,
    /// Row of each sample's state in `rows`.
    pub state: Vec<u32>,
    /// Row of each sample's next state in `rows`, [`NO_ROW`] where it terminated.
    pub next: Vec<u32>,
    /// Row of each sample's next state in `next_rows`, [`NO_ROW`] where it terminated.
    pub next_target: Vec<u32>,
    /// Actions.
    pub actions: Vec<A>,
    /// Scaled rewards.
    pub rewards: Vec<f32>,
    row_of: Vec<u32>,
    next_row_of: Vec<u32>,
    ids: Vec<u32>,
    next_ids: Vec<u32>,
}

impl<A> Default for Minibatch<A> {
    fn default() -> Self {
        Self {
            rows: Rows::default(),
            states: 0,
            next_rows: Rows::default(),
            state: Vec::new(),
            next: Vec::new(),
            next_target: Vec::new(),
            actions: Vec::new(),
            rewards: Vec::new(),
            row_of: Vec::new(),
            next_row_of: Vec::new(),
            ids: Vec::new(),
            next_ids: Vec::new(),
        }
    }
}

impl<A: Clone> Minibatch<A> {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.rewards.len()
    }

    /// True without samples.
    pub fn is_empty(&self) -> bool {
        self.rewards.is_empty()
    }

    /// Fills the batch with the transitions in `slots`, then the forced ones.
    ///
    /// # Panics
    /// If there are forced ones and the buffer has grown since they were packed.
    pub fn gather(&mut self, replay: &ReplayBuffer<A>, slots: &[u32], forced: &Forced<A>) {
        assert!(
            forced.is_empty() || forced.pushed == replay.pushed,
            "forced transitions are of the buffer before a push"
        );
        let known = replay.observations.rows.len();
        let ids = known + forced.extra.len();
        if self.row_of.len() < ids {
            self.row_of.resize(ids, NO_ROW);
            self.next_row_of.resize(ids, NO_ROW);
        }
        self.rows.clear(replay.spec);
        self.next_rows.clear(replay.spec);
        self.actions.clear();
        self.rewards.clear();
        self.ids.clear();
        self.next_ids.clear();
        for &slot in slots {
            let slot = slot as usize;
            self.actions.push(replay.action[slot].clone());
            self.rewards.push(replay.reward[slot]);
            self.ids.push(replay.state[slot]);
            self.next_ids.push(if replay.terminated[slot] { NO_ROW } else { replay.next[slot] });
        }
        for (i, transition) in forced.transitions.iter().enumerate() {
            self.actions.push(transition.action.clone());
            self.rewards.push(transition.reward);
            self.ids.push(forced.states[i]);
            self.next_ids.push(if transition.terminated { NO_ROW } else { forced.nexts[i] });
        }
        let words = |id: u32| -> &Words {
            match (id as usize).checked_sub(known) {
                None => &replay.observations.rows[id as usize],
                Some(position) => &forced.extra[position],
            }
        };
        let number = |id: u32, row_of: &mut [u32], rows: &mut Rows| {
            let row = &mut row_of[id as usize];
            if *row == NO_ROW {
                *row = rows.len() as u32;
                rows.push(words(id));
            }
            *row
        };
        let Self { rows, row_of, next_rows, next_row_of, .. } = self;
        self.state.clear();
        self.state.extend(self.ids.iter().map(|&id| number(id, row_of, rows)));
        self.states = rows.len();
        self.next.clear();
        self.next_target.clear();
        for &id in &self.next_ids {
            let known = id != NO_ROW;
            self.next.push(if known { number(id, row_of, rows) } else { NO_ROW });
            self.next_target.push(if known { number(id, next_row_of, next_rows) } else { NO_ROW });
        }
        // Only what was numbered is forgotten: of numbers, a buffer holds as many observations as transitions.
        for &id in self.ids.iter().chain(&self.next_ids).filter(|id| **id != NO_ROW) {
            (row_of[id as usize], next_row_of[id as usize]) = (NO_ROW, NO_ROW);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::Discrete;
    use crate::rng::Rng;
    use alloc::collections::{BTreeSet, VecDeque};
    use proptest::prelude::*;

    const SPEC: ObservationSpec = ObservationSpec { width: 4, binary: true };

    fn transition(code: u32) -> Transition<Discrete> {
        let bits = |n: u32| (0..4).map(|i| ((n >> i) & 1) as f32).collect();
        Transition {
            observation: bits(code % 16),
            action: Discrete((code % 2) as u8),
            reward: code as f32,
            next_observation: bits(code / 16 % 16),
            terminated: code.is_multiple_of(5),
        }
    }

    proptest! {
        #[test]
        fn holds_the_last_transitions_and_no_observation_more(
            codes in prop::collection::vec(0u32..1000, 1..120),
            capacity in 1u32..40,
        ) {
            let mut replay = ReplayBuffer::new(SPEC, capacity);
            let mut model = VecDeque::new();
            for &code in &codes {
                replay.push(&transition(code));
                model.push_back(code);
                if model.len() > capacity as usize {
                    model.pop_front();
                }
            }
            let mut held: Vec<f32> = (0..replay.len()).map(|slot| replay.get(slot).reward).collect();
            let mut expected: Vec<f32> = model.iter().map(|&code| code as f32).collect();
            held.sort_by(f32::total_cmp);
            expected.sort_by(f32::total_cmp);
            prop_assert_eq!(held, expected);
            for slot in 0..replay.len() {
                let t = replay.get(slot);
                prop_assert_eq!(&t, &transition(t.reward as u32));
            }
            let distinct: BTreeSet<u32> =
                model.iter().flat_map(|code| [code % 16, code / 16 % 16]).collect();
            prop_assert_eq!(replay.distinct(), distinct.len());
            prop_assert_eq!(replay.pushed(), codes.len() as u64);
        }

        #[test]
        fn slots_are_different_and_in_range(len in 1u32..200, count in 0u32..200, seed: u64) {
            prop_assume!(count <= len);
            let mut slots = Vec::new();
            draw_slots(len, count, &mut Rng::new(seed), &mut slots);
            let set: BTreeSet<u32> = slots.iter().copied().collect();
            prop_assert_eq!(set.len(), count as usize);
            prop_assert!(slots.iter().all(|&s| s < len));
        }

        #[test]
        fn batches_hold_their_samples(
            codes in prop::collection::vec(0u32..1000, 8..60),
            forced in prop::collection::vec(0u32..4000, 0..3),
            seed: u64,
        ) {
            let mut replay = ReplayBuffer::new(SPEC, 40);
            codes.iter().for_each(|&code| replay.push(&transition(code)));
            let extra: Vec<_> = forced.iter().map(|&code| transition(code)).collect();
            let packed = Forced::new(&extra, &replay);
            let mut slots = Vec::new();
            draw_slots(replay.len(), 8, &mut Rng::new(seed), &mut slots);
            let mut batch = Minibatch::default();
            batch.gather(&replay, &[0], &packed); // Old content must not shine through.
            batch.gather(&replay, &slots, &packed);
            let expected: Vec<_> = slots.iter().map(|&s| replay.get(s)).chain(extra).collect();
            prop_assert_eq!(batch.len(), expected.len());
            let ones = |observation: &[f32]| rows::pack(SPEC, observation);
            for (i, t) in expected.iter().enumerate() {
                prop_assert_eq!(batch.actions[i], t.action);
                prop_assert_eq!(batch.rewards[i], t.reward);
                prop_assert!((batch.state[i] as usize) < batch.states);
                prop_assert_eq!(batch.rows.ones(batch.state[i] as usize), &*ones(&t.observation));
                prop_assert_eq!(batch.next[i] == NO_ROW, t.terminated);
                if !t.terminated {
                    prop_assert_eq!(batch.rows.ones(batch.next[i] as usize), &*ones(&t.next_observation));
                    let target = batch.next_rows.ones(batch.next_target[i] as usize);
                    prop_assert_eq!(target, &*ones(&t.next_observation));
                }
            }
            let rows: BTreeSet<Vec<u32>> =
                (0..batch.rows.len()).map(|r| batch.rows.ones(r).to_vec()).collect();
            prop_assert_eq!(rows.len(), batch.rows.len());
        }
    }

    #[test]
    #[should_panic(expected = "forced transitions are of the buffer before a push")]
    fn forced_transitions_are_packed_anew_after_a_push() {
        let mut replay = ReplayBuffer::new(SPEC, 40);
        replay.push(&transition(1));
        let forced = Forced::new(&[transition(2)], &replay);
        replay.push(&transition(3));
        Minibatch::default().gather(&replay, &[0], &forced);
    }

    #[test]
    fn draws_are_uniform() {
        let (mut counts, mut slots, mut rng) = ([0u32; 10], Vec::new(), Rng::new(9));
        for _ in 0..10_000 {
            draw_slots(10, 3, &mut rng, &mut slots);
            slots.iter().for_each(|&s| counts[s as usize] += 1);
        }
        assert!(counts.iter().all(|&c| (2_750..3_250).contains(&c)), "{counts:?}");
    }

    #[test]
    fn dense_observations_keep_their_bits() {
        let spec = ObservationSpec { width: 2, binary: false };
        let mut replay = ReplayBuffer::new(spec, 2);
        let t = Transition {
            observation: vec![-0.0, 1e-40],
            action: Discrete(0),
            reward: 1.0,
            next_observation: vec![f32::MAX, 0.1],
            terminated: false,
        };
        replay.push(&t);
        let back = replay.get(0);
        assert_eq!(back.observation[0].to_bits(), (-0.0f32).to_bits());
        assert_eq!(back, t);
    }
}
