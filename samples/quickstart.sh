#!/usr/bin/env bash
# From nothing to a soft shadow: installs the packages, builds the tools, makes a sample scene,
# bakes it, shadows its floor from the map alone and writes quickstart.png.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$PWD
build=build/quickstart

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

step "1. Packages" tests/install-packages.sh
step "2. Build" build_tools
step "3. A scene: a bumpy closed body of about 300,000 triangles over a floor" \
    $build/samples/mtsm-make-bumpy -n 300000 -o "$out/quickstart.glb"
step "4. Bake: a disk light of radius 0.5 sees the body; the floor is left out of the window" \
    $build/tools/mtsm-bake "$out/quickstart.glb" --exclude floor -o "$out/quickstart.mtsm" \
    --light-shape disk --light-position 2.5,5,2 --light-radius 0.5 --resolution 1024 --layers 5
step "5. What is in the map" $build/tools/mtsm-dump "$out/quickstart.mtsm"
step "6. Shadow the floor from the map: 512 x 512 points, 256 rays each" \
    $build/tools/mtsm-query "$out/quickstart.mtsm" --plane -3,0,2,4.5,0,0,0,0,-4.5 --size 512x512 \
    --samples 256 --stats -o "$out/quickstart.png"
echo
echo "The shadow is in $out/quickstart.png: look at it. The map is in $out/quickstart.mtsm."
