/* The view is rendered at open, and again when the file of `at` names another one: the camera has
 * moved. With somebody who walks by, it is rendered with him in several places, too, which frames
 * take in turn. Every frame is that linear radiance through the sensor at the frame's true
 * exposure; the frame's number chooses the noise. The name of the unit has the seed, the view at
 * open, and the family and parameter of the curve: they determine the sensor and its response. */
#include "sim/device/camera_sim.h"

#include "core/base/rig.h"
#include "sim/sensor/sensor.h"
#include "sim/world/passer.h"
#include "sim/world/render.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { STEPS = 5 }; // places in which somebody stands, in turn

struct options {
    int64_t seed, views, view, size, samples, shadow;
    double spread, fov, param, full_us, well, flicker, hz, line_us, moving;
    int kind, free_hand, format, curve;
    char at[URI_TEXT];
};

struct state {
    struct feed feed; // first: see sim/device/feed.h
    struct sensor sensor;
    struct curve curve;
    struct options opt;
    int size;
    uint64_t seed;
    float *radiance; // (1 or 1 + STEPS, 3, size, size) without and with somebody
    uint16_t *raw;
};

#define AT(field) offsetof(struct options, field)
static const struct uri_key keys[] = {
    {"seed", AT(seed), URI_WHOLE, 0, 9007199254740992.0, NULL},
    {"kind", AT(kind), URI_WORD, 0, 0, "any|" WORLD_WORDS},
    {"views", AT(views), URI_WHOLE, 1, RIG_CAMERAS_MAX, NULL},
    {"view", AT(view), URI_WHOLE, 0, RIG_CAMERAS_MAX - 1, NULL},
    {"at", AT(at), URI_STRING, 0, 0, NULL}, // file with the number of the view that is seen now
    {"spread", AT(spread), URI_REAL, 0, 1, NULL},
    {"fov", AT(fov), URI_REAL, 20, 120, NULL},
    {"freehand", AT(free_hand), URI_WORD, 0, 0, "no|yes"},
    {"size", AT(size), URI_WHOLE, 14, 2048, NULL},
    {"samples", AT(samples), URI_WHOLE, 1, 8, NULL},
    {"shadow", AT(shadow), URI_WHOLE, 1, 64, NULL},
    {"format", AT(format), URI_WORD, 0, 0, "rgb|rggb|bggr"},
    {"curve", AT(curve), URI_WORD, 0, 0, CURVE_WORDS},
    {"param", AT(param), URI_REAL, 0, 16, NULL},
    {"full", AT(full_us), URI_REAL, 10, 1e8, NULL},
    {"well", AT(well), URI_REAL, 100, 1e6, NULL},
    {"flicker", AT(flicker), URI_REAL, 0, 1, NULL},
    {"hz", AT(hz), URI_REAL, 0, 1e6, NULL},
    {"line", AT(line_us), URI_REAL, 0, 1e5, NULL},
    {"moving", AT(moving), URI_REAL, 0, PASSER_SHARE_MAX, NULL}, // share of the picture; 0: nobody
};

static const struct options defaults = {
    .views = 1,
    .size = 224,
    .samples = 2,
    .shadow = 4,
    .spread = 0.5,
    .fov = 60.0,
    .param = NAN, // the usual one
    .curve = CURVE_SRGB,
    .full_us = 20000.0,
    .well = 10000.0,
    .hz = 100.0,
};

/* ---- rendering ---- */

static size_t picture_values(const struct state *s)
{
    return 3 * (size_t)s->size * (size_t)s->size;
}

/* The picture again, with somebody in each of his places. */
static err_t render_passer(const struct run *r, const struct render_world *scene,
                           const struct camera *cam, const struct render_quality *q,
                           struct state *s)
{
    const struct passer p = {s->seed, (float)s->opt.moving};
    const size_t mark = arena_mark(r->tmp), values = picture_values(s);
    uint8_t *mask;
    err_t e = arena_alloc(r->tmp, values / 3, 1, &mask);
    for (uint64_t k = 1; k <= STEPS && !e; k++) {
        const struct passer_shot shot = {cam, q, k};
        memcpy(s->radiance + k * values, s->radiance, values * sizeof *s->radiance);
        e = passer_draw(r, scene, &p, &shot, s->radiance + k * values, mask);
    }
    arena_reset(r->tmp, mark);
    return e;
}

