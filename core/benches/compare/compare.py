"""The same update by mcvl, by a JAX scan, by eager PyTorch and by mcvl as wasm, in turn, on one core.

    cargo build --release -p mcvl-core --example updates
    pip install -r core/benches/compare/requirements.txt
    python core/benches/compare/compare.py target/release/examples/updates [--rounds N] [CASE ...]

And as the page's module computes it (needs Node, and nothing of Python's packages; engines differ by a
sixth to a third, so take a Node whose V8 is that of the browsers in question):

    rustup target add wasm32-wasip1
    RUSTFLAGS=-Ctarget-feature=+simd128 cargo build --profile web -p mcvl-core --example updates \\
        --target wasm32-wasip1
    python core/benches/compare/compare.py target/release/examples/updates \\
        --with wasm=target/wasm32-wasip1/web/examples/updates.wasm

Every contender draws mini-batches from 1,000 transitions and makes whole updates in float32: DDQN with two
hidden layers of 128, batch 32, SmoothL1, Adam, moving target; TD3 with two of 256, batch 256, an actor's step
in every second update. In each round each works for some hundredths of a second, in an order drawn anew; what is
printed are medians of the rounds and of the ratios round by round, with the quartiles. All use one core only. Times are
processor time, so that other programs on the machine disturb little; but those of a virtual machine's neighbours make a
core up to 1.5 times slower for seconds at a time, and not all programs alike. So the ratios are printed once more of the
rounds in which both were within a tenth of their least time. With `--with a=PATH` another build of the program takes
part, under that name. (Linux: the processor time of another process is read from /proc.)

mcvl sums in a fixed order and fuses no multiply-add; JAX and PyTorch may do as they like. The losses of
mcvl's contenders must be the same to the last bit.
"""

import argparse
import os
import random
import statistics
import subprocess
import sys
import time

CORE = max(os.sched_getaffinity(0))
os.sched_setaffinity(0, {CORE})
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
os.environ["JAX_PLATFORMS"] = "cpu"
for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

try:
    import jax
    import jax.numpy as jnp
    import numpy as np
    import torch

    torch.set_num_threads(1)
except ImportError as missing:
    # Enough for mcvl alone; who asks for the others is told.
    jax, MISSING = None, missing

TRANSITIONS, GAMMA, TAU, BETAS, EPSILON = 1000, 0.95, 0.005, (0.9, 0.999), 1e-8
# Inputs; the others compute zeros and ones, and repeated states, as they compute any numbers. A case with the name of a
# world is mcvl's update after Safe training there, beside the others' dense update of the same sizes.
CASES = {
    "box-moving": 11,
    "absent-supervisor": 288,
    "tomato-watering": 294,
    "rocks-and-diamonds": 240,
    "ddqn-100-dense": 100,
    "ddqn-100-onehot": 100,
    "ddqn-100-onehot-22-states": 100,
    "ddqn-288-dense": 288,
    "ddqn-288-onehot": 288,
    "ddqn-288-onehot-22-states": 288,
    "td3-10-256": None,
}


def data(width, discrete):
    rng = np.random.default_rng(1)
    uniform = lambda *shape: rng.random(shape, dtype=np.float32)
    actions = rng.integers(0, 4, TRANSITIONS) if discrete else 2 * uniform(TRANSITIONS, 2) - 1
    shape = (TRANSITIONS, width)
    return uniform(*shape), actions, uniform(TRANSITIONS) - 0.5, uniform(*shape), np.ones(TRANSITIONS, np.float32)


def sizes(inputs, hidden, outputs):
    return list(zip([inputs, hidden, hidden], [hidden, hidden, outputs]))


# JAX: everything of an update in one compiled scan over many updates.


def jax_net(layers, seed):
    rng = np.random.default_rng(seed)
    bound = lambda i: 1 / np.sqrt(i)
    draw = lambda shape, i: jnp.asarray(rng.uniform(-bound(i), bound(i), shape).astype(np.float32))
    return [(draw((i, o), i), draw((o,), i)) for i, o in layers]


def jax_apply(net, x):
    for w, b in net[:-1]:
        x = jax.nn.relu(x @ w + b)
    return x @ net[-1][0] + net[-1][1]


