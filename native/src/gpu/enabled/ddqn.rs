//! Jobs of DDQN learners for the kernel `ddqn.wgsl`: what goes to the device, and what comes back.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use mcvl_core::agent::Agent;
use mcvl_core::agent::ddqn::Ddqn;
use mcvl_core::config::{Config, Forced as ForcedKind};
use mcvl_core::forecast::ForecastJob;
use mcvl_core::nn::optim::{BETA1, BETA2, EPSILON};
use mcvl_core::replay::{Forced, NO_ROW};

use super::arithmetic::exactly;
use super::transfer::{draws, record};

/// Samples of a mini-batch at most, forced ones included; `SAMPLES` of the kernel.
pub const SAMPLES: u32 = 64;
/// Columns of a tile of a product, one per invocation of a group; groups of a workgroup at most; rows of each; terms
/// in workgroup memory at a time; inputs whose samples are known at a time: constants of the kernel.
pub const LANES: u32 = 128;
pub const GROUPS: u32 = 8;
pub const ROWS: u32 = 8;
pub const DEPTH: u32 = 16;
pub const INPUTS: u32 = 64;
/// Forced transitions of a check at most, in the way that appends the episode's last ones.
const TAIL: u32 = 11;

/// The kernel.
pub const SOURCE: &str = exactly!("ddqn.wgsl");

record! {
    /// `Span` of the kernel.
    Span {
        first: u32,
        count: u32,
        negative_zero: f32,
    }
}

impl Span {
    /// The updates `first..first + count`.
    pub fn new(first: u32, count: u32) -> Self {
        Self { first, count, negative_zero: -0.0 }
    }
}

record! {
    /// `Job` of the kernel.
    Job {
        inputs: u32,
        hidden: u32,
        outputs: u32,
        drawn: u32,
        forced: u32,
        updates: u32,
        online: u32,
        goal: u32,
        first: u32,
        second: u32,
        largest: u32,
        work: u32,
        columns: u32,
        slots: u32,
        extra: u32,
        rows: u32,
        ones: u32,
        draws: u32,
        corrections: u32,
        gamma: f32,
        tau: f32,
        keep_first: f32,
        add_first: f32,
        keep_second: f32,
        add_second: f32,
        epsilon: f32,
        shrink: f32,
        clip: f32,
        share: f32,
        amsgrad: u32,
    }
}

/// Whether the kernel has runs of this configuration.
///
/// # Errors
/// Why not.
pub fn supports(config: &Config) -> Result<(), String> {
    let forced = if config.forced == ForcedKind::Episode { TAIL } else { 1 };
    if config.layers != 2 {
        return Err(format!("the kernel has networks of two hidden layers, and layers = {}", config.layers));
    }
    if config.batch + forced > SAMPLES {
        return Err(format!(
            "the kernel has mini-batches of up to {} transitions, and batch = {}",
            SAMPLES - forced,
            config.batch
        ));
    }
    Ok(())
}

/// The same of one job.
///
/// # Errors
/// Why not.
pub fn has<E>(job: &ForecastJob<'_, E, Ddqn>) -> Result<(), String> {
    if !job.replay.spec().binary {
        return Err("the kernel has binary observations, and these are numbers".to_owned());
    }
    let samples = u64::from(job.batch) + job.forced.len() as u64;
    // Without a full mini-batch there is no update.
    if job.value_updates() > 0 && samples > u64::from(SAMPLES) {
        return Err(format!("the kernel has mini-batches of up to {SAMPLES} transitions, and this one has {samples}"));
    }
    Ok(())
}

/// What the jobs of one check have in common.
#[derive(Debug)]
struct Common {
    /// Numbers of the inputs that are ever one, ascending: the kernel's inputs.
    inputs: Vec<u32>,
    /// Columns of the replay buffer: states, next states, actions, rewards.
    columns: Vec<u32>,
    slots: u32,
    /// Where the ones of each observation begin, and the ones.
    rows: Vec<u32>,
    ones: Vec<u32>,
    draws: Vec<u32>,
}

