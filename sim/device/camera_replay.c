/* All pictures are decoded at open, so that no frame waits for a file. */
#include "sim/device/camera_replay.h"

#include "core/base/sha256.h"
#include "drivers/format/imageset.h"
#include "drivers/format/img.h"
#include "drivers/format/name.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct options {
    int64_t bracket, view, step;
    int which;
};

struct state {
    struct feed feed; // first: see sim/device/feed.h
    struct imageset set;
    int *first; // (n_views + 1) picture that a view begins with
    int n_views, view, step, requested;
};

#define AT(field) offsetof(struct options, field)
static const struct uri_key keys[] = {
    {"which", AT(which), URI_WORD, 0, 0, "train|test|all"},
    {"bracket", AT(bracket), URI_WHOLE, 0, 64, NULL},
    {"view", AT(view), URI_WHOLE, 0, 65535, NULL},
    {"step", AT(step), URI_WHOLE, 0, 64, NULL},
};

/* ---- frames ---- */

static int choose_picture(void *ctx, struct exposure *e, bool request)
{
    struct state *s = ctx;
    const struct shot *shots = s->set.capture.shots;
    if (request && s->step > 0 && s->requested++ == s->step) {
        camera_replay_step(s);
        s->requested = 1;
    }
    double want = log(e->time_s * e->gain), best = INFINITY;
    int pick = s->first[s->view];
    for (int i = pick; i < s->first[s->view + 1]; i++) {
        double d = fabs(log(shots[i].exposure) - want);
        if (d < best) {
            best = d;
            pick = i;
        }
    }
    *e = (struct exposure){shots[pick].exposure, 1.0};
    return pick;
}

static err_t copy_picture(void *ctx, const struct feed_shot *shot, uint8_t *px)
{
    const struct state *s = ctx;
    const struct image8 *im = &s->set.capture.shots[shot->pick].image;
    memcpy(px, im->px, (size_t)im->w * (size_t)im->h * 3);
    return OK;
}

void camera_replay_step(void *st)
{
    struct state *s = st;
    s->view = (s->view + 1) % s->n_views;
}

int camera_replay_views(const void *st)
{
    return ((const struct state *)st)->n_views;
}

int camera_replay_view(const void *st)
{
    return ((const struct state *)st)->view;
}

/* ---- open and close ---- */

static err_t group_views(struct state *s, const struct options *o)
{
    const struct capture *c = &s->set.capture;
    s->first = calloc((size_t)c->n + 1, sizeof *s->first);
    if (!s->first)
        return err_fail(ERR_NOMEM, "%s: no memory for its views", s->set.dir);
    for (int i = 0; i < c->n; i++) {
        bool same = i > 0 && name_same_view(c->shots[i - 1].name, c->shots[i].name);
        if (o->bracket > 0)
            same = i % o->bracket != 0;
        if (!same)
            s->first[s->n_views++] = i;
    }
    s->first[s->n_views] = c->n;
    if (o->bracket > 0 && c->n % o->bracket != 0)
        return err_fail(ERR_ARG, "%s: %d pictures cannot be divided into brackets of %d",
                        s->set.dir, c->n, (int)o->bracket);
    if (o->view >= s->n_views)
        return err_fail(ERR_ARG, "replay: view is %d, must be 0..%d for %s", (int)o->view,
                        s->n_views - 1, s->set.dir);
    s->view = (int)o->view;
    s->step = (int)o->step;
    return OK;
}

static err_t load_pictures(struct state *s)
{
    struct capture *c = &s->set.capture;
    double mib = 3.0 * c->shots[0].image.w * c->shots[0].image.h * c->n / (1 << 20);
    if (mib > CAMERA_REPLAY_MIB)
        return err_fail(ERR_LIMIT, "%s: %d pictures take %.0f MiB, at most %d MiB are allowed",
                        s->set.dir, c->n, mib, CAMERA_REPLAY_MIB);
    return imageset_load(&s->set);
}

