#!/usr/bin/env bash
# Makes everything in this folder anew: ten seeds of each setting, at the paper's hyper-parameters.
#   cargo build --release && results/box-moving/run.sh target/release/mcvl [NAME...]
# With names, only those settings. Runs continue where they were stopped. Only what the README lists is
# copied here; the whole run directories (tapes, checkpoints, every step) stay under runs/results/.
set -eu
mcvl=$(realpath "${1:?the mcvl program}")
here=$(realpath "$(dirname "$0")")
wanted=" ${*:2} "
cd "$here/../.."
mkdir -p runs/results

setting() { # name, then the flags of `mcvl train`
    name=$1
    shift
    [[ $wanted == "  " || $wanted == *" $name "* ]] || return 0
    run=runs/results/$name
    again=$([ -e "$run/run.toml" ] && echo --resume || true)
    "$mcvl" train box-moving --seeds 0..10 "$@" $again -o "$run" >"runs/results/$name.txt"
    "$mcvl" verify "$run"
    mkdir -p "$here/$name"
    cp "$run"/{run.toml,manifest.json,summary.json,curves.svg} "runs/results/$name.txt" "$here/$name/"
    mv "$here/$name/$name.txt" "$here/$name/summary.txt"
}

setting e1
setting e1-release --preset release
setting e6-all --scheme all
setting e6-discard --scheme discard
setting e6-each-step --scheme each-step
setting e6-punish --scheme punish
setting e6-store-predicted --scheme store-predicted
setting e7-0 --set safe_steps=0
setting e7-100 --set safe_steps=100
setting e7-200 --set safe_steps=200
setting e7-300 --set safe_steps=300
setting e8-100 --set forecast=100
setting e8-300 --set forecast=300
setting e9 --variant no-inconsistency
setting e13-1 --set rollout_steps=1
setting e13-5 --set rollout_steps=5
setting e13-10 --set rollout_steps=10
setting e14 --set against=current
setting e16 --set reset_on_refusal=false
setting learners --agent oracle --agent frozen --agent frozen-reward

[[ $wanted == "  " || $wanted == *" e1 "* ]] || exit 0

# The main setting with its data: enough for `mcvl report` and `mcvl compare` on another machine.
for seed in runs/results/e1/seed-*; do
    mkdir -p "$here/e1/$(basename "$seed")"
    cp "$seed"/{metrics.jsonl,ledger.jsonl} "$here/e1/$(basename "$seed")/"
done
cp runs/results/e1/curves.png "$here/e1/"
