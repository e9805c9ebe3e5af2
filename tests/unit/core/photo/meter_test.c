/* Metering of simulated scenes: count of exposures against an exact least cover, clipping and
 * signal to noise of the true scene under the plan; scenes and devices at their extremes. */
#include "core/photo/meter.h"

#include "sim/sensor/curve.h"
#include "sim/sensor/sensor.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { EDGE = 64, SAMPLES = EDGE * EDGE, KINDS = 6 };

struct sample_set {
    bool colour;
    float l[SAMPLES][3]; // log2 radiance
};

struct device {
    int bits, black;
    bool linear;
    struct curve curve; // for display values
    double electrons, read_noise;
    enum raw_cfa cfa;
    double time_min, time_max, time_step;
};

static uint16_t pixels[SAMPLES * 4];
static uint64_t shots;

static double uniform(uint64_t seed, uint64_t i, double lo, double hi)
{
    return lo + (hi - lo) * sensor_uniform(seed, i);
}

/* --- a camera ----------------------------------------------------------------------------- */

static uint16_t code_of(const struct device *d, double radiance, double exposure, uint64_t at)
{
    double e = fmin(radiance * exposure, 1e3) * d->electrons;
    if (e < 4.0 * d->electrons)
        e = sensor_poisson(shots, 2 * at, e) + d->read_noise * sensor_normal(~shots, 2 * at + 1);
    double x = fmin(e / d->electrons, 1.0), full = exp2(d->bits) - 1.0;
    double code = d->linear ? d->black + x * (full - d->black)
                            : full * (double)curve_display(&d->curve, (float)x);
    return (uint16_t)lrint(fmin(fmax(code, 0.0), full));
}

static void photograph(const struct device *d, const struct sample_set *s, double exposure,
                       struct raw *out)
{
    static const int colour[4][4] = {{0, 1, 1, 2}, {2, 1, 1, 0}, {1, 0, 2, 1}, {1, 2, 0, 1}};
    *out = (struct raw){EDGE, EDGE, d->cfa, d->bits, d->black, d->linear, pixels};
    int n = d->cfa == RAW_MONO ? 1 : d->cfa == RAW_RGB ? 3 : 4;
    bool mosaic = n == 4;
    if (mosaic)
        out->w = out->h = 2 * EDGE;
    shots++;
    for (int p = 0; p < SAMPLES; p++)
        for (int k = 0; k < n; k++) {
            int c = mosaic ? colour[d->cfa - RAW_RGGB][k] : n == 1 ? 1 : k;
            size_t at = mosaic
                            ? (size_t)(2 * (p / EDGE) + k / 2) * 2 * EDGE + 2 * (p % EDGE) + k % 2
                            : (size_t)(p * n + k);
            pixels[at] = code_of(d, exp2(s->l[p][c]), exposure, (uint64_t)(p * n + k));
        }
}

static void config_of(const struct device *d, struct meter_config *out)
{
    struct raw kind = {EDGE, EDGE, d->cfa, d->bits, d->black, d->linear, NULL};
    meter_defaults(&kind, d->time_min, d->time_max, d->time_step, out);
    double step = d->electrons / (exp2(d->bits) - 1.0 - d->black);
    out->electrons = d->electrons;
    out->read_noise = sqrt(d->read_noise * d->read_noise + (d->linear ? step * step / 12.0 : 0.0));
}

static void table_of(const struct device *d, struct crf *out)
{
    for (int c = 0; c < 3; c++)
        for (int z = 0; z < 256; z++)
            out->log2x[c][z] = log2f(fmaxf(curve_exposure(&d->curve, (float)z / 255.0f), 1e-7f));
}

static void meter(const struct device *d, const struct meter_config *cfg,
                  const struct sample_set *s, struct meter *m, struct meter_result *out)
{
    struct raw px;
    struct crf crf;
    table_of(d, &crf);
    assert_int_equal(meter_begin(cfg, m), OK);
    for (int i = 0;; i++) {
        double probe = meter_probe(m);
        if (!(probe > 0.0))
            break;
        assert_in_range(i, 0, 2);
        assert_int_equal(meter_choose(m, out), ERR_AGAIN);
        photograph(d, s, probe, &px);
        meter_add(m, &px, d->linear ? NULL : &crf, probe);
    }
    assert_int_equal(meter_choose(m, out), OK);
}

