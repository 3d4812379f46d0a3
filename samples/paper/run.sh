#!/usr/bin/env bash
# The papers' own comparisons, again: builds the tools, makes the scenes, compares every method on
# each and prints every claim of the papers beside the number found here.
#
#     samples/paper/run.sh                     # all but the giants: about an hour on two cores
#     samples/paper/run.sh character           # one scene: character palm fur giant-13m giant-109m
#     samples/paper/run.sh --quick character   # small pictures: minutes, to see how it goes
#     samples/paper/run.sh --points16          # equal error with 16 points a pixel, first three
#     samples/paper/run.sh --large             # the same pictures with 2048 x 1024 pixels
#
# Everything goes to out/paper/SCENE (SCENE-16, SCENE-large, SCENE-quick): report.html, results.json,
# pictures. Truths and finished lights are kept in a cache there: a second run takes them from it.
set -euo pipefail
cd "$(dirname "$0")/../.."
build=build/release
out=out/paper
options=() suffix="" scenes=()
for word in "$@"; do
    case $word in
    --quick)
        options=(--image 200x100 --truth 256 --measured-pixels 512 --repeats 1)
        suffix=-quick
        ;;
    --points16)
        options=(--points 16 --pixels 2048 --truth 256 --method embree --method mtsm)
        suffix=-16
        ;;
    --large)
        options=(--image 2048x1024 --pixels 8192)
        suffix=-large
        ;;
    character | palm | fur | giant-13m | giant-109m) scenes+=("$word") ;;
    *)
        echo "run.sh: found \"$word\", expected --quick, --points16, --large or scenes: character" \
            "palm fur giant-13m giant-109m" >&2
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
    $build/tools/mtsm-compare $out/"$scene".toml "${options[@]}" -o $out/"$scene$suffix"
done
echo
python3 samples/paper/claims.py $out $suffix | tee $out/claims$suffix.md
echo
echo "The reports are in $out/*/report.html, these tables in $out/claims$suffix.md."
