#include "core/base/rotation.h"

#include <math.h>

void rotation_from_quat(const float q[4], float r[9])
{
    float w = q[0], x = q[1], y = q[2], z = q[3];
    r[0] = 1 - 2 * (y * y + z * z);
    r[1] = 2 * (x * y - w * z);
    r[2] = 2 * (x * z + w * y);
    r[3] = 2 * (x * y + w * z);
    r[4] = 1 - 2 * (x * x + z * z);
    r[5] = 2 * (y * z - w * x);
    r[6] = 2 * (x * z - w * y);
    r[7] = 2 * (y * z + w * x);
    r[8] = 1 - 2 * (x * x + y * y);
}

void rotation_to_xyzw(const float r[9], float q[4])
{
    float t[4] = {1 + r[0] - r[4] - r[8], 1 - r[0] + r[4] - r[8], 1 - r[0] - r[4] + r[8],
                  1 + r[0] + r[4] + r[8]};
    int k = 0;
    for (int i = 1; i < 4; i++)
        k = t[i] > t[k] ? i : k;
    const float v[4][4] = {
        {t[0], r[1] + r[3], r[2] + r[6], r[7] - r[5]},
        {r[1] + r[3], t[1], r[5] + r[7], r[2] - r[6]},
        {r[2] + r[6], r[5] + r[7], t[2], r[3] - r[1]},
        {r[7] - r[5], r[2] - r[6], r[3] - r[1], t[3]},
    };
    float len =
        sqrtf(v[k][0] * v[k][0] + v[k][1] * v[k][1] + v[k][2] * v[k][2] + v[k][3] * v[k][3]);
    for (int i = 0; i < 4; i++)
        q[i] = v[k][i] / len;
}
