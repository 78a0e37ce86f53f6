#!/usr/bin/env bash
# Neural and measured materials in scenes, at equal samples and at equal time: every sampler, with heads and rivals that are trained for them:
#
#     bash benches/materials.sh DATA OUT
#     SETS=temple MAPS=lebombo_1k SAMPLES=4,16 RUNS=1 bash benches/materials.sh DATA OUT
#
# With COMPARE=no it trains alone, which may be done beside other work. The sets are `welt` (in the bedroom), `satin` and `velvet` (on the cloth), and `temple` (eight measured materials from mirror-like to matte). Times mean
# something on an otherwise idle machine only. What is there already is not made again. DATA holds envmaps/*.hdr and nbrdf/nbrdf_all.f32.
set -euo pipefail
data="$1" out="$2"
headtail="${HEADTAIL:-cargo run --release --quiet --}"
fabrics="${FABRICS:-checkpoints}"
read -ra maps <<<"${MAPS:-lebombo_1k studio_small_03_1k spiaggia_di_mondello_1k venice_sunset_1k noon_grass_1k dancing_hall_1k}"
measured="nbrdf:$data/nbrdf/nbrdf_all.f32#merl/chrome,merl/nickel,rgl-isotropic/chm_light_blue_rgb,rgl-isotropic/satin_gold_rgb,\
merl/silver-metallic-paint2,merl/alumina-oxide,merl/pearl-paint,rgl-isotropic/paper_white_rgb"
mkdir -p "$out"

for set in ${SETS:-welt satin velvet temple}; do
    train=(--steps 800)
    case "$set" in
        welt) scene=bedroom material="neural:$fabrics/welt.safetensors,repeat=24" alone="neural:$fabrics/welt.safetensors" ;;
        satin) scene=cloth material="neural:$fabrics/satin.safetensors,repeat=20" alone="neural:$fabrics/satin.safetensors" ;;
        velvet) scene=cloth material="neural:$fabrics/velvet.safetensors,repeat=12" alone="neural:$fabrics/velvet.safetensors" ;;
        # One head for the family of the eight.
        temple) scene=temple material="$measured" alone="$measured" train=() ;;
        *) echo "no such set: $set" >&2 && exit 2 ;;
    esac
    [ "$set" == temple ] || train+=(--conditions-from "$scene")
    for kind in flow reparam; do
        rival="$out/$set-$kind.safetensors"
        [ -f "$rival" ] || $headtail fit-rival --kind "$kind" --material "$alone" ${RIVAL_STEPS:+--steps "$RIVAL_STEPS"} --out "$rival"
    done
    for map in "${maps[@]}"; do
        folder="$out/$set-$scene-$map" env="$data/envmaps/$map.hdr"
        [ -f "$folder/results.csv" ] && continue
        for over in tail patches; do
            head="$out/$set-$map-over-$over"
            also=()
            [ "$over" == tail ] || also=(--over patches)
            [ -f "$head/sampler.safetensors" ] || $headtail fit --env "$env" --material "$material" "${train[@]}" "${also[@]}" --out "$head" --force
        done
        [ "${COMPARE:-yes}" == yes ] || continue
        list="mis,mis2,mis-comp,cosine,brdf,emitter,ris:4,patches,patches+vis"
        list+=",neusample+emitter:$out/$set-flow.safetensors,reparam+emitter:$out/$set-reparam.safetensors"
        list+=",head+mis:$out/$set-$map-over-tail/sampler.safetensors,head+patches:$out/$set-$map-over-patches/sampler.safetensors"
        $headtail compare --scene "$scene" --material "$material" --env "$env" --samplers "$list" --spp "${SAMPLES:-4,16,64}" --runs "${RUNS:-2}" \
            --width "${WIDTH:-96}" --height "${HEIGHT:-72}" --reference-spp "${REFERENCE:-1024}" --out "$folder"
    done
done
# Times are those of the same runs.
python3 "$(dirname "$0")/geometric_means.py" "$out" "$out"