static err_t render_world_view(const struct run *r, const struct options *o, struct state *s)
{
    struct world w;
    struct render_world *scene;
    struct camera cams[RIG_CAMERAS_MAX];
    struct world_path path = {.n = (int)o->views,
                              .spread = (float)o->spread,
                              .fov_deg = (float)o->fov,
                              .jitter = o->free_hand};
    struct render_quality q = {.samples = (int)o->samples, .shadow = (int)o->shadow};
    struct render_maps maps = {.radiance = s->radiance};
    err_t e = world_make(r->keep, s->seed, (enum world_kind)(o->kind + WORLD_ANY), &w);
    if (e)
        return e;
    world_cameras(&w, &path, s->seed, s->size, cams);
    e = render_open(r, &w, &scene);
    if (!e)
        e = render_run(r, scene, &cams[o->view], &q, s->seed, &maps);
    if (!e && o->moving > 0)
        e = render_passer(r, scene, &cams[o->view], &q, s);
    return e;
}

static err_t render_view(const struct options *o, struct state *s)
{
    struct arena keep = {0}, tmp = {0};
    struct pool *pool = NULL;
    struct plan p = plan_begin(1);
    world_plan(&p);
    render_open_plan(&p);
    render_plan(&p, s->size, s->size);
    err_t e = arena_init(&keep, "world", p.keep.peak);
    if (!e)
        e = arena_init(&tmp, "rendering", p.tmp.peak);
    if (!e)
        e = pool_open(&pool, 0);
    struct run r = {.pool = pool, .keep = &keep, .tmp = &tmp};
    if (!e)
        e = render_world_view(&r, o, s);
    pool_close(pool);
    arena_free(&tmp);
    arena_free(&keep);
    return e;
}

/* Move the camera to the view that the file names. A file that is being written has no newline yet
 * and is passed over. */
static err_t follow_file(struct state *s)
{
    char text[16];
    FILE *f = s->opt.at[0] ? fopen(s->opt.at, "r") : NULL;
    if (!f)
        return OK;
    size_t n = fread(text, 1, sizeof text - 1, f);
    fclose(f);
    text[n] = 0;
    long view = strtol(text, NULL, 10);
    if (n == 0 || text[n - 1] != '\n' || view < 0 || view >= s->opt.views || view == s->opt.view)
        return OK;
    s->opt.view = view;
    return render_view(&s->opt, s);
}

/* ---- a frame ---- */

static float limit_balance(double v)
{
    return (float)fmin(fmax(v, 0.01), 1.0); // as sensor_check asks
}

/* Raw numbers of a camera whose white balance and digital gain act before they are read out. */
static void multiply_raw(struct state *s, const struct feed_shot *f)
{
    const double factor[3] = {f->red * f->digital, f->digital, f->blue * f->digital};
    const int black = s->sensor.black, top = (1 << s->sensor.bits) - 1;
    for (int i = 0; i < s->size * s->size; i++) {
        int y = i / s->size, x = i % s->size, c = y % 2 + x % 2; // colour in RGGB
        c = s->sensor.cfa == SENSOR_BGGR ? 2 - c : c;
        double v = black + factor[c] * (s->raw[i] - black);
        s->raw[i] = (uint16_t)fmin(fmax(v + 0.5, 0.0), top);
    }
}

static err_t expose_frame(void *ctx, const struct feed_shot *f, uint8_t *px)
{
    struct state *s = ctx;
    struct sensor_shot shot = {.exposure_s = f->exposure.time_s,
                               .gain = (float)fmin(fmax(f->exposure.gain, 1.0), 1e3),
                               .start_s = f->start_s,
                               .seed = s->seed,
                               .frame = (uint64_t)f->number};
    const int step = s->opt.moving > 0 ? 1 + (int)(f->number % STEPS) : 0;
    struct image radiance = {s->size, s->size, 3, s->radiance + (size_t)step * picture_values(s)};
    struct sensor_raw raw = {s->size, s->size, s->raw};
    struct sensor dim = s->sensor, shown = s->sensor;
    struct run r = {0};
    err_t e = follow_file(s);
    if (e)
        return e;
    if (f->exposure.gain < 1.0) // drift below what the amplifier knows
        dim.gain *= (float)f->exposure.gain;
    e = sensor_expose(&r, &dim, &shot, &radiance, &raw);
    if (e)
        return e;
    if (s->sensor.cfa != SENSOR_RGB) {
        if (f->red != 1.0 || f->digital != 1.0)
            multiply_raw(s, f);
        memcpy(px, s->raw, sizeof *s->raw * (size_t)s->size * (size_t)s->size);
        return OK;
    }
    const double factor[3] = {f->red, 1.0, f->blue};
    for (int c = 0; c < 3; c++)
        shown.balance[c] = limit_balance(shown.balance[c] / (factor[c] * f->digital));
    return sensor_develop(&r, &shown, &shot, &s->curve, &raw, px);
}

