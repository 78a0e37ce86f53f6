// A light sampler with pbrt's interface: Sample_Li and PDF_Li at a shading point, with headtail's C library.
//   c++ -std=c++17 -I capi/include capi/examples/light_sampler.cpp -lheadtail_c && ./a.out room.hdr
#include <cstdio>
#include <optional>
#include <stdexcept>

#include "headtail.h"

static void check(HeadtailStatus status) {
    if (status != HEADTAIL_STATUS_OK) throw std::runtime_error(headtail_last_error());
}

// One diffuse surface.
static HeadtailPoints surface(const float n[3]) {
    HeadtailPoints at{};
    at.n = n, at.n_count = 1;
    return at;
}

struct LightSample { float L[3], wi[3], pdf; };

class ProductLight {
  public:
    explicit ProductLight(const char *map) {
        check(headtail_environment_open(map, &environment));
        check(headtail_sampler_from_spec("patches", environment, &sampler));
    }
    ProductLight(const ProductLight &) = delete;
    ~ProductLight() { headtail_close(sampler), headtail_close(environment); }

    std::optional<LightSample> Sample_Li(const float n[3], const float u[2]) const {
        LightSample s;
        HeadtailPoints at = surface(n);
        check(headtail_sampler_sample(sampler, &at, 1, u, 0, s.wi, &s.pdf, s.L));
        if (s.pdf == 0) return {};
        return s;
    }
    float PDF_Li(const float n[3], const float wi[3]) const {
        HeadtailPoints at = surface(n);
        float pdf;
        check(headtail_sampler_pdf(sampler, &at, 1, wi, &pdf));
        return pdf;
    }

  private:
    HeadtailHandle environment = 0, sampler = 0;
};

int main(int argc, char **argv) try {
    ProductLight light(argc > 1 ? argv[1] : "studio");
    const float n[3] = {0, 1, 0};
    const int side = 64;
    double reflected = 0, largest = 0;
    for (int k = 0; k < side * side; k++) {
        const float u[2] = {(k % side + 0.5f) / side, (k / side + 0.5f) / side};
        auto s = light.Sample_Li(n, u);
        if (!s) continue;
        reflected += s->L[1] * s->wi[1] / (3.14159265 * s->pdf) / (side * side);
        double difference = light.PDF_Li(n, s->wi) / s->pdf - 1;
        largest = difference > largest ? difference : -difference > largest ? -difference : largest;
    }
    std::printf("reflected %.4f, pdfs differ by %.1e at most\n", reflected, largest);
    try {
        ProductLight missing("missing.hdr");
        return 2;
    } catch (const std::runtime_error &error) {
        std::printf("as expected: %s\n", error.what());
    }
    return reflected > 0 && largest < 0.05 ? 0 : 1;
} catch (const std::exception &error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
}
