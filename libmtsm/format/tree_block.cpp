#include "format/tree_block.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <utility>

#include "base/bytes.h"
#include "base/parallel.h"
#include "format/bad_file.h"
#include "format/first_error.h"
#include "format/frame.h"
#include "format/layout.h"
#include "format/near_parts.h"
#include "trace/density_tree.h"
#include "trace/fits_trees.h"
#include "trace/patch_tree.h"

namespace mtsm::format {
namespace {

using trace::DensityLevel;
using trace::DensityPyramid;
using trace::DensityTree;
using trace::PatchGroup;
using trace::PatchList;
using trace::PatchTree;

// --- records as they are stored
// ------------------------------------------------------------------------------

/// Numbers of a record that are stored together, `count` of `bytes` bytes each.
struct Column {
    std::size_t offset, bytes, count;
};

#define MTSM_COLUMN(field)                                            \
    Column {                                                          \
        offsetof(PatchGroup, field), sizeof(PatchGroup::field) / 4, 4 \
    }
constexpr Column kGroupColumns[] = {
    MTSM_COLUMN(w),           MTSM_COLUMN(above),     MTSM_COLUMN(below),
    MTSM_COLUMN(u0),          MTSM_COLUMN(v0),        MTSM_COLUMN(u1),
    MTSM_COLUMN(v1),          MTSM_COLUMN(gradientU), MTSM_COLUMN(gradientV),
    MTSM_COLUMN(residual),    MTSM_COLUMN(children),  MTSM_COLUMN(cover),
    MTSM_COLUMN(childGroups), MTSM_COLUMN(kind)};
#undef MTSM_COLUMN
constexpr Column kNumberColumns[] = {{0, 4, 1}};
constexpr Column kHalfColumns[] = {{0, 2, 1}};
constexpr Column kPairColumns[] = {{0, 4, 1}, {4, 4, 1}};

/// An array of records that lie one after another in memory.
template <typename Byte>
struct Array {
    Byte* bytes;
    std::uint64_t count;
    std::size_t size;  // of a record
    std::span<const Column> columns;

    [[nodiscard]] std::uint64_t perPart() const { return kTreePartBytes / size; }
    [[nodiscard]] std::uint64_t parts() const {
        return count / perPart() + (count % perPart() != 0);
    }
    [[nodiscard]] std::uint64_t first(std::uint64_t part) const {
        return part * perPart();
    }
    [[nodiscard]] std::size_t inPart(std::uint64_t part) const {
        return std::size_t(std::min(perPart(), count - first(part)));
    }
};

/// A list of a tile in two numbers.
struct ListRecord {
    std::uint32_t group;
    std::uint32_t groupsAndSlots;  ///< slots above kGroupBits
};

/// Texels with the length of their lists in place of where they begin.
struct TexelRecord {
    std::uint32_t range;
    std::uint32_t words;
};

/// The records of a part, column by column, each byte by byte, the lowest first.
void toColumns(const Array<const std::uint8_t>& array, std::uint64_t part,
               Bytes& content) {
    const std::size_t n = array.inPart(part);
    const std::uint8_t* const from = array.bytes + array.first(part) * array.size;
    content.resize(n * array.size);
    std::uint8_t* out = content.data();
    for (const Column& c : array.columns) {
        for (std::size_t byte = 0; byte < c.bytes; ++byte) {
            for (std::size_t i = 0; i < n; ++i) {
                for (std::size_t k = 0; k < c.count; ++k)
                    *out++ = from[i * array.size + c.offset + k * c.bytes + byte];
            }
        }
    }
}

/// `count` numbers of which the bytes lie apart.
template <typename Number>
void join(const std::uint8_t* planes, std::size_t count, std::uint8_t* numbers) {
    for (std::size_t i = 0; i < count; ++i) {
        Number x = 0;
        for (std::size_t byte = 0; byte < sizeof(Number); ++byte)
            x = Number(x | Number(Number(planes[byte * count + i]) << (8 * byte)));
        std::memcpy(numbers + i * sizeof(Number), &x, sizeof x);
    }
}

/// Undoes toColumns(). `scratch`: for one column.
void fromColumns(BytesView content, const Array<std::uint8_t>& array, std::uint64_t part,
                 Bytes& scratch) {
    const std::size_t n = array.inPart(part);
    std::uint8_t* const to = array.bytes + array.first(part) * array.size;
    const std::uint8_t* from = content.data();
    for (const Column& c : array.columns) {
        const std::size_t numbers = n * c.count, step = c.bytes * c.count;
        const bool alone = step == array.size;
        if (!alone) reuse(scratch, n * step);
        std::uint8_t* const at = alone ? to : scratch.data();
        if (c.bytes == 4)
            join<std::uint32_t>(from, numbers, at);
        else if (c.bytes == 2)
            join<std::uint16_t>(from, numbers, at);
        else
            std::memcpy(at, from, numbers);
        for (std::size_t i = 0; !alone && i < n; ++i)
            std::memcpy(to + i * array.size + c.offset, at + i * step, step);
        from += numbers * c.bytes;
    }
}

template <typename T>
Array<std::uint8_t> arrayOf(std::vector<T>& records, std::span<const Column> columns) {
    return {reinterpret_cast<std::uint8_t*>(records.data()), records.size(), sizeof(T),
            columns};
}
template <typename T>
Array<const std::uint8_t> arrayOf(const std::vector<T>& records,
                                  std::span<const Column> columns) {
    return {reinterpret_cast<const std::uint8_t*>(records.data()), records.size(),
            sizeof(T), columns};
}

/// Part number `part` of an array.
template <typename Byte>
struct TreePart {
    const Array<Byte>* array;
    std::uint64_t part;

