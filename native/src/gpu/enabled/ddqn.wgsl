// Updates of Double DQN learners (twin: core/src/agent/ddqn.rs): one workgroup trains one network, many
// updates per dispatch. Every sum has the twin's order and nothing is fused here; a compiler of the device may
// fuse, so a graphics card is an arithmetic of its own.
//
// Everything of a network lies in `memory`, from the offsets that its job names: live parameters, target
// parameters, moments, the gradient of the first layer, activations. Networks have two hidden layers; their
// first layer has only the inputs that are ever one in the data at hand.

const THREADS = 128u;
/// Samples of a mini-batch at most, forced ones included.
const SAMPLES = 64u;
/// Rows of a product that a thread sums side by side.
const TILE = 16u;
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
    /// 1 where the largest second moment divides (AMSGrad).
    amsgrad: u32,
}

/// Updates of this dispatch.
struct Span {
    first: u32,
    count: u32,
}

@group(0) @binding(0) var<storage, read> jobs: array<Job>;
@group(0) @binding(1) var<storage, read> data: array<u32>;
@group(0) @binding(2) var<storage, read_write> memory: array<f32>;
/// Per job: 1 + the first update whose loss was no finite number, 0 without.
@group(0) @binding(3) var<storage, read_write> failures: array<u32>;
@group(0) @binding(4) var<uniform> span: Span;

