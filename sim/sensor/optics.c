/* Numbers are read by one table of words. The light that a lens lets through is taken at the centre
 * of each pixel: it changes little within one. */
#include "sim/sensor/optics.h"

#include "core/base/num.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    K1,
    K2,
    K3,
    K4,
    P1,
    P2,
    FISHEYE,
    FOV,
    SIZE,
    CENTRE,
    V2,
    V4,
    COS4,
    GAIN,
    WB,
    WORDS,
    VALUES = 3
};

struct word {
    const char *name;
    int n; // numbers behind it, `between` them
    char between;
    double lo, hi;
};

static const struct word WORD[WORDS] = {
    [K1] = {"k1", 1, 0, -10, 10},
    [K2] = {"k2", 1, 0, -10, 10},
    [K3] = {"k3", 1, 0, -10, 10},
    [K4] = {"k4", 1, 0, -10, 10},
    [P1] = {"p1", 1, 0, -10, 10},
    [P2] = {"p2", 1, 0, -10, 10},
    [FISHEYE] = {"fisheye", 0, 0, 0, 0},
    [FOV] = {"fov", 1, 0, 10, 220},
    [SIZE] = {"size", 2, 'x', OPTICS_SIDE_MIN, OPTICS_SIDE_MAX},
    [CENTRE] = {"centre", 2, '/', 0.2, 0.8},
    [V2] = {"v2", 1, 0, -10, 10},
    [V4] = {"v4", 1, 0, -10, 10},
    [COS4] = {"cos4", 0, 0, 0, 0},
    [GAIN] = {"gain", 1, 0, 0.1, 10},
    [WB] = {"wb", 3, '/', 0.1, 10},
};

static const double FOV_MAX = 140; // degrees, of a lens that is no fisheye

struct words {
    bool given[WORDS];
    double v[WORDS][VALUES];
};

/* ---- reading ---- */

static err_t refuse_word(const char *what, const char *text)
{
    return err_fail(ERR_ARG, "%s: \"%.64s\" is not a list like " OPTICS_WORDS, what, text);
}

/* The numbers of word k, behind its "="; *at is moved behind them. */
static bool read_values(int k, const char **at, double v[VALUES])
{
    for (int i = 0; i < WORD[k].n; i++) {
        char *end;
        if (*(*at)++ != (i ? WORD[k].between : '='))
            return false;
        v[i] = strtod(*at, &end);
        if (end == *at || !isfinite(v[i]))
            return false;
        *at = end;
    }
    return true;
}

static int find_word(const char *at)
{
    int k = 0;
    const size_t n = strcspn(at, "=,");
    while (k < WORDS && (strlen(WORD[k].name) != n || strncmp(at, WORD[k].name, n) != 0))
        k++;
    return k;
}

static err_t read_words(const char *what, const char *text, struct words *w)
{
    *w = (struct words){0};
    for (const char *at = text;; at++) {
        const int k = find_word(at);
        if (k == WORDS || w->given[k])
            return refuse_word(what, text);
        w->given[k] = true;
        at += strlen(WORD[k].name);
        if (!read_values(k, &at, w->v[k]) || (*at && *at != ','))
            return refuse_word(what, text);
        for (int i = 0; i < WORD[k].n; i++)
            if (!(w->v[k][i] >= WORD[k].lo && w->v[k][i] <= WORD[k].hi))
                return err_fail(ERR_ARG, "%s: %s of %g, allowed are %g to %g", what, WORD[k].name,
                                w->v[k][i], WORD[k].lo, WORD[k].hi);
        if (!*at)
            return OK;
    }
}

static enum lens_model model_of(const bool given[WORDS])
{
    if (given[FISHEYE])
        return LENS_OPENCV_FISHEYE;
    if (given[P1] || given[P2])
        return LENS_OPENCV;
    return given[K2] ? LENS_RADIAL : given[K1] ? LENS_SIMPLE_RADIAL : LENS_PINHOLE;
}

