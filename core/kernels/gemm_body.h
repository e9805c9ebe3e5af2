/* gemm_body.h - products of floats and unpacking of weights, compiled once per instruction set.
 * Included by gemm_<isa>.c after one SIMD_ macro.
 * A tile keeps the sums of F32_ROWS rows and two vectors of columns in registers, enough to hide
 * the latency of an FMA; each step loads two vectors of weights and one value of each row, and
 * prefetches a share of the weights that the next tiles of columns will read. */
#include "core/kernels/kernels.h"
#include "core/kernels/simd.h"

/* Two vectors are a panel or, where a vector is one already, two panels. */
enum { F32_ROWS = LANES == PANEL ? 8 : 6, F32_COLS = 2 * LANES };

/* The weights to prefetch, `step` floats further each step. */
struct prefetch {
    const float *at;
    size_t step;
};

/* One input of each row times those of one or two vectors of columns. */
static inline __attribute__((always_inline)) void f32_add(vf sum[][2], const float *a, size_t lda,
                                                          vf w0, vf w1, const int shape[2])
{
    for (int r = 0; r < shape[0]; r++) {
        vf x = v_set(a[(size_t)r * lda]);
        sum[r][0] = v_fma(w0, x, sum[r][0]);
        if (shape[1] == 2)
            sum[r][1] = v_fma(w1, x, sum[r][1]);
    }
}

static inline __attribute__((always_inline)) void
f32_tile(const struct gemm_f32 *g, int i, int col, struct prefetch *prefetch, const int shape[2])
{
    const int rows = shape[0], vecs = shape[1];
    const size_t next = LANES == PANEL ? g->ldw : LANES;
    vf sum[F32_ROWS][2];
    const float *w = g->w + (size_t)(col / PANEL) * g->ldw + col % PANEL;
    float *c = g->c + (size_t)i * g->ldc + col;
    for (int r = 0; r < rows; r++)
        for (int v = 0; v < vecs; v++)
            sum[r][v] = g->add ? v_load(c + (size_t)r * g->ldc + LANES * v) : v_set(0);
    for (int s = 0; s < g->segs; s++) {
        const float *a = g->a + (size_t)i * g->lda + (size_t)s * g->seg_stride;
        for (int l = 0; l < g->seg; l++, w += PANEL) {
            __builtin_prefetch(prefetch->at, 0, 2);
            prefetch->at += prefetch->step;
            f32_add(sum, a + l, g->lda, v_load(w), v_load(vecs == 2 ? w + next : w), shape);
        }
    }
    for (int r = 0; r < rows; r++)
        for (int v = 0; v < vecs; v++)
            v_store(c + (size_t)r * g->ldc + LANES * v, sum[r][v]);
}

/* All rows of one or two vectors of columns. */
static inline __attribute__((always_inline)) void f32_columns(const struct gemm_f32 *g, int col,
                                                              int vecs)
{
    const int tiles = (g->m + F32_ROWS - 1) / F32_ROWS, after = col + LANES * vecs;
    struct prefetch prefetch = {g->w + (size_t)(after / PANEL) * g->ldw + after % PANEL,
                                (size_t)(PANEL * (LANES == PANEL ? vecs : 1) + tiles - 1) /
                                    (size_t)(tiles > 0 ? tiles : 1)};
    for (int i = 0; i < g->m; i += F32_ROWS)
        switch (g->m - i) {
        case 1:
            f32_tile(g, i, col, &prefetch, (const int[]){1, vecs});
            break;
        case 2:
            f32_tile(g, i, col, &prefetch, (const int[]){2, vecs});
            break;
        case 3:
            f32_tile(g, i, col, &prefetch, (const int[]){3, vecs});
            break;
        case 4:
            f32_tile(g, i, col, &prefetch, (const int[]){4, vecs});
            break;
        case 5:
            f32_tile(g, i, col, &prefetch, (const int[]){5, vecs});
            break;
        case 6:
            f32_tile(g, i, col, &prefetch, (const int[]){6, vecs});
            break;
        case 7:
            f32_tile(g, i, col, &prefetch, (const int[]){F32_ROWS < 7 ? F32_ROWS : 7, vecs});
            break;
        default:
            f32_tile(g, i, col, &prefetch, (const int[]){F32_ROWS, vecs});
        }
}

static void gemm_f32(const struct gemm_f32 *g)
{
    int col = 0;
    for (; col + F32_COLS <= PANEL * g->panels; col += F32_COLS)
        f32_columns(g, col, 2);
    if (col < PANEL * g->panels)
        f32_columns(g, col, 1);
}

typedef int32_t vi __attribute__((vector_size(4 * LANES)));
typedef uint16_t vh __attribute__((vector_size(2 * LANES)));

static void unpack_s8(const int8_t *w, int k, float *out)
{
    for (int i = 0; i < k; i += 4, w += 4 * PANEL, out += 4 * PANEL)
        for (int j = 0; j < PANEL; j += LANES) {
            vi x; // four inputs of LANES outputs
            memcpy(&x, w + 4 * j, sizeof x);
            v_store(out + j, __builtin_convertvector(x << 24 >> 24, vf));
            v_store(out + j + PANEL, __builtin_convertvector(x << 16 >> 24, vf));
            v_store(out + j + 2 * PANEL, __builtin_convertvector(x << 8 >> 24, vf));
            v_store(out + j + 3 * PANEL, __builtin_convertvector(x >> 24, vf));
        }
}

static void unpack_bf16(const uint16_t *w, int k, float *out)
{
    for (int i = 0; i < k * PANEL; i += LANES) {
        vh x;
        memcpy(&x, w + i, sizeof x);
        vi bits = __builtin_convertvector(x, vi) << 16;
        memcpy(out + i, &bits, sizeof bits);
    }
}

static void gemm_fill(struct gemm_kernels *k, const char *name)
{
    k->f32_name = name;
    k->f32 = gemm_f32;
    k->unpack_s8 = unpack_s8;
    k->unpack_bf16 = unpack_bf16;
}
