/* The network on several ranks: the same bytes as on one, however views are dealt, also where ranks
 * have none; memory as planned, less on each rank the more there are; bytes that travel by the
 * formulas of core/net/README.md 2.13. */
#include "core/net/net.h"

#include "core/net/backbone.h"
#include "tests/unit/core/base/team_local.h"
#include "tests/unit/core/net/net_world.h"
#include "tests/unit/some_of.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS_MAX = 6, SIZE_MAX_PX = 98, RANKS_MAX = 9 };

static const int unequal[RANKS_MAX] = {8, 2, 5, 1, 8, 1, 3, 2, 1};

/* What a rank leaves. */
struct rank_end {
    uint64_t hash, sent;
    size_t keep, tmp;           // most memory
    size_t keep_plan, tmp_plan; // as planned
};

static struct {
    struct net_world world; // weights and kernels of all ranks
    uint8_t rgb[3 * VIEWS_MAX * SIZE_MAX_PX * SIZE_MAX_PX];
    float log2t[VIEWS_MAX];
    struct views v;
    int threads;
    bool tapped, backbone; // backbone: nothing after it
    struct rank_end end[RANKS_MAX];
} t;

static void open_network(const struct net_dims *d, enum precision precision, unsigned floats)
{
    net_world_bind(&t.world, d, precision, floats);
    t.world.net.attend = d->appearance;
    t.threads = 1;
    t.tapped = t.backbone = false;
    for (size_t i = 0; i < sizeof t.rgb; i++)
        t.rgb[i] = (uint8_t)(i * 2654435761u >> 24);
    for (int i = 0; i < VIEWS_MAX; i++)
        t.log2t[i] = (float)(i % 3 * 2 - 2);
}

/* As net_world_hash, of words of 4 bytes: there are many. */
static uint64_t hash_words(const void *p, size_t bytes, uint64_t h)
{
    for (size_t i = 0; i < bytes; i += sizeof(uint32_t)) {
        uint32_t word;
        memcpy(&word, (const char *)p + i, sizeof word);
        h = (h ^ word) * 0x100000001B3u;
    }
    return h;
}

static uint64_t hash_of(const struct prediction *p)
{
    const size_t views = (size_t)p->geom.n_views, side = (size_t)p->geom.size;
    const size_t px = views * side * side;
    const size_t matches = views * views * (side / NET_PATCH) * (side / NET_PATCH);
    uint64_t h = hash_words(p->geom.pose, views * NET_POSE * sizeof(float), 1);
    h = hash_words(p->geom.cams, views * sizeof *p->geom.cams, h);
    h = hash_words(p->geom.depth, px * sizeof(float), h);
    h = hash_words(p->theta, sizeof p->theta, h);
    if (p->points)
        h = hash_words(p->points, 3 * px * sizeof(float), h);
    if (p->features)
        h = hash_words(p->features, 87 * px * sizeof(float), h);
    if (p->confidence)
        h = hash_words(p->confidence, px * sizeof(float), h);
    if (!p->matches.token)
        return h;
    h = hash_words(p->matches.token, matches * CORRESPONDENCE_BEST * sizeof(int16_t), h);
    return hash_words(p->matches.share, matches * CORRESPONDENCE_BEST * sizeof(float), h);
}

static void ignore_tap(void *ctx, const struct tap_tensor *tensor)
{
    (void)ctx;
    (void)tensor;
}

static err_t run_planned(struct team *team, struct arena *keep, struct arena *tmp)
{
    const struct tap tap = {.put = ignore_tap};
    struct pool *pool;
    struct prediction out;
    struct tokens tokens;
    err_t e = pool_open(&pool, t.threads);
    if (e)
        return e;
    const struct run r = {.k = &t.world.kernels,
                          .pool = pool,
                          .team = team,
                          .keep = keep,
                          .tmp = tmp,
                          .tap = t.tapped ? &tap : NULL};
    e = t.backbone ? backbone_run(&r, &t.world.net, &t.v, &tokens)
                   : net_run(&r, &t.world.net, &t.v, &out);
    pool_close(pool);
    if (!e && !t.backbone)
        t.end[team_rank(team)].hash = hash_of(&out);
    return e;
}

static err_t run_rank(void *ctx, struct team *team)
{
    struct rank_end *end = &t.end[team_rank(team)];
    struct plan plan = plan_begin(t.threads);
    struct arena keep = {0}, tmp = {0};
    (void)ctx;
    plan.team = team;
    if (t.backbone)
        backbone_plan(&plan, &t.world.net, t.v.n, t.v.size);
    else
        net_plan(&plan, &t.world.net, t.v.n, t.v.size);
    err_t e = arena_init(&keep, "keep", plan.keep.peak);
    if (!e)
        e = arena_init(&tmp, "tmp", plan.tmp.peak);
    if (!e)
        e = run_planned(team, &keep, &tmp);
    *end = (struct rank_end){.hash = end->hash,
                             .sent = team ? team->sent : 0,
                             .keep = keep.peak,
                             .tmp = tmp.peak,
                             .keep_plan = plan.keep.peak,
                             .tmp_plan = plan.tmp.peak};
    arena_free(&keep);
    arena_free(&tmp);
    return e;
}

