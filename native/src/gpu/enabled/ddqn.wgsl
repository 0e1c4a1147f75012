// Updates of Double DQN learners (twin: core/src/agent/ddqn.rs): one workgroup trains one network, many updates per
// dispatch. Every sum has the twin's order, and the arithmetic is that of rounding.wgsl, which stands in front.
//
// Everything of a network lies in `memory`, from the offsets that its job names: live parameters, target
// parameters, moments, activations. Networks have two hidden layers; their first layer has only the inputs that
// are ever one in the data at hand.

/// Invocations of a workgroup: a multiple of `LANES`, up to `GROUPS` times it.
override THREADS: u32 = 128u;
/// Samples of a mini-batch at most, forced ones included.
const SAMPLES = 64u;
/// Columns of a tile of a product: one per invocation of a group.
const LANES = 128u;
/// Groups of a workgroup at most.
const GROUPS = 8u;
/// Rows of a tile that an invocation sums side by side: each group has its own.
const ROWS = 8u;
/// Terms of the sums that lie in workgroup memory at a time.
const DEPTH = 16u;
/// Distances there from term to term, in fours of rows, and in columns: one more than there are, so that neighbours
/// have banks of their own.
const FOURS = GROUPS * ROWS / 4u;
const RIGHT_STEP = LANES + 1u;
/// Inputs of the first layer whose samples are known at a time.
const INPUTS = 64u;
/// No row: the next state of a terminated transition.
const NO_ROW = 0xffffffffu;
/// Moments below these become zero, as in the twin of the optimiser (core/src/nn/optim.rs).
const TINY_FIRST = 1e-30;
const TINY_SECOND = 1e-36;

/// One network and what it learns from; all offsets in numbers of four bytes.
struct Job {
    inputs: u32,
    hidden: u32,
    outputs: u32,
    /// Drawn and forced samples of a mini-batch.
    drawn: u32,
    forced: u32,
    updates: u32,
    /// In `memory`: parameters, target, first and second moments, largest second moments.
    online: u32,
    goal: u32,
    first: u32,
    second: u32,
    largest: u32,
    /// In `memory`: working memory.
    work: u32,
    /// In `data`: four columns of `slots` entries each, then the same of the forced transitions.
    columns: u32,
    slots: u32,
    extra: u32,
    /// In `data`: where the ones of each observation begin, counted from `ones`, one entry more than there are
    /// observations.
    rows: u32,
    /// In `data`: positions of the ones.
    ones: u32,
    /// In `data`: slots of the drawn samples, update by update.
    draws: u32,
    /// In `data`: bias corrections of the optimiser, two per update.
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
    /// Share of a sample in the loss.
    share: f32,
    /// 1 where the largest second moment divides (AMSGrad).
    amsgrad: u32,
}

/// Updates of a job in a dispatch.
struct Span {
    first: u32,
    count: u32,
    /// See rounding.wgsl.
    negative_zero: f32,
}

@group(0) @binding(0) var<storage, read> jobs: array<Job>;
@group(0) @binding(1) var<storage, read> data: array<u32>;
@group(0) @binding(2) var<storage, read_write> memory: array<f32>;
/// Per job: 1 + the first update whose loss was no finite number, 0 without.
@group(0) @binding(3) var<storage, read_write> failures: array<u32>;
/// What each job does in this dispatch.
@group(0) @binding(4) var<storage, read> spans: array<Span>;

var<workgroup> state_id: array<u32, SAMPLES>;
var<workgroup> next_id: array<u32, SAMPLES>;
var<workgroup> action: array<u32, SAMPLES>;
var<workgroup> reward: array<f32, SAMPLES>;
/// First sample with the same observation; later the loss of a sample.
var<workgroup> state_first: array<u32, SAMPLES>;
var<workgroup> next_first: array<u32, SAMPLES>;
/// Rows of the samples, numbered by first appearance: distinct states, then next states that are none.
var<workgroup> state_row: array<u32, SAMPLES>;
var<workgroup> next_row: array<u32, SAMPLES>;
/// Rows of the next states in the target network's batch.
var<workgroup> goal_row: array<u32, SAMPLES>;
var<workgroup> row_id: array<u32, 2 * SAMPLES>;
var<workgroup> goal_id: array<u32, SAMPLES>;
/// Distinct states, distinct rows, distinct next states.
var<workgroup> counts: array<u32, 3>;
var<workgroup> slope: array<f32, SAMPLES>;
/// Parts of the two matrices of a product, term by term: fours of rows, and columns.
var<workgroup> left: array<vec4<f32>, DEPTH * FOURS>;
var<workgroup> right: array<f32, DEPTH * RIGHT_STEP>;
/// Which states have an input that is one: bits, two words per input.
var<workgroup> members: array<atomic<u32>, 2 * INPUTS>;

