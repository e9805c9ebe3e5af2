#include "drivers/format/turn.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

/* Both axes of the stored picture may be exchanged, and run from their far end. */
void turn_upright(int orientation, const void *in, int w, int h, size_t bytes, void *out)
{
    const bool swap = orientation >= 5;
    const bool from_right = orientation == 2 || orientation == 3 || orientation >= 7;
    const bool from_below =
        orientation == 3 || orientation == 4 || orientation == 6 || orientation == 7;
    const int out_w = swap ? h : w, out_h = swap ? w : h;
    char *to = out;
    for (int y = 0; y < out_h; y++)
        for (int x = 0; x < out_w; x++, to += bytes) {
            const int u = swap ? y : x, v = swap ? x : y;
            const size_t at = (size_t)(from_below ? h - 1 - v : v) * (size_t)w +
                              (size_t)(from_right ? w - 1 - u : u);
            memcpy(to, (const char *)in + bytes * at, bytes);
        }
}

err_t turn_image16(int orientation, const char *name, struct image16 *io)
{
    const bool swap = orientation >= 5;
    struct image16 out = {swap ? io->h : io->w, swap ? io->w : io->h, 3, NULL};
    if (orientation == 1)
        return OK;
    out.px = malloc(3 * (size_t)io->w * (size_t)io->h * sizeof *out.px);
    if (!out.px)
        return err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", name, io->w, io->h);
    turn_upright(orientation, io->px, io->w, io->h, 3 * sizeof *io->px, out.px);
    free(io->px);
    *io = out;
    return OK;
}
