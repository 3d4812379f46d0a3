// mtsm-make-leaf-tree - writes a sample scene: a tree whose leaves are cut from cards by
// an alpha texture.
//
//     mtsm-make-leaf-tree -n 20000 -o tree.obj
//
// Writes tree.obj, tree.mtl and tree.png. The trunk forks into twigs, closed tubes of the
// object and material "wood"; on the twigs sit square cards of the object "leaves", two
// triangles each, material "leaf" with the PNG for map_Kd and map_d: a spray of five
// leaves on a stem, with holes where something has been eating. So the outline of a leaf
// is in the alpha alone. y is up, lengths are in metres. The same arguments give the same
// bytes.
#include <png.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "write_file.h"

namespace {

/// A number in [0, 1) from two, whatever the order they come in.
double random(std::uint32_t a, std::uint32_t b) {
    std::uint32_t h = a * 0x9e3779b9u + b * 0x85ebca6bu + 0x165667b1u;
    for (int i = 0; i < 2; ++i) {
        h = (h ^ h >> 15) * 0x2c1b3c6du;
        h = (h ^ h >> 12) * 0x297a2d39u;
    }
    return double(h ^ h >> 15) / 4294967296.0;
}

/// Two unit vectors across `d`, a right-handed frame with it.
void acrossOf(glm::dvec3 d, glm::dvec3& right, glm::dvec3& up) {
    const glm::dvec3 other =
        std::abs(d.y) < 0.9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0);
    right = glm::normalize(glm::cross(other, d));
    up = glm::cross(d, right);
}

// --- the tree ------------------------------------------------------------------------

struct Twig {
    glm::dvec3 from, to;
    double radiusFrom, radiusTo;
    bool bearsLeaves;
};

class Growth {
  public:
    explicit Growth(int generations) {
        grow({0, 0, 0}, {0.04, 1, 0.02}, 1.8, 0.16, generations, 1);
    }
    [[nodiscard]] const std::vector<Twig>& twigs() const { return twigs_; }

  private:
    void grow(glm::dvec3 from, glm::dvec3 direction, double length, double radius,
              int generations, std::uint32_t seed) {
        const glm::dvec3 to = from + length * glm::normalize(direction);
        const double thinner = radius * 0.72;
        twigs_.push_back({from, to, radius, thinner, generations <= 1});
        if (generations == 0) return;
        glm::dvec3 right, up;
        acrossOf(glm::normalize(direction), right, up);
        const std::uint32_t forks = 3;
        for (std::uint32_t k = 0; k < forks; ++k) {
            const std::uint32_t child = seed * forks + k + 1;
            const double turn =
                glm::two_pi<double>() * (k + 0.7 * random(child, 1)) / forks;
            const double open = 0.5 + 0.35 * random(child, 2);
            const glm::dvec3 heading =
                std::cos(open) * glm::normalize(direction) +
                std::sin(open) * (std::cos(turn) * right + std::sin(turn) * up) +
                glm::dvec3(0, 0.12, 0);
            grow(to, heading, length * (0.62 + 0.16 * random(child, 3)), thinner,
                 generations - 1, child);
        }
    }
    std::vector<Twig> twigs_;
};

// --- the file: OBJ and MTL -----------------------------------------------------------

class Obj {
  public:
    explicit Obj(const std::string& mtl)
        : text_("# mtsm-make-leaf-tree\nmtllib " + mtl + "\n") {}
    void object(const std::string& name, const std::string& material) {
        text_ += "o " + name + "\nusemtl " + material + "\n";
    }
    std::uint32_t vertex(glm::dvec3 p) {
        line("v %.6g %.6g %.6g\n", p.x, p.y, p.z);
        return ++vertices_;
    }
    void coordinate(glm::dvec2 uv) { line("vt %.6g %.6g\n", uv.x, uv.y); }
    void triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
        line("f %u %u %u\n", a, b, c);
        ++triangles_;
    }
    /// With texture coordinates 1 to 4 at the corners of the card.
    void card(std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
        line("f %u/1 %u/2 %u/3\n", a, b, c);
        line("f %u/1 %u/3 %u/4\n", a, c, d);
        triangles_ += 2;
    }
    [[nodiscard]] const std::string& text() const { return text_; }
    [[nodiscard]] std::uint64_t triangles() const { return triangles_; }

  private:
    template <typename... Numbers>
    void line(const char* format, Numbers... numbers) {
        char buffer[128];
        std::snprintf(buffer, sizeof(buffer), format, numbers...);
        text_ += buffer;
    }
    std::string text_;
    std::uint32_t vertices_ = 0;
    std::uint64_t triangles_ = 0;
};

