// layout.h - every field, constant and limit of the MTSM file format 1.0, and no logic.
//
//     prefix | HEAD [ATTR] TILE... [NEAR] [HAIR] [CARD] [TREE] HIER TOTL INDX | trailer
//
// What the fields mean and what a reader checks is said in format-spec/mtsm-format.md;
// the names here are the names there. All numbers are little-endian, all floats IEEE 754.
// Each struct lies in memory as in the file: fields are naturally aligned, so there is no
// hidden padding, and the assertions below pin every size.
#pragma once
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <type_traits>

namespace mtsm::format {

static_assert(std::endian::native == std::endian::little,
              "records are copied as they lie in memory: a big-endian port must swap");
static_assert(std::numeric_limits<float>::is_iec559 &&
              std::numeric_limits<double>::is_iec559);

// --- versions and limits
// -------------------------------------------------------------------

inline constexpr std::uint16_t kVersionMajor = 1;
inline constexpr std::uint16_t kVersionMinor = 0;
inline constexpr std::uint64_t kAlignment = 8;         ///< of every block
inline constexpr std::uint32_t kMaxDirectory = 65536;  ///< blocks that are not tiles
inline constexpr std::uint32_t kMaxPlanes = 6;         ///< of a tile: counts, z, 3 v, n

// --- prefix: the first 64 bytes
// ------------------------------------------------------------

/// Not ASCII first, then CR LF and a lone SUB: transfers that mangle text break it.
inline constexpr std::array<std::uint8_t, 8> kMagic = {0x89, 0x4d, 0x54, 0x53,
                                                       0x4d, 0x0d, 0x0a, 0x1a};

struct Prefix {
    std::array<std::uint8_t, 8> magic;
    std::uint16_t versionMajor;
    std::uint16_t versionMinor;
    std::uint32_t prefixSize;  ///< 64
    std::uint32_t width;       ///< pixels per face
    std::uint32_t height;
    std::uint32_t faces;                    ///< 1 or 6
    std::uint32_t channels;                 ///< 1 or 3
    std::uint32_t tileSize;                 ///< 8, 16, 32, 64, 128 or 256
    std::array<std::uint8_t, 20> reserved;  ///< 0
    std::uint64_t checksum;                 ///< of the 56 bytes before it
};
static_assert(sizeof(Prefix) == 64 && offsetof(Prefix, width) == 16 &&
              offsetof(Prefix, reserved) == 36 && offsetof(Prefix, checksum) == 56);

// --- blocks
// --------------------------------------------------------------------------------

using BlockType = std::array<char, 4>;
inline constexpr BlockType kHead = {'H', 'E', 'A', 'D'};  ///< what the numbers mean
inline constexpr BlockType kAttr = {'A', 'T', 'T', 'R'};  ///< free attributes
inline constexpr BlockType kTile = {'T', 'I', 'L', 'E'};  ///< the layers of one tile
inline constexpr BlockType kNear = {'N', 'E', 'A', 'R'};  ///< triangles beside the layers
inline constexpr BlockType kHair = {'H', 'A', 'I', 'R'};  ///< strands beside the layers
inline constexpr BlockType kCard = {'C', 'A', 'R', 'D'};  ///< sheets beside the layers
inline constexpr BlockType kTree = {'T', 'R', 'E', 'E'};  ///< what queries go through
inline constexpr BlockType kHier = {'H', 'I', 'E', 'R'};  ///< min/max z above the tiles
inline constexpr BlockType kTotl = {'T', 'O', 'T', 'L'};  ///< what is known at the end
inline constexpr BlockType kIndx = {'I', 'N', 'D', 'X'};  ///< where everything lies

constexpr bool isOfNearField(BlockType type) {
    return type == kNear || type == kHair || type == kCard;
}

inline constexpr std::uint32_t kCritical = 1;  ///< BlockHeader::flags; the rest are 0

/// Is a reader that knows the type free to pass it over?
constexpr bool isAncillary(BlockType type) {
    return type == kAttr || type == kTree || isOfNearField(type);
}

/// Before each payload; zeros fill up to a multiple of 8 behind it.
struct BlockHeader {
    BlockType type;
    std::uint32_t flags;
    std::uint64_t length;           ///< of the payload, without the zeros
    std::uint64_t payloadChecksum;  ///< of the payload as stored
    std::uint64_t headerChecksum;   ///< of the 24 bytes before it
};
static_assert(sizeof(BlockHeader) == 32 && offsetof(BlockHeader, headerChecksum) == 24);

// --- HEAD
// ----------------------------------------------------------------------------------

enum class DepthMeaning : std::uint32_t { linearLightSpace = 0 };
enum class VisibilityRule : std::uint32_t { stepSheets = 0, stepMedia = 1 };

/// Start of the payload. FaceRecord x faces follow, then two texts: software, settings.
struct HeadFixed {
    std::uint32_t depthMeaning;
    std::uint32_t visibilityRule;
    std::uint32_t lightShape;
    float biasPerDepth;
    std::array<double, 3> lightPosition;
    std::array<double, 3> lightDirection;
    std::array<double, 3> lightUp;
    double lightRadius;
    std::array<double, 2> lightSize;
    double lightAngularDiameter;
    float bias;
    float toleranceAsked;
    std::uint32_t maxLayers;
    std::uint32_t resets;
    double metresPerUnit;
};
static_assert(sizeof(HeadFixed) == 144 && offsetof(HeadFixed, lightPosition) == 16 &&
              offsetof(HeadFixed, bias) == 120 &&
              offsetof(HeadFixed, metresPerUnit) == 136);

struct FaceRecord {
    std::uint32_t kind;      ///< 0 perspective, 1 orthographic
    std::uint32_t reserved;  ///< 0
    std::array<double, 3> eye;
    std::array<double, 3> right;
    std::array<double, 3> up;
    std::array<double, 3> forward;
    std::array<double, 2> scale;
    std::array<double, 2> offset;
    double near;
    double far;
};
static_assert(sizeof(FaceRecord) == 152 && offsetof(FaceRecord, scale) == 104 &&
              offsetof(FaceRecord, far) == 144);

// --- ATTR
// ----------------------------------------------------------------------------------

enum class AttributeType : std::uint8_t { text = 0, integer = 1, doubles = 2 };

/// The payload is a u32 count, four zero bytes, then per attribute this record, the name
/// and the value.
struct AttributeRecord {
    std::uint8_t type;
    std::uint8_t nameLength;               ///< 1..255
    std::array<std::uint8_t, 6> reserved;  ///< 0
    std::uint64_t valueLength;             ///< bytes
};
static_assert(sizeof(AttributeRecord) == 16);

// --- TILE
// ----------------------------------------------------------------------------------

/// Which of the planes that may be left out a tile has; counts and z are always there.
inline constexpr std::uint32_t kHasV = 1;  ///< absent: every v is 0
inline constexpr std::uint32_t kHasN = 2;  ///< absent: every n is 1

/// Start of the payload. PlaneRecord x planeCount follow, then the planes' bytes.
struct TileRecord {
    std::uint32_t face;
    std::uint32_t tx;
    std::uint32_t ty;
    std::uint16_t width;  ///< pixels, after cropping to the map
    std::uint16_t height;
    std::uint32_t layers;  ///< >= 1
    std::uint32_t planes;  ///< kHasV | kHasN
    std::uint32_t planeCount;
    std::uint32_t reserved;  ///< 0
};
static_assert(sizeof(TileRecord) == 32 && offsetof(TileRecord, layers) == 16);

enum class PlaneKind : std::uint8_t { counts = 0, z = 1, v = 2, n = 3 };
enum class PlaneEncoding : std::uint8_t { raw = 0, constant = 1, zstd = 2 };
enum class PlaneFilter : std::uint8_t { none = 0, shuffle = 1, gradient = 2, delta = 3 };

/// The filters that store differences from a guess (predict.h).
[[nodiscard]] constexpr bool isGuess(PlaneFilter f) noexcept {
    return f == PlaneFilter::gradient || f == PlaneFilter::delta;
}

struct PlaneRecord {
    std::uint8_t kind;
    std::uint8_t channel;  ///< of v; else 0
    std::uint8_t encoding;
    std::uint8_t filter;                   ///< only of zstd planes; else 0
    std::uint8_t elementSize;              ///< 1, 2 or 4 bytes; 4 for z and v
    std::uint8_t shift;                    ///< low bits that the content leaves out
    std::array<std::uint8_t, 2> reserved;  ///< 0
    std::uint32_t constant;                ///< bits of every element; else 0
    std::uint32_t reserved2;               ///< 0
    std::uint64_t storedLength;            ///< bytes in the file; 0 for a constant
    std::uint64_t decodedLength;           ///< elements x elementSize
};
static_assert(sizeof(PlaneRecord) == 32 && offsetof(PlaneRecord, constant) == 8 &&
              offsetof(PlaneRecord, decodedLength) == 24);

// --- HIER
// ----------------------------------------------------------------------------------

/// Start of the payload. DepthRange per node follow: by face, by level (tiles first, one
/// node last), by row.
struct HierarchyFixed {
    std::uint32_t faces;
    std::uint32_t levels;
};
static_assert(sizeof(HierarchyFixed) == 8);

struct DepthRange {
    float min;  ///< +infinity if there is no layer
    float max;  ///< -infinity if there is no layer
};
static_assert(sizeof(DepthRange) == 8);

// --- NEAR, HAIR, CARD
// ----------------------------------------------------------------------------------

inline constexpr std::uint32_t kMaxPartChunks = 4096;

/// Start of the payload. A u64 per face follows, its number of chunks; then NearPart x
/// parts; then the parts' bytes.
struct NearFixed {
    std::uint32_t faces;
    std::uint32_t partChunks;  ///< 1..kMaxPartChunks; only a face's last part has fewer
};
static_assert(sizeof(NearFixed) == 8);

struct NearPart {
    std::uint32_t points;  ///< NEAR: different corners, counted by chunk; HAIR: 0
    std::uint32_t storedLength;
};
static_assert(sizeof(NearPart) == 8);

/// CARD: a u32, the number of textures, a CardTexture for each and their stored texels; a
/// u64, the length of a payload as NEAR's, and that; one more to the end.
struct CardTexture {
    std::uint32_t width, height, wrapU, wrapV;
    float cutoff, opacity;
    std::uint64_t storedLength;
};
static_assert(sizeof(CardTexture) == 32);

// --- TREE
// ----------------------------------------------------------------------------------

/// Another number where a tree is made or followed in another way: readers then make
/// their own.
inline constexpr std::uint32_t kTreeRevision = 1;
inline constexpr std::uint32_t kTreePartBytes = 1u << 18;

enum class TreeKind : std::uint32_t { patches = 0, densities = 1 };

/// Start of the payload. By face a PatchTreeRecord, or for media and for sheets a
/// PyramidRecord and, if it is present, a DensityLevelRecord for each level from the
/// finest on; then a u32 for each part of each array, its stored length; then the parts.
struct TreeFixed {
    std::uint32_t revision;
    std::uint32_t kind;
    std::uint32_t faces;
    std::uint32_t reserved;  ///< 0
};
static_assert(sizeof(TreeFixed) == 16);

struct PatchTreeRecord {
    std::uint64_t groups;
    std::uint64_t covers;
    float lowest;
    float highest;
    float pieceSize;
    std::uint32_t reserved;  ///< 0
};
static_assert(sizeof(PatchTreeRecord) == 32);

struct PyramidRecord {
    std::uint32_t present;  ///< 0 or 1
    float low;
    float high;
    std::uint32_t reserved;  ///< 0
};
static_assert(sizeof(PyramidRecord) == 16);

struct DensityLevelRecord {
    std::uint64_t words;
    float base;
    float step;
};
static_assert(sizeof(DensityLevelRecord) == 16);

// --- TOTL
// ----------------------------------------------------------------------------------

inline constexpr std::uint32_t kCastersClipped = 1;  ///< Totals::flags; the rest are 0

struct Totals {
    std::uint64_t layers;
    std::uint64_t samples;
    std::uint64_t samplesDropped;
    DepthRange z;
    float toleranceReached;
    std::uint32_t flags;
};
static_assert(sizeof(Totals) == 40 && offsetof(Totals, toleranceReached) == 32);

// --- INDX
// ----------------------------------------------------------------------------------

/// Start of the payload. DirectoryEntry x blocks follow, then TileEntry x tiles.
struct IndexFixed {
    std::uint64_t prefixChecksum;  ///< Prefix::checksum again
    std::uint32_t blocks;
    std::uint32_t reserved;  ///< 0
    std::uint64_t tiles;     ///< faces x tile rows x tile columns
};
static_assert(sizeof(IndexFixed) == 24);

/// A block that is neither TILE nor INDX, in the order of the file.
struct DirectoryEntry {
    BlockType type;
    std::uint32_t flags;
    std::uint64_t offset;
    std::uint64_t length;
    std::uint64_t payloadChecksum;
};
static_assert(sizeof(DirectoryEntry) == 32);

/// [face][ty][tx]; all zero for a tile without layers.
struct TileEntry {
    std::uint64_t offset;
    std::uint64_t length;
    std::uint32_t layers;
    std::uint32_t planes;  ///< TileRecord::planes
    std::uint64_t payloadChecksum;
};
static_assert(sizeof(TileEntry) == 32);

// --- trailer: the last 32 bytes
// ------------------------------------------------------------

inline constexpr std::array<std::uint8_t, 8> kFinished = {'M', 'T', 'S', 'M',
                                                          ' ', 'E', 'N', 'D'};

struct Trailer {
    std::uint64_t indexOffset;
    std::uint64_t fileLength;
    std::array<std::uint8_t, 8> finished;
    std::uint64_t checksum;  ///< of the 24 bytes before it
};
static_assert(sizeof(Trailer) == 32 && offsetof(Trailer, checksum) == 24);

/// Bytes that a block with this payload takes: header, payload, zeros.
[[nodiscard]] constexpr std::uint64_t blockSpan(std::uint64_t length) noexcept {
    return (sizeof(BlockHeader) + length + kAlignment - 1) / kAlignment * kAlignment;
}

}  // namespace mtsm::format