/// One job, ready for the device.
#[derive(Debug)]
pub struct Packed {
    common: Arc<Common>,
    /// Sizes and settings; the offsets are those within [`Packed::memory`] and unset elsewhere.
    job: Job,
    /// Parameters, target, moments: each `parameters` numbers.
    memory: Vec<f32>,
    parameters: u32,
    /// Inputs that are one in a state of some mini-batch.
    touched: Vec<u32>,
    /// Columns of the forced transitions.
    extra: Vec<u32>,
    corrections: Vec<u32>,
}

/// Packs jobs whose replay buffer, seed and version are one and the same.
pub fn pack<E>(jobs: &[ForecastJob<'_, E, Ddqn>]) -> Vec<Packed> {
    let Some(first) = jobs.first() else { return Vec::new() };
    let columns = first.replay.columns();
    let known = columns.observations.len() as u32;
    // Observations of forced transitions that the buffer does not hold, of all jobs.
    let mut others: Vec<Vec<u32>> = Vec::new();
    let mut extras = Vec::new();
    for job in jobs {
        let forced = Forced::new(job.forced, job.replay);
        let mut number = |id: u32| match id.checked_sub(known) {
            None => id,
            Some(extra) => {
                let words = &forced.extra()[extra as usize];
                let position = others.iter().position(|other| other == words).unwrap_or_else(|| {
                    others.push(words.clone());
                    others.len() - 1
                });
                known + position as u32
            }
        };
        let entries: Vec<[u32; 4]> = forced
            .entries()
            .map(|(t, state, next)| {
                let next = if t.terminated { NO_ROW } else { number(next) };
                [number(state), next, u32::from(t.action.0), t.reward.to_bits()]
            })
            .collect();
        extras.push((0..4).flat_map(|column| entries.iter().map(move |entry| entry[column])).collect::<Vec<u32>>());
    }
    let observations =
        || columns.observations.iter().map(|words| &words[..]).chain(others.iter().map(|words| &words[..]));
    let width = first.agent.online().sizes()[0];
    let mut active = vec![false; width];
    observations().flatten().for_each(|&index| active[index as usize] = true);
    for job in jobs {
        (0..width).filter(|&index| job.agent.optimizer().is_live(index)).for_each(|index| active[index] = true);
    }
    let inputs: Vec<u32> = (0u32..).zip(&active).filter(|(_, active)| **active).map(|(index, _)| index).collect();
    let place: BTreeMap<u32, u32> = inputs.iter().copied().zip(0..).collect();
    let (mut rows, mut ones) = (vec![0], Vec::new());
    for words in observations() {
        ones.extend(words.iter().map(|index| place[index]));
        rows.push(ones.len() as u32);
    }
    let slots = first.replay.len();
    let mut table = columns.state.to_vec();
    table.extend(columns.next.iter().zip(columns.terminated).map(|(&next, &over)| if over { NO_ROW } else { next }));
    table.extend(columns.action.iter().map(|action| u32::from(action.0)));
    table.extend(columns.reward.iter().map(|reward| reward.to_bits()));
    let draws = draws(jobs);
    let common = Arc::new(Common { inputs, columns: table, slots, rows, ones, draws });
    jobs.iter().zip(extras).map(|(job, extra)| Packed::new(job, common.clone(), extra)).collect()
}

impl Common {
    /// Inputs that are one in the states of the first `drawn` samples or of the forced ones, which `forced` numbers.
    fn touched(&self, drawn: u32, forced: &[u32]) -> Vec<u32> {
        let mut states = vec![false; self.rows.len()];
        let drawn = self.draws[..drawn as usize].iter().map(|&slot| self.columns[slot as usize]);
        drawn.chain(forced.iter().copied()).for_each(|id| states[id as usize] = true);
        let mut touched = vec![false; self.inputs.len()];
        for (id, _) in states.iter().enumerate().filter(|(_, seen)| **seen) {
            let ones = &self.ones[self.rows[id] as usize..self.rows[id + 1] as usize];
            ones.iter().for_each(|&place| touched[place as usize] = true);
        }
        self.inputs.iter().zip(touched).filter(|(_, touched)| *touched).map(|(&input, _)| input).collect()
    }
}

impl Packed {
    fn new<E>(job: &ForecastJob<'_, E, Ddqn>, common: Arc<Common>, extra: Vec<u32>) -> Self {
        let agent = job.agent.for_forecast(job.carry);
        let (network, optimizer) = (agent.online(), agent.optimizer());
        let sizes = network.sizes();
        let (hidden, outputs) = (sizes[1], sizes[3]);
        let (first, second, largest) = optimizer.moments();
        let mut memory = Vec::new();
        for values in [network.params(), agent.target().params(), first, second, largest] {
            if values.is_empty() {
                continue;
            }
            // Of the first layer only the inputs that are ever one.
            for &input in &common.inputs {
                let at = input as usize * hidden;
                memory.extend_from_slice(&values[at..at + hidden]);
            }
            memory.extend_from_slice(&values[sizes[0] * hidden..]);
        }
        let parameters = (network.params().len() - (sizes[0] - common.inputs.len()) * hidden) as u32;
        let (settings, updates) = (optimizer.config(), job.value_updates());
        let touched = common.touched(updates * job.batch, if updates > 0 { &extra[..job.forced.len()] } else { &[] });
        let mut corrections = optimizer.corrections();
        let corrections = (0..updates).flat_map(|_| corrections.advance()).map(f32::to_bits).collect();
        let job = Job {
            inputs: common.inputs.len() as u32,
            hidden: hidden as u32,
            outputs: outputs as u32,
            drawn: job.batch,
            forced: job.forced.len() as u32,
            updates,
            slots: common.slots,
            online: 0,
            goal: parameters,
            first: 2 * parameters,
            second: 3 * parameters,
            largest: 4 * parameters,
            work: memory.len() as u32,
            gamma: agent.gamma(),
            tau: agent.tau(),
            keep_first: BETA1 as f32,
            add_first: (1.0 - BETA1) as f32,
            keep_second: BETA2 as f32,
            add_second: (1.0 - BETA2) as f32,
            epsilon: EPSILON,
            shrink: settings.shrink(),
            clip: if settings.clip > 0.0 { settings.clip } else { f32::MAX },
            share: 1.0 / (job.batch as usize + job.forced.len()) as f32,
            amsgrad: u32::from(settings.amsgrad()),
            ..Job::default()
        };
        Self { common, job, memory, parameters, touched, extra, corrections }
    }

    /// Updates to make.
    pub fn updates(&self) -> u32 {
        self.job.updates
    }

    /// Working memory of the kernel, in numbers: activations of both networks and derivatives, in the order of `Work`.
    fn work(&self) -> u32 {
        let Job { hidden, outputs, .. } = self.job;
        SAMPLES * (8 * hidden + 4 * outputs)
    }

    /// Turns of the loops of one invocation in one update, at most, where a workgroup is one group.
    pub fn loops(&self) -> u32 {
        let Job { inputs, hidden, outputs, drawn, forced, .. } = self.job;
        let samples = drawn + forced;
        let parts = |count: u32| 1 + count.div_ceil(LANES);
        let most = self.common.rows.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(0);
        // Sums of `terms` for `rows` rows of `columns` columns, by tiles: what is brought, and what is added.
        let block = 1 + (DEPTH * ROWS / 4).div_ceil(LANES) + 1 + DEPTH + 1 + DEPTH;
        let tiles = |rows: u32, columns: u32, terms: u32| {
            (1 + rows.div_ceil(ROWS)) * parts(columns) * (1 + terms.div_ceil(DEPTH)) * block
        };
        let few = |count: u32, terms: u32| parts(count) * (4 + terms);
        let product = |rows: u32, columns: u32, terms: u32| {
            if columns < ROWS { few(rows * columns, terms) } else { tiles(rows, columns, terms) }
        };
        // By rows: the first layer, the second, the outputs.
        let forward =
            |rows: u32| few(rows * hidden, most) + product(rows, hidden, hidden) + product(rows, outputs, hidden);
        let loss = 8 * SAMPLES + few(samples * outputs, samples) + 2 * outputs;
        let backward = product(samples, hidden, outputs) + product(samples, hidden, hidden);
        let members = 4 * (2 * 2 + SAMPLES);
        let first = (1 + inputs.div_ceil(INPUTS)) * (4 + most + parts(hidden * INPUTS.div_ceil(4)) * members);
        let steps = product(hidden, outputs, samples)
            + product(hidden, hidden, samples)
            + first
            + 2 * few(hidden, samples)
            + few(outputs, samples);
        forward(2 * samples) + forward(samples) + loss + backward + steps
    }

    /// Whether both learn from the same.
    pub fn is_of_the_check_of(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.common, &other.common)
    }

    /// What the jobs of a check have in common, as it lies on the device.
    pub fn shared(&self) -> [&[u32]; 4] {
        let Common { columns, rows, ones, draws, .. } = &*self.common;
        [columns, rows, ones, draws]
    }

    /// What only this job has beside its numbers, as it lies on the device.
    pub fn own(&self) -> [&[u32]; 2] {
        [&self.extra, &self.corrections]
    }

    /// Parameters, target and moments.
    pub fn numbers(&self) -> &[f32] {
        &self.memory
    }

    /// What the kernel reads of a job that lies at these offsets: its numbers, what it shares, what it has alone.
    pub fn placed(&self, memory: u32, [columns, rows, ones, draws]: [u32; 4], [extra, corrections]: [u32; 2]) -> Job {
        let base = self.job;
        Job {
            online: memory + base.online,
            goal: memory + base.goal,
            first: memory + base.first,
            second: memory + base.second,
            largest: memory + base.largest,
            work: memory + base.work,
            columns,
            extra,
            rows,
            ones,
            draws,
            corrections,
            ..base
        }
    }

    /// Numbers that it has on the device, with the kernel's working memory behind them.
    pub fn size(&self) -> u32 {
        self.memory.len() as u32 + self.work()
    }

    /// Bytes of the two large buffers. What jobs share is counted with each.
    pub fn bytes(&self) -> [u64; 2] {
        let data: usize = self.shared().iter().chain(&self.own()).map(|part| part.len()).sum();
        [4 * u64::from(self.size()), 4 * data as u64]
    }

    /// The learner with what came back: parameters, target and moments, in the order of [`Packed::memory`]. `agent`
    /// is the copy from which the forecast started.
    pub fn finished(&self, mut agent: Ddqn, values: &[f32]) -> Ddqn {
        let hidden = self.job.hidden as usize;
        let mut parts = values.chunks_exact(self.parameters as usize);
        // Rows of inputs that are never one stay what they were.
        let mut spread = |whole: &mut [f32]| {
            let part = parts.next().expect("every part came back");
            let (first, rest) = part.split_at(self.common.inputs.len() * hidden);
            for (&input, row) in self.common.inputs.iter().zip(first.chunks_exact(hidden)) {
                let at = input as usize * hidden;
                whole[at..at + hidden].copy_from_slice(row);
            }
            let tail = whole.len() - rest.len();
            whole[tail..].copy_from_slice(rest);
        };
        spread(agent.online_mut().params_mut());
        spread(agent.target_mut().params_mut());
        let (first, second, largest) = agent.optimizer().moments();
        let mut moments = [first, second, largest].map(<[f32]>::to_vec);
        moments.iter_mut().filter(|moments| !moments.is_empty()).for_each(|moments| spread(moments));
        let [first, second, largest] = &moments;
        let optimizer = agent.optimizer_mut();
        optimizer.take_over(self.job.updates, [first, second, largest]);
        self.touched.iter().for_each(|&input| optimizer.touch(input));
        agent
    }
}
