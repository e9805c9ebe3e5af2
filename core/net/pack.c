#include "core/net/pack.h"

#include "core/kernels/kernels.h"

#include <float.h>
#include <math.h>
#include <string.h>

int pack_panels(const struct tensor_spec *t)
{
    return (table_product(t).n + PANEL - 1) / PANEL;
}

static size_t count_inputs(const struct tensor_spec *t)
{
    struct product_shape p = table_product(t);
    return (size_t)p.segs * (size_t)p.seg;
}

size_t pack_panel_bytes(const struct tensor_spec *t, enum precision type)
{
    size_t each = type == PRECISION_F32 ? 4 : type == PRECISION_BF16 ? 2 : 1;
    return count_inputs(t) * PANEL * each;
}

/* The weights of output o in the order of the product's inputs: table_source without its
 * divisions. */
static void gather_row(const struct tensor_spec *t, int o, const float *in, float *row)
{
    size_t c = (size_t)t->shape[1], cell = (size_t)t->shape[2] * (size_t)t->shape[3];
    in += table_source(t, o, 0);
    if (t->role == ROLE_LINEAR) {
        memcpy(row, in, c * sizeof *row);
    } else if (t->role == ROLE_CONV) {
        for (size_t at = 0; at < cell; at++)
            for (size_t i = 0; i < c; i++)
                row[at * c + i] = in[i * cell + at];
    } else {
        for (size_t i = 0; i < (size_t)t->shape[0]; i++)
            row[i] = in[i * c * cell];
    }
}

static uint16_t to_bf16(float v)
{
    uint32_t u;
    memcpy(&u, &v, sizeof u);
    u += 0x7FFF + (u >> 16 & 1);
    if ((u & 0x7F800000) == 0x7F800000)
        u -= 0x10000; // rounded to infinity: the largest finite value instead
    return (uint16_t)(u >> 16);
}

/* Round half to even without a library call. Values exceed 127 where the inverse of the largest is
 * infinite, or where rotation made them infinite. */
static int8_t to_s8(float v)
{
    const float big = 12582912.0f; // 1.5 * 2^23
    v = v < 127 ? v : 127;
    v = v > -127 ? v : -127;
    return (int8_t)((v + big) - big);
}

/* With the reference kernel: a file's bytes do not depend on the machine. */
static void rotate_row(float *row, size_t k, int edge)
{
    struct gemm_kernels c;
    nn_c(&c);
    c.hadamard(row, (int)k, edge);
}

/* step: from a weight to the next one of the same input channel, k if there is none. The rounding
 * error of each weight is added to the next (error diffusion): neighbouring pixels are alike, and
 * where the weights of a kernel nearly cancel, independent errors would outweigh their sum. */
static float quantise_row(float *row, size_t k, size_t step, int8_t *out)
{
    float top = 0;
    for (size_t i = 0; i < k; i++)
        top = fmaxf(top, fminf(fabsf(row[i]), FLT_MAX));
    float inv = top < FLT_MIN ? 0 : 127.0f / top;
    for (size_t i = 0; i < k; i++)
        row[i] = isnan(row[i] * inv) ? 0 : row[i] * inv;
    for (size_t i = 0; i < k; i++) {
        int8_t q = to_s8(row[i]);
        if (i + step < k)
            row[i + step] += row[i] - (float)q;
        out[i / 4 * 4 * PANEL + i % 4] = q;
    }
    return top < FLT_MIN ? 0 : top / 127.0f;
}

void pack_panel(const struct tensor_spec *t, enum precision type, int p, const float *in,
                const struct pack *to)
{
    int n = table_product(t).n, edge = model_rotation(t, type);
    size_t k = count_inputs(t), step = t->role == ROLE_CONV ? (size_t)t->shape[1] : k;
    memset(to->out, 0, pack_panel_bytes(t, type));
    for (int j = 0; j < PANEL && p * PANEL + j < n; j++) {
        gather_row(t, p * PANEL + j, in, to->row);
        if (type == PRECISION_S8) {
            if (edge)
                rotate_row(to->row, k, edge);
            to->scale[j] = quantise_row(to->row, k, step, (int8_t *)to->out + 4 * j);
        } else if (type == PRECISION_BF16) {
            for (size_t i = 0; i < k; i++)
                ((uint16_t *)to->out)[i * PANEL + (size_t)j] = to_bf16(to->row[i]);
        } else {
            for (size_t i = 0; i < k; i++)
                ((float *)to->out)[i * PANEL + (size_t)j] = to->row[i];
        }
    }
}
