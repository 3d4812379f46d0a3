// Passes of every kind of EXR that OpenEXR itself writes, and of damaged ones.
#include <ImfChannelList.h>
#include <ImfDeepFrameBuffer.h>
#include <ImfDeepScanLineOutputFile.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfMultiPartOutputFile.h>
#include <ImfOutputFile.h>
#include <ImfOutputPart.h>
#include <ImfPartType.h>
#include <ImfTiledOutputFile.h>
#include <half.h>
#include <sys/stat.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>

#include "io/exr_file.h"
#include "io/temp_folder.h"
#include "mtsm/passes.h"

using namespace mtsm;
using mtsm::test::TempFolder;

namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();

/// A value that a half holds exactly, different for every pixel and channel.
float valueAt(int x, int y, int channel) {
    return float(x + 32 * y) + 0.25f * float(channel);
}

struct Picture {
    Imath::Box2i data{{0, 0}, {18, 12}};
    Imath::Box2i display{{0, 0}, {18, 12}};
    struct Channel {
        std::string name;
        Imf::PixelType type = Imf::FLOAT;
        std::vector<float> values = {};  // empty: valueAt, by the channel's place below
    };
    std::vector<Channel> channels;
    Imf::Compression compression = Imf::ZIP_COMPRESSION;
    Imf::LineOrder order = Imf::INCREASING_Y;
    std::string part;

    [[nodiscard]] int width() const { return data.max.x - data.min.x + 1; }
    [[nodiscard]] int height() const { return data.max.y - data.min.y + 1; }
    [[nodiscard]] Imf::Header header() const {
        Imf::Header h(display, data, 1, {0, 0}, 1, order, compression);
        for (const Channel& c : channels)
            h.channels().insert(c.name, Imf::Channel(c.type));
        if (!part.empty()) h.setName(part);
        return h;
    }
};

/// The pixels of a Picture, kept alive while OpenEXR writes them.
class Pixels {
  public:
    explicit Pixels(const Picture& p) {
        for (std::size_t c = 0; c < p.channels.size(); ++c) {
            const Picture::Channel& channel = p.channels[c];
            auto& floats = floats_.emplace_back(channel.values);
            if (floats.empty()) {
                for (int y = 0; y < p.height(); ++y)
                    for (int x = 0; x < p.width(); ++x)
                        floats.push_back(valueAt(x, y, int(c)));
            }
            halfs_.emplace_back(floats.begin(), floats.end());
            uints_.emplace_back(floats.size(), 7u);
            const void* data = channel.type == Imf::FLOAT  ? (const void*)floats.data()
                               : channel.type == Imf::HALF ? (const void*)halfs_[c].data()
                                                           : uints_[c].data();
            frame_.insert(channel.name, Imf::Slice::Make(channel.type, data, p.data));
        }
    }
    [[nodiscard]] const Imf::FrameBuffer& frame() const { return frame_; }

  private:
    std::vector<std::vector<float>> floats_;
    std::vector<std::vector<Imath::half>> halfs_;
    std::vector<std::vector<unsigned>> uints_;
    Imf::FrameBuffer frame_;
};

void writeScanlines(const std::string& path, const Picture& p) {
    const Pixels pixels(p);
    Imf::OutputFile file(path.c_str(), p.header());
    file.setFrameBuffer(pixels.frame());
    file.writePixels(p.height());
}

void writeTiles(const std::string& path, const Picture& p, Imf::TileDescription tiles) {
    const Pixels pixels(p);
    Imf::Header header = p.header();
    header.setTileDescription(tiles);
    Imf::TiledOutputFile file(path.c_str(), header);
    // Lower levels are written from the same corner of the picture: they must not matter.
    file.setFrameBuffer(pixels.frame());
    for (int level = 0; level < file.numLevels(); ++level)
        file.writeTiles(0, file.numXTiles(level) - 1, 0, file.numYTiles(level) - 1,
                        level);
}