/// Sums of the rows of an invocation.
var<private> low: vec4<f32>;
var<private> high: vec4<f32>;

/// Where the parts of a network's parameters begin, relative to the first.
struct Layout {
    bias1: u32,
    weight2: u32,
    bias2: u32,
    weight3: u32,
    bias3: u32,
}

fn layout_of(job: Job) -> Layout {
    let bias1 = job.inputs * job.hidden;
    let weight2 = bias1 + job.hidden;
    let bias2 = weight2 + job.hidden * job.hidden;
    let weight3 = bias2 + job.hidden;
    return Layout(bias1, weight2, bias2, weight3, weight3 + job.hidden * job.outputs);
}

/// Where the parts of the working memory begin.
struct Work {
    /// Activations of both hidden layers and outputs, live network.
    hidden1: u32,
    hidden2: u32,
    values: u32,
    /// The same of the target network.
    goal1: u32,
    goal2: u32,
    goal_values: u32,
    /// Derivatives of the loss by the outputs, and by the sums of the hidden layers.
    delta3: u32,
    delta2: u32,
    delta1: u32,
}

fn work_of(job: Job) -> Work {
    let rows = 2u * SAMPLES;
    let hidden1 = job.work;
    let hidden2 = hidden1 + rows * job.hidden;
    let values = hidden2 + rows * job.hidden;
    let goal1 = values + rows * job.outputs;
    let goal2 = goal1 + SAMPLES * job.hidden;
    let goal_values = goal2 + SAMPLES * job.hidden;
    let delta3 = goal_values + SAMPLES * job.outputs;
    let delta2 = delta3 + SAMPLES * job.outputs;
    return Work(hidden1, hidden2, values, goal1, goal2, goal_values, delta3, delta2, delta2 + SAMPLES * job.hidden);
}

/// Reads a mini-batch and numbers its distinct observations.
fn gather(job: Job, update: u32, thread: u32) {
    let samples = job.drawn + job.forced;
    if thread < samples {
        var columns = job.columns;
        var entries = job.slots;
        var slot = thread - min(thread, job.drawn);
        if thread < job.drawn {
            slot = data[job.draws + update * job.drawn + thread];
        } else {
            columns = job.extra;
            entries = job.forced;
        }
        state_id[thread] = data[columns + slot];
        next_id[thread] = data[columns + entries + slot];
        action[thread] = data[columns + 2u * entries + slot];
        reward[thread] = bitcast<f32>(data[columns + 3u * entries + slot]);
    }
    workgroupBarrier();
    if thread < samples {
        var first = thread;
        var goal = thread;
        for (var i = thread; i > 0u; i -= 1u) {
            first = select(first, i - 1u, state_id[i - 1u] == state_id[thread]);
            goal = select(goal, i - 1u, next_id[i - 1u] == next_id[thread]);
        }
        state_first[thread] = first;
        next_first[thread] = goal;
    }
    workgroupBarrier();
    if thread < samples {
        var row = 0u;
        for (var i = 0u; i < state_first[thread]; i += 1u) {
            row += u32(state_first[i] == i);
        }
        state_row[thread] = row;
        if state_first[thread] == thread {
            row_id[row] = state_id[thread];
        }
        var goal = 0u;
        for (var i = 0u; i < next_first[thread]; i += 1u) {
            goal += u32(next_first[i] == i && next_id[i] != NO_ROW);
        }
        goal_row[thread] = goal;
        if next_first[thread] == thread && next_id[thread] != NO_ROW {
            goal_id[goal] = next_id[thread];
        }
    }
    if thread == THREADS - 1u {
        var states = 0u;
        var goals = 0u;
        for (var i = 0u; i < samples; i += 1u) {
            states += u32(state_first[i] == i);
            goals += u32(next_first[i] == i && next_id[i] != NO_ROW);
        }
        counts[0] = states;
        counts[2] = goals;
    }
    workgroupBarrier();
    let states = counts[0];
    // Distinct next states: those that are a state have its row, the others further ones.
    if thread < counts[2] {
        var row = NO_ROW;
        for (var i = 0u; i < states; i += 1u) {
            row = select(row, i, row_id[i] == goal_id[thread]);
        }
        next_first[thread] = row;
    }
    workgroupBarrier();
    if thread < counts[2] && next_first[thread] == NO_ROW {
        var row = states;
        for (var i = 0u; i < thread; i += 1u) {
            row += u32(next_first[i] == NO_ROW);
        }
        row_id[row] = goal_id[thread];
    }
    if thread == THREADS - 1u {
        var rows = states;
        for (var i = 0u; i < counts[2]; i += 1u) {
            rows += u32(next_first[i] == NO_ROW);
        }
        counts[1] = rows;
    }
    workgroupBarrier();
    if thread < samples && next_id[thread] != NO_ROW {
        let goal = goal_row[thread];
        var row = next_first[goal];
        if row == NO_ROW {
            row = states;
            for (var i = 0u; i < goal; i += 1u) {
                row += u32(next_first[i] == NO_ROW);
            }
        }
        next_row[thread] = row;
    }
    workgroupBarrier();
}

