/* Noise: e electrons have the variance e + read_noise^2 (EMVA 1288), so a ratio S needs
 * e = (S^2 + S sqrt(S^2 + 4 read_noise^2)) / 2; independent frames add the squares of their ratios.
 * Histogram: each bin comes from the longest probe that has it unclipped. The part that a longer
 * probe clips is the part that the shorter one shows above its border; where noise lifts more
 * samples over that border, the brightest count.
 * Probes: the first is in the middle of the range of times. The next are shorter by the range of
 * one probe while too much is clipped, longer while too much is too dark to be seen. Then
 * coverage.c plans.
 * Source: EMVA 1288 release 4 (noise). */
#include "core/photo/meter.h"

#include "core/photo/coverage.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

enum {
    PROBES = 3,
    SAMPLES = 65536,        // sampled in a frame at most
    ABOVE = METER_PER_STOP, // bins kept for what the shortest exposure clips
    CODE_LO = 8,            // usable display codes (core/photo/README.md 4.2)
    CODE_HI = 245,          //
    CODE_SEEN = 3,          // least display code above black
    EXPOSURES = METER_EXPOSURES_MAX
};
#define SEEN_SNR 3.0      // least ratio at which a pixel of a probe is placed in the histogram
#define FIRST_MAX_S 1.0   // the first probe is in the middle of the range of times up to here
#define TOP_SIGMAS 1.0    // standard deviations added to a sample at the bright end,
#define BOTTOM_SIGMAS 0.7 // and subtracted at the dark end
#define CHECK_SHARE 0.9   // part of snr that is enough afterwards: one sample adds its noise
#define SLIGHT 1e-9       // rounding of shares

/* --- configuration -------------------------------------------------------------------------- */

static double electrons_for(double snr, double noise)
{
    return 0.5 * (snr * snr + snr * sqrt(snr * snr + 4.0 * noise * noise));
}

static void fill_defaults(struct meter_config *c, int bits, int black)
{
    double range = exp2(bits) - 1.0 - black;
    if (!(c->electrons > 0.0))
        c->electrons = bits >= 12 ? 8000.0 : 6000.0;
    if (!(c->read_noise > 0.0)) // 3 e- and a step of the converter, as common sensors have
        c->read_noise = sqrt(9.0 + c->electrons * c->electrons / (12.0 * range * range));
    c->snr = c->snr != 0.0 ? c->snr : 10.0;
    c->clip = c->clip != 0.0 ? c->clip : 0.001;
    c->dark = c->dark != 0.0 ? c->dark : 0.01;
    c->headroom = c->headroom != 0.0 ? c->headroom : c->display ? 0.85 : 0.9;
    c->overlap = c->overlap != 0.0 ? c->overlap : 0.5;
    c->exposures_max = c->exposures_max != 0 ? c->exposures_max : EXPOSURES;
}

void meter_defaults(const struct raw *kind, double time_min_s, double time_max_s,
                    double time_step_s, struct meter_config *out)
{
    memset(out, 0, sizeof *out);
    out->time_min_s = time_min_s;
    out->time_max_s = time_max_s;
    out->time_step_s = time_step_s;
    out->display = !kind->linear;
    fill_defaults(out, kind->bits, kind->linear ? kind->black : 0);
}