/* --- truth -------------------------------------------------------------------------------- */

struct limits {
    double lo, hi; // log2 of relative exposure
};

static struct limits limits_of(const struct device *d, const struct meter_config *c)
{
    double need = 0.5 * (c->snr * c->snr +
                         c->snr * sqrt(c->snr * c->snr + 4.0 * c->read_noise * c->read_noise));
    struct limits l = {log2(need / c->electrons), log2(c->headroom)};
    struct crf crf;
    table_of(d, &crf);
    if (!d->linear) {
        l.lo = fmax(l.lo, (double)crf.log2x[1][8]);
        l.hi = fmin(l.hi, (double)crf.log2x[1][245]);
    }
    return l;
}

static int compare_descending(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x < y) - (x > y);
}

/* Samples by their strongest or weakest channel, brightest first. */
static void sorted(const struct sample_set *s, bool strongest, float *v)
{
    for (int p = 0; p < SAMPLES; p++) {
        const float *l = s->l[p];
        v[p] = !s->colour  ? l[1]
               : strongest ? fmaxf(fmaxf(l[0], l[1]), l[2])
                           : fminf(fminf(l[0], l[1]), l[2]);
    }
    qsort(v, SAMPLES, sizeof *v, compare_descending);
}

/* The fewest exposures: the first may clip `clip`, all together may leave `dark`; each covers from
 * a sample on what is up to hi - lo stops darker. 99: impossible. Exact: beginning anywhere else
 * than at a sample covers no more. */
static int optimum(const float *v, const struct limits *r, const struct meter_config *c, double top)
{
    static int left[METER_EXPOSURES_MAX + 1][SAMPLES + 1];
    float dim = (float)(r->hi - log2(c->time_max_s)), bright = (float)(r->hi - log2(c->time_min_s));
    int may = (int)(c->dark * SAMPLES), allowed = (int)(c->clip * SAMPLES), over = 0;
    while (over < SAMPLES && (float)top > bright && v[over] > bright)
        over++;
    if (over > allowed)
        return 99;
    for (int k = 0; k <= METER_EXPOSURES_MAX; k++) {
        int end = SAMPLES;
        left[k][SAMPLES] = 0;
        for (int i = SAMPLES - 1; i >= 0; i--) {
            float low = fmaxf(v[i], dim) - (float)(r->hi - r->lo);
            while (end > 0 && v[end - 1] < low)
                end--;
            int leave = 1 + left[k][i + 1];
            left[k][i] = k == 0 ? leave : v[i] > bright ? leave : left[k - 1][end > i ? end : i];
            if (leave < left[k][i])
                left[k][i] = leave;
        }
    }
    /* The brightest that must not be clipped: where the first exposure begins at the darkest. */
    float begin = fmaxf(fminf((float)top, bright), dim);
    float low = begin - (float)(r->hi - r->lo);
    int first = 0, n = SAMPLES;
    while (first < SAMPLES && v[first] > begin)
        first++;
    for (n = first; n < SAMPLES && v[n] >= low; n++)
        ;
    for (int k = 0; k < METER_EXPOSURES_MAX; k++)
        if (left[k][n] <= may)
            return k + 1;
    return 99;
}

/* Lower bound for scenes in colour, exact for grey ones. */
static int fewest(const struct sample_set *s, const struct device *d, const struct meter_config *c)
{
    static float v[SAMPLES];
    struct limits r = limits_of(d, c);
    sorted(s, true, v);
    double top = v[(int)(c->clip * SAMPLES)];
    int a = optimum(v, &r, c, top);
    sorted(s, false, v);
    int b = optimum(v, &r, c, top);
    return a > b ? a : b;
}

struct truth {
    double clipped, dark, snr; // shares; ratio that all but `dark` of the config reach
};