fn relu(x: f32) -> f32 {
    return select(x, 0.0, x < 0.0);
}

/// The first layer on `count` rows of zeros and ones: sums of the rows of its weights. `goal` says which
/// observations.
fn sum_rows(job: Job, params: u32, bias: u32, goal: bool, count: u32, out: u32, thread: u32) {
    for (var at = thread; at < count * job.hidden; at += THREADS) {
        let row = at / job.hidden;
        let column = at % job.hidden;
        var id: u32;
        if goal {
            id = goal_id[row];
        } else {
            id = row_id[row];
        }
        var sum = memory[bias + column];
        var one = job.ones + data[job.rows + id];
        let end = job.ones + data[job.rows + id + 1u];
        let weights = params + column;
        // Eight at a time are on their way.
        for (; one + 7u < end; one += 8u) {
            let low_places = vec4<u32>(data[one], data[one + 1u], data[one + 2u], data[one + 3u]);
            let high_places = vec4<u32>(data[one + 4u], data[one + 5u], data[one + 6u], data[one + 7u]);
            let low_weights = four(weights, low_places * job.hidden);
            let high_weights = four(weights, high_places * job.hidden);
            sum += low_weights.x;
            sum += low_weights.y;
            sum += low_weights.z;
            sum += low_weights.w;
            sum += high_weights.x;
            sum += high_weights.y;
            sum += high_weights.z;
            sum += high_weights.w;
        }
        for (; one < end; one += 1u) {
            sum += memory[weights + data[one] * job.hidden];
        }
        memory[out + at] = relu(sum);
    }
    storageBarrier();
    workgroupBarrier();
}

/// What becomes of the sums of a product.
const PLAIN = 0u;
const RELU = 1u;
/// Zero where `gate` is not positive.
const GATED = 2u;

fn finished(sum: f32, finish: u32, gate: u32) -> f32 {
    if finish == RELU {
        return relu(sum);
    }
    if finish == GATED && !(memory[gate] > 0.0) {
        return 0.0;
    }
    return sum;
}

/// Adds `depth` terms in workgroup memory to the sums of an invocation's rows.
fn accumulate(depth: u32, group: u32, lane: u32) {
    let rows = group * (ROWS / 4u);
    var k = 0u;
    for (; k + 3u < depth; k += 4u) {
        add_term(k, rows, lane);
        add_term(k + 1u, rows, lane);
        add_term(k + 2u, rows, lane);
        add_term(k + 3u, rows, lane);
    }
    for (; k < depth; k += 1u) {
        add_term(k, rows, lane);
    }
}

fn add_term(k: u32, rows: u32, lane: u32) {
    let factor = vec4<f32>(right[k * RIGHT_STEP + lane]);
    low += times4(left[k * FOURS + rows], factor);
    high += times4(left[k * FOURS + rows + 1u], factor);
}