void writeParts(const std::string& path, const std::vector<Picture>& pictures) {
    std::vector<Imf::Header> headers;
    for (const Picture& p : pictures) {
        headers.push_back(p.header());
        headers.back().setType(Imf::SCANLINEIMAGE);
    }
    Imf::MultiPartOutputFile file(path.c_str(), headers.data(), int(headers.size()));
    for (std::size_t i = 0; i < pictures.size(); ++i) {
        const Pixels pixels(pictures[i]);
        Imf::OutputPart part(file, int(i));
        part.setFrameBuffer(pixels.frame());
        part.writePixels(pictures[i].height());
    }
}

Picture positionPicture() {
    Picture p;
    p.channels = {{"P.X"}, {"P.Y"}, {"P.Z"}};
    return p;
}

/// The pass has valueAt of the channels `first`, `first` + 1, `first` + 2 everywhere.
void checkValues(const Pass& pass, const Picture& p, int first = 0) {
    REQUIRE(pass.data.width == std::uint32_t(p.width()));
    REQUIRE(pass.data.height == std::uint32_t(p.height()));
    REQUIRE(pass.pixels() == std::size_t(p.width()) * std::size_t(p.height()));
    std::size_t i = 0;
    bool same = true;
    for (int y = 0; y < p.height(); ++y) {
        for (int x = 0; x < p.width(); ++x, ++i)
            same = same && pass.values[i] == glm::vec3(valueAt(x, y, first),
                                                       valueAt(x, y, first + 1),
                                                       valueAt(x, y, first + 2));
    }
    CHECK(same);
}

std::string errorOf(const Result<Pass>& pass, ErrorCode code) {
    if (pass) return "no error";
    CHECK(pass.error().code == code);
    return pass.error().message;
}

bool contains(const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
}

}  // namespace

TEST_CASE("positions come through every compression", "[io][exr][roundtrip]") {
    TempFolder folder;
    for (int c = 0; c < Imf::NUM_COMPRESSION_METHODS; ++c) {
        INFO("compression " << c);
        Picture p = positionPicture();
        p.compression = Imf::Compression(c);
        p.data = {{0, 0}, {40, 300}};  // more rows than the largest chunk
        p.display = p.data;
        const bool lossy = c == Imf::PXR24_COMPRESSION || c == Imf::B44_COMPRESSION ||
                           c == Imf::B44A_COMPRESSION || c == Imf::DWAA_COMPRESSION ||
                           c == Imf::DWAB_COMPRESSION;
        writeScanlines(folder / "p.exr", p);
        auto pass = readPositionPass(folder / "p.exr");
        REQUIRE(pass);
        if (!lossy) checkValues(*pass, p);
        CHECK(pass->pixels() == 41 * 301);
        CHECK(pass->layer == "P");
    }
}

TEST_CASE("half, float and mixed channels give the same positions", "[io][exr]") {
    TempFolder folder;
    for (int mask = 0; mask < 8; ++mask) {
        Picture p = positionPicture();
        for (std::size_t c = 0; c < 3; ++c)
            p.channels[c].type = mask >> c & 1 ? Imf::HALF : Imf::FLOAT;
        writeScanlines(folder / "p.exr", p);
        auto pass = readPositionPass(folder / "p.exr");
        REQUIRE(pass);
        checkValues(*pass, p);
    }
}

TEST_CASE(
    "a picture that may be no pass, and halves that are too coarse for one, are told",
    "[io][exr]") {
    TempFolder folder;
    const std::string path = folder / "p.exr";
    const auto read = [&](const std::string& part, const std::string& prefix,
                          const std::string& letters, Imf::PixelType third) {
        Picture p;
        p.part = part;
        for (std::size_t c = 0; c < 3; ++c)
            p.channels.push_back({prefix + letters[c], c == 2 ? third : Imf::FLOAT});
        writeScanlines(path, p);
        auto pass = readPositionPass(path);
        REQUIRE(pass);
        return *std::move(pass);
    };
    CHECK(read("", "", "RGB", Imf::FLOAT).guessed);
    CHECK(read("beauty", "", "rgb", Imf::FLOAT).guessed);
    CHECK_FALSE(read("", "", "XYZ", Imf::FLOAT).guessed);
    CHECK_FALSE(read("P", "", "RGB", Imf::FLOAT).guessed);
    CHECK_FALSE(read("", "P.", "RGB", Imf::FLOAT).guessed);
    CHECK_FALSE(read("", "P.", "RGB", Imf::FLOAT).half);
    CHECK(read("", "P.", "RGB", Imf::HALF).half);
    CHECK(read("", "", "RGB", Imf::HALF).half);
}

