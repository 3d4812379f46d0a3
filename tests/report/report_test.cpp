// The report page as text; report_test.py opens it in a browser.
#include "compare/report.h"

#include <catch2/catch.hpp>
#include <string>

#include "io/temp_folder.h"

using mtsm::ErrorCode;
using mtsm::test::TempFolder;
using mtsm::tools::makeReport;
using Json = nlohmann::ordered_json;

namespace {

const std::string kPng = std::string("\x89PNG\r\n\x1a\n") + "rest";

/// What stands between `from` and the first `to` behind it.
std::string between(const std::string& text, const std::string& from,
                    const std::string& to) {
    const std::size_t start = text.find(from);
    REQUIRE(start != std::string::npos);
    const std::size_t end = text.find(to, start + from.size());
    REQUIRE(end != std::string::npos);
    return text.substr(start + from.size(), end - start - from.size());
}

Json resultsWithPicture(const std::string& name) {
    Json results;
    results["runs"] =
        Json::array({{{"id", "0"}, {"image", name}, {"difference", nullptr}}});
    return results;
}

}  // namespace

TEST_CASE("the report holds the results, whatever their texts are", "[report]") {
    Json results;
    results["scene"]["casters"] = {"</script><script>alert(1)</script>", "<!--<script>",
                                   "@PICTURES@ @RESULTS@", "\"&'\n\x01 \xc3\xa9"};
    const auto page = makeReport(results, "");
    REQUIRE(page);
    const std::string json = between(*page, "id=\"results\">", "</script>");
    CHECK(json.find('<') == std::string::npos);
    CHECK(Json::parse(json) == results);
    CHECK(page->ends_with("</html>\n"));
}

TEST_CASE("bytes that are no UTF-8 do not keep the report from being made", "[report]") {
    Json results;
    results["scene"]["name"] = "bad \xff name";
    CHECK(makeReport(results, ""));
}

TEST_CASE("pictures stand in the report as base64, each once", "[report]") {
    const TempFolder folder;
    mtsm::test::write(folder / "a\"<&.png", kPng);
    Json results = resultsWithPicture("a\"<&.png");
    results["lights"] = Json::array({{{"truth", {{"image", "a\"<&.png"}}}}});
    const auto page = makeReport(results, folder / "");
    REQUIRE(page);
    // RFC 4648 by hand: twelve bytes are sixteen digits.
    CHECK(between(*page, "data-picture=\"a&quot;&lt;&amp;.png\">", "<") ==
          "iVBORw0KGgpyZXN0");
    CHECK(page->find("data-picture=\"") == page->rfind("data-picture=\""));

    mtsm::test::write(folder / "a\"<&.png", kPng + "1");
    CHECK(between(*makeReport(results, folder / ""), ".png\">", "<") ==
          "iVBORw0KGgpyZXN0MQ==");
    mtsm::test::write(folder / "a\"<&.png", kPng + "12");
    CHECK(between(*makeReport(results, folder / ""), ".png\">", "<") ==
          "iVBORw0KGgpyZXN0MTI=");
}

TEST_CASE("a picture that is missing or no PNG is an error that names it", "[report]") {
    const TempFolder folder;
    const auto missing = makeReport(resultsWithPicture("gone.png"), folder / "");
    REQUIRE(!missing);
    CHECK(missing.error().code == ErrorCode::io);
    CHECK_THAT(missing.error().message,
               Catch::Contains("gone.png") && Catch::Contains("No such file"));

    mtsm::test::write(folder / "text.png", "no picture");
    const auto text = makeReport(resultsWithPicture("text.png"), folder / "");
    REQUIRE(!text);
    CHECK(text.error().code == ErrorCode::badFile);
    CHECK_THAT(text.error().message, Catch::Contains("text.png"));

    const auto directory = makeReport(resultsWithPicture("."), folder / "");
    REQUIRE(!directory);
    CHECK(directory.error().code == ErrorCode::io);
}

TEST_CASE("results that are empty or of another shape make a page all the same",
          "[report]") {
    CHECK(makeReport(Json(), ""));
    CHECK(makeReport(Json::array({1, 2}), ""));
    CHECK(makeReport(Json{{"lights", 3}, {"runs", Json::array({1, nullptr})}}, ""));
}