static err_t run_ranks(int n, const int *share, int n_views, int size)
{
    memset(t.end, 0, sizeof t.end);
    t.v = (struct views){.n = n_views, .size = size, .rgb = t.rgb, .log2t = t.log2t};
    return team_local_run(n, share, run_rank, NULL, NULL);
}

static int views_of(int rank, int n, const int *share, int n_views)
{
    struct team team = {.rank = rank, .size = n};
    for (int i = 0; i < n; i++)
        team.share[i] = share ? share[i] : 1;
    return team_own(&team, n_views);
}

/* Against `want` of a single process; memory, unless a rank has no views, nearly as planned. */
static void check_ranks(int n, const int *share, uint64_t want)
{
    for (int i = 0; i < n; i++) {
        const struct rank_end *e = &t.end[i];
        if (e->hash != want)
            fail_msg("rank %d of %d, %d views of %d px: other bytes", i, n, t.v.n, t.v.size);
        assert_true(e->keep <= e->keep_plan && e->tmp <= e->tmp_plan);
        assert_true((double)e->keep > 0.99 * (double)e->keep_plan);
        if (views_of(i, n, share, t.v.n) > 0 && (double)e->tmp <= 0.9 * (double)e->tmp_plan)
            fail_msg("rank %d of %d: %zu bytes of scratch, planned %zu", i, n, e->tmp, e->tmp_plan);
    }
}

/* 1 to `most` ranks, and as many of unequal speed. */
static void compare_ranks(int most, int n_views, int size)
{
    assert_int_equal(run_ranks(1, NULL, n_views, size), OK);
    const uint64_t want = t.end[0].hash;
    assert_true(want != 0);
    for (int n = 2; n <= most; n += some_of(2))
        for (int k = 0; k < 2; k++) {
            const int *share = k ? unequal : NULL;
            assert_int_equal(run_ranks(n, share, n_views, size), OK);
            check_ranks(n, share, want);
        }
}

/* One block of keys for all views, then several, of which most belong to two ranks or more. */
static void any_ranks_and_views(void **state)
{
    (void)state;
    open_network(&small_model_tiny, PRECISION_S8, 0);
    for (int n_views = 2; n_views <= VIEWS_MAX; n_views += some_of(3))
        compare_ranks(5, n_views, 42);
    compare_ranks(5, 2, SIZE_MAX_PX);
    compare_ranks(5, 5, SIZE_MAX_PX);
    compare_ranks(RANKS_MAX, VIEWS_MAX, SIZE_MAX_PX);
    small_model_free(&t.world.model);
}

static void any_arithmetic(void **state)
{
    static const enum precision precisions[] = {PRECISION_F32, PRECISION_BF16, PRECISION_S8};
    static const unsigned floats[] = {0, 0, NET_FLOAT_SPECIAL | NET_FLOAT_ATTENTION};
    (void)state;
    for (int i = 0; i < 3; i++) {
        open_network(&small_model_tiny, precisions[i], floats[i]);
        compare_ranks(4, 5, SIZE_MAX_PX);
        small_model_free(&t.world.model);
    }
}

static void any_threads(void **state)
{
    (void)state;
    open_network(&small_model_tiny, PRECISION_S8, 0);
    assert_int_equal(run_ranks(1, NULL, 4, SIZE_MAX_PX), OK);
    const uint64_t want = t.end[0].hash;
    t.threads = 3;
    assert_int_equal(run_ranks(3, NULL, 4, SIZE_MAX_PX), OK);
    check_ranks(3, NULL, want);
    small_model_free(&t.world.model);
}

static void other_heads(void **state)
{
    struct net_dims d = small_model_tiny;
    (void)state;
    d.appearance = false;
    open_network(&d, PRECISION_S8, 0);
    compare_ranks(4, 3, SIZE_MAX_PX);
    small_model_free(&t.world.model);
    d.gauss = false;
    d.gs_feat = d.hdr = 0;
    memset(d.gs_oc, 0, sizeof d.gs_oc);
    open_network(&d, PRECISION_S8, 0);
    compare_ranks(4, 3, SIZE_MAX_PX);
    small_model_free(&t.world.model);
}

