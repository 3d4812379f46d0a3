// Settings by name, and the methods that have them.
#include "baseline/settings.h"
#include "mtsm/describe.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <set>

#include "baseline/methods.h"

using namespace mtsm;
using namespace mtsm::baseline;

namespace {

const std::vector<SettingInfo> kInfos = {
    wholeSetting("samples", 256, 1, 4096, "rays a point"),
    numberSetting("bias", -1.0, -1.0, 10.0, "world units", SettingUse::build),
    flagSetting("adaptive", false, "stops early"),
    wordSetting("lookup", {"trace", "pcf"}, "how"),
};

/// What is said of one wrong setting.
std::string refusal(const std::string& name, const SettingValue& value) {
    const auto settings = Settings::complete(kInfos, {{name, value}}, "mvsm");
    REQUIRE_FALSE(settings);
    CHECK(settings.error().code == ErrorCode::badArgument);
    return settings.error().message;
}

}  // namespace

TEST_CASE("what is not given has its fallback, in the order of the infos", "[baseline]") {
    const auto settings = Settings::complete(
        kInfos, {{"lookup", std::string("pcf")}, {"samples", 64.0}}, "m");
    REQUIRE(settings);
    CHECK(settings->whole("samples") == 64);
    CHECK(settings->number("bias") == -1.0);
    CHECK_FALSE(settings->flag("adaptive"));
    CHECK(settings->word("lookup") == "pcf");
    REQUIRE(settings->all().size() == kInfos.size());
    for (std::size_t i = 0; i < kInfos.size(); ++i)
        CHECK(settings->all()[i].first == kInfos[i].name);
}

TEST_CASE("values at their bounds are taken", "[baseline]") {
    for (const double samples : {1.0, 4096.0})
        CHECK(Settings::complete(kInfos, {{"samples", samples}}, "m"));
    for (const double bias : {-1.0, 0.25, 10.0})
        CHECK(Settings::complete(kInfos, {{"bias", bias}}, "m"));
}

TEST_CASE("numbers out of range, broken ones and none are refused with what was expected",
          "[baseline][bad-input]") {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    for (const double samples : {0.0, 4097.0, -1.0, 1.5, nan, HUGE_VAL})
        CHECK_THAT(refusal("samples", samples),
                   Catch::Contains("method mvsm, samples: found " + settingText(samples) +
                                   ", expected a whole number from 1 to 4096"));
    for (const double bias : {-1.01, 10.01, nan, -HUGE_VAL})
        CHECK_THAT(refusal("bias", bias), Catch::Contains("a number from -1 to 10"));
}

TEST_CASE("values of another type are refused with what was expected",
          "[baseline][bad-input]") {
    CHECK_THAT(refusal("samples", true),
               Catch::Contains("found true") && Catch::Contains("a whole number"));
    CHECK_THAT(refusal("samples", std::string("64")), Catch::Contains("a whole number"));
    CHECK_THAT(refusal("adaptive", 1.0),
               Catch::Contains("found 1,") && Catch::Contains("true or false"));
    CHECK_THAT(refusal("lookup", false), Catch::Contains("one of trace, pcf"));
    CHECK_THAT(refusal("lookup", std::string("Trace")),
               Catch::Contains("found Trace, expected one of trace, pcf"));
    // What a file brings cannot steer a terminal.
    CHECK(refusal("lookup", std::string("\x1b[2J")).find('\x1b') == std::string::npos);
}

TEST_CASE("an unknown setting is refused with the nearest name and all that there are",
          "[baseline][bad-input]") {
    CHECK_THAT(refusal("smaples", 1.0),
               Catch::Contains("method mvsm has no setting \"smaples\"; did you mean "
                               "\"samples\"? It has samples, bias, adaptive, lookup"));
    CHECK_THAT(refusal("resolution", 1.0),
               Catch::Contains("has no setting \"resolution\"; it has samples, bias"));
    const auto bare = Settings::complete({}, {{"samples", 1.0}}, "plain");
    REQUIRE_FALSE(bare);
    CHECK_THAT(bare.error().message, Catch::Contains("it has none"));
}

TEST_CASE("the nearest name is near, and the first of equally near ones", "[baseline]") {
    const std::vector<std::string> names = {"resolution", "samples", "mode", "node"};
    CHECK(nearestName("sampels", names) == "samples");
    CHECK(nearestName("resolutoin", names) == "resolution");
    CHECK(nearestName("samples", names) == "samples");
    CHECK(nearestName("ode", names) == "mode");
    CHECK(nearestName("opacity", names).empty());
    // One that was cut short, or had a shorter name once.
    CHECK(nearestName("resol", names) == "resolution");
    CHECK(nearestName("near", {"layers", "near-field"}) == "near-field");
    CHECK(nearestName("re", names).empty());
    CHECK(nearestName("", {"resolution"}).empty());
    CHECK(nearestName("x", {}).empty());
}

TEST_CASE("texts of values are what a scene file would have", "[baseline]") {
    CHECK(settingText(true) == "true");
    CHECK(settingText(false) == "false");
    CHECK(settingText(64.0) == "64");
    CHECK(settingText(0.1) == "0.1");
    CHECK(settingText(-1.0) == "-1");
    CHECK(settingText(std::string("pcf")) == "pcf");
    // The longest that doubles have.
    const double longest = -std::numeric_limits<double>::denorm_min() * 3;
    CHECK(std::stold(settingText(-1.7976931348623157e308)) == -1.7976931348623157e308L);
    CHECK(settingText(longest).size() < 32);
}