/// Brings `depth` terms of up to `LANES` columns from `edge` on to workgroup memory: B from the offset of their first
/// term on, with these distances from term to term and from column to column.
fn bring_right(b: u32, depth: u32, step: u32, stride: u32, edge: u32, columns: u32, thread: u32) {
    for (var at = thread; at < DEPTH * LANES; at += THREADS) {
        // Neighbours in memory are read by neighbours.
        let by_term = step == 1u;
        let k = select(at / LANES, at % DEPTH, by_term);
        let lane = select(at % LANES, at / DEPTH, by_term);
        var number = 0.0;
        if k < depth && edge + lane < columns {
            number = memory[b + k * step + (edge + lane) * stride];
        }
        right[k * RIGHT_STEP + lane] = number;
    }
}

/// Brings `depth` terms of the rows of all groups, from `top` on, to workgroup memory: A from the offset of their
/// first term on, with these distances from row to row and from term to term.
fn bring_left(a: u32, depth: u32, step: u32, stride: u32, top: u32, count: u32, thread: u32) {
    let fours = THREADS / LANES * (ROWS / 4u);
    for (var at = thread; at < DEPTH * fours; at += THREADS) {
        let by_term = stride == 1u;
        let k = select(at / fours, at % DEPTH, by_term);
        let four = select(at % fours, at / DEPTH, by_term);
        let row = top + 4u * four;
        if k < depth && row < count {
            // Rows behind the last are read as the last, and their sums are of no use.
            let last = count - 1u;
            let term = a + k * stride;
            left[k * FOURS + four] = vec4<f32>(
                memory[term + row * step],
                memory[term + min(row + 1u, last) * step],
                memory[term + min(row + 2u, last) * step],
                memory[term + min(row + 3u, last) * step],
            );
        }
    }
}

/// Adds all `terms` of the tile at `top` and `edge` to the sums of an invocation's rows; distances as in `bring_left` and
/// `bring_right`.
fn sum_tile(
    a: u32, row_step: u32, left_term: u32, top: u32, count: u32, b: u32, right_term: u32, column_step: u32, edge: u32,
    columns: u32, terms: u32, thread: u32,
) {
    let group = thread / LANES;
    for (var block = 0u; block < terms; block += DEPTH) {
        let depth = min(DEPTH, terms - block);
        workgroupBarrier();
        bring_left(a + block * left_term, depth, row_step, left_term, top, count, thread);
        bring_right(b + block * right_term, depth, right_term, column_step, edge, columns, thread);
        workgroupBarrier();
        if top + group * ROWS < count {
            accumulate(depth, group, thread % LANES);
        }
    }
}

/// Writes the finished sums of up to four rows, the first of `rows` that there are, at this distance.
fn put_sums(sums: vec4<f32>, rows: u32, step: u32, out: u32, finish: u32, gate: u32) {
    memory[out] = finished(sums.x, finish, gate);
    if rows > 1u {
        memory[out + step] = finished(sums.y, finish, gate + step);
    }
    if rows > 2u {
        memory[out + 2u * step] = finished(sums.z, finish, gate + 2u * step);
    }
    if rows > 3u {
        memory[out + 3u * step] = finished(sums.w, finish, gate + 3u * step);
    }
}

