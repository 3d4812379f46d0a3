// Meshes out of a file: polygons cut, instances collected, names asked, oddities told.
#include <algorithm>
#include <cctype>
#include <cstdint>
#include <fstream>
#include <iomanip>
#include <set>
#include <string>
#include <vector>

#include "base/message.h"
#include "scene/assimp_scene.h"
#include "scene/name_filter.h"
#include "scene/ply.h"
#include "scene/polygon.h"
#include "scene/send.h"
#include "scene/send_materials.h"

namespace mtsm::scene {
namespace {

constexpr std::size_t kMostNames = 1000;

std::string count(std::uint64_t n, const char* one, const char* many) {
    return base::concat(n, " ", n == 1 ? one : many);
}

/// "1 a, 2 b and 3 c"
std::string joined(const std::vector<std::string>& parts) {
    std::string text;
    for (std::size_t i = 0; i < parts.size(); ++i) {
        if (i > 0) text += i + 1 == parts.size() ? " and " : ", ";
        text += parts[i];
    }
    return text;
}

/// What is in a scene beside triangles.
struct Census {
    std::uint64_t points = 0, lines = 0, triangles = 0;
    std::uint64_t bones = 0, morphTargets = 0, animations = 0;

    [[nodiscard]] std::string ignored() const {
        std::vector<std::string> parts;
        const auto add = [&](std::uint64_t n, const char* one, const char* many) {
            if (n > 0) parts.push_back(count(n, one, many));
        };
        add(points, "point", "points");
        add(lines, "line", "lines");
        add(bones, "bone", "bones");
        add(morphTargets, "morph target", "morph targets");
        add(animations, "animation", "animations");
        return joined(parts);
    }
};

/// A polygon counts as the triangles that it will give.
Census censusOf(const aiScene& scene) {
    Census census;
    census.animations = scene.mNumAnimations;
    for (unsigned m = 0; m < scene.mNumMeshes; ++m) {
        const aiMesh& mesh = *scene.mMeshes[m];
        census.bones += mesh.mNumBones;
        census.morphTargets += mesh.mNumAnimMeshes;
        if (mesh.mNumFaces == 0) census.points += mesh.mNumVertices;
        for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
            const unsigned corners = mesh.mFaces[f].mNumIndices;
            census.points += corners == 1;
            census.lines += corners == 2;
            census.triangles += corners > 2 ? corners - 2 : 0;
        }
    }
    return census;
}

/// Says which face refers to a vertex that its mesh does not have; empty if none does.
std::string indexOutOfRange(const aiScene& scene) {
    for (unsigned m = 0; m < scene.mNumMeshes; ++m) {
        const aiMesh& mesh = *scene.mMeshes[m];
        for (unsigned f = 0; f < mesh.mNumFaces; ++f)
            for (unsigned i = 0; i < mesh.mFaces[f].mNumIndices; ++i)
                if (mesh.mFaces[f].mIndices[i] >= mesh.mNumVertices)
                    return base::concat("face ", f, " of mesh \"", mesh.mName.C_Str(),
                                        "\" refers to vertex ",
                                        std::int64_t(int(mesh.mFaces[f].mIndices[i])),
                                        " of ", mesh.mNumVertices,
                                        "; re-export or repair the file");
    }
    return {};
}

/// Names that options.include and exclude could match, each once, in the file's order.
class NameList {
  public:
    void add(const char* name) {
        const std::string text(name);
        // FBX pivots become nodes of their own, which no one has named.
        if (text.empty() || text.find("$AssimpFbx$") != text.npos) return;
        if (inOrder_.size() < kMostNames && known_.insert(text).second)
            inOrder_.push_back(text);
    }
    [[nodiscard]] const std::vector<std::string>& inOrder() const { return inOrder_; }

