/* pair.h - which corners of two views are the same point.
 * Pure computation; views are shared, a pair and a workspace belong to one worker at a time. */
#ifndef SFM_PAIR_H
#define SFM_PAIR_H

#include "core/base/types.h"
#include "core/kernels/kernels.h"
#include "core/sfm/corner.h"
#include "core/sfm/epipolar.h"

enum {
    PAIR_ALL = 64,   // views that are compared all with all
    PAIR_LEAST = 12, // matches that one epipolar geometry must explain
    PAIR_SURE = 40   // from which on a need not be turned, nor b stretched
};
#define PAIR_BOUND 1.5f // px, Sampson distance of corners that agree

/* One match. */
struct pair_link {
    float doubt;  // squared distance over that of the next best, 0..1
    int16_t a, b; // corners
};

/* Two views, a < b. */
struct pair {
    int a, b, n;
    struct pair_link *link; // (corner_cap) the surest first
    double f[9];            // epipolar geometry, see epipolar.h
    bool known;             // f
    int agree;              // links that f explains
    int turn;               // eighths of a full turn, from x to y, that bring a to look like b
    bool tilted;            // links are those with b stretched as well
};

/* All views. */
struct pair_views {
    const struct kernels *k;
    const struct correspondence *prior; // NULL: none
    int n, size, cap;                   // views; px, longest edge; corner_cap
    struct corner_view *view;           // (n)
    double *bend;                       // (n) of each view's lens, epipolar.h
    int *token;                         // (n, cap) patch of the network that a corner lies in
};

/* Scratch of a worker. */
struct pair_workspace {
    size_t pitch;                 // of product
    const int8_t *descriptor;     // (n, CORNER_DESCRIPTOR) of b, those that are compared
    const int32_t *square_b;      // (n)
    int8_t *panels;               // descriptor, packed for gemm_s8
    int32_t *product;             // (rows, pitch)
    int32_t *column;              // (cap) smallest distance to each corner of b
    int16_t *from;                // (cap) the corner of a at that distance
    int16_t *to;                  // (cap) nearest in b of each corner of a
    float *doubt;                 // (cap)
    int16_t *near;                // (cap) corners of b on a line
    int8_t *turned;               // (rows, CORNER_DESCRIPTOR) descriptors of a
    int32_t *square;              // (rows) sums of the squares of these
    struct epipolar_match *match; // (cap)
    uint8_t *expected;            // (grid^2) whether the network's attention is on this token
};

/* Memory of the views, of which n, size and extent are read, and of a worker. out->k and out->prior
 * are the caller's.
 * err:  ERR_NOMEM. */
MUST_USE err_t pair_views_init(struct arena *tmp, const struct views *v, struct pair_views *out);
MUST_USE err_t pair_workspace_init(struct arena *tmp, const struct pair_views *v,
                                   struct pair_workspace *w);

/* n descriptors as panels of gemm_s8: (n in whole panels, CORNER_DESCRIPTOR), the rest is 0. */
void pair_pack(const int8_t *descriptor, int n, int8_t *panels);

/* After corner_run of view i. */
void pair_prepare(const struct pair_views *m, int i);

/* Compare all corners: fill c, whose a, b and link are set, with matches, many of them wrong. */
void pair_search(const struct pair_views *m, struct pair_workspace *w, struct pair *c);

/* After pair_search: matches with a turned in the best of some turns (bit k: k eighths) instead, if
 * one geometry explains more of them. */
void pair_turn(const struct pair_views *m, struct pair_workspace *w, struct pair *c,
               unsigned turns);

/* After pair_search and corner_tilt of b: add the matches with the stretched views of b, if one
 * geometry explains more of them. */
void pair_tilt(const struct pair_views *m, struct pair_workspace *w, struct pair *c);

/* After pair_search: fill c with the matches along its epipolar lines; without a geometry that
 * enough matches agree with, n is 0. bend: of m; `again` where it was another before. */
void pair_complete(const struct pair_views *m, struct pair_workspace *w, struct pair *c,
                   bool again);

/* Two points of views a and b, px of these, for epipolar_distance with a pair's f. */
struct epipolar_match pair_match(const struct pair_views *m, int a, int b, const float at[4]);

/* The surest matches of a pair, `most` of them if there are as many; returns their number. */
int pair_matches(const struct pair_views *m, const struct pair *c, int most,
                 struct epipolar_match *match);

static inline struct epipolar_bend pair_bend(const struct pair_views *m, const struct pair *c)
{
    return (struct epipolar_bend){m->bend[c->a], m->bend[c->b]};
}

#endif
