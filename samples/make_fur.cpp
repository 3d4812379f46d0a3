// mtsm-make-fur - writes a sample scene: a ball of fur, as a .hair file.
//
//     mtsm-make-fur -n 4500000 -o fur.hair
//
// The skin is a sphere of radius 1 about the origin (it is not in the file); y is up. The
// hairs are curved, hang down a little, gather in clumps and taper from root to tip. The
// file is written as it is made, so that any size takes the same memory. The same
// arguments give the same hairs.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "write_file.h"

namespace {

constexpr std::uint32_t kSegments = 16;  // per hair
constexpr double kLength = 0.25;         // of a hair, about

struct Fur {
    std::uint64_t hairs = 0;
    std::uint64_t seed = 0;
    float opacity = 0, width = 0, tipWidth = 0;
};

/// Numbers in [0, 1) that depend on nothing but the seed and the hair (SplitMix64).
class Random {
  public:
    Random(std::uint64_t seed, std::uint64_t hair)
        : state_(seed * 0xd1342543de82ef95u + hair * 0x9e3779b97f4a7c15u) {}
    double unit() {
        std::uint64_t z = state_ += 0x9e3779b97f4a7c15u;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
        return double((z ^ (z >> 31)) >> 11) * 0x1p-53;
    }
    double around0() { return 2.0 * unit() - 1.0; }

  private:
    std::uint64_t state_;
};

/// Where neighbouring hairs lean to: up the slope of smooth bumps, so that tips gather
/// on their crests.
glm::dvec3 clump(glm::dvec3 p) {
    constexpr int kWaves = 5;
    constexpr double kFrequency = 40.0;
    glm::dvec3 slope(0.0);
    for (int i = 0; i < kWaves; ++i) {
        const double y = 1.0 - 2.0 * (i + 0.5) / kWaves, flat = std::sqrt(1.0 - y * y);
        const double turn = 2.399963229728653 * (i + 1);
        const glm::dvec3 wave(flat * std::cos(turn), y, flat * std::sin(turn));
        slope += wave * std::cos(kFrequency * glm::dot(wave, p) + 1.7 * i);
    }
    return slope / double(kWaves);
}

/// The points of one hair, root first.
void makeHair(const Fur& fur, std::uint64_t hair, std::vector<glm::vec3>& out) {
    Random random(fur.seed, hair);
    // Roots: a spiral of golden angles, which spreads evenly, a little shaken.
    const double y = 1.0 - 2.0 * (double(hair) + random.unit()) / double(fur.hairs);
    const double turn =
        glm::two_pi<double>() *
        std::fmod(0.6180339887498949 * double(hair) + 0.1 * random.unit(), 1.0);
    const double flat = std::sqrt(std::max(0.0, 1.0 - y * y));
    const glm::dvec3 root(flat * std::cos(turn), y, flat * std::sin(turn));

    const double length = kLength * (0.8 + 0.4 * random.unit());
    const glm::dvec3 stray(random.around0(), random.around0(), random.around0());
    glm::dvec3 lean = 0.8 * clump(root) + 0.25 * stray + glm::dvec3(0.0, -0.35, 0.0);
    lean -= 0.7 * glm::dot(lean, root) * root;
    const glm::dvec3 curl = 0.04 * glm::cross(root, stray);
    const double phase = glm::two_pi<double>() * random.unit();
    for (std::uint32_t i = 0; i <= kSegments; ++i) {
        const double t = double(i) / kSegments;
        const double wave = std::sin(7.0 * t + phase) - std::sin(phase);
        const glm::dvec3 way =
            t * (1.0 - 0.2 * t) * root + t * t * lean + t * wave * curl;
        out.emplace_back(root + length * way);
    }
}

// --- the file: Cem Yuksel's .hair ------------------------------------------------------

class File {
  public:
    explicit File(const std::string& path)
        : path_(path), file_(std::fopen(path.c_str(), "wb")) {
        if (!file_) reason_ = errno;
    }
    void write(const void* bytes, std::size_t count) {
        if (reason_ != 0) return;
        errno = 0;
        if (std::fwrite(bytes, 1, count, file_) != count) reason_ = errno ? errno : EIO;
    }
    [[nodiscard]] bool failed() const { return reason_ != 0; }
    /// Empty, or the reason why it could not be written; then no part of it stays.
    std::string close() {
        if (!file_) return std::strerror(reason_);
        if (std::fclose(file_) != 0 && reason_ == 0) reason_ = errno;
        if (reason_ == 0) return {};
        std::error_code ignored;
        if (std::filesystem::is_regular_file(path_, ignored))
            std::filesystem::remove(path_, ignored);
        return std::strerror(reason_);
    }

