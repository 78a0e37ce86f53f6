// Samplers of light directions in proportion to environment light x BRDF x cosine. Generated from capi/src by cbindgen; a test compares them.

#ifndef HEADTAIL_H
#define HEADTAIL_H

#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>

// The result of a call.
typedef enum {
    // The call succeeded.
    HEADTAIL_STATUS_OK = 0,
    // An argument or the content of a file is invalid.
    HEADTAIL_STATUS_INVALID = 1,
    // A file cannot be read.
    HEADTAIL_STATUS_IO = 2,
    // An internal error of the library. Objects stay usable.
    HEADTAIL_STATUS_INTERNAL = 3,
} HeadtailStatus;

// A handle of an open environment, sampler, material or list of prepared points; 0 is never a valid handle.
typedef uint64_t HeadtailHandle;

// Shading points. Each list has one entry for all points, or one per point. Surfaces are diffuse, unless `alpha`,
// `roughness` or `material` is given.
typedef struct {
    // Unit shading normals in world space, three floats each.
    const float *n;
    // Number of entries of `n`.
    uintptr_t n_count;
    // Unit directions to the viewer; NULL uses the normals, which suffices for diffuse surfaces.
    const float *wo;
    // Number of entries of `wo`.
    uintptr_t wo_count;
    // Trowbridge-Reitz widths from 0.001 to 1 of glossy surfaces, or NULL.
    const float *alpha;
    // Number of entries of `alpha`.
    uintptr_t alpha_count;
    // Their reflectances at normal incidence from 0 to 1; NULL uses 1.
    const float *f0;
    // Number of entries of `f0`.
    uintptr_t f0_count;
    // Roughness, from 0 to 1, of the metallic-roughness surfaces of glTF, or NULL.
    const float *roughness;
    // Number of entries of `roughness`.
    uintptr_t roughness_count;
    // Metalness of these, from 0 to 1; NULL uses 0.
    const float *metallic;
    // Number of entries of `metallic`.
    uintptr_t metallic_count;
    // Base colours of these, linear Rec.709 from 0 to 1, three floats each; NULL uses white.
    const float *base_color;
    // Number of entries of `base_color`.
    uintptr_t base_color_count;
    // Positions in metres, three floats each, for samplers with visibility or portals; NULL for others.
    const float *p;
    // Number of entries of `p`.
    uintptr_t p_count;
    // The measured or neural material of all surfaces, or 0.
    HeadtailHandle material;
    // Texture coordinates of a neural material, two floats each; NULL for others, as the following. The texture
    // repeats with period 1.
    const float *uv;
    // Number of entries of `uv`.
    uintptr_t uv_count;
    // Directions in world space in which u grows, of any length, and 1, or -1 where the texture is mirrored: four
    // floats each, as tangents of glTF.
    const float *tangent;
    // Number of entries of `tangent`.
    uintptr_t tangent_count;
    // Standard deviations of pixels' footprints on the surface, in units of the texture coordinates; NULL uses 0,
    // which is the finest detail.
    const float *footprint;
    // Number of entries of `footprint`.
    uintptr_t footprint_count;
} HeadtailPoints;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Returns the error message of this thread's last call that did not return HEADTAIL_STATUS_OK. It stays
// valid until the next such call.
const char *headtail_last_error(void);

// Opens an environment by its UTF-8 name: a built-in one (overcast, window, studio, sunset) or a Radiance
// .hdr file. For other formats, pass the texels to headtail_environment_from_texels.
//
// # Safety
// `name` is NULL or ends with a zero byte; `out` is NULL or may be written to.
HeadtailStatus headtail_environment_open(const char *name, HeadtailHandle *out);

// Creates an environment from linear Rec.709 radiance, three floats per texel, rows from the top.
//
// # Safety
// `texels` is NULL or holds 3 * width * height floats; `out` is NULL or may be written to.
HeadtailStatus headtail_environment_from_texels(uintptr_t width,
                                                uintptr_t height,
                                                const float *texels,
                                                HeadtailHandle *out);

