/* Streaming attention against a softmax in double over the whole row, in floats and s8. */
#include "core/net/attention.h"

#include "core/base/cpu.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static struct {
    struct kernels kernels;
    struct arena arena;
    struct attention a;
    struct attention_workspace room;
    uint32_t rng;
    float *qkv; // (seqs, len, 3, heads, width)
    double *want;
    float *got;
} t;

static float uniform(void)
{
    t.rng = t.rng * 1664525u + 1013904223u;
    return (float)(t.rng >> 8) * 0x1p-23f - 1;
}

static float *at(int seq, int token, int part, int head)
{
    size_t c = (size_t)t.a.heads * (size_t)t.a.width;
    size_t row = (size_t)seq * (size_t)t.a.len + (size_t)token;
    return t.qkv + (row * 3 + (size_t)part) * c + (size_t)head * (size_t)t.a.width;
}

/* A shape with random tokens: q, k in [-reach, reach], v in [-1, 1]. */
static void open_world(struct attention shape, float reach)
{
    memset(&t, 0, sizeof t);
    kernels_init(&t.kernels, cpu_detect());
    t.a = shape;
    t.a.q_len = shape.len;
    t.a.k = &t.kernels.net;
    size_t c = (size_t)(t.a.heads * t.a.width), n = (size_t)t.a.seqs * (size_t)t.a.len * 3 * c;
    struct arena need = arena_counter();
    assert_int_equal(attention_init(&t.a, &need), OK);
    assert_int_equal(attention_workspace_init(&t.room, t.a.width, &need), OK);
    assert_int_equal(arena_init(&t.arena, "attention", need.peak), OK);
    assert_int_equal(attention_init(&t.a, &t.arena), OK);
    assert_int_equal(attention_workspace_init(&t.room, t.a.width, &t.arena), OK);
    assert_true(t.arena.peak == need.peak);
    t.qkv = malloc(n * sizeof *t.qkv);
    t.want = malloc((size_t)t.a.width * sizeof *t.want);
    t.got = malloc(ATTENTION_ROWS * (c + 3) * sizeof *t.got);
    assert_true(t.qkv && t.want && t.got);
    for (size_t i = 0; i < n; i++)
        t.qkv[i] = uniform() * (i / c % 3 < 2 ? reach : 1);
}

static void close_world(void)
{
    free(t.qkv);
    free(t.want);
    free(t.got);
    arena_free(&t.arena);
}

static void store_all(void)
{
    for (int s = 0; s < t.a.seqs; s++)
        for (int first = 0; first < t.a.len; first += ATTENTION_KEYS) {
            int left = t.a.len - first;
            struct attention_span span = {s, first, left < ATTENTION_KEYS ? left : ATTENTION_KEYS};
            attention_store_queries(&t.a, &span, at(s, first, 0, 0));
            attention_store_block(&t.a, &span, at(s, first, 0, 0), &t.room);
        }
}

static void naive(int seq, int token, int head)
{
    double top = -INFINITY, sum = 0, *p = malloc((size_t)t.a.len * sizeof *p);
    assert_non_null(p);
    for (int j = 0; j < t.a.len; j++) {
        const float *q = at(seq, token, 0, head), *k = at(seq, j, 1, head);
        p[j] = 0;
        for (int c = 0; c < t.a.width; c++)
            p[j] += (double)q[c] * k[c] / sqrt(t.a.width);
        top = fmax(top, p[j]);
    }
    memset(t.want, 0, (size_t)t.a.width * sizeof *t.want);
    for (int j = 0; j < t.a.len; j++) {
        double w = exp(p[j] - top);
        sum += w;
        for (int c = 0; c < t.a.width; c++)
            t.want[c] += w * (double)at(seq, j, 2, head)[c];
    }
    for (int c = 0; c < t.a.width; c++)
        t.want[c] /= sum;
    free(p);
}

/* One row of a head against the naive one, each error within `bound`; sum of their squares. */
static double check_row(int seq, int token, int head, const float *row, double bound)
{
    double squares = 0;
    naive(seq, token, head);
    for (int c = 0; c < t.a.width; c++) {
        double error = (double)row[c] - t.want[c];
        squares += error * error;
        if (!(fabs(error) <= bound))
            fail_msg("len %d width %d sequence %d head %d row %d channel %d: %g, wanted %g",
                     t.a.len, t.a.width, seq, head, token, c, (double)row[c], t.want[c]);
    }
    return squares;
}

/* Rows of a span through one head, written into the middle of wider rows. */
static double check_head(const struct attention_span *s, int head, double bound)
{
    size_t ldo = (size_t)(t.a.heads * t.a.width) + 3;
    double squares = 0;
    for (size_t i = 0; i < ATTENTION_ROWS * ldo; i++)
        t.got[i] = 1e9f;
    attention_head(&t.a, s, head, t.got + head * t.a.width, ldo, &t.room);
    for (int i = 0; i < s->n; i++) {
        const float *row = t.got + (size_t)i * ldo + head * t.a.width;
        squares += check_row(s->seq, s->first + i, head, row, bound);
        assert_true(row[t.a.width] == 1e9f);
    }
    return squares;
}

