// Updates of TD3 learners (twin: core/src/agent/td3.rs): an update is a sequence of dispatches, listed in td3.rs,
// and every dispatch does one step of it for all jobs. Every sum has the twin's order and nothing is fused here; a
// compiler of the device may fuse, so a graphics card is an arithmetic of its own.
//
// Everything of a job lies in `memory`, at the offsets that its products and steps name. Samples of a mini-batch are
// rows: the drawn ones, then the forced ones. Equal observations are not computed once: numbers hardly repeat.

/// Invocations of a workgroup of the products.
const THREADS = 128u;
/// Invocations of a workgroup of the kernels that give each sample an invocation.
const SAMPLES = 64u;
/// A workgroup computes a tile of a product; each invocation four by four numbers of it.
const TILE_ROWS = 32u;
const TILE_COLUMNS = 64u;
const ROW_GROUPS = TILE_ROWS / 4u;
const COLUMN_GROUPS = TILE_COLUMNS / 4u;
/// Terms of the sums that lie in workgroup memory at a time.
const DEPTH = 16u;
/// Distances there from term to term: one more than there are groups, so that neighbours have banks of their own.
const LEFT_STEP = ROW_GROUPS + 1u;
const RIGHT_STEP = COLUMN_GROUPS + 1u;
/// Not there: an offset, or the next state of a terminated transition.
const NONE = 0xffffffffu;
/// Moments below these become zero, as in the twin of the optimiser (core/src/nn/optim.rs).
const TINY_FIRST = 1e-30;
const TINY_SECOND = 1e-36;
/// Products and steps of a job.
const PRODUCTS = 29u;
const STEPS = 9u;

/// A layer on a mini-batch, forwards or backwards (twin: core/src/nn/gemm.rs): `start + A·B`. All offsets are
/// those of numbers in `memory`.
struct Product {
    rows: u32,
    /// Terms of each sum.
    inner: u32,
    columns: u32,
    /// A: its first number, and the distance from row to row.
    left: u32,
    left_step: u32,
    /// B: its first number, and the distances from term to term and from column to column.
    right: u32,
    right_term: u32,
    right_column: u32,
    /// First term of each column's sums; `NONE` for zero.
    start: u32,
    out: u32,
    /// Backwards: the activations whose ReLU gates the sums. `NONE` forwards.
    gate: u32,
    /// Due in every n-th update, with this n.
    every: u32,
}

/// The gradient of a layer, and a step of the optimiser on its parameters.
struct Step {
    inputs: u32,
    columns: u32,
    /// In `memory`: inputs of the layer, and their distance from sample to sample.
    left: u32,
    left_step: u32,
    /// In `memory`: derivatives of the loss by the layer's sums.
    slopes: u32,
    /// In `memory`: weights and biases. Behind them at distances of `parameters`: target, first moment, second moment,
    /// largest second moment.
    live: u32,
    parameters: u32,
    /// In `data`: bias corrections of the optimiser, two per step.
    corrections: u32,
    /// Due in every n-th update, with this n.
    every: u32,
    /// In `memory`: losses of the samples for this step to sum; `NONE` for none.
    losses: u32,
}

/// One learner and what it learns from.
struct Job {
    updates: u32,
    /// Updates of the critics per step of the actor and of the target networks.
    policy_delay: u32,
    /// Numbers of an observation and of an action.
    width: u32,
    actions: u32,
    /// Drawn and forced samples of a mini-batch.
    drawn: u32,
    forced: u32,
    /// In `data`: observations.
    observations: u32,
    /// In `data`: numbers of the observations before and after the step, rewards (one column of `slots` entries
    /// each) and actions of the transitions; then the same of the forced ones.
    columns: u32,
    slots: u32,
    extra: u32,
    /// In `data`: slots of the drawn samples, update by update.
    draws: u32,
    /// In `data`: noise of the target actions, update by update.
    noise: u32,
    /// In `memory`, an observation and an action per sample: the transition's, those after it, those of the actor.
    pairs: u32,
    next_pairs: u32,
    own_pairs: u32,
    /// In `memory`, per sample: reward, and 1 where the episode goes on.
    rewards: u32,
    goes_on: u32,
    /// In `memory`, per sample: derivatives of the actor's actions by its outputs, and of the mean value by them.
    squash_slopes: u32,
    actor_slopes: u32,
    /// In `memory`, per critic and sample: losses, and their derivatives by the values.
    losses: u32,
    value_slopes: u32,
    /// One over the number of samples.
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
    /// 1 where the largest second moment divides (AMSGrad).
    amsgrad: u32,
    products: array<Product, PRODUCTS>,
    steps: array<Step, STEPS>,
}

