#!/usr/bin/env bash
# Is the map ahead of Embree? Builds the tools, makes the scenes, measures both on each and prints
# tables: equal samples, equal error, errors, cost against resolution, memory.
#
#     samples/paper/bench.sh                # all but the giants: some hours
#     samples/paper/bench.sh palm fur       # some of: character bumpy palm fur cards smoke giant-13m
#                                           # giant-109m
#     samples/paper/bench.sh --quick        # fewer settings, each timed thrice: an hour and more
#     samples/paper/bench.sh --points16     # equal error with 16 points a pixel as well, of fewer settings
#     samples/paper/bench.sh --mesh dragon.ply --light-position 50,300,100 --light-radius 10
#                                           # a mesh of yours on a floor as well
#
# Everything goes to out/paper: bench.md has the tables, bench-SCENE/results.json what they are made
# from. Truths and finished lights are kept in a cache there: a second run takes them from it.
set -euo pipefail
here=$PWD
cd "$(dirname "$0")/../.."
build=build/release
out=out/paper
quick="" points16="" mesh="" position="" radius="" scenes=()

refuse() {
    echo "bench.sh: $1" >&2
    exit 2
}
while [ $# -gt 0 ]; do
    case $1 in
    --quick) quick=-quick ;;
    --points16) points16=1 ;;
    --mesh | --light-position | --light-radius)
        [ $# -gt 1 ] || refuse "$1 needs a value"
        case $1 in
        --mesh) mesh=$2 ;;
        --light-position) position=$2 ;;
        --light-radius) radius=$2 ;;
        esac
        shift
        ;;
    character | bumpy | palm | fur | cards | smoke | giant-13m | giant-109m) scenes+=("$1") ;;
    *)
        refuse "found \"$1\", expected --quick, --points16, --mesh FILE with --light-position X,Y,Z \
and --light-radius R, or scenes: character bumpy palm fur cards smoke giant-13m giant-109m"
        ;;
    esac
    shift
