/* label.h - which exposure a frame of one camera had, by the evidence at hand: the log of requests,
 * the pixels against frames whose exposure is known, and what the device reports.
 *
 * Pixels decide; requests say what they may decide for; the device must agree. An exposure can be
 * in force from `lo` frames after its request on, and is so from `hi` frames on until a later one
 * is. Both are believed until the pixels show otherwise, within 0..`doubt`.
 * Ages of requests are intervals: sequence numbers and time stamps may contradict each other.
 * thread: any, one at a time per struct. */
#ifndef CAPTURE_LABEL_H
#define CAPTURE_LABEL_H

#include "firmware/capture/evidence.h"

#include "core/photo/exposure_probe.h"
#include "core/photo/flicker.h"

enum {
    LABEL_LOG = 64,
    LABEL_REFERENCE = BRACKET_EXPOSURES_MAX, // anchor; the others are kept frames by index
    LABEL_LAST,                              // the frame before, for its rows only
    LABEL_ANCHORS,
    LABEL_BASE = BRACKET_EXPOSURES_MAX, // index of a request for the base exposure
    LABEL_OTHER                         // of one for another plan
};

struct label_request {
    int index;                        // of the plan, LABEL_BASE or LABEL_OTHER
    struct exposure ask, set, expect; // set: read back; expect: what the sensor should make of it
    double stops, from;               // log2 of expect; of the request before, NAN: none
    int age_lo, age_hi;               // frames since the one that ran during the request
    int64_t asked_ns, answered_ns;
};

/* A frame whose exposure is known. */
struct label_anchor {
    struct exposure_probe seen;
    double stops, error; // log2 of exposure for comparisons, s; its standard error
    double slack;        // stops: flicker may have made it look so much brighter or darker
    double recorded;     // log2 of the exposure that is written down
    bool held, proven;
    uint32_t sure; // rows of it that surely have no other exposure: only they tell of others' rows
};

struct label {
    struct bracket_camera cfg;
    int lo, hi, doubt; // frames
    bool guess;        // lo..hi is not known, but a guess
    struct flicker_light light;
    struct label_request log[LABEL_LOG];
    int n; // oldest first
    struct label_anchor anchor[LABEL_ANCHORS];
    bool seen; // the frame before:
    uint32_t sequence;
    int64_t stamp_ns, shown_ns; // shown: stamp if it can be true, else arrival
    bool sane;                  // the stamp can be true
};

enum label_verdict {
    LABEL_PROVEN,    // one exposure fits requests, pixels and report
    LABEL_BLIND,     // the only one by the requests; pixels can tell nothing
    LABEL_UNDECIDED, // several may be
    LABEL_SHIFTED,   // pixels say one that is a little too old or too young for the delay
    LABEL_CONFLICT
};

struct label_look {
    enum label_verdict verdict;
    int entry;                // of the log; -1: none
    struct exposure exposure; // to be recorded: as reported, else expected
    bool disagrees;           // pixels and requests fit, the report does not
    bool measured, changed;   // by pixels; the light of parts changed
    bool torn;                // rows side by side had another exposure than the rest
    uint32_t sure;            // rows that surely had not: all at rest, else by label_whole
    bool whole;               // all are sure, or would look the same
    double stops, error;      // if measured: log2 of exposure, s
    double slack;             // stops: flicker of the anchor, and after the verdict of the frame
    double lo, hi;            // bounds of it in any case
    int by, places;           // anchor
    float ratio;              // stops, to it
    int dark, clipped;        // places, of both
};

/* err:  ERR_ARG names camera i, field and bound. */
MUST_USE err_t label_check(int i, const struct bracket_camera *c);

void label_init(struct label *l, const struct bracket_camera *cfg);

/* Forget requests and frames. base: the exposure asked for last, NULL: not known. */
void label_restart(struct label *l, const struct exposure *base, int64_t now_ns);

/* A request that the camera took. */
void label_asked(struct label *l, const struct label_request *r);

/* The last request; NULL: none. */
const struct label_request *label_newest(const struct label *l);

/* The same frame once more. */
bool label_duplicate(const struct label *l, const struct frame *f);

/* A frame arrives; returns the least number of frames since the one before. */
int label_advance(struct label *l, const struct frame *f, int64_t now_ns);

/* The last request is in force for so long that nobody can doubt it. */
bool label_rested(const struct label *l);

/* It is in force, and alone, if the delay is right; and was so in the frame before. */
bool label_alone(const struct label *l);
bool label_still(const struct label *l);

/* Stops from an exposure to the nearest frame to compare with. */
double label_distance(const struct label *l, double stops);

/* Nothing asked for so long ago can be in force. */
bool label_passed(const struct label *l, int entry);

/* The longest frame, s, by all that may be in force or comes. */
double label_longest_s(const struct label *l);

void label_look(const struct label *l, const struct frame *f, const struct exposure_probe *w,
                struct label_look *out);

/* Of a frame that was looked at: which rows surely are not of another exposure of before, and
 * whether that is so of all of them that would show it. */
void label_whole(const struct label *l, const struct exposure_probe *w, struct label_look *k);

/* The same; from now on it is the frame before. */
void label_last(struct label *l, const struct exposure_probe *w, struct label_look *k);

/* The delay: unknown after all; narrowed, if it is unknown, to what a proven look shows; as it was
 * promised. */
void label_doubt(struct label *l);
void label_narrow(struct label *l, const struct label_look *k);
void label_trust(struct label *l);

/* The delay varies, and nobody tells when a request took effect: a flash of light could make a
 * frame look like its neighbour in time. */
bool label_unsteady(const struct label *l);

/* What is known about a frame that is kept; the plan's fields are the caller's. */
void label_evidence(const struct label *l, const struct frame *f, const struct label_look *k,
                    struct bracket_evidence *out);

/* Make a frame an anchor; k is its look. */
void label_hold(struct label *l, int index, const struct exposure_probe *w,
                const struct label_look *k);

/* Make a rested frame of the base exposure the reference.
 * out: whether it looks like the reference before.
 * err:  ERR_AGAIN (the device reports another exposure; no reference then) */
MUST_USE err_t label_settle(struct label *l, const struct frame *f, const struct exposure_probe *w,
                            bool *same);

/* Forget kept frames, or all anchors. */
void label_forget(struct label *l, bool reference);

/* As the device rounds times. */
struct exposure label_rounded(const struct label *l, const struct exposure *e);

/* Log2 of an exposure, s. */
double label_stops(const struct exposure *e);

/* Exposures that nobody could tell apart. */
bool label_same(double stops_a, double stops_b);

#endif
