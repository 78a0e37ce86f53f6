#!/usr/bin/env bash
# Rendering on a graphics device, in at most eight minutes: bash benches/gpu/render.sh PROGRAM OUT
# PROGRAM is `headtail`, built before: cargo build --release --workspace --features gpu --bin headtail
# Sizes for a software adapter: WIDTH=64 HEIGHT=48 SECONDS_EACH=0.2 RUNS=1 VIEWS=1 bash benches/gpu/render.sh ...
set -uo pipefail
program="$1" out="$2"
width="${WIDTH:-1024}" height="${HEIGHT:-1024}" seconds="${SECONDS_EACH:-0.5}" runs="${RUNS:-2}" views="${VIEWS:-10}"
. "$(dirname "$0")/part.sh"

# Is it right here: the same picture by the CPU and by the device.
for device in cpu gpu; do
    part "right-$device" 60 "$program" render --scene temple --env sunset --sampler split:4:patches --spp 16 --width 256 --height 192 \
        --device "$device" --json --force --out "$out/right-$device.exr"
done

# The aim: a million pixels with 16 samples.
for sampler in split:4:patches split:3:mis2-comp mis2-comp; do
    part "million-${sampler//:/-}" 60 "$program" render --scene temple --env sunset --sampler "$sampler" --spp 16 --width "$width" \
        --height "$height" --device gpu --json --force --out "$out/million.exr"
done

# Equal time, errors against a reference of the CPU; seconds, samples and rays of every run are in results.csv.
head="checkpoints/studio-head.safetensors"
number=0
for view in "temple studio lambert" "temple sunset lambert" "dishes studio ggx:alpha=0.4" "dishes sunset ggx:alpha=0.4" "arcade sunset lambert" \
    "arcade studio lambert" "bedroom window lambert" "droid studio ggx:alpha=0.2..0.6" "diorama overcast lambert" "dishes window ggx:alpha=0.1"; do
    read -r scene env material <<<"$view"
    number=$((number + 1))
    [ "$number" -le "$views" ] || break
    samplers="mis,mis2,mis-comp,mis2-comp,split:3:mis2-comp,ris:4,patches,split:4:patches"
    [ "$env $material" != "studio lambert" ] || samplers="$samplers,head+mis:$head"
    for device in gpu cpu; do
        part "view-$number-$device" 40 "$program" compare --scene "$scene" --env "$env" --material "$material" --samplers "$samplers" \
            --seconds "$seconds" --runs "$runs" --width 256 --height 192 --reference-spp 512 --reference-cache "$out/references" \
            --device "$device" --json --force --out "$out/view-$number-$device"
        rm -f "$out/view-$number-$device"/*.exr
    done
done
