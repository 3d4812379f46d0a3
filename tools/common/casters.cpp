#include "common/casters.h"

#include <algorithm>

#include "common/map_file.h"
#include "common/tool.h"

namespace mtsm::tools {
namespace {

/// A setting of casters whose value 0 leaves nothing of them.
struct Emptying {
    CasterKind kind;
    bool (*isZero)(const CasterFile&);
    const char* text;
};

constexpr Emptying kEmptying[] = {
    {CasterKind::volume, [](const CasterFile& c) { return c.densityScale == 0.0f; },
     "a density-scale of 0 makes volumes empty: give more than 0, or leave it out for "
     "densities as the file has them"},
    {CasterKind::hair, [](const CasterFile& c) { return c.hairWidth == 0.0f; },
     "a hair-width of 0 leaves strands out: give their width in world units, or leave it "
     "out for the file's own"},
    {CasterKind::hair, [](const CasterFile& c) { return c.hairOpacity == 0.0f; },
     "a hair-opacity of 0 lets all light through: give more than 0, or leave it out for "
     "the file's own"},
    {CasterKind::mesh, [](const CasterFile& c) { return c.opacity == 0.0f; },
     "an opacity of 0 lets all light through: give more than 0, or leave it out for the "
     "materials' own"},
};

bool empties(const Emptying& e, const CasterFile& c) {
    return mayHold(c.path, e.kind) && e.isZero(c);
}

}  // namespace

void refuseMaps(const std::vector<CasterFile>& casters) {
    for (const CasterFile& caster : casters)
        if (isMap(caster.path))
            throw Failure{{ErrorCode::badFile,
                           caster.path +
                               ": is a map already, no caster: mtsm-query asks "
                               "it for shadows, mtsm-dump shows what is in it"}};
}

std::string emptyingSettings(const std::vector<CasterFile>& casters) {
    std::string text;
    for (const Emptying& e : kEmptying)
        if (std::any_of(casters.begin(), casters.end(),
                        [&](const CasterFile& c) { return empties(e, c); }))
            text += (text.empty() ? "" : "; ") + std::string(e.text);
    return text;
}

Error withEmptying(Error error, const std::vector<CasterFile>& casters) {
    const auto says = [&](const char* words) {
        return error.message.find(words) != std::string::npos;
    };
    if (error.code != ErrorCode::badFile ||
        !(says("casts a shadow: ") || says("nothing that casts: ")))
        return error;
    const std::string why = emptyingSettings(casters);
    if (why.empty()) return error;
    const bool all = std::all_of(casters.begin(), casters.end(), [](const CasterFile& c) {
        return std::any_of(std::begin(kEmptying), std::end(kEmptying),
                           [&](const Emptying& e) { return empties(e, c); });
    });
    error.message = (all ? "nothing casts a shadow: " : error.message + "; ") + why;
    return error;
}

}  // namespace mtsm::tools