var<workgroup> state_id: array<u32, SAMPLES>;
var<workgroup> next_id: array<u32, SAMPLES>;
var<workgroup> action: array<u32, SAMPLES>;
var<workgroup> reward: array<f32, SAMPLES>;
/// First sample with the same observation.
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
var<workgroup> loss: array<f32, SAMPLES>;
var<workgroup> slope: array<f32, SAMPLES>;
/// Rows of a product's left matrix.
var<workgroup> left: array<f32, TILE * THREADS>;

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
    gradient1: u32,
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
    let delta1 = delta2 + SAMPLES * job.hidden;
    return Work(
        hidden1, hidden2, values, goal1, goal2, goal_values, delta3, delta2, delta1, delta1 + SAMPLES * job.hidden,
    );
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
    for (var column = thread; column < job.hidden; column += THREADS) {
        for (var row = 0u; row < count; row += 1u) {
            var id: u32;
            if goal {
                id = goal_id[row];
            } else {
                id = row_id[row];
            }
            var sum = memory[bias + column];
            let end = job.ones + data[job.rows + id + 1u];
            for (var at = job.ones + data[job.rows + id]; at < end; at += 1u) {
                sum += memory[params + data[at] * job.hidden + column];
            }
            memory[out + row * job.hidden + column] = relu(sum);
        }
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

/// `out = start + A·B` with A `[count, inner]` and B `[inner, columns]`, or Bᵀ `[columns, inner]` where
/// `transposed`; `start` is the bias, or zero for `NO_ROW`.
fn product(
    a: u32, count: u32, inner: u32, b: u32, columns: u32, transposed: bool, start: u32, out: u32, finish: u32, gate: u32,
    thread: u32,
) {
    var step = columns;
    var stride = 1u;
    if transposed {
        step = 1u;
        stride = inner;
    }
    if columns < TILE {
        // A sum per thread: few columns.
        for (var at = thread; at < count * columns; at += THREADS) {
            let row = at / columns;
            let column = at % columns;
            var sum = 0.0;
            if start != NO_ROW {
                sum = memory[start + column];
            }
            for (var k = 0u; k < inner; k += 1u) {
                let term = memory[a + row * inner + k] * memory[b + k * step + column * stride];
                sum += term;
            }
            memory[out + at] = finished(sum, finish, gate + at);
        }
    } else {
        for (var top = 0u; top < count; top += TILE) {
            let rows = min(TILE, count - top);
            for (var edge = 0u; edge < columns; edge += THREADS) {
                let column = edge + thread;
                var sums: array<f32, TILE>;
                for (var r = 0u; r < TILE; r += 1u) {
                    sums[r] = 0.0;
                    if start != NO_ROW && column < columns {
                        sums[r] = memory[start + column];
                    }
                }
                for (var block = 0u; block < inner; block += THREADS) {
                    let depth = min(THREADS, inner - block);
                    workgroupBarrier();
                    for (var at = thread; at < TILE * depth; at += THREADS) {
                        let row = at / depth;
                        let k = at % depth;
                        var x = 0.0;
                        if row < rows {
                            x = memory[a + (top + row) * inner + block + k];
                        }
                        left[k * TILE + row] = x;
                    }
                    workgroupBarrier();
                    if column < columns {
                        for (var k = 0u; k < depth; k += 1u) {
                            let right = memory[b + (block + k) * step + column * stride];
                            for (var r = 0u; r < TILE; r += 1u) {
                                let term = left[k * TILE + r] * right;
                                sums[r] += term;
                            }
                        }
                    }
                }
                if column < columns {
                    for (var r = 0u; r < rows; r += 1u) {
                        let at = (top + r) * columns + column;
                        memory[out + at] = finished(sums[r], finish, gate + at);
                    }
                }
            }
        }
    }
    storageBarrier();
    workgroupBarrier();
}

/// One step of the optimiser on parameter `index`, then of its moving average (twin: core/src/nn/optim.rs).
fn step_parameter(job: Job, corrections: vec2<f32>, index: u32, raw: f32) {
    let low = select(raw, -job.clip, raw < -job.clip);
    let gradient = select(low, job.clip, low > job.clip);
    let kept_first = job.keep_first * memory[job.first + index];
    let a = kept_first + job.add_first * gradient;
    let kept_second = job.keep_second * memory[job.second + index];
    let b = kept_second + job.add_second * (gradient * gradient);
    let moment = select(a, 0.0, a < TINY_FIRST && a > -TINY_FIRST);
    let square = select(b, 0.0, b < TINY_SECOND);
    memory[job.first + index] = moment;
    memory[job.second + index] = square;
    var under = square;
    if job.amsgrad == 1u {
        under = max(square, memory[job.largest + index]);
        memory[job.largest + index] = under;
    }
    let denominator = sqrt(under) * corrections.y + job.epsilon;
    let shrunk = memory[job.online + index] * job.shrink;
    let value = shrunk - corrections.x * moment / denominator;
    memory[job.online + index] = value;
    let average = memory[job.goal + index];
    memory[job.goal + index] = average + job.tau * (value - average);
}

/// Steps on the weights `[inputs, columns]` from parameter `at` on, whose gradient is `Xᵀ·delta` over `count`
/// rows, and on their biases behind them.
fn step_layer(
    job: Job, corrections: vec2<f32>, x: u32, inputs: u32, delta: u32, columns: u32, count: u32, at: u32, thread: u32,
) {
    if columns < TILE {
        // A sum per thread: few columns.
        for (var index = thread; index < inputs * columns; index += THREADS) {
            let row = index / columns;
            let column = index % columns;
            var sum = 0.0;
            for (var sample = 0u; sample < count; sample += 1u) {
                let term = memory[x + sample * inputs + row] * memory[delta + sample * columns + column];
                sum += term;
            }
            step_parameter(job, corrections, at + index, sum);
        }
    } else {
        for (var top = 0u; top < inputs; top += TILE) {
            let rows = min(TILE, inputs - top);
            workgroupBarrier();
            for (var place = thread; place < SAMPLES * TILE; place += THREADS) {
                let sample = place / TILE;
                let row = place % TILE;
                var number = 0.0;
                if sample < count && row < rows {
                    number = memory[x + sample * inputs + top + row];
                }
                left[place] = number;
            }
            workgroupBarrier();
            for (var column = thread; column < columns; column += THREADS) {
                var sums: array<f32, TILE>;
                for (var r = 0u; r < TILE; r += 1u) {
                    sums[r] = 0.0;
                }
                for (var sample = 0u; sample < count; sample += 1u) {
                    let right = memory[delta + sample * columns + column];
                    for (var r = 0u; r < TILE; r += 1u) {
                        let term = left[sample * TILE + r] * right;
                        sums[r] += term;
                    }
                }
                for (var r = 0u; r < rows; r += 1u) {
                    step_parameter(job, corrections, at + (top + r) * columns + column, sums[r]);
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
        step_parameter(job, corrections, at + column, sum);
    }
}

/// Steps on the first layer, whose inputs are zeros and ones.
fn step_first(job: Job, corrections: vec2<f32>, delta: u32, gradient: u32, count: u32, bias: u32, thread: u32) {
    for (var column = thread; column < job.hidden; column += THREADS) {
        for (var input = 0u; input < job.inputs; input += 1u) {
            memory[gradient + input * job.hidden + column] = 0.0;
        }
        for (var row = 0u; row < count; row += 1u) {
            let id = row_id[row];
            let add = memory[delta + row * job.hidden + column];
            let end = job.ones + data[job.rows + id + 1u];
            for (var at = job.ones + data[job.rows + id]; at < end; at += 1u) {
                memory[gradient + data[at] * job.hidden + column] += add;
            }
        }
        for (var input = 0u; input < job.inputs; input += 1u) {
            let index = input * job.hidden + column;
            step_parameter(job, corrections, index, memory[gradient + index]);
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
    let share = 1.0 / f32(samples);
    if thread < samples {
        var y = reward[thread];
        if next_id[thread] != NO_ROW {
            let best = best_action(job, work.values + next_row[thread] * job.outputs);
            let bootstrap = job.gamma * memory[work.goal_values + goal_row[thread] * job.outputs + best];
            y += bootstrap;
        }
        let difference = memory[work.values + state_row[thread] * job.outputs + action[thread]] - y;
        let magnitude = abs(difference);
        let sign = select(-1.0, 1.0, difference > 0.0);
        // SmoothL1: quadratic within ±1, linear beyond.
        let value = select(magnitude - 0.5, 0.5 * difference * difference, magnitude < 1.0);
        loss[thread] = value * share;
        slope[thread] = select(sign, difference, magnitude < 1.0) * share;
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
            sum += loss[i];
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
        step_first(job, corrections, work.delta1, work.gradient1, states, at.bias1, thread);
        storageBarrier();
        workgroupBarrier();
    }
}
