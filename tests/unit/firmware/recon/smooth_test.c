/* Factors between the weights of a network: which tensors carry them, that its function stays, that
 * outliers shrink, that dead, huge and tiny channels harm nobody; and what all this is for: int8
 * weights with planted outliers are as good as those without. */
#include "firmware/recon/smooth.h"

#include "core/base/cpu.h"
#include "core/net/net.h"
#include "tests/unit/core/net/tiny_net.h"
#include "tests/unit/small_model.h"

#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>

#include <cmocka.h>

/* ---- weights with changes ---- */

/* Elements first, first + step, .. (n) of a tensor: set, or multiplied. */
struct change {
    char name[NET_NAME_CAP];
    size_t first, step, n;
    float value;
    bool set;
};

enum { CHANGES = 4096 };

static struct {
    struct change list[CHANGES];
    int n;
    int fail; // the call that fails; 0: none
} plant;

static struct change *add(const char *name, size_t first, size_t step, size_t n, float value)
{
    assert_true(plant.n < CHANGES);
    struct change *c = plant.list + plant.n++;
    snprintf(c->name, sizeof c->name, "%s", name);
    c->first = first;
    c->step = step;
    c->n = n;
    c->value = value;
    c->set = false;
    return c;
}

static void set(const char *name, size_t first, size_t step, size_t n, float value)
{
    add(name, first, step, n, value)->set = true;
}

static void planted(void *ctx, const struct tensor_spec *t, float *out)
{
    (void)ctx;
    hashed_fill(t, 1, 0, table_count(t), out);
    for (int i = 0; i < plant.n; i++) {
        const struct change *c = plant.list + i;
        for (size_t k = 0; k < c->n && strcmp(c->name, t->name) == 0; k++) {
            float *x = out + c->first + k * c->step;
            *x = c->set ? c->value : *x * c->value;
        }
    }
}

static err_t fetch(void *ctx, const struct run *r, const struct tensor_spec *t, float *out)
{
    (void)r;
    if (plant.fail > 0 && --plant.fail == 0)
        return err_fail(ERR_IO, "planted");
    planted(ctx, t, out);
    return OK;
}

/* ---- the values of one tensor, as they are and smoothed ---- */

static const struct run no_run;
static struct smooth smooth;

struct values {
    struct tensor_spec t;
    size_t n;
    float *raw, *out;
};

struct wanted {
    const char *name;
    struct values *v;
};

static err_t pick(void *ctx, const struct tensor_spec *t)
{
    struct wanted *w = ctx;
    if (strcmp(t->name, w->name) == 0)
        w->v->t = *t;
    return OK;
}

static struct values values(const char *prefix, const char *suffix)
{
    struct values v = {.n = 0};
    char name[NET_NAME_CAP];
    snprintf(name, sizeof name, "%s%s", prefix, suffix);
    struct wanted w = {name, &v};
    assert_int_equal(table_walk(smooth.dims, pick, &w), OK);
    assert_true(v.t.rank > 0);
    v.n = table_count(&v.t);
    v.raw = small_alloc(v.n, sizeof *v.raw);
    v.out = small_alloc(v.n, sizeof *v.out);
    planted(NULL, &v.t, v.raw);
    assert_int_equal(smooth_fetch(&smooth, &no_run, &v.t, v.out), OK);
    for (size_t i = 0; i < v.n; i++)
        if (!isfinite(v.out[i]))
            fail_msg("%s: %zu is not finite", name, i);
    return v;
}

static void drop(struct values *v)
{
    free(v->raw);
    free(v->out);
}

static void begin(void)
{
    plant.n = 0;
    smooth = (struct smooth){.dims = &tiny_net, .fetch = fetch};
}

/* Groups are found anew. */
static void again(void)
{
    smooth_free(&smooth);
    assert_null(smooth.groups);
}

/* ---- which ones ---- */

static const char *const in_block[] = {"norm1.weight",  "norm1.bias",       "attn.qkv.weight",
                                       "attn.qkv.bias", "attn.proj.weight", "norm2.weight",
                                       "norm2.bias",    "mlp.fc1.weight",   NULL};
static const char *const in_trunk[] = {
    "norm.weight",       "norm.bias", "projects.0.weight", "projects.1.weight", "projects.2.weight",
    "projects.3.weight", NULL};

