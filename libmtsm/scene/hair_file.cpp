// HairFile: chunks of strands from whatever format, checked, and handed on as views.
#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <limits>
#include <string_view>
#include <utility>

#include "base/finite.h"
#include "base/message.h"
#include "mtsm/hair_files.h"
#include "scene/hair_reader.h"

namespace mtsm {
namespace {

using base::makeError;
using scene::HairChunk;
using scene::HairReader;

/// Of the diagonal, where nothing says how wide strands are.
constexpr double kDefaultWidth = 1.0 / 2000.0;

bool endsIn(std::string_view path, std::string_view ending) {
    if (path.size() < ending.size()) return false;
    const auto same = [](char a, char b) {
        return (a >= 'A' && a <= 'Z' ? char(a - 'A' + 'a') : a) == b;
    };
    return std::equal(path.end() - std::ptrdiff_t(ending.size()), path.end(),
                      ending.begin(), same);
}

Status checkOptions(const HairFileOptions& o) {
    const auto refuse = [](const char* what, float value, const char* expected) {
        return makeError(ErrorCode::badArgument, "hair ", what, ' ', value, " must be ",
                         expected);
    };
    for (const auto& [what, width] :
         {std::pair("width", o.width), std::pair("tip width", o.tipWidth)}) {
        if (width && !(*width >= 0.0f && std::isfinite(*width)))
            return refuse(what, *width, "finite and not negative");
    }
    if (o.tipWidth && !o.width)
        return makeError(ErrorCode::badArgument,
                         "a hair tip width needs a hair width to start from");
    if (o.opacity && !(*o.opacity >= 0.0f && *o.opacity <= 1.0f))
        return refuse("opacity", *o.opacity, "in [0, 1]");
    if (!(o.scale > 0.0f && std::isfinite(o.scale)))
        return refuse("scale", o.scale, "finite and above 0");
    return {};
}

/// Takes strands with points that are not finite out of a chunk; returns how many.
std::uint64_t dropNonFinite(HairChunk& chunk) {
    std::size_t kept = 0, to = 0;
    const std::size_t strands = chunk.strands();
    for (std::size_t s = 0; s < strands; ++s) {
        const std::size_t first = chunk.begin[s], end = chunk.begin[s + 1];
        bool finite = true;
        for (std::size_t i = first; i < end; ++i)
            finite = finite && base::isFinite(chunk.points[i]);
        if (!finite) continue;
        if (to != first) {
            const auto move = [&](auto& array) {
                if (array.empty()) return;
                const auto at = array.begin();
                std::copy(at + std::ptrdiff_t(first), at + std::ptrdiff_t(end),
                          at + std::ptrdiff_t(to));
            };
            move(chunk.points);
            move(chunk.widths);
            move(chunk.transparency);
        }
        to += end - first;
        chunk.begin[++kept] = std::uint32_t(to);
    }
    chunk.begin.resize(kept + 1);
    return strands - kept;
}

}  // namespace

struct HairFile::Impl {
    std::string path;
    HairFileOptions options;
    std::optional<scene::ByteFile::Stamp> stamp;  // of the file at the first visit
    bool warned = false;                          // a visit has come to its end
    std::optional<float> defaultWidth;            // in the file's units
    std::optional<scene::ObjCurves> curves;