/* ---- open and close ---- */

static void set_sensor(const struct options *o, struct state *s)
{
    s->opt = *o;
    s->size = (int)o->size;
    s->seed = (uint64_t)o->seed;
    s->sensor = sensor_default;
    s->sensor.cfa = (enum sensor_cfa)o->format;
    s->sensor.gain *= s->sensor.full_well / (float)o->well;
    s->sensor.full_well = (float)o->well;
    s->sensor.electrons = (float)(s->sensor.full_well / (o->full_us * 1e-6));
    s->sensor.flicker = (float)o->flicker;
    s->sensor.flicker_hz = (float)o->hz;
    s->sensor.line_s = (float)(o->line_us * 1e-6);
    s->sensor.unit = (uint64_t)o->view;
    curve_make((enum curve_family)o->curve, (float)o->param, s->seed, &s->curve);
}

static err_t check_options(const struct options *o)
{
    if (o->view >= o->views)
        return err_fail(ERR_ARG, "sim: view is %d, must be 0..%d (views is %d)", (int)o->view,
                        (int)o->views - 1, (int)o->views);
    if (o->moving > 0 && o->moving < PASSER_SHARE_MIN)
        return err_fail(ERR_ARG, "sim: moving is %g, must be 0 or %g..%g", o->moving,
                        PASSER_SHARE_MIN, PASSER_SHARE_MAX);
    if (o->format != SENSOR_RGB && o->size % 2)
        return err_fail(ERR_ARG, "sim: size is %d px, must be even for a Bayer format",
                        (int)o->size);
    return OK;
}

static err_t start_feed(struct state *s, const struct camera_cfg *cfg, const struct options *o,
                        const struct feed_options *feed)
{
    static const enum camera_format format[] = {CAMERA_RGB8, CAMERA_RGGB16, CAMERA_BGGR16};
    set_sensor(o, s);
    size_t area = (size_t)s->size * (size_t)s->size;
    s->radiance = malloc((o->moving > 0 ? 1 + STEPS : 1) * 3 * area * sizeof *s->radiance);
    s->raw = malloc(3 * area * sizeof *s->raw);
    if (!s->radiance || !s->raw)
        return err_fail(ERR_NOMEM, "sim: no memory for pictures of %d px", s->size);
    bool rgb = s->sensor.cfa == SENSOR_RGB;
    struct feed_source source = {.ctx = s,
                                 .w = s->size,
                                 .h = s->size,
                                 .bytes_per_px = rgb ? 3 : 2,
                                 .bits = rgb ? 8 : s->sensor.bits,
                                 .black = rgb ? 0 : s->sensor.black,
                                 .format = format[o->format],
                                 .line_s = o->line_us * 1e-6,
                                 .expose = expose_frame};
    snprintf(source.unit, sizeof source.unit, "sim-%lld-%lld-%d-%g", (long long)o->seed,
             (long long)o->view, o->curve, s->curve.param);
    err_t e = feed_open(&s->feed, cfg, feed, &source);
    if (!e)
        e = render_view(o, s);
    if (!e)
        feed_start(&s->feed);
    return e;
}

static void sim_close(void *st)
{
    struct state *s = st;
    feed_close(&s->feed);
    free(s->radiance);
    free(s->raw);
    memset(s, 0, sizeof *s);
}

static err_t sim_open(void *st, const struct camera_cfg *cfg)
{
    struct options o = defaults;
    struct feed_options feed = feed_defaults;
    const struct uri_table tables[] = {{keys, sizeof keys / sizeof keys[0], &o},
                                       {feed_keys, feed_n_keys, &feed}};
    memset(st, 0, sizeof(struct state));
    if (strncmp(cfg->uri, "sim:", 4) != 0)
        return err_fail(ERR_ARG, "%.64s: does not begin with \"sim:\"", cfg->uri);
    err_t e = uri_parse("sim", cfg->uri + 4, tables, 2);
    if (!e)
        e = check_options(&o);
    if (!e)
        e = start_feed(st, cfg, &o, &feed);
    if (e)
        sim_close(st);
    return e;
}

const struct camera_ops camera_sim = {.name = "sim",
                                      .state_bytes = sizeof(struct state),
                                      .open = sim_open,
                                      .close = sim_close,
                                      .info = feed_info,
                                      .fd = feed_fd,
                                      .request = feed_request,
                                      .shift = feed_shift,
                                      .next = feed_next,
                                      .release = feed_release,
                                      .now = feed_own_now};