TEST_CASE("tiles of odd sizes and mipmaps give the picture's own level", "[io][exr]") {
    TempFolder folder;
    for (auto mode : {Imf::ONE_LEVEL, Imf::MIPMAP_LEVELS}) {
        for (unsigned size : {1u, 7u, 16u, 100u}) {
            const Picture p = positionPicture();
            writeTiles(folder / "p.exr", p, {size, size + 2, mode});
            auto pass = readPositionPass(folder / "p.exr");
            REQUIRE(pass);
            checkValues(*pass, p);
        }
    }
}

TEST_CASE("rows stored from the bottom up come out from the top down", "[io][exr]") {
    TempFolder folder;
    Picture p = positionPicture();
    p.order = Imf::DECREASING_Y;
    p.data.max.y = 99;
    writeScanlines(folder / "p.exr", p);
    auto pass = readPositionPass(folder / "p.exr");
    REQUIRE(pass);
    checkValues(*pass, p);
}

TEST_CASE("a data window anywhere keeps its place", "[io][exr]") {
    TempFolder folder;
    Picture p = positionPicture();
    p.data = {{-7, 1000}, {11, 1080}};
    p.display = {{0, 0}, {1919, 1079}};
    writeScanlines(folder / "p.exr", p);
    auto pass = readPositionPass(folder / "p.exr");
    REQUIRE(pass);
    checkValues(*pass, p);
    CHECK(pass->data.x == -7);
    CHECK(pass->data.y == 1000);
    CHECK(pass->display.width == 1920);
    CHECK(pass->display.height == 1080);
    writeTiles(folder / "t.exr", p, {16, 16, Imf::ONE_LEVEL});
    pass = readPositionPass(folder / "t.exr");
    REQUIRE(pass);
    checkValues(*pass, p);
}

TEST_CASE("parts and layers are told apart", "[io][exr]") {
    TempFolder folder;
    const std::string path = folder / "m.exr";
    Picture beauty, position, normal, id;
    beauty.part = "rgba";
    beauty.channels = {{"R"}, {"G"}, {"B"}, {"A"}};
    beauty.channels[3].values.assign(19 * 13, 1.0f);
    beauty.channels[3].values[5] = 0.0f;
    position.part = "P";
    position.channels = {{"R"}, {"G"}, {"B"}};
    normal.part = "N";
    normal.channels = {{"id", Imf::UINT}, {"X"}, {"Y"}, {"Z"}};
    writeParts(path, {beauty, position, normal});

    auto pass = readPositionPass(path);
    REQUIRE(pass);
    checkValues(*pass, position);
    CHECK(pass->layer == "P");
    for (std::size_t i = 0; i < pass->pixels(); ++i)
        REQUIRE(pass->surface[i] == (i != 5));  // the picture's alpha, in another part
    CHECK(pass->hidden == 1);
    auto normals = readNormalPass(path, *pass);
    REQUIRE(normals);
    CHECK(normals->values[5] == glm::vec3(0));
    CHECK(normals->values[6] ==
          glm::vec3(valueAt(6, 0, 1), valueAt(6, 0, 2), valueAt(6, 0, 3)));
}