    [[nodiscard]] std::size_t contentBytes() const {
        return array->inPart(part) * array->size;
    }
};

template <typename Byte>
std::vector<TreePart<Byte>> partsOf(const std::vector<Array<Byte>>& arrays) {
    std::vector<TreePart<Byte>> parts;
    for (const Array<Byte>& array : arrays) {
        for (std::uint64_t part = 0; part < array.parts(); ++part)
            parts.push_back({&array, part});
    }
    return parts;
}

// --- writing
// -------------------------------------------------------------------------------

using Written = std::vector<Array<const std::uint8_t>>;

/// What of a face's tree is stored in another form.
struct Records {
    std::vector<ListRecord> tiles;  // of all levels
    std::vector<TexelRecord> texels[2];
};

/// Writes a face's record, and appends its arrays.
void put(const PatchTree& tree, Records& records, base::ByteWriter& out,
         Written& arrays) {
    const PatchTree::Content& c = tree.content();
    out.put(PatchTreeRecord{c.groups.size(), c.covers.size(), c.lowest, c.highest,
                            c.pieceSize, 0});
    for (const PatchTree::Level& level : c.levels) {
        for (const PatchList& list : level.tiles)
            records.tiles.push_back(
                {list.group, std::uint32_t(list.groups) | std::uint32_t(list.slots)
                                                              << PatchGroup::kGroupBits});
    }
    arrays.push_back(arrayOf(std::as_const(records.tiles), kPairColumns));
    arrays.push_back(arrayOf(c.groups, kGroupColumns));
    arrays.push_back(arrayOf(c.covers, kHalfColumns));
}

void put(const DensityTree& tree, Records& records, base::ByteWriter& out,
         Written& arrays) {
    const DensityPyramid* const pyramids[] = {&tree.media(), &tree.sheets()};
    for (int i = 0; i < 2; ++i) {
        const DensityPyramid& pyramid = *pyramids[i];
        if (pyramid.empty()) {
            out.put(PyramidRecord{});
            continue;
        }
        out.put(PyramidRecord{1, pyramid.low, pyramid.high, 0});
        std::vector<TexelRecord>& texels = records.texels[i];
        for (const DensityLevel& level : pyramid.levels) {
            if (level.texels.empty()) continue;
            out.put(
                DensityLevelRecord{level.texels.back().begin, level.base, level.step});
            for (std::size_t t = 0; t < level.texelCount(); ++t)
                texels.push_back({level.texels[t].range, level.words(t)});
        }
        arrays.push_back(arrayOf(std::as_const(texels), kPairColumns));
        for (const DensityLevel& level : pyramid.levels) {
            if (level.texels.empty()) continue;
            arrays.push_back(arrayOf(level.slabs, kNumberColumns));
            arrays.back().count = level.texels.back().begin;  // not the vectors' room
        }
    }
}

template <typename Tree>
Bytes encode(const std::vector<Tree>& trees, TreeKind kind, Codec codec, int level) {
    Bytes payload;
    base::ByteWriter out(payload);
    out.put(
        TreeFixed{kTreeRevision, std::uint32_t(kind), std::uint32_t(trees.size()), 0});
    std::vector<Records> records(trees.size());
    Written arrays;
    for (std::size_t face = 0; face < trees.size(); ++face)
        put(trees[face], records[face], out, arrays);
    const auto parts = partsOf(arrays);
    std::vector<Bytes> content(parts.size());
    base::parallelFor(std::size_t(0), parts.size(), [&](std::size_t i) {
        toColumns(*parts[i].array, parts[i].part, content[i]);
        content[i] = compressPart(std::move(content[i]), 0, codec, level).bytes;
    });
    for (const Bytes& part : content)
        out.put(std::uint32_t(part.size()));
    for (const Bytes& part : content)
        out.bytes(part);
    return payload;
}

// --- reading
// -------------------------------------------------------------------------------

/// A face while its parts come; one kind of trees.
struct FaceTrees {
    PatchTree::Content patches;
    DensityPyramid pyramids[2];  // media, sheets
    Records records;
};

/// Its arrays, in the order of the file.
void addArrays(FaceTrees& face, TreeKind kind, std::vector<Array<std::uint8_t>>& arrays) {
    if (kind == TreeKind::patches) {
        arrays.push_back(arrayOf(face.records.tiles, kPairColumns));
        arrays.push_back(arrayOf(face.patches.groups, kGroupColumns));
        arrays.push_back(arrayOf(face.patches.covers, kHalfColumns));
        return;
    }
    for (int i = 0; i < 2; ++i) {
        arrays.push_back(arrayOf(face.records.texels[i], kPairColumns));
        for (DensityLevel& level : face.pyramids[i].levels)
            arrays.push_back(arrayOf(level.slabs, kNumberColumns));
    }
}

/// Reads a block, of which the first bytes are known to be right.
class Decoder {
  public:
    Decoder(BytesView payload, std::uint64_t most, const ShadowMap& map)
        : in_(payload),
          most_(most),
          map_(map),
          kind_(map.isOpaque() ? TreeKind::patches : TreeKind::densities),
          faces_(map.faceCount()) {}

