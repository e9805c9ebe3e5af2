/* The curve of IEC 61966-2-1: half of the first code step stands for the code 0. */
#include "core/expo/crf.h"

#include <math.h>
#include <string.h>

void crf_srgb(struct crf *out)
{
    memset(out, 0, sizeof *out);
    for (int z = 0; z < 256; z++) {
        double d = z > 0 ? z / 255.0 : 0.25 / 255.0;
        double x = d <= 0.04045 ? d / 12.92 : pow((d + 0.055) / 1.055, 2.4);
        out->log2x[0][z] = out->log2x[1][z] = out->log2x[2][z] = z < 255 ? (float)log2(x) : 0.0f;
    }
}
