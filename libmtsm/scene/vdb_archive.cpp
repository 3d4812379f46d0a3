#include "scene/vdb_archive.h"

#include <fcntl.h>
#include <openvdb/openvdb.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <stdexcept>

#include "base/message.h"
#include "base/system_error.h"

namespace mtsm::scene {

// --- bytes
// -------------------------------------------------------------------------------

WholeFileBuffer::WholeFileBuffer(const std::string& path, FrameWriter& out)
    : path_(path), out_(out), fd_(open(path.c_str(), O_RDONLY | O_CLOEXEC)) {
    struct stat info {};
    if (fd_ >= 0 && fstat(fd_, &info) == 0) size_ = info.st_size;
    buffer_.resize(kBuffer);
}

WholeFileBuffer::~WholeFileBuffer() {
    if (fd_ >= 0) close(fd_);
}

WholeFileBuffer::int_type WholeFileBuffer::underflow() {
    ssize_t n = 0;
    do {
        n = pread(fd_, buffer_.data(), buffer_.size(), next_);
    } while (n < 0 && errno == EINTR);
    if (n < 0) {
        out_.failure(ErrorCode::io, base::concat(path_, ": cannot be read at byte ",
                                                 next_, ": ", base::systemReason(errno)));
        _exit(0);
    }
    if (n == 0) {
        out_.failure(
            ErrorCode::badFile,
            base::concat(path_, ": the file is cut off or damaged: a read at byte ",
                         next_, " met the end of its ", size_,
                         " bytes; copy or export it again"));
        _exit(0);
    }
    next_ += n;
    setg(buffer_.data(), buffer_.data(), buffer_.data() + n);
    return traits_type::to_int_type(*gptr());
}

WholeFileBuffer::pos_type WholeFileBuffer::seekoff(off_type offset,
                                                   std::ios_base::seekdir from,
                                                   std::ios_base::openmode mode) {
    const off_type here = next_ - (egptr() - gptr());
    if (from == std::ios_base::cur && offset == 0) return here;  // tellg()
    const off_type base = from == std::ios_base::beg   ? 0
                          : from == std::ios_base::cur ? here
                                                       : size_;
    if (offset > size_ - base) return seekpos(size_, mode);  // the next read ends it
    return seekpos(base + offset, mode);
}

WholeFileBuffer::pos_type WholeFileBuffer::seekpos(pos_type position,
                                                   std::ios_base::openmode) {
    if (position < 0) throw std::runtime_error("an offset in it is negative");
    next_ = std::min<std::int64_t>(position, size_);
    setg(buffer_.data(), buffer_.data(), buffer_.data());
    return position;
}

// --- grids
// -------------------------------------------------------------------------------

std::string VdbArchive::Entry::name() const {
    return openvdb::io::GridDescriptor::stripSuffix(descriptor.uniqueName());
}

std::string VdbArchive::Entry::shownName() const {
    return openvdb::io::GridDescriptor::nameAsString(descriptor.uniqueName());
}

bool VdbArchive::Entry::isLevelSet() const {
    return grid->getGridClass() == openvdb::GRID_LEVEL_SET;
}

bool VdbArchive::Entry::isFloat() const {
    return grid->isType<openvdb::FloatGrid>() || grid->isType<openvdb::DoubleGrid>();
}

/// Says what a file is that does not begin as it should.
void VdbArchive::checkMagic() {
    char magic[8] = {};
    in_.read(magic, std::min<std::int64_t>(sizeof(magic), buffer_.size()));
    if (std::memcmp(magic, "NanoVDB", 7) == 0)
        throw Refusal{ErrorCode::unsupported,
                      "it is a NanoVDB file; convert it to .vdb (nanovdb_convert)"};
    if (std::memcmp(magic, " BDV\0\0\0\0", 8) != 0)
        throw Refusal{ErrorCode::badFile, "it is not an OpenVDB file"};
    in_.seekg(0);
}

VdbArchive::VdbArchive(const std::string& path, FrameWriter& out)
    : buffer_(path, out), in_(&buffer_) {
    in_.exceptions(std::ios_base::badbit);  // what the buffer throws comes through
    list();
}

void VdbArchive::list() {
    checkMagic();
    readHeader(in_);
    openvdb::io::setStreamMetadataPtr(in_, ofStream_, false);
    openvdb::io::setVersion(in_, libraryVersion(), fileVersion());
    openvdb::io::setDataCompression(in_, compression());
    openvdb::MetaMap ofFile;
    ofFile.readMeta(in_);
    for (std::int32_t left = readGridCount(in_); left > 0; --left)
        listNext();
}

void VdbArchive::listNext() {
    const std::int64_t start = in_.tellg();
    Entry& entry = entries_.emplace_back();
    entry.grid = entry.descriptor.read(in_);
    if (!inputHasGridOffsets()) {
        read(entry);
        return;
    }
    if (entry.descriptor.getEndPos() > buffer_.size())
        throw std::runtime_error(base::concat("its grids reach to byte ",
                                              entry.descriptor.getEndPos(), " of ",
                                              buffer_.size(), ", so it is cut off"));
    if (entry.descriptor.getEndPos() <= start || entry.descriptor.getGridPos() <= start)
        throw std::runtime_error("the offsets of its grids contradict themselves");
    entry.descriptor.seekToGrid(in_);
    readGridCompression(in_);
    entry.grid->readMeta(in_);
    entry.descriptor.seekToEnd(in_);
}

void VdbArchive::read(Entry& entry) {
    if (entry.read) return;
    entry.read = true;
    if (inputHasGridOffsets()) entry.descriptor.seekToGrid(in_);
    readGrid(entry.grid, entry.descriptor, in_);
    if (!entry.descriptor.isInstance()) return;
    for (Entry& parent : entries_) {
        if (parent.descriptor.uniqueName() != entry.descriptor.instanceParentName())
            continue;
        read(parent);
        entry.grid->setTree(parent.grid->baseTreePtr());
        return;
    }
}

}  // namespace mtsm::scene
