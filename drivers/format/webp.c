/* The one file that knows libwebp. */
#include "drivers/format/webp.h"

#include <stdlib.h>
#include <webp/decode.h>

enum { CHANNELS = 4 };

err_t webp_size(const char *name, const void *bytes, size_t n, int *w, int *h)
{
    if (WebPGetInfo(bytes, n, w, h))
        return OK;
    *w = *h = 0;
    return err_fail(ERR_FORMAT, "%s: no WebP picture, or cut off", name);
}

static err_t decode(const char *name, const void *bytes, size_t n, const struct webp_picture *out)
{
    WebPDecoderConfig to;
    if (!WebPInitDecoderConfig(&to))
        return err_fail(ERR_UNSUPPORTED, "%s: libwebp is older than its header", name);
    to.output.colorspace = MODE_RGBA;
    to.output.is_external_memory = 1;
    to.output.u.RGBA = (WebPRGBABuffer){.rgba = out->px,
                                        .stride = out->w * CHANNELS,
                                        .size = (size_t)out->w * (size_t)out->h * CHANNELS};
    const VP8StatusCode status = WebPDecode(bytes, n, &to);
    if (status == VP8_STATUS_OK)
        return OK;
    if (status == VP8_STATUS_OUT_OF_MEMORY)
        return err_fail(ERR_NOMEM, "%s: no memory to decode %d x %d px", name, out->w, out->h);
    return err_fail(ERR_FORMAT, "%s: WebP of %d x %d px: %s", name, out->w, out->h,
                    status == VP8_STATUS_UNSUPPORTED_FEATURE ? "moving pictures are not read"
                    : status == VP8_STATUS_NOT_ENOUGH_DATA   ? "cut off"
                                                             : "damaged");
}

err_t webp_read(const char *name, const void *bytes, size_t n, size_t px_max,
                struct webp_picture *out)
{
    struct webp_picture p = {0};
    *out = p;
    err_t e = webp_size(name, bytes, n, &p.w, &p.h);
    if (e)
        return e;
    const size_t px = (size_t)p.w * (size_t)p.h; // WebP has 14 bits a side
    if (px > px_max)
        return err_fail(ERR_FORMAT, "%s: %d x %d px, at most %zu in all are read", name, p.w, p.h,
                        px_max);
    p.px = malloc(px * CHANNELS);
    e = p.px ? decode(name, bytes, n, &p)
             : err_fail(ERR_NOMEM, "%s: no memory for %d x %d px", name, p.w, p.h);
    if (!e)
        *out = p;
    else
        free(p.px);
    return e;
}
