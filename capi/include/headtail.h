// Samplers of light directions in proportion to environment light x BRDF x cosine. Generated from capi/src by cbindgen; a test compares them.

#ifndef HEADTAIL_H
#define HEADTAIL_H

#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>

// How a call ended.
typedef enum {
    // All is well.
    HEADTAIL_STATUS_OK = 0,
    // An argument or the content of a file cannot be used.
    HEADTAIL_STATUS_INVALID = 1,
    // The system refused to read a file.
    HEADTAIL_STATUS_IO = 2,
    // A fault of the library itself. Objects stay usable.
    HEADTAIL_STATUS_INTERNAL = 3,
} HeadtailStatus;

// An environment or a sampler that is open. 0 is none.
typedef uint64_t HeadtailHandle;

// Shading points. Each list has one entry for all points, or one for each.
typedef struct {
    // Unit shading normals in world space, three floats each.
    const float *n;
    // Entries of `n`.
    uintptr_t n_count;
    // Unit directions to the viewer; NULL takes the normals, which is enough for diffuse surfaces.
    const float *wo;
    // Entries of `wo`.
    uintptr_t wo_count;
    // Trowbridge-Reitz widths from 0.001 to 1; NULL for diffuse surfaces.
    const float *alpha;
    // Entries of `alpha`.
    uintptr_t alpha_count;
    // Reflectances at normal incidence from 0 to 1; NULL takes 1.
    const float *f0;
    // Entries of `f0`.
    uintptr_t f0_count;
} HeadtailPoints;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The sentence of the last call of this thread that did not end with HEADTAIL_STATUS_OK. It stays valid until the next such call.
const char *headtail_last_error(void);

// Opens an environment: a built-in one (overcast, window, studio, sunset) or a Radiance .hdr file, by its UTF-8 name. Of other formats, give the
// texels to headtail_environment_from_texels.
//
// # Safety
// `name` is NULL or ends with a zero byte; `out` is NULL or may be written to.
HeadtailStatus headtail_environment_open(const char *name,
                                         HeadtailHandle *out);

// Makes an environment of linear Rec.709 radiance, three floats for each texel, rows from the top.
//
// # Safety
// `texels` is NULL or holds 3 * width * height floats; `out` is NULL or may be written to.
HeadtailStatus headtail_environment_from_texels(uintptr_t width,
                                                uintptr_t height,
                                                const float *texels,
                                                HeadtailHandle *out);

// Makes the sampler of a SPEC for an environment: "auto", which is "patches" where there is no scene; "mis", "direct:FILE", ... as on the
// command line.
//
// # Safety
// `spec` is NULL or ends with a zero byte; `out` is NULL or may be written to.
HeadtailStatus headtail_sampler_from_spec(const char *spec,
                                          HeadtailHandle environment,
                                          HeadtailHandle *out);

// Opens a sampler's file for the environment that it was made for.
//
// # Safety
// `path` is NULL or ends with a zero byte; `out` is NULL or may be written to.
HeadtailStatus headtail_sampler_open(const char *path, HeadtailHandle environment, HeadtailHandle *out);

// Writes what a sampler says of itself, as JSON that ends with a zero byte, into `buffer`, as much of it as fits. `length` becomes the bytes that all
// of it needs, the zero included; it may be NULL.
//
// # Safety
// `buffer` is NULL or has room for `capacity` bytes; `length` is NULL or may be written to.
HeadtailStatus headtail_sampler_describe(HeadtailHandle sampler,
                                         char *buffer,
                                         uintptr_t capacity,
                                         uintptr_t *length);

// Draws a direction for each of `count` points. `u` holds two uniform numbers of [0, 1) for each; where it is NULL, random numbers of `seed` are
// taken. `wi` gets three floats for each point, `pdf` one, `radiance`, which may be NULL, three. A pdf of 0 is no sample; the other results are then 0.
//
// # Safety
// Lists are NULL or as long as their counts say. Results may be written to, and share no memory with each other or with other lists.
HeadtailStatus headtail_sampler_sample(HeadtailHandle sampler,
                                       const HeadtailPoints *points,
                                       uintptr_t count,
                                       const float *u,
                                       uint64_t seed,
                                       float *wi,
                                       float *pdf,
                                       float *radiance);

// The solid-angle pdfs with which [`headtail_sampler_sample`] draws the `count` unit directions `wi` at the points.
//
// # Safety
// As for [`headtail_sampler_sample`].
HeadtailStatus headtail_sampler_pdf(HeadtailHandle sampler,
                                    const HeadtailPoints *points,
                                    uintptr_t count,
                                    const float *wi,
                                    float *pdf);

// Closes an environment or a sampler. A sampler keeps what it needs of its environment.
HeadtailStatus headtail_close(HeadtailHandle handle);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* HEADTAIL_H */