/// A closed tube of a few sides.
void addTwig(Obj& obj, const Twig& twig) {
    const std::uint32_t sides = twig.radiusFrom > 0.05 ? 12 : 5;
    glm::dvec3 right, up;
    acrossOf(glm::normalize(twig.to - twig.from), right, up);
    std::uint32_t first = 0;
    for (const bool end : {false, true})
        for (std::uint32_t k = 0; k < sides; ++k) {
            const double turn = glm::two_pi<double>() * k / sides;
            const double radius = end ? twig.radiusTo : twig.radiusFrom;
            const std::uint32_t v =
                obj.vertex((end ? twig.to : twig.from) +
                           radius * (std::cos(turn) * right + std::sin(turn) * up));
            if (first == 0) first = v;
        }
    for (std::uint32_t k = 0; k < sides; ++k) {
        const std::uint32_t a = first + k, b = first + (k + 1) % sides;
        obj.triangle(a, b, b + sides);
        obj.triangle(a, b + sides, a + sides);
        if (k > 1) {
            obj.triangle(first, a, a - 1);
            obj.triangle(first + sides, a - 1 + sides, a + sides);
        }
    }
}

/// A card whose lower edge sits on the twig and that points away from it, hanging.
void addCard(Obj& obj, const Twig& twig, std::uint32_t seed) {
    const glm::dvec3 along = glm::normalize(twig.to - twig.from);
    glm::dvec3 right, up;
    acrossOf(along, right, up);
    const double turn = glm::two_pi<double>() * random(seed, 11);
    const glm::dvec3 out = std::cos(turn) * right + std::sin(turn) * up;
    const glm::dvec3 tip =
        glm::normalize(out + 0.5 * along - glm::dvec3(0, 0.5 * random(seed, 12), 0));
    const glm::dvec3 wide = glm::normalize(
        glm::cross(tip, out + glm::dvec3(random(seed, 13), random(seed, 14), 0.3)));
    const double size = 0.16 * (0.7 + 0.6 * random(seed, 15));
    const glm::dvec3 foot = glm::mix(twig.from, twig.to, random(seed, 16));
    const glm::dvec3 half = 0.5 * size * wide;
    const std::uint32_t a = obj.vertex(foot - half), b = obj.vertex(foot + half);
    const std::uint32_t c = obj.vertex(foot + half + size * tip);
    obj.card(a, b, c, obj.vertex(foot - half + size * tip));
}

std::string makeObj(std::uint32_t cards, const std::string& mtl,
                    std::uint64_t& triangles) {
    // About ten cards to a twig.
    int generations = 3;
    while (generations < 9 && 12.0 * std::pow(3.0, generations) < double(cards))
        ++generations;
    const Growth growth(generations);
    std::vector<Twig> bearing;
    Obj obj(mtl);
    obj.object("wood", "wood");
    for (const Twig& twig : growth.twigs()) {
        addTwig(obj, twig);
        if (twig.bearsLeaves) bearing.push_back(twig);
    }
    obj.object("leaves", "leaf");
    for (const glm::dvec2 corner :
         {glm::dvec2(0, 0), glm::dvec2(1, 0), glm::dvec2(1, 1), glm::dvec2(0, 1)})
        obj.coordinate(corner);
    for (std::uint32_t i = 0; i < cards; ++i)
        addCard(obj, bearing[i % bearing.size()], i);
    triangles = obj.triangles();
    return obj.text();
}

// --- the texture -----------------------------------------------------------------------

/// How far p is from the segment a b, and how far along it, 0 to 1.
double distance(glm::dvec2 p, glm::dvec2 a, glm::dvec2 b, double& along) {
    along = std::clamp(glm::dot(p - a, b - a) / glm::dot(b - a, b - a), 0.0, 1.0);
    return glm::length(p - glm::mix(a, b, along));
}

struct Leaf {
    glm::dvec2 foot, tip;
    double width;  // of half of it
};

const Leaf kLeaves[] = {{{0.50, 0.55}, {0.50, 0.97}, 0.10},
                        {{0.50, 0.48}, {0.88, 0.80}, 0.09},
                        {{0.50, 0.46}, {0.12, 0.78}, 0.09},
                        {{0.50, 0.26}, {0.92, 0.42}, 0.10},
                        {{0.50, 0.24}, {0.08, 0.40}, 0.10}};
/// Holes: centre and radius.
const glm::dvec3 kHoles[] = {
    {0.50, 0.78, 0.035}, {0.72, 0.66, 0.025}, {0.27, 0.65, 0.03}, {0.76, 0.35, 0.03}};

