/* exposure_anchor.h - frames whose exposure is known, and what comparison with them says about
 * another frame of the scene: its exposure, whether its light changed in parts, and which of its
 * rows surely have no other exposure (core/photo/README.md 5.1).
 * Pure; any thread. */
#ifndef PHOTO_EXPOSURE_ANCHOR_H
#define PHOTO_EXPOSURE_ANCHOR_H

#include "core/photo/exposure_probe.h"

/* Stops by which an exposure may be wrong: from this tolerance on, the response is not calibrated
 * and bends all ratios. */
#define EXPOSURE_ANCHOR_LOOSE 0.2
#define EXPOSURE_ANCHOR_DOUBTED 2.0 // standard errors that a decision must bear
#define EXPOSURE_ANCHOR_SAME 0.005  // stops: nearer exposures are not told apart

struct exposure_anchor {
    struct exposure_probe seen;
    double stops, error; // log2 of exposure for comparisons, s; its standard error
    double slack;        // stops by which flicker may have changed it
    double recorded;     // log2 of the exposure that is recorded
    bool held, proven;
    uint32_t sure; // rows that surely have this exposure: only they are evidence for others
};

struct exposure_anchor_ratio {
    bool changed;        // parts of the picture have another ratio than the rest
    bool torn;           // some rows side by side have another ratio than the rest
    bool accurate;       // enough patches, and errors that the tolerance bears
    double stops, error; // if accurate: log2 of the frame's exposure, s
    double lo, hi;       // bounds of it, accurate or not
    float ratio;         // stops, to the anchor
    int patches;
};

/* What a comparison allows for. */
struct exposure_anchor_doubt {
    double tolerance; // stops by which an exposure may be wrong
    double slack;     // stops by which flicker may have changed a row of the frame
    float moving;     // share of the picture that moves, 0..1
};

/* Compare the frame w with an anchor. */
void exposure_anchor_compare(const struct exposure_anchor *a, const struct exposure_probe *w,
                             const struct exposure_anchor_doubt *doubt,
                             struct exposure_anchor_ratio *out);

/* Whether w looks like the anchor, at the same exposure. The slack is that of both; what moves is
 * asked here.
 * out: *moved: the share of the patches that do not. */
bool exposure_anchor_alike(const struct exposure_anchor *a, const struct exposure_probe *w,
                           const struct exposure_anchor_doubt *doubt, float *moved);

struct exposure_anchor_pair {
    double stops, other; // log2 of exposure, s: that of the frame, and that which rows may have
};

/* Add the rows of a frame that by this anchor cannot have the other exposure of the pair, and those
 * which would look alike. A row that looks alike is no evidence for the next frame: it may be torn
 * itself. */
void exposure_anchor_refute(const struct exposure_anchor *a, const struct exposure_probe *w,
                            const struct exposure_anchor_pair *pair,
                            const struct exposure_anchor_doubt *doubt,
                            struct exposure_probe_rows *rows);

#endif
