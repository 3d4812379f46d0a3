#!/usr/bin/env bash
# The papers' own comparisons, again: builds the tools, makes the scenes, compares every method on
# each and prints every claim of the papers beside the number found here.
#
#     samples/paper/run.sh                     # all but the giants: about an hour on two cores
#     samples/paper/run.sh character           # one scene: character palm fur giant-13m giant-109m
#     samples/paper/run.sh --quick character   # small pictures: minutes, to see how it goes
#     samples/paper/run.sh --points16          # equal error with 16 points a pixel, first three
#
# Everything goes to out/paper/SCENE: report.html, results.json, pictures. What was done is kept in
# a cache there: a second run goes on where the first one stopped.
set -euo pipefail
cd "$(dirname "$0")/../.."
build=build/release
out=out/paper
quick=() points16=no scenes=()
for word in "$@"; do
    case $word in
    --quick) quick=(--image 200x100 --truth 256 --measured-pixels 512 --repeats 1) ;;
    --points16) points16=yes ;;
    character | palm | fur | giant-13m | giant-109m) scenes+=("$word") ;;
    *)
        echo "run.sh: found \"$word\", expected --quick, --points16 or scenes: character palm fur" \
            "giant-13m giant-109m" >&2
        exit 2
        ;;
    esac
done
[ ${#scenes[@]} -gt 0 ] || scenes=(character palm fur)

tests/install-packages.sh
cmake --preset release -DMTSM_BUILD_TESTS=OFF >/dev/null
cmake --build --preset release --parallel "$(nproc)" --target mtsm-compare mtsm-make-character \
    mtsm-make-palm mtsm-make-fur

# caster SCENE: its file, made once.
caster() {
    case $1 in
    character) made=character.ply make="mtsm-make-character -n 316000" ;;
    palm) made=palm.ply make="mtsm-make-palm -n 310000" ;;
    fur) made=fur.hair make="mtsm-make-fur -n 4562000" ;;
    giant-13m) made=giant-13m.hair make="mtsm-make-fur -n 13000000" ;;
    giant-109m) made=giant-109m.hair make="mtsm-make-fur -n 109000000" ;;
    esac
    # shellcheck disable=SC2086 # the words of the command
    [ -e "$out/$made" ] || $build/samples/$make -o "$out/$made"
    cp "samples/paper/$1.toml" "$out/$1.toml"
}

mkdir -p $out
for scene in "${scenes[@]}"; do
    echo
    echo "=== $scene"
    caster "$scene"
    if [ $points16 = yes ]; then
        $build/tools/mtsm-compare $out/"$scene".toml --points 16 --pixels 2048 --truth 256 \
            --method embree --method mtsm "${quick[@]}" -o $out/"$scene"-16
    else
        $build/tools/mtsm-compare $out/"$scene".toml "${quick[@]}" -o $out/"$scene"
    fi
done
echo
python3 samples/paper/claims.py $out | tee $out/claims.md
echo
echo "The reports are in $out/*/report.html, this table in $out/claims.md."