def jax_adam(params, state, grads, lr):
    m, v, t = state
    t = t + 1
    m = jax.tree.map(lambda m, g: BETAS[0] * m + (1 - BETAS[0]) * g, m, grads)
    v = jax.tree.map(lambda v, g: BETAS[1] * v + (1 - BETAS[1]) * g * g, v, grads)
    rate, root = lr / (1 - BETAS[0] ** t), 1 / jnp.sqrt(1 - BETAS[1] ** t)
    params = jax.tree.map(lambda p, m, v: p - rate * m / (jnp.sqrt(v) * root + EPSILON), params, m, v)
    return params, (m, v, t)


def jax_fresh(params):
    zeros = jax.tree.map(jnp.zeros_like, params)
    return params, (zeros, zeros, jnp.float32(0))


def jax_follow(target, live):
    return jax.tree.map(lambda t, x: t + TAU * (x - t), target, live)


def jax_ddqn(width):
    columns = [jnp.asarray(c) for c in data(width, True)]
    params = jax_net(sizes(width, 128, 4), 2)

    def update(carry, slots):
        params, target, adam = carry
        s, a, r, s2, live = [c[slots] for c in columns]
        best = jnp.argmax(jax_apply(params, s2), axis=1)
        y = r + GAMMA * live * jnp.take_along_axis(jax_apply(target, s2), best[:, None], 1)[:, 0]

        def loss(params):
            d = jnp.take_along_axis(jax_apply(params, s), a[:, None], 1)[:, 0] - y
            return jnp.mean(jnp.where(jnp.abs(d) < 1, 0.5 * d * d, jnp.abs(d) - 0.5))

        value, grads = jax.value_and_grad(loss)(params)
        params, adam = jax_adam(params, adam, grads, 1e-4)
        return (params, jax_follow(target, params), adam), value

    return jax_runner(update, (params, params, jax_fresh(params)[1]), 32)


def jax_td3():
    columns = [jnp.asarray(c) for c in data(10, False)]
    actor, critics = jax_net(sizes(10, 256, 2), 2), [jax_net(sizes(12, 256, 1), seed) for seed in (3, 4)]
    q = lambda critic, s, a: jax_apply(critic, jnp.concatenate([s, a], 1))[:, 0]

    def update(carry, inputs):
        actor, critics, t_actor, t_critics, actor_adam, critic_adam = carry
        slots, noise, moves = inputs
        s, a, r, s2, live = [c[slots] for c in columns]
        a2 = jnp.clip(jnp.tanh(jax_apply(t_actor, s2)) + jnp.clip(0.2 * noise, -0.5, 0.5), -1, 1)
        y = r + 0.99 * live * jnp.minimum(q(t_critics[0], s2, a2), q(t_critics[1], s2, a2))
        loss = lambda critics: sum(jnp.mean((q(c, s, a) - y) ** 2) for c in critics)
        value, grads = jax.value_and_grad(loss)(critics)
        critics, critic_adam = jax_adam(critics, critic_adam, grads, 3e-4)

        def improve(of):
            actor, t_actor, t_critics, actor_adam = of
            grads = jax.grad(lambda actor: -jnp.mean(q(critics[0], s, jnp.tanh(jax_apply(actor, s)))))(actor)
            actor, actor_adam = jax_adam(actor, actor_adam, grads, 3e-4)
            return actor, jax_follow(t_actor, actor), jax_follow(t_critics, critics), actor_adam

        of = (actor, t_actor, t_critics, actor_adam)
        actor, t_actor, t_critics, actor_adam = jax.lax.cond(moves, improve, lambda of: of, of)
        return (actor, critics, t_actor, t_critics, actor_adam, critic_adam), value

    start = (actor, critics, actor, critics, jax_fresh(actor)[1], jax_fresh(critics)[1])
    return jax_runner(update, start, 256, noise=True)


def jax_runner(update, carry, batch, noise=False):
    rng = np.random.default_rng(5)
    scan = jax.jit(lambda carry, inputs: jax.lax.scan(update, carry, inputs))
    state = [carry]

    def run(count):
        slots = np.stack([rng.choice(TRANSITIONS, batch, replace=False) for _ in range(count)])
        inputs = jnp.asarray(slots)
        if noise:
            noises = rng.standard_normal((count, batch, 2)).astype(np.float32)
            inputs = (inputs, jnp.asarray(noises), jnp.arange(count) % 2 == 1)
        start = time.process_time()
        state[0], losses = scan(state[0], inputs)
        losses.block_until_ready()
        return (time.process_time() - start) / count

    return run


