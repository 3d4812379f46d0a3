// importFile: what the parent believes, and what it says when it does not.
#include "scene/import_file.h"

#include <sys/stat.h>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <csignal>
#include <cstdint>
#include <limits>
#include <vector>

#include "scene_fixture.h"

using namespace mtsm;
using namespace mtsm::scene;
using test::contains;

namespace {

constexpr std::uint64_t kLimit = std::uint64_t(256) << 20;

Status importWith(const std::function<void(FrameWriter&)>& send,
                  const ImportSink& sink = {}) {
    const test::TempFolder folder;
    return importFile(folder.write("a.obj", "x"), kLimit, send, sink);
}

/// A stream that `write` makes, as the parent's reader sees it.
template <typename Use>
void withStream(const std::function<void(ChildPipe&)>& write, Use&& use) {
    auto child = Isolated::start(write, kLimit);
    REQUIRE(child);
    FrameReader reader(*child, kLimit);
    use(reader);
}

/// A mesh frame with this head and these bytes behind it.
void checkRefused(MeshHead head, const std::string& behind) {
    withStream(
        [&](ChildPipe& out) {
            const std::uint32_t frame[] = {std::uint32_t(FrameKind::mesh), sizeof(head)};
            out.write(frame, sizeof(frame));
            out.write(&head, sizeof(head));
            out.write(behind.data(), behind.size());
        },
        [](FrameReader& reader) {
            const auto frame = reader.next();
            REQUIRE(frame);
            CHECK(!reader.mesh(*frame));
        });
}

}  // namespace

TEST_CASE("a crash of the importer is a bad file, with its signal",
          "[scene][bad-input]") {
    const Status s = importWith([](FrameWriter&) { std::raise(SIGSEGV); });
    REQUIRE(!s);
    CHECK(s.error().code == ErrorCode::badFile);
    CHECK(contains(s.error().message,
                   "a.obj: the importer crashed on this file "
                   "(signal 11); re-export or repair it"));
}

TEST_CASE("an importer that is killed is the system's doing, not the file's",
          "[scene][bad-input]") {
    const Status s = importWith([](FrameWriter&) { std::raise(SIGKILL); });
    REQUIRE(!s);
    CHECK(s.error().code == ErrorCode::io);
    CHECK(contains(s.error().message, "signal 9"));
}

TEST_CASE("an importer that is interrupted was cancelled", "[scene]") {
    for (const int signal : {SIGINT, SIGTERM}) {
        const Status s = importWith([&](FrameWriter&) { std::raise(signal); });
        REQUIRE(!s);
        CHECK(s.error().code == ErrorCode::cancelled);
        CHECK(contains(s.error().message, "a.obj: reading was cancelled"));
    }
}

TEST_CASE("an importer without enough memory names the limit", "[scene][bad-input]") {
    if (test::kSanitized) {
        WARN("no memory limit under a sanitizer: skipped");
        return;
    }
    const Status s = importWith([](FrameWriter&) { test::takeAllMemory(); });
    REQUIRE(!s);
    CHECK(s.error().code == ErrorCode::tooLarge);
    CHECK(contains(s.error().message, "256 MiB"));
    CHECK(contains(s.error().message, "importerBytes"));
}

TEST_CASE("an importer that stops without a word is a bad file", "[scene][bad-input]") {
    for (const int code : {0, 1, 5}) {
        const Status s = importWith([&](FrameWriter& out) {
            out.warning("so far so good");
            _exit(code);
        });
        REQUIRE(!s);
        CHECK(s.error().code == ErrorCode::badFile);
        CHECK(contains(s.error().message, "without a result"));
    }
}

TEST_CASE("a failure that the importer reports arrives with its code, in one line",
          "[scene]") {
    const Status s = importWith([](FrameWriter& out) {
        out.failure(ErrorCode::unsupported, "a.obj: two\nlines\tof \x1b[31mtext");
    });
    REQUIRE(!s);
    CHECK(s.error().code == ErrorCode::unsupported);
    CHECK(s.error().message == "a.obj: two\\nlines\\tof \\x1b[31mtext");
}

TEST_CASE("a name's control characters do not arrive", "[scene]") {
    std::vector<std::string> names;
    ImportSink sink;
    sink.name = [&](std::string name) { names.push_back(std::move(name)); };
    const auto send = [](FrameWriter& out) {
        out.name(
            "\xc2\x9b"
            "2J");
        out.name("L\xc3\xa4mpchen");
        out.end();
    };
    REQUIRE(importWith(send, sink));
    CHECK(names == std::vector<std::string>{"\\xc2\\x9b2J", "L\xc3\xa4mpchen"});
}