static double merged(const struct meter_config *c, const struct limits *r, double l,
                     const struct meter_result *p)
{
    double s = 0.0;
    for (int i = 0; i < p->n; i++) {
        double x = exp2(l) * p->time_s[i], e = x * c->electrons;
        if (log2(x) <= r->hi + 1e-6)
            s += e * e / (e + c->read_noise * c->read_noise);
    }
    return sqrt(s);
}

/* True coverage by the plan: samples are clipped if the shortest exposure saturates. */
static void check_true_cover(const struct sample_set *s, const struct device *d,
                             const struct meter_config *c, const struct meter_result *p,
                             struct truth *out)
{
    static float v[SAMPLES], snr[SAMPLES];
    struct limits r = {.hi = log2(0.97)}; // headroom is for errors of metering
    if (!d->linear)
        r.hi = fmin(r.hi, log2((double)curve_exposure(&d->curve, 252.0f / 255.0f)));
    memset(out, 0, sizeof *out);
    sorted(s, true, v);
    for (int i = 0; i < SAMPLES; i++)
        out->clipped += exp2(v[i]) * p->time_s[0] >= 1.0;
    out->clipped /= SAMPLES;
    out->snr = INFINITY;
    for (int end = 0; end < 2; end++) {
        double dark = 0.0;
        int n = 0;
        sorted(s, end == 0, v);
        for (int i = 0; i < SAMPLES; i++)
            if (exp2(v[i]) * p->time_s[0] <= exp2(r.hi)) {
                snr[n] = (float)merged(c, &r, v[i], p);
                dark += snr[n++] < c->snr;
            }
        qsort(snr, (size_t)n, sizeof *snr, compare_descending);
        int at = n - 1 - (int)(c->dark * SAMPLES);
        out->snr = fmin(out->snr, at >= 0 ? snr[at] : INFINITY);
        out->dark = fmax(out->dark, dark / SAMPLES);
    }
}

/* --- random scenes ------------------------------------------------------------------------ */

/* Height above the darkest, 0..range, of a sample. */
static double sample_stops(int kind, double range, uint64_t seed, uint64_t p)
{
    double u = sensor_uniform(seed ^ 0x5555, p), w = sensor_normal(seed ^ 0xAAAA, p);
    double a = sensor_uniform(seed, 10), b = sensor_uniform(seed, 11);
    switch (kind) {
    case 0:
        return range * u;
    case 1: // two lumps
        return (u < 0.1 + 0.8 * a ? 0.2 : 0.6 + 0.3 * b) * range + w * range * 0.05;
    case 2: { // lumps of any width
        int k = (int)(u * 5);
        double mid = sensor_uniform(seed, 20 + (uint64_t)k),
               wide = sensor_uniform(seed, 30 + (uint64_t)k);
        return range *
               fmin(fmax(mid + 0.15 * wide * (sensor_uniform(seed ^ 77, p) - 0.5), 0.0), 1.0);
    }
    case 3: // dark room and window, nothing between
        return u < 0.03 + 0.4 * a ? range * (1.0 - 0.15 * sensor_uniform(seed ^ 77, p))
                                  : range * (0.1 + 0.25 * b) * sensor_uniform(seed ^ 78, p);
    case 4: // sun
        return u < 0.0002 + 0.005 * a * a ? range : range * 0.6 * sensor_uniform(seed ^ 77, p);
    default: // natural: many greys, few lights
        return range * fmin(fmax(0.35 + 0.15 * w, 0.0), 1.0) + (u < 0.01 ? range * 0.5 * b : 0.0);
    }
}

static void make_scene(uint64_t seed, double range, double darkest, struct sample_set *s)
{
    int kind = (int)uniform(seed, 1, 0, KINDS);
    s->colour = sensor_uniform(seed, 2) < 0.3;
    for (uint64_t p = 0; p < SAMPLES; p++) {
        double l = darkest + sample_stops(kind, range, seed, p);
        for (uint64_t c = 0; c < 3; c++)
            s->l[p][c] = (float)(l - (s->colour ? uniform(seed ^ 99, 3 * p + c, 0.0, 2.0) : 0.0));
    }
}

