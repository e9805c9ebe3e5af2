/* First byte: manifest.json of a take, or a calibration file; the rest is its text. */
#include "firmware/calib.h"
#include "firmware/manifest.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const struct camera_info camera = {.unit = "u",
                                          .w = 2,
                                          .h = 2,
                                          .format = CAMERA_YUYV,
                                          .time_min_s = 1e-4,
                                          .time_max_s = 1,
                                          .exposure_delay = -1};

/* What was read is within its bounds, and the bracket machine can be told so. */
static void calibration(const char *text, size_t n)
{
    struct calib c;
    struct bracket_camera b;
    err_t e = calib_parse("input", text, n, &camera, &c);
    calib_camera(&camera, &c, &b);
    if (!(b.time_min_s <= b.time_max_s && b.time_min_s >= 1e-4 && b.time_max_s <= 1) ||
        b.delay_lo < 0 || b.delay_lo > b.delay_hi || b.delay_hi > 32 || !(b.tolerance > 0))
        abort();
    for (int i = 0; !e && c.has_crf && i < 3; i++)
        for (int k = 1; k < 256; k++)
            if (!(c.crf.log2x[i][k] > c.crf.log2x[i][k - 1]))
                abort();
}

static void manifest(const char *text, size_t n)
{
    static struct manifest m;
    err_t e = manifest_parse("input", text, n, &m);
    if (e && (m.n || m.id[0]))
        abort();
    for (int i = 0; i < m.n; i++)
        if (m.file[i].name[0] == '/' || strstr(m.file[i].name, "..") == m.file[i].name ||
            strstr(m.file[i].name, "/.") || strlen(m.file[i].sha256) != SHA256_HEX_CAP - 1)
            abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size < 1)
        return 0;
    if (data[0] & 1)
        calibration((const char *)data + 1, size - 1);
    else
        manifest((const char *)data + 1, size - 1);
    return 0;
}