/// What a dispatch does: for each job, products or steps from the `first` on, `parts` of them.
struct Operation {
    first: u32,
    parts: u32,
}

/// The update that a dispatch belongs to, from 0.
struct Update {
    number: u32,
}

@group(0) @binding(0) var<storage, read> jobs: array<Job>;
@group(0) @binding(1) var<storage, read> data: array<u32>;
@group(0) @binding(2) var<storage, read_write> memory: array<f32>;
/// Per job: 1 + the first update whose loss was no finite number, 0 without.
@group(0) @binding(3) var<storage, read_write> failures: array<u32>;
@group(1) @binding(0) var<uniform> operation: Operation;
@group(1) @binding(1) var<uniform> update: Update;

var<workgroup> left: array<vec4<f32>, DEPTH * LEFT_STEP>;
var<workgroup> right: array<vec4<f32>, DEPTH * RIGHT_STEP>;
/// The sums of a tile, row by row.
var<workgroup> tile: array<vec4<f32>, TILE_ROWS * COLUMN_GROUPS>;

/// Whether a job goes on, and what is due in every n-th update is due now, with this n.
fn is_due(index: u32, every: u32) -> bool {
    return update.number < jobs[index].updates && (update.number + 1u) % every == 0u;
}

/// A matrix whose columns (on the right) or rows (on the left) are told by `j` and whose terms by `k`.
struct Side {
    first: u32,
    by_k: u32,
    by_j: u32,
    /// How many `j` there are, and the one where all numbers are one (`NONE`: none).
    count: u32,
    ones: u32,
}

fn number(side: Side, k: u32, j: u32) -> f32 {
    if j == side.ones {
        return 1.0;
    }
    if j >= side.count {
        return 0.0;
    }
    return memory[side.first + k * side.by_k + j * side.by_j];
}

fn four_numbers(side: Side, k: u32, j: u32, inner: u32) -> vec4<f32> {
    if k >= inner {
        return vec4<f32>();
    }
    return vec4<f32>(number(side, k, j), number(side, k, j + 1u), number(side, k, j + 2u), number(side, k, j + 3u));
}

/// Which term and which group an invocation brings: neighbours take neighbouring numbers of `memory`.
fn place(side: Side, item: u32, groups: u32) -> vec2<u32> {
    if side.by_k == 1u {
        return vec2<u32>(item % DEPTH, item / DEPTH);
    }
    return vec2<u32>(item / groups, item % groups);
}

/// Leaves the sums of the tile from row `top` and column `from` on in `tile`.
fn sum_tile(inner: u32, rows: Side, columns: Side, start: u32, top: u32, from_column: u32, thread: u32) {
    let row_group = thread / COLUMN_GROUPS;
    let column_group = thread % COLUMN_GROUPS;
    var begin = vec4<f32>();
    if start != NONE {
        begin = four_numbers(Side(start, 0u, 1u, columns.count, NONE), 0u, from_column + 4u * column_group, 1u);
    }
    var sum0 = begin;
    var sum1 = begin;
    var sum2 = begin;
    var sum3 = begin;
    for (var block = 0u; block < inner; block += DEPTH) {
        workgroupBarrier();
        for (var item = thread; item < DEPTH * ROW_GROUPS; item += THREADS) {
            let at = place(rows, item, ROW_GROUPS);
            left[at.x * LEFT_STEP + at.y] = four_numbers(rows, block + at.x, top + 4u * at.y, inner);
        }
        for (var item = thread; item < DEPTH * COLUMN_GROUPS; item += THREADS) {
            let at = place(columns, item, COLUMN_GROUPS);
            right[at.x * RIGHT_STEP + at.y] = four_numbers(columns, block + at.x, from_column + 4u * at.y, inner);
        }
        workgroupBarrier();
        // Of constant length, so that it is unrolled; behind the last term are zeros, which change no sum.
        for (var k = 0u; k < DEPTH; k += 1u) {
            let factors = left[k * LEFT_STEP + row_group];
            let line = right[k * RIGHT_STEP + column_group];
            let term0 = factors.x * line;
            let term1 = factors.y * line;
            let term2 = factors.z * line;
            let term3 = factors.w * line;
            sum0 += term0;
            sum1 += term1;
            sum2 += term2;
            sum3 += term3;
        }
    }
    let at = 4u * row_group * COLUMN_GROUPS + column_group;
    tile[at] = sum0;
    tile[at + COLUMN_GROUPS] = sum1;
    tile[at + 2u * COLUMN_GROUPS] = sum2;
    tile[at + 3u * COLUMN_GROUPS] = sum3;
    workgroupBarrier();
}

