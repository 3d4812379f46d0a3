// Position and normal passes: which layer of which part, and its pixels.
#include "mtsm/passes.h"

#include <ImfChannelList.h>
#include <ImfHeader.h>
#include <ImfMultiPartInputFile.h>
#include <ImfPartType.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <map>
#include <optional>

#include "base/message.h"
#include "base/printable.h"
#include "io/exr_file.h"

namespace mtsm {
namespace {

using base::concat;
using base::makeError;
using base::printable;

/// Three channels that belong together.
struct Layer {
    int part = 0;
    std::string partName;  // "" if it has none
    std::string prefix;    // of the channels' names, without the dot; "" for bare ones
    std::array<std::string, 3> channels;
    bool half = false;  // one of them is

    /// What a user would call it.
    [[nodiscard]] std::string path() const { return prefix.empty() ? partName : prefix; }
};

struct AlphaChannel {
    int part = 0;
    std::string channel;
};

/// What is looked for, and how messages speak of it.
struct Wanted {
    const char* noun;    // "position"
    const char* option;  // "--position-layer"
    std::vector<std::string> words;
};

Wanted wantedPosition() {
    return {
        "position",
        "--position-layer",
        {"p", "position", "worldposition", "pworld", "worldp", "wp", "positionworld"}};
}

Wanted wantedNormal() {
    return {"normal",
            "--normal-layer",
            {"n", "normal", "normals", "worldnormal", "nworld", "worldn", "wn",
             "normalworld"}};
}

std::string upToLastDot(const std::string& name) {
    const std::size_t dot = name.rfind('.');
    return dot == std::string::npos ? std::string() : name.substr(0, dot);
}

std::string afterLastDot(const std::string& name) {
    return name.substr(name.rfind('.') + 1);  // npos + 1 is 0: the whole name
}

/// The last word of a layer's name in lower case and without separators.
std::string lastWord(const std::string& name) {
    std::string word;
    for (unsigned char c : afterLastDot(name)) {
        if (c != '_' && c != '-' && c != ' ') word.push_back(char(std::tolower(c)));
    }
    return word;
}

/// The words of a name in lower case: it is split at whatever is no letter or digit, and
/// where a capital follows a small letter.
std::vector<std::string> wordsOf(const std::string& name) {
    std::vector<std::string> words(1);
    bool small = false;  // the character before
    for (unsigned char c : name) {
        if (!std::isalnum(c) || (small && std::isupper(c))) words.emplace_back();
        if (std::isalnum(c)) words.back().push_back(char(std::tolower(c)));
        small = std::islower(c);
    }
    words.erase(std::remove(words.begin(), words.end(), ""), words.end());
    return words;
}

bool isOneOf(const std::string& word, const std::vector<std::string>& words) {
    return std::find(words.begin(), words.end(), word) != words.end();
}

bool isDeep(const Imf::Header& header) {
    return header.hasType() && Imf::isDeepData(header.type());
}

std::string partName(const Imf::Header& header) {
    return header.hasName() ? header.name() : std::string();
}

/// All layers of the flat parts, in the order of the file.
std::vector<Layer> findLayers(const Imf::MultiPartInputFile& file) {
    static constexpr const char* kTriples[][3] = {
        {"X", "Y", "Z"}, {"x", "y", "z"}, {"R", "G", "B"}, {"r", "g", "b"}};
    std::vector<Layer> layers;
    for (int part = 0; part < file.parts(); ++part) {
        const Imf::Header& header = file.header(part);
        if (isDeep(header)) continue;
        std::map<std::string, std::vector<std::string>> components;  // by prefix
        const Imf::ChannelList& channels = header.channels();
        for (auto c = channels.begin(); c != channels.end(); ++c) {
            if (c.channel().type != Imf::UINT)
                components[upToLastDot(c.name())].push_back(afterLastDot(c.name()));
        }
        for (const auto& [prefix, names] : components) {
            const std::string dotted = prefix.empty() ? prefix : prefix + ".";
            for (const auto& t : kTriples) {
                if (!isOneOf(t[0], names) || !isOneOf(t[1], names) ||
                    !isOneOf(t[2], names))
                    continue;
                Layer layer{part,
                            partName(header),
                            prefix,
                            {dotted + t[0], dotted + t[1], dotted + t[2]}};
                for (const std::string& name : layer.channels)
                    layer.half |= channels[name].type == Imf::HALF;
                layers.push_back(std::move(layer));
                break;
            }
        }
    }
    return layers;
}

/// The channels that a file has, for a message.
std::string listChannels(const Imf::MultiPartInputFile& file) {
    constexpr int kMost = 60;
    std::string text;
    int listed = 0;
    for (int part = 0; part < file.parts(); ++part) {
        const Imf::Header& header = file.header(part);
        text += text.empty() ? "" : "; ";
        if (file.parts() > 1)
            text += concat("part ", part, " \"", printable(partName(header), 80), "\": ");
        const Imf::ChannelList& channels = header.channels();
        const char* comma = "";
        for (auto c = channels.begin(); c != channels.end(); ++c, comma = ", ") {
            if (++listed > kMost) return text + ", and more";
            text += concat(comma, printable(c.name(), 80),
                           c.channel().type == Imf::UINT ? " (integers)" : "");
        }
    }
    return text;
}

/// True if the layer's name says that its values are not those of world space, such as
/// "camera.Position" and "Pref.P". A "View Layer" is no view.
bool isOfOtherSpace(const Layer& layer) {
    static const std::vector<std::string> kSpaces{"camera", "cam",     "object", "obj",
                                                  "local",  "tangent", "ref",    "pref",
                                                  "rest",   "light",   "screen", "ndc"};
    const std::vector<std::string> words = wordsOf(layer.partName + ":" + layer.prefix);
    for (std::size_t i = 0; i < words.size(); ++i) {
        const bool view = words[i] == "view" || words[i] == "views";
        const bool viewLayer = i + 1 < words.size() && words[i + 1].starts_with("layer");
        if (isOneOf(words[i], kSpaces) || (view && !viewLayer)) return true;
    }
    return false;
}

/// True if `name` is how a user may call the layer: whole, or the end of it.
bool answersTo(const Layer& layer, const std::string& name, bool whole) {
    const std::string full = layer.partName + ":" + layer.prefix;
    if (whole) return name == layer.path() || name == full;
    const std::string path = layer.path();
    return path.size() > name.size() && path.ends_with(name) &&
           path[path.size() - name.size() - 1] == '.';
}

/// A file of three bare channels and perhaps an alpha.
bool nothingButThisLayer(const Imf::MultiPartInputFile& file, const Layer& layer) {
    if (file.parts() != 1 || !layer.prefix.empty()) return false;
    std::size_t others = 0;
    const Imf::ChannelList& channels = file.header(0).channels();
    for (auto c = channels.begin(); c != channels.end(); ++c) {
        const std::string name = c.name();
        const bool own = std::find(layer.channels.begin(), layer.channels.end(), name) !=
                         layer.channels.end();
        others += !own && lastWord(name) != "a";
    }
    return others == 0;
}

std::vector<Layer> matchingLayers(const Imf::MultiPartInputFile& file,
                                  const std::vector<Layer>& layers,
                                  const std::string& name, const Wanted& wanted) {
    std::vector<Layer> found;
    const auto keep = [&](auto&& fits) {
        if (!found.empty()) return;
        std::copy_if(layers.begin(), layers.end(), std::back_inserter(found), fits);
    };
    if (!name.empty()) {
        keep([&](const Layer& l) { return answersTo(l, name, true); });
        keep([&](const Layer& l) { return answersTo(l, name, false); });
    } else {
        keep([&](const Layer& l) {
            return isOneOf(lastWord(l.path()), wanted.words) && !isOfOtherSpace(l);
        });
        keep([&](const Layer& l) {
            return nothingButThisLayer(file, l) && !isOfOtherSpace(l);
        });
    }
    return found;
}

Result<Layer> chooseLayer(const Imf::MultiPartInputFile& file, const std::string& name,
                          const Wanted& wanted, const std::string& path) {
    const std::vector<Layer> layers = findLayers(file);
    bool flat = false;
    for (int part = 0; part < file.parts(); ++part)
        flat |= !isDeep(file.header(part));
    if (!flat)
        return makeError(ErrorCode::unsupported, path, ": is a deep image; a ",
                         wanted.noun, " pass has one value per pixel: flatten it first");
    const std::vector<Layer> found = matchingLayers(file, layers, name, wanted);
    if (found.size() == 1) return found.front();
    if (found.empty()) {
        const std::string what =
            name.empty() ? concat("no three float channels that are known to mean ",
                                  wanted.noun, " in world space")
                         : concat("no layer \"", name, "\" of three float channels");
        return makeError(ErrorCode::badArgument, path, ": ", what,
                         "; name the layer with ", wanted.option,
                         "; channels in the file: ", listChannels(file));
    }
    std::string names;
    for (const Layer& l : found)
        names += concat(
            names.empty() ? "\"" : ", \"",
            printable(file.parts() > 1 ? l.partName + ":" + l.prefix : l.path(), 80),
            "\"");
    return makeError(ErrorCode::badArgument, path, ": several layers could be the ",
                     wanted.noun, " pass: ", names, "; name one of them with ",
                     wanted.option, "; channels in the file: ", listChannels(file));
}

bool sameWindow(PixelWindow a, PixelWindow b) {
    return a.x == b.x && a.y == b.y && a.width == b.width && a.height == b.height;
}

/// The alpha that says where `layer` has a surface: its own before the bare one of its
/// part before that of the picture it belongs to.
std::optional<AlphaChannel> findAlpha(const Imf::MultiPartInputFile& file,
                                      const Layer& layer) {
    static const std::vector<std::string> kPictures{"rgba", "combined", "beauty"};
    std::optional<AlphaChannel> best;
    int bestRank = 0;
    for (int part = 0; part < file.parts(); ++part) {
        const Imf::Header& header = file.header(part);
        if (isDeep(header) || !sameWindow(io::exrDataWindow(file, part),
                                          io::exrDataWindow(file, layer.part)))
            continue;
        const Imf::ChannelList& channels = header.channels();
        for (auto c = channels.begin(); c != channels.end(); ++c) {
            const std::string prefix = upToLastDot(c.name());
            if (c.channel().type == Imf::UINT || lastWord(c.name()) != "a") continue;
            const bool samePart = part == layer.part;
            int rank = 0;
            if (samePart && prefix == layer.prefix)
                rank = 3;
            else if (samePart && prefix.empty())
                rank = 2;
            else if (isOneOf(lastWord(prefix.empty() ? partName(header) : prefix),
                             kPictures) &&
                     upToLastDot(prefix) == upToLastDot(layer.prefix))
                rank = 1;
            if (rank > bestRank) {
                best = AlphaChannel{part, c.name()};
                bestRank = rank;
            }
        }
    }
    return best;
}

bool isFinite(glm::vec3 p) {
    return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z);
}

/// The layer's values and the mask of where there is a surface.
Result<Pass> readLayer(Imf::MultiPartInputFile& file, const Layer& layer,
                       const PassOptions& options, const Wanted& wanted,
                       const std::string& path) {
    Pass pass;
    pass.guessed = options.layer.empty() && lastWord(layer.channels[0]) == "r" &&
                   !isOneOf(lastWord(layer.path()), wanted.words);
    pass.half = layer.half;
    pass.layer = file.parts() > 1 && !layer.prefix.empty()
                     ? layer.partName + ":" + layer.prefix
                     : layer.path();
    pass.data = io::exrDataWindow(file, layer.part);
    const Imath::Box2i frame = file.header(layer.part).displayWindow();
    pass.display = {frame.min.x, frame.min.y,
                    std::uint32_t(std::int64_t(frame.max.x) - frame.min.x + 1),
                    std::uint32_t(std::int64_t(frame.max.y) - frame.min.y + 1)};
    const std::uint64_t pixels = std::uint64_t(pass.data.width) * pass.data.height;
    if (pixels > options.maxPixels)
        return makeError(ErrorCode::tooLarge, path, ": ", pass.data.width, " x ",
                         pass.data.height, " pixels are more than the limit of ",
                         options.maxPixels);

    const auto alpha = findAlpha(file, layer);
    const bool alphaAlong = alpha && alpha->part == layer.part;
    std::vector<std::string> names(layer.channels.begin(), layer.channels.end());
    if (alphaAlong) names.push_back(alpha->channel);
    const std::size_t stride = names.size();
    auto done = io::readExrChannels(
        file, layer.part, names, path, [&](const float* v, std::size_t count) {
            for (const float* end = v + count * stride; v != end; v += stride) {
                const glm::vec3 p(v[0], v[1], v[2]);
                const bool hidden = alphaAlong && !(v[3] > 0.0f);
                pass.values.push_back(p);
                pass.surface.push_back(isFinite(p) && !hidden);
                pass.hidden += hidden;
            }
        });
    if (!done) return done.error();
    if (alpha && !alphaAlong) {
        std::size_t at = 0;
        done = io::readExrChannels(file, alpha->part, {alpha->channel}, path,
                                   [&](const float* v, std::size_t count) {
                                       for (std::size_t i = 0; i < count; ++i, ++at) {
                                           if (v[i] > 0.0f) continue;
                                           pass.surface[at] = 0;
                                           ++pass.hidden;
                                       }
                                   });
        if (!done) return done.error();
    }
    return pass;
}

Result<Pass> readPass(const std::string& path, const PassOptions& options,
                      const Wanted& wanted) {
    auto stream = io::ExrStream::open(path);
    if (!stream) return stream.error();
    if (auto s = io::checkExrHeader(**stream, path); !s) return s.error();
    return io::guardExr(path, [&]() -> Result<Pass> {
        // No reconstruction of missing offset tables: a cut file is an error here.
        Imf::MultiPartInputFile file(**stream, 0, false);
        auto layer = chooseLayer(file, options.layer, wanted, path);
        if (!layer) return layer.error();
        return readLayer(file, *layer, options, wanted, path);
    });
}

}  // namespace

Result<Pass> readPositionPass(const std::string& path, const PassOptions& options) {
    return readPass(path, options, wantedPosition());
}

Result<Pass> readNormalPass(const std::string& path, const Pass& positions,
                            const PassOptions& options) {
    auto pass = readPass(path, options, wantedNormal());
    if (!pass) return pass;
    const PixelWindow a = pass->data, b = positions.data;
    if (!sameWindow(a, b))
        return makeError(ErrorCode::badArgument, path, ": the normal pass covers ",
                         a.width, " x ", a.height, " pixels at (", a.x, ", ", a.y,
                         "), the position pass ", b.width, " x ", b.height, " at (", b.x,
                         ", ", b.y, "); they must be the same");
    for (std::size_t i = 0; i < pass->values.size(); ++i) {
        if (!pass->surface[i]) pass->values[i] = glm::vec3(0.0f);
    }
    return pass;
}

}  // namespace mtsm
