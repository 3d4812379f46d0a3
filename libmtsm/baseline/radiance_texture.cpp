#include "baseline/radiance_texture.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <memory>
#include <new>

#include "base/finite.h"
#include "base/message.h"
#include "base/parallel.h"

namespace mtsm::baseline {
namespace {

constexpr std::size_t kMostTexels = std::size_t(1) << 28;     // of one texture
constexpr std::uint64_t kMostBytes = std::uint64_t(1) << 35;  // of all textures
constexpr std::size_t kMostImages = 16;  // hard shadows in memory at once, per receiver
constexpr std::size_t kImageTexels = std::size_t(1) << 25;  // in all of them
constexpr int kMostSupersampling = 16;
constexpr int kReceiverProbes = 8;  // along a side, for the solid angle

glm::dvec3 pointAt(const PlanarReceiver& plane, double u, double v) {
    return plane.corner + u * plane.edgeX + v * plane.edgeY;
}

glm::dvec3 unitNormal(const PlanarReceiver& plane) {
    return glm::normalize(glm::cross(plane.edgeX, plane.edgeY));
}

std::array<glm::dvec3, 4> cornersOf(const PlanarReceiver& plane) {
    return {pointAt(plane, 0, 0), pointAt(plane, 1, 0), pointAt(plane, 0, 1),
            pointAt(plane, 1, 1)};
}

/// The grid's side for this light as this receiver sees it.
int gridSide(const AreaLight& light, const PlanarReceiver& plane,
             const RadianceOptions& options) {
    if (!(options.solidAngle > 0.0)) return options.samplesPerSide;
    double most = 0.0;
    for (int j = 0; j <= kReceiverProbes; ++j)
        for (int i = 0; i <= kReceiverProbes; ++i)
            most = std::max(
                most, densestAngle(light, pointAt(plane, double(i) / kReceiverProbes,
                                                  double(j) / kReceiverProbes)));
    if (most == 0.0) return options.samplesPerSide;
    return int(std::clamp(std::ceil(std::sqrt(most / options.solidAngle)), 1.0,
                          double(kMaxGridSide)));
}

/// What a light has given a receiver so far.
struct LightSums {
    std::vector<LightPoint> points;
    double measure = 1.0;  // of one point
    bool sun = false;
    bool partly = false;  // some points shine to some texels only
    /// First back-face test: the light lies behind the receiver or the receiver behind
    /// the light, and nothing has to be drawn.
    bool apart = false;
    int done = 0;                // points
    std::vector<float> visible;  // [texels], sums
    std::vector<float> facing;   // [texels] if partly: points that shine to the texel
    /// [texels], by a light of radiance 1; empty: not asked for.
    std::vector<float> radiance;

    [[nodiscard]] int wanted() const { return apart ? 0 : int(points.size()); }
};

/// A receiver's texture in the making.
class Work {
  public:
    Work(const RadianceReceiver& receiver, const std::vector<RadianceLight>& lights,
         const RadianceOptions& options)
        : receiver_(receiver),
          lights_(lights),
          options_(options),
          normal_(unitNormal(receiver.plane)),
          size_(textureSize(receiver, options)),
          fine_(size_ * std::uint32_t(options.supersampling)) {
        for (const RadianceLight& light : lights)
            sums_.push_back(begin(light.light, std::uint32_t(sums_.size())));
    }

    /// True once all points of all lights have had their turn.
    bool advance(const ShadowCasters& casters, int samples) {
        bool complete = true;
        for (LightSums& light : sums_) {
            advance(casters, light, std::min(samples, light.wanted()));
            complete = complete && light.done == light.wanted();
        }
        return complete;
    }

    [[nodiscard]] RadianceTexture texture() const;

