// vdb_archive.h - an OpenVDB file inside the importing child: its grids, one of them
// read.
//
// OpenVDB does not notice where a file ends: reads beyond go through and leave what was
// there before. So it reads from a stream of ours, which at the end of the file says so
// to the parent and ends the child at once. Nor does anything here get destroyed: trees
// free their nodes in parallel, and the child must not wake threads.
#pragma once
#include <openvdb/io/Archive.h>
#include <openvdb/io/GridDescriptor.h>

#include <cstdint>
#include <istream>
#include <memory>
#include <streambuf>
#include <string>
#include <vector>

#include "scene/frames.h"

namespace mtsm::scene {

/// A file's bytes. What asks for more than there are does not come back.
class WholeFileBuffer final : public std::streambuf {
  public:
    /// A file that cannot be opened is one of 0 bytes.
    WholeFileBuffer(const std::string& path, FrameWriter& out);
    WholeFileBuffer(const WholeFileBuffer&) = delete;
    WholeFileBuffer& operator=(const WholeFileBuffer&) = delete;
    ~WholeFileBuffer() override;
    [[nodiscard]] std::int64_t size() const { return size_; }

  protected:
    int_type underflow() override;
    pos_type seekoff(off_type offset, std::ios_base::seekdir from,
                     std::ios_base::openmode) override;
    pos_type seekpos(pos_type position, std::ios_base::openmode mode) override;

  private:
    static constexpr std::int64_t kBuffer = 1 << 16;
    std::string path_;
    FrameWriter& out_;
    int fd_ = -1;
    std::int64_t size_ = 0, next_ = 0;  // next_: file position behind the buffer
    std::vector<char> buffer_;
};

/// Something to tell the parent in place of a volume.
struct Refusal {
    ErrorCode code;
    std::string text;
};

/// The grids of a file. Throws what OpenVDB throws, Refusal and std::runtime_error.
class VdbArchive final : public openvdb::io::Archive {
  public:
    struct Entry {
        openvdb::io::GridDescriptor descriptor;
        openvdb::GridBase::Ptr grid;  ///< its metadata, until read()
        bool read = false;

        [[nodiscard]] std::string name() const;       ///< "density"
        [[nodiscard]] std::string shownName() const;  ///< "density[1]" if there are more
        [[nodiscard]] bool isLevelSet() const;
        [[nodiscard]] bool isFloat() const;  ///< or double, or half
    };

    VdbArchive(const std::string& path, FrameWriter& out);
    /// In the file's order.
    [[nodiscard]] std::vector<Entry>& entries() { return entries_; }
    /// Reads the grid's transform and all its values.
    void read(Entry& entry);

  private:
    void checkMagic();
    void list();
    void listNext();

    WholeFileBuffer buffer_;
    std::istream in_;
    /// What in_ is tagged with: it keeps a pointer to this pointer.
    openvdb::io::StreamMetadata::Ptr ofStream_{new openvdb::io::StreamMetadata};
    std::vector<Entry> entries_;
};

}  // namespace mtsm::scene
