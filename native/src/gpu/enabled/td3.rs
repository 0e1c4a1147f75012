//! Jobs of TD3 learners for the kernels in `td3.wgsl`: what goes to the device, the dispatches of an update, and what
//! comes back.
//!
//! The layers are large, so a layer on a mini-batch is a dispatch: tiles of its numbers are spread over workgroups,
//! and all jobs, and all networks that have this layer to do at this point, are in one dispatch.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use mcvl_core::agent::Agent;
use mcvl_core::agent::td3::Td3;
use mcvl_core::config::Config;
use mcvl_core::env::Continuous;
use mcvl_core::forecast::ForecastJob;
use mcvl_core::nn::optim::{BETA1, BETA2, EPSILON};
use mcvl_core::replay::{Forced, NO_ROW, ReplayBuffer};
use wgpu::{CommandEncoder, ComputePipeline};

use super::super::GpuError;
use super::device::{Binding, DYNAMIC_STEP, Device};
use super::transfer::{Outcome, Parts, Returns, draws, record};

/// The kernels.
pub const SOURCE: &str = include_str!("td3.wgsl");

/// Constants of the kernels, by the same names.
pub const THREADS: u32 = 128;
pub const SAMPLES: u32 = 64;
pub const TILE_ROWS: u32 = 32;
pub const TILE_COLUMNS: u32 = 64;
pub const PRODUCTS: usize = 29;
pub const STEPS: usize = 9;
const NONE: u32 = u32::MAX;
/// Bytes of a forecast's random numbers at most: thirty times those of the paper's.
const DRAWS_BYTES: u64 = 1 << 30;

record! {
    /// `Product` of the kernels.
    Product {
        rows: u32,
        inner: u32,
        columns: u32,
        left: u32,
        left_step: u32,
        right: u32,
        right_term: u32,
        right_column: u32,
        start: u32,
        out: u32,
        gate: u32,
        every: u32,
    }
}

record! {
    /// `Step` of the kernels.
    Step {
        inputs: u32,
        columns: u32,
        left: u32,
        left_step: u32,
        slopes: u32,
        live: u32,
        parameters: u32,
        corrections: u32,
        every: u32,
        losses: u32,
    }
}

record! {
    /// `Job` of the kernels.
    Job {
        updates: u32,
        policy_delay: u32,
        width: u32,
        actions: u32,
        drawn: u32,
        forced: u32,
        observations: u32,
        columns: u32,
        slots: u32,
        extra: u32,
        draws: u32,
        noise: u32,
        pairs: u32,
        next_pairs: u32,
        own_pairs: u32,
        rewards: u32,
        goes_on: u32,
        squash_slopes: u32,
        actor_slopes: u32,
        losses: u32,
        value_slopes: u32,
        share: f32,
        gamma: f32,
        tau: f32,
        low: f32,
        high: f32,
        middle: f32,
        half: f32,
        keep_first: f32,
        add_first: f32,
        keep_second: f32,
        add_second: f32,
        epsilon: f32,
        shrink: f32,
        clip: f32,
        amsgrad: u32,
        products: [Product; PRODUCTS],
        steps: [Step; STEPS],
    }
}

record! {
    /// `Operation` of the kernels.
    Operation {
        first: u32,
        parts: u32,
    }
}

record! {
    /// `Update` of the kernels.
    Update {
        number: u32,
    }
}

/// Entry points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    Gather,
    Layer,
    Act,
    Loss,
    Step,
    Steer,
}

/// Their names, in that order.
pub const ENTRIES: [&str; 6] = ["gather", "layer", "act", "loss", "step", "steer"];

/// A dispatch of an update.
#[derive(Clone, Copy, Debug)]
pub struct Dispatch {
    entry: Entry,
    operation: Operation,
    /// Only where some actor moves.
    actor: bool,
}

const fn dispatch(entry: Entry, first: u32, parts: u32) -> Dispatch {
    Dispatch { entry, operation: Operation { first, parts }, actor: false }
}

