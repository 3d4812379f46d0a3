#include "baseline/picture.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <numeric>
#include <optional>

#include "base/finite.h"
#include "base/parallel.h"
#include "base/sampling.h"
#include "light/sample.h"

namespace mtsm::baseline {
namespace {

constexpr double kOffStrand = 0.1;  // of its width

/// Bits of x and y in turn: cells of any size hold pixels that follow each other.
std::uint64_t zOrder(std::uint32_t x, std::uint32_t y) {
    const auto spread = [](std::uint64_t v) {
        v = (v | v << 16) & 0x0000ffff0000ffffu;
        v = (v | v << 8) & 0x00ff00ff00ff00ffu;
        v = (v | v << 4) & 0x0f0f0f0f0f0f0f0fu;
        v = (v | v << 2) & 0x3333333333333333u;
        return (v | v << 1) & 0x5555555555555555u;
    };
    return spread(x) | spread(y) << 1;
}

std::vector<std::uint32_t> pixelsInZOrder(std::uint32_t width, std::uint32_t height) {
    std::vector<std::uint32_t> order(std::size_t(width) * height);
    std::iota(order.begin(), order.end(), 0u);
    std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
        return zOrder(a % width, a / width) < zOrder(b % width, b / width);
    });
    return order;
}

struct Frame {
    glm::dvec3 forward, right, up;
};

Frame frameOf(const Camera& camera) {
    Frame frame;
    frame.forward = glm::normalize(camera.target - camera.position);
    frame.right = glm::normalize(glm::cross(frame.forward, camera.up));
    frame.up = glm::cross(frame.right, frame.forward);
    return frame;
}

/// What a camera's ray meets.
struct Seen {
    glm::dvec3 point, normal, start;
    bool object = false;
};

class Viewer {
  public:
    Viewer(const Camera& camera, const EmbreeReference& casters,
           const EmbreeReference* receivers)
        : camera_(camera),
          casters_(casters),
          receivers_(receivers),
          frame_(frameOf(camera)),
          size_(glm::length(casters.boundsMax() - casters.boundsMin())),
          perPixel_(2.0 * std::tan(0.5 * camera.fov) /
                    std::max(camera.width, camera.height)) {}

    /// (x, y) in pixels; `left` in [0, 1) is what passes until light scatters.
    [[nodiscard]] std::optional<Seen> look(double x, double y, double left) const {
        const double u = perPixel_ * (x - 0.5 * camera_.width),
                     v = perPixel_ * (0.5 * camera_.height - y);
        const glm::dvec3 ray =
            glm::normalize(frame_.forward + u * frame_.right + v * frame_.up);
        const auto seen = surface(ray);
        return casters_.hasVolumes() ? scattered(ray, seen, left) : seen;
    }

  private:
    [[nodiscard]] std::optional<Seen> surface(glm::dvec3 ray) const {
        std::optional<Seen> seen;
        double away = HUGE_VAL;
        if (const auto hit = casters_.firstHit(camera_.position, ray)) {
            away = glm::distance(hit->position, camera_.position);
            seen = Seen{hit->position, hit->normal, hit->position, true};
            if (hit->strand) {
                seen->start += kOffStrand * hit->width * hit->normal;
                seen->normal = glm::dvec3(0.0);
            }
        }
        if (!receivers_) return seen;
        if (const auto hit = receivers_->firstHit(camera_.position, ray);
            hit && glm::distance(hit->position, camera_.position) < away)
            seen = Seen{hit->position, hit->normal, hit->position, false};
        return seen;
    }

    /// The point of a volume at which so much is left of light from the camera, or what
    /// is behind it.
    [[nodiscard]] std::optional<Seen> scattered(glm::dvec3 ray,
                                                const std::optional<Seen>& behind,
                                                double left) const {
        const glm::dvec3 middle = 0.5 * (casters_.boundsMin() + casters_.boundsMax());
        double far = behind ? (1 - 1e-7) * glm::distance(camera_.position, behind->point)
                            : glm::distance(camera_.position, middle) + size_;
        // Up to the surface there is nothing but volumes.
        const auto passes = [&](double t) {
            return casters_.visibility(camera_.position, t * ray).x;
        };
        if (passes(far) > left) return behind;
        double near = 0.0;
        for (int i = 0; i < 50; ++i) {
            const double t = 0.5 * (near + far);
            (passes(t) > left ? near : far) = t;
        }
        const glm::dvec3 at = camera_.position + far * ray;
        return Seen{at, glm::dvec3(0.0), at, true};
    }

