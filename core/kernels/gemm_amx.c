/* Products of int8 by tiles (Intel AMX). A tile of sums has up to 16 rows and one panel. A step
 * takes 64 inputs: 16 rows of activations as they lie, and 64 inputs of a panel, which are a tile
 * of weights as they are packed. Two by two tiles of sums share what is loaded and hide the latency
 * of a product. The remainder of a run passes through tiles of its own width, so that one
 * configuration serves a call. Without a remainder, as in most layers, those tiles have full width,
 * too, and a step loads nothing twice. Where rows or panels do not fill the last tiles, these
 * overlap or repeat others and store the same sums again. */
#if !defined(__AMX_INT8__) && !defined(__AMXINT8__) // gcc; clang 14
#error "compile this file with -mamx-tile -mamx-int8"
#endif
#include "core/kernels/kernels.h"

#include <immintrin.h>

enum { ROWS = 16, STEP = 64 }; // rows of a tile; inputs of a step

/* Numbers of tiles; gcc pastes them into the instruction. */
#define SUM00 0
#define SUM01 1
#define SUM10 2
#define SUM11 3
#define FULL_A 4
#define FULL_W 5
#define REST_A 6
#define REST_W 7

struct tile_config { // Intel SDM vol. 1, 18.2
    uint8_t palette, start_row, reserved[14];
    uint16_t bytes[16]; // bytes per row
    uint8_t rows[16];
};

static void configure_tiles(const struct gemm_s8 *g)
{
    struct tile_config t = {.palette = 1};
    int rows = g->m < ROWS ? g->m : ROWS, rest = g->seg % STEP ? g->seg % STEP : STEP;
    for (int i = SUM00; i <= REST_W; i++) {
        t.rows[i] = (uint8_t)(i == FULL_W ? STEP / 4 : i == REST_W ? rest / 4 : rows);
        t.bytes[i] = (uint16_t)(i == REST_A ? rest : 4 * PANEL);
    }
    __asm__ volatile("" ::"r"(&t) : "memory"); // gcc 12 assumes that 8 bytes are read
    _tile_loadconfig(&t);
}

/* One step of two by two tiles of sums, with two tiles for operands. */
#define TILE_STEP(a_tile, w_tile, a0, a1, w0, w1)                                                  \
    _tile_loadd(a_tile, a0, g->lda);                                                               \
    _tile_loadd(w_tile, w0, 4 * PANEL);                                                            \
    _tile_dpbssd(SUM00, a_tile, w_tile);                                                           \
    _tile_loadd(a_tile, a1, g->lda);                                                               \
    _tile_dpbssd(SUM10, a_tile, w_tile);                                                           \
    _tile_loadd(w_tile, w1, 4 * PANEL);                                                            \
    _tile_dpbssd(SUM11, a_tile, w_tile);                                                           \
    _tile_loadd(a_tile, a0, g->lda);                                                               \
    _tile_dpbssd(SUM01, a_tile, w_tile)

/* The same with four tiles for operands. */
#define TILE_STEP_OF_FOUR(a0, a1, w0, w1)                                                          \
    _tile_loadd(FULL_A, a0, g->lda);                                                               \
    _tile_loadd(FULL_W, w0, 4 * PANEL);                                                            \
    _tile_dpbssd(SUM00, FULL_A, FULL_W);                                                           \
    _tile_loadd(REST_W, w1, 4 * PANEL);                                                            \
    _tile_dpbssd(SUM01, FULL_A, REST_W);                                                           \
    _tile_loadd(REST_A, a1, g->lda);                                                               \
    _tile_dpbssd(SUM10, REST_A, FULL_W);                                                           \
    _tile_dpbssd(SUM11, REST_A, REST_W)

/* Rows from i0 and from i1 of panels p0 and p1. */
static void multiply_tiles(const struct gemm_s8 *g, int i0, int i1, int p0, int p1)
{
    const int8_t *w0 = g->w + (size_t)p0 * g->ldw, *w1 = g->w + (size_t)p1 * g->ldw;
    int32_t *c0 = g->c + (size_t)i0 * g->ldc, *c1 = g->c + (size_t)i1 * g->ldc;
    size_t ldc_bytes = g->ldc * sizeof *g->c;
    int rest = g->seg % STEP;
    _tile_zero(SUM00);
    _tile_zero(SUM01);
    _tile_zero(SUM10);
    _tile_zero(SUM11);
    for (int s = 0; s < g->segs; s++) {
        const int8_t *a0 = g->a + (size_t)i0 * g->lda + (size_t)s * g->seg_stride;
        const int8_t *a1 = g->a + (size_t)i1 * g->lda + (size_t)s * g->seg_stride;
        int l = 0;
        for (; l <= g->seg - STEP; l += STEP, w0 += STEP * PANEL, w1 += STEP * PANEL) {
            if (rest) {
                TILE_STEP(FULL_A, FULL_W, a0 + l, a1 + l, w0, w1);
            } else {
                TILE_STEP_OF_FOUR(a0 + l, a1 + l, w0, w1);
            }
        }
        if (rest) {
            TILE_STEP(REST_A, REST_W, a0 + l, a1 + l, w0, w1);
        }
        w0 += rest * PANEL;
        w1 += rest * PANEL;
    }
    _tile_stored(SUM00, c0 + PANEL * p0, ldc_bytes);
    _tile_stored(SUM01, c0 + PANEL * p1, ldc_bytes);
    _tile_stored(SUM10, c1 + PANEL * p0, ldc_bytes);
    _tile_stored(SUM11, c1 + PANEL * p1, ldc_bytes);
}

static void gemm_s8(const struct gemm_s8 *g)
{
    int last = g->m > ROWS ? g->m - ROWS : 0; // where the last tile starts
    if (g->m == 0)
        return;
    configure_tiles(g);
    for (int p = 0; p < g->panels; p += 2)
        for (int i = 0; i < g->m; i += 2 * ROWS)
            multiply_tiles(g, i < last ? i : last, i + ROWS < last ? i + ROWS : last, p,
                           p + 1 < g->panels ? p + 1 : p);
    _tile_release();
}

void gemm_amx(struct gemm_kernels *k)
{
    k->s8_name = "amx";
    k->s8 = gemm_s8;
}
