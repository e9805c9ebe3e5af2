/* Any bytes as a calibration file: what was read is within its bounds, and the bracket machine can
 * be told so. */
#include "firmware/capture/calib.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const struct camera_info camera = {.unit = "u",
                                          .w = 2,
                                          .h = 2,
                                          .format = CAMERA_YUYV,
                                          .period_s = 0.03,
                                          .time_min_s = 1e-4,
                                          .time_max_s = 1,
                                          .exposure_delay = -1};

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct calib c;
    struct bracket_camera b;
    struct bracket *machine;
    err_t e = calib_parse("input", (const char *)data, size, &camera, &c);
    if (e && !*err_text())
        abort();
    calib_camera(&camera, &c, &b);
    if (!(b.time_min_s <= b.time_max_s && b.time_min_s >= 1e-4 && b.time_max_s <= 1) ||
        b.delay_lo < 0 || b.delay_lo > b.delay_hi || b.delay_hi > 32 || !(b.tolerance > 0))
        abort();
    if (bracket_new(&b, 1, &machine) != OK)
        abort();
    bracket_free(machine);
    for (int i = 0; !e && c.has_crf && i < 3; i++)
        for (int k = 1; k < 256; k++)
            if (!(c.crf.log2x[i][k] > c.crf.log2x[i][k - 1]))
                abort();
    return 0;
}
