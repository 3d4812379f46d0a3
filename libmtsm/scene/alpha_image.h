// alpha_image.h - the alpha, and the colours if asked for, of an image, through
// OpenImageIO; inside the importing child.
#pragma once
#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "mtsm/result.h"

namespace mtsm::scene {

struct AlphaImage {
    std::uint32_t width = 0, height = 0;
    bool hasAlpha = false;           ///< `alpha` comes from an alpha channel
    std::vector<float> alpha;        ///< [height][width], upper row first, in [0, 1]
    std::vector<glm::vec3> colours;  ///< the same, linear; empty unless asked for
};

struct AlphaWanted {
    /// Where there is no alpha channel, or one that is 1 all over, `alpha` is the
    /// brightness; else it is 1.
    bool orBrightness = false;
    bool colours = false;
};

/// Errors say what is wrong, without the image's name: io and badFile as OpenImageIO has
/// it, tooLarge for more than OpacityImage::kMostTexels on a side.
[[nodiscard]] Result<AlphaImage> readAlpha(const std::string& path, AlphaWanted wanted);

/// The same from the bytes of a file; `kind` is what its name would end in ("png"), or
/// empty.
[[nodiscard]] Result<AlphaImage> readAlpha(std::span<const std::uint8_t> bytes,
                                           const std::string& kind, AlphaWanted wanted);

/// The same from texels of red, green, blue and alpha, 8 bit each.
[[nodiscard]] Result<AlphaImage> alphaOfTexels(std::uint32_t width, std::uint32_t height,
                                               std::span<const std::uint8_t> rgba,
                                               AlphaWanted wanted);

}  // namespace mtsm::scene