    Status run() {
        (void)in_.get<TreeFixed>();
        for (std::size_t f = 0; f < faces_.size(); ++f) {
            auto s = kind_ == TreeKind::patches ? getPatches(faces_[f])
                                                : getPyramids(faces_[f]);
            if (!s) return bad("face ", f, ": ", s.error().message);
        }
        if (!in_.ok()) return bad("ends within what it says of its trees");
        if (auto s = checkMemory(); !s) return s;
        if (auto s = getParts(); !s) return s;
        return kind_ == TreeKind::patches ? hold<PatchTree>(trace::holdPatchTrees)
                                          : hold<DensityTree>(trace::holdDensityTrees);
    }

  private:
    // Numbers that the file decides are proved before there is memory for what they
    // count: `sizes_` are those of the arrays to come.
    using Part = TreePart<std::uint8_t>;
    struct Size {
        std::uint64_t count;
        std::size_t bytes;  // of a record
    };

    Status getPatches(FaceTrees& face) {
        const auto r = in_.get<PatchTreeRecord>();
        if (r.reserved != 0) return bad("reserved bytes are not zero");
        if (r.groups >> PatchGroup::kGroupBits || r.covers >> 32)
            return bad(r.groups, " groups and ", r.covers, " rows of texels");
        PatchTree::Content& c = face.patches;
        c.lowest = r.lowest, c.highest = r.highest, c.pieceSize = r.pieceSize;
        c.levels = PatchTree::levelsOf(map_.info().width, map_.info().height);
        std::uint64_t tiles = 0;
        for (const PatchTree::Level& level : c.levels)
            tiles += level.tiles.size();
        sizes_.push_back({tiles, sizeof(ListRecord)});
        sizes_.push_back({r.groups, sizeof(PatchGroup)});
        sizes_.push_back({r.covers, sizeof(std::uint16_t)});
        return {};
    }