static void make_device(uint64_t seed, const struct sample_set *s, struct device *d)
{
    int kind = (int)uniform(seed, 3, 0, 4);
    memset(d, 0, sizeof *d);
    d->linear = kind < 2;
    d->bits = kind == 0 ? 12 : kind == 1 ? 10 : 8;
    d->black = kind == 0 ? 256 : kind == 1 ? 64 : 0;
    d->electrons = kind == 0 ? 8000.0 : 6000.0;
    d->read_noise = 2.5;
    d->cfa = !s->colour ? RAW_MONO : d->linear ? RAW_RGGB + (enum raw_cfa)(seed % 4) : RAW_RGB;
    d->time_min = 1e-5;
    d->time_max = 60.0;
    d->time_step = kind == 0 ? 1.5e-5 : kind == 1 ? 0.0 : 1e-5;
    if (kind == 3)
        curve_draw(seed, &d->curve);
    else
        curve_make(CURVE_SRGB, 0.0f, 0, &d->curve);
}

struct count {
    int scenes, beyond, timid, over[2], probes, members, reused;
    double least_snr, most_clipped, most_dark;
};

static void check_plan(const struct meter *m, const struct meter_result *p)
{
    const struct meter_config *c = &m->cfg;
    double total = 0.0;
    assert_in_range(p->n, 1, c->exposures_max);
    for (int i = 0; i < p->n; i++) {
        double steps = c->time_step_s > 0.0 ? (p->time_s[i] - c->time_min_s) / c->time_step_s : 0.0;
        assert_true(i == 0 || p->time_s[i] > p->time_s[i - 1]);
        assert_true(p->time_s[i] >= c->time_min_s && p->time_s[i] <= c->time_max_s);
        assert_true(fabs(steps - round(steps)) < 1e-4 || p->time_s[i] == c->time_max_s);
        assert_true(p->probe[i] >= -1 && p->probe[i] < m->probes);
        assert_true(p->probe[i] < 0 || fabs(m->probe_s[p->probe[i]] / p->time_s[i] - 1.0) < 1e-5);
        total += p->time_s[i];
    }
    assert_true(c->budget_s == 0.0 || total <= c->budget_s * (1.0 + 1e-6));
    assert_true(c->blur_s == 0.0 || p->time_s[p->n - 1] <= c->blur_s);
    assert_true(isfinite(p->snr) && isfinite(p->stops) && p->stops >= 0.0);
    assert_true(p->clipped >= 0.0 && p->clipped <= 1.0 + 1e-6 && p->dark >= 0.0 &&
                p->dark <= 1.0 + 1e-6);
}

static void random_scene(uint64_t seed, struct count *n)
{
    static struct sample_set s;
    static struct meter m;
    double range = uniform(seed, 0, 2.0, 20.0);
    struct device d;
    struct meter_config c;
    struct meter_result p;
    struct truth t;
    make_scene(seed, range, uniform(seed, 4, -12.0, 15.0 - range), &s);
    make_device(seed, &s, &d);
    config_of(&d, &c);
    meter(&d, &c, &s, &m, &p);
    check_plan(&m, &p);
    check_true_cover(&s, &d, &c, &p, &t);
    int best = fewest(&s, &d, &c);
    n->scenes++;
    n->probes += m.probes;
    n->members += p.n;
    for (int k = 0; k < p.n; k++)
        n->reused += p.probe[k] >= 0;
    if (best == 99) { // only frames added up may reach it
        n->beyond++;
        assert_true(p.too_dark || p.too_bright || (t.dark <= c.dark && t.clipped <= c.clip));
        return;
    }
    n->timid += p.too_dark || p.too_bright;
    assert_true(p.n <= best + 1);
    assert_true(t.snr >= c.snr && t.clipped <= c.clip);
    n->over[p.n > best]++;
    n->least_snr = fmin(n->least_snr, t.snr / c.snr);
    n->most_clipped = fmax(n->most_clipped, t.clipped);
    n->most_dark = fmax(n->most_dark, t.dark);
}

