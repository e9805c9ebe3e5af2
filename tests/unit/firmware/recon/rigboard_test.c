/* Tags in takes: corners of the board, several exposures, two boards in view, tags of none. */
#include "firmware/recon/rigboard.h"

#include "core/sfm/board.h"
#include "drivers/format/apriltags.h"
#include "tests/unit/expect.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { W = 320, H = 240, CELL = 4, SHOTS = 4, TAKES = 2 };

static struct shot shots[TAKES][SHOTS];
static struct capture captures[TAKES];
static struct rigcal_take takes[TAKES];
static struct job_config cfg;
static struct job_result *notes;

/* Two cameras, two exposures each, white. */
static struct rigcal_job make_takes(int n)
{
    static const char *const names[TAKES] = {"first", "second"};
    for (int t = 0; t < n; t++) {
        captures[t] = (struct capture){SHOTS, shots[t]};
        takes[t] = (struct rigcal_take){names[t], &captures[t], NULL};
        for (int i = 0; i < SHOTS; i++) {
            shots[t][i] = (struct shot){.image = {W, H, 3, malloc(3 * W * H)},
                                        .again = i % 2 == 1,
                                        .taken_w = W,
                                        .taken_h = H};
            snprintf(shots[t][i].name, NAME_CAP, "cam%d_%d.png", i / 2, i % 2);
            assert_non_null(shots[t][i].image.px);
            memset(shots[t][i].image.px, 200, 3 * W * H);
        }
    }
    notes = calloc(1, sizeof *notes);
    assert_non_null(notes);
    return (struct rigcal_job){.n = n, .take = takes, .cfg = &cfg, .tag_mm = 30};
}

static void free_takes(int n)
{
    for (int i = 0; i < n * SHOTS; i++)
        free(shots[i / SHOTS][i % SHOTS].image.px);
    free(notes);
}

static void put_tag(struct image8 *im, int id, int x0, int y0, int black)
{
    uint8_t cells[APRILTAGS_EDGE][APRILTAGS_EDGE];
    assert_int_equal(apriltags_cells(id, cells), OK);
    for (int y = 0; y < CELL * APRILTAGS_EDGE; y++)
        for (int x = 0; x < CELL * APRILTAGS_EDGE; x++)
            memset(im->px + 3 * ((y0 + y) * W + x0 + x), cells[y / CELL][x / CELL] ? 200 : black,
                   3);
}

/* Three by two tags from id 0. */
static void put_board(struct image8 *im, int x0, int y0, int black)
{
    for (int i = 0; i < 6; i++)
        put_tag(im, board_id(i % 3, i / 3), x0 + 10 * CELL * (i % 3), y0 + 10 * CELL * (i / 3),
                black);
}

static err_t find(const struct rigcal_job *job, struct rigboard *b)
{
    const struct run r = {0};
    return rigboard_find(&r, job, notes, b);
}

static void corners(void **state)
{
    static struct rigboard b;
    (void)state;
    const struct rigcal_job job = make_takes(2);
    put_board(&shots[0][0].image, 30, 40, 20);
    put_board(&shots[0][1].image, 30, 40, 100); // less contrast counts, too
    put_board(&shots[0][2].image, 60, 50, 196); // too little
    put_board(&shots[0][3].image, 60, 50, 60);
    assert_int_equal(find(&job, &b), OK);
    assert_true(rigboard_seen(&b));
    assert_int_equal(b.n, 2 * 6 * 4);
    assert_int_equal(b.tags[0], 12);
    assert_int_equal(b.n_lenses, 1);
    for (int i = 0; i < b.n; i++) {
        const struct boardfit_corner *c = &b.corner[i];
        const double x0 = c->camera ? 60 : 30, y0 = c->camera ? 50 : 40;
        assert_true(
            hypot(c->px[0] - x0 - 8 * CELL * c->at[0], c->px[1] - y0 - 8 * CELL * c->at[1]) < 0.35);
        assert_true(fabs(hypot(c->inward[0], c->inward[1]) - sqrt(2)) < 0.05);
        assert_int_equal(c->take, 0);
    }
    assert_int_equal(notes->n_warnings, 1);
    assert_non_null(strstr(notes->warnings[0], "second: no camera sees the board in this take"));
    rigboard_free(&b);
    free_takes(2);
}

static void odd_tags(void **state)
{
    static struct rigboard b;
    (void)state;
    const struct rigcal_job job = make_takes(1);
    put_board(&shots[0][0].image, 30, 40, 20);
    put_tag(&shots[0][0].image, 1, 200, 150, 20); // of a second board
    put_board(&shots[0][2].image, 60, 50, 60);
    put_tag(&shots[0][2].image, 580, 200, 150, 20); // of another print
    assert_int_equal(find(&job, &b), OK);
    assert_int_equal(b.n, 6 * 4);
    assert_int_equal(b.corner[0].camera, 1);
    assert_int_equal(notes->n_warnings, 2);
    assert_non_null(strstr(notes->warnings[0], "first: tag 1 is in cam0_0.png twice"));
    assert_non_null(strstr(notes->warnings[1], "tag 580 in cam1_0.png is not of a board"));
    rigboard_free(&b);
    free_takes(1);
}

static void nothing(void **state)
{
    static struct rigboard b;
    (void)state;
    const struct rigcal_job job = make_takes(1);
    put_tag(&shots[0][0].image, 1, 100, 100, 20); // one tag is no board
    assert_int_equal(find(&job, &b), OK);
    assert_false(rigboard_seen(&b));
    assert_int_equal(notes->n_warnings, 0);
    rigboard_free(&b);
    free_takes(1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(corners), cmocka_unit_test(odd_tags),
                                       cmocka_unit_test(nothing)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
