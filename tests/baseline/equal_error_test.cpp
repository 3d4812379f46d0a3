// Who reaches an error the cheapest, against power laws and brute force.
#include "baseline/equal_error.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <random>

using namespace mtsm::baseline;

namespace {

Measured run(const std::string& label, double error, double seconds,
             const std::string& series = "", double samples = 0.0) {
    return {label, error, seconds, 0.0, series, samples};
}

}  // namespace

TEST_CASE("between the runs of a power law its own time is found", "[baseline][exact]") {
    // error = 0.3 / N^0.7 and seconds = 0.01 N^0.9: for an error e, N = (0.3 /
    // e)^(1/0.7).
    std::vector<Measured> runs;
    for (const double n : {64.0, 1.0, 16.0, 4.0, 256.0})  // in no order
        runs.push_back(run("n" + std::to_string(int(n)), 0.3 / std::pow(n, 0.7),
                           0.01 * std::pow(n, 0.9), "embree", n));
    for (double e = 0.299; e > runs.back().error; e *= 0.93) {
        const auto found = cheapest(runs, e);
        REQUIRE(found);
        INFO("error " << e << ", " << found->label);
        CHECK(found->seconds ==
              Approx(0.01 * std::pow(0.3 / e, 0.9 / 0.7)).epsilon(1e-9));
    }
    CHECK(cheapest(runs, 0.02)->label == "between n16 and n64");
    CHECK(cheapest(runs, 0.3)->label == "n1");
    CHECK(cheapest(runs, 1.0)->label == "n1");
    CHECK_FALSE(cheapest(runs, 0.99 * runs.back().error));
    CHECK_FALSE(cheapest({}, 1.0));
}

TEST_CASE("runs without a series, and a series of one, count only as they are",
          "[baseline]") {
    const std::vector<Measured> runs = {run("coarse", 0.1, 1), run("fine", 0.01, 4),
                                        run("alone", 0.05, 3, "s", 16)};
    CHECK(cheapest(runs, 0.1)->label == "coarse");
    CHECK(cheapest(runs, 0.099)->label == "alone");
    CHECK(cheapest(runs, 0.05)->seconds == 3);
    CHECK(cheapest(runs, 0.049)->label == "fine");
    CHECK(cheapest(runs, 0.049)->seconds == 4);
    CHECK_FALSE(cheapest(runs, 0.009));
}

TEST_CASE("different series are not interpolated between", "[baseline]") {
    const std::vector<Measured> runs = {run("a", 0.1, 1, "bias=0", 4),
                                        run("b", 0.001, 100, "bias=1", 8)};
    CHECK(cheapest(runs, 0.05)->label == "b");
    CHECK(cheapest(runs, 0.05)->seconds == 100);
}

TEST_CASE("a better run elsewhere beats an interpolated one", "[baseline]") {
    const std::vector<Measured> runs = {
        run("a", 0.1, 1, "s", 1), run("b", 0.001, 100, "s", 4), run("map", 0.01, 2)};
    CHECK(cheapest(runs, 0.01)->label == "map");
    CHECK(cheapest(runs, 0.009)->label == "between a and b");
}

TEST_CASE("in a series that gets worse in between, only falling neighbours are joined",
          "[baseline]") {
    // 1 -> 2 falls, 2 -> 4 rises, 4 -> 8 falls.
    const std::vector<Measured> runs = {
        run("1", 0.1, 1, "s", 1), run("2", 0.02, 2, "s", 2), run("4", 0.04, 4, "s", 4),
        run("8", 0.01, 8, "s", 8)};
    CHECK(cheapest(runs, 0.05)->label == "between 1 and 2");
    CHECK(cheapest(runs, 0.03)->label == "between 1 and 2");
    CHECK(cheapest(runs, 0.02)->label == "2");
    // Half way in the logarithm from 0.04 to 0.01: half way from 4 s to 8 s.
    const auto between = cheapest(runs, 0.0199999999);
    REQUIRE(between);
    CHECK(between->label == "between 4 and 8");
    CHECK(between->seconds == Approx(std::sqrt(32.0)).epsilon(1e-6));
}

TEST_CASE("a run without error is taken as it is", "[baseline]") {
    const std::vector<Measured> runs = {run("a", 0.1, 1, "s", 1),
                                        run("b", 0.0, 5, "s", 4)};
    for (const double error : {0.05, 1e-300, 0.0}) {
        REQUIRE(cheapest(runs, error));
        CHECK(cheapest(runs, error)->label == "b");
        CHECK(cheapest(runs, error)->seconds == 5);
    }
}

TEST_CASE("the Pareto front is what brute force finds", "[baseline]") {
    std::mt19937 random(5);
    for (int trial = 0; trial < 200; ++trial) {
        // Few values, so that many are equal.
        std::vector<Measured> runs;
        for (unsigned i = 0; i < random() % 30; ++i)
            runs.push_back(run("", double(random() % 8), 1.0 + double(random() % 8)));
        const auto front = paretoFront(runs);
        // By time, error strictly falling: so none of the front beats another.
        for (std::size_t i = 1; i < front.size(); ++i) {
            CHECK(runs[front[i - 1]].seconds < runs[front[i]].seconds);
            CHECK(runs[front[i - 1]].error > runs[front[i]].error);
        }
        for (const Measured& any : runs) {
            bool reached = false;
            for (const std::size_t i : front)
                reached = reached ||
                          (runs[i].seconds <= any.seconds && runs[i].error <= any.error);
            CHECK(reached);
        }
        for (const std::size_t i : front) {
            for (const Measured& any : runs) {
                const bool beats =
                    any.seconds <= runs[i].seconds && any.error <= runs[i].error &&
                    (any.seconds < runs[i].seconds || any.error < runs[i].error);
                CHECK_FALSE(beats);
            }
        }
    }
    CHECK(paretoFront({}).empty());
}