static err_t check_config(const struct meter_config *c)
{
    const struct {
        const char *name;
        double value, lo, hi;
    } field[] = {
        {"electrons", c->electrons, 10.0, 1e7},
        {"read_noise", c->read_noise, 0.0, 1e4},
        {"snr", c->snr, 0.1, 1e3},
        {"clip", c->clip, 0.0, 0.5},
        {"dark", c->dark, 0.0, 0.5},
        {"headroom", c->headroom, 0.1, 1.0},
        {"overlap", c->overlap, 0.0, 10.0},
        {"time_min_s", c->time_min_s, 1e-7, 1e4},
        {"time_max_s", c->time_max_s, c->time_min_s, 1e4},
        {"time_step_s", c->time_step_s, 0.0, 1e4},
        {"blur_s", c->blur_s > 0.0 ? c->blur_s : c->time_min_s, c->time_min_s, INFINITY},
        {"budget_s", c->budget_s > 0.0 ? c->budget_s : c->time_min_s, c->time_min_s, INFINITY},
        {"exposures_max", c->exposures_max, 1, EXPOSURES}};
    for (size_t i = 0; i < sizeof field / sizeof field[0]; i++)
        if (!(field[i].value >= field[i].lo && field[i].value <= field[i].hi))
            return err_fail(ERR_ARG, "metering: %s is %g, must be %g..%g", field[i].name,
                            field[i].value, field[i].lo, field[i].hi);
    double need = electrons_for(c->snr, c->read_noise), have = c->headroom * c->electrons;
    if (2.0 * need > have)
        return err_fail(ERR_ARG,
                        "metering: snr %g needs %.0f electrons, at most half of the %.0f that the "
                        "sensor holds below its headroom",
                        c->snr, need, have);
    return OK;
}

/* Usable range in relative exposure, and the origin of the bins: the upper limit of the shortest
 * exposure is an edge. */
static void set_limits(struct meter *m, const struct crf *crf)
{
    const struct meter_config *c = &m->cfg;
    struct crf srgb;
    m->hi = log2(c->headroom);
    m->lo = log2(electrons_for(c->snr, c->read_noise) / c->electrons);
    m->floor = log2(electrons_for(SEEN_SNR, c->read_noise) / c->electrons);
    crf_srgb(&srgb);
    const struct crf *use = crf != NULL ? crf : &srgb;
    for (int i = 0; c->display && i < 3; i++) {
        m->hi = fmin(m->hi, use->log2x[i][CODE_HI]);
        m->lo = fmax(m->lo, use->log2x[i][CODE_LO]);
        m->floor = fmax(m->floor, use->log2x[i][CODE_SEEN]);
    }
    m->lo = fmin(m->lo, m->hi - 1.0);
    m->floor = fmin(m->floor, m->lo);
    m->bin_lo = m->hi - log2(c->time_min_s) - (double)(METER_BINS - ABOVE) / METER_PER_STOP;
}

err_t meter_begin(const struct meter_config *cfg, struct meter *m)
{
    memset(m, 0, sizeof *m);
    m->cfg = *cfg;
    fill_defaults(&m->cfg, cfg->display ? 8 : 12, 0);
    err_t e = check_config(&m->cfg);
    if (e == OK)
        set_limits(m, NULL);
    return e;
}

/* --- pixels --------------------------------------------------------------------------------- */

struct sampler {
    const struct raw *px;
    bool mosaic;
    int stride, w, h; // px between samples; samples
    float scale;
    float x[3][256]; // by display code
};

static void sampler_init(const struct raw *px, const struct crf *crf, struct sampler *s)
{
    struct crf srgb;
    if (!px->linear && crf == NULL) {
        crf_srgb(&srgb);
        crf = &srgb;
    }
    s->px = px;
    s->mosaic = px->cfa != RAW_MONO && px->cfa != RAW_RGB;
    int cell = s->mosaic ? 2 : 1, w = px->w / cell, h = px->h / cell, skip = 1;
    while ((long)((w + skip - 1) / skip) * ((h + skip - 1) / skip) > SAMPLES)
        skip++;
    s->w = (w + skip - 1) / skip;
    s->h = (h + skip - 1) / skip;
    s->stride = cell * skip;
    s->scale = 1.0f / (float)((1 << px->bits) - 1 - px->black);
    for (int c = 0; !px->linear && c < 3; c++)
        for (int z = 0; z < 256; z++)
            s->x[c][z] = exp2f(crf->log2x[c][z]);
}

