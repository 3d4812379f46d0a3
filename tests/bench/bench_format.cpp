// bench_format - how fast maps are written and read, and how many bytes a layer takes.
#include <benchmark/benchmark.h>

#include <filesystem>
#include <string>
#include <vector>

#include "bumpy_mesh.h"
#include "format/tile_decode.h"
#include "format/tile_encode.h"
#include "mtsm/bake.h"
#include "mtsm/reader.h"
#include "mtsm/writer.h"

namespace {

using namespace mtsm;

const ShadowMap& map() {
    static const ShadowMap baked = [] {
        const test::Mesh body = test::bumpyBody(350'000);
        CasterViews casters({body.view()});
        BakeOptions options;
        options.light.shape = LightShape::disk;
        options.light.position = {2, 5, 2.5};
        options.light.radius = 0.5;
        options.width = options.height = 2048;
        auto result = bake(casters, options);
        if (!result) throw std::runtime_error(result.error().message);
        return std::move(result->map);
    }();
    return baked;
}

WriteOptions optionsFor(const benchmark::State& state) {
    WriteOptions options;
    options.codec = state.range(0) == 0 ? Codec::none : Codec::zstd;
    options.level = state.range(0) == 0 ? 1 : int(state.range(0));
    return options;
}

std::string scratchFile() {
    return (std::filesystem::temp_directory_path() / "mtsm_bench_format.mtsm").string();
}

void report(benchmark::State& state, std::uint64_t fileBytes) {
    const auto layers = double(map().layerCount());
    // GB of layers (4 bytes of depth each), not of file.
    state.SetBytesProcessed(std::int64_t(double(state.iterations()) * 4.0 * layers));
    state.counters["bytes/layer"] = double(fileBytes) / layers;
    state.counters["file bytes"] = double(fileBytes);
}

void writeFile(benchmark::State& state) {
    const std::string path = scratchFile();
    for (auto _ : state) {
        if (!writeMap(map(), path, optionsFor(state)))
            state.SkipWithError("cannot write");
    }
    report(state, std::filesystem::file_size(path));
    std::filesystem::remove(path);
}

void readFile(benchmark::State& state) {
    const std::string path = scratchFile();
    if (!writeMap(map(), path, optionsFor(state))) state.SkipWithError("cannot write");
    for (auto _ : state) {
        auto read = readMap(path);
        if (!read) state.SkipWithError("cannot read");
        benchmark::DoNotOptimize(read);
    }
    report(state, std::filesystem::file_size(path));
    std::filesystem::remove(path);
}

/// Tiles alone, on one core, without what reading a file has to do besides.
void decodeTiles(benchmark::State& state) {
    const ShadowMap& m = map();
    format::TileEncoder encoder(Codec::zstd, int(state.range(0)));
    std::vector<format::Bytes> payloads;
    std::vector<format::TileFacts> facts;
    std::uint64_t bytes = 0;
    for (std::uint32_t ty = 0; ty < m.tilesY(); ++ty) {
        for (std::uint32_t tx = 0; tx < m.tilesX(); ++tx) {
            const Tile& tile = m.tile(0, tx, ty);
            if (tile.empty()) continue;
            const format::TilePlace place{0, tx, ty, m.tileWidth(tx), m.tileHeight(ty)};
            payloads.push_back(encoder.encode(tile, place, 1));
            facts.push_back(
                {place, 1, std::uint32_t(tile.z.size()), format::planesNeeded(tile)});
            bytes += payloads.back().size();
        }
    }
    format::TileDecoder decoder;
    for (auto _ : state) {
        for (std::size_t i = 0; i < payloads.size(); ++i) {
            auto tile = decoder.decode(payloads[i], facts[i]);
            if (!tile) state.SkipWithError("cannot decode");
            benchmark::DoNotOptimize(tile);
        }
    }
    report(state, bytes);
}

}  // namespace

// The argument is zstd's level; 0 writes every plane raw.
BENCHMARK(writeFile)
    ->ArgName("zstd")
    ->Arg(0)
    ->Arg(1)
    ->Arg(3)
    ->Arg(9)
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(readFile)->ArgName("zstd")->Arg(0)->Arg(1)->Arg(3)->Arg(9)->UseRealTime()->Unit(
    benchmark::kMillisecond);
BENCHMARK(decodeTiles)->ArgName("zstd")->Arg(1)->Arg(3)->Unit(benchmark::kMillisecond);