/* More heads than are on their way at a time, on a network that attends to no other view. */
static void many_heads(void **state)
{
    struct net_dims d = small_model_tiny;
    (void)state;
    d.embed = 128;
    d.heads = 8;
    open_network(&d, PRECISION_S8, 0);
    t.world.net.attend = false;
    compare_ranks(3, 3, SIZE_MAX_PX);
    small_model_free(&t.world.model);
}

static void less_memory_on_each(void **state)
{
    size_t last = SIZE_MAX;
    (void)state;
    open_network(&small_model_tiny, PRECISION_S8, 0);
    for (int n = 1; n <= VIEWS_MAX; n += n < 3 ? 1 : 3) {
        assert_int_equal(run_ranks(n, NULL, VIEWS_MAX, SIZE_MAX_PX), OK);
        assert_true(t.end[0].tmp < last);
        last = t.end[0].tmp;
    }
    small_model_free(&t.world.model);
}

/* The largest step of the backbone is a global block, also where a rank has no views. */
static void backbone_as_planned(void **state)
{
    (void)state;
    open_network(&small_model_tiny, PRECISION_S8, 0);
    t.backbone = true;
    for (int n = 1; n <= RANKS_MAX; n++) {
        assert_int_equal(run_ranks(n, unequal, VIEWS_MAX, SIZE_MAX_PX), OK);
        for (int i = 0; i < n; i++)
            assert_true(t.end[i].keep == t.end[i].keep_plan && t.end[i].tmp == t.end[i].tmp_plan);
    }
    small_model_free(&t.world.model);
}

/* ---- bytes: core/net/README.md 2.13 ---- */

/* Blocks of 128 tokens that begin among those of the views [first, end), and tokens at their
 * beginning that lie in a block that began before. */
static void count_blocks(int first, int end, int per_view, int *blocks, int *lent)
{
    *blocks = *lent = 0;
    for (int token = first * per_view; token < end * per_view; token++) {
        *blocks += token % 128 == 0;
        *lent += *blocks == 0;
    }
}

static uint64_t bytes_of(int rank, int n, const int *share, int n_views, int size)
{
    const struct net_dims *d = &t.world.net.d;
    const uint64_t m = (uint64_t)(size / NET_PATCH) * (uint64_t)(size / NET_PATCH), p = m + 5;
    const uint64_t c = (uint64_t)d->embed, w = c / (uint64_t)d->heads, hdr = (uint64_t)d->hdr;
    const uint64_t px = (uint64_t)size * (uint64_t)size, panels = (2 * hdr + 15) / 16;
    int first = 0, blocks, lent;
    for (int i = 0; i < rank; i++)
        first += views_of(i, n, share, n_views);
    const int own = views_of(rank, n, share, n_views);
    count_blocks(first, first + own, (int)p, &blocks, &lent);
    const uint64_t others = (uint64_t)(n - 1), layers = (uint64_t)d->depth;
    uint64_t view = 4 * (2 * c + px);            // camera token, depth
    view += 4 * p * c;                           // keys of the shared attention
    view += (uint64_t)n_views * m * 4 * (2 + 4); // matches
    view += 8 * hdr + 4 * 16 * panels * m;       // means, values
    view += 4 * (88 * px + 2 * hdr);             // raw Gaussians, summary
    const uint64_t block = c * (2 * 128 + 8) + 4 * 128 * (c / w);
    return others * (uint64_t)own * view +
           layers * (others * (uint64_t)blocks * block + (uint64_t)lent * 4 * c);
}

static void bytes_by_formula(void **state)
{
    (void)state;
    open_network(&small_model_tiny, PRECISION_S8, 0);
    for (int n = 2; n <= 7; n++)
        for (int k = 0; k < 2; k++) {
            const int *share = k ? unequal : NULL;
            assert_int_equal(run_ranks(n, share, VIEWS_MAX, SIZE_MAX_PX), OK);
            for (int i = 0; i < n; i++)
                assert_int_equal(t.end[i].sent, bytes_of(i, n, share, VIEWS_MAX, SIZE_MAX_PX));
        }
    small_model_free(&t.world.model);
}

static void taps_are_refused(void **state)
{
    (void)state;
    open_network(&small_model_tiny, PRECISION_S8, 0);
    t.tapped = true;
    assert_int_equal(run_ranks(1, NULL, 2, 42), OK);
    assert_int_equal(run_ranks(2, NULL, 2, 42), ERR_UNSUPPORTED);
    assert_non_null(strstr(err_text(), "single process"));
    small_model_free(&t.world.model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(any_ranks_and_views), cmocka_unit_test(any_arithmetic),
        cmocka_unit_test(any_threads),         cmocka_unit_test(other_heads),
        cmocka_unit_test(many_heads),          cmocka_unit_test(less_memory_on_each),
        cmocka_unit_test(backbone_as_planned), cmocka_unit_test(bytes_by_formula),
        cmocka_unit_test(taps_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