  private:
    std::set<std::string> known_;
    std::vector<std::string> inOrder_;
};

/// Walks the nodes and notes where each mesh stands.
class Placement {
  public:
    Placement(const aiScene& scene, const NameFilter& filter)
        : scene_(scene), filter_(filter), places_(scene.mNumMeshes) {
        if (scene.mRootNode) visit(*scene.mRootNode, glm::dmat4(1.0));
    }
    /// [mesh]: transforms of the nodes that pass.
    [[nodiscard]] const std::vector<std::vector<glm::dmat4>>& places() const {
        return places_;
    }
    [[nodiscard]] bool anyPassed() const { return passed_; }
    [[nodiscard]] const std::vector<std::string>& names() const {
        return names_.inOrder();
    }

  private:
    void visit(const aiNode& node, const glm::dmat4& worldFromParent) {
        const glm::dmat4 world = worldFromParent * toDouble(node.mTransformation);
        path_.push_back(node.mName.C_Str());
        for (unsigned i = 0; i < node.mNumMeshes; ++i)
            place(node.mMeshes[i], world);
        for (unsigned i = 0; i < node.mNumChildren; ++i)
            visit(*node.mChildren[i], world);
        path_.pop_back();
    }
    void place(unsigned index, const glm::dmat4& world) {
        const aiMesh& mesh = *scene_.mMeshes[index];
        const aiString material = scene_.mMaterials[mesh.mMaterialIndex]->GetName();
        path_.push_back(mesh.mName.C_Str());
        path_.push_back(material.C_Str());
        if (filter_.passes(path_)) {
            places_[index].push_back(world);
            passed_ = true;
        }
        if (!passed_)  // nobody asks for names once something passes
            for (const char* name : path_)
                names_.add(name);
        path_.resize(path_.size() - 2);
    }

    const aiScene& scene_;
    const NameFilter& filter_;
    std::vector<std::vector<glm::dmat4>> places_;
    std::vector<const char*> path_;  // names that the visited node goes by
    NameList names_;
    bool passed_ = false;
};

std::vector<std::uint32_t> triangleIndices(const aiMesh& mesh, PolygonCutter& cutter) {
    std::vector<std::uint32_t> indices;
    indices.reserve(std::size_t(3) * mesh.mNumFaces);
    for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
        const aiFace& face = mesh.mFaces[f];
        if (face.mNumIndices >= 3)
            cutter.cut({face.mIndices, face.mNumIndices}, mesh.mVertices, indices);
    }
    return indices;
}

Status sendPlaced(const aiScene& scene, const Placement& placement, Materials& materials,
                  FrameWriter& out) {
    static_assert(sizeof(aiVector3D) == 3 * sizeof(float));
    const auto placed = [&](const auto& visit) {
        for (unsigned m = 0; m < scene.mNumMeshes; ++m)
            if (!placement.places()[m].empty()) visit(*scene.mMeshes[m], m);
    };
    placed([&](const aiMesh& mesh, unsigned) { materials.use(mesh); });
    if (Status s = materials.sendTextures(); !s) return s;
    PolygonCutter cutter;
    placed([&](const aiMesh& mesh, unsigned m) {
        const auto indices = triangleIndices(mesh, cutter);
        if (indices.empty()) return;
        const CastMaterial& material = materials.of(mesh);
        const auto uvs = materials.uvs(mesh);
        std::vector<Instance> instances;
        for (const glm::dmat4& world : placement.places()[m])
            instances.push_back({world, material.opacity});
        out.mesh({&mesh.mVertices[0].x, std::size_t(3) * mesh.mNumVertices}, uvs, indices,
                 instances, uvs.empty() ? kNoTexture : material.texture, material.tint);
    });
    return {};
}

void failWithoutTriangles(const std::string& path, std::uint64_t points,
                          std::uint64_t lines, FrameWriter& out) {
    std::string message = path + ": no triangles";
    if (points + lines > 0)
        message += base::concat(": ", count(points, "point", "points"), " and ",
                                count(lines, "line", "lines"), " were ignored");
    out.failure(ErrorCode::badFile, message);
}