/// `out = start + A·B` with A `[count, inner]` and B `[inner, columns]`, or Bᵀ `[columns, inner]` where
/// `transposed`; `start` is the bias, or zero for `NO_ROW`.
fn product(
    a: u32, count: u32, inner: u32, b: u32, columns: u32, transposed: bool, start: u32, out: u32, finish: u32, gate: u32,
    thread: u32,
) {
    let step = select(columns, 1u, transposed);
    let stride = select(1u, inner, transposed);
    if columns < ROWS {
        // A sum per thread: few columns.
        for (var at = thread; at < count * columns; at += THREADS) {
            let row = at / columns;
            let column = at % columns;
            var sum = 0.0;
            if start != NO_ROW {
                sum = memory[start + column];
            }
            let x = a + row * inner;
            let y = b + column * stride;
            var k = 0u;
            for (; k + 3u < inner; k += 4u) {
                let first = times(memory[x + k], memory[y + k * step]);
                let second = times(memory[x + k + 1u], memory[y + (k + 1u) * step]);
                let third = times(memory[x + k + 2u], memory[y + (k + 2u) * step]);
                let fourth = times(memory[x + k + 3u], memory[y + (k + 3u) * step]);
                sum += first;
                sum += second;
                sum += third;
                sum += fourth;
            }
            for (; k < inner; k += 1u) {
                sum += times(memory[x + k], memory[y + k * step]);
            }
            memory[out + at] = finished(sum, finish, gate + at);
        }
    } else {
        let lane = thread % LANES;
        let group = thread / LANES;
        for (var top = 0u; top < count; top += THREADS / LANES * ROWS) {
            let row = top + group * ROWS;
            for (var edge = 0u; edge < columns; edge += LANES) {
                let column = edge + lane;
                low = vec4<f32>(0.0);
                if start != NO_ROW && column < columns {
                    low = vec4<f32>(memory[start + column]);
                }
                high = low;
                sum_tile(a, inner, 1u, top, count, b, step, stride, edge, columns, inner, thread);
                if column < columns && row < count {
                    let at = row * columns + column;
                    put_sums(low, count - row, columns, out + at, finish, gate + at);
                    if row + 4u < count {
                        let next = at + 4u * columns;
                        put_sums(high, count - row - 4u, columns, out + next, finish, gate + next);
                    }
                }
            }
        }
    }
    storageBarrier();
    workgroupBarrier();
}

/// Numbers of `memory` at four indices.
fn four(at: u32, index: vec4<u32>) -> vec4<f32> {
    let place = at + index;
    return vec4<f32>(memory[place.x], memory[place.y], memory[place.z], memory[place.w]);
}

fn put_four(at: u32, index: vec4<u32>, count: u32, numbers: vec4<f32>) {
    memory[at + index.x] = numbers.x;
    if count > 1u {
        memory[at + index.y] = numbers.y;
    }
    if count > 2u {
        memory[at + index.z] = numbers.z;
    }
    if count > 3u {
        memory[at + index.w] = numbers.w;
    }
}

/// One step of the optimiser on `count` parameters, at most four, of which the first is `first` and the next ones
/// follow at this distance; then of their moving averages (twin: core/src/nn/optim.rs).
fn step_parameters(job: Job, corrections: vec2<f32>, first: u32, stride: u32, count: u32, raw: vec4<f32>) {
    let index = first + stride * min(vec4<u32>(0u, 1u, 2u, 3u), vec4<u32>(count - 1u));
    // All that is read, before anything is written: it is on its way together.
    let first_moment = four(job.first, index);
    let second_moment = four(job.second, index);
    var largest = second_moment;
    if job.amsgrad == 1u {
        largest = four(job.largest, index);
    }
    let parameter = four(job.online, index);
    let average = four(job.goal, index);

    let clip = vec4<f32>(job.clip);
    let bounded = select(raw, -clip, raw < -clip);
    let gradient = select(bounded, clip, bounded > clip);
    let a = times4(vec4<f32>(job.keep_first), first_moment) + times4(vec4<f32>(job.add_first), gradient);
    let b = times4(vec4<f32>(job.keep_second), second_moment)
        + times4(vec4<f32>(job.add_second), times4(gradient, gradient));
    let moment = select(a, vec4<f32>(0.0), abs(a) < vec4<f32>(TINY_FIRST));
    let square = select(b, vec4<f32>(0.0), b < vec4<f32>(TINY_SECOND));
    var under = square;
    if job.amsgrad == 1u {
        under = max(square, largest);
        put_four(job.largest, index, count, under);
    }
    let denominator = times4(root4(under), vec4<f32>(corrections.y)) + job.epsilon;
    let shrunk = times4(parameter, vec4<f32>(job.shrink));
    let value = shrunk - quotient4(times4(vec4<f32>(corrections.x), moment), denominator);
    put_four(job.first, index, count, moment);
    put_four(job.second, index, count, square);
    put_four(job.online, index, count, value);
    put_four(job.goal, index, count, average + times4(vec4<f32>(job.tau), value - average));
}