const fn of_actor(entry: Entry, first: u32) -> Dispatch {
    let parts = if matches!(entry, Entry::Step) { 3 } else { 1 };
    Dispatch { entry, operation: Operation { first, parts }, actor: true }
}

/// The dispatches of an update. Numbers are those of the products that [`Packed::products`] and of the steps that
/// [`Packed::steps`] list.
pub const UPDATE: [Dispatch; 18] = [
    dispatch(Entry::Gather, 0, 1),
    // Hidden layers: target actor after the samples, critics in them, and, where it moves, the actor.
    dispatch(Entry::Layer, 0, 4),
    dispatch(Entry::Layer, 4, 4),
    dispatch(Entry::Act, 8, 2),
    // Target critics on what follows.
    dispatch(Entry::Layer, 10, 2),
    dispatch(Entry::Layer, 12, 2),
    dispatch(Entry::Loss, 14, 1),
    // Critics backwards. Derivatives first, while the weights are the old ones.
    dispatch(Entry::Layer, 18, 2),
    dispatch(Entry::Layer, 20, 2),
    dispatch(Entry::Step, 0, 6),
    // The first critic, as it is now, on the actor's actions, forwards and backwards.
    of_actor(Entry::Layer, 22),
    of_actor(Entry::Layer, 23),
    of_actor(Entry::Layer, 24),
    of_actor(Entry::Layer, 25),
    of_actor(Entry::Steer, 26),
    // The actor backwards.
    of_actor(Entry::Layer, 27),
    of_actor(Entry::Layer, 28),
    of_actor(Entry::Step, 6),
];

/// Whether the kernels have runs of this configuration.
///
/// # Errors
/// Why not.
pub fn supports(config: &Config) -> Result<(), String> {
    if config.layers != 2 {
        return Err(format!("the kernels have networks of two hidden layers, and layers = {}", config.layers));
    }
    // A slot and the noise of two numbers for each sample.
    let bytes = 4 * 3 * u64::from(config.forecast) * u64::from(config.batch);
    if bytes > DRAWS_BYTES {
        return Err(format!(
            "the random numbers of a forecast are made beforehand, and would take {} MiB (forecast = {}, batch = {})",
            bytes >> 20,
            config.forecast,
            config.batch
        ));
    }
    Ok(())
}

/// What the jobs of one check have in common.
#[derive(Debug)]
struct Common {
    /// The bits of their numbers.
    observations: Vec<u32>,
    /// Columns of the replay buffer.
    columns: Vec<u32>,
    slots: u32,
    draws: Vec<u32>,
}

/// Sizes of a job.
#[derive(Clone, Copy, Debug)]
struct Shape {
    /// Numbers of an observation and of an action.
    width: u32,
    actions: u32,
    hidden: u32,
    samples: u32,
}

/// One job, ready for the device.
#[derive(Debug)]
pub struct Packed {
    common: Arc<Common>,
    shape: Shape,
    /// Sizes and settings; products, steps and offsets are unset.
    job: Job,
    /// The learner's numbers, then the derivative that [`Places::lowered`] means.
    memory: Vec<f32>,
    /// How many the learner's are: they come back.
    learned: u32,
    /// Columns of the forced transitions.
    extra: Vec<u32>,
    noise: Vec<u32>,
    /// Of the actor and both critics each.
    corrections: [Vec<u32>; 3],
}

/// Columns of transitions: observations before and after the step, rewards, actions.
fn table<const N: usize>(
    state: impl Iterator<Item = u32>,
    next: impl Iterator<Item = u32>,
    reward: impl Iterator<Item = f32>,
    action: impl Iterator<Item = Continuous<N>>,
) -> Vec<u32> {
    let mut table: Vec<u32> = state.collect();
    table.extend(next);
    table.extend(reward.map(f32::to_bits));
    table.extend(action.flat_map(|action| action.0.map(f32::to_bits)));
    table
}