/// A hidden layer, forwards or backwards.
@compute @workgroup_size(THREADS)
fn layer(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let index = group.z / operation.parts;
    let product = jobs[index].products[operation.first + group.z % operation.parts];
    let top = group.y * TILE_ROWS;
    let from_column = group.x * TILE_COLUMNS;
    if !is_due(index, product.every) || top >= product.rows || from_column >= product.columns {
        return;
    }
    let rows = Side(product.left, 1u, product.left_step, product.rows, NONE);
    let columns = Side(product.right, product.right_term, product.right_column, product.columns, NONE);
    sum_tile(product.inner, rows, columns, product.start, top, from_column, thread);
    for (var item = thread; item < TILE_ROWS * TILE_COLUMNS; item += THREADS) {
        let row = top + item / TILE_COLUMNS;
        let column = from_column + item % TILE_COLUMNS;
        if row < product.rows && column < product.columns {
            let at = row * product.columns + column;
            let sum = tile[item / 4u][item % 4u];
            if product.gate == NONE {
                memory[product.out + at] = select(sum, 0.0, sum < 0.0);
            } else {
                memory[product.out + at] = select(0.0, sum, memory[product.gate + at] > 0.0);
            }
        }
    }
}

/// One sum of a product.
fn sum_of(product: Product, row: u32, column: u32) -> f32 {
    var sum = 0.0;
    if product.start != NONE {
        sum = memory[product.start + column];
    }
    let a = product.left + row * product.left_step;
    let b = product.right + column * product.right_column;
    for (var k = 0u; k < product.inner; k += 1u) {
        let term = memory[a + k] * memory[b + k * product.right_term];
        sum += term;
    }
    return sum;
}

/// Reads a mini-batch: states with actions, next states, rewards.
@compute @workgroup_size(SAMPLES)
fn gather(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let index = group.z;
    let job = &jobs[index];
    let sample = group.x * SAMPLES + thread;
    let drawn = (*job).drawn;
    if !is_due(index, 1u) || sample >= drawn + (*job).forced {
        return;
    }
    var columns = (*job).columns;
    var entries = (*job).slots;
    var slot = 0u;
    if sample < drawn {
        slot = data[(*job).draws + update.number * drawn + sample];
    } else {
        columns = (*job).extra;
        entries = (*job).forced;
        slot = sample - drawn;
    }
    let width = (*job).width;
    let actions = (*job).actions;
    let at = sample * (width + actions);
    let state = (*job).observations + data[columns + slot] * width;
    for (var i = 0u; i < width; i += 1u) {
        let x = bitcast<f32>(data[state + i]);
        memory[(*job).pairs + at + i] = x;
        memory[(*job).own_pairs + at + i] = x;
    }
    let action = columns + 3u * entries + slot * actions;
    for (var i = 0u; i < actions; i += 1u) {
        memory[(*job).pairs + at + width + i] = bitcast<f32>(data[action + i]);
    }
    let next = data[columns + entries + slot];
    for (var i = 0u; i < width; i += 1u) {
        var x = 0.0;
        if next != NONE {
            x = bitcast<f32>(data[(*job).observations + next * width + i]);
        }
        memory[(*job).next_pairs + at + i] = x;
    }
    memory[(*job).rewards + sample] = bitcast<f32>(data[columns + 2u * entries + slot]);
    memory[(*job).goes_on + sample] = select(1.0, 0.0, next == NONE);
}