/// Steps on the weights `[inputs, columns]` from parameter `at` on, whose gradient is `Xᵀ·delta` over `count`
/// rows, and on their biases behind them.
fn step_layer(
    job: Job, corrections: vec2<f32>, x: u32, inputs: u32, delta: u32, columns: u32, count: u32, at: u32, thread: u32,
) {
    if columns < ROWS {
        // A sum per thread: few columns.
        for (var index = thread; index < inputs * columns; index += THREADS) {
            let row = index / columns;
            let column = index % columns;
            var sum = 0.0;
            for (var sample = 0u; sample < count; sample += 1u) {
                sum += times(memory[x + sample * inputs + row], memory[delta + sample * columns + column]);
            }
            step_parameters(job, corrections, at + index, 0u, 1u, vec4<f32>(sum));
        }
    } else {
        let lane = thread % LANES;
        let group = thread / LANES;
        for (var top = 0u; top < inputs; top += THREADS / LANES * ROWS) {
            let row = top + group * ROWS;
            for (var edge = 0u; edge < columns; edge += LANES) {
                let column = edge + lane;
                low = vec4<f32>(0.0);
                high = low;
                sum_tile(x, 1u, inputs, top, inputs, delta, columns, 1u, edge, columns, count, thread);
                if column < columns && row < inputs {
                    let index = at + row * columns + column;
                    let rows = min(ROWS, inputs - row);
                    step_parameters(job, corrections, index, columns, min(rows, 4u), low);
                    if rows > 4u {
                        step_parameters(job, corrections, index + 4u * columns, columns, rows - 4u, high);
                    }
                }
            }
        }
    }
    step_biases(job, corrections, delta, columns, count, at + inputs * columns, thread);
}

fn step_biases(job: Job, corrections: vec2<f32>, delta: u32, columns: u32, count: u32, at: u32, thread: u32) {
    for (var column = thread; column < columns; column += THREADS) {
        var sum = 0.0;
        for (var sample = 0u; sample < count; sample += 1u) {
            sum += memory[delta + sample * columns + column];
        }
        step_parameters(job, corrections, at + column, 0u, 1u, vec4<f32>(sum));
    }
}

/// The sum of a column of `delta` over the rows whose input `place` is one.
fn sum_members(place: u32, delta: u32, step: u32) -> f32 {
    var sum = 0.0;
    for (var word = 0u; word < 2u; word += 1u) {
        var bits = atomicLoad(&members[2u * place + word]);
        while bits != 0u {
            let row = 32u * word + firstTrailingBit(bits);
            bits &= bits - 1u;
            sum += memory[delta + row * step];
        }
    }
    return sum;
}

/// Steps on the first layer, whose inputs are zeros and ones.
fn step_first(job: Job, corrections: vec2<f32>, delta: u32, count: u32, bias: u32, thread: u32) {
    for (var begin = 0u; begin < job.inputs; begin += INPUTS) {
        let places = min(INPUTS, job.inputs - begin);
        workgroupBarrier();
        for (var word = thread; word < 2u * INPUTS; word += THREADS) {
            atomicStore(&members[word], 0u);
        }
        workgroupBarrier();
        // A few invocations per row.
        let parts = THREADS / SAMPLES;
        let row = thread / parts;
        if row < count {
            let id = row_id[row];
            let end = job.ones + data[job.rows + id + 1u];
            for (var at = job.ones + data[job.rows + id] + thread % parts; at < end; at += parts) {
                let place = data[at] - begin;
                // An input before the first wraps around to a large number.
                if place < places {
                    atomicOr(&members[2u * place + row / 32u], 1u << (row % 32u));
                }
            }
        }
        workgroupBarrier();
        let fours = (places + 3u) / 4u;
        for (var at = thread; at < fours * job.hidden; at += THREADS) {
            let place = 4u * (at / job.hidden);
            let column = at % job.hidden;
            let number = min(4u, places - place);
            let last = place + number - 1u;
            let sums = vec4<f32>(
                sum_members(place, delta + column, job.hidden),
                sum_members(min(place + 1u, last), delta + column, job.hidden),
                sum_members(min(place + 2u, last), delta + column, job.hidden),
                sum_members(min(place + 3u, last), delta + column, job.hidden),
            );
            step_parameters(job, corrections, (begin + place) * job.hidden + column, job.hidden, number, sums);
        }
    }
    step_biases(job, corrections, delta, job.hidden, count, bias, thread);
}

/// Position of the largest of the outputs from `at` on; the first of equal ones.
fn best_action(job: Job, at: u32) -> u32 {
    var best = 0u;
    for (var i = 1u; i < job.outputs; i += 1u) {
        best = select(best, i, memory[at + i] > memory[at + best]);
    }
    return best;
}