/// Packs jobs whose replay buffer, seed and version are one and the same.
pub fn pack<E, const N: usize>(jobs: &[ForecastJob<'_, E, Td3<N>>]) -> Vec<Packed> {
    let Some(first) = jobs.first() else { return Vec::new() };
    let (replay, columns): (&ReplayBuffer<_>, _) = (first.replay, first.replay.columns());
    let (width, slots) = (replay.spec().width, replay.len());
    let known = columns.observations.len() as u32;
    let mut observations = vec![0; known as usize * width];
    for (row, words) in observations.chunks_exact_mut(width).zip(columns.observations) {
        // A number that is not in use has no words.
        row[..words.len()].copy_from_slice(words);
    }
    // Behind them the observations of forced transitions that the buffer does not hold, job by job.
    let mut extras = Vec::new();
    for job in jobs {
        let forced = Forced::new(job.forced, replay);
        let shift = (observations.len() / width) as u32 - known;
        let number = |id: u32| if id < known { id } else { id + shift };
        extras.push(table(
            forced.entries().map(|(_, state, _)| number(state)),
            forced.entries().map(|(t, _, next)| if t.terminated { NO_ROW } else { number(next) }),
            job.forced.iter().map(|t| t.reward),
            job.forced.iter().map(|t| t.action),
        ));
        forced.extra().iter().for_each(|words| observations.extend_from_slice(words));
    }
    let next = columns.next.iter().zip(columns.terminated).map(|(&next, &over)| if over { NO_ROW } else { next });
    let columns =
        table(columns.state.iter().copied(), next, columns.reward.iter().copied(), columns.action.iter().copied());
    let draws = draws(jobs);
    let common = Arc::new(Common { observations, columns, slots, draws });
    jobs.iter().zip(extras).map(|(job, extra)| Packed::new(job, common.clone(), extra)).collect()
}

/// A layer's place in a network's parameters.
#[derive(Clone, Copy, Debug)]
struct Layer {
    inputs: u32,
    outputs: u32,
    weights: u32,
}

impl Layer {
    fn bias(self) -> u32 {
        self.weights + self.inputs * self.outputs
    }

    fn end(self) -> u32 {
        self.bias() + self.outputs
    }
}

/// A network's place in `memory`.
#[derive(Clone, Copy, Debug)]
struct Network {
    live: u32,
    parameters: u32,
    layers: [Layer; 3],
    /// Activations of both hidden layers, live and target.
    hidden: [[u32; 2]; 2],
}

/// Where everything of a job lies in `memory`: what is brought there, then working memory.
#[derive(Clone, Copy, Debug)]
struct Places {
    /// The actor and both critics.
    networks: [Network; 3],
    /// Minus one over the number of samples, per sample: the derivative of what the actor's step lowers.
    lowered: u32,
    pairs: u32,
    next_pairs: u32,
    own_pairs: u32,
    rewards: u32,
    goes_on: u32,
    squash_slopes: u32,
    actor_slopes: u32,
    losses: u32,
    value_slopes: u32,
    /// Derivatives by the sums of both hidden layers, of two networks.
    slopes: [[u32; 2]; 2],
    end: u32,
}

impl Shape {
    /// The layers of a network.
    fn layers(self, inputs: u32, outputs: u32) -> [Layer; 3] {
        let first = Layer { inputs, outputs: self.hidden, weights: 0 };
        let second = Layer { inputs: self.hidden, outputs: self.hidden, weights: first.end() };
        [first, second, Layer { inputs: self.hidden, outputs, weights: second.end() }]
    }

    /// The places of a job from `begin` on; `copies` sets of numbers lie there for each network.
    fn places(self, begin: u32, copies: u32) -> Places {
        let Self { width, actions, hidden, samples } = self;
        let mut end = begin;
        let mut take = |count: u32| {
            end += count;
            end - count
        };
        let layers = [(width, actions), (width + actions, 1), (width + actions, 1)]
            .map(|(inputs, outputs)| self.layers(inputs, outputs));
        let lives = layers.map(|layers| take(copies * layers[2].end()));
        let lowered = take(samples);
        let mut activations = || [take(samples * hidden), take(samples * hidden)];
        let networks = std::array::from_fn(|i| Network {
            live: lives[i],
            parameters: layers[i][2].end(),
            layers: layers[i],
            hidden: [activations(), activations()],
        });
        let slopes = [activations(), activations()];
        Places {
            networks,
            lowered,
            pairs: take(samples * (width + actions)),
            next_pairs: take(samples * (width + actions)),
            own_pairs: take(samples * (width + actions)),
            rewards: take(samples),
            goes_on: take(samples),
            squash_slopes: take(samples * actions),
            actor_slopes: take(samples * actions),
            losses: take(2 * samples),
            value_slopes: take(2 * samples),
            slopes,
            end,
        }
    }
}

impl Packed {
    fn new<E, const N: usize>(job: &ForecastJob<'_, E, Td3<N>>, common: Arc<Common>, extra: Vec<u32>) -> Self {
        let agent = job.agent.for_forecast(job.carry);
        let (settings, optimizers, updates) = (*agent.config(), agent.optimizers(), job.value_updates());
        let samples = job.batch + job.forced.len() as u32;
        let shape = Shape {
            width: agent.actor().sizes()[0] as u32,
            actions: N as u32,
            hidden: settings.hidden as u32,
            samples,
        };
        let mut memory: Vec<f32> = agent.numbers().collect();
        let learned = memory.len() as u32;
        let share = 1.0 / samples as f32;
        memory.extend((0..samples).map(|_| -share));
        let mut noise = Vec::with_capacity(updates as usize * samples as usize * N);
        for update in 1..=updates {
            let mut stream = job.update_stream(update);
            noise.extend((0..samples).flat_map(|_| agent.target_noise(&mut stream)).map(f32::to_bits));
        }
        let steps = [updates / settings.policy_delay, updates, updates];
        let corrections = std::array::from_fn(|i| {
            let mut corrections = optimizers[i].corrections();
            (0..steps[i]).flat_map(|_| corrections.advance()).map(f32::to_bits).collect()
        });
        let [low, high] = agent.range();
        let adam = settings.adam;
        let job = Job {
            updates,
            policy_delay: settings.policy_delay,
            width: shape.width,
            actions: shape.actions,
            drawn: job.batch,
            forced: job.forced.len() as u32,
            slots: common.slots,
            share,
            gamma: settings.gamma,
            tau: settings.tau,
            low,
            high,
            middle: agent.middle(),
            half: agent.half(),
            keep_first: BETA1 as f32,
            add_first: (1.0 - BETA1) as f32,
            keep_second: BETA2 as f32,
            add_second: (1.0 - BETA2) as f32,
            epsilon: EPSILON,
            shrink: adam.shrink(),
            clip: if adam.clip > 0.0 { adam.clip } else { f32::MAX },
            amsgrad: u32::from(adam.amsgrad()),
            ..Job::default()
        };
        Self { common, shape, job, memory, learned, extra, noise, corrections }
    }

    /// Updates to make.
    pub fn updates(&self) -> u32 {
        self.job.updates
    }

    fn places(&self, begin: u32) -> Places {
        self.shape.places(begin, if self.job.amsgrad == 1 { 5 } else { 4 })
    }

    /// Bytes of the two large buffers. What jobs share is counted with each.
    pub fn bytes(&self) -> [u64; 2] {
        let Common { observations, columns, draws, .. } = &*self.common;
        let common = observations.len() + columns.len() + draws.len();
        let corrections: usize = self.corrections.iter().map(Vec::len).sum();
        let data = common + self.extra.len() + self.noise.len() + corrections;
        [4 * u64::from(self.places(0).end), 4 * data as u64]
    }

    /// Turns of the loops of one invocation in one dispatch, at most; loops of constant length are unrolled.
    pub fn loops(&self) -> u32 {
        let Shape { width, actions, hidden, samples } = self.shape;
        let tile = |inner: u32| 2 * inner + TILE_ROWS * TILE_COLUMNS / THREADS;
        let step = tile(samples) + 2 * samples;
        let layer = tile(hidden.max(width + actions));
        let sums = actions.max(4) * (1 + hidden);
        step.max(layer).max(sums).max(2 * width + actions)
    }

    /// The products of an update, in the order of [`UPDATE`].
    fn products(&self, places: &Places) -> [Product; PRODUCTS] {
        let Shape { width, actions, samples, .. } = self.shape;
        let (pair, delay) = (width + actions, self.job.policy_delay);
        let [actor, first, second] = places.networks;
        // A layer of a network, or of its target, forwards; `left` is where its inputs lie.
        let forward = |network: Network, target: usize, layer: usize, left: u32, left_step: u32, every: u32| {
            let place = network.layers[layer];
            let params = network.live + target as u32 * network.parameters;
            Product {
                rows: samples,
                inner: place.inputs,
                columns: place.outputs,
                left,
                left_step,
                right: params + place.weights,
                right_term: place.outputs,
                right_column: 1,
                start: params + place.bias(),
                // The outputs have no place: what uses them sums them.
                out: network.hidden[target].get(layer).copied().unwrap_or(NONE),
                gate: NONE,
                every,
            }
        };
        let inner = |network: Network, target: usize, layer: usize, every: u32| {
            let left = network.hidden[target][layer - 1];
            forward(network, target, layer, left, network.layers[layer].inputs, every)
        };
        // From the derivatives by the sums of a layer to those by the sums of the one before.
        let backward = |network: Network, layer: usize, left: u32, out: u32, every: u32| {
            let place = network.layers[layer];
            Product {
                rows: samples,
                inner: place.outputs,
                columns: place.inputs,
                left,
                left_step: place.outputs,
                right: network.live + place.weights,
                right_term: 1,
                right_column: place.outputs,
                start: NONE,
                out,
                gate: network.hidden[0][layer - 1],
                every,
            }
        };
        let [slopes, others] = places.slopes;
        let values = places.value_slopes;
        let to_actions = Layer { inputs: actions, ..first.layers[0] };
        [
            forward(actor, 1, 0, places.next_pairs, pair, 1),
            forward(first, 0, 0, places.pairs, pair, 1),
            forward(second, 0, 0, places.pairs, pair, 1),
            forward(actor, 0, 0, places.own_pairs, pair, delay),
            inner(actor, 1, 1, 1),
            inner(first, 0, 1, 1),
            inner(second, 0, 1, 1),
            inner(actor, 0, 1, delay),
            inner(actor, 1, 2, 1),
            inner(actor, 0, 2, delay),
            forward(first, 1, 0, places.next_pairs, pair, 1),
            forward(second, 1, 0, places.next_pairs, pair, 1),
            inner(first, 1, 1, 1),
            inner(second, 1, 1, 1),
            inner(first, 0, 2, 1),
            inner(second, 0, 2, 1),
            inner(first, 1, 2, 1),
            inner(second, 1, 2, 1),
            backward(first, 2, values, slopes[1], 1),
            backward(second, 2, values + samples, others[1], 1),
            backward(first, 1, slopes[1], slopes[0], 1),
            backward(second, 1, others[1], others[0], 1),
            forward(first, 0, 0, places.own_pairs, pair, delay),
            inner(first, 0, 1, delay),
            backward(first, 2, places.lowered, slopes[1], delay),
            backward(first, 1, slopes[1], slopes[0], delay),
            Product {
                rows: samples,
                inner: to_actions.outputs,
                columns: to_actions.inputs,
                left: slopes[0],
                left_step: to_actions.outputs,
                // The weights of the actions lie behind those of the observation.
                right: first.live + to_actions.weights + width * to_actions.outputs,
                right_term: 1,
                right_column: to_actions.outputs,
                start: NONE,
                out: NONE,
                gate: NONE,
                every: delay,
            },
            backward(actor, 2, places.actor_slopes, slopes[1], delay),
            backward(actor, 1, slopes[1], slopes[0], delay),
        ]
    }

    /// The steps of an update, in the order of [`UPDATE`]; `corrections` are those of the actor and both critics.
    fn steps(&self, places: &Places, corrections: [u32; 3]) -> [Step; STEPS] {
        let Shape { width, actions, samples, .. } = self.shape;
        let layers = |index: usize, inputs: u32, outputs: u32, hidden: [u32; 2], every: u32| {
            let network = places.networks[index];
            let left = [inputs, network.hidden[0][0], network.hidden[0][1]];
            let slopes = [hidden[0], hidden[1], outputs];
            let step = move |layer: usize| Step {
                inputs: network.layers[layer].inputs,
                columns: network.layers[layer].outputs,
                left: left[layer],
                left_step: if layer == 0 { width + actions } else { network.layers[layer].inputs },
                slopes: slopes[layer],
                live: network.live + network.layers[layer].weights,
                parameters: network.parameters,
                corrections: corrections[index],
                every,
                losses: NONE,
            };
            [step(0), step(1), step(2)]
        };
        let [slopes, others] = places.slopes;
        let [mut a, b, c] = layers(1, places.pairs, places.value_slopes, slopes, 1);
        a.losses = places.losses;
        let [d, e, f] = layers(2, places.pairs, places.value_slopes + samples, others, 1);
        let [g, h, i] = layers(0, places.own_pairs, places.actor_slopes, slopes, self.job.policy_delay);
        [a, b, c, d, e, f, g, h, i]
    }

    /// The job with its places.
    fn placed(&self, places: &Places, data: &Data) -> Job {
        Job {
            observations: data.common[0],
            columns: data.common[1],
            draws: data.common[2],
            extra: data.extra,
            noise: data.noise,
            pairs: places.pairs,
            next_pairs: places.next_pairs,
            own_pairs: places.own_pairs,
            rewards: places.rewards,
            goes_on: places.goes_on,
            squash_slopes: places.squash_slopes,
            actor_slopes: places.actor_slopes,
            losses: places.losses,
            value_slopes: places.value_slopes,
            products: self.products(places),
            steps: self.steps(places, data.corrections),
            ..self.job
        }
    }
}

/// Where a job's parts lie in `data`.
#[derive(Clone, Copy, Debug)]
struct Data {
    /// Observations, columns and draws.
    common: [u32; 3],
    extra: u32,
    noise: u32,
    corrections: [u32; 3],
}

/// The kernels on a device.
#[derive(Debug)]
pub struct Kernel {
    pipelines: [ComputePipeline; 6],
    buffers: wgpu::BindGroupLayout,
    numbers: wgpu::BindGroupLayout,
}

impl Kernel {
    /// Builds the kernels.
    pub fn new(device: &Device) -> Self {
        let buffers = device.layout("td3", &[Binding::Read, Binding::Read, Binding::Write, Binding::Write]);
        let numbers = device.layout("td3 numbers", &[Binding::Record, Binding::Record]);
        let pipelines = device.pipelines("td3", SOURCE, ENTRIES, &[&buffers, &numbers]);
        Self { pipelines, buffers, numbers }
    }
}

/// Jobs that train side by side.
#[derive(Debug)]
pub struct Batch {
    pipelines: [ComputePipeline; 6],
    buffers: wgpu::BindGroup,
    numbers: wgpu::BindGroup,
    returns: Returns,
    /// Which updates move an actor.
    delays: Vec<u32>,
    /// Workgroups of each entry point along the first two axes.
    groups: [[u32; 2]; 6],
    updates: u32,
}

impl Batch {
    /// Brings jobs to the device.
    pub fn new(device: &Device, kernel: &Kernel, packed: &[Arc<Packed>]) -> Self {
        let mut data = Parts::default();
        let mut placed: BTreeMap<*const Common, [u32; 3]> = BTreeMap::new();
        let (mut jobs, mut memory, mut places) = (Vec::new(), 0, Vec::new());
        for job in packed {
            let Common { observations, columns, draws, .. } = &*job.common;
            let common = *placed
                .entry(Arc::as_ptr(&job.common))
                .or_insert_with(|| [observations, columns, draws].map(|part| data.add(part)));
            let (extra, noise) = (data.add(&job.extra), data.add(&job.noise));
            let corrections = job.corrections.each_ref().map(|part| data.add(part));
            let own = job.places(memory);
            jobs.push(job.placed(&own, &Data { common, extra, noise, corrections }));
            places.push((memory, job.learned));
            memory = own.end;
        }
        let data = data.bring(device, "td3 data");
        let buffer = device.buffer("td3 memory", 4 * u64::from(memory), &[]);
        for (job, (begin, _)) in packed.iter().zip(&places) {
            device.write(&buffer, 4 * u64::from(*begin), bytemuck::must_cast_slice(&job.memory));
        }
        let described = device.buffer("td3 jobs", 0, bytemuck::must_cast_slice(&jobs));
        let failures = device.buffer("td3 failures", 4 * jobs.len() as u64, &[]);
        let updates = packed.iter().map(|job| job.updates()).max().unwrap_or(0);
        let operations = device.records("td3 operations", UPDATE.map(|dispatch| dispatch.operation));
        let numbers = device.records("td3 updates", (0..updates.max(1)).map(|number| Update { number }));
        let most = |size: fn(&Shape) -> u32| packed.iter().map(|job| size(&job.shape)).max().unwrap_or(1);
        let (samples, hidden) = (most(|shape| shape.samples), most(|shape| shape.hidden));
        let actions = most(|shape| shape.actions);
        let widest = most(|shape| shape.hidden.max(shape.width + shape.actions));
        let by_sample = [samples.div_ceil(SAMPLES), 1];
        let groups = [
            by_sample,
            [hidden.div_ceil(TILE_COLUMNS), samples.div_ceil(TILE_ROWS)],
            by_sample,
            by_sample,
            [hidden.max(actions).div_ceil(TILE_COLUMNS), (widest + 1).div_ceil(TILE_ROWS)],
            by_sample,
        ];
        Self {
            pipelines: kernel.pipelines.clone(),
            buffers: device.bind("td3", &kernel.buffers, &[&described, &data, &buffer, &failures]),
            numbers: device.bind_records("td3 numbers", &kernel.numbers, &[&operations, &numbers]),
            returns: Returns::new(buffer, failures, places),
            delays: packed.iter().map(|job| job.job.policy_delay).collect(),
            groups,
            updates,
        }
    }
}

impl Batch {
    /// Updates of the longest job.
    pub fn updates(&self) -> u32 {
        self.updates
    }

    /// Commands for the updates `first..first + count` of every job.
    pub fn encode(&self, commands: &mut CommandEncoder, first: u32, count: u32) {
        let mut pass =
            commands.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("td3"), timestamp_writes: None });
        pass.set_bind_group(0, &self.buffers, &[]);
        for update in first..first + count {
            let moves = self.delays.iter().any(|&delay| (update + 1).is_multiple_of(delay));
            for (number, dispatch) in (0u32..).zip(&UPDATE) {
                if dispatch.actor && !moves {
                    continue;
                }
                let entry = dispatch.entry as usize;
                let [x, y] = self.groups[entry];
                pass.set_pipeline(&self.pipelines[entry]);
                pass.set_bind_group(1, &self.numbers, &[number * DYNAMIC_STEP, update * DYNAMIC_STEP]);
                pass.dispatch_workgroups(x, y, self.returns.jobs() * dispatch.operation.parts);
            }
        }
    }

    /// What a job brings back, or 1 + the update whose loss was no finite number; in the order of the jobs.
    ///
    /// # Errors
    /// If the device fails.
    pub fn results(&self, device: &Device) -> Result<Vec<Outcome>, GpuError> {
        self.returns.read(device)
    }
}

#[cfg(test)]
mod tests;