// Opens a measured or neural material by its UTF-8 name: "nbrdf:FILE#NAME" or "neural:FILE".
//
// # Safety
// `name` is NULL or ends with a zero byte; `out` is NULL or may be written to.
HeadtailStatus headtail_material_open(const char *name, HeadtailHandle *out);

// Creates the sampler of a SPEC for an environment, as on the command line: "auto" (here the same as
// "patches", because there is no scene), "mis", "direct:FILE", "patches+vis:FILE", ... Visibility and portals in files
// are in the coordinates of the scene that they were made for, and need the positions of points.
//
// # Safety
// `spec` is NULL or ends with a zero byte; `out` is NULL or may be written to.
HeadtailStatus headtail_sampler_from_spec(const char *spec, HeadtailHandle environment, HeadtailHandle *out);

// Opens a sampler's file for the environment that it was built for.
//
// # Safety
// `path` is NULL or ends with a zero byte; `out` is NULL or may be written to.
HeadtailStatus headtail_sampler_open(const char *path, HeadtailHandle environment, HeadtailHandle *out);

// Writes the description of a sampler, as zero-terminated JSON, into `buffer`, truncated to `capacity`.
// `length`, which may be NULL, is set to the required bytes, including the terminating zero.
//
// # Safety
// `buffer` is NULL or has room for `capacity` bytes; `length` is NULL or may be written to.
HeadtailStatus headtail_sampler_describe(HeadtailHandle sampler, char *buffer, uintptr_t capacity, uintptr_t *length);

// Samples a direction for each of `count` points. `u` holds two uniform numbers in [0, 1) per point; if it
// is NULL, random numbers are generated from `seed`. `wi` receives three floats per point, `pdf` one,
// `radiance`, which may be NULL, three. A pdf of 0 marks no sample; the other results are then 0.
//
// # Safety
// Lists are NULL or as long as their counts. Results may be written to, and do not overlap each other or
// other lists.
HeadtailStatus headtail_sampler_sample(HeadtailHandle sampler,
                                       const HeadtailPoints *points,
                                       uintptr_t count,
                                       const float *u,
                                       uint64_t seed,
                                       float *wi,
                                       float *pdf,
                                       float *radiance);

// Evaluates the solid-angle pdfs with which [`headtail_sampler_sample`] samples the `count` unit directions
// `wi` at the points.
//
// # Safety
// As for [`headtail_sampler_sample`].
HeadtailStatus headtail_sampler_pdf(HeadtailHandle sampler,
                                    const HeadtailPoints *points,
                                    uintptr_t count,
                                    const float *wi,
                                    float *pdf);

// Evaluates BRDF times max(0, cosine) of the `count` unit directions `wi` at the points, in 1/sr: `value` receives
// three floats per point, linear Rec.709. Surfaces that are not diffuse need `wo`.
//
// # Safety
// As for [`headtail_sampler_sample`].
HeadtailStatus headtail_brdf_cosine(const HeadtailPoints *points, uintptr_t count, const float *wi, float *value);

// Prepares `count` points for a sampler, whose samples and pdfs then cost less: copies the points, and computes what
// the sampler needs of each. Close the handle when the points are done.
//
// # Safety
// As for [`headtail_sampler_sample`]; `out` is NULL or may be written to.
HeadtailStatus headtail_points_prepare(HeadtailHandle sampler,
                                       const HeadtailPoints *points,
                                       uintptr_t count,
                                       HeadtailHandle *out);

// [`headtail_sampler_sample`] for prepared points; `count` is their number.
//
// # Safety
// As for [`headtail_sampler_sample`].
HeadtailStatus headtail_points_sample(HeadtailHandle points,
                                      uintptr_t count,
                                      const float *u,
                                      uint64_t seed,
                                      float *wi,
                                      float *pdf,
                                      float *radiance);

// [`headtail_sampler_pdf`] for prepared points; `count` is their number.
//
// # Safety
// As for [`headtail_sampler_sample`].
HeadtailStatus headtail_points_pdf(HeadtailHandle points, uintptr_t count, const float *wi, float *pdf);

// Closes an environment, a sampler, a material, or prepared points. Samplers and prepared points keep what they need.
HeadtailStatus headtail_close(HeadtailHandle handle);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* HEADTAIL_H */