TEST_CASE("the layer names that renderers use are recognised", "[io][exr]") {
    TempFolder folder;
    const std::string path = folder / "p.exr";
    const auto read = [&](std::vector<std::string> names) {
        Picture p;
        p.channels = {{"R"}, {"G"}, {"B"}};
        for (auto& n : names)
            p.channels.push_back({n});
        writeScanlines(path, p);
        auto pass = readPositionPass(path);
        if (!pass) return pass.error().message;
        checkValues(*pass, p, 3);
        return pass->layer;
    };
    CHECK(read({"P.X", "P.Y", "P.Z"}) == "P");
    CHECK(read({"P.x", "P.y", "P.z"}) == "P");
    CHECK(read({"P.R", "P.G", "P.B"}) == "P");
    CHECK(read({"P.r", "P.g", "P.b"}) == "P");
    CHECK(read({"Position.X", "Position.Y", "Position.Z"}) == "Position");
    CHECK(read({"position.X", "position.Y", "position.Z"}) == "position");
    CHECK(read({"worldPosition.R", "worldPosition.G", "worldPosition.B"}) ==
          "worldPosition");
    CHECK(read({"WorldPosition.R", "WorldPosition.G", "WorldPosition.B"}) ==
          "WorldPosition");
    CHECK(read({"world_position.x", "world_position.y", "world_position.z"}) ==
          "world_position");
    CHECK(read({"Pworld.X", "Pworld.Y", "Pworld.Z"}) == "Pworld");
    CHECK(read({"RenderLayer.Position.X", "RenderLayer.Position.Y",
                "RenderLayer.Position.Z"}) == "RenderLayer.Position");
    CHECK(read({"ViewLayer.Position.X", "ViewLayer.Position.Y",
                "ViewLayer.Position.Z"}) == "ViewLayer.Position");
    CHECK(contains(read({"Prefix.X", "Prefix.Y", "Prefix.Z"}), "--position-layer"));
    CHECK(contains(read({"P.X", "P.Y"}), "--position-layer"));
}

TEST_CASE("a layer of another space is taken only by its name", "[io][exr]") {
    TempFolder folder;
    const std::string path = folder / "p.exr";
    for (const std::string layer :
         {"camera.Position", "Camera.P", "object.P", "Pref.P", "light.P", "Pcam",
          "View.Position", "screen_space.P", "rest:P.Position", "myCam.P"}) {
        INFO(layer);
        Picture p;
        p.channels = {{layer + ".X"}, {layer + ".Y"}, {layer + ".Z"}};
        writeScanlines(path, p);
        CHECK(contains(errorOf(readPositionPass(path), ErrorCode::badArgument),
                       "--position-layer"));
        PassOptions options;
        options.layer = layer;
        const auto pass = readPositionPass(path, options);
        REQUIRE(pass);
        checkValues(*pass, p);
        CHECK(pass->layer == layer);
        // Nor does it keep one in world space from being recognised.
        for (const char* c : {"X", "Y", "Z"})
            p.channels.push_back({std::string("View Layer.Position.") + c});
        writeScanlines(path, p);
        const auto world = readPositionPass(path);
        REQUIRE(world);
        CHECK(world->layer == "View Layer.Position");
        checkValues(*world, p, 3);
    }
    Picture beauty, position;  // the part's name counts too
    beauty.part = "beauty";
    beauty.channels = {{"R"}, {"G"}, {"B"}};
    position.part = "camera";
    position.channels = {{"P.X"}, {"P.Y"}, {"P.Z"}};
    writeParts(path, {beauty, position});
    CHECK_FALSE(readPositionPass(path));
    position.part = "floor";
    writeParts(path, {beauty, position});
    const auto pass = readPositionPass(path);
    REQUIRE(pass);
    CHECK(pass->layer == "floor:P");
}