static err_t set_lens(const char *what, const struct words *w, double fov, struct optics *o)
{
    struct lens *l = &o->lens;
    l->model = model_of(w->given);
    const bool fisheye = l->model == LENS_OPENCV_FISHEYE;
    fov = w->given[FOV] ? w->v[FOV][0] : fov;
    if (!fisheye && fov > FOV_MAX)
        return err_fail(ERR_ARG, "%s: fov of %g, a lens that is no fisheye has at most %g", what,
                        fov, FOV_MAX);
    const double half = fov * NUM_PI / 360;
    l->fx = l->fy = 0.5 * o->w / (fisheye ? half : tan(half));
    l->cx = (w->given[CENTRE] ? w->v[CENTRE][0] : 0.5) * o->w;
    l->cy = (w->given[CENTRE] ? w->v[CENTRE][1] : 0.5) * o->h;
    for (int i = 0; i < LENS_TERMS; i++)
        l->term[i] = w->v[fisheye || i < 2 ? K1 + i : P1 + i - 2][0];
    return lens_init(l);
}

static err_t check_vignette(const char *what, const struct optics *o)
{
    enum { STEPS = 64 };
    for (int i = 0; i <= STEPS; i++) {
        const float r2 = (float)i / STEPS;
        const float left = 1 + r2 * (o->vignette[0] + r2 * o->vignette[1]);
        if (!(left > 0))
            return err_fail(ERR_ARG,
                            "%s: vignetting leaves %g of the light at %g of the half diagonal, "
                            "must be more than 0",
                            what, (double)left, sqrt((double)r2));
    }
    return OK;
}

err_t optics_parse(const char *what, const char *text, int size, double fov, struct optics *out)
{
    struct words w;
    *out = (struct optics){.w = size, .h = size, .gain = {1, 1, 1}};
    err_t e = read_words(what, text, &w);
    if (e)
        return e;
    if (w.given[FISHEYE] ? w.given[P1] || w.given[P2] : w.given[K3] || w.given[K4])
        return refuse_word(what, text);
    if (w.given[SIZE]) {
        out->w = (int)w.v[SIZE][0];
        out->h = (int)w.v[SIZE][1];
    }
    out->vignette[0] = (float)w.v[V2][0];
    out->vignette[1] = (float)w.v[V4][0];
    out->cos4 = w.given[COS4];
    for (int c = 0; c < 3; c++)
        out->gain[c] = (float)((w.given[GAIN] ? w.v[GAIN][0] : 1) * (w.given[WB] ? w.v[WB][c] : 1));
    e = set_lens(what, &w, fov, out);
    return e ? e : check_vignette(what, out);
}

/* ---- light ---- */

bool optics_dims(const struct optics *o)
{
    bool any = o->cos4 || o->vignette[0] != 0 || o->vignette[1] != 0;
    for (int c = 0; c < 3; c++)
        any = any || o->gain[c] != 1;
    return any;
}

void optics_factor(const struct optics *o, double u, double v, float out[3])
{
    const double x = u - o->lens.cx, y = v - o->lens.cy;
    const double r2 = 4 * (x * x + y * y) / ((double)o->w * o->w + (double)o->h * o->h);
    double left = 1 + r2 * ((double)o->vignette[0] + r2 * (double)o->vignette[1]), ray[3];
    if (o->cos4) {
        const bool there = lens_unproject(&o->lens, (const double[2]){u, v}, ray);
        const double facing = there && ray[2] > 0 ? ray[2] : 0;
        left *= facing * facing * facing * facing;
    }
    for (int c = 0; c < 3; c++)
        out[c] = (float)fmax(left, 0) * o->gain[c];
}

void optics_apply(const struct optics *o, float *radiance)
{
    const size_t px = (size_t)o->w * (size_t)o->h;
    for (int i = 0; i < o->h; i++)
        for (int j = 0; j < o->w; j++) {
            float factor[3];
            optics_factor(o, j + 0.5, i + 0.5, factor);
            for (size_t c = 0; c < 3; c++)
                radiance[c * px + (size_t)i * (size_t)o->w + (size_t)j] *= factor[c];
        }
}
