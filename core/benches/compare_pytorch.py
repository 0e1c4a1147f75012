"""Compares one DDQN update of mcvl with the same update in eager PyTorch on the same core.

    pip install torch numpy
    cargo bench -p mcvl-core --bench update --no-run
    python core/benches/compare_pytorch.py

The two are run in turn, several times, each pinned to one core; the ratios of neighbouring runs are
printed with their median and spread. Observation 100 (ten one-hot cells), two hidden layers of 128,
4 actions, batch 32, SmoothL1, Adam, moving average of the target network after every update.
Not part of the tests.
"""

import argparse
import os
import statistics
import subprocess
import sys
import time

PAIRS = 7


def pytorch_seconds(width: int, foreach: bool) -> float:
    """Median seconds per eager update, mini-batch drawing included."""
    import torch
    import torch.nn.functional as F

    torch.set_num_threads(1)
    torch.manual_seed(0)

    def network():
        layers = [torch.nn.Linear(width, 128), torch.nn.ReLU(), torch.nn.Linear(128, 128), torch.nn.ReLU()]
        return torch.nn.Sequential(*layers, torch.nn.Linear(128, 4))

    online, target = network(), network()
    target.load_state_dict(online.state_dict())
    optimizer = torch.optim.Adam(online.parameters(), lr=1e-4, foreach=foreach)
    codes = torch.randint(10, (2000, width // 10))
    boards = F.one_hot(codes, 10).float().reshape(2000, width)
    states, nexts = boards[:1000], boards[1000:]
    actions, rewards = torch.randint(4, (1000, 1)), torch.rand(1000)
    terminated = torch.zeros(1000)

    def update():
        index = torch.randperm(1000)[:32]
        s, a, r, n, d = states[index], actions[index], rewards[index], nexts[index], terminated[index]
        with torch.no_grad():
            best = online(n).argmax(1, keepdim=True)
            y = r + 0.95 * (1.0 - d) * target(n).gather(1, best).squeeze(1)
        loss = F.smooth_l1_loss(online(s).gather(1, a).squeeze(1), y)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        with torch.no_grad():
            torch._foreach_lerp_(list(target.parameters()), list(online.parameters()), 0.005)

    for _ in range(100):
        update()
    times = []
    for _ in range(11):
        start = time.perf_counter()
        for _ in range(100):
            update()
        times.append((time.perf_counter() - start) / 100)
    return statistics.median(times)


def mcvl_seconds(program: str) -> dict[str, float]:
    lines = subprocess.run([program, "--time"], check=True, capture_output=True, text=True).stdout.split("\n")
    return {name: float(value) for name, value in (line.split() for line in lines if line)}


def newest_benchmark() -> str:
    folder = "target/release/deps"
    programs = [f"{folder}/{name}" for name in os.listdir(folder) if name.startswith("update-") and "." not in name]
    if not programs:
        sys.exit("no benchmark program: run `cargo bench -p mcvl-core --bench update --no-run` first")
    return max(programs, key=os.path.getmtime)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--program", help="the benchmark program (default: the newest under target/release)")
    parser.add_argument("--core", type=int, default=0, help="the core that both use")
    arguments = parser.parse_args()
    os.sched_setaffinity(0, {arguments.core})
    program = arguments.program or newest_benchmark()
    rows: dict[str, list[float]] = {}
    for pair in range(PAIRS):
        ours = mcvl_seconds(program)
        theirs = min(pytorch_seconds(100, foreach) for foreach in (False, True))
        print(f"pair {pair + 1}: PyTorch {theirs * 1e6:.0f} us", end="")
        for case in ("100-dense", "100-onehot", "100-onehot-22-states"):
            rows.setdefault(case, []).append(theirs / ours[case])
            share = 4_341_760 / ours[case] / ours["peak"]
            print(f", {case} {ours[case] * 1e6:.1f} us ({share:.0%} of peak)", end="")
        print()
    for case, ratios in rows.items():
        low, middle, high = min(ratios), statistics.median(ratios), max(ratios)
        print(f"{case}: mcvl is {middle:.1f} times faster (median of {PAIRS} pairs; {low:.1f} to {high:.1f})")


if __name__ == "__main__":
    main()