    const Camera& camera_;
    const EmbreeReference& casters_;
    const EmbreeReference* receivers_;
    const Frame frame_;
    const double size_, perPixel_;
};

void append(Picture& picture, std::uint32_t pixel, const std::vector<Seen>& seen) {
    if (seen.empty()) return;
    std::size_t objects = 0;
    for (const Seen& s : seen) {
        picture.points.push_back(s.point);
        picture.normals.push_back(s.normal);
        picture.starts.push_back(s.start);
        objects += s.object;
    }
    picture.first.push_back(picture.points.size());
    picture.pixel.push_back(pixel);
    picture.object.push_back(2 * objects >= seen.size());
}

}  // namespace

Camera Camera::framing(glm::dvec3 low, glm::dvec3 high, std::uint32_t width,
                       std::uint32_t height) {
    Camera camera;
    camera.width = width;
    camera.height = height;
    const glm::dvec3 centre = 0.5 * (low + high);
    const glm::dvec3 back = glm::normalize(glm::dvec3(0.55, 0.45, 1.0));
    camera.position = centre + 2.5 * glm::length(high - low) * back;
    // Towards the middle of the corners as the camera sees them.
    camera.target = centre;
    glm::dvec2 least, most;
    for (int pass = 0; pass < 4; ++pass) {
        const Frame frame = frameOf(camera);
        least = glm::dvec2(std::numeric_limits<double>::infinity());
        most = -least;
        for (int corner = 0; corner < 8; ++corner) {
            const glm::dvec3 p =
                glm::mix(low, high,
                         glm::dvec3(corner & 1, corner >> 1 & 1, corner >> 2)) -
                camera.position;
            const glm::dvec2 at =
                glm::dvec2(glm::dot(p, frame.right), glm::dot(p, frame.up)) /
                glm::dot(p, frame.forward);
            least = glm::min(least, at);
            most = glm::max(most, at);
        }
        const glm::dvec2 middle = 0.5 * (least + most);
        camera.target = camera.position + glm::distance(camera.position, centre) *
                                              (frame.forward + middle.x * frame.right +
                                               middle.y * frame.up);
    }
    const double perPixel =
        std::max((most.x - least.x) / (0.9 * width), (most.y - least.y) / (0.9 * height));
    camera.fov = 2.0 * std::atan(0.5 * perPixel * std::max(width, height));
    return camera;
}

Status checkCamera(const Camera& camera) {
    const auto refuse = [](const char* why) {
        return Error{ErrorCode::badArgument, why};
    };
    if (camera.width == 0 || camera.height == 0)
        return refuse("the picture has no pixels; each side needs at least 1");
    if (!base::isFinite(camera.position) || !base::isFinite(camera.target) ||
        !base::isFinite(camera.up))
        return refuse("the camera's position, target or up is not finite");
    if (!(camera.fov > 0.0 && camera.fov < 3.14))
        return refuse("the camera's field of view must lie between 0 and 180 degrees");
    const glm::dvec3 forward = camera.target - camera.position;
    if (!(glm::length(forward) > 0.0))
        return refuse("the camera's target is where the camera is");
    if (!(glm::length(glm::cross(forward, camera.up)) >
          1e-9 * glm::length(forward) * glm::length(camera.up)))
        return refuse("the camera looks along its up; give it another one");
    return {};
}

Receivers Picture::receivers() const noexcept {
    Receivers r;
    r.points = points.data();
    r.normals = normals.data();
    r.starts = starts.data();
    r.count = points.size();
    r.first = first.data();
    r.pixels = pixel.size();
    return r;
}

Picture Picture::part(const std::vector<std::size_t>& which) const {
    Picture part;
    part.width = width;
    part.height = height;
    for (const std::size_t p : which) {
        for (std::size_t i = first[p]; i < first[p + 1]; ++i) {
            part.points.push_back(points[i]);
            part.normals.push_back(normals[i]);
            part.starts.push_back(starts[i]);
        }
        part.first.push_back(part.points.size());
        part.pixel.push_back(pixel[p]);
        part.object.push_back(object[p]);
    }
    return part;
}

