// OpacityTexture: a pyramid of box-filtered levels, and probes along the footprint.
//
// The footprint is a parallelogram; a box with the same second moments stands in for it:
// its sides are the singular values of the matrix (du dv) in texels. Probes, each as wide
// as the box is thin, lie along its long side: cards are often seen edge-on, and one
// probe as wide as the long side would blur across the card as much as along it. A probe
// is a trilinear lookup. At most kMostProbes are made; a thinner box is taken for a
// thicker one.
#include "mtsm/opacity_texture.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <utility>

#include "base/message.h"
#include "base/parallel.h"

namespace mtsm {
namespace {

constexpr int kMostProbes = 8;
// A footprint of more texels than this may as well be the whole texture.
constexpr float kWholeTexture = 1e12f;
// A bilinear lookup in a level of texel size s weighs as a tent over boxes: its variance
// is s^2/12 + s^2/6 on average, that of a box 3^(1/2) times as wide. So the level for a
// footprint of w texels is log2(w) less half of log2(3).
constexpr float kLevelOffset = 0.792481250f;

/// [n] to [max(1, n / 2)], each new texel the area-weighted mean of the n / m that it
/// covers: where it begins, and how much of the first and the last count.
struct Halving {
    std::uint32_t from, to;

    explicit Halving(std::uint32_t n) : from(n), to(std::max(1u, n / 2)) {}
    /// add(texel, weight), weights sum up to 1.
    template <typename Add>
    void covered(std::uint32_t i, const Add& add) const {
        // In units of 1 / to of an old texel all borders are whole numbers.
        const std::uint64_t begin = std::uint64_t(i) * from, end = begin + from;
        for (std::uint64_t k = begin / to; k * to < end; ++k) {
            const std::uint64_t low = std::max(begin, k * to);
            const std::uint64_t high = std::min(end, (k + 1) * to);
            add(std::uint32_t(k), double(high - low) / double(from));
        }
    }
};

double floorOf(double x) {
    if (!(std::abs(x) < 1e9)) return std::floor(x);
    const auto i = std::int64_t(x);  // much faster where there is no instruction for it
    return double(i - (double(i) > x));
}

/// Takes a coordinate into [0, 1].
float wrapped(double u, TextureWrap wrap) {
    switch (wrap) {
        case TextureWrap::clamp:
            return float(std::clamp(u, 0.0, 1.0));
        case TextureWrap::mirror: {
            const double period = u - 2.0 * floorOf(0.5 * u);
            return float(period > 1.0 ? 2.0 - period : period);
        }
        case TextureWrap::repeat:
            break;
    }
    return float(u - floorOf(u));
}

/// Between which two texels of a row a coordinate lies, and how far from the first.
struct Between {
    std::int32_t first, second;
    float t;
};

/// `u` in [0, 1], of `n` texels; only a repeated row goes on at its other end.
/// Inlined by force: as a call it takes longer than all the rest of a lookup.
[[gnu::always_inline]] inline Between between(float u, std::uint32_t n,
                                              TextureWrap wrap) {
    const float x = u * float(n) - 0.5f;
    const auto i = std::int32_t(x + 1.0f) - 1;  // floor, as x >= -0.5
    const auto last = std::int32_t(n) - 1;
    const bool repeats = wrap == TextureWrap::repeat;
    Between found{i, i + 1, x - float(i)};
    if (i < 0) found.first = repeats ? last : 0;
    if (i >= last) found.second = repeats ? 0 : last;
    if (i > last) found.first = last;
    return found;
}

/// The box that stands in for a footprint with sides a and b, in texels. In float: this
/// is a good part of a lookup's time, and a footprint need not be known to more digits.
class Box {
  public:
    Box(glm::vec2 a, glm::vec2 b)
        : p_(a.x * a.x + b.x * b.x),
          q_(a.x * a.y + b.x * b.y),
          r_(a.y * a.y + b.y * b.y) {
        spread_ = std::sqrt(0.25f * (p_ - r_) * (p_ - r_) + q_ * q_);
        major = std::sqrt(0.5f * (p_ + r_) + spread_);
        // The determinant loses little to cancellation where the box is thin.
        minor = major > 0 ? std::abs(a.x * b.y - a.y * b.x) / major : 0.0f;
    }
    /// Unit vector along the long side.
    [[nodiscard]] glm::vec2 direction() const {
        const glm::vec2 axis = p_ > r_ ? glm::vec2(0.5f * (p_ - r_) + spread_, q_)
                                       : glm::vec2(q_, 0.5f * (r_ - p_) + spread_);
        const float length = std::sqrt(axis.x * axis.x + axis.y * axis.y);
        return length > 0 ? axis / length : glm::vec2(1, 0);
    }
    float major, minor;