/// Targets, losses and their derivatives by the outputs; notes a loss that is no finite number.
fn derive_loss(job: Job, work: Work, update: u32, index: u32, thread: u32) {
    let samples = job.drawn + job.forced;
    if thread < samples {
        var y = reward[thread];
        if next_id[thread] != NO_ROW {
            let best = best_action(job, work.values + next_row[thread] * job.outputs);
            y += times(job.gamma, memory[work.goal_values + goal_row[thread] * job.outputs + best]);
        }
        let difference = memory[work.values + state_row[thread] * job.outputs + action[thread]] - y;
        let magnitude = abs(difference);
        let sign = select(-1.0, 1.0, difference > 0.0);
        // SmoothL1: quadratic within ±1, linear beyond.
        let value = select(magnitude - 0.5, times(0.5 * difference, difference), magnitude < 1.0);
        state_first[thread] = bitcast<u32>(times(value, job.share));
        slope[thread] = select(sign, difference, magnitude < 1.0) * job.share;
    }
    workgroupBarrier();
    for (var at = thread; at < counts[0] * job.outputs; at += THREADS) {
        var sum = 0.0;
        for (var i = 0u; i < samples; i += 1u) {
            if state_row[i] * job.outputs + action[i] == at {
                sum += slope[i];
            }
        }
        memory[work.delta3 + at] = sum;
    }
    if thread == 0u {
        var sum = 0.0;
        for (var i = 0u; i < samples; i += 1u) {
            sum += bitcast<f32>(state_first[i]);
        }
        // All ones in the exponent: infinite or no number.
        if (bitcast<u32>(sum) & 0x7f800000u) == 0x7f800000u && failures[index] == 0u {
            failures[index] = update + 1u;
        }
    }
    storageBarrier();
    workgroupBarrier();
}

@compute @workgroup_size(THREADS)
fn ddqn(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let index = group.x;
    let span = spans[index];
    negative_zero = span.negative_zero;
    let job = jobs[index];
    let at = layout_of(job);
    let work = work_of(job);
    let end = min(job.updates, span.first + span.count);
    for (var update = span.first; update < end; update += 1u) {
        gather(job, update, thread);
        let states = workgroupUniformLoad(&counts[0]);
        let rows = workgroupUniformLoad(&counts[1]);
        let goals = workgroupUniformLoad(&counts[2]);
        sum_rows(job, job.online, job.online + at.bias1, false, rows, work.hidden1, thread);
        product(
            work.hidden1, rows, job.hidden, job.online + at.weight2, job.hidden, false, job.online + at.bias2,
            work.hidden2, RELU, 0u, thread,
        );
        product(
            work.hidden2, rows, job.hidden, job.online + at.weight3, job.outputs, false, job.online + at.bias3,
            work.values, PLAIN, 0u, thread,
        );
        sum_rows(job, job.goal, job.goal + at.bias1, true, goals, work.goal1, thread);
        product(
            work.goal1, goals, job.hidden, job.goal + at.weight2, job.hidden, false, job.goal + at.bias2, work.goal2,
            RELU, 0u, thread,
        );
        product(
            work.goal2, goals, job.hidden, job.goal + at.weight3, job.outputs, false, job.goal + at.bias3,
            work.goal_values, PLAIN, 0u, thread,
        );
        derive_loss(job, work, update, index, thread);
        // Derivatives first, while the weights are the old ones.
        product(
            work.delta3, states, job.outputs, job.online + at.weight3, job.hidden, true, NO_ROW, work.delta2, GATED,
            work.hidden2, thread,
        );
        product(
            work.delta2, states, job.hidden, job.online + at.weight2, job.hidden, true, NO_ROW, work.delta1, GATED,
            work.hidden1, thread,
        );
        let correction = job.corrections + 2u * update;
        let corrections = vec2<f32>(bitcast<f32>(data[correction]), bitcast<f32>(data[correction + 1u]));
        step_layer(job, corrections, work.hidden2, job.hidden, work.delta3, job.outputs, states, at.weight3, thread);
        step_layer(job, corrections, work.hidden1, job.hidden, work.delta2, job.hidden, states, at.weight2, thread);
        step_first(job, corrections, work.delta1, states, at.bias1, thread);
        storageBarrier();
        workgroupBarrier();
    }
}