/* n rows from `first` on of every sequence and head: errors within `bound`, and a quarter of it in
 * the mean of squares. */
static void check_rows(int first, int n, double bound)
{
    double squares = 0;
    for (int s = 0; s < t.a.seqs; s++)
        for (int h = 0; h < t.a.heads; h++) {
            const struct attention_span span = {s, first, n};
            squares += check_head(&span, h, bound);
        }
    assert_true(sqrt(squares / (t.a.seqs * t.a.heads * n * t.a.width)) <= bound / 4);
}

static void lengths_and_widths(void **state)
{
    static const int lens[] = {1, 5, 16, 63, 127, 128, 129, 300};
    static const int widths[] = {16, 64, 128};
    (void)state;
    for (int f = 0; f < 2; f++)
        for (int i = 0; i < 8; i++)
            for (int w = 0; w < 3; w++) {
                open_world(
                    (struct attention){
                        .seqs = 2, .len = lens[i], .heads = 3, .width = widths[w], .floats = f > 0},
                    2);
                store_all();
                int last = lens[i] - 1 - (lens[i] - 1) % ATTENTION_ROWS;
                check_rows(0, lens[i] < 7 ? lens[i] : 7, f ? 2e-6 : 0.08);
                check_rows(last, lens[i] - last, f ? 2e-6 : 0.08);
                close_world();
            }
}

/* More keys than the release can have: 18 views of 1029. */
static void many_keys(void **state)
{
    (void)state;
    for (int f = 0; f < 2; f++) {
        open_world(
            (struct attention){.seqs = 1, .len = 20000, .heads = 1, .width = 64, .floats = f > 0},
            3);
        store_all();
        check_rows(19968, 32, f ? 2e-6 : 0.01);
        close_world();
    }
}

/* Logits up to +-80: the largest decide alone, and nothing overflows. */
static void large_logits(void **state)
{
    (void)state;
    for (int f = 0; f < 2; f++) {
        open_world(
            (struct attention){.seqs = 1, .len = 500, .heads = 2, .width = 64, .floats = f > 0}, 1);
        for (int i = 0; i < 2 * 500; i++) {
            int token = i / 2, head = i % 2;
            memset(at(0, token, 0, head), 0, 64 * sizeof(float));
            memset(at(0, token, 1, head), 0, 64 * sizeof(float));
            at(0, token, 0, head)[head] = 80;
            at(0, token, 1, head)[head] = 8 * (float)(token - 250) / 250;
        }
        store_all();
        check_rows(0, 64, f ? 2e-5 : 0.06);
        close_world();
    }
}

/* One key has all the weight: its value comes out, in s8 within half a step of it. */
static void one_key_dominates(void **state)
{
    (void)state;
    for (int f = 0; f < 2; f++)
        for (int key = 0; key < 400; key += 133) {
            open_world(
                (struct attention){.seqs = 1, .len = 400, .heads = 1, .width = 64, .floats = f > 0},
                0.01f);
            for (int i = 0; i < 400; i++)
                at(0, i, 0, 0)[5] = 100;
            at(0, key, 1, 0)[5] = 100;
            store_all();
            check_rows(0, 64, f ? 1e-6 : 4.0 / 254);
            for (int c = 0; c < 64; c++)
                assert_true(fabs((double)t.got[c] - (double)at(0, key, 2, 0)[c]) < 1.01 / 254);
            close_world();
        }
}

/* Queries and keys as large as floats allow: the largest logit takes all. */
static void huge_values(void **state)
{
    static const float sizes[] = {1e4f, 1e9f, 1e14f};
    (void)state;
    for (int f = 0; f < 2; f++)
        for (int s = 0; s < 3; s++) {
            open_world(
                (struct attention){.seqs = 1, .len = 300, .heads = 1, .width = 32, .floats = f > 0},
                0.1f * sizes[s]);
            for (int i = 0; i < 300; i++)
                at(0, i, 0, 0)[3] = 3 * sizes[s];
            at(0, 222, 1, 0)[3] = sizes[s];
            store_all();
            check_rows(0, 64, f ? 1e-6 : 4.0 / 254);
            close_world();
        }
}

/* Equal logits give the mean of all values: also those of a last block with one key. */
static void equal_logits(void **state)
{
    (void)state;
    for (int f = 0; f < 2; f++) {
        open_world(
            (struct attention){.seqs = 1, .len = 257, .heads = 1, .width = 32, .floats = f > 0}, 0);
        store_all();
        check_rows(0, 64, f ? 1e-6 : 1.01 / 254);
        close_world();
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lengths_and_widths), cmocka_unit_test(many_keys),
        cmocka_unit_test(large_logits),       cmocka_unit_test(one_key_dominates),
        cmocka_unit_test(equal_logits),       cmocka_unit_test(huge_values),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
