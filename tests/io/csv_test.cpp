// Points and rays in, results out.
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>

#include "io/temp_folder.h"
#include "mtsm/points.h"

using namespace mtsm;
using mtsm::test::TempFolder;

namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

Result<PointList> pointsOf(const std::string& text) {
    TempFolder folder;
    const std::string path = folder / "p.csv";
    test::write(path, text);
    return readPoints(path);
}

Result<std::vector<ShadowRay>> raysOf(const std::string& text,
                                      std::vector<glm::dvec3>* directions = nullptr) {
    TempFolder folder;
    const std::string path = folder / "r.csv";
    test::write(path, text);
    return readRays(path, directions);
}

/// The message without the folder, which differs from run to run.
template <typename T>
std::string complaint(const Result<T>& result) {
    if (result) return "no error";
    CHECK(result.error().code == ErrorCode::badFile);
    const std::string& m = result.error().message;
    return m.substr(m.rfind(".csv") + 1);
}

}  // namespace

TEST_CASE("points are read by the names of their columns", "[io][csv]") {
    auto list = pointsOf("x,y,z\n1,2,3\n-4.5,+6e2,.5\n");
    REQUIRE(list);
    REQUIRE(list->points.size() == 2);
    CHECK(list->points[0] == glm::dvec3(1, 2, 3));
    CHECK(list->points[1] == glm::dvec3(-4.5, 600, 0.5));
    CHECK(list->normals.empty());

    list = pointsOf("name, Z ,x,\"y\",extra\n\"a, b\",3,1,2,what\n c ,6, 4 ,\t5,\n");
    REQUIRE(list);
    REQUIRE(list->points.size() == 2);
    CHECK(list->points[0] == glm::dvec3(1, 2, 3));
    CHECK(list->points[1] == glm::dvec3(4, 5, 6));
}

TEST_CASE("normals come along when there are three columns of them", "[io][csv]") {
    auto list = pointsOf("nx,ny,nz,x,y,z\n0,1,0,1,2,3\n0,0,-2,4,5,6\n");
    REQUIRE(list);
    REQUIRE(list->normals.size() == 2);
    CHECK(list->normals[1] == glm::dvec3(0, 0, -2));
    CHECK(list->points[1] == glm::dvec3(4, 5, 6));
    CHECK(complaint(pointsOf("x,y,z,nx,ny\n")).find("csv:1:1: ") == 0);
}

TEST_CASE("comments, blank lines, CRLF, a byte order mark and no last newline are fine",
          "[io][csv]") {
    auto list = pointsOf(
        "\xef\xbb\xbf# made by hand\r\n\r\nx,y,z\r\n  \r\n1,2,3\r\n# half way\r\n4,5,6");
    REQUIRE(list);
    CHECK(list->points ==
          std::vector<glm::dvec3>{glm::dvec3(1, 2, 3), glm::dvec3(4, 5, 6)});
    list = pointsOf("x,y,z\n");
    REQUIRE(list);
    CHECK(list->points.empty());
}

TEST_CASE("a quoted # is a value, not a comment", "[io][csv]") {
    const auto list = pointsOf("name,x,y,z,note\n\"#1\",0,0,0,\"a\"\n #,1,1,1,\n");
    REQUIRE(list);
    CHECK(list->points == std::vector<glm::dvec3>{glm::dvec3(0)});
}

TEST_CASE("nan and inf are numbers, and what a double cannot hold goes to its limits",
          "[io][csv]") {
    auto list = pointsOf("x,y,z\nnan,inf,-inf\n1e999,-1e999,1e-999\n");
    REQUIRE(list);
    CHECK(std::isnan(list->points[0].x));
    CHECK(list->points[0].y == kInf);
    CHECK(list->points[0].z == -kInf);
    CHECK(list->points[1] == glm::dvec3(kInf, -kInf, 0));
}

TEST_CASE("a bad line is named by line and column, with what was found and expected",
          "[io][csv][bad-input]") {
    CHECK(complaint(pointsOf("x,y,z\n1,2,3\n# c\n1,two,3\n")) ==
          "csv:4:3: found \"two\", expected a number for y");
    CHECK(complaint(pointsOf("x,y,z\n1,+-2,3\n")) ==
          "csv:2:3: found \"+-2\", expected a number for y");
    CHECK(complaint(pointsOf("x,y,z\n1,2,\n")) ==
          "csv:2:5: found \"\", expected a number for z");
    CHECK(complaint(pointsOf("x,y,z\n1,2,3 4\n")) ==
          "csv:2:5: found \"3 4\", expected a number for z");
    CHECK(complaint(pointsOf("x,y,z\n1,2\n")) ==
          "csv:2:4: found 2 fields, expected 3 as in the line of names");
    CHECK(complaint(pointsOf("x,y,z\n1,2,3,4\n")) ==
          "csv:2:7: found more than the 3 fields that the line of names has");
    CHECK(complaint(pointsOf("1,2,3\n4,5,6\n")).find("csv:1:1: found \"1,2,3\"") == 0);
    CHECK(complaint(pointsOf("x,y,x,z\n")) == "csv:1:5: column x is there twice");
    CHECK(complaint(pointsOf("")).find("is empty") != std::string::npos);
    CHECK(complaint(pointsOf("# x,y,z\n")).find("is empty") != std::string::npos);
    CHECK(complaint(pointsOf("x,y,z\n1,2,\x1b[31m\n")).find('\x1b') == std::string::npos);
    CHECK(complaint(pointsOf("x,y,z\n" + std::string(3 << 20, '1'))).find("1 MiB") !=
          std::string::npos);
    CHECK(complaint(pointsOf(std::string("\0\1\2\n\n", 5))).find("csv:1:1: ") == 0);
}

