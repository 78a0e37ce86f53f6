#!/usr/bin/env bash
# What heads and tables are worth beside `patches`, on diffuse and on glossy surfaces: trains a head of each kind for each map, and compares in all scenes:
#
#     bash benches/heads.sh DATA OUT
#     MAPS=lebombo_1k SCENES=temple,cloth SAMPLES=4,16 POINTS=independent MATERIALS=lambert:albedo=0.5 bash benches/heads.sh DATA OUT
#
# Some hour and a half of one core; what is there already is not made again, so other settings take another OUT. DATA holds envmaps/*.hdr and scenes/*.glb, OUT
# takes the results. FLAGS=--unshadowed leaves out shadows, ALSO names more samplers.
set -euo pipefail
data="$(realpath "$1")"
mkdir -p "$2"
out="$(realpath "$2")"
headtail="${HEADTAIL:-cargo run --release --quiet --}"
read -ra maps <<<"${MAPS:-lebombo_1k venice_sunset_1k studio_small_03_1k dancing_hall_1k spiaggia_di_mondello_1k noon_grass_1k}"
scenes="${SCENES:-temple,dishes,diorama,droid,bedroom,cloth,$(printf "$data/scenes/%s.glb," japanese_temple terrarium_robots japanese_bridge_garden usd_shaderball spot)}"

train() { # NAME MATERIAL [FLAG...]
    for map in "${maps[@]}"; do
        [ -f "$out/$map-$1.safetensors" ] && continue
        $headtail fit --quiet --env "$data/envmaps/$map.hdr" --material "$2" "${@:3}" --out "$out/fit" --force
        mv "$out/fit/sampler.safetensors" "$out/$map-$1.safetensors"
    done
}

environments="$(printf "$data/envmaps/%s.hdr," "${maps[@]}")"
file="$out/MAP"
for material in ${MATERIALS:-lambert:albedo=0.5 ggx:alpha=0.4 ggx:alpha=0.2..0.8}; do
    name="${material//[:=]/-}"
    # A head does not depend on the albedo.
    trained="${material%%:albedo*}"
    [ -f "$out/$name.csv" ] && continue
    train "$name" "$trained"
    train "$name-over" "$trained" --over patches
    list="mis,mis2,mis-comp,ris:4,patches,head+mis:$file-$name.safetensors,head+patches:$file-$name-over.safetensors"
    case "$material" in
        lambert*)
            train "$name-plain" "$trained" --set head.share=false
            list+=",direct:TABLE,head:$file-$name-plain.safetensors"
            ;;
        *) list+=",ris:4:direct:TABLE,head:$file-$name.safetensors" ;;
    esac
    list+="${ALSO:+,$ALSO}"
    cargo bench --quiet -p headtail-render --bench visibility -- "${scenes%,}" "${environments%,}" "$material" "$list" "${SAMPLES:-4,16,64,256}" \
        "${SIZE:-96x72}" "${POINTS:-sobol}" 64 "${REFERENCE:-1024}" ${FLAGS:-} >"$out/$name.part"
    mv "$out/$name.part" "$out/$name.csv"
done
for results in "$out"/*.csv; do
    echo "## $(basename "${results%.csv}")"
    python3 "$(dirname "$0")/equal_time.py" "$results"
done
