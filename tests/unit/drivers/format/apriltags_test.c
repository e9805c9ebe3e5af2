/* Tags in drawn pictures: which, and their corners against where they were drawn, at several angles
 * and sizes; blurred, dark, saturated, cut off, twice; pictures without any. The PDF of the board:
 * its squares are those of the tags, and the same for every run. */
#include "drivers/format/apriltags.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/splitmix.h"
#include "core/sfm/board.h"
#include "drivers/format/boardpdf.h"
#include "drivers/format/file.h"
#include "drivers/format/origin.h"

#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { W = 480, H = 360, FINE = 5, COLS = 4, ROWS = 3 };

/* How a board of COLS x ROWS tags is drawn. */
struct drawing {
    double h[9];         // board, in tags, to px
    double black, white; // levels
    double blur, noise;  // px; levels
    int first;           // id of the upper left tag
};

static uint8_t picture[H * W];
static struct apriltags_tag found[APRILTAGS_MAX];

static void apply(const double h[9], const double at[2], double out[2])
{
    const double x[3] = {at[0], at[1], 1};
    double y[3];
    lin_apply(h, x, y);
    out[0] = y[0] / y[2];
    out[1] = y[1] / y[2];
}

static void invert(const double a[9], double out[9])
{
    for (int i = 0; i < 9; i++) {
        const int r = (i % 3 + 1) % 3, c = (i / 3 + 1) % 3, r2 = (r + 1) % 3, c2 = (c + 1) % 3;
        out[i] = a[3 * r + c] * a[3 * r2 + c2] - a[3 * r + c2] * a[3 * r2 + c];
    }
}

/* Whether the board is black at a point. */
static bool is_black(uint8_t cells[][8][8], const double at[2])
{
    const int col = (int)floor(at[0] / BOARD_PITCH), row = (int)floor(at[1] / BOARD_PITCH);
    const double x = 8 * (at[0] - BOARD_PITCH * col), y = 8 * (at[1] - BOARD_PITCH * row);
    if (col < 0 || row < 0 || col >= COLS || row >= ROWS || x >= 8 || y >= 8)
        return false;
    return !cells[row * COLS + col][(int)y][(int)x];
}

static void draw(const struct drawing *d)
{
    static uint8_t cells[COLS * ROWS][8][8];
    static float sharp[H * FINE][W * FINE];
    double back[9], level[2] = {d->white, d->black};
    uint64_t state = 5;
    invert(d->h, back);
    for (int i = 0; i < COLS * ROWS; i++)
        assert_int_equal(apriltags_cells(d->first + board_id(i % COLS, i / COLS), cells[i]), OK);
    for (int y = 0; y < H * FINE; y++)
        for (int x = 0; x < W * FINE; x++) {
            const double px[2] = {(x + 0.5) / FINE, (y + 0.5) / FINE};
            double at[2];
            apply(back, px, at);
            sharp[y][x] = (float)level[is_black(cells, at)];
        }
    const int reach = (int)ceil(FINE * (0.5 + 2.5 * d->blur));
    for (int i = 0; i < W * H; i++) {
        double sum = 0, weight = 0;
        for (int k = 0; k < (2 * reach + 1) * (2 * reach + 1); k++) {
            const int x = k % (2 * reach + 1) - reach, y = k / (2 * reach + 1) - reach;
            const int u = i % W * FINE + FINE / 2 + x, v = i / W * FINE + FINE / 2 + y;
            const double s = d->blur * d->blur + 1.0 / 12, r2 = (x * x + y * y) / 25.0,
                         w = exp(-r2 / (2 * s));
            if (u < 0 || v < 0 || u >= W * FINE || v >= H * FINE)
                continue;
            sum += w * (double)sharp[v][u];
            weight += w;
        }
        state += SPLITMIX_STEP;
        const double off = d->noise * 3.46 * ((double)(splitmix_mix(state) >> 11) * 0x1p-53 - 0.5);
        picture[i] = (uint8_t)fmin(fmax(sum / weight + off + 0.5, 0), 255);
    }
}

