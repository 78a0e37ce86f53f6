#!/usr/bin/env bash
# Every sampler on every scene under every map, at equal samples and at equal time, and one page over all:
#
#     bash benches/scenes.sh DATA OUT
#     MAPS="studio sunset" SCENES=cloth SECONDS_EACH=0.5 bash benches/scenes.sh DATA OUT
#
# Some four hours on two cores; what is there already is not made again.
#
# DATA holds envmaps/*.hdr and scenes/*.glb (and may be empty: then the built-in scenes and maps are used alone), OUT takes the results.
# Each scene is given Lambert surfaces, then ggx:alpha=0.4. For each map a head for either
# material is trained and a table is baked, once. A row of unshadowed images and one with the oracle (small, it is slow) stand beside.
set -euo pipefail
data="$1" out="$2" seconds="${SECONDS_EACH:-1}"
headtail="${HEADTAIL:-cargo run --release --quiet --}"
maps=(studio sunset "$data"/envmaps/{lebombo_1k,studio_small_03_1k,venice_sunset_1k,spiaggia_di_mondello_1k}.hdr)
scenes=(temple dishes diorama droid bedroom cloth "$data"/scenes/{japanese_temple,terrarium_robots,japanese_bridge_garden,usd_shaderball,spot}.glb)

[ -z "${MAPS:-}" ] || read -ra maps <<<"$MAPS"
[ -z "${SCENES:-}" ] || read -ra scenes <<<"$SCENES"

exists() { [[ "$1" != */* || -f "$1" ]]; }
name() { basename "${1%.*}"; }

for map in "${maps[@]}"; do
    exists "$map" || continue
    samplers="$out/samplers/$(name "$map")"
    mkdir -p "$samplers"
    [ -f "$samplers/direct.safetensors" ] || $headtail bake --direct --env "$map" --out "$samplers/direct.safetensors"
    for material in lambert ggx:alpha=0.4; do
        head="$samplers/head-${material%%:*}.safetensors"
        [ -f "$head" ] && continue
        $headtail fit --env "$map" --material "$material" --out "$samplers/fit" --force
        mv "$samplers/fit/sampler.safetensors" "$head"
    done
    for scene in "${scenes[@]}"; do
        exists "$scene" || continue
        for material in lambert:albedo=0.5 ggx:alpha=0.4; do
            head="$samplers/head-${material%%:*}.safetensors"
            list="mis,mis2,mis-comp,ris:4,ris:16,patches,head+mis:$head"
            case "$material" in
                lambert*) list="$list,direct:$samplers/direct.safetensors" ;;
                *) list="$list,head:$head,ris:4:head:$head,ris:4:direct:$samplers/direct.safetensors" ;;
            esac
            ground=()
            [[ "$scene" != */* ]] || ground=(--ground)
            compare() {
                [ -f "$1/results.csv" ] || $headtail compare --scene "$scene" "${ground[@]}" --material "$material" --env "$map" \
                    --reference-spp 1024 --reference-cache "$out/references" --out "$@"
            }
            folder="$out/${material%%:*}/$(name "$scene")-$(name "$map")"
            compare "$folder" --width 256 --height 192 --samplers "$list" --spp 4 --seconds "$seconds"
            compare "$folder-unshadowed" --width 128 --height 96 --samplers "$list" --spp 4 --unshadowed
            compare "$folder-oracle" --width 32 --height 24 --samplers "$list,oracle" --spp 4 --runs 3
        done
    done
done
for material in lambert ggx; do
    mapfile -t results < <(find "$out/$material" -mindepth 1 -maxdepth 1 -type d ! -name '*-unshadowed' ! -name '*-oracle' | sort)
    $headtail chart "${results[@]}" --out "$out/$material.html" --force
done
