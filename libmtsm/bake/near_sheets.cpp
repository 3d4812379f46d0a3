#include "bake/near_sheets.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <optional>

#include "bake/face.h"
#include "bake/near_chunks.h"
#include "bake/near_field.h"
#include "bake/near_triangles.h"
#include "base/parallel.h"
#include "raster/light_from_object.h"

namespace mtsm::bake_detail {
namespace {

constexpr std::size_t kTriangles = NearChunk::kTriangles;
constexpr std::size_t kPerTask = 1024;
constexpr double kFinestStep = 0x1p-16;  // of texture coordinates

using Coordinates = std::array<glm::dvec2, 3>;  // of a triangle's corners
/// A triangle, its coordinates, its place in the order, and its part of a chunk, the
/// points twice for a moment.
constexpr std::uint64_t kWorkOfTriangle =
    sizeof(NearTriangle) + sizeof(Coordinates) + 4 + 16 + 34 + 20;

/// All triangles with one texture.
struct Sheets {
    NearTexture texture;
    std::vector<NearTriangle> triangles;
    std::vector<Coordinates> uvs;  // [triangles], or empty: one texel
};

NearTexture plain(float opacity) {
    NearTexture texture;
    texture.opacity = opacity;
    return texture;
}

/// Nothing where three channels are not the mean of three.
std::optional<NearTexture> textureOf(const OpacityTexture& from) {
    if (!from.translucent()) return plain(1.0f);
    const OpacityImage image = from.image();
    if (image.channels > 1 && image.cutoff >= 0.0f) return std::nullopt;
    NearTexture texture;
    texture.width = image.width, texture.height = image.height;
    texture.wrapU = image.wrapU, texture.wrapV = image.wrapV;
    texture.cutoff = image.cutoff;
    texture.opacity = image.opacity;
    texture.texels.resize(std::size_t(image.width) * image.height);
    for (std::size_t i = 0; i < texture.texels.size(); ++i) {
        float sum = 0.0f;
        for (std::uint32_t c = 0; c < image.channels; ++c)
            sum += image.texels[i * image.channels + c];
        texture.texels[i] =
            std::uint8_t(std::lround(255.0f * sum / float(image.channels)));
    }
    return texture;
}

bool isSame(const NearTexture& a, const NearTexture& b) {
    return a.width == b.width && a.height == b.height && a.wrapU == b.wrapU &&
           a.wrapV == b.wrapV && a.cutoff == b.cutoff && a.opacity == b.opacity &&
           a.texels == b.texels;
}

/// Texture coordinates of places on a triangle.
class Mapping {
  public:
    Mapping(const Projection& projection, const glm::dvec3 (&light)[3],
            const Coordinates& uvs)
        : projection_(projection), first_(light[0]), uvs_(uvs) {
        const glm::dvec3 a = light[1] - light[0], b = light[2] - light[0];
        const glm::dvec3 normal = glm::cross(a, b);
        const double scale = 1.0 / glm::dot(normal, normal);
        along_[0] = glm::cross(b, normal) * scale;
        along_[1] = glm::cross(normal, a) * scale;
    }
    /// Of a corner in straight space.
    [[nodiscard]] glm::dvec2 operator()(const float (&corner)[3]) const {
        const bool perspective = projection_.kind == ProjectionKind::perspective;
        const double z = perspective ? 1.0 / corner[2] : -double(corner[2]);
        const glm::dvec3 from =
            projection_.lightFromRaster({corner[0], corner[1]}, z) - first_;
        const double p = share(glm::dot(along_[0], from));
        const double q = std::min(share(glm::dot(along_[1], from)), 1.0 - p);
        return uvs_[0] + p * (uvs_[1] - uvs_[0]) + q * (uvs_[2] - uvs_[0]);
    }

  private:
    static double share(double x) { return x > 0.0 ? std::min(x, 1.0) : 0.0; }