# PyTorch: eager, in the way of the common single-file implementations.


def torch_net(layers):
    modules = []
    for i, o in layers:
        modules += [torch.nn.Linear(i, o), torch.nn.ReLU()]
    return torch.nn.Sequential(*modules[:-1])


def torch_follow(targets, lives):
    with torch.no_grad():
        for target, live in zip(targets, lives):
            for t, x in zip(target.parameters(), live.parameters()):
                t.copy_(TAU * x + (1 - TAU) * t)


def torch_ddqn(width):
    columns = [torch.from_numpy(np.asarray(c)) for c in data(width, True)]
    live, target = torch_net(sizes(width, 128, 4)), torch_net(sizes(width, 128, 4))
    target.load_state_dict(live.state_dict())
    adam = torch.optim.Adam(live.parameters(), lr=1e-4)

    def update():
        slots = torch.from_numpy(np.random.randint(0, TRANSITIONS, 32))
        s, a, r, s2, alive = [c[slots] for c in columns]
        with torch.no_grad():
            best = live(s2).argmax(1, keepdim=True)
            y = r + GAMMA * alive * target(s2).gather(1, best).squeeze(1)
        loss = torch.nn.functional.smooth_l1_loss(live(s).gather(1, a[:, None]).squeeze(1), y)
        adam.zero_grad()
        loss.backward()
        adam.step()
        torch_follow([target], [live])

    return torch_runner(update)


def torch_td3():
    columns = [torch.from_numpy(np.asarray(c)) for c in data(10, False)]
    actor, critics = torch_net(sizes(10, 256, 2)), [torch_net(sizes(12, 256, 1)) for _ in range(2)]
    t_actor, t_critics = torch_net(sizes(10, 256, 2)), [torch_net(sizes(12, 256, 1)) for _ in range(2)]
    for target, live in zip([t_actor, *t_critics], [actor, *critics]):
        target.load_state_dict(live.state_dict())
    critic_adam = torch.optim.Adam([p for c in critics for p in c.parameters()], lr=3e-4)
    actor_adam = torch.optim.Adam(actor.parameters(), lr=3e-4)
    count = [0]
    mse = torch.nn.functional.mse_loss

    def update():
        count[0] += 1
        slots = torch.from_numpy(np.random.randint(0, TRANSITIONS, 256))
        s, a, r, s2, alive = [c[slots] for c in columns]
        with torch.no_grad():
            noise = (torch.randn_like(a) * 0.2).clamp(-0.5, 0.5)
            pairs = torch.cat([s2, (torch.tanh(t_actor(s2)) + noise).clamp(-1, 1)], 1)
            y = r + 0.99 * alive * torch.min(t_critics[0](pairs), t_critics[1](pairs)).squeeze(1)
        pairs = torch.cat([s, a], 1)
        loss = mse(critics[0](pairs).squeeze(1), y) + mse(critics[1](pairs).squeeze(1), y)
        critic_adam.zero_grad()
        loss.backward()
        critic_adam.step()
        if count[0] % 2 == 0:
            loss = -critics[0](torch.cat([s, torch.tanh(actor(s))], 1)).mean()
            actor_adam.zero_grad()
            loss.backward()
            actor_adam.step()
            torch_follow([t_actor, *t_critics], [actor, *critics])

    return torch_runner(update)


def torch_runner(update):
    def run(count):
        start = time.process_time()
        for _ in range(count):
            update()
        return (time.process_time() - start) / count

    return run


# mcvl: a process that answers lines, native or wasm in Node.

NODE = """
const { WASI } = require("wasi");
const wasi = new WASI({ version: "preview1" });
const module = new WebAssembly.Module(require("fs").readFileSync(process.argv[1]));
wasi.start(new WebAssembly.Instance(module, wasi.getImportObject()));
"""