/// ln(2) in two parts, of which the first has few digits: small multiples of it are exact.
const LN2_FIRST = 0.693359375;
const LN2_REST = -2.12194440e-4;
const INVERSE_LN2 = 1.44269504;
/// From here on the tangent rounds to one.
const SATURATED = 9.02;

/// The hyperbolic tangent, within a few units in the last place: `t/(t + 2)` with `t = exp(2|x|) − 1`, which is summed
/// as a series where nothing cancels. A device's own may be off by 1e-5.
fn tangent(x: f32) -> f32 {
    let magnitude = abs(x);
    var result = 1.0;
    if magnitude < SATURATED {
        // exp(2|x|) = 2^k·exp(r), |r| at most ln(2)/2.
        let argument = 2.0 * magnitude;
        let k = floor(argument * INVERSE_LN2 + 0.5);
        let r = (argument - k * LN2_FIRST) - k * LN2_REST;
        let tail = 1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0)));
        let series = r + r * r * (0.5 + r * (1.0 / 6.0 + r * tail));
        let power = bitcast<f32>(u32(127 + i32(k)) << 23u);
        let t = power * series + (power - 1.0);
        result = t / (t + 2.0);
        if t > 1.0 {
            result = 1.0 - 2.0 / (t + 2.0);
        }
    } else if !(magnitude >= SATURATED) {
        // Not a number.
        return x;
    }
    return select(result, -result, x < 0.0);
}

/// Actions of the target actor after each sample, with noise (part 0), and of the actor in each sample (part 1).
@compute @workgroup_size(SAMPLES)
fn act(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let index = group.z / operation.parts;
    let part = group.z % operation.parts;
    let job = &jobs[index];
    let product = (*job).products[operation.first + part];
    let sample = group.x * SAMPLES + thread;
    if !is_due(index, product.every) || sample >= product.rows {
        return;
    }
    let actions = (*job).actions;
    let pair = sample * ((*job).width + actions) + (*job).width;
    for (var i = 0u; i < actions; i += 1u) {
        let t = tangent(sum_of(product, sample, i));
        let squashed = (*job).middle + (*job).half * t;
        if part == 0u {
            let noise = (*job).noise + (update.number * product.rows + sample) * actions + i;
            let noisy = squashed + bitcast<f32>(data[noise]);
            let least = select(noisy, (*job).low, noisy < (*job).low);
            memory[(*job).next_pairs + pair + i] = select(least, (*job).high, least > (*job).high);
        } else {
            memory[(*job).own_pairs + pair + i] = squashed;
            memory[(*job).squash_slopes + sample * actions + i] = (*job).half * (1.0 - t * t);
        }
    }
}

/// Targets, losses of both critics and their derivatives by the values. Products: both critics on the mini-batch,
/// both target critics on what follows.
@compute @workgroup_size(SAMPLES)
fn loss(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let index = group.z;
    let job = &jobs[index];
    let sample = group.x * SAMPLES + thread;
    let samples = (*job).drawn + (*job).forced;
    if !is_due(index, 1u) || sample >= samples {
        return;
    }
    var y = memory[(*job).rewards + sample];
    if memory[(*job).goes_on + sample] != 0.0 {
        let a = sum_of((*job).products[operation.first + 2u], sample, 0u);
        let b = sum_of((*job).products[operation.first + 3u], sample, 0u);
        let bootstrap = (*job).gamma * select(a, b, b < a);
        y += bootstrap;
    }
    for (var critic = 0u; critic < 2u; critic += 1u) {
        let difference = sum_of((*job).products[operation.first + critic], sample, 0u) - y;
        let at = critic * samples + sample;
        memory[(*job).losses + at] = difference * difference * (*job).share;
        memory[(*job).value_slopes + at] = 2.0 * difference * (*job).share;
    }
}

