/* division.h - rough lenses from matches alone, before any camera is known: how strongly each
 * distorts and its focal length. Where pictures are bent, one epipolar geometry explains only the
 * matches of a part of them, and focal length and depth trade with distortion; so this comes first.
 * One number describes the distortion (division model, see struct epipolar_bend).
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef SFM_DIVISION_H
#define SFM_DIVISION_H

#include "core/base/lens.h"
#include "core/base/types.h"
#include "core/sfm/epipolar.h"

enum { DIVISION_MATCHES = 200 }; // of a pair that are looked at

/* Matches of views a < b. */
struct division_pair {
    int a, b, n;
    const struct epipolar_match *match; // (n) the surest first
};

struct division_views {
    int n_lenses, n_pairs;
    const int *lens_of;               // (views)
    const double *frame;              // (n_lenses) px, from the middle to the corner
    const double *focal;              // (n_lenses) px, what is expected; used as start
    struct epipolar_search search;    // how pairs are matched
    const struct division_pair *pair; // (n_pairs)
};

struct division_lens {
    double bend;  // px^-2
    double focal; // px
};

/* Lenses of views, to be found: `focal` is what is expected at first. */
struct division_lenses {
    int n;
    const int *of;              // (views)
    struct division_lens *lens; // (n)
};

/* out:  (n_lenses); all bends are 0 unless some explain clearly more matches.
 * err:  ERR_NOMEM (see division_plan), ERR_CANCELLED. */
MUST_USE err_t division_run(const struct run *r, const struct division_views *v,
                            struct division_lens *out);
size_t division_plan(int n_lenses, int n_pairs);

/* The lens of struct lens that is nearest over the frame: RADIAL, or OPENCV_FISHEYE with one term
 * where the corners of the frame look far aside; PINHOLE where bend is 0.
 * err:  those of lens_init. */
MUST_USE err_t division_fit(const struct division_lens *d, double frame, struct lens *out);

#endif
