/* Any bytes as a camera's promise and a frame: what unpack accepts lies within its bits, what the
 * check accepts can be unpacked unless the decoder or the words say no. The frame's bytes are a
 * block of their own, so that reading one byte more is seen. */
#include "drivers/device/unpack.h"

#include "core/base/bytes.h"

#include <stdlib.h>
#include <string.h>

enum { HEAD = 17, COUNT_MAX = 1 << 20 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void unpack(const struct camera_info *info, const struct frame *f)
{
    size_t n = unpack_count(info);
    err_t checked = unpack_check(info, f);
    if (checked && !*err_text())
        abort();
    if (n == 0 && !checked)
        abort();
    if (n == 0 || n > COUNT_MAX)
        return;
    struct raw raw = {.px = malloc(n * sizeof *raw.px)};
    err_t e = unpack_run(info, f, &raw);
    if (!e && (checked || raw.bits < 8 || raw.bits > 16))
        abort();
    for (size_t i = 0; !e && i < n; i++)
        if (raw.px[i] >> raw.bits)
            abort();
    bool may_refuse =
        f->format == CAMERA_MJPG || (f->format >= CAMERA_GREY16 && f->format <= CAMERA_GBRG16);
    if (e && !checked && !may_refuse)
        abort();
    free(raw.px);
}

/* format, flags, w, h, bits, black, then stride and stride of the frame; the rest is the frame. */
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct bytes b = bytes_of(data, size);
    if (size < HEAD)
        return 0;
    struct camera_info info = {.format = (enum camera_format)bytes_u8(&b)};
    unsigned flags = bytes_u8(&b);
    info.limited = flags & 1;
    info.bt709 = flags & 2;
    info.w = bytes_u16(&b);
    info.h = bytes_u16(&b);
    info.bits = (int8_t)bytes_u8(&b);
    info.black = (int16_t)bytes_u16(&b);
    info.stride = (int32_t)bytes_u32(&b);
    struct frame f = {.format = flags & 4 ? CAMERA_YUYV : info.format,
                      .w = info.w - (flags & 8 ? 2 : 0),
                      .h = info.h,
                      .stride = (int32_t)bytes_u32(&b)};
    f.bytes = b.left;
    if (flags & 16)
        info.w = -info.w;
    uint8_t *copy = malloc(b.left ? b.left : 1);
    if (!copy)
        return 0;
    memcpy(copy, b.p, b.left);
    f.data = flags & 32 ? NULL : copy;
    unpack(&info, &f);
    free(copy);
    return 0;
}
