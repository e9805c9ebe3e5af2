/* vec.h - three floats as a vector, nine as a row-major matrix. Pure; any thread. */
#ifndef WORLD_VEC_H
#define WORLD_VEC_H

#include <math.h>

/* Unlike fminf and fmaxf one instruction; b if a or b is NaN. */
static inline float vec_min(float a, float b)
{
    return a < b ? a : b;
}

static inline float vec_max(float a, float b)
{
    return a > b ? a : b;
}

static inline float vec_dot(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* out = a + s b; out may be a or b. */
static inline void vec_along(const float a[3], float s, const float b[3], float out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = a[k] + s * b[k];
}

static inline void vec_sub(const float a[3], const float b[3], float out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = a[k] - b[k];
}

/* out = m v; out is not v. */
static inline void vec_turn(const float m[9], const float v[3], float out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = m[3 * k] * v[0] + m[3 * k + 1] * v[1] + m[3 * k + 2] * v[2];
}

/* out = transpose(m) v; out is not v. */
static inline void vec_turn_back(const float m[9], const float v[3], float out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = m[k] * v[0] + m[3 + k] * v[1] + m[6 + k] * v[2];
}

/* Make v a unit vector and return the length it had; one too short becomes z. */
static inline float vec_unit(float v[3])
{
    float length = sqrtf(vec_dot(v, v));
    if (!(length > 1e-20f)) {
        v[0] = v[1] = 0;
        v[2] = 1;
        return 0;
    }
    float inverse = 1 / length;
    for (int k = 0; k < 3; k++)
        v[k] *= inverse;
    return length;
}

/* Two unit vectors at right angles to the unit vector n and to each other (Duff et al., Building an
 * Orthonormal Basis, Revisited, JCGT 6(1), 2017). */
static inline void vec_basis(const float n[3], float a[3], float b[3])
{
    float sign = n[2] < 0 ? -1.0f : 1.0f;
    float p = -1 / (sign + n[2]), q = n[0] * n[1] * p;
    a[0] = 1 + sign * n[0] * n[0] * p;
    a[1] = sign * q;
    a[2] = -sign * n[0];
    b[0] = q;
    b[1] = sign + n[1] * n[1] * p;
    b[2] = -n[1];
}

/* The point of the unit circle after u turns, 0 <= u < 1, within 1e-6: Taylor's series in
 * eighths of the circle. */
static inline void vec_circle(float u, float *x, float *y)
{
    float t = 4 * u + 0.5f;
    int quarter = (int)t;
    float a = (t - (float)quarter - 0.5f) * 1.57079633f, a2 = a * a;
    float s = a * (1 - a2 / 6 * (1 - a2 / 20 * (1 - a2 / 42)));
    float c = 1 - a2 / 2 * (1 - a2 / 12 * (1 - a2 / 30 * (1 - a2 / 56)));
    *x = quarter & 1 ? -s : c;
    *y = quarter & 1 ? c : s;
    if (quarter & 2) {
        *x = -*x;
        *y = -*y;
    }
}

/* Luminance of linear Rec. 709 colours. */
static inline float vec_grey(const float c[3])
{
    return 0.2126f * c[0] + 0.7152f * c[1] + 0.0722f * c[2];
}

#endif
