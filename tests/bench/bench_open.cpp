// bench_open - how soon a map answers: from its file's name to the first shadow factor,
// as it is, with trees in the file, and from those alone.
//
//     bench_open MAP.mtsm...
//
// Files are read from the system's cache. Medians of nine rounds in which all three take
// turns, milliseconds of one thread and of all.
#include <tbb/global_control.h>
#include <tbb/info.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <vector>

#include "mtsm/reader.h"
#include "mtsm/shadow.h"
#include "mtsm/writer.h"

namespace {

using namespace mtsm;
namespace fs = std::filesystem;

constexpr int kRounds = 9;

int complain(const Error& error) {
    std::fprintf(stderr, "bench_open: %s\n", error.message.c_str());
    return exitCode(error.code);
}

/// Milliseconds; below 0 if it cannot be read.
double open(const std::string& path, bool layers) {
    using Clock = std::chrono::steady_clock;
    const auto start = Clock::now();
    ReadLimits limits;
    limits.layers = layers;
    const auto map = readMap(path, limits);
    if (!map) {
        complain(map.error());
        return -1.0;
    }
    const Projection& p = map->projection(0);
    const double depth = map->zRange(0).empty() ? 1.0 : map->zRange(0).max;
    volatile float factor = shadowFactor(
        *map, map->info().light,
        p.worldFromLight(p.lightFromRaster(p.offset, 1.01 * depth)), glm::dvec3(0.0), {});
    (void)factor;
    return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

int measure(const std::string& path) {
    const auto map = readMap(path);
    if (!map) return complain(map.error());
    const std::string withTrees =
        (fs::temp_directory_path() / "mtsm_bench_open.mtsm").string();
    WriteOptions options;
    options.trees = true;
    if (auto s = writeMap(*map, withTrees, options); !s) return complain(s.error());
    std::printf("%-28s %8.2f MB, with trees %8.2f MB\n",
                fs::path(path).filename().c_str(), double(fs::file_size(path)) * 1e-6,
                double(fs::file_size(withTrees)) * 1e-6);
    for (const int threads : {1, tbb::info::default_concurrency()}) {
        const tbb::global_control control(tbb::global_control::max_allowed_parallelism,
                                          std::size_t(threads));
        std::vector<double> times[3];
        for (int round = 0; round < kRounds; ++round) {
            times[0].push_back(open(path, true));
            times[1].push_back(open(withTrees, true));
            times[2].push_back(open(withTrees, false));
        }
        for (auto& t : times)
            std::nth_element(t.begin(), t.begin() + kRounds / 2, t.end());
        const auto median = [&](int i) { return times[i][kRounds / 2]; };
        std::printf(
            "  %2d thread(s): %8.1f ms; trees read %8.1f; trees alone %8.1f, "
            "%.1f times as soon\n",
            threads, median(0), median(1), median(2), median(0) / median(2));
    }
    fs::remove(withTrees);
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    if (argc < 2) {
        std::fprintf(stderr, "usage: bench_open MAP.mtsm...\n");
        return 2;
    }
    for (int i = 1; i < argc; ++i) {
        if (const int code = measure(argv[i]); code != 0) return code;
    }
    return 0;
}