/// True if it was a PLY file that needs no importer, or none that one should see.
bool sendPly(const std::string& path, const NameFilter& filter,
             const MeshFileOptions& options, FrameWriter& out) {
    const PlyScan scan = scanPly(path);
    if (!scan.problem.empty()) {
        out.failure(ErrorCode::badFile, base::concat(path, ": ", scan.problem));
        return true;
    }
    if (!scan.hasStrips) return false;
    if (scan.stripTriangles.empty()) {
        failWithoutTriangles(path, scan.coordinates.size() / 3, 0, out);
        return true;
    }
    if (filter.passes({})) {
        const Instance place{glm::dmat4(1.0), options.opacity.value_or(1.0f)};
        out.mesh(scan.coordinates, scan.stripTriangles, {&place, 1});
    }
    out.end();
    return true;
}

/// The next word of an OFF file, its first characters; comments are passed over.
std::string offWord(std::istream& in) {
    constexpr int kMost = 18;  // digits of a number that 64 bits hold
    std::string word, comment;
    while (in >> std::setw(kMost) >> word) {
        const std::size_t mark = word.find('#');
        if (mark != word.npos) std::getline(in, comment);
        if (mark != 0) return word.substr(0, mark);
    }
    return {};
}

/// What is wrong with the numbers that an OFF file begins with, or nothing. The importer
/// makes room for as many vertices and faces before it looks for them.
std::string wrongOffCounts(const std::string& path) {
    std::ifstream in(path, std::ios::binary | std::ios::ate);
    const std::streamoff bytes = in.tellg();
    in.seekg(0);
    std::string word = offWord(in);
    // The keyword may be missing. Before the two, nOFF has the number of dimensions.
    int left = word.find('n') == word.npos ? 2 : 3;
    if (word.ends_with("OFF")) word = offWord(in);
    for (; left > 0; --left, word = offWord(in)) {
        if (word.empty() || word.find_first_not_of("0123456789") != word.npos) return {};
        if (std::stoll(word) > bytes)
            return base::concat("states ", word, " vertices or faces, more than its ",
                                bytes, " bytes can hold; re-export or repair the file");
    }
    return {};
}

/// `extension` of four characters, with its dot, in whatever case.
bool hasExtension(const std::string& path, std::string_view extension) {
    std::string tail = path.substr(path.size() - std::min<std::size_t>(4, path.size()));
    std::transform(tail.begin(), tail.end(), tail.begin(),
                   [](unsigned char c) { return char(std::tolower(c)); });
    return tail == extension;
}

}  // namespace

void sendMeshes(const std::string& path, const MeshFileOptions& options,
                FrameWriter& out) {
    const NameFilter filter(options.include, options.exclude);
    if (hasExtension(path, ".ply") && sendPly(path, filter, options, out)) return;

    const std::string wrong = hasExtension(path, ".off") ? wrongOffCounts(path) : "";
    if (!wrong.empty())
        return out.failure(ErrorCode::badFile, base::concat(path, ": ", wrong));
    AssimpScene file(path, out);
    if (!file.scene()) return;
    const std::string badIndex = indexOutOfRange(*file.scene());
    if (!badIndex.empty())
        return out.failure(ErrorCode::badFile, base::concat(path, ": ", badIndex));
    Census census = censusOf(*file.scene());
    if (options.linesAreStrands && hasExtension(path, ".obj")) census.lines = 0;
    if (census.triangles == 0)
        return failWithoutTriangles(path, census.points, census.lines, out);
    const Placement placement(*file.scene(), filter);
    Materials materials(path, *file.scene(), file.format(), options, out);
    if (Status s = sendPlaced(*file.scene(), placement, materials, out); !s)
        return out.failure(s.error().code, s.error().message);
    materials.warn();
    if (!placement.anyPassed()) {
        for (const std::string& name : placement.names())
            out.name(name);
    } else {
        for (const std::string& pattern : filter.unmatched())
            out.warning(base::concat(path, ": no name matches the pattern \"", pattern,
                                     "\"; case counts"));
    }
    if (const std::string ignored = census.ignored(); !ignored.empty())
        out.warning(base::concat(path, ": ignored ", ignored));
    out.end();
}

}  // namespace mtsm::scene
