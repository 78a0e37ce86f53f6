// C++17 over headtail.h: objects that close themselves, exceptions, and lists with lengths that are checked.
//
//     headtail::environment map("room.hdr");
//     headtail::sampler sampler("patches", map);
//     std::vector<std::array<float, 3>> n(64, {0, 1, 0}), wi(64), radiance(64);
//     std::vector<float> pdf(64);
//     sampler.sample({n}, headtail::seed{1}, wi, pdf, radiance);

#ifndef HEADTAIL_HPP
#define HEADTAIL_HPP

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "headtail.h"

namespace headtail {

// A call that failed: the message names the argument or the file.
class error : public std::runtime_error {
  public:
    error(HeadtailStatus status, const char *message) : std::runtime_error(message), status(status) {}
    HeadtailStatus status;
};

inline void check(HeadtailStatus status) {
    if (status != HEADTAIL_STATUS_OK) throw error(status, headtail_last_error());
}

// A list of elements of N floats each that it does not own: any contiguous container of such elements (std::vector,
// std::array, std::span, ...) whose type may be the renderer's own vector, or a pointer and a count.
struct any_list {};

template <std::size_t N, bool IsOutput = false> class list : any_list {
    using number = std::conditional_t<IsOutput, float, const float>;
    template <class Container> using element = std::remove_pointer_t<decltype(std::declval<Container &>().data())>;

  public:
    list() = default;
    list(number *numbers, std::size_t count) : numbers(numbers), count(count) {}
    // Results as an input.
    template <bool Other, class = std::enable_if_t<Other && !IsOutput>>
    list(const list<N, Other> &other) : numbers(other.data()), count(other.size()) {}
    template <class Container, class = decltype(std::declval<Container &>().data(), std::declval<Container &>().size()),
              class = std::enable_if_t<!std::is_base_of_v<any_list, std::decay_t<Container>>>>
    list(Container &&container) : numbers(reinterpret_cast<number *>(container.data())), count(container.size()) {
        using own = std::remove_reference_t<Container>;
        static_assert(sizeof(element<own>) == N * sizeof(float) && alignof(element<own>) == alignof(float) &&
                          std::is_trivially_copyable_v<element<own>>,
                      "elements must be N floats and nothing else");
        static_assert(!IsOutput || std::is_lvalue_reference_v<Container> || std::is_trivially_copyable_v<own>,
                      "results must not be written to a temporary container");
    }
    number *data() const { return numbers; }
    std::size_t size() const { return count; }
    bool empty() const { return count == 0; }

  private:
    number *numbers = nullptr;
    std::size_t count = 0;
};

template <std::size_t N> using results = list<N, true>;

// Shading points; each list has one entry for all points, or one per point. Without `wo`, directions to the viewer are
// the normals. Surfaces are diffuse; with `alpha` glossy, with `f0` as their reflectance at normal incidence (1 without
// it); with `roughness` those of glTF, with `metallic` (0) and `base_color` (white); with the handle of a `material`
// measured or neural, the latter with `uv`, `tangent` and `footprint` (0). Positions `p` are for samplers with visibility
// or portals.
struct points {
    list<3> n, wo{};
    list<1> alpha{}, f0{}, roughness{}, metallic{};
    list<3> base_color{}, p{};
    HeadtailHandle material = 0;
    list<2> uv{};
    list<4> tangent{};
    list<1> footprint{};

    operator HeadtailPoints() const {
        HeadtailPoints at{};
        at.n = n.data(), at.n_count = n.size();
        at.wo = wo.data(), at.wo_count = wo.size();
        at.alpha = alpha.data(), at.alpha_count = alpha.size();
        at.f0 = f0.data(), at.f0_count = f0.size();
        at.roughness = roughness.data(), at.roughness_count = roughness.size();
        at.metallic = metallic.data(), at.metallic_count = metallic.size();
        at.base_color = base_color.data(), at.base_color_count = base_color.size();
        at.p = p.data(), at.p_count = p.size();
        at.material = material;
        at.uv = uv.data(), at.uv_count = uv.size();
        at.tangent = tangent.data(), at.tangent_count = tangent.size();
        at.footprint = footprint.data(), at.footprint_count = footprint.size();
        return at;
    }
};

// The seed of random numbers in place of given ones.
struct seed {
    std::uint64_t number;
};

// A handle that is closed at the end of its life.
class object {
  public:
    object(object &&other) noexcept : own(std::exchange(other.own, 0)) {}
    object &operator=(object &&other) noexcept {
        std::swap(own, other.own);
        return *this;
    }
    ~object() {
        if (own) headtail_close(own);
    }
    HeadtailHandle handle() const { return own; }

  protected:
    object() = default;
    HeadtailHandle own = 0;
};

class environment : public object {
  public:
    // A built-in name, or a Radiance .hdr file.
    explicit environment(const std::string &name) { check(headtail_environment_open(name.c_str(), &own)); }