TEST_CASE("every method is found by its name and works with its own fallbacks",
          "[baseline]") {
    std::set<std::string> names;
    for (const MethodInfo& info : methods()) {
        INFO(info.name);
        CHECK(names.insert(info.name).second);
        CHECK_FALSE(info.title.empty());
        CHECK_FALSE(info.source.empty());
        REQUIRE(info.build);
        const auto found = findMethod(info.name);
        REQUIRE(found);
        CHECK(*found == &info);
        // Given one by one, as a scene file would have them.
        Settings::Given all;
        std::set<std::string> own;
        for (const SettingInfo& setting : info.settings) {
            INFO(setting.name);
            CHECK(own.insert(setting.name).second);
            CHECK_FALSE(setting.help.empty());
            all.emplace_back(setting.name, setting.fallback);
        }
        CHECK(Settings::complete(info.settings, all, info.name));
    }
}

TEST_CASE("an unknown method is refused with the nearest name and all that there are",
          "[baseline][bad-input]") {
    const auto near = findMethod("mtms");
    REQUIRE_FALSE(near);
    CHECK(near.error().code == ErrorCode::badArgument);
    CHECK_THAT(
        near.error().message,
        Catch::Contains("there is no method \"mtms\"; did you mean \"mtsm\"? There "
                        "are "));
    const auto far = findMethod("photon-mapping");
    REQUIRE_FALSE(far);
    CHECK_THAT(far.error().message, Catch::Contains("\"photon-mapping\"; there are "));
    for (const MethodInfo& info : methods())
        CHECK_THAT(far.error().message, Catch::Contains(info.name));
}

TEST_CASE("rows leave at its fallback what their other settings switch off",
          "[baseline]") {
    const auto completed = [](const char* row, const Settings::Given& given) {
        const auto info = findMethod(row);
        REQUIRE(info);
        auto settings = Settings::complete((*info)->settings, given, row);
        REQUIRE(settings);
        return *settings;
    };
    for (const char* row : {"pcf", "deep-pcf"}) {
        CHECK(completed(row, {{"search", 7.0}}).whole("search") == 64);
        CHECK(completed(row, {{"search", 7.0}, {"filter", std::string("blocker")}})
                  .whole("search") == 7);
    }
    const Settings::Given largest = {{"bounds", std::string("largest")}};
    CHECK(completed("single-sample", largest).word("bounds") == "largest");
    CHECK(completed("single-sample", {largest[0], {"hard", true}}).word("bounds") ==
          "cone");
}

TEST_CASE("what was given is told from what has its fallback", "[baseline]") {
    std::vector<SettingInfo> infos = kInfos;
    infos[2].with = "lookup=trace";
    const auto settings = Settings::complete(
        infos, {{"samples", 256.0}, {"lookup", std::string("pcf")}, {"adaptive", true}},
        "m");
    REQUIRE(settings);
    CHECK(settings->given("samples"));  // though it is the fallback
    CHECK_FALSE(settings->given("bias"));
    CHECK(settings->given("lookup"));
    CHECK_FALSE(settings->given("adaptive"));  // beside pcf it does not count
    CHECK_FALSE(settings->flag("adaptive"));
}

TEST_CASE("bytes are whole numbers with a suffix, in place of a word where they may be",
          "[baseline]") {
    CHECK(parseBytes("1000000") == 1000000u);
    CHECK(parseBytes("32M") == 32u << 20);
    CHECK(parseBytes("1g") == 1u << 30);
    CHECK(parseBytes("2T") == std::uint64_t(2) << 40);
    CHECK(parseBytes("18446744073709551615") == UINT64_MAX);
    CHECK_FALSE(parseBytes(std::string("32\0", 3)));
    for (const char* wrong : {"", "M", "0", "0K", "-1", "1.5G", "32MB", " 1", "1 ",
                              "auto", "16777216T", "18446744073709551616"})
        CHECK_FALSE(parseBytes(wrong));
    SettingInfo info = wordSetting("near-field", {"auto", "none"}, "what is kept");
    CHECK_FALSE(Settings::complete({info}, {{"near-field", std::string("32M")}}, "m"));
    info.bytes = true;
    const auto wordOf = [&](const SettingValue& value) -> std::string {
        const auto settings = Settings::complete({info}, {{"near-field", value}}, "m");
        return settings ? settings->word("near-field") : settings.error().message;
    };
    CHECK(wordOf(std::string("32M")) == "32M");
    CHECK(wordOf(std::string("none")) == "none");
    CHECK(wordOf(64000000.0) == "64000000");
    SettingInfo rays = wordSetting("adaptive", {"false", "true"}, "which rays");
    CHECK(Settings::complete({rays}, {{"adaptive", true}}, "m")->word("adaptive") ==
          "true");
    for (const SettingValue& wrong : {SettingValue(0.0), SettingValue(1.5),
                                      SettingValue(-1.0), SettingValue(std::string("x"))})
        CHECK_THAT(wordOf(wrong),
                   Catch::Contains("one of auto, none, or bytes such as 32M"));
}