TEST_CASE("a mesh arrives as it was sent", "[scene][roundtrip]") {
    const std::vector<float> xyz = {0, 0, 0, 1, 2, 3, -1e30f, 1e-30f, NAN};
    const std::vector<std::uint32_t> indices = {0, 1, 2, 2, 1, 0};
    std::vector<Instance> places(2);
    places[1].worldFromObject[3] = {1e7, 2, 3, 1};
    places[1].opacity = 0.25f;
    std::vector<PlacedMesh> got;
    ImportSink sink;
    sink.mesh = [&](PlacedMesh&& mesh) -> Status {
        got.push_back(std::move(mesh));
        return {};
    };
    const auto send = [&](FrameWriter& out) {
        out.mesh(xyz, indices, places);
        out.mesh({}, {}, {});
        out.end();
    };
    REQUIRE(importWith(send, sink));
    REQUIRE(got.size() == 2);
    REQUIRE(got[0].positions.size() == 3);
    CHECK(got[0].positions[1] == glm::vec3(1, 2, 3));
    CHECK(std::isnan(got[0].positions[2].z));
    CHECK(got[0].indices == indices);
    REQUIRE(got[0].instances.size() == 2);
    CHECK(got[0].instances[1].worldFromObject == places[1].worldFromObject);
    CHECK(got[0].instances[1].opacity == 0.25f);
    CHECK(got[1].indices.empty());
}

TEST_CASE("an error of the visitor stops the import", "[scene]") {
    ImportSink sink;
    int calls = 0;
    sink.mesh = [&](PlacedMesh&&) -> Status {
        ++calls;
        return Error{ErrorCode::cancelled, "enough"};
    };
    const Status s = importWith(
        [](FrameWriter& out) {
            for (;;)
                out.mesh({}, {}, {});
        },
        sink);
    REQUIRE(!s);
    CHECK(s.error().message == "enough");
    CHECK(calls == 1);
}

TEST_CASE("what is no frame ends the stream", "[scene][bad-input]") {
    const auto none = [](FrameReader& reader) { CHECK(!reader.next()); };
    withStream([](ChildPipe& out) { out.write("no frame at all", 15); }, none);
    withStream([](ChildPipe& out) { out.write("cut", 3); }, none);
    const std::uint32_t tooLong[] = {std::uint32_t(FrameKind::warning),
                                     kMaxFrameBytes + 1};
    withStream([&](ChildPipe& out) { out.write(tooLong, sizeof(tooLong)); }, none);
    const std::uint32_t kindZero[] = {0, 0};
    withStream([&](ChildPipe& out) { out.write(kindZero, sizeof(kindZero)); }, none);
}

TEST_CASE("a mesh that breaks a rule is refused before it can do harm",
          "[scene][bad-input]") {
    const std::string vertex(12, '\0'), triangle(12, '\0');
    checkRefused({1, 1, 0}, vertex);                                      // cut off
    checkRefused({1, 1, 0}, vertex + std::string(8, '\0') + "\1\0\0\0");  // index 1 of 1
    checkRefused({0, 1, 0}, triangle);                                    // index 0 of 0
    checkRefused({std::uint64_t(1) << 60, 0, 0}, "");
    checkRefused({0, std::numeric_limits<std::uint64_t>::max() / 3 + 1, 0}, "");
    checkRefused({0, 0, std::numeric_limits<std::uint64_t>::max()}, "");
    Instance opaquer;
    opaquer.opacity = 2;
    checkRefused({0, 0, 1}, {reinterpret_cast<const char*>(&opaquer), sizeof(opaquer)});
    opaquer.opacity = NAN;
    checkRefused({0, 0, 1}, {reinterpret_cast<const char*>(&opaquer), sizeof(opaquer)});
}

TEST_CASE("a light that no light can be is refused", "[scene][bad-input]") {
    LightRecord record{};
    record.direction = {0, 0, -1};
    const auto frameOf = [](const LightRecord& r) {
        const auto* first = reinterpret_cast<const std::uint8_t*>(&r);
        return Frame{FrameKind::light, {first, first + sizeof(r)}};
    };
    CHECK(FrameReader::light(frameOf(record)));
    record.position.x = NAN;
    CHECK(!FrameReader::light(frameOf(record)));
    record.position.x = 0;
    record.shape = LightShape(77);
    CHECK(!FrameReader::light(frameOf(record)));
    CHECK(!FrameReader::light(Frame{FrameKind::light, {1, 2, 3}}));
}

TEST_CASE("what cannot be read is said in the system's words", "[scene][bad-input]") {
    const test::TempFolder folder;
    const Status missing = checkReadable(folder.path("none.ply"));
    REQUIRE(!missing);
    CHECK(missing.error().code == ErrorCode::io);
    CHECK(contains(missing.error().message, "none.ply: cannot be read: No such file"));

    const Status aFolder = checkReadable(folder.path(""));
    REQUIRE(!aFolder);
    CHECK(aFolder.error().code == ErrorCode::io);
    CHECK(contains(aFolder.error().message, "is a folder"));

    REQUIRE(mkfifo(folder.path("pipe.ply").c_str(), 0600) == 0);
    const Status aPipe = checkReadable(folder.path("pipe.ply"));
    REQUIRE(!aPipe);
    CHECK(contains(aPipe.error().message, "not a regular file"));

    const Status empty = checkReadable(folder.write("empty.ply", ""));
    REQUIRE(!empty);
    CHECK(empty.error().code == ErrorCode::badFile);
    CHECK(contains(empty.error().message, "the file is empty"));
}