    Status visit(const CasterVisitor& visitor);
    Result<std::unique_ptr<HairReader>> open(const scene::ByteFile& file);
    Status findDefaultWidth(const scene::ByteFile& file);
    Status checkHeader(const HairReader& reader) const;
    Status check(const HairChunk& chunk, std::uint64_t firstStrand) const;
    Status show(HairChunk& chunk, const HairReader& reader, const CasterVisitor& visitor);
    void warn(const std::string& text) const {
        if (!warned && options.warn) options.warn(base::concat(path, ": ", text));
    }
};

Result<std::unique_ptr<HairReader>> HairFile::Impl::open(const scene::ByteFile& file) {
    const scene::HairWanted wanted{!options.width, !options.opacity};
    if (endsIn(path, ".hair")) return scene::openYukselHair(file, wanted);
    if (endsIn(path, ".tfx")) return scene::openTfx(file, wanted);
    if (!curves) {
        auto read = scene::readObjCurves(file);
        if (!read) return read.error();
        curves = std::move(*read);
    }
    return scene::openObjCurves(*curves);
}

/// A look at all strands before they are handed out.
Status HairFile::Impl::findDefaultWidth(const scene::ByteFile& file) {
    auto reader = open(file);
    if (!reader) return reader.error();
    glm::vec3 low(std::numeric_limits<float>::infinity()), high = -low;
    HairChunk chunk;
    for (;;) {
        const auto more = (*reader)->next(chunk);
        if (!more) return more.error();
        if (!*more) break;
        dropNonFinite(chunk);
        for (std::size_t i = 0; i < chunk.begin.back(); ++i) {
            low = glm::min(low, chunk.points[i]);
            high = glm::max(high, chunk.points[i]);
        }
    }
    const double diagonal =
        low.x <= high.x ? glm::length(glm::dvec3(high) - glm::dvec3(low)) : 0.0;
    defaultWidth = float(kDefaultWidth * diagonal);
    warn(base::concat("does not say how wide its strands are; taken is ",
                      *defaultWidth * options.scale,
                      ", 1/2000 of the diagonal around all of them; set it with "
                      "--hair-width"));
    return {};
}

/// What holds for all strands of the file.
Status HairFile::Impl::checkHeader(const HairReader& reader) const {
    const auto refuse = [&](const char* what, float value, const char* expected) {
        return makeError(ErrorCode::badFile, path, ": its header has the ", what, ' ',
                         value, ", expected ", expected);
    };
    if (!options.width && reader.width) {
        if (!(*reader.width >= 0.0f && std::isfinite(*reader.width)))
            return refuse("thickness", *reader.width,
                          "a number that is not negative; set it with --hair-width");
        if (*reader.width == 0.0f)
            warn(
                "its strands have the thickness 0 and cast no shadow; set it with "
                "--hair-width");
    }
    if (!options.opacity && !(reader.transparency >= 0.0f && reader.transparency <= 1.0f))
        return refuse("transparency", reader.transparency,
                      "a number from 0 to 1; set it with --hair-opacity");
    return {};
}

/// Widths and transparencies of points as the file has them.
Status HairFile::Impl::check(const HairChunk& chunk, std::uint64_t firstStrand) const {
    const auto find = [&](const char* what, const std::vector<float>& values, float most,
                          const char* expected, const char* option) -> Status {
        const auto good = [most](float v) { return v >= 0.0f && v <= most; };
        const auto at = std::find_if_not(values.begin(), values.end(), good);
        if (at == values.end()) return {};
        const auto point = std::uint32_t(at - values.begin());
        const auto next = std::upper_bound(chunk.begin.begin(), chunk.begin.end(), point);
        const auto strand = std::uint64_t(next - chunk.begin.begin()) - 1;
        return makeError(ErrorCode::badFile, path, ": strand ", firstStrand + strand,
                         " has the ", what, ' ', *at, ", expected ", expected,
                         "; export it again, or set it with ", option);
    };
    if (Status s = find("thickness", chunk.widths, std::numeric_limits<float>::max(),
                        "a number that is not negative", "--hair-width");
        !s)
        return s;
    return find("transparency", chunk.transparency, 1.0f, "a number from 0 to 1",
                "--hair-opacity");
}

Status HairFile::Impl::show(HairChunk& chunk, const HairReader& reader,
                            const CasterVisitor& visitor) {
    StrandsView view;
    view.points = chunk.points.data();
    view.begin = chunk.begin.data();
    view.strandCount = chunk.strands();
    view.worldFromObject = glm::dmat4(options.scale);
    view.worldFromObject[3][3] = 1.0;
    const auto unscaled = [&](float width) { return width / options.scale; };
    if (options.tipWidth) {
        const double root = *options.width, tip = *options.tipWidth;
        chunk.widths.clear();
        for (std::size_t s = 0; s < chunk.strands(); ++s) {
            const std::uint32_t segments = chunk.begin[s + 1] - chunk.begin[s] - 1;
            for (std::uint32_t i = 0; i <= segments; ++i)
                chunk.widths.push_back(
                    unscaled(float(root + (tip - root) * i / segments)));
        }
    }
    if (!chunk.widths.empty())
        view.widths = chunk.widths.data();
    else if (options.width)
        view.width = unscaled(*options.width);
    else
        view.width = reader.width ? *reader.width : *defaultWidth;
    for (float& t : chunk.transparency)
        t = 1.0f - t;
    if (!chunk.transparency.empty()) view.opacities = chunk.transparency.data();
    view.opacity = options.opacity.value_or(1.0f - reader.transparency);
    return visitor(view);
}

Status HairFile::Impl::visit(const CasterVisitor& visitor) {
    if (Status s = checkOptions(options); !s) return s;
    if (options.progress && !options.progress(path))
        return makeError(ErrorCode::cancelled, path, ": reading was cancelled");
    const auto file = scene::ByteFile::open(path);
    if (!file) return file.error();
    if (stamp && *stamp != (*file)->stamp())
        return makeError(ErrorCode::io, path,
                         ": has changed since it was read first; start again");
    stamp = (*file)->stamp();

    auto opened = open(**file);
    if (!opened) return opened.error();
    HairReader& reader = **opened;
    if (Status s = checkHeader(reader); !s) return s;
    HairChunk chunk;
    std::uint64_t strands = 0, dropped = 0;
    for (;;) {
        const auto more = reader.next(chunk);
        if (!more) return more.error();
        if (!*more) break;
        if (Status s = check(chunk, strands); !s) return s;
        // No array says how wide strands are, no header, no option.
        if (!options.width && !reader.width && chunk.widths.empty() && !defaultWidth) {
            if (Status s = findDefaultWidth(**file); !s) return s;
        }
        strands += chunk.strands();
        dropped += dropNonFinite(chunk);
        if (chunk.strands() == 0) continue;
        if (Status s = show(chunk, reader, visitor); !s) return s;
    }
    if (dropped > 0)
        warn(base::concat(dropped, " of ", strands,
                          " strands have points that are not finite; they are left "
                          "out"));
    warned = true;
    return {};
}

HairFile::HairFile(std::string path, HairFileOptions options)
    : impl_(std::make_unique<Impl>()) {
    impl_->path = std::move(path);
    impl_->options = std::move(options);
}

HairFile::~HairFile() = default;

Status HairFile::visit(const CasterVisitor& visitor) {
    try {
        return impl_->visit(visitor);
    } catch (const std::bad_alloc&) {
        return makeError(ErrorCode::tooLarge, impl_->path,
                         ": there is not enough memory to hold its strands");
    }
}

bool isHairFile(const std::string& path) {
    return endsIn(path, ".hair") || endsIn(path, ".tfx");
}

}  // namespace mtsm