    const Projection& projection_;
    glm::dvec3 first_, along_[2];
    Coordinates uvs_;
};

bool isFinite(const Coordinates& uvs) {
    return std::all_of(uvs.begin(), uvs.end(), [](glm::dvec2 uv) {
        return std::isfinite(uv.x) && std::isfinite(uv.y);
    });
}

/// Where a texture repeats, the first of the same.
void reduce(const NearTexture& texture, Coordinates& uvs) {
    const TextureWrap wraps[2] = {texture.wrapU, texture.wrapV};
    for (int axis = 0; axis < 2; ++axis) {
        const double least = std::min({uvs[0][axis], uvs[1][axis], uvs[2][axis]});
        const double turns = wraps[axis] == TextureWrap::repeat ? std::floor(least) : 0.0;
        for (glm::dvec2& uv : uvs)
            uv[axis] = std::clamp(uv[axis] - turns, -1e30, 1e30);
    }
}

/// The casters' triangles, by texture; no more than so many and so many bytes.
class Collection {
  public:
    Collection(const Projection& projection, const BakeOptions& options,
               std::uint64_t most)
        : projection_(projection), options_(options), most_(most) {}

    void add(const MeshView& mesh);

    std::vector<Sheets> sheets;
    std::uint64_t triangles = 0, textureBytes = 0;
    bool hasColouredMask = false;

  private:
    Sheets& sheetsFor(const NearTexture& texture);
    void addTextured(const MeshView& mesh, const NearTexture& texture,
                     const std::vector<NearTriangle>& found,
                     const std::vector<std::uint32_t>& sources);

