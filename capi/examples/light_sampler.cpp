// A light sampler with pbrt's interface: SampleLi and PDF_Li at a shading point, with headtail's C++ header.
//   c++ -std=c++17 -I capi/include capi/examples/light_sampler.cpp -lheadtail_c && ./a.out room.hdr neural:satin.safetensors
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <exception>
#include <optional>
#include <stdexcept>
#include <vector>

#include "headtail.hpp"

struct Vector3f {
    float x, y, z;
};
struct Point2f {
    float x, y;
};
struct LightSample {
    Vector3f L, wi;
    float pdf;
};

class ProductLight {
  public:
    explicit ProductLight(const char *name) : map(name), sampler("patches", map) {}

    std::optional<LightSample> SampleLi(Vector3f n, Point2f u) const {
        LightSample s;
        sampler.sample({one(n)}, one(u), one(s.wi), headtail::results<1>(&s.pdf, 1), one(s.L));
        if (s.pdf == 0) return {};
        return s;
    }
    float PDF_Li(Vector3f n, Vector3f wi) const {
        float pdf;
        sampler.pdf({one(n)}, one(wi), headtail::results<1>(&pdf, 1));
        return pdf;
    }

  private:
    static headtail::results<3> one(Vector3f &v) { return {&v.x, 1}; }
    static headtail::list<3> one(const Vector3f &v) { return {&v.x, 1}; }
    static headtail::list<2> one(const Point2f &u) { return {&u.x, 1}; }

    headtail::environment map;
    headtail::sampler sampler;
};

// Draws one direction per point of a batch, which takes less time per point than one call for each, and evaluates their
// pdfs from the same preparation.
static double reflected_by_batch(const char *name, std::size_t count) {
    headtail::environment map(name);
    headtail::sampler sampler("patches", map);
    const std::array<Vector3f, 1> n{{{0, 1, 0}}};
    std::vector<Vector3f> wi(count), radiance(count);
    std::vector<float> pdf(count);
    const auto points = sampler.prepare({n}, count);
    points.sample(headtail::seed{1}, wi, pdf, radiance);
    std::vector<float> again(count);
    points.pdf(wi, again);
    double sum = 0;
    for (std::size_t k = 0; k < count; k++)
        if (std::abs(again[k] / pdf[k] - 1) > 0.01f) return -1;
    for (std::size_t k = 0; k < count; k++)
        if (pdf[k] > 0) sum += radiance[k].y * wi[k].y / (3.14159265 * pdf[k]) / double(count);
    try {
        sampler.pdf({n}, std::vector<Vector3f>(3), pdf);
        return -1;
    } catch (const std::invalid_argument &error) {
        std::printf("as expected: %s\n", error.what());
    }
    return sum;
}

// Light that a point of a neural material reflects to a viewer: radiance x BRDF x cosine / pdf.
static double reflected_by_material(const char *map_name, const char *name, std::size_t count) {
    const headtail::environment map(map_name);
    const headtail::sampler sampler("mis", map);
    const headtail::material material(name);
    const std::array<Vector3f, 1> n{{{0, 1, 0}}}, wo{{{0.6f, 0.8f, 0}}};
    const std::array<std::array<float, 2>, 1> uv{{{0.3f, 0.6f}}};
    const std::array<std::array<float, 4>, 1> tangent{{{1, 0, 0, 1}}};
    headtail::points at{n, wo};
    at.material = material.handle(), at.uv = uv, at.tangent = tangent;
    std::vector<Vector3f> wi(count), radiance(count), reflectance(count);
    std::vector<float> pdf(count);
    sampler.prepare(at, count).sample(headtail::seed{1}, wi, pdf, radiance);
    for (std::size_t k = 0; k < count; k++)
        if (pdf[k] == 0) wi[k] = n[0];
    headtail::brdf_cosine(at, wi, reflectance);
    double sum = 0;
    for (std::size_t k = 0; k < count; k++)
        if (pdf[k] > 0) sum += radiance[k].y * reflectance[k].y / pdf[k] / double(count);
    return sum;
}

int main(int argc, char **argv) try {
    const char *name = argc > 1 ? argv[1] : "studio";
    ProductLight light(name);
    const Vector3f n{0, 1, 0};
    const int side = 64;
    double reflected = 0, largest = 0;
    for (int k = 0; k < side * side; k++) {
        const Point2f u{(float(k % side) + 0.5f) / side, (float(k / side) + 0.5f) / side};
        auto s = light.SampleLi(n, u);
        if (!s) continue;
        reflected += s->L.y * s->wi.y / (3.14159265 * s->pdf) / (side * side);
        largest = std::max(largest, std::abs(light.PDF_Li(n, s->wi) / double(s->pdf) - 1));
    }
    const double batch = reflected_by_batch(name, side * side);
    std::printf("reflected %.4f and %.4f, pdfs differ by %.1e at most\n", reflected, batch, largest);
    try {
        ProductLight missing("missing.hdr");
        return 2;
    } catch (const headtail::error &error) {
        std::printf("as expected: %s\n", error.what());
    }
    if (argc > 2) {
        const double by_material = reflected_by_material(name, argv[2], side * side);
        std::printf("reflected by %s %.4f\n", argv[2], by_material);
        if (!(by_material > 0)) return 1;
    }
    return reflected > 0 && std::abs(batch / reflected - 1) < 0.1 && largest < 0.05 ? 0 : 1;
} catch (const std::exception &error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
}