/* The name depends on the pictures and exposures, not on the path of the folder. */
static void name_unit(const struct capture *c, char unit[CAMERA_UNIT_CAP])
{
    struct sha256 hash;
    char hex[SHA256_HEX_CAP];
    sha256_init(&hash);
    for (int i = 0; i < c->n; i++) {
        sha256_add(&hash, c->shots[i].name, strlen(c->shots[i].name) + 1);
        sha256_add(&hash, &c->shots[i].exposure, sizeof c->shots[i].exposure);
    }
    snprintf(unit, CAMERA_UNIT_CAP, "replay-%.16s", sha256_hex(&hash, hex));
}

/* Open the feed with the exposure range of the pictures. */
static err_t start_feed(struct state *s, const struct camera_cfg *cfg, struct feed_options *feed)
{
    const struct capture *c = &s->set.capture;
    double lo = INFINITY, hi = 0.0;
    for (int i = 0; i < c->n; i++) {
        lo = fmin(lo, c->shots[i].exposure);
        hi = fmax(hi, c->shots[i].exposure);
    }
    struct feed_source source = {.ctx = s,
                                 .w = c->shots[0].image.w,
                                 .h = c->shots[0].image.h,
                                 .bytes_per_px = 3,
                                 .bits = 8,
                                 .format = CAMERA_RGB8,
                                 .time_min_s = lo,
                                 .expose = copy_picture,
                                 .snap = choose_picture};
    name_unit(c, source.unit);
    feed->length = TIMING_FREE;
    feed->step_us = 0.0;
    feed->longest_us = hi * 1e6;
    feed->gain_max = 1.0;
    feed->first_us = sqrt(lo * hi) * 1e6;
    err_t e = feed_open(&s->feed, cfg, feed, &source);
    if (!e)
        feed_start(&s->feed);
    return e;
}

static err_t split_uri(const char *uri, char dir[FILE_PATH_CAP], const char **options)
{
    static const char prefix[] = "replay:";
    size_t skip = sizeof prefix - 1;
    if (strncmp(uri, prefix, skip) != 0)
        return err_fail(ERR_ARG, "%.64s: does not begin with \"%s\"", uri, prefix);
    size_t n = strcspn(uri + skip, ",");
    if (n == 0 || n >= FILE_PATH_CAP)
        return err_fail(ERR_ARG, "replay: the folder's path has %zu bytes, must be 1..%d", n,
                        FILE_PATH_CAP - 1);
    memcpy(dir, uri + skip, n);
    dir[n] = '\0';
    *options = uri + skip + n + (uri[skip + n] == ',');
    return OK;
}

static void replay_close(void *st)
{
    struct state *s = st;
    feed_close(&s->feed);
    imageset_free(&s->set);
    free(s->first);
    memset(s, 0, sizeof *s);
}

static err_t replay_open(void *st, const struct camera_cfg *cfg)
{
    struct state *s = st;
    char dir[FILE_PATH_CAP];
    const char *text = "";
    struct options o = {.which = IMAGESET_TRAIN};
    struct feed_options feed = feed_defaults;
    const struct uri_table tables[] = {{keys, sizeof keys / sizeof keys[0], &o},
                                       {feed_keys, feed_n_common, &feed}};
    memset(s, 0, sizeof *s);
    feed.delay = 1;
    err_t e = split_uri(cfg->uri, dir, &text);
    if (!e)
        e = uri_parse("replay", text, tables, 2);
    struct imageset_request requested = {.images = dir,
                                         .which = (enum imageset_which)o.which,
                                         .every_exposure = true,
                                         .no_cameras = true};
    if (!e)
        e = imageset_list(&requested, &s->set);
    if (!e)
        e = group_views(s, &o);
    if (!e)
        e = load_pictures(s);
    if (!e)
        e = start_feed(s, cfg, &feed);
    if (e)
        replay_close(s);
    return e;
}

const struct camera_ops camera_replay = {.name = "replay",
                                         .state_bytes = sizeof(struct state),
                                         .open = replay_open,
                                         .close = replay_close,
                                         .info = feed_info,
                                         .fd = feed_fd,
                                         .request = feed_request,
                                         .next = feed_next,
                                         .release = feed_release,
                                         .now = feed_own_now};