static float relative_exposure(const struct sampler *s, size_t at, int channel)
{
    int code = s->px->px[at];
    if (s->px->linear)
        return (float)(code - s->px->black) * s->scale;
    int z = s->px->bits > 8 ? code >> (s->px->bits - 8) : code;
    return s->x[channel][z < 255 ? z : 255];
}

/* Relative exposures of the channels of a sample. The greens of a mosaic are averaged unless one of
 * them is above `hi`. returns: number of channels. */
static int sample_at(const struct sampler *s, int i, int j, float hi, float x[3])
{
    size_t w = (size_t)s->px->w, at = (size_t)j * (size_t)s->stride * w + (size_t)(i * s->stride);
    if (s->px->cfa == RAW_MONO) {
        x[0] = relative_exposure(s, at, 1);
        return 1;
    }
    if (s->px->cfa == RAW_RGB) {
        for (int c = 0; c < 3; c++)
            x[c] = relative_exposure(s, 3 * at + (size_t)c, c);
        return 3;
    }
    bool green_first = s->px->cfa == RAW_GRBG || s->px->cfa == RAW_GBRG;
    float q[4] = {relative_exposure(s, at, 1), relative_exposure(s, at + 1, 1),
                  relative_exposure(s, at + w, 1), relative_exposure(s, at + w + 1, 1)};
    float g0 = green_first ? q[0] : q[1], g1 = green_first ? q[3] : q[2];
    x[0] = green_first ? q[1] : q[0];
    x[1] = fmaxf(g0, g1) > hi ? fmaxf(g0, g1) : 0.5f * (g0 + g1);
    x[2] = green_first ? q[2] : q[3];
    return 3;
}

/* --- histogram ------------------------------------------------------------------------------ */

static int clamp_bin(double b)
{
    return (int)fmin(fmax(b, 0.0), METER_BINS - 1);
}

/* First bin that is wholly visible at that exposure. */
static int seen_bin(const struct meter *m, double t)
{
    return clamp_bin(ceil((m->floor - log2(t) - m->bin_lo) * METER_PER_STOP - 1e-6));
}

/* Bin of relative exposure x, plus `sigmas` times its noise. */
static int bin_of(const struct meter *m, double x, double sigmas, double log2t)
{
    if (!(x > 0.0) || log2(x) < m->floor)
        return 0;
    double noise = m->cfg.read_noise / m->cfg.electrons;
    double l = log2(x + sigmas * sqrt(x / m->cfg.electrons + noise * noise));
    if (l > m->hi)
        return clamp_bin(ceil((m->hi - log2t - m->bin_lo) * METER_PER_STOP - 1e-6));
    return clamp_bin(fmax(floor((l - log2t - m->bin_lo) * METER_PER_STOP), 1.0));
}

/* Probes by exposure, the longest first. */
static void sort_by_length(const struct meter *m, int order[EXPOSURES])
{
    for (int i = 0; i < m->probes; i++) {
        int k = i;
        for (; k > 0 && m->probe_s[order[k - 1]] < m->probe_s[i]; k--)
            order[k] = order[k - 1];
        order[k] = i;
    }
}

static double sum_bins(const float *v, int from, int to)
{
    double s = 0.0;
    for (int b = from; b < to; b++)
        s += v[b];
    return s;
}

/* Take the bins range[0]..range[1]-1 of one probe, limited to the brightest `rest` of its samples,
 * because noise may lift more over the border. The part of `rest` that it does not see goes to the
 * bin `blind`. returns: the share above range[1]. */
static double take_bins(const float *share, const int range[2], int blind, double rest, double *out)
{
    double above = fmin(sum_bins(share, range[1], METER_BINS), rest), left = rest - above;
    for (int b = range[1] - 1; b >= range[0]; b--) {
        out[b] = fmin(share[b], left);
        left -= out[b];
    }
    out[blind] += left;
    return above;
}

