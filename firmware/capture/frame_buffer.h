/* frame_buffer.h - the frames of one camera that a take has kept so far: probes of the meter,
 * exposures of the bracket, extension.
 * thread: one. */
#ifndef CAPTURE_FRAME_BUFFER_H
#define CAPTURE_FRAME_BUFFER_H

#include "firmware/capture/take.h"

enum { FRAME_BUFFER_MAX = 3 * BRACKET_EXPOSURES_MAX };

struct frame_buffer {
    int n;
    struct {
        struct take_frame frame;
        bool used; // belongs to the take, not only to metering
    } kept[FRAME_BUFFER_MAX];
};

/* Copy a driver's frame.
 * err:  ERR_NOMEM, ERR_LIMIT (full) */
MUST_USE err_t frame_buffer_add(struct frame_buffer *r, const struct take_frame *t,
                                const struct frame *f, bool used);

/* Forget all from that one on. */
void frame_buffer_cut(struct frame_buffer *r, int from);

size_t frame_buffer_bytes(const struct frame_buffer *r);
int frame_buffer_used(const struct frame_buffer *r);

/* Tell the meter the frames from that one on.
 * px: room for a small picture (drivers/format/subsample.h). err: as subsample_run. */
MUST_USE err_t frame_buffer_meter(const struct frame_buffer *r, int from,
                                  const struct take_camera *c, struct raw *px, struct meter *m);

/* Shares of the picture that the used frames leave clipped or dark; pictures that cannot be had
 * count for nothing. */
void frame_buffer_cover(const struct frame_buffer *r, const struct take_camera *c,
                        const struct meter_config *cfg, struct meter_coverage *out);

/* Used frames into the take by rising exposure, the others are forgotten. */
void frame_buffer_move(struct frame_buffer *r, struct take *t);

#endif