TEST_CASE("wide pictures are read in bands of at most 64 MiB", "[io][exr][bad-input]") {
    TempFolder folder;
    const std::string path = folder / "wide.exr";
    constexpr int kWidth = 1 << 20, kHeight = 7;
    Imf::Header header(kWidth, kHeight);
    header.compression() = Imf::ZIPS_COMPRESSION;
    const std::vector<float> zeros(kWidth);
    Imf::FrameBuffer frame;
    for (const char* c : {"P.X", "P.Y", "P.Z"}) {
        header.channels().insert(c, Imf::Channel(Imf::FLOAT));
        frame.insert(c, Imf::Slice(Imf::FLOAT, (char*)zeros.data(), sizeof(float), 0));
    }
    {
        Imf::OutputFile file(path.c_str(), header);
        file.setFrameBuffer(frame);
        file.writePixels(kHeight);
    }
    auto stream = io::ExrStream::open(path);
    REQUIRE(stream);
    Imf::MultiPartInputFile file(**stream);
    std::size_t most = 0, pixels = 0;
    REQUIRE(io::readExrChannels(file, 0, {"P.X", "P.Y", "P.Z"}, path,
                                [&](const float*, std::size_t count) {
                                    most = std::max(most, count);
                                    pixels += count;
                                }));
    CHECK(pixels == std::size_t(kWidth) * kHeight);
    CHECK(most == std::size_t(kWidth) * 5);  // 12 MiB a row
}

TEST_CASE("a file of nothing but three channels is the pass itself", "[io][exr]") {
    TempFolder folder;
    const std::string path = folder / "p.exr";
    for (const auto& names : {std::vector<std::string>{"R", "G", "B"}, {"X", "Y", "Z"}}) {
        Picture p;
        for (const auto& n : names)
            p.channels.push_back({n});
        writeScanlines(path, p);
        auto pass = readPositionPass(path);
        REQUIRE(pass);
        checkValues(*pass, p);
        p.channels.push_back({"A", Imf::HALF, std::vector<float>(19 * 13, 0.0f)});
        writeScanlines(path, p);
        pass = readPositionPass(path);
        REQUIRE(pass);
        CHECK(std::count(pass->surface.begin(), pass->surface.end(), 1) == 0);
        p.channels.push_back({"depth"});
        writeScanlines(path, p);
        CHECK(contains(errorOf(readPositionPass(path), ErrorCode::badArgument),
                       "channels in the file: A, "));
    }
}

TEST_CASE("several layers ask for a name, and a name settles it", "[io][exr]") {
    TempFolder folder;
    const std::string path = folder / "p.exr";
    Picture p;
    for (const char* layer : {"a.Position.", "b.Position.", "b.Other."})
        for (const char* c : {"X", "Y", "Z"})
            p.channels.push_back({std::string(layer) + c});
    writeScanlines(path, p);
    const std::string several = errorOf(readPositionPass(path), ErrorCode::badArgument);
    CHECK(contains(several, path));
    CHECK(contains(several, "\"a.Position\", \"b.Position\""));
    CHECK(contains(several, "--position-layer"));
    CHECK(contains(several, "a.Position.X, a.Position.Y"));

    PassOptions options;
    options.layer = "b.Position";
    auto pass = readPositionPass(path, options);
    REQUIRE(pass);
    checkValues(*pass, p, 3);
    options.layer = "Other";
    pass = readPositionPass(path, options);
    REQUIRE(pass);
    checkValues(*pass, p, 6);
    CHECK(pass->layer == "b.Other");
    options.layer = "Position";
    CHECK(contains(errorOf(readPositionPass(path, options), ErrorCode::badArgument),
                   "several"));
    options.layer = "osition";
    CHECK(contains(errorOf(readPositionPass(path, options), ErrorCode::badArgument),
                   "no layer \"osition\""));
}