std::vector<std::size_t> Picture::spread(std::size_t count, std::size_t run) const {
    std::vector<std::size_t> chosen;
    const std::size_t runs = pixels() / run;
    if (count >= pixels() || runs == 0) {
        chosen.resize(pixels());
        std::iota(chosen.begin(), chosen.end(), std::size_t(0));
        return chosen;
    }
    const std::size_t wanted = std::clamp<std::size_t>(count / run, 1, runs);
    for (std::size_t i = 0; i < wanted; ++i) {
        // One run in each of `wanted` stretches, where a hash says.
        const std::size_t begin = i * runs / wanted, end = (i + 1) * runs / wanted;
        const std::size_t at = begin + std::size_t(base::mix(i + 1) % (end - begin));
        for (std::size_t k = 0; k < run; ++k)
            chosen.push_back(at * run + k);
    }
    return chosen;
}

std::vector<float> Picture::pixelMeans(const std::vector<float>& values) const {
    std::vector<float> means(pixels());
    for (std::size_t p = 0; p < pixels(); ++p) {
        double sum = 0.0;
        for (std::size_t i = first[p]; i < first[p + 1]; ++i)
            sum += values[i];
        means[p] = float(sum / double(first[p + 1] - first[p]));
    }
    return means;
}

std::vector<float> Picture::image(const std::vector<float>& values, float nothing) const {
    std::vector<float> image(std::size_t(width) * height, nothing);
    for (std::size_t p = 0; p < pixels(); ++p)
        image[pixel[p]] = values[p];
    return image;
}

std::vector<float> Picture::cosines(const AreaLight& light) const {
    const light::LightSampler sampler(light);
    std::vector<float> all(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::dvec3 to = sampler.towards(points[i]);
        const double length = glm::length(to);
        const bool none = normals[i] == glm::dvec3(0.0) || !(length > 0.0);
        all[i] = none ? 1.0f : float(std::max(0.0, glm::dot(normals[i], to) / length));
    }
    return pixelMeans(all);
}

Picture takePicture(const Camera& camera, const EmbreeReference& casters,
                    const EmbreeReference* receivers,
                    const std::function<void(double)>& progress) {
    const Viewer viewer(camera, casters, receivers);
    const auto order = pixelsInZOrder(camera.width, camera.height);
    const int side = std::max(1, camera.pointsPerSide);
    Picture picture;
    picture.width = camera.width;
    picture.height = camera.height;
    constexpr std::size_t kBatch = 1 << 14;
    std::vector<std::vector<Seen>> seen(std::min(kBatch, order.size()));
    for (std::size_t begin = 0; begin < order.size(); begin += kBatch) {
        const std::size_t end = std::min(order.size(), begin + kBatch);
        base::parallelFor(begin, end, [&](std::size_t k) {
            auto& here = seen[k - begin];
            here.clear();
            const std::uint32_t pixel = order[k];
            const base::SquareSequence jitter(base::mix(pixel + 1)),
                more(base::mix(~std::uint64_t(pixel)));
            for (int ray = 0; ray < side * side; ++ray) {
                const glm::dvec2 j =
                    side == 1 ? glm::dvec2(0.5) : jitter(std::uint32_t(ray));
                const double x = (ray % side + j.x) / side, y = (ray / side + j.y) / side;
                if (const auto met =
                        viewer.look(pixel % camera.width + x, pixel / camera.width + y,
                                    more(std::uint32_t(ray)).x))
                    here.push_back(*met);
            }
        });
        for (std::size_t k = begin; k < end; ++k)
            append(picture, order[k], seen[k - begin]);
        if (progress) progress(double(end) / double(order.size()));
    }
    return picture;
}

Picture pictureOfPass(std::uint32_t width, std::uint32_t height,
                      const std::vector<glm::vec3>& positions,
                      const std::vector<std::uint8_t>& surface,
                      const std::vector<glm::vec3>& normals) {
    Picture picture;
    picture.width = width;
    picture.height = height;
    for (const std::uint32_t pixel : pixelsInZOrder(width, height)) {
        if (!surface[pixel] || !base::isFinite(glm::dvec3(positions[pixel]))) continue;
        glm::dvec3 at(positions[pixel]);
        glm::dvec3 n = normals.empty() ? glm::dvec3(0.0) : glm::dvec3(normals[pixel]);
        const double length = glm::length(n);
        n = length > 0.0 && base::isFinite(n) ? n / length : glm::dvec3(0.0);
        // Far from the origin floats put points as far behind their surface.
        constexpr double kRounding = 0x1p-23;
        at += kRounding * glm::dot(glm::abs(at), glm::abs(n)) * n;
        append(picture, pixel, {Seen{at, n, at, true}});
    }
    return picture;
}

}  // namespace mtsm::baseline