/// The point is leaf or stem; v up.
bool isLeaf(glm::dvec2 p) {
    for (const glm::dvec3& hole : kHoles)
        if (glm::length(p - glm::dvec2(hole)) < hole.z) return false;
    double along = 0;
    if (distance(p, {0.5, 0.0}, {0.5, 0.6}, along) < 0.012) return true;
    for (const Leaf& leaf : kLeaves) {
        const double off = distance(p, leaf.foot, leaf.tip, along);
        const double outline =
            leaf.width * std::pow(std::sin(glm::pi<double>() * along), 0.8);
        if (along > 0 && along < 1 && off < outline * (1 + 0.06 * std::sin(60 * along)))
            return true;
    }
    return false;
}

/// [size][size][4], alpha from 4 x 4 points a texel.
std::vector<std::uint8_t> drawLeaves(std::uint32_t size) {
    std::vector<std::uint8_t> pixels;
    pixels.reserve(std::size_t(4) * size * size);
    constexpr int kPoints = 4;
    for (std::uint32_t y = 0; y < size; ++y)
        for (std::uint32_t x = 0; x < size; ++x) {
            int inside = 0;
            for (int k = 0; k < kPoints * kPoints; ++k) {
                const double u = (x + (k % kPoints + 0.5) / kPoints) / size;
                const double v = 1 - (y + (k / kPoints + 0.5) / kPoints) / size;
                inside += isLeaf({u, v});
            }
            const double shade = 0.8 + 0.2 * std::sin(40.0 * (x + y) / size);
            pixels.push_back(std::uint8_t(70 * shade));
            pixels.push_back(std::uint8_t(130 * shade));
            pixels.push_back(std::uint8_t(40 * shade));
            pixels.push_back(std::uint8_t(inside * 255 / (kPoints * kPoints)));
        }
    return pixels;
}

std::string encodePng(std::uint32_t size, const std::vector<std::uint8_t>& pixels) {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    image.width = image.height = size;
    image.format = PNG_FORMAT_RGBA;
    png_alloc_size_t bytes = PNG_IMAGE_PNG_SIZE_MAX(image);
    std::string file(bytes, '\0');
    if (!png_image_write_to_memory(&image, file.data(), &bytes, 0, pixels.data(), 0,
                                   nullptr))
        return {};
    file.resize(bytes);
    return file;
}

}  // namespace

int main(int argc, char** argv) {
    std::uint32_t cards = 20000, size = 512;
    std::string output = "tree.obj";
    CLI::App app{
        "Writes a sample scene: a tree about 6 metres high, its foot at the origin, "
        "with\n"
        "leaves cut from cards by an alpha texture. Objects \"wood\" and \"leaves\" in "
        "an\n"
        "OBJ file, with a .mtl and a .png of the same name beside it.",
        "mtsm-make-leaf-tree"};
    app.add_option("-n,--cards", cards, "Leaf cards, two triangles each")
        ->check(CLI::Range(1, 10'000'000))
        ->capture_default_str();
    app.add_option("-t,--texture-size", size, "Pixels along each side of the texture")
        ->check(CLI::Range(16, 8192))
        ->capture_default_str();
    app.add_option("-o,--output", output, "File to write, .obj")
        ->check([](const std::string& path) { return checkEnding(path, {".obj"}); })
        ->capture_default_str();
    app.footer(
        "Examples:\n  mtsm-make-leaf-tree\n"
        "  mtsm-make-leaf-tree -n 500 -t 64 -o small.obj\n\n"
        "Exit codes: 0 good, 2 usage, 3 a file cannot be written.");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& e) {
        return app.exit(e) == 0 ? 0 : 2;
    }

    const std::filesystem::path obj(output);
    const auto beside = [&](const char* extension) {
        return std::filesystem::path(obj).replace_extension(extension);
    };
    const std::filesystem::path mtl = beside(".mtl"), png = beside(".png");
    const std::string image = png.filename().string();
    std::uint64_t triangles = 0;
    const std::pair<std::filesystem::path, std::string> files[] = {
        {png, encodePng(size, drawLeaves(size))},
        {mtl,
         "# mtsm-make-leaf-tree\nnewmtl wood\nKd 0.25 0.18 0.12\n\nnewmtl leaf\n"
         "Kd 1 1 1\nmap_Kd " +
             image + "\nmap_d " + image + "\n"},
        {obj, makeObj(cards, mtl.filename().string(), triangles)}};
    for (const auto& [path, bytes] : files) {
        const std::string problem = writeFile(path.string(), bytes);
        if (problem.empty()) continue;
        std::fprintf(stderr, "mtsm-make-leaf-tree: %s: cannot be written: %s\n",
                     path.c_str(), problem.c_str());
        return 3;
    }
    std::fprintf(stderr, "%s: tree of %llu triangles, %u leaf cards among them; %s, %s\n",
                 obj.c_str(), static_cast<unsigned long long>(triangles), cards,
                 mtl.c_str(), png.c_str());
    return 0;
}