enum { BLOCKS = 10, TRUNKS = 2 };
static const char *const blocks[BLOCKS] = {
    "encoder.aggregator.patch_embed.blocks.0.", "encoder.aggregator.frame_blocks.0.",
    "encoder.aggregator.frame_blocks.1.",       "encoder.aggregator.frame_blocks.2.",
    "encoder.aggregator.frame_blocks.3.",       "encoder.aggregator.global_blocks.0.",
    "encoder.aggregator.global_blocks.1.",      "encoder.aggregator.global_blocks.2.",
    "encoder.aggregator.global_blocks.3.",      "encoder.camera_head.trunk.0."};
static const char *const trunks[TRUNKS] = {"encoder.depth_head.", "encoder.gaussian_param_head."};

static bool is_one_of(const char *name, const char *const *prefix, int n, const char *const *suffix)
{
    char full[NET_NAME_CAP];
    for (int i = 0; i < n; i++)
        for (int k = 0; suffix[k]; k++) {
            snprintf(full, sizeof full, "%s%s", prefix[i], suffix[k]);
            if (strcmp(name, full) == 0)
                return true;
        }
    return false;
}

static err_t check_tensor(void *ctx, const struct tensor_spec *t)
{
    int *changed = ctx;
    struct values v = values("", t->name);
    bool want = is_one_of(t->name, blocks, BLOCKS, in_block) ||
                is_one_of(t->name, trunks, TRUNKS, in_trunk);
    bool same = memcmp(v.raw, v.out, v.n * sizeof *v.raw) == 0;
    if (want == same)
        fail_msg("%s is %s", t->name, same ? "as it was" : "changed");
    *changed += !same;
    drop(&v);
    return OK;
}

static void these_tensors_and_no_others(void **state)
{
    int changed = 0;
    (void)state;
    begin();
    assert_int_equal(table_walk(&tiny_net, check_tensor, &changed), OK);
    assert_int_equal(changed, BLOCKS * 8 + TRUNKS * 6);
    again();
}

/* ---- the function ---- */

static void assert_kept(double raw, double out, const char *what)
{
    if (!(fabs(raw - out) <= 1e-6 * fabs(raw)))
        fail_msg("%s: %.9g became %.9g", what, raw, out);
}

/* a_c w_oc for the rows [0, rows) of w (.., c). */
static void keep_columns(const char *prefix, const char *over, const char *times, size_t rows)
{
    struct values a = values(prefix, over), w = values(prefix, times);
    size_t c = a.n;
    rows = rows ? rows : w.n / c;
    for (size_t i = 0; i < rows * c; i++)
        assert_kept((double)a.raw[i % c] * (double)w.raw[i],
                    (double)a.out[i % c] * (double)w.out[i], prefix);
    drop(&a);
    drop(&w);
}

/* gain_c v_oc proj_po, and the same with the offsets of the norm and of v. */
static void keep_values(const char *prefix)
{
    struct values g = values(prefix, "norm1.weight"), o = values(prefix, "norm1.bias");
    struct values v = values(prefix, "attn.qkv.weight"), b = values(prefix, "attn.qkv.bias");
    struct values p = values(prefix, "attn.proj.weight");
    size_t c = g.n;
    for (size_t i = 0; i < 2 * c; i++)
        assert_true(b.raw[i] == b.out[i]); // those of q and k
    for (size_t row = 0; row < c; row++)
        for (size_t i = 0; i < c * c; i++) {
            size_t at = (2 * c + row) * c + i % c, to = i / c * c + row;
            double raw = (double)v.raw[at] * (double)p.raw[to];
            double out = (double)v.out[at] * (double)p.out[to];
            assert_kept(raw * (double)g.raw[i % c], out * (double)g.out[i % c], prefix);
            assert_kept(raw * (double)o.raw[i % c], out * (double)o.out[i % c], prefix);
            assert_kept((double)b.raw[2 * c + row] * (double)p.raw[to],
                        (double)b.out[2 * c + row] * (double)p.out[to], prefix);
        }
    struct values *all[] = {&g, &o, &v, &b, &p};
    for (int i = 0; i < 5; i++)
        drop(all[i]);
}

static void keep_block(const char *prefix)
{
    struct values g = values(prefix, "norm1.weight");
    size_t c = g.n;
    drop(&g);
    keep_columns(prefix, "norm1.weight", "attn.qkv.weight", 2 * c);
    keep_columns(prefix, "norm1.bias", "attn.qkv.weight", 2 * c);
    keep_columns(prefix, "norm2.weight", "mlp.fc1.weight", 0);
    keep_columns(prefix, "norm2.bias", "mlp.fc1.weight", 0);
    keep_values(prefix);
}