  private:
    [[nodiscard]] LightSums begin(const AreaLight& light, std::uint32_t index) const;
    /// Above the receiver; of a sun the sine of its elevation.
    [[nodiscard]] double height(const LightPoint& point, bool sun) const {
        return glm::dot(normal_,
                        sun ? point.position : point.position - receiver_.plane.corner);
    }
    void advance(const ShadowCasters& casters, LightSums& light, int end);
    void add(LightSums& light, const LightPoint& point, const float* reaches,
             std::uint32_t row) const;
    void addAway(LightSums& light, const LightPoint& point, std::uint32_t row) const;
    [[nodiscard]] glm::dvec3 texel(std::uint32_t x, std::uint32_t y) const {
        return pointAt(receiver_.plane, (x + 0.5) / fine_.x, (y + 0.5) / fine_.y);
    }
    [[nodiscard]] float visibility(const LightSums& light, std::size_t at) const;
    [[nodiscard]] glm::vec3 radiance(std::size_t at) const;
    [[nodiscard]] Flatness flatness(const RadianceTexture& texture) const;

    const RadianceReceiver& receiver_;
    const std::vector<RadianceLight>& lights_;
    const RadianceOptions& options_;
    const glm::dvec3 normal_;
    const glm::uvec2 size_, fine_;
    std::vector<LightSums> sums_;
    std::uint64_t looked_ = 0;
};

LightSums Work::begin(const AreaLight& light, std::uint32_t index) const {
    LightSums sums;
    const PlanarReceiver& plane = receiver_.plane;
    sums.points = lightPoints(light, gridSide(light, plane, options_), options_.grid,
                              options_.seed + index);
    sums.measure = lightMeasure(light) / double(sums.points.size());
    sums.sun = light.shape == LightShape::sun;
    const auto corners = cornersOf(plane);
    const auto shinesTo = [&](const LightPoint& point) {
        return [&](glm::dvec3 p) { return sums.sun || point.faces(p); };
    };
    bool apart = true;
    for (const LightPoint& point : sums.points) {
        if (!std::all_of(corners.begin(), corners.end(), shinesTo(point)))
            sums.partly = true;
        if (height(point, sums.sun) > 0.0 &&
            std::any_of(corners.begin(), corners.end(), shinesTo(point)))
            apart = false;
    }
    sums.apart = apart;
    if (apart) return sums;
    const std::size_t texels = std::size_t(fine_.x) * fine_.y;
    sums.visible.resize(texels);
    if (sums.partly) sums.facing.resize(texels);
    if (options_.radiance) sums.radiance.resize(texels);
    return sums;
}

/// Hard shadow images are drawn side by side and added one after another.
void Work::advance(const ShadowCasters& casters, LightSums& light, int end) {
    const std::size_t texels = std::size_t(fine_.x) * fine_.y;
    const std::size_t atOnce =
        std::clamp(kImageTexels / texels, std::size_t(1), kMostImages);
    std::vector<std::vector<float>> images(
        std::min(atOnce, std::size_t(end - light.done)));
    std::vector<std::uint64_t> looked(images.size());
    while (light.done < end) {
        const auto first = std::size_t(light.done);
        const std::size_t count = std::min(images.size(), std::size_t(end) - first);
        const auto inFront = [&](std::size_t i) {
            return height(light.points[first + i], light.sun) > 0.0;
        };
        base::parallelFor(std::size_t(0), count, [&](std::size_t i) {
            // Second back-face test.
            if (!inFront(i)) return;
            images[i].resize(texels);
            looked[i] += casters.draw(
                shadowView(light.points[first + i], receiver_.plane, light.sun), fine_.x,
                fine_.y, options_.cull, images[i].data());
        });
        base::parallelRanges(
            0u, fine_.y, 16u, [&](std::uint32_t beginRow, std::uint32_t endRow) {
                for (std::size_t i = 0; i < count; ++i) {
                    const LightPoint& point = light.points[first + i];
                    for (std::uint32_t row = beginRow; row < endRow; ++row) {
                        if (inFront(i))
                            add(light, point, images[i].data(), row);
                        else if (light.partly)
                            addAway(light, point, row);
                    }
                }
            });
        light.done += int(count);
    }
    for (const std::uint64_t count : looked)
        looked_ += count;
}

/// A row of a hard shadow image, shaded [Heckbert97, eq. 2].
void Work::add(LightSums& light, const LightPoint& point, const float* reaches,
               std::uint32_t row) const {
    const double above = height(point, light.sun);
    const bool directed = !light.sun && point.normal != glm::dvec3(0.0);
    const std::size_t start = std::size_t(row) * fine_.x;
    const glm::dvec3 from = texel(0, row) - point.position,
                     step = receiver_.plane.edgeX / double(fine_.x);
    for (std::uint32_t x = 0; x < fine_.x; ++x) {
        const std::size_t at = start + x;
        const glm::dvec3 d = from + double(x) * step;
        // r cos' and r cos; the latter is the same for all texels.
        const double atLight = directed ? glm::dot(point.normal, d) : 1.0;
        if (!(atLight > 0.0)) continue;
        light.visible[at] += reaches[at];
        if (light.partly) light.facing[at] += 1.0f;
        if (light.radiance.empty()) continue;
        double weight = above;
        if (!light.sun) {
            const double r2 = glm::dot(d, d);
            weight *= directed ? atLight / (r2 * r2) : 1.0 / (r2 * std::sqrt(r2));
        }
        light.radiance[at] +=
            float(weight * light.measure * glm::one_over_pi<double>()) * reaches[at];
    }
}

/// A row for a point below the receiver's horizon: it is blocked where it shines to.
void Work::addAway(LightSums& light, const LightPoint& point, std::uint32_t row) const {
    for (std::uint32_t x = 0; x < fine_.x; ++x)
        if (point.faces(texel(x, row)))
            light.facing[std::size_t(row) * fine_.x + x] += 1.0f;
}

float Work::visibility(const LightSums& light, std::size_t at) const {
    if (light.apart) {
        const glm::dvec3 p =
            texel(std::uint32_t(at % fine_.x), std::uint32_t(at / fine_.x));
        const auto shines = [&](const LightPoint& point) {
            return light.sun || point.faces(p);
        };
        return std::any_of(light.points.begin(), light.points.end(), shines) ? 0.0f
                                                                             : 1.0f;
    }
    const float count = light.partly ? light.facing[at] : float(light.done);
    return count > 0.0f ? light.visible[at] / count : 1.0f;
}

glm::vec3 Work::radiance(std::size_t at) const {
    glm::dvec3 sum = options_.ambient;
    for (std::size_t l = 0; l < sums_.size(); ++l) {
        const LightSums& light = sums_[l];
        if (light.apart) continue;
        // Of the points that are done so far each stands for more.
        const double share = double(light.points.size()) / light.done;
        sum += lights_[l].radiance * (double(light.radiance[at]) * share);
    }
    return receiver_.reflectance * sum;
}

/// The sums so far, filtered down to the texture's own size.
RadianceTexture Work::texture() const {
    RadianceTexture texture;
    texture.width = size_.x;
    texture.height = size_.y;
    texture.looked = looked_;
    const auto s = std::uint32_t(options_.supersampling);
    const float share = 1.0f / float(s * s);
    const auto filtered = [&](auto zero, const auto& value) {
        std::vector<decltype(zero)> values(std::size_t(size_.x) * size_.y, zero);
        base::parallelRanges(0u, size_.y, 16u,
                             [&](std::uint32_t begin, std::uint32_t end) {
                                 for (std::uint32_t y = begin * s; y < end * s; ++y)
                                     for (std::uint32_t x = 0; x < fine_.x; ++x)
                                         values[std::size_t(y / s) * size_.x + x / s] +=
                                             share * value(std::size_t(y) * fine_.x + x);
                             });
        return values;
    };
    for (const LightSums& light : sums_) {
        texture.samples.push_back(light.done);
        texture.visibility.push_back(
            filtered(0.0f, [&](std::size_t at) { return visibility(light, at); }));
    }
    if (!options_.radiance) return texture;
    texture.radiance =
        filtered(glm::vec3(0.0f), [&](std::size_t at) { return radiance(at); });
    texture.flatness = flatness(texture);
    return texture;
}

/// Least squares in 1, u and v over the texels within the receiver, then the largest
/// distance from that.
Flatness Work::flatness(const RadianceTexture& texture) const {
    const auto forEach = [&](const auto& visit) {
        for (std::uint32_t y = 0; y < size_.y; ++y)
            for (std::uint32_t x = 0; x < size_.x; ++x) {
                const glm::dvec2 uv = (glm::dvec2(x, y) + 0.5) / glm::dvec2(size_);
                if (receiver_.contains(uv))
                    visit(glm::dvec3(1.0, uv - 0.5),
                          glm::dvec3(texture.radiance[std::size_t(y) * size_.x + x]));
            }
    };
    glm::dmat3 moments(0.0), right(0.0);  // right: a column for each colour
    glm::dvec3 low(1e300), high(-1e300);
    forEach([&](glm::dvec3 basis, glm::dvec3 value) {
        moments += glm::outerProduct(basis, basis);
        right += glm::outerProduct(basis, value);
        low = glm::min(low, value);
        high = glm::max(high, value);
    });
    const double most = std::max({high.x, high.y, high.z, 0.0});
    const double allowed = 2.0 * options_.flatTolerance * most;
    const glm::dvec3 range = high - low;
    if (!(std::max({range.x, range.y, range.z}) > allowed)) return Flatness::constant;
    // A texture one texel wide has no slope that way.
    for (int i = 1; i < 3; ++i)
        moments[i][i] += 1e-9 * moments[0][0];
    const glm::dmat3 fit = glm::inverse(moments) * right;
    bool linear = true;
    forEach([&](glm::dvec3 basis, glm::dvec3 value) {
        const glm::dvec3 off = glm::abs(basis * fit - value);
        linear = linear && std::max({off.x, off.y, off.z}) <= 0.5 * allowed;
    });
    return linear ? Flatness::linear : Flatness::textured;
}

Error refuse(const char* what, double found, double least, double most) {
    return base::makeError(ErrorCode::badArgument, what, ": found ", found, ", expected ",
                           least, " to ", most);
}

Status checkOptions(const RadianceOptions& o) {
    if (o.supersampling < 1 || o.supersampling > kMostSupersampling)
        return refuse("supersampling", o.supersampling, 1, kMostSupersampling);
    if (o.samplesPerSide < 1 || o.samplesPerSide > kMaxGridSide)
        return refuse("samples per side", o.samplesPerSide, 1, kMaxGridSide);
    if (!(o.pixelSize > 0.0) && (o.resolution < 1 || o.resolution > int(kMaxResolution)))
        return refuse("resolution", o.resolution, 1, kMaxResolution);
    if (!std::isfinite(o.pixelSize) || !std::isfinite(o.solidAngle))
        return Error{ErrorCode::badArgument, "pixel size and solid angle must be finite"};
    return {};
}

/// What messages call a receiver.
std::string label(const std::vector<RadianceReceiver>& receivers, std::size_t i) {
    const std::string& name = receivers[i].name;
    return name.empty() ? base::concat("receiver ", i) : "receiver " + name;
}

Status checkReceiver(const RadianceReceiver& receiver, const std::string& label,
                     const RadianceOptions& options) {
    const PlanarReceiver& plane = receiver.plane;
    const glm::dvec3 normal = glm::cross(plane.edgeX, plane.edgeY);
    if (!base::isFinite(plane.corner) || !base::isFinite(normal) ||
        !(glm::length(normal) >
          1e-12 * glm::length(plane.edgeX) * glm::length(plane.edgeY)))
        return base::makeError(ErrorCode::badArgument, label,
                               " has no area: its edges must be finite and not in line");
    const glm::uvec2 size = textureSize(receiver, options);
    const auto s = std::size_t(options.supersampling);
    if (size.x * s > kMaxResolution || size.y * s > kMaxResolution ||
        size.x * s * size.y * s > kMostTexels)
        return base::makeError(
            ErrorCode::tooLarge, label, " would need more than ", kMaxResolution,
            " texels on a side or ", kMostTexels,
            " in all, supersampling included; choose a larger pixel size, a lower "
            "resolution or less supersampling");
    return {};
}

/// What the textures take together: with refinement all sums are held, without it one
/// after the other.
Status checkTotal(const std::vector<RadianceReceiver>& receivers, std::size_t lights,
                  const RadianceOptions& options) {
    const double s = options.supersampling;
    const double sums = !options.refined ? 0.0 : (options.radiance ? 3.0 : 2.0) * s * s;
    const double bytes =
        4.0 * double(lights) * (1.0 + sums) + (options.radiance ? 12.0 : 0.0);
    double total = 0.0;
    for (const RadianceReceiver& receiver : receivers) {
        const glm::uvec2 size = textureSize(receiver, options);
        total += bytes * double(size.x) * double(size.y);
    }
    if (total <= double(kMostBytes)) return {};
    return base::makeError(
        ErrorCode::tooLarge, "the textures of ", receivers.size(), " receivers and ",
        lights, " lights would take ", std::uint64_t(total / 0x1p20), " MB; at most ",
        kMostBytes >> 20, " are allowed; choose a larger pixel size, a lower resolution ",
        "or fewer receivers");
}

}  // namespace

const char* name(Flatness flatness) noexcept {
    return flatness == Flatness::constant ? "constant"
           : flatness == Flatness::linear ? "linear"
                                          : "textured";
}

namespace {

Result<std::vector<RadianceTexture>> makeTextures(
    const ShadowCasters& casters, const std::vector<RadianceReceiver>& receivers,
    const std::vector<RadianceLight>& lights, const RadianceOptions& options) {
    std::vector<RadianceTexture> textures(receivers.size());
    if (!options.refined) {
        // One receiver after another is done with, so that only those at work take room.
        base::parallelFor(std::size_t(0), receivers.size(), [&](std::size_t i) {
            Work work(receivers[i], lights, options);
            work.advance(casters, kMaxGridSide * kMaxGridSide);
            textures[i] = work.texture();
        });
        return textures;
    }
    std::vector<std::unique_ptr<Work>> works;
    for (const RadianceReceiver& receiver : receivers)
        works.push_back(std::make_unique<Work>(receiver, lights, options));
    for (int samples = 1;; samples *= 4) {
        std::vector<char> complete(works.size());
        base::parallelFor(std::size_t(0), works.size(), [&](std::size_t i) {
            complete[i] = works[i]->advance(casters, samples);
            textures[i] = works[i]->texture();
        });
        if (Status go = options.refined(samples, textures); !go) return go.error();
        if (std::find(complete.begin(), complete.end(), 0) == complete.end())
            return textures;
    }
}

}  // namespace

Result<std::vector<RadianceTexture>> radianceTextures(
    const ShadowCasters& casters, const std::vector<RadianceReceiver>& receivers,
    const std::vector<RadianceLight>& lights, const RadianceOptions& options) {
    if (Status fine = checkOptions(options); !fine) return fine.error();
    for (const RadianceLight& light : lights)
        if (Status fine = checkLight(light.light); !fine) return fine.error();
    for (std::size_t i = 0; i < receivers.size(); ++i) {
        const Status fine = checkReceiver(receivers[i], label(receivers, i), options);
        if (!fine) return fine.error();
    }
    if (Status fits = checkTotal(receivers, lights.size(), options); !fits)
        return fits.error();
    try {
        return makeTextures(casters, receivers, lights, options);
    } catch (const std::bad_alloc&) {
        return Error{ErrorCode::tooLarge,
                     "there is not enough memory for the textures; choose a larger pixel "
                     "size, a lower resolution or fewer receivers"};
    }
}

float lookUp(const std::vector<float>& values, glm::uvec2 size, glm::dvec2 uv) noexcept {
    const glm::dvec2 last = glm::dvec2(size) - 1.0;
    const glm::dvec2 at = glm::clamp(uv * glm::dvec2(size) - 0.5, glm::dvec2(0.0), last);
    const glm::uvec2 low(at), high = glm::min(low + 1u, size - 1u);
    const glm::vec2 f(at - glm::dvec2(low));
    const auto value = [&](std::uint32_t x, std::uint32_t y) {
        return values[std::size_t(y) * size.x + x];
    };
    const float lower = value(low.x, low.y) * (1 - f.x) + value(high.x, low.y) * f.x;
    const float upper = value(low.x, high.y) * (1 - f.x) + value(high.x, high.y) * f.x;
    return lower * (1 - f.y) + upper * f.y;
}

}  // namespace mtsm::baseline