static void combine_probes(const struct meter *m, int end, double out[METER_BINS])
{
    int order[EXPOSURES], cut;
    sort_by_length(m, order);
    memset(out, 0, METER_BINS * sizeof *out);
    const float *first = m->share[order[0]][end];
    cut = coverage_clip_bin(m, m->probe_s[order[0]]);
    double rest = 1.0;
    for (int b = 0; b < cut; b++) {
        out[b] = first[b];
        rest = fmax(rest - out[b], 0.0);
    }
    for (int i = 1; i < m->probes; i++) {
        double t = m->probe_s[order[i]];
        int to = coverage_clip_bin(m, t), blind = seen_bin(m, t);
        if (to <= cut)
            continue;
        blind = end == 0 ? (blind < to ? blind : to) - 1 : cut;
        rest = take_bins(m->share[order[i]][end], (int[2]){cut, to}, blind > cut ? blind : cut,
                         rest, out);
        cut = to;
    }
    out[cut] += rest;
}

static void summarise_probes(struct meter *m)
{
    int order[EXPOSURES];
    sort_by_length(m, order);
    combine_probes(m, 0, m->top);
    combine_probes(m, 1, m->bottom);
    const float *brightest = m->share[order[m->probes - 1]][0];
    const float *darkest = m->share[order[0]][1];
    double t_long = m->probe_s[order[0]];
    int usable = clamp_bin(floor((m->lo - log2(t_long) - m->bin_lo) * METER_PER_STOP));
    m->clipped = sum_bins(brightest, coverage_clip_bin(m, m->probe_s[order[m->probes - 1]]),
                          METER_BINS) > m->cfg.clip + SLIGHT;
    m->starved = sum_bins(darkest, 0, usable) > m->cfg.dark + SLIGHT;
}

void meter_add(struct meter *m, const struct raw *px, const struct crf *crf, double exposure_s)
{
    struct sampler s;
    uint32_t count[2][METER_BINS] = {{0}};
    if (m->probes >= EXPOSURES || px->w < 1 || px->h < 1 || !(exposure_s > 0.0))
        return;
    if (m->probes == 0)
        set_limits(m, crf);
    sampler_init(px, crf, &s);
    float hi = (float)exp2(m->hi), x[3];
    double log2t = log2(exposure_s);
    for (int j = 0; j < s.h; j++)
        for (int i = 0; i < s.w; i++) {
            int n = sample_at(&s, i, j, hi, x);
            float top = n == 3 ? fmaxf(fmaxf(x[0], x[1]), x[2]) : x[0];
            float bottom = n == 3 ? fminf(fminf(x[0], x[1]), x[2]) : x[0];
            count[0][bin_of(m, top, TOP_SIGMAS, log2t)]++;
            count[1][bin_of(m, bottom, -BOTTOM_SIGMAS, log2t)]++;
        }
    float one = 1.0f / ((float)s.w * (float)s.h);
    for (int k = 0; k < 2; k++)
        for (int b = 0; b < METER_BINS; b++)
            m->share[m->probes][k][b] = (float)count[k][b] * one;
    m->probe_s[m->probes++] = exposure_s;
    summarise_probes(m);
}

/* --- probes --------------------------------------------------------------------------------- */

/* Share that the longest probe does not see. */
static double unseen_share(const struct meter *m, double *t)
{
    int order[EXPOSURES];
    sort_by_length(m, order);
    *t = m->probe_s[order[0]];
    return m->share[order[0]][1][0];
}

static double shortest_probe(const struct meter *m)
{
    double t = m->probe_s[0];
    for (int i = 1; i < m->probes; i++)
        t = fmin(t, m->probe_s[i]);
    return t;
}