done
[ ${#scenes[@]} -gt 0 ] || [ -n "$mesh" ] || scenes=(character bumpy palm fur cards smoke)
if [ -n "$mesh" ]; then
    if [ -z "$position" ] || [ -z "$radius" ]; then
        refuse "--mesh needs --light-position X,Y,Z and --light-radius R beside it"
    fi
    case $mesh in /*) ;; *) mesh=$here/$mesh ;; esac
    [ -e "$mesh" ] || refuse "$mesh: there is no such file"
    scenes+=(mesh)
fi

tests/install-packages.sh
cmake --preset release -DMTSM_BUILD_TESTS=OFF >/dev/null
cmake --build --preset release --parallel "$(nproc)" --target mtsm-compare mtsm-make-character \
    mtsm-make-bumpy mtsm-make-palm mtsm-make-fur mtsm-make-leaf-tree mtsm-make-smoke

# caster SCENE: its file, made once.
caster() {
    case $1 in
    character) made=character.ply make="mtsm-make-character -n 316000" ;;
    bumpy) made=bumpy.glb make="mtsm-make-bumpy -n 350000" ;;
    palm) made=palm.ply make="mtsm-make-palm -n 310000" ;;
    fur) made=fur.hair make="mtsm-make-fur -n 4562000" ;;
    cards) made=cards.obj make="mtsm-make-leaf-tree -n 20000" ;;
    smoke) made=smoke.vdb make="mtsm-make-smoke --size 128" ;;
    giant-13m) made=giant-13m.hair make="mtsm-make-fur -n 13000000" ;;
    giant-109m) made=giant-109m.hair make="mtsm-make-fur -n 109000000" ;;
    mesh) return ;;
    esac
    # shellcheck disable=SC2086 # the words of the command
    [ -e "$out/$made" ] || $build/samples/$make -o "$out/$made"
}

# place SCENE: its file up to the methods.
place() {
    if [ "$1" != mesh ]; then
        sed '/^\[\[method\]\]/,$d' "samples/paper/$1.toml"
        return
    fi
    cat <<END
[light]
shape = "disk"
radius = $radius
position = [$position]

[[caster]]
file = '$mesh'

[[receiver]]
floor = true

[camera]
image = [600, 300]

[compare]
light-scales = [0.28, 1, 2.68]
truth = 4096

END
}

# methods16 SCENE: the same where a pixel has 16 points, of which few samples are enough.
methods16() {
    local resolutions="512" near='"none", "auto"'
    case $1 in
    palm) resolutions="256, 512" ;;
    fur | cards) resolutions="256, 512" near='"auto"' ;;
    smoke) resolutions="64, 128" near='"none"' ;;
    giant-*) near='"512M"' ;;
    esac
    cat <<END
[[method]]
name = "embree"
samples = [1, 4, 16]

[[method]]
name = "embree"
mode = "pixel"
samples = [1, 4, 16]

[[method]]
name = "mtsm"
resolution = [$resolutions]
near-field = [$near]
samples = [1, 2, 4, 16, 64]
END
}

# methods SCENE [16]: what is compared. Of Embree every mode that might be the cheapest; of the map
# the sweep for equal error, the paper's settings, and what cost against resolution needs besides.
methods() {
    local resolutions="512, 1024, 2048" near='"none"' further="" paper=1024
    local counts="1, 2, 4, 8, 16, 32, 64, 128, 256" embree="1, 2, 4, 8, 16, 32, 64, 128, 256"
    if [ "${2-}" = 16 ]; then
        methods16 "$1"
        return
    fi
    case $1 in
    character | bumpy | palm | mesh) near='"none", "auto"' further="4096, 8192" ;;
    fur) resolutions="256, $resolutions" near='"none", "auto"' further="4096" ;;
    cards) resolutions="256, $resolutions" near='"none", "auto"' ;;
    smoke) resolutions="32, 64, 128, 256, 512" ;; # of 128 x 128 x 128 voxels
    giant-*) resolutions="2048, 512" near='"none", "512M"' paper=2048 embree="1, 4, 16, 64, 256" ;;
    esac
    if [ -n "$quick" ]; then
        case $1 in
        smoke) resolutions=${resolutions%, 512} ;;
        *) resolutions=${resolutions%, 2048} ;;
        esac
        [ "$further" != "4096, 8192" ] || further="2048, $further"
        [ "$further" != 4096 ] || further=""
        counts="1, 2, 4, 8, 16, 64, 256" embree="1, 4, 16, 64, 256"
    fi
    cat <<END
[[method]]
name = "embree"
samples = [$embree]

[[method]]
name = "embree"
mode = "adaptive"
samples = [4, 16]
most = [64, 256]

[[method]]
name = "embree"
mode = "pixel"
samples = [1, 4, 16, 256]

[[method]]
name = "mtsm"
resolution = [$resolutions]
near-field = [$near]
samples = [$counts]

[[method]]
name = "mtsm"
resolution = [$resolutions]
near-field = [$near]
samples = [${counts##*16, }]
adaptive = "true"
END
    # With a near field few pixels are enough, and the first picture is there the sooner.
    case $1 in
    character | bumpy | palm | fur | cards | mesh)
        cat <<END

[[method]]
name = "mtsm"
resolution = 128
near-field = "auto"
samples = [$counts]
END
        ;;
    esac
    cat <<END

[[method]]
name = "mtsm"
resolution = $paper
near-field = [$near]
layers = 5
samples = 256
END
    [ -n "$further" ] || return 0
    cat <<END

[[method]]
name = "mtsm"
resolution = [$further]
near-field = "none"
samples = 64
END
}

mkdir -p $out
for scene in "${scenes[@]}"; do
    caster "$scene"
    for points in 1 ${points16:+16}; do
        # Times are those of all pixels: what is asked for a few again and again lies in
        # Embree's caches, and in small pictures neighbours share less of their way. Of the
        # giants' pictures a part is as many points.
        measured=180000 pixels=0 truth="" suffix=$quick
        case $scene in giant-*) measured=20000 pixels=20000 ;; esac
        options=(--no-pictures --threads 1 --pixels "$pixels" --measured-pixels "$measured")
        if [ -n "$quick" ]; then
            options+=(--repeats 3) truth=1024
        fi
        if [ "$points" = 16 ]; then # rays a pixel as with one point
            options+=(--points 16) truth=$((${truth:-4096} / 16)) suffix=-16$quick
        fi
        echo
        echo "=== $scene, $points point(s) a pixel"
        {
            place "$scene"
            methods "$scene" "$points"
        } >$out/"bench-$scene$suffix.toml"
        $build/tools/mtsm-compare $out/"bench-$scene$suffix.toml" "${options[@]}" \
            ${truth:+--truth "$truth"} -o $out/"bench-$scene$suffix"
    done
done
echo
python3 samples/paper/bench.py $out $quick | tee $out/bench$quick.md
echo
echo "These tables are in $out/bench$quick.md."
