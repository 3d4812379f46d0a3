#!/usr/bin/env bash
# Installs the build into a scratch folder and builds a sample against it, as a renderer would.
# Usage: run.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
build=$1 source=$2
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cmake --install "$build" --prefix "$scratch/prefix" >/dev/null
cmake -S "$source/tests/install/consumer" -B "$scratch/consumer" -G Ninja \
    -DCMAKE_PREFIX_PATH="$scratch/prefix" -DSAMPLE="$source/samples/shadow_at_point.cpp" >/dev/null
cmake --build "$scratch/consumer"
# It runs: a file that is not there is exit code 3.
code=0
"$scratch/consumer/shadow_at_point" "$scratch/none.mtsm" 0 0 0 || code=$?
[ "$code" -eq 3 ]