static void test_random(void **state)
{
    struct count n = {.least_snr = INFINITY};
    (void)state;
    for (uint64_t i = 0; i < 1000; i++)
        random_scene(1000 + i, &n);
    printf("%d scenes, %d beyond the device; as few exposures as can be: %d, one more: %d; said to "
           "exceed the device and do not: %d\n",
           n.scenes, n.beyond, n.over[0], n.over[1], n.timid);
    printf("least SNR %.3f of what was asked, most clipped %.4f, dark %.4f; exposures %.2f, probes "
           "%.2f, of these reused %.2f\n",
           n.least_snr, n.most_clipped, n.most_dark, (double)n.members / n.scenes,
           (double)n.probes / n.scenes, (double)n.reused / n.scenes);
    assert_true(n.beyond < 100 && n.timid <= 2 && n.over[1] <= 120);
}

/* --- figures of core/photo/README.md 4 ----------------------------------------------------- */

static const struct device imx477 = {.bits = 12,
                                     .black = 256,
                                     .linear = true,
                                     .electrons = 8000.0,
                                     .read_noise = 2.5,
                                     .cfa = RAW_MONO,
                                     .time_min = 1e-5,
                                     .time_max = 60.0};

static void test_usable_range(void **state)
{
    static const struct {
        double electrons, noise, stops[3];
    } model[] = {{6000, 3.45, {7.8, 5.6, 3.7}},
                 {8000, 2.5, {8.4, 6.1, 4.2}},
                 {14000, 3, {9.1, 6.9, 4.9}},
                 {6000, 7.43, {7.1, 5.3, 3.6}}};
    (void)state;
    for (size_t i = 0; i < 4; i++)
        for (int k = 0; k < 3; k++) {
            static struct meter m;
            struct meter_config c;
            config_of(&imx477, &c);
            c.electrons = model[i].electrons;
            c.read_noise = model[i].noise;
            c.snr = k == 0 ? 4.0 : k == 1 ? 10.0 : 20.0;
            assert_int_equal(meter_begin(&c, &m), OK);
            assert_true(fabs(m.hi - m.lo - model[i].stops[k]) < 0.06);
        }
    struct raw eight = {8, 8, RAW_MONO, 8, 0, true, NULL};
    struct meter_config c;
    meter_defaults(&eight, 1e-5, 1.0, 0.0, &c);
    assert_true(fabs(c.read_noise - 7.43) < 0.1); // 3 e- and the steps of 8 bits
}

/* An even scene from bright to dark: the greedy count. */
static void even_scene(double brightest, double range, struct sample_set *s)
{
    s->colour = false;
    for (int p = 0; p < SAMPLES; p++)
        for (int c = 0; c < 3; c++)
            s->l[p][c] = (float)(brightest - range * p / (SAMPLES - 1));
}

static void test_counts(void **state)
{
    static const int n[] = {2, 2, 2, 3, 3, 3, 4}; // 8..20 stops; at 12 and 18 two and three just do
    static struct sample_set s;
    static struct meter m;
    (void)state;
    for (int i = 0; i < 7; i++) {
        struct meter_config c;
        struct meter_result p;
        config_of(&imx477, &c);
        even_scene(12.0, 8.0 + 2.0 * i, &s);
        meter(&imx477, &c, &s, &m, &p);
        check_plan(&m, &p);
        assert_in_range(p.n, n[i], n[i] + (i == 2 || i == 5));
        assert_true(fabs(p.stops - 8.0 - 2.0 * i) < 0.6 && p.snr >= 10.0);
        assert_true(!p.too_bright && !p.too_dark);
    }
}

/* --- extremes ----------------------------------------------------------------------------- */

static void plan(const struct device *d, const struct meter_config *c, const struct sample_set *s,
                 struct meter_result *p)
{
    static struct meter m;
    meter(d, c, s, &m, p);
    check_plan(&m, p);
}

