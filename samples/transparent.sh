#!/usr/bin/env bash
# Fur and smoke: builds the tools, makes a ball of fur and a puff of smoke, bakes both by a job
# file, shadows the floor below them from the map alone and writes out/transparent.png.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$PWD/out
build=build/quickstart
mkdir -p "$out"

# step TITLE COMMAND...: runs the command and says how long it took.
step() {
    local title=$1 start
    shift
    echo
    echo "--- $title"
    start=$(date +%s.%N)
    "$@"
    printf -- '    (%.1f s)\n' "$(echo "$(date +%s.%N) $start" | awk '{print $1 - $2}')"
}

build_tools() {
    cmake --preset release -B $build -DMTSM_BUILD_TESTS=OFF -DMTSM_BUILD_BASELINE=OFF >/dev/null
    cmake --build $build --parallel "$(nproc)"
}

make_casters() {
    $build/samples/mtsm-make-fur -n 1000000 -o "$out/fur.hair"
    $build/samples/mtsm-make-smoke --size 96 -o "$out/smoke.vdb"
    cat >"$out/transparent.toml" <<'END'
output = "transparent.mtsm"

[light]
shape = "disk"
radius = 0.5
position = [0, 7, 3]

[map]
resolution = 1024
tolerance = 0.005

[[caster]]
file = "fur.hair"
hair-opacity = 0.4
translate = [-1.5, 1.4, 0]

[[caster]]
file = "smoke.vdb"
density-scale = 4
translate = [1.5, 0.2, 0]
END
    cat "$out/transparent.toml"
}

step "1. Packages" tests/install-packages.sh
step "2. Build" build_tools
step "3. Casters: fur of about a million triangles, smoke, and a job file for both" make_casters
step "4. Bake" $build/tools/mtsm-bake "$out/transparent.toml"
step "5. What is in the map" $build/tools/mtsm-dump "$out/transparent.mtsm"
step "6. Shadow the floor from the map: 512 x 320 points, 256 rays each" \
    $build/tools/mtsm-query "$out/transparent.mtsm" --plane -4,0,1.5,8,0,0,0,0,-5 --size 512x320 \
    --samples 256 --stats -o "$out/transparent.png"
echo
echo "The shadow is in $out/transparent.png: look at it. The map is in $out/transparent.mtsm."
