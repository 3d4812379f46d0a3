// gradient.h - the prediction of the gradient filter: what a layer's 32 bits are guessed
// to be from its neighbours, so that only the difference has to be stored.
//
// Layers with the same number in neighbouring pixels mostly belong to one surface. Were
// it a plane, and its depths integers, left + above - above left would be exact [as the
// plane predictor of lossless image coders has it; Weinberger00, "LOCO-I", sec. III A].
// Bits of positive floats are ordered as the floats are, and differences are taken modulo
// 2^32, so nothing can overflow and every bit pattern comes back.
#pragma once
#include <cstdint>
#include <span>

namespace mtsm::format {

/// Predicts one layer of one pixel after another, in the order of the plane.
class GradientPredictor {
  public:
    /// `begin` as in Tile; `bits` [layers], filled at least up to the layer before the
    /// one that is predicted.
    GradientPredictor(std::span<const std::uint32_t> begin, std::uint32_t width,
                      const std::uint32_t* bits)
        : begin_(begin), width_(width), bits_(bits) {}

    /// Of layer k of pixel (x, y): the plane through three neighbours that have a layer
    /// k; else the left one's, else the upper one's, else this pixel's layer before, else
    /// 0.
    [[nodiscard]] std::uint32_t operator()(std::uint32_t x, std::uint32_t y,
                                           std::uint32_t k) const noexcept {
        const std::uint32_t p = y * width_ + x;
        const bool left = x > 0 && has(p - 1, k);
        const bool above = y > 0 && has(p - width_, k);
        if (left && above && has(p - width_ - 1, k))
            return at(p - 1, k) + at(p - width_, k) - at(p - width_ - 1, k);
        if (left) return at(p - 1, k);
        if (above) return at(p - width_, k);
        return k > 0 ? at(p, k - 1) : 0;
    }

  private:
    [[nodiscard]] bool has(std::uint32_t p, std::uint32_t k) const noexcept {
        return k < begin_[p + 1] - begin_[p];
    }
    [[nodiscard]] std::uint32_t at(std::uint32_t p, std::uint32_t k) const noexcept {
        return bits_[begin_[p] + k];
    }
    std::span<const std::uint32_t> begin_;
    std::uint32_t width_;
    const std::uint32_t* bits_;
};

/// Small differences of either sign become small numbers: 0, -1, 1, -2, ... -> 0, 1,
/// 2, 3.
[[nodiscard]] constexpr std::uint32_t zigzag(std::uint32_t d) noexcept {
    return (d << 1) ^ (0u - (d >> 31));
}
[[nodiscard]] constexpr std::uint32_t unzigzag(std::uint32_t r) noexcept {
    return (r >> 1) ^ (0u - (r & 1u));
}

}  // namespace mtsm::format
