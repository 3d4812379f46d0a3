// Images out, read back by the libraries that own the formats.
#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfStringAttribute.h>
#include <png.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>

#include "io/temp_folder.h"
#include "mtsm/image.h"

using namespace mtsm;
using mtsm::test::TempFolder;

TEST_CASE("an EXR comes back with its channels, windows and texts",
          "[io][exr][roundtrip]") {
    TempFolder folder;
    const std::string path = folder / "a.exr";
    FloatImage image(7, 5);
    image.data.x = -3;
    image.data.y = 11;
    image.display = {0, 0, 1920, 1080};
    std::vector<float> shadow, visibility;
    for (int i = 0; i < 35; ++i) {
        shadow.push_back(float(i) / 35);
        visibility.push_back(1 - float(i) / 35);
    }
    shadow[4] = std::numeric_limits<float>::infinity();
    image.channels = {{"shadow", shadow}, {"visibility", visibility}};
    image.attributes = {{"mtsm:map", "key.mtsm"}, {"comments", "two\nlines"}};
    REQUIRE(writeImageExr(path, image));

    Imf::InputFile file(path.c_str());
    const Imf::Header& header = file.header();
    CHECK(header.dataWindow() == Imath::Box2i({-3, 11}, {3, 15}));
    CHECK(header.displayWindow() == Imath::Box2i({0, 0}, {1919, 1079}));
    CHECK(header.compression() == Imf::ZIP_COMPRESSION);
    CHECK(header.typedAttribute<Imf::StringAttribute>("mtsm:map").value() == "key.mtsm");
    CHECK(header.typedAttribute<Imf::StringAttribute>("comments").value() ==
          "two\nlines");
    for (const auto& expected : image.channels) {
        REQUIRE(header.channels().findChannel(expected.name));
        CHECK(header.channels()[expected.name].type == Imf::FLOAT);
        std::vector<float> got(35);
        Imf::FrameBuffer frame;
        frame.insert(expected.name,
                     Imf::Slice::Make(Imf::FLOAT, got.data(), header.dataWindow()));
        file.setFrameBuffer(frame);
        file.readPixels(11, 15);
        CHECK(got == expected.values);
    }
}

TEST_CASE("an image that cannot be is refused before a file is touched",
          "[io][exr][bad-input]") {
    TempFolder folder;
    const auto refused = [&](const FloatImage& image) {
        const Status done = writeImageExr(folder / "a.exr", image);
        CHECK(folder.files() == 0);
        return !done && done.error().code == ErrorCode::badArgument;
    };
    FloatImage good(2, 2);
    good.channels = {{"Y", {0, 1, 2, 3}}};
    auto image = good;
    image.channels[0].values.pop_back();
    CHECK(refused(image));
    image = good;
    image.channels.push_back(good.channels[0]);
    CHECK(refused(image));
    image = good;
    image.channels.clear();
    CHECK(refused(image));
    image = good;
    image.data.x = std::numeric_limits<std::int32_t>::max();
    CHECK(refused(image));
    CHECK(refused(FloatImage(0, 2)));
    image = good;
    image.attributes = {{"", "x"}};
    CHECK(refused(image));
    image.attributes = {{"compression", "a text where the format wants something else"}};
    CHECK(refused(image));
    CHECK(writeImageExr(folder / "a.exr", good));
}

TEST_CASE("a PNG comes back from libpng byte for byte", "[io][png][roundtrip]") {
    TempFolder folder;
    const std::string path = folder / "a.png";
    for (std::uint32_t channels : {1u, 3u, 4u}) {
        INFO(channels << " channels");
        ByteImage image{13, 6, channels, {}};
        for (std::uint32_t i = 0; i < 13 * 6 * channels; ++i)
            image.values.push_back(std::uint8_t(i * 37));
        REQUIRE(writeImagePng(path, image));

        png_image file{};
        file.version = PNG_IMAGE_VERSION;
        REQUIRE(png_image_begin_read_from_file(&file, path.c_str()));
        CHECK(file.width == 13);
        CHECK(file.height == 6);
        const png_uint_32 formats[] = {PNG_FORMAT_GRAY, 0, PNG_FORMAT_RGB,
                                       PNG_FORMAT_RGBA};
        const png_uint_32 format = formats[channels - 1];
        CHECK((file.format & ~png_uint_32(PNG_FORMAT_FLAG_COLORMAP)) == format);
        file.format = format;
        std::vector<std::uint8_t> got(PNG_IMAGE_SIZE(file));
        REQUIRE(png_image_finish_read(&file, nullptr, got.data(), 0, nullptr));
        CHECK(got == image.values);
    }
}

TEST_CASE("a PNG whose values do not fit its size is refused", "[io][png][bad-input]") {
    TempFolder folder;
    const std::string path = folder / "a.png";
    for (const ByteImage& image :
         {ByteImage{2, 2, 1, {1, 2, 3}}, ByteImage{2, 2, 2, std::vector<std::uint8_t>(8)},
          ByteImage{0, 2, 1, {}}, ByteImage{2000000, 1, 1, {}}}) {
        const Status done = writeImagePng(path, image);
        REQUIRE_FALSE(done);
        CHECK(done.error().code == ErrorCode::badArgument);
    }
    CHECK(folder.files() == 0);
}

TEST_CASE("grey levels run from black to white and clamp beyond", "[io][png]") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const float inf = std::numeric_limits<float>::infinity();
    CHECK(greyImage(7, 1, {0, 1, 0.5f, 2, -1, nan, inf}, 0, 1).values ==
          std::vector<std::uint8_t>{0, 255, 128, 255, 0, 0, 255});
    CHECK(greyImage(3, 1, {10, 15, 20}, 20, 10).values ==
          std::vector<std::uint8_t>{255, 128, 0});
    CHECK(greyImage(3, 1, {1, 2, 3}, 2, 2).values ==
          std::vector<std::uint8_t>{0, 0, 255});
    const ByteImage color = colorImage(2, 1, {0, 1}, {0.5f, 0}, {1, 3}, 0, 1);
    CHECK(color.channels == 3);
    CHECK(color.values == std::vector<std::uint8_t>{0, 128, 255, 255, 0, 255});
}
