#include "drivers/format/dotsplat.h"

#include "core/base/bytes.h"

#include <string.h>

enum { SPLAT_BYTES = 32 };

static err_t peek_splat(const struct splats_bytes *file, struct splats_info *out)
{
    memset(out, 0, sizeof *out);
    if (file->n % SPLAT_BYTES != 0 || file->n / SPLAT_BYTES > GAUSSIANS_MAX)
        return err_fail(ERR_FORMAT, "%s: %zu bytes, expected %d for each of at most %d splats",
                        file->what, file->n, SPLAT_BYTES, GAUSSIANS_MAX);
    out->n = (int)(file->n / SPLAT_BYTES);
    return OK;
}

static void take_splat(struct bytes *b, int i, struct gaussians *g)
{
    for (int k = 0; k < 3; k++)
        g->plane[G_MU + k][i] = bytes_f32(b);
    for (int k = 0; k < 3; k++)
        g->plane[G_LOG_SCALE + k][i] = splats_log_scale(bytes_f32(b));
    for (int c = 0; c < 3; c++)
        g->plane[G_SH + c][i] = splats_colour(bytes_u8(b));
    g->plane[G_LOGIT][i] = splats_logit(bytes_u8(b));
    for (int k = 0; k < 4; k++)
        g->plane[G_QUAT + k][i] = (float)(bytes_u8(b) - 128) / 128;
}

static err_t parse_splat(const struct splats_bytes *file, float ev, struct arena *a,
                         struct gaussians *g, struct gaussians_report *report)
{
    struct splats_info info;
    struct bytes b = bytes_of(file->p, file->n);
    memset(g, 0, sizeof *g);
    err_t e = peek_splat(file, &info);
    if (!e)
        e = gaussians_init(g, a, info.n, 0);
    if (e)
        return e;
    for (int i = 0; i < info.n; i++)
        take_splat(&b, i, g);
    g->n = info.n;
    splats_to_radiance(g, ev);
    gaussians_sanitize(g, report);
    return OK;
}

const struct splats_format dotsplat_format = {(uint64_t)SPLAT_BYTES * GAUSSIANS_MAX, 0, peek_splat,
                                              parse_splat};
