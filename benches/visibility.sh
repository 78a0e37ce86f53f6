#!/usr/bin/env bash
# What knowing visibility gains over `patches`, as CSV files for the charts of docs/results/visibility.md:
#
#     bash benches/visibility.sh DATA OUT
#     SCENES=bedroom MAPS=studio_small_03_1k CHARTS=rays,memory bash benches/visibility.sh DATA OUT
#
# What is learned is always drawn with. rays.csv: by the samples per pixel that were learned from; cells.csv: tables by the cells along a side of Y; memory.csv: by the megabytes that may be taken;
# cache.csv: a cache in X by its points, rows of tiles, angle of normals and floor. Some ten minutes on one core. DATA holds envmaps/*.hdr and scenes/*.glb.
set -euo pipefail
data="$1" out="$2"
bench="${BENCH:-cargo bench --quiet -p headtail-render --bench visibility --}"
IFS=, read -ra maps <<<"${MAPS:-lebombo_1k,studio_small_03_1k,noon_grass_1k}"
scenes="${SCENES:-bedroom,temple,$data/scenes/japanese_temple.glb}"
charts=",${CHARTS:-rays,cells,memory,cache},"
files="$(printf ",$data/envmaps/%s.hdr" "${maps[@]}")"
mkdir -p "$out"

# The samplers of a chart, and the megabytes that they learn with.
measure() {
    $bench "$scenes" "${files#,}" lambert "$1" "${SAMPLES:-16}" 160x120 sobol "$2" "${REFERENCE:-256}"
}

[[ "$charts" != *,rays,* ]] ||
    measure patches,always:patches+vis,always:patches+vis:LEARNED1,always:patches+vis:LEARNED4,always:patches+vis:LEARNED16,always:patches+vis:LEARNED64 64 >"$out/rays.csv"
[[ "$charts" != *,cells,* ]] ||
    measure direct:TABLE,always:direct+vis8@LEARNED16:TABLE,always:direct+vis@LEARNED16:TABLE,always:direct+vis32@LEARNED16:TABLE 64 >"$out/cells.csv"
if [[ "$charts" == *,memory,* ]]; then
    for megabytes in 0.0625 0.25 1 64; do
        measure patches,always:patches+vis "$megabytes" | sed "s/^/$megabytes,/;1s/^[^,]*/megabytes/"
    done | awk 'NR == 1 || !/^megabytes,/' >"$out/memory.csv"
fi
[[ "$charts" != *,cache,* ]] ||
    measure mis,cache:2000,cache:500,cache:8000:8,cache:500:32,cache:2000:16:15,cache:2000:16:45,cache:2000:16:25:0.03,cache:2000:16:25:0.3 64 >"$out/cache.csv"
