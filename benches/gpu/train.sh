#!/usr/bin/env bash
# Training on a graphics device, in at most eight minutes: bash benches/gpu/train.sh PROGRAM BENCH OUT
# PROGRAM is `headtail`, BENCH the benchmark `device`, both built before:
#   cargo build --release --workspace --features gpu --bin headtail --bench device
# A third argument of sizes for a software adapter: CONDITIONS=8 STEPS=2 bash benches/gpu/train.sh ...
set -uo pipefail
program="$1" bench="$2" out="$3"
conditions="${CONDITIONS:-256}" steps="${STEPS:-50}"
. "$(dirname "$0")/part.sh"
# Is it right here: gradients against the host's and against f64, ten steps of training.
part right 45 "$program" backends --preset fast-ggx --conditions 8 --samples 64 --steps 3 --json
part step 90 "$bench" "$conditions" "$steps"
part forms 100 "$program" backends --preset paper-ggx --conditions "$conditions" --steps "$steps" --gradient device --json
part fused 30 "$program" backends --preset paper-ggx --conditions "$conditions" --steps 5 --gradient fused --json
# The paper's microfacet head at its size, and the same steps on the host for as long as they take.
part fit 130 "$program" fit --env studio --preset paper-ggx --set gradient=device ${FIT_STEPS:+--set steps=$FIT_STEPS} --out "$out/fit"
# Points from tables of half a million cells per condition, as in the paper.
part tabulated 60 "$program" fit --env studio --preset paper-ggx --target tabulated --set gradient=device --set steps="${TABULATED_STEPS:-500}" \
    --set conditions="$conditions" --json --out "$out/tabulated"