TEST_CASE("pixels without a surface are those without alpha and those not finite",
          "[io][exr]") {
    TempFolder folder;
    const std::string path = folder / "p.exr";
    const float badAlpha = GENERATE(-1.0f, NAN);
    const auto surfaces = [&](const char* layer, const char* alpha) {
        Picture p;
        for (const char* c : {"X", "Y", "Z"})
            p.channels.push_back({std::string(layer) + c});
        p.channels[1].values.assign(19 * 13, 2.0f);
        p.channels[1].values[1] = NAN;
        p.channels[1].values[2] = kInf;
        p.channels[1].values[3] = -kInf;
        std::vector<float> a(19 * 13, 1.0f);
        a[4] = 0.0f;
        a[5] = -0.0f;
        a[6] = 1e-30f;
        a[7] = badAlpha;
        p.channels.push_back({alpha, Imf::FLOAT, a});
        writeScanlines(path, p);
        auto pass = readPositionPass(path);
        REQUIRE(pass);
        std::string text;
        for (std::size_t i = 0; i < 8; ++i)
            text += pass->surface[i] ? '1' : '0';
        // Three are not finite; what else is without a surface, alpha took.
        CHECK(pass->hidden == (text == "10000010" ? 3 : 0));
        return text;
    };
    CHECK(surfaces("P.", "P.A") == "10000010");
    CHECK(surfaces("P.", "A") == "10000010");
    CHECK(surfaces("ViewLayer.Position.", "ViewLayer.Combined.A") == "10000010");
    CHECK(surfaces("ViewLayer.Position.", "Other.Combined.A") == "10001111");
    CHECK(surfaces("P.", "Z.A") == "10001111");
    CHECK(surfaces("P.", "beta") == "10001111");
}

TEST_CASE("normals must cover the pixels that the positions cover",
          "[io][exr][bad-input]") {
    TempFolder folder;
    Picture p = positionPicture(), n;
    n.channels = {{"N.X"}, {"N.Y"}, {"N.Z"}};
    writeScanlines(folder / "p.exr", p);
    auto positions = readPositionPass(folder / "p.exr");
    REQUIRE(positions);
    n.data.max.x += 1;
    writeScanlines(folder / "n.exr", n);
    CHECK(contains(
        errorOf(readNormalPass(folder / "n.exr", *positions), ErrorCode::badArgument),
        "20 x 13 pixels"));
    CHECK(contains(
        errorOf(readNormalPass(folder / "p.exr", *positions), ErrorCode::badArgument),
        "--normal-layer"));
}

TEST_CASE("deep, subsampled and too large pictures are refused with a reason",
          "[io][exr][bad-input]") {
    TempFolder folder;
    {
        Imf::Header header(4, 4);
        header.channels().insert("P.X", Imf::Channel(Imf::FLOAT));
        header.channels().insert("P.Y", Imf::Channel(Imf::FLOAT));
        header.channels().insert("P.Z", Imf::Channel(Imf::FLOAT));
        header.setType(Imf::DEEPSCANLINE);
        header.compression() = Imf::ZIPS_COMPRESSION;
        Imf::DeepScanLineOutputFile file((folder / "deep.exr").c_str(), header);
        std::vector<unsigned> counts(16, 0);
        std::vector<float*> none(16, nullptr);
        Imf::DeepFrameBuffer frame;
        frame.insertSampleCountSlice(
            Imf::Slice::Make(Imf::UINT, counts.data(), header.dataWindow()));
        for (const char* c : {"P.X", "P.Y", "P.Z"})
            frame.insert(
                c, Imf::DeepSlice(Imf::FLOAT, reinterpret_cast<char*>(none.data()),
                                  sizeof(float*), 4 * sizeof(float*), sizeof(float)));
        file.setFrameBuffer(frame);
        file.writePixels(4);
    }
    CHECK(contains(errorOf(readPositionPass(folder / "deep.exr"), ErrorCode::unsupported),
                   "deep"));

    {
        Imf::Header header(4, 4);
        for (const char* c : {"P.X", "P.Y", "P.Z"})
            header.channels().insert(c, Imf::Channel(Imf::FLOAT, 2, 2));
        std::vector<float> values(4);
        Imf::FrameBuffer frame;
        for (const char* c : {"P.X", "P.Y", "P.Z"})
            frame.insert(c, Imf::Slice::Make(Imf::FLOAT, values.data(),
                                             header.dataWindow(), 0, 0, 2, 2));
        Imf::OutputFile file((folder / "sub.exr").c_str(), header);
        file.setFrameBuffer(frame);
        file.writePixels(4);
    }
    CHECK(contains(errorOf(readPositionPass(folder / "sub.exr"), ErrorCode::unsupported),
                   "subsampled 2 x 2"));

    writeScanlines(folder / "p.exr", positionPicture());
    PassOptions options;
    options.maxPixels = 19 * 13 - 1;
    CHECK(contains(
        errorOf(readPositionPass(folder / "p.exr", options), ErrorCode::tooLarge),
        "246"));
}