    Status getPyramids(FaceTrees& face) {
        for (DensityPyramid& pyramid : face.pyramids) {
            const auto r = in_.get<PyramidRecord>();
            if (r.present > 1 || r.reserved != 0 || (r.present && !(r.low < r.high)))
                return bad("a pyramid of depths from ", r.low, " to ", r.high,
                           " is there ", r.present, " times");
            pyramid.low = r.low, pyramid.high = r.high;
            if (!r.present) {
                pyramid = {};
                sizes_.push_back({0, sizeof(TexelRecord)});
                continue;
            }
            pyramid.levels =
                DensityPyramid::levelsOf(map_.info().width, map_.info().height,
                                         trace::receiverOptions(map_).finest);
            std::uint64_t texels = 0;
            for (const DensityLevel& level : pyramid.levels)
                texels += level.texelCount();
            sizes_.push_back({texels, sizeof(TexelRecord)});
            for (DensityLevel& level : pyramid.levels) {
                DensityLevelRecord l{};
                if (level.width > 0) l = in_.get<DensityLevelRecord>();
                if (l.words >> 32) return bad("a level of ", l.words, " words of slabs");
                level.base = l.base, level.step = l.step;
                sizes_.push_back({l.words, sizeof(std::uint32_t)});
            }
        }
        return {};
    }

    /// Of all arrays, the work of each thread, and what is known of parts.
    Status checkMemory() const {
        std::uint64_t bytes = 0, parts = 0;
        for (const Size& size : sizes_) {
            bytes += size.count * size.bytes;
            parts += size.count / (kTreePartBytes / size.bytes) + 1;
        }
        const auto threads =
            static_cast<std::uint64_t>(tbb::this_task_arena::max_concurrency());
        // Lists and texels once more, as they come; marks of patches.
        bytes = 2 * bytes + threads * 2 * kTreePartBytes +
                parts * (sizeof(Part) + sizeof(BytesView) + sizeof(std::uint32_t));
        if (bytes > most_)
            return base::makeError(ErrorCode::tooLarge, "takes ", bytes,
                                   " bytes to decode, more than the ", most_,
                                   " that ReadLimits::maxBytes leaves for it");
        return {};
    }

    void makeRoom() {
        auto size = sizes_.begin();
        for (FaceTrees& face : faces_) {
            if (kind_ == TreeKind::patches) {
                face.records.tiles.resize(size++->count);
                face.patches.groups.resize(size++->count);
                face.patches.covers.resize(size++->count);
                continue;
            }
            for (int i = 0; i < 2; ++i) {
                face.records.texels[i].resize(size++->count);
                for (DensityLevel& level : face.pyramids[i].levels) {
                    if (level.width > 0) level.texels.resize(level.texelCount() + 1);
                    // One allocation, room for vectors included.
                    level.slabs.reserve(size->count + trace::kLanes);
                    level.slabs.resize(size++->count);
                }
            }
        }
    }

    Status getParts() {
        std::uint64_t count = 0;
        for (const Size& size : sizes_) {
            const std::uint64_t perPart = kTreePartBytes / size.bytes;
            count += size.count / perPart + (size.count % perPart != 0);
        }
        // Each has a length and a byte at least.
        if (count > in_.left() / 5)
            return bad("claims ", count, " parts, more than the block can hold");
        makeRoom();
        std::vector<Array<std::uint8_t>> arrays;
        for (FaceTrees& face : faces_)
            addArrays(face, kind_, arrays);
        const std::vector<Part> parts = partsOf(arrays);
        std::vector<std::uint32_t> lengths(parts.size());
        for (std::uint32_t& length : lengths)
            length = in_.get<std::uint32_t>();
        std::vector<BytesView> bytes(parts.size());
        for (std::size_t i = 0; i < parts.size(); ++i) {
            const std::size_t content = parts[i].contentBytes();
            if (lengths[i] < 1 || lengths[i] > content)
                return bad("part ", i, ": stores ", lengths[i], " bytes for ", content);
            bytes[i] = in_.bytes(lengths[i]);
            if (!in_.ok()) return bad("part ", i, ": reaches past the end");
        }
        if (in_.left() != 0) return bad(in_.left(), " bytes are left over at its end");
        return decodeParts(parts, bytes);
    }

    static Status decodeParts(const std::vector<Part>& parts,
                              const std::vector<BytesView>& bytes) {
        struct Worker {
            FrameDecoder frames;
            Bytes content, scratch;
        };
        tbb::enumerable_thread_specific<Worker> workers;
        FirstError firstError;
        base::parallelFor(std::size_t(0), parts.size(), [&](std::size_t i) {
            if (firstError.isBehind(i)) return;
            Worker& worker = workers.local();
            BytesView content = bytes[i];
            if (content.size() < parts[i].contentBytes()) {
                if (const Status s = worker.frames.decode(
                        content, parts[i].contentBytes(), worker.content);
                    !s) {
                    firstError.add(i, bad("part ", i, ": ", s.error().message));
                    return;
                }
                content = worker.content;
            }
            fromColumns(content, *parts[i].array, parts[i].part, worker.scratch);
        });
        return firstError.status();
    }