  private:
    float p_, q_, r_;  // second moments, but for a factor: p q; q r
    float spread_;
};

/// The footprint is as large as the texture and reaches across it both ways.
bool coversAll(glm::dvec2 du, glm::dvec2 dv) {
    return std::abs(du.x * dv.y - du.y * dv.x) >= 1.0 &&
           std::abs(du.x) + std::abs(dv.x) >= 1.0 &&
           std::abs(du.y) + std::abs(dv.y) >= 1.0;
}

bool isFinite(glm::dvec2 v) {
    return std::isfinite(v.x) && std::isfinite(v.y);
}

Status check(const OpacityImage& image) {
    using base::makeError;
    constexpr std::uint32_t kMostTexels = OpacityImage::kMostTexels;
    for (const std::uint32_t side : {image.width, image.height})
        if (side < 1 || side > kMostTexels)
            return makeError(ErrorCode::badArgument, "an opacity texture of ",
                             image.width, " x ", image.height,
                             " texels: each side must have 1 to ", kMostTexels);
    if (image.channels != 1 && image.channels != 3)
        return makeError(ErrorCode::badArgument, "an opacity texture of ", image.channels,
                         " channels: there must be 1 or 3");
    const std::uint64_t count =
        std::uint64_t(image.width) * image.height * image.channels;
    if (image.texels.size() != count)
        return makeError(ErrorCode::badArgument, "an opacity texture with ",
                         image.texels.size(), " numbers where its size needs ", count);
    if (!std::isfinite(image.cutoff))
        return makeError(ErrorCode::badArgument,
                         "the cutoff of an opacity texture must be finite");
    if (!(image.opacity >= 0.0f && image.opacity <= 1.0f))
        return makeError(ErrorCode::badArgument, "the opacity ", image.opacity,
                         " of an opacity texture must be in [0, 1]");
    for (std::size_t i = 0; i < image.texels.size(); ++i)
        if (!(image.texels[i] >= 0.0f && image.texels[i] <= 1.0f))
            return makeError(ErrorCode::badArgument, "texel ", i / image.channels,
                             " of an opacity texture is ", image.texels[i],
                             ": it must be in [0, 1]");
    return {};
}

}  // namespace

OpacityTexture::Level OpacityTexture::halved(const Level& from, std::uint32_t channels) {
    const Halving across(from.width), down(from.height);
    Level to{across.to, down.to,
             std::vector<float>(std::size_t(across.to) * down.to * channels)};
    const auto row = [&](std::uint32_t y) {
        for (std::uint32_t x = 0; x < to.width; ++x)
            for (std::uint32_t c = 0; c < channels; ++c) {
                double sum = 0;
                down.covered(y, [&](std::uint32_t oldY, double weightY) {
                    across.covered(x, [&](std::uint32_t oldX, double weightX) {
                        sum +=
                            weightY * weightX *
                            double(from.texels[(std::size_t(oldY) * from.width + oldX) *
                                                   channels +
                                               c]);
                    });
                });
                to.texels[(std::size_t(y) * to.width + x) * channels + c] =
                    std::min(1.0f, float(sum));
            }
    };
    const std::uint32_t grain = std::max(1u, 65536u / to.width);
    base::parallelRanges(0u, to.height, grain, [&](std::uint32_t y, std::uint32_t end) {
        for (; y < end; ++y)
            row(y);
    });
    return to;
}

Result<OpacityTexture> OpacityTexture::create(OpacityImage image) {
    if (Status s = check(image); !s) return s.error();
    OpacityTexture texture;
    texture.channels_ = image.channels;
    texture.wrapU_ = image.wrapU;
    texture.wrapV_ = image.wrapV;
    texture.cutoff_ = image.cutoff;
    texture.opacity_ = image.opacity;
    Level level{image.width, image.height, std::move(image.texels)};
    if (image.cutoff >= 0.0f) {
        texture.original_ = level.texels;
        for (float& texel : level.texels)
            texel = texel >= image.cutoff ? 1.0f : 0.0f;
    }
    texture.translucent_ =
        image.opacity < 1.0f || std::any_of(level.texels.begin(), level.texels.end(),
                                            [](float t) { return t < 1; });
    while (level.width > 1 || level.height > 1) {
        Level next = halved(level, image.channels);
        texture.levels_.push_back(std::exchange(level, std::move(next)));
    }
    texture.levels_.push_back(std::move(level));
    return texture;
}

template <int C>
void OpacityTexture::addLevel(const Probe& probe, std::size_t index, float weight,
                              float* sum) const noexcept {
    const Level& level = levels_[index];
    const Between x = between(probe.u, level.width, wrapU_);
    const Between y = between(probe.v, level.height, wrapV_);
    const float* texels = probe.decide ? original_.data() : level.texels.data();
    const float* upper = texels + std::size_t(y.first) * level.width * C;
    const float* lower = texels + std::size_t(y.second) * level.width * C;
    for (int c = 0; c < C; ++c) {
        const float a = upper[x.first * C + c], b = upper[x.second * C + c];
        const float d = lower[x.first * C + c], e = lower[x.second * C + c];
        const float above = a + x.t * (b - a), below = d + x.t * (e - d);
        const float value = above + y.t * (below - above);
        sum[c] += weight * (probe.decide ? float(value >= cutoff_) : value);
    }
}

template <int C>
void OpacityTexture::lookUp(glm::dvec2 uv, glm::dvec2 du, glm::dvec2 dv,
                            float* out) const noexcept {
    float sum[C] = {};
    // Rows run down, v runs up.
    const glm::dvec2 at(uv.x, 1.0 - uv.y);
    const glm::dvec2 size(levels_[0].width, -double(levels_[0].height));
    const Box box(glm::vec2(du * size), glm::vec2(dv * size));
    if (box.major <= 1.0f) {
        const Probe probe{wrapped(at.x, wrapU_), wrapped(at.y, wrapV_),
                          !original_.empty()};
        addLevel<C>(probe, 0, 1.0f, sum);
    } else if (!(box.major < kWholeTexture) || coversAll(du, dv)) {
        std::copy_n(levels_.back().texels.data(), C, sum);
    } else {
        const float thin = std::max({box.minor, 1.0f, box.major / kMostProbes});
        const int probes = std::min(kMostProbes, int(box.major / thin + 0.5f));
        const float spacing = box.major / float(probes);
        const float level = std::clamp(std::log2(std::max(thin, spacing)) - kLevelOffset,
                                       0.0f, float(levels_.size() - 1));
        const auto fine = std::uint32_t(level);
        const float t = level - float(fine), share = 1.0f / float(probes);
        const glm::dvec2 step = probes > 1 ? glm::dvec2(spacing * box.direction()) /
                                                 glm::dvec2(size.x, -size.y)
                                           : glm::dvec2(0.0);
        for (int i = 0; i < probes; ++i) {
            const glm::dvec2 there = at + step * (i - 0.5 * (probes - 1));
            const Probe probe{wrapped(there.x, wrapU_), wrapped(there.y, wrapV_), false};
            addLevel<C>(probe, fine, share * (1.0f - t), sum);
            if (t > 0) addLevel<C>(probe, fine + 1, share * t, sum);
        }
    }
    for (int c = 0; c < C; ++c)
        out[c] = std::clamp(opacity_ * sum[c], 0.0f, 1.0f);
}

void OpacityTexture::opacity(glm::dvec2 uv, glm::dvec2 du, glm::dvec2 dv,
                             float* out) const noexcept {
    if (!isFinite(uv))
        std::fill_n(out, channels_, 1.0f);
    else if (channels_ == 1)
        lookUp<1>(uv, du, dv, out);
    else
        lookUp<3>(uv, du, dv, out);
}

OpacityImage OpacityTexture::image() const {
    OpacityImage image;
    image.width = levels_[0].width;
    image.height = levels_[0].height;
    image.channels = channels_;
    image.texels = original_.empty() ? levels_[0].texels : original_;
    image.wrapU = wrapU_;
    image.wrapV = wrapV_;
    image.cutoff = cutoff_;
    image.opacity = opacity_;
    return image;
}

std::uint64_t OpacityTexture::memoryBytes() const noexcept {
    std::uint64_t numbers = original_.size();
    for (const Level& level : levels_)
        numbers += level.texels.size();
    return numbers * sizeof(float);
}

}  // namespace mtsm