static void test_24_stops(void **state)
{
    static struct sample_set s;
    struct device d = imx477;
    struct meter_config c;
    struct meter_result p;
    (void)state;
    even_scene(16.0, 24.0, &s); // within 1e-5 .. 60 s
    config_of(&d, &c);
    plan(&d, &c, &s, &p);
    assert_in_range(p.n, 4, 5);
    assert_true(!p.too_bright && !p.too_dark && p.stops > 23.0);
    d.time_min = 1e-4;
    d.time_max = 0.1;
    config_of(&d, &c);
    plan(&d, &c, &s, &p);
    assert_true(p.too_bright && p.too_dark);
    assert_true(p.n >= 2 && p.n <= 3 && p.time_s[0] == 1e-4 && p.time_s[p.n - 1] > 0.06);
    assert_true(fabs(p.clipped - 2.86 / 24.0) < 0.02 && fabs(p.dark - 5.3 / 24.0) < 0.03);
}

static void test_nothing_to_see(void **state)
{
    static struct sample_set s;
    struct meter_config c;
    struct meter_result p;
    (void)state;
    config_of(&imx477, &c);
    even_scene(-60.0, 0.0, &s);
    plan(&imx477, &c, &s, &p);
    assert_true(p.n == 1 && p.time_s[0] == 60.0 && p.probe[0] >= 0);
    assert_true(p.too_dark && !p.too_bright && p.dark == 1.0 && p.snr < 10.0);
    even_scene(40.0, 0.0, &s);
    plan(&imx477, &c, &s, &p);
    assert_true(p.n == 1 && p.time_s[0] == 1e-5 && p.probe[0] >= 0);
    assert_true(p.too_bright && !p.too_dark && p.clipped == 1.0 && p.dark == 0.0);
    even_scene(0.0, 0.0, &s); // one grey: one exposure, nearly full
    plan(&imx477, &c, &s, &p);
    assert_true(p.n == 1 && !p.too_bright && !p.too_dark && p.snr > 30.0 && p.stops <= 1.0);
}

static void test_times(void **state)
{
    static struct sample_set s;
    struct device d = imx477;
    struct meter_config c;
    struct meter_result p;
    (void)state;
    even_scene(4.0, 12.0, &s);
    d.time_min = d.time_max = 0.01; // one value
    config_of(&d, &c);
    plan(&d, &c, &s, &p);
    assert_true(p.n == 1 && p.time_s[0] == 0.01 && p.probe[0] == 0 && p.too_dark);
    d = imx477;
    d.time_min = 1e-4;
    d.time_step = 10.0; // 0.1 ms, 10 s, 20 s ..
    config_of(&d, &c);
    plan(&d, &c, &s, &p);
    assert_true(!p.too_bright && p.too_dark);
    d.time_step = 1e-3; // larger than the shortest time
    config_of(&d, &c);
    plan(&d, &c, &s, &p);
    assert_true(p.n <= 3 && !p.too_bright && !p.too_dark);
    d.time_step = 1e6;
    config_of(&d, &c);
    c.time_step_s = 1e4;
    plan(&d, &c, &s, &p);
    assert_true(p.n == 1 && p.time_s[0] == 1e-4);
}

static void test_limits(void **state)
{
    static struct sample_set s;
    struct meter_config c;
    struct meter_result free_plan, p;
    (void)state;
    even_scene(4.0, 16.0, &s);
    config_of(&imx477, &c);
    plan(&imx477, &c, &s, &free_plan);
    double longest = free_plan.time_s[free_plan.n - 1];
    assert_true(free_plan.n == 3 && !free_plan.too_dark && longest > 10.0);
    c.blur_s = 1.0;
    plan(&imx477, &c, &s, &p);
    assert_true(p.too_dark && !p.too_bright && p.time_s[p.n - 1] > 0.8);
    c.blur_s = 0.0;
    c.budget_s = 2.0;
    plan(&imx477, &c, &s, &p);
    assert_true(p.too_dark && p.time_s[p.n - 1] > 1.5);
    c.budget_s = 0.0;
    c.exposures_max = 2;
    plan(&imx477, &c, &s, &p);
    assert_true(p.n == 2 && p.too_dark + p.too_bright > 0);
    assert_true(p.clipped + p.dark < 1.0 - 2.0 * 5.7 / 16.0); // two of 6.1 stops each
}

