#include "drivers/format/json.h"
#include "drivers/format/npy.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static struct npy_dir dir;

static int setup(void **state)
{
    (void)state;
    tmpdir_make();
    return npy_open(&dir, tmpdir_path(".")) == OK ? 0 : -1;
}

static int teardown(void **state)
{
    (void)state;
    if (dir.open && npy_close(&dir) != OK)
        return -1;
    tmpdir_remove();
    return 0;
}

static void put(const struct tap_tensor *t)
{
    dir.tap.put(dir.tap.ctx, t);
}

/* Words of a file behind its head. */
static void load(const char *name, size_t n, void *out)
{
    char head[NPY_HEAD];
    FILE *f = fopen(tmpdir_path(name), "rb");
    assert_non_null(f);
    assert_int_equal(fread(head, 1, sizeof head, f), sizeof head);
    assert_int_equal(fread(out, 4, n, f), n);
    assert_int_equal(fgetc(f), EOF);
    fclose(f);
}

static void head_is_numpy_1_0(void **state)
{
    (void)state;
    static const char want[] = "{'descr': '<i4', 'fortran_order': False, 'shape': (2, 3,), } ";
    const int32_t v[6] = {1, 2, 3, 4, 5, 6};
    char head[NPY_HEAD];
    put(&(struct tap_tensor){
        .name = "a.b", .rank = 2, .shape = {2, 3}, .parts = 1, .ints = v, .stride = {3, 1}});
    FILE *f = fopen(tmpdir_path("a.b.npy"), "rb");
    assert_non_null(f);
    assert_int_equal(fread(head, 1, sizeof head, f), sizeof head);
    fclose(f);
    assert_memory_equal(head, "\x93NUMPY\x01\x00\xb6\x00", 10);
    assert_memory_equal(head + 10, want, sizeof want - 1);
    assert_int_equal(head[NPY_HEAD - 1], '\n');
    assert_int_equal(NPY_HEAD % 64, 0);
    int32_t got[6];
    load("a.b.npy", 6, got);
    assert_memory_equal(got, v, sizeof v);
}

/* Maps with channels last become (views, channels, h, w), the later view first. */
static void pieces_in_any_order_through_strides(void **state)
{
    (void)state;
    float map[2][3 * 5 * 2], got[2][2][3][5];
    for (int v = 1; v >= 0; v--) {
        for (int i = 0; i < 15; i++)
            for (int c = 0; c < 2; c++)
                map[v][i * 2 + c] = (float)(1000 * v + 100 * c + 10 * (i / 5) + i % 5);
        put(&(struct tap_tensor){.name = "map",
                                 .rank = 4,
                                 .shape = {2, 2, 3, 5},
                                 .part = v,
                                 .parts = 2,
                                 .data = map[v],
                                 .stride = {30, 1, 10, 2}});
    }
    load("map.npy", 60, got);
    for (int v = 0; v < 4; v++)
        for (int y = 0; y < 3; y++)
            for (int x = 0; x < 5; x++)
                assert_float_equal(got[v / 2][v % 2][y][x],
                                   1000 * (v / 2) + 100 * (v % 2) + 10 * y + x, 0);
}

/* (1, 4 rows, 3) in pieces of two rows, larger than one block of the writer when widened. */
static void pieces_of_an_inner_axis(void **state)
{
    (void)state;
    enum { ROWS = 6, W = 3001 };
    static float in[ROWS][W], got[ROWS][W];
    for (int i = 0; i < ROWS * W; i++)
        in[i / W][i % W] = (float)i;
    for (int p = 0; p < 3; p++)
        put(&(struct tap_tensor){.name = "rows",
                                 .rank = 3,
                                 .shape = {1, ROWS, W},
                                 .part = p,
                                 .parts = 3,
                                 .data = in[2 * p],
                                 .stride = {ROWS * W, W, 1}});
    load("rows.npy", ROWS * W, got);
    assert_memory_equal(got, in, sizeof in);
}

static err_t row_chunk(void *ctx, int chunk, int worker)
{
    const float(*in)[64] = ctx;
    (void)worker;
    put(&(struct tap_tensor){.name = chunk % 2 ? "odd" : "even",
                             .rank = 2,
                             .shape = {100, 64},
                             .part = chunk / 2,
                             .parts = 100,
                             .data = in[chunk],
                             .stride = {64, 1}});
    return OK;
}

