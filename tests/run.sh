#!/usr/bin/env bash
# Installs the packages, builds with warnings as errors and runs every test: once plain, once with
# the address and undefined behaviour sanitizers; then what is threaded with the thread sanitizer.
# Arguments go to ctest (tests/run.sh -L format).
#
# Tests that use real meshes look for them in the folder that MTSM_TEST_DATA names and skip what
# they do not find.
set -euo pipefail
cd "$(dirname "$0")/.."
tests/install-packages.sh
jobs=$(nproc)
for preset in dev asan; do
    echo "=== $preset: configure and build"
    cmake --preset "$preset" >/dev/null
    cmake --build --preset "$preset" --parallel "$jobs"
    echo "=== $preset: test"
    ctest --preset "$preset" --parallel "$jobs" "$@"
done
echo "=== tsan: what is threaded, by test cases with the tag [threads]"
threaded=(compress format raster bake shadow)
cmake --preset tsan >/dev/null
cmake --build --preset tsan --parallel "$jobs" --target "${threaded[@]/#/test_}"
for module in "${threaded[@]}"; do
    timeout 1200 "build/tsan/tests/$module/test_$module" '[threads]' --warn NoTests
done
echo "All tests passed, plain and with sanitizers."
