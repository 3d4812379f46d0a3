#include "scene/send_materials.h"

#include <algorithm>
#include <cctype>
#include <optional>
#include <string_view>
#include <utility>

#include "base/message.h"
#include "scene/find_image.h"
#include "scene/name_filter.h"

namespace mtsm::scene {
namespace {

/// A name as the pattern that it alone matches.
std::string asPattern(std::string_view name) {
    std::string pattern;
    for (const char c : name) {
        if (std::string_view("*?[]\\").find(c) != std::string_view::npos) pattern += '\\';
        pattern += c;
    }
    return pattern;
}

constexpr std::size_t kMostComplaints = 10;
constexpr std::size_t kMostNames = 20;  // of materials, in one warning

/// The mesh's texture coordinates for a material, or the first it has; null without any.
const aiVector3D* coordinates(const aiMesh& mesh, unsigned channel) {
    if (channel < AI_MAX_NUMBER_OF_TEXTURECOORDS && mesh.mTextureCoords[channel])
        return mesh.mTextureCoords[channel];
    return mesh.mTextureCoords[0];
}

bool hasImages(const aiMaterial& material) {
    for (int type = aiTextureType_NONE; type <= AI_TEXTURE_TYPE_MAX; ++type)
        if (material.GetTextureCount(aiTextureType(type)) > 0) return true;
    return false;
}

/// JPEGs have no alpha, so where only alpha would count they need not be read.
bool mayHaveAlpha(std::string image) {
    std::transform(image.begin(), image.end(), image.begin(),
                   [](unsigned char c) { return char(std::tolower(c)); });
    return !image.ends_with(".jpg") && !image.ends_with(".jpeg");
}

bool sameUse(const OpacityImage& a, const OpacityImage& b) {
    return a.channels == b.channels && a.wrapU == b.wrapU && a.wrapV == b.wrapV &&
           a.cutoff == b.cutoff && a.opacity == b.opacity && a.texels == b.texels;
}

bool opaque(const OpacityImage& image) {
    if (image.opacity < 1.0f) return false;
    const float least = image.cutoff >= 0.0f ? image.cutoff : 1.0f;
    return std::all_of(image.texels.begin(), image.texels.end(),
                       [&](float t) { return t >= least; });
}

/// One channel where all three always agree.
void dropGrey(OpacityImage& image) {
    std::vector<float>& t = image.texels;
    for (std::size_t i = 0; i < t.size(); i += 3)
        if (t[i] != t[i + 1] || t[i] != t[i + 2]) return;
    for (std::size_t i = 0; i < t.size(); i += 3)
        t[i / 3] = t[i];
    t.resize(t.size() / 3);
    image.channels = 1;
}

}  // namespace

std::string OddMaterials::list(std::size_t most) const {
    std::string text;
    std::size_t listed = 0;
    for (const std::string& name : names_) {
        if (listed++ == most)
            return base::concat(text, " and ", names_.size() - most, " more");
        text += base::concat(text.empty() ? "\"" : ", \"", name, "\"");
    }
    return text;
}

void OddMaterials::warn(const std::string& path, const char* what,
                        FrameWriter& out) const {
    if (names_.empty()) return;
    out.warning(base::concat(path, ": material ", list(1), ": ", what));
}

Materials::Materials(const std::string& path, const aiScene& scene, SourceFormat format,
                     const MeshFileOptions& options, FrameWriter& out)
    : path_(path),
      scene_(scene),
      options_(options),
      out_(out),
      cast_(scene.mNumMaterials),
      used_(scene.mNumMaterials),
      planned_(scene.mNumMaterials),
      asCollada_(format == SourceFormat::collada) {
    for (unsigned m = 0; m < scene.mNumMaterials; ++m) {
        MaterialOpacity stated = materialOpacity(*scene.mMaterials[m], format);
        if (options.opacity) {
            stated.takenForOpaque = false;
            // A mask's number decides what is there; the override, how opaque that is.
            if (stated.cutoff < 0.0f) stated.value = *options.opacity;
        }
        stated_.push_back(std::move(stated));
        castConstant(m);
    }
    replaceTextures();
}

void Materials::replaceTextures() {
    for (const MaterialTexture& given : options_.textures) {
        const NameFilter filter({given.material}, {});
        for (unsigned m = 0; m < scene_.mNumMaterials; ++m) {
            const aiString name = scene_.mMaterials[m]->GetName();
            const char* const names[] = {name.C_Str()};
            if (!filter.passes(names)) continue;
            stated_[m].texture.reset();
            stated_[m].guessed = false;
            if (given.image.empty()) continue;
            TextureUse& use = stated_[m].texture.emplace();
            use.image = given.image;
            use.given = use.madeForOpacity = true;
        }
        for (const std::string& pattern : filter.unmatched())
            unmatched_.push_back(pattern);
    }
}

void Materials::castConstant(unsigned material) {
    const MaterialOpacity& stated = stated_[material];
    CastMaterial& cast = cast_[material];
    cast.opacity = stated.cut(stated.value);
    if (stated.cutoff >= 0.0f) cast.opacity *= options_.opacity.value_or(1.0f);
    if (options_.color && cast.opacity < 1.0f) cast.tint = stated.tint;
}

void Materials::use(const aiMesh& mesh) {
    const unsigned m = mesh.mMaterialIndex;
    used_[m] = true;
    const auto& texture = stated_[m].texture;
    // Who gives textures knows of those that the file lacks.
    if (!texture && options_.textures.empty() && mesh.mTextureCoords[0] &&
        !hasImages(*scene_.mMaterials[m]) && (asCollada_ || stated_[m].cutoff >= 0.0f))
        noImage_.add(*scene_.mMaterials[m]);
    if (!texture) return;
    if (!coordinates(mesh, texture->uvChannel)) {
        if (!stated_[m].guessed) noUvs_.add(*scene_.mMaterials[m]);
    } else if (!planned_[m]) {
        planned_[m] = true;
        plan(m);
    }
}

void Materials::plan(unsigned material) {
    const MaterialOpacity& stated = stated_[material];
    const TextureUse& texture = *stated.texture;
    if (stated.guessed && !mayHaveAlpha(texture.image)) return;
    const bool asItIs =
        texture.given || scene_.GetEmbeddedTexture(texture.image.c_str()) != nullptr;
    Job job{asItIs ? texture.image : findImage(path_, texture.image),
            {texture.madeForOpacity, options_.color && texture.coloured},
            {material}};
    if (job.image.empty())
        return complain(material, texture.image, "there is no such file");
    for (Job& other : jobs_) {
        if (other.image != job.image ||
            other.wanted.orBrightness != job.wanted.orBrightness)
            continue;
        other.wanted.colours |= job.wanted.colours;
        other.materials.push_back(material);
        return;
    }
    jobs_.push_back(std::move(job));
}

Result<AlphaImage> Materials::read(const Job& job) const {
    const aiTexture* embedded = scene_.GetEmbeddedTexture(job.image.c_str());
    if (!embedded) return readAlpha(job.image, job.wanted);
    const auto* bytes = reinterpret_cast<const std::uint8_t*>(embedded->pcData);
    if (embedded->mHeight == 0)
        return readAlpha({bytes, embedded->mWidth}, embedded->achFormatHint, job.wanted);
    std::vector<std::uint8_t> rgba;
    const std::size_t count = std::size_t(embedded->mWidth) * embedded->mHeight;
    for (std::size_t i = 0; i < count; ++i) {
        const aiTexel& t = embedded->pcData[i];
        rgba.insert(rgba.end(), {t.r, t.g, t.b, t.a});
    }
    return alphaOfTexels(embedded->mWidth, embedded->mHeight, rgba, job.wanted);
}

Status Materials::sendTextures() {
    for (const Job& job : jobs_) {
        const Result<AlphaImage> image = read(job);
        if (image) {
            finish(job, *image);
            continue;
        }
        for (const unsigned m : job.materials)
            if (stated_[m].texture->given)
                return base::makeError(
                    ErrorCode::io, job.image,
                    ": cannot be used as a texture: ", image.error().message);
        const unsigned m = job.materials.front();
        complain(m, stated_[m].texture->image, image.error().message);
    }
    return {};
}

/// Opacities from alphas. A single number multiplies them all, so that it need not be
/// worked into each; colours are, for what they do depends on the alpha.
OpacityImage Materials::textureOf(unsigned material, const AlphaImage& image) const {
    const MaterialOpacity& stated = stated_[material];
    const TextureUse& use = *stated.texture;
    OpacityImage out{image.width, image.height, 1,     {},
                     use.wrapU,   use.wrapV,    -1.0f, stated.value};
    std::vector<float> alpha = image.alpha;
    if (use.inverted)
        for (float& a : alpha)
            a = 1.0f - a;
    const bool mask = stated.cutoff >= 0.0f;
    const bool tinted =
        options_.color && !mask && (use.coloured || stated.tint != glm::vec3(1.0f));
    if (mask) {
        // value * texel >= cutoff; nothing reaches a cutoff above 1.
        out.opacity = options_.opacity.value_or(1.0f);
        out.cutoff = stated.value > 0.0f    ? std::min(2.0f, stated.cutoff / stated.value)
                     : stated.cutoff > 0.0f ? 2.0f
                                            : 0.0f;
    }
    if (!tinted) {
        out.texels = std::move(alpha);
        return out;
    }
    out.channels = 3;
    out.opacity = 1.0f;
    out.texels.reserve(3 * alpha.size());
    for (std::size_t i = 0; i < alpha.size(); ++i) {
        const glm::vec3 tint =
            use.coloured ? stated.tint * image.colours[i] : stated.tint;
        const glm::vec3 stopped = channelOpacity(stated.value * alpha[i], tint);
        for (int c = 0; c < 3; ++c)
            out.texels.push_back(std::clamp(stopped[c], 0.0f, 1.0f));
    }
    dropGrey(out);
    return out;
}

void Materials::finish(const Job& job, const AlphaImage& image) {
    std::vector<std::pair<OpacityImage, std::uint32_t>> made;  // and its number
    for (const unsigned m : job.materials) {
        const MaterialOpacity& stated = stated_[m];
        CastMaterial& cast = cast_[m];
        if (!image.hasAlpha && !stated.texture->madeForOpacity) {
            if (stated.guessed) continue;
            if (cast.opacity == 1.0f) noAlpha_.add(*scene_.mMaterials[m]);
        }
        OpacityImage texture = textureOf(m, image);
        // One that says nothing is no texture.
        if (stated.value > 0.0f && opaque(texture)) {
            cast.opacity = texture.opacity;
            cast.tint = glm::vec3(1.0f);
            continue;
        }
        if (stated.guessed) guessed_.add(*scene_.mMaterials[m]);
        cast.uvChannel = stated.texture->uvChannel;
        cast.transform = stated.texture->transform;
        const auto same = std::find_if(made.begin(), made.end(), [&](const auto& other) {
            return sameUse(other.first, texture);
        });
        if (same != made.end()) {
            cast.texture = same->second;
            continue;
        }
        out_.texture(texture);
        cast.texture = sent_++;
        made.emplace_back(std::move(texture), cast.texture);
    }
}

std::vector<glm::vec2> Materials::uvs(const aiMesh& mesh) const {
    const CastMaterial& cast = of(mesh);
    const aiVector3D* from = coordinates(mesh, cast.uvChannel);
    if (cast.texture == kNoTexture || !from) return {};
    std::vector<glm::vec2> uvs(mesh.mNumVertices);
    for (unsigned i = 0; i < mesh.mNumVertices; ++i)
        uvs[i] = glm::vec2(cast.transform({from[i].x, from[i].y}));
    return uvs;
}

void Materials::complain(unsigned material, const std::string& image,
                         const std::string& why) {
    if (++complaints_ > kMostComplaints) return;
    const aiString given = scene_.mMaterials[material]->GetName();
    const char* const name = given.C_Str();
    out_.warning(base::concat(
        path_, ": material \"", name, "\": its texture ", image, " is not used: ", why,
        "; it casts without; give another with --texture '", asPattern(name), "=IMAGE'"));
}

void Materials::warn() const {
    if (complaints_ > kMostComplaints)
        out_.warning(base::concat(path_, ": ", complaints_ - kMostComplaints,
                                  " more textures are not used"));
    OddMaterials all;
    for (unsigned m = 0; m < scene_.mNumMaterials; ++m)
        if (used_[m]) all.add(*scene_.mMaterials[m]);
    for (const std::string& pattern : unmatched_)
        out_.warning(
            base::concat(path_, ": no material's name matches the pattern \"", pattern,
                         "\"; case counts; materials there are: ", all.list(kMostNames)));
    if (const std::string names = noImage_.list(kMostNames); !names.empty())
        out_.warning(base::concat(
            path_, ": material ", names,
            ": there are texture coordinates for an image, but the file names none: it "
            "casts as a whole; if an image cuts it out, give it with --texture "
            "NAME=IMAGE"));
    OddMaterials takenForOpaque, transmissive;
    for (unsigned m = 0; m < scene_.mNumMaterials; ++m) {
        if (!used_[m]) continue;
        const aiMaterial& material = *scene_.mMaterials[m];
        if (stated_[m].takenForOpaque) takenForOpaque.add(material);
        if (stated_[m].transmissive && cast_[m].opacity == 1.0f)
            transmissive.add(material);
    }
    noAlpha_.warn(path_, "its texture has no alpha channel, so it casts as opaque", out_);
    guessed_.warn(path_,
                  "the alpha of its colour texture counts as opacity, though the file "
                  "names no texture for that",
                  out_);
    noUvs_.warn(path_,
                "it has a texture for its opacity, but a mesh of it has no texture "
                "coordinates: that one casts without",
                out_);
    transmissive.warn(path_,
                      "it is glass by KHR_materials_transmission, which casts as opaque; "
                      "alpha mode BLEND says how opaque glass is",
                      out_);
    takenForOpaque.warn(
        path_, "its opacity of 0 is taken for 1, as COLLADA exporters often mean that",
        out_);
}

}  // namespace mtsm::scene
