/* From libcamera 0.7.2 (CameraSensorProperties, CameraSensorHelper) and the Raspberry Pi helpers.
 * Where VBLANK acts later than exposure (IMX477, 519, 708: 3 frames), the first frame of an
 * exposure that needs longer frames comes one frame late; the labels of frames show that by pixels.
 * */
#include "drivers/device/v4l2_sensor.h"

#include <ctype.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>
#include <strings.h>

enum { MARGIN = 4 }; // where not known; exposures are read back anyway

#define INVERSE(n) 0, n, -1, n // n / (n - code)
#define LINEAR(n) 1, 0, 0, n   // code / n
#define NO_CODE 0, 0, 0, 0

static const struct v4l2_sensor sensors[] = {
    {"imx219", 2, 1, 4, INVERSE(256), 0.0, 4096},
    {"imx477", 2, 2, 22, INVERSE(1024), 0.0, 4096},
    {"imx708", 2, 2, 48, INVERSE(1024), 0.0, 4096},
    {"imx519", 2, 2, 32, INVERSE(1024), 0.0, 4096},
    {"imx296", 2, 2, 4, NO_CODE, 0.1, 3840},
    {"imx290", 2, 2, 2, NO_CODE, 0.3, 3840},
    {"imx327", -1, -1, 2, NO_CODE, 0.3, 3840},
    {"imx462", 2, 2, 2, NO_CODE, 0.3, 3840},
    {"imx283", 2, 1, MARGIN, INVERSE(2048), 0.0, 3200},
    {"imx335", -1, -1, MARGIN, NO_CODE, 0.3, 3200},
    {"imx415", 2, 2, MARGIN, NO_CODE, 0.3, -1},
    {"imx678", 2, 2, MARGIN, NO_CODE, 0.3, 3200},
    {"imx214", -1, -1, MARGIN, INVERSE(512), 0.0, 4096},
    {"imx258", -1, -1, MARGIN, INVERSE(512), 0.0, 4096},
    {"ov5647", 2, 2, 4, LINEAR(16), 0.0, 1024},
    {"ov5640", -1, -1, MARGIN, LINEAR(16), 0.0, 1024},
    {"ov5693", -1, -1, MARGIN, LINEAR(16), 0.0, 1024},
    {"ov7251", 2, 2, MARGIN, LINEAR(16), 0.0, -1},
    {"ov9281", 2, 2, 25, LINEAR(16), 0.0, -1},
    {"ov2740", -1, -1, MARGIN, LINEAR(128), 0.0, 4096},
    {"ov4689", -1, -1, MARGIN, LINEAR(128), 0.0, 1024},
    {"ov5675", -1, -1, MARGIN, LINEAR(128), 0.0, 4096},
    {"ov64a40", 2, 2, MARGIN, LINEAR(128), 0.0, -1},
    {"ov01a10", -1, -1, MARGIN, LINEAR(256), 0.0, -1},
    {"vd55g1", 2, 2, MARGIN, INVERSE(32), 0.0, -1},
    {"vd56g3", -1, -1, MARGIN, INVERSE(32), 0.0, -1},
    {"ar0144", 2, 2, MARGIN, NO_CODE, 0.0, 2688},
    {"gc05a2", 2, 2, MARGIN, NO_CODE, 0.0, -1},
};
static const struct v4l2_sensor unknown = {"", -1, -1, MARGIN, NO_CODE, 0.0, -1};

const struct v4l2_sensor *v4l2_sensor_find(const char *name)
{
    for (size_t i = 0; i < sizeof sensors / sizeof sensors[0]; i++) {
        size_t n = strlen(sensors[i].name);
        for (const char *p = name; *p; p++) {
            bool begins = p == name || !isalnum((unsigned char)p[-1]);
            if (begins && strncasecmp(p, sensors[i].name, n) == 0 && !isalnum((unsigned char)p[n]))
                return &sensors[i];
        }
    }
    return &unknown;
}

double v4l2_sensor_gain(const struct v4l2_sensor *s, int64_t code)
{
    double c = (double)code;
    if (s->db > 0.0)
        return pow(10.0, s->db * c / 20.0);
    double g = (s->m0 * c + s->c0) / (s->m1 * c + s->c1);
    return isfinite(g) && g > 0.0 ? g : 0.0;
}

int64_t v4l2_sensor_code(const struct v4l2_sensor *s, double gain, int64_t lo, int64_t hi)
{
    double limit = gain * (1.0 + 1e-9);
    while (lo < hi) { // factors rise with codes
        int64_t mid = lo + (hi - lo + 1) / 2;
        double g = v4l2_sensor_gain(s, mid);
        if (g > 0.0 && g <= limit)
            lo = mid;
        else
            hi = mid - 1;
    }
    return lo;
}