class Mcvl:
    def __init__(self, path):
        # The optimising compiler at once: what remains after some seconds of a page.
        node = ["node", "--no-warnings", "--no-wasm-tier-up", "--no-liftoff", "-e", NODE]
        self.wasm = path.endswith(".wasm")
        command = [*node, path] if self.wasm else [os.path.abspath(path)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.cases = self.ask("cases").split()

    def ask(self, line):
        print(line, file=self.process.stdin, flush=True)
        answer = self.process.stdout.readline().strip()
        if not answer or answer.startswith("error"):
            sys.exit(answer or f"error: {self.process.args[0]} ended; what it said stands above")
        return answer

    def seconds(self):
        with open(f"/proc/{self.process.pid}/schedstat") as spent:
            return int(spent.read().split()[0]) / 1e9

    def run(self, count):
        start = self.seconds()
        self.digest = self.ask(f"run {count}")
        return (self.seconds() - start) / count


def quartiles(values):
    low, middle, high = statistics.quantiles(values, n=4)
    return f"{middle:8.2f} ({low:.2f} to {high:.2f})"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="the built example `updates`")
    parser.add_argument("--rounds", type=int, default=101, help="at least 2; default: 101")
    others = "contenders: jax, pytorch, NAME=PATH of another build, native or .wasm; default: jax pytorch"
    parser.add_argument("--with", dest="others", action="append", metavar="OTHER", help=others)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; all without")
    arguments = parser.parse_intermixed_args()
    if arguments.rounds < 2:
        parser.error("--rounds: at least 2")
    asked = arguments.others or ["jax", "pytorch"]
    if jax is None and {"jax", "pytorch"} & set(asked):
        sys.exit(f"error: {MISSING}; install core/benches/compare/requirements.txt, or leave jax and pytorch out by --with")
    own = {"mcvl": Mcvl(arguments.program)}
    for other in asked:
        name, _, path = other.partition("=")
        if name in own or (not path and name not in ("jax", "pytorch")):
            parser.error(f"--with {other}: one of jax, pytorch and NAME=PATH, each name once")
        if path:
            own[name] = Mcvl(path)
    model = next((line.split(": ")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), "?")
    versions = f", JAX {jax.__version__}, PyTorch {torch.__version__}" if jax else ""
    if any(it.wasm for it in own.values()):
        engine = "`Node ${process.versions.node} (V8 ${process.versions.v8})`"
        versions += ", " + subprocess.run(["node", "-p", engine], capture_output=True, text=True).stdout.strip()
    for case in arguments.cases:
        if case not in CASES or any(case not in it.cases for it in own.values()):
            parser.error(f"{case} is no case of all contenders; cases: {', '.join(CASES)}")
    print(f"{model}; Python {sys.version.split()[0]}{versions}; one core; {arguments.rounds} rounds")
    for case in arguments.cases or [case for case in own["mcvl"].cases if case in CASES]:
        width = CASES[case]
        # Updates of a turn: some hundredths of a second.
        turn, slow = (4, 4) if width is None else (200, 20)
        contenders = {name: (it.run, turn) for name, it in own.items()}
        if "jax" in asked:
            contenders["JAX scan"] = (jax_td3() if width is None else jax_ddqn(width), turn)
        if "pytorch" in asked:
            contenders["PyTorch eager"] = (torch_td3() if width is None else torch_ddqn(width), slow)
        for it in own.values():
            it.ask(f"prepare {case}")
        for run, count in contenders.values():
            run(2 * count)
            run(count)
        times = {name: [] for name in contenders}
        for _ in range(arguments.rounds):
            for name, (run, count) in random.sample(sorted(contenders.items()), len(contenders)):
                times[name].append(1e6 * run(count))
        digests = {name: it.digest for name, it in own.items()}
        assert len(set(digests.values())) == 1, f"the same losses from {digests}"
        print(case)
        for name, values in times.items():
            ratio = [value / own for value, own in zip(values, times["mcvl"])]
            line = f"  {name:<14}{quartiles(values)} us    {quartiles(ratio)} times mcvl's"
            still = [all(t[i] < 1.1 * min(t) for t in (values, times["mcvl"])) for i in range(arguments.rounds)]
            if name != "mcvl" and 8 < sum(still) < arguments.rounds:
                line += f"; in {sum(still)} quiet rounds {quartiles([r for r, quiet in zip(ratio, still) if quiet])}"
            print(line, flush=True)


if __name__ == "__main__":
    main()