    Result<PatchTree> made(FaceTrees& face, std::uint32_t, const PatchTree*) const {
        auto list = face.records.tiles.begin();
        constexpr std::uint32_t kGroups = (1u << PatchGroup::kGroupBits) - 1;
        for (PatchTree::Level& level : face.patches.levels) {
            for (PatchList& tile : level.tiles) {
                tile = {list->group, list->groupsAndSlots & kGroups,
                        list->groupsAndSlots >> PatchGroup::kGroupBits};
                ++list;
            }
        }
        return PatchTree::restore(std::move(face.patches), map_.info().width,
                                  map_.info().height);
    }

    Result<DensityTree> made(FaceTrees& face, std::uint32_t number,
                             const DensityTree*) const {
        for (int i = 0; i < 2; ++i) {
            auto texel = face.records.texels[i].begin();
            for (DensityLevel& level : face.pyramids[i].levels) {
                if (level.texels.empty()) continue;
                std::uint32_t begin = 0;
                for (std::size_t t = 0; t < level.texelCount(); ++t, ++texel) {
                    level.texels[t] = {texel->range, begin};
                    begin += texel->words;
                }
                level.texels.back().begin = begin;
                level.slabs.resize(level.slabs.size() + trace::kLanes);
            }
        }
        return DensityTree::restore(map_, number, trace::receiverOptions(map_),
                                    std::move(face.pyramids[0]),
                                    std::move(face.pyramids[1]));
    }

    template <typename Tree>
    Status hold(void (*give)(const ShadowMap&, std::vector<Tree>)) {
        std::vector<Tree> trees;
        for (std::uint32_t f = 0; f < faces_.size(); ++f) {
            Result<Tree> tree = made(faces_[f], f, static_cast<const Tree*>(nullptr));
            if (!tree) return bad("face ", f, ": ", tree.error().message);
            trees.push_back(*std::move(tree));
        }
        give(map_, std::move(trees));
        return {};
    }

    base::ByteReader in_;
    std::uint64_t most_;
    const ShadowMap& map_;
    TreeKind kind_;
    std::vector<FaceTrees> faces_;
    std::vector<Size> sizes_;
};

}  // namespace

Bytes encodeTrees(const ShadowMap& map, Codec codec, int level) {
    if (!trace::fitsTrees(map)) return {};
    if (map.isOpaque()) {
        const auto* const trees = trace::patchTrees(map);
        return trees ? encode(*trees, TreeKind::patches, codec, level) : Bytes();
    }
    const auto* const trees = trace::densityTrees(map, trace::DensityUse::receivers);
    return trees ? encode(*trees, TreeKind::densities, codec, level) : Bytes();
}

bool hasKnownTrees(BytesView payload) noexcept {
    const auto revision = base::ByteReader(payload).get<std::uint32_t>();
    return payload.size() < sizeof revision || revision == kTreeRevision;
}

bool areOfOpaque(BytesView payload) noexcept {
    return base::ByteReader(payload).get<TreeFixed>().kind ==
           std::uint32_t(TreeKind::patches);
}

Status decodeTrees(BytesView payload, std::uint64_t most, const ShadowMap& map) {
    const auto fixed = base::ByteReader(payload).get<TreeFixed>();
    const TreeKind kind = map.isOpaque() ? TreeKind::patches : TreeKind::densities;
    if (payload.size() < sizeof fixed)
        return bad("ends within its first ", sizeof fixed, " bytes");
    if (fixed.kind != std::uint32_t(kind))
        return bad("has trees of kind ", fixed.kind, ", the map's are ",
                   std::uint32_t(kind));
    if (fixed.faces != map.faceCount())
        return bad("has ", fixed.faces, " faces, not ", map.faceCount());
    if (fixed.reserved != 0) return bad("reserved bytes are not zero");
    if (!trace::fitsTrees(map))
        return bad("has trees of a map that is asked without them: of more than ",
                   trace::kMostLayers, " layers, or of six faces that are no cube's");
    return Decoder(payload, most, map).run();
}

}  // namespace mtsm::format