double meter_probe(const struct meter *m)
{
    const struct meter_config *c = &m->cfg;
    double most = coverage_longest_s(c), t_long;
    if (m->probes == 0)
        return coverage_legal_s(c,
                                sqrt(c->time_min_s * fmax(fmin(most, FIRST_MAX_S), c->time_min_s)));
    double reach = exp2(m->hi - m->floor - 1.0), dark = unseen_share(m, &t_long);
    double t_short = shortest_probe(m);
    if (m->probes >= PROBES)
        return 0.0;
    if (m->clipped && t_short > c->time_min_s * (1.0 + 1e-6))
        return coverage_legal_s(c, t_short < 3.0 * reach * c->time_min_s ? c->time_min_s
                                                                         : t_short / reach);
    if (dark <= c->dark + SLIGHT || t_long > most * (1.0 - 1e-6))
        return 0.0;
    /* A step of the usable range makes a likely member; the last probe sees as far as it can. */
    double step = m->probes + 1 < PROBES && dark < 0.5 ? exp2(m->hi - m->lo) : reach;
    double t = coverage_legal_s(c, fmin(t_long * step, most));
    return t > t_long * (1.0 + 1e-6) ? t : 0.0;
}

/* --- plan ----------------------------------------------------------------------------------- */

/* Spread the share that the longest probe does not see below its floor: twice as far down as at the
 * density of the stop above, but not beyond the range of one exposure or the reachable bins. */
static void place_unseen(const struct meter *m, double *top, double *bottom)
{
    double t_long, dark = unseen_share(m, &t_long), a = top[0], b = bottom[0], dense = 0.0;
    int last = seen_bin(m, t_long) - 1, length = coverage_bins(m);
    int reach = last - (coverage_clip_bin(m, coverage_longest_s(&m->cfg)) - length) + 1;
    if (last < 1)
        return;
    for (int i = last + 1; i <= last + METER_PER_STOP && i < METER_BINS; i++)
        dense += bottom[i] / METER_PER_STOP;
    double wide = dark > 0.0 ? ceil(2.0 * dark / fmax(dense, SLIGHT)) : 1.0;
    wide = fmax(fmin(fmin(wide, length), fmin(reach, last)), 1.0);
    top[0] = bottom[0] = 0.0;
    for (int i = last; i > last - (int)wide; i--) {
        top[i] += a / (int)wide;
        bottom[i] += b / (int)wide;
    }
}

err_t meter_choose(const struct meter *m, struct meter_result *out)
{
    double top[METER_BINS], bottom[METER_BINS], probe = meter_probe(m);
    memset(out, 0, sizeof *out);
    if (probe > 0.0)
        return err_fail(ERR_AGAIN, "metering: a probe of %g s is missing, there are %d", probe,
                        m->probes);
    memcpy(top, m->top, sizeof top);
    memcpy(bottom, m->bottom, sizeof bottom);
    place_unseen(m, top, bottom);
    coverage_run(m, top, bottom, out);
    return OK;
}

/* --- coverage afterwards -------------------------------------------------------------------- */

struct tally {
    double clipped, dark;
    double mass[METER_BINS]; // dark samples by radiance
};

/* Square of the merged signal to noise of one channel; *l: log2 of its radiance. */
static double merged_snr2(const struct meter *m, const double *exposure, const float *x, int n,
                          double *l)
{
    double hi = exp2(m->hi), light = 0.0, time = 0.0, s = 0.0;
    for (int i = 0; i < n; i++)
        if (x[3 * i] <= hi) {
            light += x[3 * i];
            time += exposure[i];
        }
    *l = light > 0.0 ? log2(light / time) : -INFINITY;
    for (int i = 0; i < n && light > 0.0; i++)
        if (x[3 * i] <= hi)
            s += coverage_snr2(&m->cfg, light / time * exposure[i]);
    return s;
}