static int find(void)
{
    struct apriltags *a;
    int n = 0;
    assert_int_equal(apriltags_open(&a), OK);
    assert_int_equal(apriltags_find(a, picture, W, H, found, &n), OK);
    apriltags_close(a);
    return n;
}

/* Turned by `angle` degrees, `size` px a tag, tilted. */
static struct drawing posed(double angle, double size, double tilt)
{
    const double c = size * cos(angle * NUM_PI / 180), s = size * sin(angle * NUM_PI / 180);
    const double turn[9] = {c, -s, 240.3, s, c, 180.6, 0, 0, 1},
                 flat[9] = {1, 0, -2.4, 0, 1 - tilt, -1.75 * (1 - tilt), 0, 0.12 * tilt, 1};
    struct drawing d = {.black = 40, .white = 215, .blur = 0.4, .noise = 2};
    lin_product(turn, flat, d.h);
    return d;
}

/* Worst and root mean square distance of corners from where they were drawn. */
static void errors_of(const struct drawing *d, int n, double *worst, double *rms)
{
    double sum = 0;
    *worst = 0;
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 4; k++) {
            double at[2], px[2];
            board_corner(found[i].id - d->first, k, at);
            apply(d->h, at, px);
            const double off = hypot(px[0] - found[i].corner[k][0], px[1] - found[i].corner[k][1]);
            sum += off * off;
            *worst = fmax(*worst, off);
        }
    *rms = sqrt(sum / (4 * n));
}

static void corners(void **state)
{
    static const double sizes[] = {30, 45, 70};
    (void)state;
    for (int i = 0; i < 9; i++) {
        const struct drawing d = posed(i * 17 - 30, sizes[i % 3], 0.12 * (i / 3));
        double worst, rms;
        draw(&d);
        const int n = find();
        assert_true(n == COLS * ROWS || (sizes[i % 3] > 60 && n >= 6)); // some are beyond the edge
        errors_of(&d, n, &worst, &rms);
        print_message("%g px, %d degrees, tilt %d: rms %.3f, worst %.3f px\n", sizes[i % 3],
                      i * 17 - 30, i / 3, rms, worst);
        assert_true(rms < 0.1 && worst < 0.3);
    }
}

static void conditions(void **state)
{
    struct drawing d = posed(10, 40, 0.2);
    (void)state;
    d.first = 100;
    d.blur = 1.5; // blurred
    draw(&d);
    assert_int_equal(find(), COLS * ROWS);
    assert_int_equal(found[0].id, 100);
    assert_int_equal(found[11].id, 100 + 48 + 3);
    d.blur = 0.4; // dark
    d.black = 3;
    d.white = 22;
    d.noise = 1;
    draw(&d);
    assert_in_range(find(), 6, COLS * ROWS);
    d.black = 120; // white is clipped
    d.white = 400;
    draw(&d);
    assert_int_equal(find(), COLS * ROWS);
    d = posed(0, 150, 0); // partly outside
    draw(&d);
    assert_in_range(find(), 1, 6);
    memset(picture, 90, sizeof picture);
    assert_int_equal(find(), 0);
    for (int i = 0; i < W * H; i++)
        picture[i] = (uint8_t)(splitmix_mix((uint64_t)i) & 255);
    assert_int_equal(find(), 0);
    struct apriltags *a;
    int n;
    assert_int_equal(apriltags_open(&a), OK);
    assert_int_equal(apriltags_find(a, picture, 15, H, found, &n), ERR_ARG);
    apriltags_close(a);
    apriltags_close(NULL);
}

/* ---- the board on paper ---- */