static void pieces_from_many_threads(void **state)
{
    (void)state;
    static float in[200][64], got[100][64];
    struct pool *pool;
    for (int i = 0; i < 200 * 64; i++)
        in[i / 64][i % 64] = (float)i;
    assert_int_equal(pool_open(&pool, 8), OK);
    assert_int_equal(pool_for(pool, 200, row_chunk, in), OK);
    pool_close(pool);
    load("odd.npy", 100 * 64, got);
    for (int i = 0; i < 100; i++)
        assert_memory_equal(got[i], in[2 * i + 1], sizeof got[i]);
}

static void index_lists_what_is_there(void **state)
{
    (void)state;
    const float v[4] = {0};
    struct cJSON *doc;
    double side;
    put(&(struct tap_tensor){
        .name = "x", .rank = 3, .shape = {1, 2, 2}, .parts = 1, .data = v, .stride = {4, 2, 1}});
    assert_int_equal(npy_close(&dir), OK);
    assert_int_equal(json_read(tmpdir_path("index.json"), &doc), OK);
    const struct cJSON *t = json_first(json_member(doc, "tensors"));
    assert_string_equal(json_string(json_member(t, "name")), "x");
    assert_string_equal(json_string(json_member(t, "file")), "x.npy");
    assert_string_equal(json_string(json_member(t, "dtype")), "float32");
    assert_int_equal(json_count(json_member(t, "shape")), 3);
    assert_true(json_number(json_next(json_first(json_member(t, "shape"))), &side) && side == 2);
    assert_null(json_next(t));
    json_free(doc);
}

static void refused(const struct tap_tensor *t, const char *words)
{
    put(t);
    assert_int_equal(npy_close(&dir), ERR_FORMAT);
    if (!strstr(err_text(), words))
        fail_msg("\"%s\" lacks \"%s\"", err_text(), words);
    assert_int_equal(npy_open(&dir, tmpdir_path(".")), OK);
}

static void contradictions_are_remembered(void **state)
{
    (void)state;
    const float v[4] = {0};
    const struct tap_tensor half = {
        .name = "x", .rank = 1, .shape = {8}, .parts = 2, .data = v, .stride = {1}};
    struct tap_tensor t = half;
    t.name = "../x";
    refused(&t, "slashes");
    t.name = "..";
    refused(&t, "folder");
    refused(&half, "1 of 2 pieces");
    t = half;
    t.part = 2;
    refused(&t, "piece 2 of 2");
    t.part = 0, t.parts = 3;
    refused(&t, "piece 0 of 3");
    t = half;
    t.shape[0] = 0;
    refused(&t, "axis 0 of 0");
    t = half;
    put(&t);
    t.shape[0] = 4;
    refused(&t, "contradicts");
    put(&half);
    put(&half);
    refused(&half, "contradicts");
    FILE *f = fopen(tmpdir_path("index.json"), "rb");
    assert_null(f);
}

static void a_folder_that_is_gone(void **state)
{
    (void)state;
    const float v = 0;
    struct npy_dir d;
    assert_int_equal(npy_open(&d, tmpdir_path("nowhere")), OK);
    npy_put(&d, &(struct tap_tensor){
                    .name = "x", .rank = 1, .shape = {1}, .parts = 1, .data = &v, .stride = {1}});
    assert_int_equal(npy_close(&d), ERR_IO);
    assert_non_null(strstr(err_text(), "nowhere/x.npy"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(head_is_numpy_1_0, setup, teardown),
        cmocka_unit_test_setup_teardown(pieces_in_any_order_through_strides, setup, teardown),
        cmocka_unit_test_setup_teardown(pieces_of_an_inner_axis, setup, teardown),
        cmocka_unit_test_setup_teardown(pieces_from_many_threads, setup, teardown),
        cmocka_unit_test_setup_teardown(index_lists_what_is_there, setup, teardown),
        cmocka_unit_test_setup_teardown(contradictions_are_remembered, setup, teardown),
        cmocka_unit_test_setup_teardown(a_folder_that_is_gone, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