  private:
    std::string path_;
    std::FILE* file_;
    int reason_ = 0;
};

void put(std::vector<std::uint8_t>& out, std::uint32_t value) {
    for (int shift = 0; shift < 32; shift += 8)
        out.push_back(std::uint8_t(value >> shift));
}

void put(std::vector<std::uint8_t>& out, float value) {
    std::uint32_t bits = 0;
    std::memcpy(&bits, &value, sizeof(bits));
    put(out, bits);
}

std::vector<std::uint8_t> encodeHeader(const Fur& fur) {
    constexpr std::uint32_t kPointsAndThickness = 2 | 4;
    std::vector<std::uint8_t> header{'H', 'A', 'I', 'R'};
    put(header, std::uint32_t(fur.hairs));
    put(header, std::uint32_t(fur.hairs * (kSegments + 1)));
    put(header, kPointsAndThickness);
    put(header, kSegments);
    put(header, fur.width);
    put(header, 1.0f - fur.opacity);
    for (const float colour : {0.45f, 0.32f, 0.2f})
        put(header, colour);
    const std::string about = "mtsm-make-fur: a ball of fur around a sphere of radius 1";
    header.insert(header.end(), about.begin(), about.end());
    header.resize(128);
    return header;
}

/// Points, then thickness: some thousand hairs at a time.
std::string writeFur(const std::string& path, const Fur& fur) {
    constexpr std::uint64_t kAtOnce = 4096;
    File file(path);
    const std::vector<std::uint8_t> header = encodeHeader(fur);
    file.write(header.data(), header.size());
    std::vector<glm::vec3> points;
    std::vector<std::uint8_t> bytes;
    for (std::uint64_t first = 0; first < fur.hairs && !file.failed(); first += kAtOnce) {
        points.clear();
        bytes.clear();
        for (std::uint64_t h = first; h < std::min(fur.hairs, first + kAtOnce); ++h)
            makeHair(fur, h, points);
        for (const glm::vec3& p : points)
            for (int axis = 0; axis < 3; ++axis)
                put(bytes, p[axis]);
        file.write(bytes.data(), bytes.size());
    }
    bytes.clear();
    for (std::uint32_t i = 0; i <= kSegments; ++i)
        put(bytes, glm::mix(fur.width, fur.tipWidth, float(i) / kSegments));
    for (std::uint64_t h = 0; h < fur.hairs && !file.failed(); ++h)
        file.write(bytes.data(), bytes.size());
    return file.close();
}

}  // namespace

int main(int argc, char** argv) {
    std::uint64_t triangles = 4'500'000;
    Fur fur;
    fur.opacity = 0.4f;
    fur.width = 0.003f;
    fur.tipWidth = 0.0006f;
    std::string output = "fur.hair";
    CLI::App app{
        "Writes a ball of fur as a .hair file: hairs about 0.25 long on a sphere of\n"
        "radius 1 about the origin, 16 segments each. The sphere is not in the file.",
        "mtsm-make-fur"};
    app.add_option("-n,--triangles", triangles,
                   "Size, as triangles at two per segment; the nearest number of whole\n"
                   "hairs is made, at 32 triangles each")
        ->check(CLI::Range(std::uint64_t(32), std::uint64_t(4'000'000'000)))
        ->capture_default_str();
    app.add_option("-o,--output", output, "File to write, .hair")
        ->check([](const std::string& path) { return checkEnding(path, {".hair"}); })
        ->capture_default_str();
    app.add_option("--opacity", fur.opacity,
                   "Part of the light that a hair stops, 0 to 1")
        ->check(CLI::Range(0.0, 1.0))
        ->capture_default_str();
    app.add_option("--width", fur.width,
                   "Width of a hair at its root, in the units of the sphere")
        ->check(CLI::Range(0.0, 1.0))
        ->capture_default_str();
    app.add_option("--tip-width", fur.tipWidth, "Width of a hair at its tip, likewise")
        ->check(CLI::Range(0.0, 1.0))
        ->capture_default_str();
    app.add_option("--seed", fur.seed, "Other hairs for other numbers")
        ->capture_default_str();
    app.footer(
        "Examples:\n  mtsm-make-fur\n  mtsm-make-fur -n 109000000 -o giant.hair\n\n"
        "Exit codes: 0 good, 2 usage, 3 the file cannot be written.");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& e) {
        return app.exit(e) == 0 ? 0 : 2;
    }

    fur.hairs = (triangles + kSegments) / (2 * kSegments);
    const std::string problem = writeFur(output, fur);
    if (!problem.empty()) {
        std::fprintf(stderr, "mtsm-make-fur: %s: cannot be written: %s\n", output.c_str(),
                     problem.c_str());
        return 3;
    }
    std::fprintf(stderr,
                 "%s: %llu hairs of %u segments, as much as %llu triangles; opacity %g, "
                 "width %g to %g\n",
                 output.c_str(), static_cast<unsigned long long>(fur.hairs), kSegments,
                 static_cast<unsigned long long>(fur.hairs * 2 * kSegments),
                 double(fur.opacity), double(fur.width), double(fur.tipWidth));
    return 0;
}
