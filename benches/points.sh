#!/usr/bin/env bash
# Samplers at equal samples and at equal time with the same points, over scenes and maps, and the geometric means of what they gain:
#
#     bash benches/points.sh DATA OUT
#     SAMPLES=4,16 SECONDS_EACH=0.25,1 MAPS=studio SCENES=cloth MATERIALS=lambert SAMPLERS=mis,patches bash benches/points.sh DATA OUT
#
# Some twenty minutes on four cores; what is there already is not made again. DATA holds envmaps/*.hdr and scenes/*.glb, OUT takes the results.
set -euo pipefail
data="$1" out="$2" points="${POINTS:-sobol}"
headtail="${HEADTAIL:-cargo run --release --quiet --}"
maps=("$data"/envmaps/{lebombo_1k,studio_small_03_1k,venice_sunset_1k,spiaggia_di_mondello_1k}.hdr)
scenes=(temple dishes diorama droid bedroom cloth "$data"/scenes/{japanese_temple,terrarium_robots,japanese_bridge_garden,usd_shaderball,spot}.glb)
[ -z "${MAPS:-}" ] || read -ra maps <<<"$MAPS"
[ -z "${SCENES:-}" ] || read -ra scenes <<<"$SCENES"
budgets=()
[ -z "${SAMPLES-4,16,64}" ] || budgets+=(--spp "${SAMPLES-4,16,64}")
[ -z "${SECONDS_EACH:-}" ] || budgets+=(--seconds "$SECONDS_EACH")

name() { basename "${1%.*}"; }

for map in "${maps[@]}"; do
    table="$out/direct-$(name "$map").safetensors"
    mkdir -p "$out"
    [ -f "$table" ] || $headtail bake --direct --env "$map" --out "$table"
    for scene in "${scenes[@]}"; do
        for material in ${MATERIALS:-lambert:albedo=0.5 ggx:alpha=0.4}; do
            folder="$out/${material%%:*}-$(name "$scene")-$(name "$map")"
            [ -f "$folder/results.csv" ] && continue
            ground=()
            [[ "$scene" != */* ]] || ground=(--ground)
            view=(--scene "$scene" "${ground[@]}" --material "$material" --env "$map" --width "${WIDTH:-96}" --height "${HEIGHT:-72}")
            seen="$folder-visibility.safetensors"
            [ -f "$seen" ] || $headtail bake --visibility "${view[@]}" --out "$seen"
            list="mis,mis2,mis-comp,ris:4,patches,patches+vis,patches+vis:$seen"
            [[ "$material" != lambert* ]] || list="$list,direct:$table"
            [ -z "${SAMPLERS:-}" ] || list="$SAMPLERS,patches+vis:$seen"
            $headtail compare "${view[@]}" --points "$points" --samplers "$list" "${budgets[@]}" --runs "${RUNS:-3}" --reference-spp "${REFERENCE:-2048}" \
                --reference-cache "$out/references" --out "$folder"
        done
    done
done
python3 "$(dirname "$0")/geometric_means.py" "$out"
