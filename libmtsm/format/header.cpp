#include "format/header.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <set>
#include <string_view>

#include "base/bytes.h"
#include "base/checksum.h"
#include "base/message.h"
#include "base/utf8.h"
#include "format/bad_file.h"

namespace mtsm::format {
namespace {

using base::ByteReader;
using base::ByteWriter;
using base::makeError;

template <std::size_t N>
bool allZero(const std::array<std::uint8_t, N>& bytes) {
    return std::all_of(bytes.begin(), bytes.end(), [](auto b) { return b == 0; });
}

std::array<double, 3> pack(glm::dvec3 p) {
    return {p.x, p.y, p.z};
}
std::array<double, 2> pack(glm::dvec2 p) {
    return {p.x, p.y};
}
glm::dvec3 unpack(const std::array<double, 3>& p) {
    return {p[0], p[1], p[2]};
}
glm::dvec2 unpack(const std::array<double, 2>& p) {
    return {p[0], p[1]};
}

bool sameBits(float a, float b) {
    return std::bit_cast<std::uint32_t>(a) == std::bit_cast<std::uint32_t>(b);
}

std::string_view asText(BytesView bytes) {
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

Status putText(ByteWriter& out, std::string_view text, const char* what) {
    if (!base::isUtf8(text))
        return makeError(ErrorCode::badArgument, what, " is not UTF-8");
    if (text.size() > 0xffffffffu)
        return makeError(ErrorCode::badArgument, what, " has ", text.size(),
                         " bytes, more than 4294967295");
    out.put(static_cast<std::uint32_t>(text.size()));
    out.text(text);
    return {};
}

Status getText(ByteReader& in, std::string& text, const char* what) {
    const auto length = in.get<std::uint32_t>();
    const BytesView bytes = in.bytes(length);
    if (!in.ok()) return bad("the text \"", what, "\" reaches past the end");
    if (!base::isUtf8(asText(bytes))) return bad("the text \"", what, "\" is not UTF-8");
    text = asText(bytes);
    return {};
}

/// A later minor version may add fields at the end of a payload; this one has none.
Status checkEnd(const ByteReader& in, const Prefix& prefix) {
    if (in.left() != 0 && prefix.versionMinor == kVersionMinor)
        return bad(in.left(), " bytes are left over at its end");
    return {};
}

FaceRecord packFace(const Projection& p) {
    FaceRecord r = {};
    r.kind = static_cast<std::uint32_t>(p.kind);
    r.eye = pack(p.eye);
    r.right = pack(p.right);
    r.up = pack(p.up);
    r.forward = pack(p.forward);
    r.scale = pack(p.scale);
    r.offset = pack(p.offset);
    r.near = p.near;
    r.far = p.far;
    return r;
}

Projection unpackFace(const FaceRecord& r) {
    Projection p;
    p.kind = static_cast<ProjectionKind>(r.kind);
    p.eye = unpack(r.eye);
    p.right = unpack(r.right);
    p.up = unpack(r.up);
    p.forward = unpack(r.forward);
    p.scale = unpack(r.scale);
    p.offset = unpack(r.offset);
    p.near = r.near;
    p.far = r.far;
    return p;
}

}  // namespace

// --- prefix
// --------------------------------------------------------------------------------

Prefix makePrefix(const ShadowMap& map) {
    const MapInfo& info = map.info();
    Prefix p = {};
    p.magic = kMagic;
    p.versionMajor = kVersionMajor;
    p.versionMinor = kVersionMinor;
    p.prefixSize = sizeof(Prefix);
    p.width = info.width;
    p.height = info.height;
    p.faces = map.faceCount();
    p.channels = info.channels;
    p.tileSize = info.tileSize;
    const auto bytes = std::bit_cast<std::array<std::uint8_t, sizeof(Prefix)>>(p);
    p.checksum = base::checksum(BytesView(bytes).first(offsetof(Prefix, checksum)));
    return p;
}

Error ofItsVersion(Error error, std::uint16_t versionMinor) {
    if (error.code != ErrorCode::badFile || versionMinor <= kVersionMinor) return error;
    return makeError(ErrorCode::unsupported, "is of version ", kVersionMajor, ".",
                     versionMinor, ", newer than the ", kVersionMajor, ".", kVersionMinor,
                     " that this reader knows: ", error.message, "; use a newer libmtsm");
}

Error withWayOut(Error error) {
    if (error.code == ErrorCode::badFile)
        error.message += "; copy the file again or bake it again";
    return error;
}

namespace {

/// The fields of a prefix whose checksum and version are right.
Status checkPrefix(const Prefix& p) {
    if (p.prefixSize != sizeof(Prefix))
        return bad("prefix: says that it has ", p.prefixSize, " bytes, not ",
                   sizeof(Prefix));
    if (p.width < 1 || p.height < 1 || p.width > kMaxResolution ||
        p.height > kMaxResolution)
        return bad("prefix: ", p.width, " x ", p.height,
                   " pixels, each side must be 1 to ", kMaxResolution);
    if (p.faces != 1 && p.faces != 6)
        return bad("prefix: ", p.faces, " faces, must be 1 or 6");
    if (p.channels != 1 && p.channels != 3)
        return bad("prefix: ", p.channels, " visibility channels, must be 1 or 3");
    if (p.tileSize < 8 || p.tileSize > 256 || !std::has_single_bit(p.tileSize))
        return bad("prefix: tile size ", p.tileSize,
                   " is not a power of two from 8 to 256");
    if (!allZero(p.reserved)) return bad("prefix: reserved bytes are not zero");
    return {};
}

}  // namespace

Result<Prefix> decodePrefix(BytesView bytes) {
    // Magic and major version come first: nothing else of a newer file means anything.
    if (bytes.empty()) return withWayOut(bad("is empty, not an MTSM file"));
    const std::size_t begun = std::min(bytes.size(), kMagic.size());
    if (std::memcmp(bytes.data(), kMagic.data(), begun) != 0)
        return bad("is not an MTSM file: it does not begin with the magic of its prefix");
    ByteReader in(bytes.subspan(begun));
    const auto major = in.get<std::uint16_t>();
    const auto minor = in.get<std::uint16_t>();
    if (in.ok() && major > kVersionMajor)
        return makeError(ErrorCode::unsupported, "has format version ", major, ".", minor,
                         " by its prefix, and this library reads ", kVersionMajor,
                         ".x: a newer libmtsm is needed");
    if (bytes.size() < sizeof(Prefix))
        return withWayOut(bad("is cut off within its prefix: ", bytes.size(),
                              " bytes of ", sizeof(Prefix)));

    const auto p = ByteReader(bytes).get<Prefix>();
    if (p.checksum != base::checksum(bytes.first(offsetof(Prefix, checksum))))
        return withWayOut(bad("prefix: damaged, its checksum does not fit"));
    if (p.versionMajor != kVersionMajor)
        return withWayOut(
            bad("prefix: format version ", p.versionMajor, " has never been"));
    if (auto s = checkPrefix(p); !s)
        return withWayOut(ofItsVersion(s.error(), p.versionMinor));
    return p;
}

// --- HEAD
// ----------------------------------------------------------------------------------

std::uint64_t headFixedBytes(std::uint32_t faces) noexcept {
    return sizeof(HeadFixed) + std::uint64_t(faces) * sizeof(FaceRecord) +
           2 * sizeof(std::uint32_t);
}

Result<Bytes> encodeHead(const ShadowMap& map) {
    const MapInfo& info = map.info();
    HeadFixed h = {};
    h.depthMeaning = static_cast<std::uint32_t>(DepthMeaning::linearLightSpace);
    h.visibilityRule = static_cast<std::uint32_t>(info.translucent == Translucent::media
                                                      ? VisibilityRule::stepMedia
                                                      : VisibilityRule::stepSheets);
    h.lightShape = static_cast<std::uint32_t>(info.light.shape);
    h.lightPosition = pack(info.light.position);
    h.lightDirection = pack(info.light.direction);
    h.lightUp = pack(info.light.up);
    h.lightRadius = info.light.radius;
    h.lightSize = pack(info.light.size);
    h.lightAngularDiameter = info.light.angularDiameter;
    h.bias = info.bias;
    h.biasPerDepth = info.biasPerDepth;
    h.toleranceAsked = info.toleranceAsked;
    h.maxLayers = info.maxLayers;
    h.resets = info.resets;
    h.metresPerUnit = info.metresPerUnit;

    Bytes bytes;
    ByteWriter out(bytes);
    out.put(h);
    for (std::uint32_t face = 0; face < map.faceCount(); ++face)
        out.put(packFace(map.projection(face)));
    if (auto s = putText(out, info.software, "the text \"software\""); !s)
        return s.error();
    if (auto s = putText(out, info.settings, "the text \"settings\""); !s)
        return s.error();
    return bytes;
}

Status decodeHead(BytesView payload, const Prefix& prefix, MapInfo& info,
                  std::vector<MapFace>& faces) {
    ByteReader in(payload);
    const auto h = in.get<HeadFixed>();
    if (!in.ok())
        return bad("has ", payload.size(), " bytes, fewer than ", sizeof(HeadFixed));
    if (h.depthMeaning != std::uint32_t(DepthMeaning::linearLightSpace))
        return makeError(ErrorCode::unsupported, "depth meaning ", h.depthMeaning,
                         " is unknown: a newer libmtsm is needed");
    if (h.visibilityRule > std::uint32_t(VisibilityRule::stepMedia))
        return makeError(ErrorCode::unsupported, "visibility rule ", h.visibilityRule,
                         " is unknown: a newer libmtsm is needed");

    info.translucent = h.visibilityRule == std::uint32_t(VisibilityRule::stepMedia)
                           ? Translucent::media
                           : Translucent::sheets;
    info.width = prefix.width;
    info.height = prefix.height;
    info.tileSize = prefix.tileSize;
    info.channels = prefix.channels;
    info.light.shape = static_cast<LightShape>(h.lightShape);
    info.light.position = unpack(h.lightPosition);
    info.light.direction = unpack(h.lightDirection);
    info.light.up = unpack(h.lightUp);
    info.light.radius = h.lightRadius;
    info.light.size = unpack(h.lightSize);
    info.light.angularDiameter = h.lightAngularDiameter;
    info.bias = h.bias;
    info.biasPerDepth = h.biasPerDepth;
    info.toleranceAsked = h.toleranceAsked;
    info.maxLayers = h.maxLayers;
    info.resets = h.resets;
    info.metresPerUnit = h.metresPerUnit;
    for (std::size_t i = 0; i < faces.size(); ++i) {
        const auto r = in.get<FaceRecord>();
        if (!in.ok()) return bad("ends within the record of face ", i);
        if (r.reserved != 0) return bad("face ", i, ": reserved bytes are not zero");
        faces[i].projection = unpackFace(r);
    }
    if (auto s = getText(in, info.software, "software"); !s) return s;
    if (auto s = getText(in, info.settings, "settings"); !s) return s;
    return checkEnd(in, prefix);
}

// --- ATTR
// ----------------------------------------------------------------------------------

namespace {

Bytes valueBytes(const Attribute& a) {
    Bytes bytes;
    ByteWriter out(bytes);
    if (const auto* text = std::get_if<std::string>(&a.value)) out.text(*text);
    if (const auto* integer = std::get_if<std::int64_t>(&a.value)) out.put(*integer);
    if (const auto* doubles = std::get_if<std::vector<double>>(&a.value)) {
        for (double d : *doubles)
            out.put(d);
    }
    return bytes;
}

AttributeType typeOf(const Attribute& a) {
    if (std::holds_alternative<std::string>(a.value)) return AttributeType::text;
    if (std::holds_alternative<std::int64_t>(a.value)) return AttributeType::integer;
    return AttributeType::doubles;
}

/// The value of a known type.
Status decodeValue(AttributeType type, BytesView bytes, Attribute& a) {
    ByteReader in(bytes);
    switch (type) {
        case AttributeType::text:
            if (!base::isUtf8(asText(bytes)))
                return bad("attribute \"", a.name, "\": the text is not UTF-8");
            a.value = std::string(asText(bytes));
            return {};
        case AttributeType::integer:
            if (bytes.size() != sizeof(std::int64_t))
                return bad("attribute \"", a.name, "\": an integer of ", bytes.size(),
                           " bytes, not 8");
            a.value = in.get<std::int64_t>();
            return {};
        case AttributeType::doubles:
            if (bytes.size() % sizeof(double) != 0)
                return bad("attribute \"", a.name, "\": ", bytes.size(),
                           " bytes of doubles, no multiple of 8");
            std::vector<double> values(bytes.size() / sizeof(double));
            if (!values.empty()) std::memcpy(values.data(), bytes.data(), bytes.size());
            a.value = std::move(values);
            return {};
    }
    return {};
}

}  // namespace

Result<Bytes> encodeAttributes(const std::vector<Attribute>& attributes) {
    Bytes bytes;
    ByteWriter out(bytes);
    out.put(static_cast<std::uint32_t>(attributes.size()));
    out.put(std::uint32_t(0));
    for (const Attribute& a : attributes) {
        const auto* text = std::get_if<std::string>(&a.value);
        if (!base::isUtf8(a.name))
            return makeError(ErrorCode::badArgument,
                             "the name of an attribute is not UTF-8");
        if (text && !base::isUtf8(*text))
            return makeError(ErrorCode::badArgument, "attribute \"", a.name,
                             "\": the text is not UTF-8");
        const Bytes value = valueBytes(a);
        AttributeRecord r = {};
        r.type = static_cast<std::uint8_t>(typeOf(a));
        r.nameLength = static_cast<std::uint8_t>(a.name.size());
        r.valueLength = value.size();
        out.put(r);
        out.text(a.name);
        out.bytes(value);
    }
    return bytes;
}

Result<std::vector<Attribute>> decodeAttributes(BytesView payload, const Prefix& prefix) {
    ByteReader in(payload);
    const auto count = in.get<std::uint32_t>();
    const auto reserved = in.get<std::uint32_t>();
    if (!in.ok()) return bad("has ", payload.size(), " bytes, fewer than 8");
    if (reserved != 0) return bad("reserved bytes are not zero");
    std::vector<Attribute> attributes;
    std::set<std::string> names;
    for (std::uint32_t i = 0; i < count; ++i) {
        const auto r = in.get<AttributeRecord>();
        const BytesView name = in.bytes(r.nameLength);
        const BytesView value = in.bytes(r.valueLength);
        if (!in.ok()) return bad("attribute ", i, " of ", count, " reaches past the end");
        if (!allZero(r.reserved))
            return bad("attribute ", i, ": reserved bytes are not zero");
        Attribute a;
        a.name = asText(name);
        if (a.name.empty() || !base::isUtf8(a.name))
            return bad("attribute ", i, ": the name is empty or not UTF-8");
        if (!names.insert(a.name).second)
            return bad("attribute \"", a.name, "\" is there twice");
        if (r.type > std::uint8_t(AttributeType::doubles)) {
            if (prefix.versionMinor > kVersionMinor) continue;  // a type of later days
            return bad("attribute \"", a.name, "\": unknown type ", int(r.type));
        }
        if (auto s = decodeValue(AttributeType(r.type), value, a); !s) return s.error();
        attributes.push_back(std::move(a));
    }
    if (auto s = checkEnd(in, prefix); !s) return s.error();
    return attributes;
}

// --- TOTL
// ----------------------------------------------------------------------------------

ZRange wholeRange(const ShadowMap& map) noexcept {
    ZRange z;
    for (std::uint32_t face = 0; face < map.faceCount(); ++face)
        z.include(map.zRange(face));
    return z;
}

Bytes encodeTotals(const ShadowMap& map) {
    const ZRange z = wholeRange(map);
    Totals t = {};
    t.layers = map.layerCount();
    t.samples = map.info().samples;
    t.samplesDropped = map.info().samplesDropped;
    t.z = {z.min, z.max};
    t.toleranceReached = map.info().toleranceReached;
    t.flags = map.info().castersClipped ? kCastersClipped : 0;
    Bytes bytes;
    ByteWriter(bytes).put(t);
    return bytes;
}

Result<Totals> decodeTotals(BytesView payload, const Prefix& prefix, MapInfo& info) {
    ByteReader in(payload);
    const auto t = in.get<Totals>();
    if (!in.ok())
        return bad("has ", payload.size(), " bytes, fewer than ", sizeof(Totals));
    if (auto s = checkEnd(in, prefix); !s) return s.error();
    if (t.flags & ~kCastersClipped) return bad("unknown flags ", t.flags);
    info.samples = t.samples;
    info.samplesDropped = t.samplesDropped;
    info.toleranceReached = t.toleranceReached;
    info.castersClipped = t.flags & kCastersClipped;
    return t;
}

Status checkTotals(const Totals& totals, const ShadowMap& map) {
    if (totals.layers != map.layerCount())
        return bad("says ", totals.layers, " layers, the tiles hold ", map.layerCount());
    const ZRange z = wholeRange(map);
    if (!sameBits(totals.z.min, z.min) || !sameBits(totals.z.max, z.max))
        return bad("says depths from ", totals.z.min, " to ", totals.z.max,
                   ", the tiles hold ", z.min, " to ", z.max);
    return {};
}

}  // namespace mtsm::format