    const Projection& projection_;
    const BakeOptions& options_;
    std::uint64_t most_;
};

Sheets& Collection::sheetsFor(const NearTexture& texture) {
    for (Sheets& known : sheets) {
        if (isSame(known.texture, texture)) return known;
    }
    textureBytes += nearTextureBytes(texture.width, texture.height);
    return sheets.emplace_back(Sheets{texture, {}, {}});
}

void Collection::add(const MeshView& mesh) {
    if (!mesh.texture && mesh.opacity <= 0.0f) return;
    const auto texture = mesh.texture ? textureOf(*mesh.texture) : plain(mesh.opacity);
    if (!texture) {
        hasColouredMask = true;
        return;
    }
    const bool textured = texture->texels.size() > 1;
    NearTriangles found;
    found.count = triangles;
    std::vector<std::uint32_t> sources;
    collectMesh(mesh, projection_, options_, most_, found, textured ? &sources : nullptr);
    triangles = found.count;
    if (triangles > most_) return;
    if (textured) return addTextured(mesh, *texture, found.items, sources);
    std::vector<NearTriangle>& to = sheetsFor(*texture).triangles;
    to.insert(to.end(), found.items.begin(), found.items.end());
}

void Collection::addTextured(const MeshView& mesh, const NearTexture& texture,
                             const std::vector<NearTriangle>& found,
                             const std::vector<std::uint32_t>& sources) {
    const raster::LightFromObject lightFromObject(projection_, mesh.worldFromObject);
    std::vector<NearTriangle> opaque;  // without coordinates
    Sheets& to = sheetsFor(texture);
    for (std::size_t i = 0; i < found.size(); ++i) {
        glm::dvec3 light[3];
        Coordinates uvs;
        for (std::size_t c = 0; c < 3; ++c) {
            const std::uint32_t vertex = mesh.indices[3 * std::size_t(sources[i]) + c];
            light[c] = lightFromObject(mesh.positions[vertex]);
            uvs[c] = glm::dvec2(mesh.uvs[vertex]);
        }
        if (!isFinite(uvs)) {
            opaque.push_back(found[i]);
            continue;
        }
        const Mapping mapping(projection_, light, uvs);
        for (std::size_t c = 0; c < 3; ++c)
            uvs[c] = mapping(found[i].corner[c]);
        reduce(texture, uvs);
        to.triangles.push_back(found[i]);
        to.uvs.push_back(uvs);
    }
    if (opaque.empty()) return;
    std::vector<NearTriangle>& others = sheetsFor(plain(1.0f)).triangles;
    others.insert(others.end(), opaque.begin(), opaque.end());
}

/// The finest grid of powers of two on which 16 bits reach from low to high and a float
/// holds every multiple.
void setGrid(double low, double high, float& first, float& step) {
    double s = kFinestStep;
    while (std::max(std::abs(low), std::abs(high)) / s >= 0x1p24 ||
           std::floor(high / s + 0.5) - std::floor(low / s) > 65535.0)
        s *= 2.0;
    first = float(std::floor(low / s) * s);
    step = float(s);
}

/// `triangle` [16]: those of the chunk.
NearSheetChunk chunkOf(std::uint32_t texture, const Sheets& sheets,
                       const std::uint32_t* triangle) {
    NearSheetChunk chunk;
    chunk.texture = texture;
    while (chunk.triangles > 1 &&
           triangle[chunk.triangles - 2] == triangle[kTriangles - 1])
        --chunk.triangles;
    if (sheets.uvs.empty()) return chunk;
    for (int axis = 0; axis < 2; ++axis) {
        double low = HUGE_VAL, high = -HUGE_VAL;
        for (std::size_t t = 0; t < kTriangles; ++t) {
            for (const glm::dvec2 uv : sheets.uvs[triangle[t]]) {
                low = std::min(low, uv[axis]);
                high = std::max(high, uv[axis]);
            }
        }
        setGrid(low, high, chunk.low[axis], chunk.step[axis]);
        for (std::size_t t = 0; t < kTriangles; ++t) {
            for (std::size_t c = 0; c < 3; ++c) {
                const double steps =
                    (sheets.uvs[triangle[t]][c][axis] - chunk.low[axis]) /
                    chunk.step[axis];
                chunk.uv[c][axis][t] = std::uint16_t(std::floor(steps + 0.5));
            }
        }
    }
    return chunk;
}

NearSheets pack(const std::vector<Sheets>& sheets, const Projection& projection) {
    NearSheets near;
    for (const Sheets& part : sheets) {
        if (part.triangles.empty()) continue;
        NearPacking packing = packTriangles(part.triangles, projection);
        const std::size_t chunks = packing.field.chunks.size();
        const auto texture = std::uint32_t(near.textures.size());
        near.textures.push_back(part.texture);
        near.triangles.chunks.append(&packing.field.chunks, 1);
        std::vector<NearSheetChunks> tasks((chunks + kPerTask - 1) / kPerTask);
        base::parallelFor(std::size_t(0), tasks.size(), [&](std::size_t task) {
            const std::size_t end = std::min((task + 1) * kPerTask, chunks);
            for (std::size_t i = task * kPerTask; i < end; ++i)
                tasks[task].push_back(
                    chunkOf(texture, part, packing.triangle.data() + kTriangles * i));
        });
        near.chunks.append(tasks.data(), tasks.size());
    }
    return near;
}

}  // namespace

Status bakeNearSheets(Visits& visits, const BakeOptions& options, std::uint64_t bytesLeft,
                      std::vector<MapFace>& faces, BakeReport& report) {
    if (faces.size() != 1 || options.color) {
        report.noNearField =
            "only casters that are all opaque have one in a map of six faces or in "
            "colour";
        return {};
    }
    const WorkClock clock(visits);
    const std::uint64_t budget = std::min(options.nearField, bytesLeft / 4);
    const std::uint64_t most = std::min(budget /
                                            (NearChunks::memoryBytes(1, kFewestPoints) +
                                             NearSheetChunks::memoryBytes(1, 1)) *
                                            kTriangles,
                                        bytesLeft / kWorkOfTriangle);
    Collection found(faces[0].projection, options, most);
    const Status status = visits.each(meshesOnly([&](const MeshView& mesh) -> Status {
        if (auto s = visits.progress()("collecting the near field", -1.0); !s) return s;
        found.add(mesh);
        return {};
    }));
    if (!status) return status;
    report.nearTriangles = found.triangles;
    if (found.hasColouredMask) {
        report.noNearField = "only textures of one channel may have a cutoff in it";
    } else if (found.triangles > most) {
        // Chunks were not made: about one slot in 16 of them stays unused.
        const std::uint64_t slots = found.triangles + found.triangles / 16;
        report.nearBytes =
            nearSheetBytes((slots + kTriangles - 1) / kTriangles, kCardPoints) +
            found.textureBytes;
    } else {
        faces[0].nearSheets = pack(found.sheets, faces[0].projection);
        report.nearBytes = memoryBytes(faces[0].nearSheets);
    }
    if (found.triangles > most || report.nearBytes > budget) {
        report.noNearField = nearFieldTooSmall(report.nearBytes, options, budget);
        faces[0].nearSheets = {};
    }
    report.nearSeconds = clock.seconds();
    return {};
}

}  // namespace mtsm::bake_detail
