#!/usr/bin/env bash
# Makes everything in this folder anew: five seeds at the preset `small`, with the button and without.
#   cargo xtask setup && cargo build --release --features mujoco && results/reacher/run.sh target/release/mcvl
# Runs continue where they were stopped. Only what the README lists is copied here; the whole run
# directories (tapes, checkpoints, every step) stay under runs/results/.
set -eu
mcvl=$(realpath "${1:?the mcvl program}")
here=$(realpath "$(dirname "$0")")
cd "$here/../.."
mkdir -p runs/results

setting() { # name, then the flags of `mcvl train`
    name=$1
    shift
    run=runs/results/reacher-$name
    again=$([ -e "$run/run.toml" ] && echo --resume || true)
    "$mcvl" train reacher --preset small --seeds 0..5 "$@" $again -o "$run" >"runs/results/reacher-$name.txt"
    "$mcvl" verify "$run"
    mkdir -p "$here/$name"
    cp "$run"/{run.toml,manifest.json,summary.json,curves.svg} "$here/$name/"
    cp "runs/results/reacher-$name.txt" "$here/$name/summary.txt"
    for seed in "$run"/seed-*; do
        mkdir -p "$here/$name/$(basename "$seed")"
        cp "$seed/ledger.jsonl" "$here/$name/$(basename "$seed")/"
    done
}

setting small
setting no-button --variant no-button
cp runs/results/reacher-small/curves.png "$here/small/"