/* One exposure for a dark room with a small window goes to the room. */
static void test_one_of_two(void **state)
{
    static struct sample_set s;
    struct meter_config c;
    struct meter_result p;
    (void)state;
    even_scene(-6.0, 3.0, &s);
    for (int i = 0; i < SAMPLES / 20; i++)
        s.l[i * 20][1] = 15.8f;
    config_of(&imx477, &c);
    plan(&imx477, &c, &s, &p);
    assert_true(p.n == 2 && !p.too_bright && !p.too_dark);
    c.exposures_max = 1;
    plan(&imx477, &c, &s, &p);
    assert_true(p.n == 1 && p.too_bright && !p.too_dark && fabs(p.clipped - 0.05) < 0.002);
    assert_true(p.time_s[0] > 10.0);
}

/* Samples are spread over large frames, whatever their kind. */
static void test_large_frame(void **state)
{
    enum { W = 1030, H = 514 };
    static struct meter m;
    struct meter_config c;
    struct device d = imx477;
    (void)state;
    uint16_t *px = malloc(sizeof *px * W * H * 3);
    assert_non_null(px);
    for (int cfa = RAW_MONO; cfa <= RAW_GBRG; cfa++) {
        int n = cfa == RAW_RGB ? 3 : 1;
        for (int i = 0; i < W * H * n; i++)
            px[i] = (uint16_t)(i / n / W < H / 4 ? 256 + 3000 : 256 + 600);
        struct raw frame = {W, H, (enum raw_cfa)cfa, 12, 256, true, px};
        config_of(&d, &c);
        assert_int_equal(meter_begin(&c, &m), OK);
        meter_add(&m, &frame, NULL, 0.01);
        double bright = 0.0, all = 0.0;
        for (int b = 0; b < METER_BINS; b++) {
            all += m.bottom[b];
            if (m.bin_lo + (double)b / METER_PER_STOP > log2(1000.0 / 3839.0 / 0.01))
                bright += m.bottom[b];
        }
        assert_true(fabs(all - 1.0) < 1e-4 && fabs(bright - 0.25) < 0.01);
    }
    free(px);
}

static void test_bad_config(void **state)
{
    static struct meter m;
    const struct {
        size_t field;
        double value;
        const char *says;
    } bad[] = {
        {offsetof(struct meter_config, snr), -1.0, "snr is -1"},
        {offsetof(struct meter_config, snr), NAN, "snr is"},
        {offsetof(struct meter_config, snr), 900.0, "electrons"},
        {offsetof(struct meter_config, clip), 0.6, "clip is 0.6"},
        {offsetof(struct meter_config, dark), -0.1, "dark is -0.1"},
        {offsetof(struct meter_config, headroom), 1.5, "headroom is 1.5"},
        {offsetof(struct meter_config, overlap), 11.0, "overlap is 11"},
        {offsetof(struct meter_config, time_min_s), 0.0, "time_min_s is 0"},
        {offsetof(struct meter_config, time_max_s), 1e-6, "time_max_s is 1e-06"},
        {offsetof(struct meter_config, time_step_s), -1.0, "time_step_s is -1"},
        {offsetof(struct meter_config, blur_s), 1e-6, "blur_s is 1e-06"},
        {offsetof(struct meter_config, budget_s), 1e-6, "budget_s is 1e-06"},
    };
    (void)state;
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        struct meter_config c;
        config_of(&imx477, &c);
        memcpy((char *)&c + bad[i].field, &bad[i].value, sizeof bad[i].value);
        assert_int_equal(meter_begin(&c, &m), ERR_ARG);
        if (strstr(err_text(), bad[i].says) == NULL)
            fail_msg("no \"%s\" in \"%s\"", bad[i].says, err_text());
    }
    struct meter_config c;
    config_of(&imx477, &c);
    c.exposures_max = 10;
    assert_int_equal(meter_begin(&c, &m), ERR_ARG);
    assert_non_null(strstr(err_text(), "exposures_max is 10"));
    struct meter_config empty = {.time_min_s = 1e-4, .time_max_s = 1.0};
    assert_int_equal(meter_begin(&empty, &m), OK);
    assert_true(m.cfg.snr == 10.0 && m.cfg.electrons > 0.0 && m.cfg.exposures_max == 9);
}

