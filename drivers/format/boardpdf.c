/* The content is written to memory first, because its length stands before it. Lengths on the page
 * are mm: the first operator scales points, 72 to an inch, and turns y down. */
#include "drivers/format/boardpdf.h"

#include "drivers/format/apriltags.h"
#include "drivers/format/file.h"
#include "drivers/format/origin.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const struct {
    const char *name;
    double w, h; // mm
} papers[] = {{"a4", 297, 210}, {"a3", 420, 297}, {"letter", 279.4, 215.9}};

static const double MARGIN = 10; // mm on all sides: printers leave 5 white
static const double FOOT = 12;   // mm for text and ruler
static const double POINTS = 72 / 25.4;
enum { COLS_USUAL = 6, ROWS_USUAL = 4, RULER = 100, OBJECTS = 5 };

err_t boardpdf_choose(const char *paper, double tag, struct boardpdf *out)
{
    size_t i = 0;
    const size_t n = sizeof papers / sizeof papers[0];
    while (i < n && strcmp(papers[i].name, paper) != 0)
        i++;
    if (i == n)
        return err_fail(ERR_ARG, "no paper \"%.32s\": it is " BOARDPDF_PAPERS, paper);
    const double w = papers[i].w - 2 * MARGIN, h = papers[i].h - 2 * MARGIN - FOOT;
    const struct board usual = {COLS_USUAL, ROWS_USUAL};
    double size[2];
    board_size(&usual, size);
    const double most = floor(fmin(w, h) / (1 + BOARD_PITCH));
    *out = (struct boardpdf){.paper = papers[i].name, .w = papers[i].w, .h = papers[i].h};
    out->tag = tag > 0 ? tag : floor(fmin(w / size[0], h / size[1]));
    if (!(out->tag >= BOARDPDF_TAG_MIN) || !board_fit(w, h, out->tag, &out->board))
        return err_fail(ERR_ARG, "tags of %g mm on %s: allowed are %g to %g mm", out->tag, paper,
                        BOARDPDF_TAG_MIN, most);
    return OK;
}

/* ---- the page ---- */

static void put_box(FILE *f, double x, double y, double w, double h)
{
    fprintf(f, "%.4f %.4f %.4f %.4f re\n", x, y, w, h);
}

/* Black cells, those side by side as one box. */
static err_t put_tag(FILE *f, int id, double x, double y, double cell)
{
    uint8_t cells[APRILTAGS_EDGE][APRILTAGS_EDGE];
    err_t e = apriltags_cells(id, cells);
    for (int row = 0; row < APRILTAGS_EDGE && !e; row++)
        for (int from = 0, to; from < APRILTAGS_EDGE; from = to + 1) {
            for (to = from; to < APRILTAGS_EDGE && !cells[row][to]; to++)
                ;
            if (to > from)
                put_box(f, x + cell * from, y + cell * row, cell * (to - from), cell);
        }
    return e;
}

static err_t put_grid(FILE *f, const struct boardpdf *b)
{
    double size[2];
    err_t e = OK;
    board_size(&b->board, size);
    const double x0 = (b->w - size[0] * b->tag) / 2, y0 = (b->h - FOOT - size[1] * b->tag) / 2;
    for (int row = 0; row < b->board.rows; row++)
        for (int col = 0; col < b->board.cols && !e; col++) {
            double at[2];
            board_corner(board_id(col, row), 0, at);
            e = put_tag(f, board_id(col, row), x0 + b->tag * at[0], y0 + b->tag * at[1],
                        b->tag / APRILTAGS_EDGE);
        }
    fputs("f\n", f);
    return e;
}

/* 100 mm, a mark each 10. */
static void put_ruler(FILE *f, const struct boardpdf *b)
{
    const double x0 = b->w - MARGIN - RULER, y0 = b->h - MARGIN;
    put_box(f, x0, y0 - 0.2, RULER, 0.2);
    for (int i = 0; i <= RULER / 10; i++) {
        const double high = i % 5 == 0 ? 4 : 2;
        put_box(f, x0 + 10 * i - 0.1, y0 - high, 0.2, high);
    }
    fputs("f\n", f);
}

/* y is down on our page, so letters are turned back. */
static void put_text(FILE *f, const struct boardpdf *b)
{
    const struct board *g = &b->board;
    fprintf(f,
            "BT /F1 3 Tf 1 0 0 -1 %.4f %.4f Tm (hdrig rig calibrate --tag %g: tag36h11, edge of a "
            "tag %g mm; %d x %d tags, ids 0 to %d) Tj\n"
            "0 -4 Td (Print at 100 %%, fix it to something flat; the ruler must be 100 mm long) Tj "
            "ET\n",
            MARGIN, b->h - MARGIN - 4, b->tag, b->tag, g->cols, g->rows,
            board_id(g->cols - 1, g->rows - 1));
}

static err_t make_content(const struct boardpdf *b, char **text, size_t *n)
{
    FILE *f = open_memstream(text, n);
    if (!f)
        return err_fail(ERR_NOMEM, "no memory for a page");
    fprintf(f, "%.6f 0 0 %.6f 0 %.4f cm\n0 g\n", POINTS, -POINTS, b->h * POINTS);
    err_t e = put_grid(f, b);
    put_ruler(f, b);
    put_text(f, b);
    const bool bad = ferror(f) != 0;
    if (fclose(f) != 0 || bad)
        e = e ? e : err_fail(ERR_NOMEM, "no memory for a page");
    return e;
}

/* ---- the file ---- */

static void put_objects(FILE *f, const struct boardpdf *b, const char *content, size_t n)
{
    long at[OBJECTS + 1];
    fputs("%PDF-1.4\n% " ORIGIN_COMMENT "\n", f);
    at[1] = ftell(f);
    fputs("1 0 obj\n<< /Type /Catalog /Pages 2 0 R >>\nendobj\n", f);
    at[2] = ftell(f);
    fputs("2 0 obj\n<< /Type /Pages /Kids [3 0 R] /Count 1 >>\nendobj\n", f);
    at[3] = ftell(f);
    fprintf(f,
            "3 0 obj\n<< /Type /Page /Parent 2 0 R /MediaBox [0 0 %.4f %.4f] /Contents 4 0 R\n"
            "/Resources << /Font << /F1 5 0 R >> >> >>\nendobj\n",
            b->w * POINTS, b->h * POINTS);
    at[4] = ftell(f);
    fprintf(f, "4 0 obj\n<< /Length %zu >>\nstream\n", n);
    fwrite(content, 1, n, f);
    fputs("endstream\nendobj\n", f);
    at[5] = ftell(f);
    fputs("5 0 obj\n<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>\nendobj\n", f);
    const long table = ftell(f);
    fprintf(f, "xref\n0 %d\n0000000000 65535 f \n", OBJECTS + 1);
    for (int i = 1; i <= OBJECTS; i++)
        fprintf(f, "%010ld 00000 n \n", at[i]);
    fprintf(f, "trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%ld\n%%%%EOF\n", OBJECTS + 1,
            table);
}

err_t boardpdf_write(const char *path, const struct boardpdf *b)
{
    char *content = NULL;
    size_t n = 0;
    FILE *f;
    err_t e = make_content(b, &content, &n);
    if (!e)
        e = file_create(path, &f);
    if (!e) {
        put_objects(f, b, content, n);
        e = file_finish(f, path);
    }
    free(content);
    return e;
}