static void sheet(void **state)
{
    static const struct {
        const char *paper;
        double tag;
        int cols, rows;
    } want[] = {{"a4", 37, 6, 4}, {"a3", 55, 6, 4}, {"letter", 35, 6, 4}};
    struct boardpdf b;
    (void)state;
    for (int i = 0; i < 3; i++) {
        assert_int_equal(boardpdf_choose(want[i].paper, 0, &b), OK);
        assert_true(b.tag == want[i].tag);
        assert_int_equal(b.board.cols, want[i].cols);
        assert_int_equal(b.board.rows, want[i].rows);
    }
    assert_int_equal(boardpdf_choose("a4", 10, &b), OK);
    assert_int_equal(b.board.cols, 22);
    assert_int_equal(boardpdf_choose("a3", 10, &b), OK);
    assert_int_equal(b.board.cols, BOARD_STRIDE);
    assert_int_equal(boardpdf_choose("a4", 9, &b), ERR_ARG);
    assert_int_equal(boardpdf_choose("a4", 80, &b), ERR_ARG);
    assert_non_null(strstr(err_text(), "10 to 79"));
    assert_int_equal(boardpdf_choose("a5", 0, &b), ERR_ARG);
}

/* Black area of the page's squares, mm^2, apart from the ruler; *boxes of them. */
static double read_boxes(const char *text, double tag, int *boxes)
{
    double area = 0;
    *boxes = 0;
    for (const char *at = strstr(text, "0 g\n") + 4; *at != 'f'; at = strchr(at, '\n') + 1) {
        double x, y, w, h;
        assert_int_equal(sscanf(at, "%lf %lf %lf %lf re", &x, &y, &w, &h), 4);
        assert_true(x > 9.9 && y > 9.9 && fabs(h - tag / 8) < 1e-3);
        area += w * h;
        ++*boxes;
    }
    return area;
}

static void pdf(void **state)
{
    char path[2][FILE_PATH_CAP];
    struct file_map m[2];
    struct boardpdf b;
    double black = 0;
    int boxes;
    (void)state;
    assert_int_equal(boardpdf_choose("a4", 0, &b), OK);
    for (int i = 0; i < 2; i++) {
        assert_int_equal(file_join(tmpdir_root, i ? "b.pdf" : "a.pdf", path[i]), OK);
        assert_int_equal(boardpdf_write(path[i], &b), OK);
        assert_int_equal(file_map(path[i], 1 << 20, &m[i]), OK);
    }
    assert_int_equal(m[0].n, m[1].n);
    assert_memory_equal(m[0].p, m[1].p, m[0].n);
    char *text = calloc(1, m[0].n + 1);
    assert_non_null(text);
    memcpy(text, m[0].p, m[0].n);
    for (int i = 0; i < 24; i++) {
        uint8_t cells[8][8];
        assert_int_equal(apriltags_cells(board_id(i % 6, i / 6), cells), OK);
        for (int k = 0; k < 64; k++)
            black += !cells[k / 8][k % 8];
    }
    const double area = read_boxes(text, b.tag, &boxes), cell = b.tag / 8;
    assert_true(fabs(area / (black * cell * cell) - 1) < 1e-3);
    assert_in_range(boxes, 24 * 8, 24 * 8 * 4);
    assert_non_null(strstr(text, "edge of a tag 37 mm; 6 x 4 tags, ids 0 to 77"));
    const long table = strtol(strstr(text, "startxref\n") + 10, NULL, 10);
    assert_int_equal(strncmp(text + table, "xref\n0 6\n", 9), 0);
    for (int i = 1; i <= 5; i++) {
        char head[16];
        const long at = strtol(text + table + 9 + 20 * i, NULL, 10);
        snprintf(head, sizeof head, "%d 0 obj\n", i);
        assert_int_equal(strncmp(text + at, head, strlen(head)), 0);
    }
    const char *stream = strstr(text, "stream\n") + 7;
    assert_int_equal(
        strncmp(stream + strtol(strstr(text, "/Length ") + 8, NULL, 10), "endstream", 9), 0);
    assert_int_equal(origin_check_place(path[0]), OK);
    assert_int_equal(boardpdf_write("/nowhere/a.pdf", &b), ERR_IO);
    free(text);
    file_unmap(&m[0]);
    file_unmap(&m[1]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(corners), cmocka_unit_test(conditions), cmocka_unit_test(sheet),
        cmocka_unit_test_setup_teardown(pdf, tmpdir_setup, tmpdir_teardown)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