TEST_CASE("what is no EXR at all is said so", "[io][exr][bad-input]") {
    TempFolder folder;
    CHECK(contains(errorOf(readPositionPass(folder / "none.exr"), ErrorCode::io),
                   "No such file"));
    CHECK(contains(errorOf(readPositionPass(folder / "."), ErrorCode::io), "folder"));
    // A pipe without a writer: must not wait for one.
    REQUIRE(::mkfifo((folder / "pipe.exr").c_str(), 0600) == 0);
    CHECK(contains(errorOf(readPositionPass(folder / "pipe.exr"), ErrorCode::io),
                   "no regular file"));
    test::write(folder / "text.exr", "this is text, not pixels\n");
    CHECK(contains(errorOf(readPositionPass(folder / "text.exr"), ErrorCode::badFile),
                   "not an OpenEXR file"));
    test::write(folder / "empty.exr", "");
    CHECK(contains(errorOf(readPositionPass(folder / "empty.exr"), ErrorCode::badFile),
                   "not an OpenEXR file"));
}

TEST_CASE("every truncation of an EXR is an error", "[io][exr][bad-input]") {
    TempFolder folder;
    const std::string path = folder / "p.exr";
    Picture p = positionPicture();
    p.data = {{0, 0}, {4, 2}};
    const bool tiled = GENERATE(false, true);
    if (tiled)
        writeTiles(path, p, {2, 2, Imf::ONE_LEVEL});
    else
        writeScanlines(path, p);
    const std::string whole = test::contents(path);
    REQUIRE(readPositionPass(path));
    for (std::size_t n = 0; n < whole.size(); ++n) {
        INFO("first " << n << " of " << whole.size() << " bytes");
        test::write(path, whole.substr(0, n));
        REQUIRE_FALSE(readPositionPass(path));
    }
}

TEST_CASE("a flipped byte gives a picture or an error, never worse",
          "[io][exr][bad-input]") {
    TempFolder folder;
    const std::string path = folder / "p.exr";
    Picture p = positionPicture();
    p.data = {{0, 0}, {4, 2}};
    const bool tiled = GENERATE(false, true);
    if (tiled)
        writeTiles(path, p, {2, 2, Imf::ONE_LEVEL});
    else
        writeScanlines(path, p);
    const std::string whole = test::contents(path);
    PassOptions options;
    options.maxPixels = 1 << 20;
    int errors = 0;
    for (std::size_t n = 0; n < whole.size(); ++n) {
        for (char flip : {'\x01', '\x80', '\xff'}) {
            std::string damaged = whole;
            damaged[n] = char(damaged[n] ^ flip);
            test::write(path, damaged);
            auto pass = readPositionPass(path, options);
            if (!pass) ++errors;
            if (!pass) REQUIRE(contains(pass.error().message, path));
        }
    }
    CHECK(errors > 100);
}

TEST_CASE("sizes that only hostile files claim are refused before memory is spent",
          "[io][exr][bad-input]") {
    TempFolder folder;
    const std::string path = folder / "p.exr";
    writeTiles(path, positionPicture(), {16, 16, Imf::ONE_LEVEL});
    const std::string whole = test::contents(path);
    const std::size_t tiles = whole.find(std::string("tiledesc\0", 9)) + 13;
    std::string hostile = whole;
    hostile.replace(tiles, 8, std::string("\xff\xff\xff\x3f\xff\xff\xff\x3f", 8));
    test::write(path, hostile);
    REQUIRE_FALSE(readPositionPass(path));

    hostile = whole;
    const std::size_t size = whole.find(std::string("chlist\0", 7)) + 7;
    hostile.replace(size, 4, std::string("\xf0\xff\xff\x7f", 4));
    test::write(path, hostile);
    CHECK(contains(errorOf(readPositionPass(path), ErrorCode::badFile),
                   "claims 2147483632 bytes"));
}
