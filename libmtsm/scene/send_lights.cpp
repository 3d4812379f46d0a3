// Lights out of a file, placed by their nodes.
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <map>
#include <string>
#include <vector>

#include "base/message.h"
#include "mtsm/light.h"
#include "scene/assimp_scene.h"
#include "scene/send.h"

namespace mtsm::scene {
namespace {

glm::dvec3 toDouble(const aiVector3D& v) {
    return {v.x, v.y, v.z};
}

using Transforms = std::map<std::string, std::vector<glm::dmat4>>;

/// The world transforms of all nodes without meshes, by name.
void collect(const aiNode& node, const glm::dmat4& worldFromParent, Transforms& out) {
    const glm::dmat4 world = worldFromParent * scene::toDouble(node.mTransformation);
    if (node.mNumMeshes == 0) out[node.mName.C_Str()].push_back(world);
    for (unsigned i = 0; i < node.mNumChildren; ++i)
        collect(*node.mChildren[i], world, out);
}

/// Full outer angle of a spot light's cone. Assimp hands on what the file says: glTF
/// states the angle from the axis to the edge, COLLADA and FBX the one from edge to edge.
/// COLLADA's is the falloff angle, which Assimp files as the inner one; it derives an
/// outer one from the falloff exponent, which is none of the cone's.
double coneAngle(const aiLight& light, SourceFormat format) {
    if (format == SourceFormat::gltf) return 2.0 * light.mAngleOuterCone;
    if (format == SourceFormat::collada) return light.mAngleInnerCone;
    return light.mAngleOuterCone;
}

glm::dvec3 anyAcross(glm::dvec3 d) {
    return std::abs(d.y) < 0.9 * glm::length(d) ? glm::dvec3(0, 1, 0)
                                                : glm::dvec3(0, 0, 1);
}

LightRecord recordOf(const aiLight& light, const glm::dmat4& world, SourceFormat format) {
    LightRecord record;
    const glm::dmat3 turn(world);
    record.position = glm::dvec3(world * glm::dvec4(toDouble(light.mPosition), 1.0));
    glm::dvec3 direction = toDouble(light.mDirection);
    if (direction == glm::dvec3(0.0)) direction = {0, -1, 0};
    glm::dvec3 up = toDouble(light.mUp);
    if (glm::length(glm::cross(direction, up)) < 1e-6) up = anyAcross(direction);
    record.direction = glm::normalize(turn * direction);
    record.up = glm::normalize(turn * up);
    if (light.mType == aiLightSource_DIRECTIONAL) record.shape = LightShape::sun;
    if (light.mType == aiLightSource_SPOT) record.fov = coneAngle(light, format);
    if (light.mType == aiLightSource_AREA) {
        record.shape = LightShape::rect;
        const glm::dvec3 right = glm::normalize(glm::cross(direction, up));
        record.width = light.mSize.x * glm::length(turn * right);
        record.height = light.mSize.y * glm::length(turn * glm::normalize(up));
    }
    return record;
}

bool usable(const LightRecord& record) {
    AreaLight light;
    light.shape = record.shape;
    light.position = record.position;
    light.direction = record.direction;
    light.up = record.up;
    light.size = {record.width, record.height};
    return checkLight(light).ok();
}

}  // namespace

void sendLights(const std::string& path, FrameWriter& out) {
    const AssimpScene file(path, out);
    if (!file.scene()) return;
    const aiScene& scene = *file.scene();
    Transforms transforms;
    if (scene.mRootNode) collect(*scene.mRootNode, glm::dmat4(1.0), transforms);

    std::map<std::string, std::size_t> met;  // lights of that name so far
    for (unsigned i = 0; i < scene.mNumLights; ++i) {
        const aiLight& light = *scene.mLights[i];
        const std::string stated = light.mName.C_Str();
        const std::string name = stated.empty() ? base::concat("light", i) : stated;
        // A light and its node share their name, and names need not be unique: the
        // n-th light of a name belongs to the n-th node of that name.
        const std::vector<glm::dmat4>& nodes = transforms[stated];
        const std::size_t rank = met[stated]++;
        if (light.mType == aiLightSource_AMBIENT ||
            light.mType == aiLightSource_UNDEFINED)
            continue;
        const glm::dmat4 world = rank < nodes.size() ? nodes[rank] : glm::dmat4(1.0);
        const LightRecord record = recordOf(light, world, file.format());
        if (usable(record))
            out.light(record, name);
        else
            out.warning(base::concat(path, ": light \"", name,
                                     "\" has no finite place or direction: ignored"));
    }
    out.end();
}

}  // namespace mtsm::scene
