/* label.h - which exposure a frame of one camera had, by three kinds of evidence: the log of
 * requests, the pixels compared with frames whose exposure is known, and the device's report.
 *
 * The pixels decide among the exposures that the requests allow; the report must agree. An exposure
 * can be in force from `lo` frames after its request on; from `hi` frames on it is, until a later
 * one is. Both numbers hold until the pixels show otherwise, within 0..`doubt`.
 * Ages of requests are intervals: sequence numbers and time stamps may contradict each other.
 * thread: any, one at a time per struct. */
#ifndef CAPTURE_LABEL_H
#define CAPTURE_LABEL_H

#include "firmware/capture/evidence.h"

#include "core/photo/exposure_anchor.h"
#include "core/photo/flicker.h"

enum {
    LABEL_LOG = 64,
    LABEL_REFERENCE =
        BRACKET_EXPOSURES_MAX, // this anchor is the reference; those below are kept frames
    LABEL_LAST,                // the frame before; only its rows are compared
    LABEL_ANCHORS,
    LABEL_BASE = BRACKET_EXPOSURES_MAX, // index of a request for the base exposure
    LABEL_OTHER                         // index of a request from another plan
};

struct label_request {
    int index;                              // in the plan, or LABEL_BASE, LABEL_OTHER
    struct exposure requested, set, expect; // set: read back; expect: as the sensor should take it
    double stops, from; // log2 of expect, now and in the request before; NAN: none
    int age_lo, age_hi; // frames since the one that ran during the request
    int64_t asked_ns, answered_ns;
};

struct label {
    struct bracket_camera cfg;
    int lo, hi, doubt; // frames
    bool guess;        // lo..hi is guessed
    struct flicker_light light;
    struct label_request log[LABEL_LOG];
    int n; // oldest first
    struct exposure_anchor anchor[LABEL_ANCHORS];
    float moving; // share of the picture that moved between frames at rest
    bool seen; // there was a frame before; the rest describes it
    uint32_t sequence;
    int64_t stamp_ns, shown_ns; // shown: stamp if it can be true, else arrival
    bool sane;                  // the stamp can be true
};

enum label_verdict {
    LABEL_PROVEN,    // one exposure fits requests, pixels and report
    LABEL_BLIND,     // the requests allow one only; the pixels show nothing
    LABEL_UNDECIDED, // several exposures fit
    LABEL_SHIFTED,   // the pixels show an exposure a little too old or too young for the delay
    LABEL_CONFLICT
};

struct label_look {
    enum label_verdict verdict;
    int entry;                // in the log; -1: none
    struct exposure exposure; // to be recorded: as reported, else expected
    bool disagrees;           // pixels and requests agree, the report does not
    bool measured, changed;   // by pixels; the light changed in parts
    bool weak; // measured by few patches of a picture that moves: says nothing against an exposure
    bool torn;                // some rows side by side have another exposure than the rest
    uint32_t sure;       // rows that surely have this exposure: all at rest, else by label_whole
    bool whole;          // every row is sure, or would look the same
    double stops, error; // if measured: log2 of exposure, s
    double slack;        // stops: flicker of the anchor, after the verdict also of the frame
    double lo, hi;       // bounds of `stops`, measured or not
    int by, patches;     // anchor compared with; patches used
    float ratio;         // stops, to the anchor
    int dark, clipped;   // patches of both
};

/* err:  ERR_ARG names camera i, field and bound. */
MUST_USE err_t label_check(int i, const struct bracket_camera *c);

void label_init(struct label *l, const struct bracket_camera *cfg);

/* Forgets requests and frames. base: the exposure asked for last, NULL: not known. */
void label_restart(struct label *l, const struct exposure *base, int64_t now_ns);

/* Logs a request that the camera accepted. */
void label_asked(struct label *l, const struct label_request *r);

/* The last request; NULL: none. */
const struct label_request *label_newest(const struct label *l);

/* Whether f is the last frame again. */
bool label_duplicate(const struct label *l, const struct frame *f);

/* Ages the requests by a frame that arrived. Returns the least number of frames since the last. */
int label_advance(struct label *l, const struct frame *f, int64_t now_ns);

/* Whether the last request is in force for longer than any delay in doubt. */
bool label_rested(const struct label *l);

/* Whether the last request alone is in force, if the delay is right. */
bool label_alone(const struct label *l);

/* Stops from an exposure to the nearest frame to compare with. */
double label_distance(const struct label *l, double stops);

/* Whether entry `entry` of the log can no longer be in force. */
bool label_passed(const struct label *l, int entry);

/* The longest frame of all exposures that may be in force or come, s. */
double label_longest_s(const struct label *l);

void label_look(const struct label *l, const struct frame *f, const struct exposure_probe *w,
                struct label_look *out);

/* Sets k->sure and k->whole of a frame that was looked at: the rows that surely have no former
 * exposure, and whether all rows that could show one are sure. */
void label_whole(const struct label *l, const struct exposure_probe *w, struct label_look *k);

/* As label_whole; from now on this is the frame before. */
void label_last(struct label *l, const struct exposure_probe *w, struct label_look *k);

/* The delay is unknown after all; an unknown delay is narrowed by a proven look; the promised delay
 * holds again. */
void label_doubt(struct label *l);
void label_narrow(struct label *l, const struct label_look *k);
void label_trust(struct label *l);

/* Whether the delay varies and the device does not report exposures: a flash of light could make a
 * frame look like its neighbour in time. */
bool label_unsteady(const struct label *l);

/* The evidence for a kept frame; the caller fills in the fields about the plan. */
void label_evidence(const struct label *l, const struct frame *f, const struct label_look *k,
                    struct bracket_evidence *out);

/* Makes a frame an anchor; k is its look. */
void label_hold(struct label *l, int index, const struct exposure_probe *w,
                const struct label_look *k);

/* Makes a rested frame of the base exposure the reference.
 * out: whether it looks like the reference before.
 * err:  ERR_AGAIN (the device reports another exposure; there is no reference then) */
MUST_USE err_t label_settle(struct label *l, const struct frame *f, const struct exposure_probe *w,
                            bool *same);

/* Forgets the kept frames, or all anchors. */
void label_forget(struct label *l, bool reference);

/* The exposure as the device rounds its time. */
struct exposure label_rounded(const struct label *l, const struct exposure *e);

/* Log2 of an exposure, s. */
double label_stops(const struct exposure *e);

/* Whether two exposures are too near to be told apart. */
bool label_same(double stops_a, double stops_b);

#endif