    // Linear Rec.709 radiance, width * height texels, rows from the top.
    environment(std::size_t width, std::size_t height, list<3> texels) {
        if (height == 0 || texels.size() / height != width || texels.size() % height != 0)
            throw std::invalid_argument("texels: not width * height");
        check(headtail_environment_from_texels(width, height, texels.data(), &own));
    }
};

class material : public object {
  public:
    // "nbrdf:FILE#NAME" or "neural:FILE".
    explicit material(const std::string &name) { check(headtail_material_open(name.c_str(), &own)); }
};

inline void same_length(const char *name, std::size_t length, std::size_t count) {
    if (length != count)
        throw std::invalid_argument(std::string(name) + ": has " + std::to_string(length) + " entries, not " + std::to_string(count));
}

// The lists of `count` points, whose lengths are checked.
inline HeadtailPoints checked_lists(const points &at, std::size_t count) {
    const auto one_or_all = [count](const char *name, std::size_t length, bool may_lack) {
        if (length != 1 && !(may_lack && length == 0)) same_length(name, length, count);
    };
    one_or_all("n", at.n.size(), false);
    one_or_all("wo", at.wo.size(), true);
    one_or_all("alpha", at.alpha.size(), true);
    one_or_all("f0", at.f0.size(), true);
    one_or_all("roughness", at.roughness.size(), true);
    one_or_all("metallic", at.metallic.size(), true);
    one_or_all("base_color", at.base_color.size(), true);
    one_or_all("p", at.p.size(), true);
    one_or_all("uv", at.uv.size(), true);
    one_or_all("tangent", at.tangent.size(), true);
    one_or_all("footprint", at.footprint.size(), true);
    return at;
}

// Evaluates BRDF times max(0, cosine) of unit directions, one per point, per channel in 1/sr.
inline void brdf_cosine(const points &at, list<3> wi, results<3> value) {
    same_length("wi", wi.size(), value.size());
    const HeadtailPoints checked = checked_lists(at, value.size());
    if (!value.empty()) check(headtail_brdf_cosine(&checked, value.size(), wi.data(), value.data()));
}

// Samples directions for points: one per point. Where the pdf is 0, there is no sample and all results are 0. All member
// functions may be called from any thread at any time.
class prepared_points : public object {
  public:
    std::size_t size() const { return count; }

    // From uniform numbers of [0, 1)^2. `radiance` may be left out.
    void sample(list<2> u, results<3> wi, results<1> pdf, results<3> radiance = {}) const {
        same_length("u", u.size(), count);
        draw(u.data(), 0, wi, pdf, radiance);
    }

    // From random numbers.
    void sample(seed random, results<3> wi, results<1> pdf, results<3> radiance = {}) const {
        draw(nullptr, random.number, wi, pdf, radiance);
    }

    // Evaluates the solid-angle pdfs with which `sample` samples unit directions.
    void pdf(list<3> wi, results<1> out) const {
        same_length("wi", wi.size(), count);
        same_length("pdf", out.size(), count);
        if (count) check(headtail_points_pdf(own, count, wi.data(), out.data()));
    }

  private:
    friend class sampler;
    explicit prepared_points(std::size_t count) : count(count) {}

    void draw(const float *u, std::uint64_t random, results<3> wi, results<1> pdf, results<3> radiance) const {
        same_length("wi", wi.size(), count);
        same_length("pdf", pdf.size(), count);
        if (!radiance.empty()) same_length("radiance", radiance.size(), count);
        if (count) check(headtail_points_sample(own, count, u, random, wi.data(), pdf.data(), radiance.data()));
    }

    std::size_t count;
};

// All member functions may be called from any thread at any time.
class sampler : public object {
  public:
    // A SPEC as on the command line, such as "patches" or "head+mis:FILE".
    sampler(const std::string &spec, const environment &map) {
        check(headtail_sampler_from_spec(spec.c_str(), map.handle(), &own));
    }

    // A sampler's file, for the environment that it was built for.
    static sampler open(const std::string &path, const environment &map) {
        sampler opened;
        check(headtail_sampler_open(path.c_str(), map.handle(), &opened.own));
        return opened;
    }

    // JSON.
    std::string description() const {
        std::uintptr_t length = 0;
        check(headtail_sampler_describe(own, nullptr, 0, &length));
        std::string text(length, '\0');
        check(headtail_sampler_describe(own, &text[0], length, nullptr));
        text.pop_back();
        return text;
    }

    // Samples one direction per point from uniform numbers of [0, 1)^2. Where the pdf is 0, there is no sample and all
    // results are 0. `radiance` may be left out.
    void sample(const points &at, list<2> u, results<3> wi, results<1> pdf, results<3> radiance = {}) const {
        same_length("u", u.size(), pdf.size());
        draw(at, u.data(), 0, wi, pdf, radiance);
    }

    // As above, from random numbers.
    void sample(const points &at, seed random, results<3> wi, results<1> pdf, results<3> radiance = {}) const {
        draw(at, nullptr, random.number, wi, pdf, radiance);
    }

    // Evaluates the solid-angle pdfs with which `sample` samples unit directions.
    void pdf(const points &at, list<3> wi, results<1> out) const {
        same_length("wi", wi.size(), out.size());
        const HeadtailPoints checked = checked_lists(at, out.size());
        if (!out.empty()) check(headtail_sampler_pdf(own, &checked, out.size(), wi.data(), out.data()));
    }

    // Prepares `count` points: their samples and pdfs then cost less.
    prepared_points prepare(const points &at, std::size_t count) const {
        prepared_points prepared(count);
        const HeadtailPoints checked = checked_lists(at, count);
        if (count) check(headtail_points_prepare(own, &checked, count, &prepared.own));
        return prepared;
    }

  private:
    sampler() = default;

    void draw(const points &at, const float *u, std::uint64_t random, results<3> wi, results<1> pdf, results<3> radiance) const {
        same_length("wi", wi.size(), pdf.size());
        if (!radiance.empty()) same_length("radiance", radiance.size(), pdf.size());
        const HeadtailPoints checked = checked_lists(at, pdf.size());
        if (pdf.empty()) return;
        check(headtail_sampler_sample(own, &checked, pdf.size(), u, random, wi.data(), pdf.data(), radiance.data()));
    }
};

}  // namespace headtail

#endif  // HEADTAIL_HPP