static void keep_trunk(const char *prefix)
{
    for (int k = 2; k < 6; k++) {
        keep_columns(prefix, "norm.weight", in_trunk[k], 0);
        keep_columns(prefix, "norm.bias", in_trunk[k], 0);
    }
}

static void the_function_stays(void **state)
{
    (void)state;
    begin();
    for (int i = 0; i < BLOCKS; i++)
        keep_block(blocks[i]);
    for (int i = 0; i < TRUNKS; i++)
        keep_trunk(trunks[i]);
    again();
}

/* ---- outliers ---- */

static const char *name_of(const char *prefix, const char *suffix)
{
    static char name[4][NET_NAME_CAP];
    static int turn;
    turn = (turn + 1) % 4;
    snprintf(name[turn], sizeof name[turn], "%s%s", prefix, suffix);
    return name[turn];
}

/* Channel i of c times f, what reads it over `back`. */
struct spot {
    const char *prefix;
    size_t c, i;
    float f, back;
};

static void plant_norm(const struct spot *s, const char *norm, const char *reads, size_t rows)
{
    char name[NET_NAME_CAP];
    snprintf(name, sizeof name, "%s%s.weight", s->prefix, norm);
    add(name, s->i, 1, 1, s->f);
    snprintf(name, sizeof name, "%s%s.bias", s->prefix, norm);
    add(name, s->i, 1, 1, s->f);
    add(name_of(s->prefix, reads), s->i, s->c, rows, 1 / s->back);
}

static void plant_value(const struct spot *s)
{
    size_t row = 2 * s->c + s->i;
    add(name_of(s->prefix, "attn.qkv.weight"), row * s->c, 1, s->c, s->f);
    add(name_of(s->prefix, "attn.qkv.bias"), row, 1, 1, s->f);
    add(name_of(s->prefix, "attn.proj.weight"), s->i, s->c, s->c, 1 / s->back);
}

/* Four channels each of both norms and of v. */
static void plant_block(const char *prefix, size_t c, float f, float back)
{
    for (size_t k = 0; k < 4; k++) {
        plant_norm(&(struct spot){prefix, c, (5 * k + 3) % c, f, back}, "norm1", "attn.qkv.weight",
                   3 * c);
        plant_norm(&(struct spot){prefix, c, (7 * k + 1) % c, f, back}, "norm2", "mlp.fc1.weight",
                   4 * c);
        plant_value(&(struct spot){prefix, c, (3 * k + 2) % c, f, back});
    }
}