/// The gradient of the mean value of the actor's actions by its outputs. Product: that by its actions.
@compute @workgroup_size(SAMPLES)
fn steer(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let index = group.z;
    let job = &jobs[index];
    let product = (*job).products[operation.first];
    let sample = group.x * SAMPLES + thread;
    if !is_due(index, product.every) || sample >= product.rows {
        return;
    }
    for (var i = 0u; i < product.columns; i += 1u) {
        let at = sample * product.columns + i;
        memory[(*job).actor_slopes + at] = memory[(*job).squash_slopes + at] * sum_of(product, sample, i);
    }
}

/// Notes a loss that is no finite number.
fn note_loss(index: u32, losses: u32) {
    let samples = jobs[index].drawn + jobs[index].forced;
    var sum = 0.0;
    for (var i = 0u; i < 2u * samples; i += 1u) {
        sum += memory[losses + i];
    }
    // All ones in the exponent: infinite or no number.
    if (bitcast<u32>(sum) & 0x7f800000u) == 0x7f800000u && failures[index] == 0u {
        failures[index] = update.number + 1u;
    }
}

/// Gradients of layers, each with the optimiser's step (twin: core/src/nn/optim.rs) and, where the actor moves too,
/// that of the moving average.
@compute @workgroup_size(THREADS)
fn step(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let index = group.z / operation.parts;
    let job = &jobs[index];
    let layer = (*job).steps[operation.first + group.z % operation.parts];
    let top = group.y * TILE_ROWS;
    let from_column = group.x * TILE_COLUMNS;
    // The biases are the weights of an input that is always one, and lie behind those of the others.
    if !is_due(index, layer.every) || top > layer.inputs || from_column >= layer.columns {
        return;
    }
    let samples = (*job).drawn + (*job).forced;
    let rows = Side(layer.left, layer.left_step, 1u, layer.inputs, layer.inputs);
    let columns = Side(layer.slopes, layer.columns, 1u, layer.columns, NONE);
    sum_tile(samples, rows, columns, NONE, top, from_column, thread);
    if layer.losses != NONE && top == 0u && from_column == 0u && thread == 0u {
        note_loss(index, layer.losses);
    }
    let corrections = layer.corrections + 2u * ((update.number + 1u) / layer.every - 1u);
    let rate = bitcast<f32>(data[corrections]);
    let root = bitcast<f32>(data[corrections + 1u]);
    let moves = is_due(index, (*job).policy_delay);
    let clip = (*job).clip;
    let keep_first = (*job).keep_first;
    let add_first = (*job).add_first;
    let keep_second = (*job).keep_second;
    let add_second = (*job).add_second;
    let epsilon = (*job).epsilon;
    let shrink = (*job).shrink;
    let tau = (*job).tau;
    let amsgrad = (*job).amsgrad == 1u;
    for (var item = thread; item < TILE_ROWS * TILE_COLUMNS; item += THREADS) {
        let row = top + item / TILE_COLUMNS;
        let column = from_column + item % TILE_COLUMNS;
        if row > layer.inputs || column >= layer.columns {
            continue;
        }
        let live = layer.live + row * layer.columns + column;
        let goal = live + layer.parameters;
        let first = goal + layer.parameters;
        let second = first + layer.parameters;
        let largest = second + layer.parameters;
        let raw = tile[item / 4u][item % 4u];
        let low = select(raw, -clip, raw < -clip);
        let gradient = select(low, clip, low > clip);
        let kept_first = keep_first * memory[first];
        let a = kept_first + add_first * gradient;
        let kept_second = keep_second * memory[second];
        let b = kept_second + add_second * (gradient * gradient);
        let moment = select(a, 0.0, a < TINY_FIRST && a > -TINY_FIRST);
        let square = select(b, 0.0, b < TINY_SECOND);
        memory[first] = moment;
        memory[second] = square;
        var under = square;
        if amsgrad {
            let before = memory[largest];
            under = select(before, square, square > before);
            memory[largest] = under;
        }
        let denominator = sqrt(under) * root + epsilon;
        let shrunk = memory[live] * shrink;
        let value = shrunk - rate * moment / denominator;
        memory[live] = value;
        if moves {
            let average = memory[goal];
            memory[goal] = average + tau * (value - average);
        }
    }
}