/* --- coverage afterwards ------------------------------------------------------------------ */

static void check_coverage(const struct device *d, const struct sample_set *s, const double *times,
                           int n, struct meter_coverage *out)
{
    static uint16_t kept[METER_EXPOSURES_MAX][SAMPLES * 4];
    struct raw frames[METER_EXPOSURES_MAX];
    struct meter_config c;
    struct crf crf;
    table_of(d, &crf);
    config_of(d, &c);
    for (int i = 0; i < n; i++) {
        photograph(d, s, times[i], &frames[i]);
        memcpy(kept[i], pixels, sizeof kept[i]);
        frames[i].px = kept[i];
    }
    meter_check(&c, frames, n, d->linear ? NULL : &crf, times, out);
}

static void test_coverage(void **state)
{
    static struct sample_set s;
    struct device d = imx477;
    struct meter_config c;
    struct meter_result p;
    struct meter_coverage v, w;
    double times[METER_EXPOSURES_MAX];
    (void)state;
    for (int kind = 0; kind < 3; kind++) {
        d.cfa = kind == 0 ? RAW_MONO : kind == 1 ? RAW_GBRG : RAW_RGB;
        d.linear = kind != 2;
        d.bits = kind == 2 ? 8 : 12;
        d.black = kind == 2 ? 0 : 256;
        curve_make(CURVE_SRGB, 0.0f, 0, &d.curve);
        even_scene(6.0, 15.0, &s);
        config_of(&d, &c);
        plan(&d, &c, &s, &p);
        assert_true(p.n >= 3);
        check_coverage(&d, &s, p.time_s, p.n, &v); // as planned
        assert_true(v.clipped <= c.clip && v.dark <= c.dark && v.extend_s == 0.0);
        check_coverage(&d, &s, p.time_s, p.n - 1, &v); // without the longest
        assert_true(v.dark > 0.1 && v.extend_s > p.time_s[p.n - 2]);
        memcpy(times, p.time_s, sizeof times);
        times[p.n - 1] = v.extend_s;
        check_coverage(&d, &s, times, p.n, &w);
        assert_true(w.dark < 0.3 * v.dark);
        check_coverage(&d, &s, p.time_s + 1, p.n - 1, &v); // without the shortest
        assert_true(v.clipped > 0.1 && v.extend_s > 0.0 && v.extend_s < p.time_s[1]);
        times[0] = p.time_s[0];
        times[1] = p.time_s[2];
        check_coverage(&d, &s, times, 2, &v); // without one between
        assert_true(v.dark > 0.1 && v.extend_s > times[0] && v.extend_s < times[1]);
    }
    even_scene(-60.0, 0.0, &s);
    times[0] = 0.1;
    d = imx477;
    d.read_noise = 0.0; // no code tells anything
    check_coverage(&d, &s, times, 1, &v);
    assert_true(v.dark == 1.0 && v.extend_s > 0.1);
    times[0] = 60.0;
    check_coverage(&imx477, &s, times, 1, &v);
    assert_true(v.dark == 1.0 && v.extend_s == 0.0);
    even_scene(40.0, 0.0, &s);
    times[0] = 1e-5;
    check_coverage(&imx477, &s, times, 1, &v);
    assert_true(v.clipped == 1.0 && v.extend_s == 0.0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_usable_range), cmocka_unit_test(test_counts),
        cmocka_unit_test(test_24_stops),     cmocka_unit_test(test_nothing_to_see),
        cmocka_unit_test(test_times),        cmocka_unit_test(test_limits),
        cmocka_unit_test(test_one_of_two),   cmocka_unit_test(test_large_frame),
        cmocka_unit_test(test_bad_config),   cmocka_unit_test(test_coverage),
        cmocka_unit_test(test_random),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