/* x: [frames][3] relative exposures. */
static void add_sample(const struct meter *m, const double *exposure, const float *x, int n,
                       int channels, struct tally *out)
{
    double darkest = INFINITY, l, hi = exp2(m->hi), need = CHECK_SHARE * m->cfg.snr;
    bool clipped = false;
    for (int c = 0; c < channels; c++) {
        bool open = false;
        for (int i = 0; i < n; i++)
            open = open || x[3 * i + c] <= hi;
        clipped = clipped || !open;
        if (open && merged_snr2(m, exposure, x + c, n, &l) < need * need)
            darkest = fmin(darkest, l);
    }
    out->clipped += clipped;
    if (darkest < INFINITY) {
        out->dark += 1.0;
        out->mass[clamp_bin(floor((darkest - m->bin_lo) * METER_PER_STOP))] += 1.0;
    }
}

/* The exposure of at most `left` that covers most of the dark samples; 0: none. */
static double longer_exposure(const struct meter *m, const struct tally *t, double left,
                              double longest_s)
{
    double most = fmin(coverage_longest_s(&m->cfg), left), best = 0.0, found = 0.0;
    if (most < m->cfg.time_min_s)
        return 0.0;
    most = coverage_legal_s(&m->cfg, most);
    for (int k = 0; k < METER_BINS; k++) {
        double time = coverage_legal_s(&m->cfg, most * exp2(-(double)k / METER_PER_STOP)),
               covered = 0.0;
        int from = clamp_bin(ceil((m->lo - log2(time) - m->bin_lo) * METER_PER_STOP - 1e-6));
        for (int b = from; b < coverage_clip_bin(m, time); b++)
            covered += t->mass[b];
        if (covered > found) {
            found = covered;
            best = time;
        }
    }
    /* No dark sample can be reached; unseen ones may be a step below. */
    if (found == 0.0 && most > longest_s * (1.0 + 1e-6))
        best =
            coverage_legal_s(&m->cfg, fmin(most, longest_s * exp2(m->hi - m->lo - m->cfg.overlap)));
    return best;
}

void meter_check(const struct meter_config *cfg, const struct raw *frames, int n,
                 const struct crf *crf, const double *exposure_s, struct meter_coverage *out)
{
    struct meter m = {.cfg = *cfg};
    struct sampler s[EXPOSURES];
    struct tally t = {0};
    float x[EXPOSURES][3] = {{0}};
    double shortest = INFINITY, long_s = 0.0, total = 0.0;
    memset(out, 0, sizeof *out);
    n = n < EXPOSURES ? n : EXPOSURES;
    if (n < 1 || frames[0].w < 1 || frames[0].h < 1)
        return;
    fill_defaults(&m.cfg, cfg->display ? 8 : 12, 0);
    set_limits(&m, crf);
    for (int i = 0; i < n; i++) {
        sampler_init(&frames[i], crf, &s[i]);
        shortest = fmin(shortest, exposure_s[i]);
        long_s = fmax(long_s, exposure_s[i]);
        total += exposure_s[i];
    }
    for (int at = 0; at < s[0].w * s[0].h; at++) {
        int channels = 0;
        for (int i = 0; i < n; i++)
            channels = sample_at(&s[i], at % s[0].w, at / s[0].w, (float)exp2(m.hi), x[i]);
        add_sample(&m, exposure_s, &x[0][0], n, channels, &t);
    }
    double samples = (double)s[0].w * s[0].h;
    out->clipped = t.clipped / samples;
    out->dark = t.dark / samples;
    double left = m.cfg.budget_s > 0.0 ? m.cfg.budget_s - total : INFINITY;
    double darker = coverage_legal_s(&m.cfg, shortest * exp2(m.cfg.overlap - (m.hi - m.lo)));
    double over[2] = {out->clipped / fmax(m.cfg.clip, SLIGHT),
                      out->dark / fmax(m.cfg.dark, SLIGHT)};
    if (over[0] > 1.0 && over[0] > over[1] && darker < shortest * (1.0 - 1e-6) && darker <= left)
        out->extend_s = darker;
    else if (over[1] > 1.0)
        out->extend_s = longer_exposure(&m, &t, left, long_s);
    else if (over[0] > 1.0 && darker < shortest * (1.0 - 1e-6) && darker <= left)
        out->extend_s = darker;
}