static int ascending(const void *a, const void *b)
{
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* Largest over middle of n magnitudes. */
static float spread(float *x, size_t n)
{
    qsort(x, n, sizeof *x, ascending);
    return x[n - 1] / x[n / 2];
}

/* Spread of the channels of a norm, and of the columns of w that read them. */
static void norm_spread(const char *prefix, const char *norm, const char *reads, float out[2])
{
    char bias[NET_NAME_CAP];
    snprintf(bias, sizeof bias, "%s.bias", norm);
    struct values g = values(prefix, name_of(norm, ".weight")), b = values(prefix, bias);
    struct values w = values(prefix, reads);
    float *top = small_alloc(g.n, sizeof *top);
    for (size_t i = 0; i < g.n; i++) {
        g.out[i] = 3 * fabsf(g.out[i]) + fabsf(b.out[i]);
        top[i] = 0;
        for (size_t o = i; o < w.n; o += g.n)
            top[i] = fmaxf(top[i], fabsf(w.out[o]));
    }
    out[0] = spread(g.out, g.n);
    out[1] = spread(top, g.n);
    free(top);
    drop(&g);
    drop(&b);
    drop(&w);
}

/* Spread of the rows of v and of proj's columns. */
static void value_spread(const char *prefix, float out[2])
{
    struct values v = values(prefix, "attn.qkv.weight"), p = values(prefix, "attn.proj.weight");
    size_t c = (size_t)p.t.shape[0];
    float *row = small_alloc(c, sizeof *row), *top = small_alloc(c, sizeof *top);
    for (size_t i = 0; i < c; i++) {
        row[i] = top[i] = 0;
        for (size_t k = 0; k < c; k++) {
            row[i] = fmaxf(row[i], fabsf(v.out[(2 * c + i) * c + k]));
            top[i] = fmaxf(top[i], fabsf(p.out[k * c + i]));
        }
    }
    out[0] = spread(row, c);
    out[1] = spread(top, c);
    free(row);
    free(top);
    drop(&v);
    drop(&p);
}

static void block_spread(const char *prefix, float out[6])
{
    norm_spread(prefix, "norm1", "attn.qkv.weight", out);
    norm_spread(prefix, "norm2", "mlp.fc1.weight", out + 2);
    value_spread(prefix, out + 4);
}

/* Outliers that the next weights take back vanish; those which they do not are shared by both
 * sides. */
static void outliers_shrink(void **state)
{
    (void)state;
    const char *const some[] = {blocks[0], blocks[2], blocks[7], blocks[9]};
    for (int k = 0; k < 4; k++) {
        size_t c = k == 3 ? 64 : 32;
        float clean[6], back[6], stay[6];
        begin();
        block_spread(some[k], clean);
        again();
        plant_block(some[k], c, 300, 300);
        block_spread(some[k], back);
        keep_block(some[k]);
        again();
        plant.n = 0;
        plant_block(some[k], c, 300, 1);
        block_spread(some[k], stay);
        keep_block(some[k]);
        again();
        for (int i = 0; i < 6; i++) {
            assert_true(back[i] < 2 * clean[i]); // the columns of q, k and v also have rows of v
            assert_true(stay[i] < 1.5f * sqrtf(300) * clean[i]);
        }
    }
}

static void outliers_of_trunks_shrink(void **state)
{
    (void)state;
    for (int k = 0; k < TRUNKS; k++) {
        const int *oc = k ? tiny_net.gs_oc : tiny_net.depth_oc;
        float clean[2], back[2];
        begin();
        norm_spread(trunks[k], "norm", "projects.2.weight", clean);
        again();
        for (size_t i = 0; i < 4; i++) {
            add(name_of(trunks[k], "norm.weight"), 9 * i, 1, 1, 300);
            add(name_of(trunks[k], "norm.bias"), 9 * i, 1, 1, 300);
            for (int p = 0; p < NET_KEEP; p++)
                add(name_of(trunks[k], in_trunk[2 + p]), 9 * i, 64, (size_t)oc[p], 1.0f / 300);
        }
        norm_spread(trunks[k], "norm", "projects.2.weight", back);
        keep_trunk(trunks[k]);
        again();
        for (int i = 0; i < 2; i++)
            assert_float_equal(back[i], clean[i], 1e-4 * (double)clean[i]);
    }
}

/* ---- dead, huge and tiny channels ---- */

static void assert_untouched(const char *prefix, const char *suffix, size_t first, size_t step,
                             size_t n)
{
    struct values v = values(prefix, suffix);
    for (size_t i = 0; i < n; i++)
        if (v.raw[first + i * step] != v.out[first + i * step])
            fail_msg("%s%s: %zu changed", prefix, suffix, first + i * step);
    drop(&v);
}

static void dead_channels(void **state)
{
    (void)state;
    const char *b = blocks[3];
    const size_t c = 32;
    begin();
    set(name_of(b, "norm1.weight"), 3, 4, 2, 0); // channels 3 and 7
    set(name_of(b, "norm1.bias"), 3, 4, 2, 0);
    set(name_of(b, "attn.qkv.weight"), 5, c, 3 * c, 0);
    set(name_of(b, "attn.qkv.weight"), 7, c, 3 * c, 0);
    set(name_of(b, "attn.qkv.weight"), (2 * c + 4) * c, 1, c, 0); // row of v
    set(name_of(b, "attn.qkv.bias"), 2 * c + 4, 1, 1, 0);
    set(name_of(b, "attn.proj.weight"), 6, c, c, 0);
    set(name_of(b, "norm2.weight"), 0, 1, c, 0); // all of them
    set(name_of(b, "norm2.bias"), 0, 1, c, 0);
    set(name_of(trunks[0], "norm.weight"), 11, 1, 1, 0); // its offset is alive
    keep_block(b);
    keep_trunk(trunks[0]);
    assert_untouched(b, "attn.qkv.weight", 3, c, 2 * c);
    assert_untouched(b, "norm1.weight", 5, 1, 1);
    assert_untouched(b, "norm1.weight", 7, 1, 1);
    assert_untouched(b, "attn.proj.weight", 4, c, c);
    assert_untouched(b, "attn.qkv.bias", 2 * c + 6, 1, 1);
    assert_untouched(b, "mlp.fc1.weight", 0, 1, 4 * c * c);
    again();
}

/* Extreme channels stay as they are, and the others get the factors that they have without them. */
static void huge_and_tiny_channels(void **state)
{
    (void)state;
    const char *b = blocks[5];
    const size_t c = 32;
    begin();
    set(name_of(b, "norm2.weight"), 2, 1, 1, 0); // the same channels, dead
    set(name_of(b, "norm2.bias"), 2, 1, 1, 0);
    set(name_of(b, "mlp.fc1.weight"), 3, c, 4 * c, 0);
    set(name_of(b, "norm2.weight"), 4, 1, 1, 0);
    set(name_of(b, "norm2.bias"), 4, 1, 1, 0);
    set(name_of(b, "mlp.fc1.weight"), 6, c, 4 * c, 0);
    struct values without = values(b, "norm2.weight");
    again();
    plant.n = 0;
    set(name_of(b, "norm2.weight"), 2, 1, 1, 1e38f);
    set(name_of(b, "mlp.fc1.weight"), 3, c, 4 * c, FLT_MAX);
    set(name_of(b, "norm2.weight"), 4, 1, 1, 1e-42f);
    set(name_of(b, "norm2.bias"), 4, 1, 1, 0);
    set(name_of(b, "mlp.fc1.weight"), 6, c, 4 * c, -1e-42f);
    struct values with = values(b, "norm2.weight");
    for (size_t i = 0; i < c; i++)
        if (i != 2 && i != 4)
            assert_true(with.out[i] == without.out[i]);
    keep_columns(b, "norm2.weight", "mlp.fc1.weight", 0);
    keep_columns(b, "norm2.bias", "mlp.fc1.weight", 0);
    drop(&with);
    drop(&without);
    again();
}

/* ---- errors ---- */

static err_t first_of(const char *name, struct values *v)
{
    struct wanted w = {name, v};
    return table_walk(&tiny_net, pick, &w);
}

/* Whatever read fails, its sentence comes back, nothing is lost and the next try works. */
static void failing_reads(void **state)
{
    (void)state;
    struct values v = {.n = 0};
    static float out[96 * 32];
    begin();
    assert_int_equal(first_of("encoder.aggregator.frame_blocks.0.attn.qkv.weight", &v), OK);
    for (int call = 1; call <= 9; call++) { // itself and the eight of its block
        plant.fail = call;
        assert_int_equal(smooth_fetch(&smooth, &no_run, &v.t, out), ERR_IO);
        assert_string_equal(err_text(), "planted");
        assert_null(smooth.groups);
    }
    plant.fail = 10;
    assert_int_equal(smooth_fetch(&smooth, &no_run, &v.t, out), OK);
    assert_int_equal(plant.fail, 1);
    plant.fail = 0;
    again();
}

/* ---- int8 ---- */

static struct net_dims whole; // small_model_tiny with more channels, see make_dims

enum { VIEWS = 3, SIZE_PX = 42, PIXELS = VIEWS * SIZE_PX * SIZE_PX, FEATURES = 87 * PIXELS };

struct outcome {
    float pose[VIEWS * NET_POSE], log_depth[PIXELS], features[FEATURES];
};

static void smoothed(void *ctx, const struct tensor_spec *t, float *out)
{
    assert_int_equal(smooth_fetch(ctx, &no_run, t, out), OK);
}

static void keep_outcome(const struct prediction *p, struct outcome *out)
{
    memcpy(out->pose, p->geom.pose, sizeof out->pose);
    memcpy(out->features, p->features, sizeof out->features);
    for (int i = 0; i < PIXELS; i++)
        out->log_depth[i] = logf(p->geom.depth[i]);
}

static void run_model(enum precision precision, bool with_smooth, struct outcome *out)
{
    static struct small_model model;
    static uint8_t rgb[3 * PIXELS];
    static float log2t[VIEWS] = {-1, 0, 1};
    struct net net;
    struct kernels kernels;
    struct arena keep, tmp;
    struct pool *pool;
    struct prediction p;
    size_t kept, taken;
    const struct views v = {.n = VIEWS, .size = SIZE_PX, .rgb = rgb, .log2t = log2t};
    smooth = (struct smooth){.dims = &whole, .fetch = fetch};
    small_model_make(&model, &whole, precision, with_smooth ? smoothed : planted, &smooth);
    assert_int_equal(net_bind(&model.model, 0, &net), OK);
    kernels_init(&kernels, cpu_detect());
    struct plan plan = plan_begin(1);
    net_plan(&plan, &net, VIEWS, SIZE_PX);
    kept = plan.keep.peak;
    taken = plan.tmp.peak;
    assert_int_equal(arena_init(&keep, "keep", kept), OK);
    assert_int_equal(arena_init(&tmp, "tmp", taken), OK);
    assert_int_equal(pool_open(&pool, 1), OK);
    for (size_t i = 0; i < sizeof rgb; i++)
        rgb[i] = (uint8_t)(i * 2654435761u >> 24);
    const struct run r = {.k = &kernels, .pool = pool, .keep = &keep, .tmp = &tmp};
    assert_int_equal(net_run(&r, &net, &v, &p), OK);
    keep_outcome(&p, out);
    pool_close(pool);
    arena_free(&keep);
    arena_free(&tmp);
    small_model_free(&model);
    again();
}

static double rel_rms(const float *got, const float *want, size_t n)
{
    double off = 0, all = 0;
    for (size_t i = 0; i < n; i++) {
        off += ((double)got[i] - (double)want[i]) * ((double)got[i] - (double)want[i]);
        all += (double)want[i] * (double)want[i];
    }
    return sqrt(off / all);
}

/* Error of int8 against floats with the same weights: pose, log depth, features. */
static void int8_error(bool with_smooth, double out[3])
{
    static struct outcome want, got;
    run_model(PRECISION_F32, false, &want);
    run_model(PRECISION_S8, with_smooth, &got);
    out[0] = rel_rms(got.pose, want.pose, VIEWS * NET_POSE);
    out[1] = rel_rms(got.log_depth, want.log_depth, PIXELS);
    out[2] = rel_rms(got.features, want.features, FEATURES);
    printf("pose %.4f, log depth %.4f, features %.4f\n", out[0], out[1], out[2]);
}

static void for_all_blocks(void (*change)(const char *prefix))
{
    char prefix[NET_NAME_CAP];
    plant.n = 0;
    for (int i = 0; i < whole.dino_depth; i++) {
        snprintf(prefix, sizeof prefix, "encoder.aggregator.patch_embed.blocks.%d.", i);
        change(prefix);
    }
    for (int i = 0; i < 2 * whole.depth; i++) {
        snprintf(prefix, sizeof prefix, "encoder.aggregator.%s_blocks.%d.",
                 i % 2 ? "global" : "frame", i / 2);
        change(prefix);
    }
}

static void thousandfold(const char *prefix)
{
    plant_block(prefix, (size_t)whole.embed, 1000, 1000);
}

/* Hidden units behind the activation: nothing can be moved there. */
static void hidden(const char *prefix)
{
    size_t c = (size_t)whole.embed;
    for (size_t k = 0; k < 4; k++) {
        add(name_of(prefix, "mlp.fc1.weight"), (11 * k + 5) * c, 1, c, 30);
        add(name_of(prefix, "mlp.fc1.bias"), 11 * k + 5, 1, 1, 30);
        add(name_of(prefix, "mlp.fc2.weight"), 11 * k + 5, 4 * c, c, 1.0f / 30);
    }
}

static void outliers_do_not_harm_int8(void **state)
{
    (void)state;
    double clean[3], bare[3], moved[3];
    begin();
    int8_error(true, clean);
    for_all_blocks(thousandfold);
    int8_error(false, bare);
    int8_error(true, moved);
    for (int i = 0; i < 3; i++)
        assert_true(clean[i] < 0.1 && moved[i] < 3 * clean[i] && bare[i] > 3 * clean[i]);
}

static void hidden_outliers_do_not_harm_int8(void **state)
{
    (void)state;
    double clean[3], spread_out[3];
    begin();
    int8_error(true, clean);
    for_all_blocks(hidden);
    int8_error(true, spread_out);
    for (int i = 0; i < 3; i++)
        assert_true(spread_out[i] < 3 * clean[i]);
}

static int make_dims(void **state)
{
    (void)state;
    whole = small_model_tiny;
    whole.embed = 64;
    whole.dino_depth = 2;
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(these_tensors_and_no_others),
        cmocka_unit_test(the_function_stays),
        cmocka_unit_test(outliers_shrink),
        cmocka_unit_test(outliers_of_trunks_shrink),
        cmocka_unit_test(dead_channels),
        cmocka_unit_test(huge_and_tiny_channels),
        cmocka_unit_test(failing_reads),
        cmocka_unit_test(outliers_do_not_harm_int8),
        cmocka_unit_test(hidden_outliers_do_not_harm_int8),
    };
    return cmocka_run_group_tests(tests, make_dims, NULL);
}
