#include "accuracy/sources.h"

#include <cmath>
#include <cstdio>
#include <glm/geometric.hpp>
#include <glm/gtc/constants.hpp>

#include "accuracy/random.h"
#include "mtsm/caster_files.h"

namespace mtsm::bench {
namespace {

/// A unit ball with curved hair, as long as a third of its radius, tapering to a fifth of
/// its width, of opacity 0.4 [Xie07, sec. 6].
class FurBall final : public CasterSource {
  public:
    explicit FurBall(std::size_t segments) {
        const std::size_t strands = segments / kSegments;
        Random random(5);
        points_.reserve(strands * (kSegments + 1));
        begin_.reserve(strands + 1);
        for (std::size_t s = 0; s < strands; ++s)
            addStrand(random);
    }
    Status visit(const CasterVisitor& visitor) override {
        StrandsView view;
        view.points = points_.data();
        view.begin = begin_.data();
        view.strandCount = begin_.size() - 1;
        view.widths = widths_.data();
        view.opacity = 0.4f;
        return visitor(view);
    }

  private:
    static constexpr int kSegments = 8;  // per strand

    void addStrand(Random& random) {
        const double y = random(-1, 1), phi = random(0, 2 * glm::pi<double>());
        const double ring = std::sqrt(1 - y * y);
        const glm::dvec3 root(ring * std::cos(phi), y, ring * std::sin(phi));
        const glm::dvec3 lean(random(-0.4, 0.4), random(-0.4, 0.4), random(-0.4, 0.4));
        const double length = random(0.25, 0.4);
        for (int i = 0; i <= kSegments; ++i) {
            const double t = double(i) / kSegments;
            const glm::dvec3 bent = root + t * (lean - glm::dvec3(0, 0.5 * t, 0));
            points_.emplace_back(root + length * t * bent);
            widths_.push_back(float(0.003 - 0.0024 * t));
        }
        begin_.push_back(std::uint32_t(points_.size()));
    }

    std::vector<glm::vec3> points_;
    std::vector<std::uint32_t> begin_{0};
    std::vector<float> widths_;
};

}  // namespace

std::unique_ptr<CasterSource> openCasters(const SourceOptions& options) {
    if (options.furSegments > 0) return std::make_unique<FurBall>(options.furSegments);
    std::vector<CasterFile> files;
    for (const std::string& path : options.files) {
        CasterFile file;
        file.path = path;
        if (mayHold(path, CasterKind::hair)) {
            file.hairWidth = options.hairWidth;
            file.hairOpacity = options.hairOpacity;
        }
        if (mayHold(path, CasterKind::volume))
            file.densityScale = options.densityScale.value_or(file.densityScale);
        files.push_back(std::move(file));
    }
    CasterFilesOptions reading;
    reading.warn = [](const std::string& line) {
        std::fprintf(stderr, "bench_accuracy: %s\n", line.c_str());
    };
    return std::make_unique<CasterFiles>(std::move(files), std::move(reading));
}

}  // namespace mtsm::bench
