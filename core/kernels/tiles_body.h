/* tiles_body.h - a product as tiles of ROWS = 6 rows and one panel; the last tile has fewer rows,
 * each number compiled on its own so that sums stay in registers.
 * The including file defines PRODUCT (gemm_s8 or gemm_f32), ELEM and SUM (the element types), ROWS
 * and multiply_tile(g, a, w, c, rows). */

static void gemm_by_tiles(const struct PRODUCT *g)
{
    for (int p = 0; p < g->panels; p++)
        for (int i = 0; i < g->m; i += ROWS) {
            const ELEM *a = g->a + (size_t)i * g->lda, *w = g->w + (size_t)p * g->ldw;
            SUM *c = g->c + (size_t)i * g->ldc + PANEL * p;
            switch (g->m - i) {
            case 1:
                multiply_tile(g, a, w, c, 1);
                break;
            case 2:
                multiply_tile(g, a, w, c, 2);
                break;
            case 3:
                multiply_tile(g, a, w, c, 3);
                break;
            case 4:
                multiply_tile(g, a, w, c, 4);
                break;
            case 5:
                multiply_tile(g, a, w, c, 5);
                break;
            default:
                multiply_tile(g, a, w, c, ROWS);
            }
        }
}
