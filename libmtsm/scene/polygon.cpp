// [Meisters75] G. H. Meisters, Polygons have ears, Am. Math. Monthly 82 (1975): a simple
// polygon of more than three corners has two ears, corners whose triangle with their
// neighbours lies inside and holds no other corner; cutting one off leaves a simple
// polygon.
#include "scene/polygon.h"

#include <algorithm>
#include <cmath>

namespace mtsm::scene {

namespace {

/// Point tests per polygon after which ears are no longer checked for what lies in them:
/// some seconds. No honest polygon gets there; a made-up one must not hang the import.
constexpr std::uint64_t kPatience = 2'000'000'000;

}  // namespace

void PolygonCutter::project(std::span<const unsigned> corners,
                            const aiVector3D* positions) {
    // Newell's normal: the sum of cross products, right for concave outlines too.
    double nx = 0, ny = 0, nz = 0;
    for (std::size_t i = 0; i < corners.size(); ++i) {
        const aiVector3D& p = positions[corners[i]];
        const aiVector3D& q = positions[corners[(i + 1) % corners.size()]];
        nx += (double(p.y) - q.y) * (double(p.z) + q.z);
        ny += (double(p.z) - q.z) * (double(p.x) + q.x);
        nz += (double(p.x) - q.x) * (double(p.y) + q.y);
    }
    const double ax = std::abs(nx), ay = std::abs(ny), az = std::abs(nz);
    points_.clear();
    for (const unsigned corner : corners) {
        const aiVector3D& p = positions[corner];
        Point flat{p.x, p.y};
        double facing = nz;
        if (ax >= ay && ax >= az) {
            flat = {p.y, p.z};
            facing = nx;
        } else if (ay >= az) {
            flat = {p.z, p.x};
            facing = ny;
        }
        if (facing < 0) std::swap(flat.x, flat.y);  // counter-clockwise from here on
        points_.push_back(flat);
    }
}

/// Twice the area of the triangle; positive if it turns left. Differences of floats and
/// their products are exact in a double for all but extreme ratios of coordinates.
double PolygonCutter::turn(std::uint32_t a, std::uint32_t b, std::uint32_t c) const {
    const Point &p = points_[a], &q = points_[b], &r = points_[c];
    return (q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x);
}

bool PolygonCutter::isEar(std::uint32_t corner, Rule rule) {
    const std::uint32_t a = before_[corner], b = corner, c = behind_[corner];
    if (!(turn(a, b, c) > 0)) return false;
    if (rule == Rule::convex || patience_ == 0) return true;
    const double least = rule == Rule::nothingTouches ? 0.0 : 1e-300;
    const Point &pa = points_[a], &pb = points_[b], &pc = points_[c];
    const double xLow = std::min({pa.x, pb.x, pc.x}),
                 xHigh = std::max({pa.x, pb.x, pc.x});
    const double yLow = std::min({pa.y, pb.y, pc.y}),
                 yHigh = std::max({pa.y, pb.y, pc.y});
    patience_ -= std::min<std::uint64_t>(patience_, concave_.size());
    // A triangle that holds any corner holds a concave one, and none turns concave.
    for (const std::uint32_t p : concave_) {
        if (behind_[p] == p || p == a || p == b || p == c) continue;
        const Point& q = points_[p];
        if (q.x < xLow || q.x > xHigh || q.y < yLow || q.y > yHigh) continue;
        if (turn(a, b, p) >= least && turn(b, c, p) >= least && turn(c, a, p) >= least)
            return false;
    }
    return true;
}

std::uint32_t PolygonCutter::findEar(std::uint32_t from, std::uint32_t left) {
    for (const Rule rule : {Rule::nothingTouches, Rule::nothingInside, Rule::convex}) {
        std::uint32_t corner = from;
        for (std::uint32_t i = 0; i < left; ++i, corner = behind_[corner])
            if (isEar(corner, rule)) return corner;
    }
    return from;
}

void PolygonCutter::cut(std::span<const unsigned> corners, const aiVector3D* positions,
                        std::vector<std::uint32_t>& triangles) {
    const auto n = std::uint32_t(corners.size());
    if (n == 3) {
        triangles.insert(triangles.end(), corners.begin(), corners.end());
        return;
    }
    project(corners, positions);
    before_.resize(n);
    behind_.resize(n);
    for (std::uint32_t i = 0; i < n; ++i) {
        before_[i] = (i + n - 1) % n;
        behind_[i] = (i + 1) % n;
    }
    concave_.clear();
    for (std::uint32_t i = 0; i < n; ++i)
        if (!(turn(before_[i], i, behind_[i]) > 0)) concave_.push_back(i);
    patience_ = kPatience;
    // Going on two corners behind the last ear makes triangles less slim than a fan's.
    std::uint32_t from = 1;
    for (std::uint32_t left = n; left > 3; --left) {
        const std::uint32_t ear = findEar(from, left);
        const std::uint32_t a = before_[ear], c = behind_[ear];
        triangles.insert(triangles.end(), {corners[a], corners[ear], corners[c]});
        behind_[a] = c;
        before_[c] = a;
        before_[ear] = behind_[ear] = ear;
        from = behind_[c];
    }
    const std::uint32_t a = before_[from], c = behind_[from];
    triangles.insert(triangles.end(), {corners[a], corners[from], corners[c]});
}

}  // namespace mtsm::scene
