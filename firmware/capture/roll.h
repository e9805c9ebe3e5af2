/* roll.h - the frames of one camera that a take has kept so far: probes of the meter, exposures of
 * the bracket, extension.
 * thread: one. */
#ifndef CAPTURE_ROLL_H
#define CAPTURE_ROLL_H

#include "firmware/capture/take.h"

enum { ROLL_MAX = 3 * BRACKET_EXPOSURES_MAX };

struct roll {
    int n;
    struct {
        struct take_frame frame;
        bool used; // belongs to the take, not only to metering
    } kept[ROLL_MAX];
};

/* Copy a driver's frame.
 * err:  ERR_NOMEM, ERR_LIMIT (full) */
MUST_USE err_t roll_add(struct roll *r, const struct take_frame *t, const struct frame *f,
                        bool used);

/* Forget all from that one on. */
void roll_cut(struct roll *r, int from);

size_t roll_bytes(const struct roll *r);
int roll_used(const struct roll *r);

/* Tell the meter the frames from that one on.
 * px: room for a small picture (drivers/format/thin.h). err: as thin_run. */
MUST_USE err_t roll_meter(const struct roll *r, int from, const struct take_camera *c,
                          struct raw *px, struct meter *m);

/* What the used frames leave uncovered; pictures that cannot be had count for nothing. */
void roll_cover(const struct roll *r, const struct take_camera *c, const struct meter_config *cfg,
                struct meter_cover *out);

/* Used frames into the take by rising exposure, the others are forgotten. */
void roll_move(struct roll *r, struct take *t);

#endif