TEST_CASE("a missing file and a folder are errors of the system",
          "[io][csv][bad-input]") {
    TempFolder folder;
    auto missing = readPoints(folder / "none.csv");
    REQUIRE_FALSE(missing);
    CHECK(missing.error().code == ErrorCode::io);
    CHECK(missing.error().message.find("No such file") != std::string::npos);
    auto directory = readRays(folder / ".");
    REQUIRE_FALSE(directory);
    CHECK(directory.error().code == ErrorCode::io);
}

TEST_CASE("rays have unit directions and end at tmax, or not at all", "[io][csv]") {
    std::vector<glm::dvec3> given;
    auto rays = raysOf(
        "ox,oy,oz,dx,dy,dz,tmax\n1,2,3,0,3,4,10\n1,2,3,0,0,-1e200,inf\n0,0,0,1,0,0,\n"
        "0,0,0,0,0,0,1\n",
        &given);
    REQUIRE(rays);
    CHECK(given ==
          std::vector<glm::dvec3>{{0, 3, 4}, {0, 0, -1e200}, {1, 0, 0}, {0, 0, 0}});
    REQUIRE(rays->size() == 4);
    CHECK((*rays)[0].origin == glm::dvec3(1, 2, 3));
    CHECK((*rays)[0].direction == glm::dvec3(0, 0.6, 0.8));
    CHECK((*rays)[0].length == 10);  // world units, not multiples of the given direction
    CHECK((*rays)[1].direction == glm::dvec3(0, 0, -1));
    CHECK((*rays)[1].length == kInf);
    CHECK((*rays)[2].length == kInf);
    CHECK((*rays)[3].direction == glm::dvec3(0, 0, 0));
    rays = raysOf("dx,dy,dz,ox,oy,oz\n1,0,0,7,8,9\n");
    REQUIRE(rays);
    CHECK((*rays)[0].origin == glm::dvec3(7, 8, 9));
    CHECK((*rays)[0].length == kInf);
    CHECK(complaint(raysOf("ox,oy,oz,dx,dy\n")).find("there is no dz") !=
          std::string::npos);
}

TEST_CASE("lines that straddle the reader's blocks come out whole", "[io][csv]") {
    std::string text = "x,y,z\n";
    constexpr int kCount = 150000;  // about 3 MB: several blocks
    for (int i = 0; i < kCount; ++i)
        text += std::to_string(i) + "," + std::to_string(-i) + ",0.125\n";
    auto list = pointsOf(text);
    REQUIRE(list);
    REQUIRE(list->points.size() == kCount);
    bool all = true;
    for (int i = 0; i < kCount; ++i)
        all = all && list->points[std::size_t(i)] == glm::dvec3(i, -i, 0.125);
    CHECK(all);
}

TEST_CASE("what is written as CSV reads back to the same bits", "[io][csv][roundtrip]") {
    TempFolder folder;
    const std::string path = folder / "out.csv";
    std::mt19937_64 random(3);
    std::vector<glm::dvec3> points;
    std::vector<float> shadow;
    for (int i = 0; i < 20000; ++i) {
        glm::dvec3 p;
        for (int c = 0; c < 3; ++c) {
            const std::uint64_t bits = random();
            double value;
            std::memcpy(&value, &bits, sizeof value);
            p[c] = std::isnan(value) ? 0.1 : value;
        }
        points.push_back(p);
        shadow.push_back(float(random() >> 40) * 0x1p-24f);
    }
    REQUIRE(writeCsv(path,
                     {{"x", &points[0].x, 3},
                      {"shadow", shadow.data()},
                      {"y", &points[0].y, 3},
                      {"z", &points[0].z, 3}},
                     points.size()));
    auto back = readPoints(path);
    REQUIRE(back);
    CHECK(back->points == points);
    const std::string text = test::contents(path);
    CHECK(text.find("x,shadow,y,z\n") == 0);
    CHECK(std::count(text.begin(), text.end(), '\n') == 20001);
}

TEST_CASE("floats are written as short as floats are", "[io][csv]") {
    TempFolder folder;
    const float values[] = {0.1f, 1.0f, 0.0f, 1e-7f};
    REQUIRE(writeCsv(folder / "f.csv", {{"v", values}}, 4));
    CHECK(test::contents(folder / "f.csv") == "v\n0.1\n1\n0\n1e-07\n");
}
