/* A frame has three stages. When it ends (finish_frame), its faults are applied, its true exposure
 * is fixed and it is queued if a buffer is free. When it is due and requested (feed_next), its
 * pixels are made. It keeps its buffer until feed_release.
 * Metadata and read-back report the programmed exposure. Faults that ignore, round or drift change
 * only the true one, as in cameras that do not notice them. */
#include "sim/device/feed.h"

#include "drivers/device/clocks.h"
#include "sim/sensor/sensor.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

#define VIRTUAL_START 1000000000 // ns
#define SHIFT_STEP_S 1e-6        // where the time of a row is not known
#define UNSETTLED 0.3            // part of the exposure, in frames before `startup`
#define TORN_LEAST 0.03          // share of the rows
#define TORN_MOST 0.45
#define TORN_CODES 2.0  // mean difference of a cell that shows it: less is black and rounding, and
#define TORN_ERRORS 4.0 // standard errors more, noise (core/photo/README.md 5.1)
enum { TORN_CELL = 8 }; // px

#define AT(field) offsetof(struct feed_options, field)
const struct uri_key feed_keys[] = {
    {"fps", AT(fps), URI_REAL, 0.01, 1000, NULL},
    {"delay", AT(delay), URI_WHOLE, 1, TIMING_DELAY_MAX, NULL},
    {"jitter", AT(jitter), URI_WHOLE, 0, TIMING_DELAY_MAX, NULL}, // frames
    {"claim", AT(claim), URI_WHOLE, -1, TIMING_DELAY_MAX, NULL},  // delay that feed_info reports
    {"readback", AT(readback), URI_WORD, 0, 0, "honest|cached|lagged"},
    {"metadata", AT(metadata), URI_WORD, 0, 0, "correct|absent|late"},
    {"stamp", AT(stamp), URI_WORD, 0, 0, "start|end"},
    {"clock", AT(virtual), URI_WORD, 0, 0, "real|virtual"},
    {"skew", AT(skew_us), URI_REAL, 0, 1e9, NULL}, // us, that frame 0 begins later
    {"faults", AT(faults), URI_STRING, 0, 0, NULL},
    {"truth", AT(truth), URI_STRING, 0, 0, NULL}, // file: a line per delivered frame
    {"node", AT(node), URI_STRING, 0, 0, NULL},   // file: while it is missing, the camera is gone
    {"gaindelay", AT(gain_delay), URI_WHOLE, 1, TIMING_DELAY_MAX, NULL},
    {"quantum", AT(step_us), URI_REAL, 0.1, 1e6, NULL},      // us, of exposure times
    {"longest", AT(longest_us), URI_REAL, 1, 3600e6, NULL},  // us, exposure time
    {"length", AT(length), URI_WORD, 0, 0, "stretch|limit"}, // as enum timing_length
    {"gainmax", AT(gain_max), URI_REAL, 1, 64, NULL},
    {"first", AT(first_us), URI_REAL, 0.1, 3600e6, NULL}, // us, exposure time at open
    {"startup", AT(startup), URI_WHOLE, 0, 1000, NULL},   // frames wrongly exposed at first
    {"drift", AT(drift_ppm), URI_REAL, -1e4, 1e4, NULL},  // ppm, that frames are longer
    {"wobble", AT(wobble_us), URI_REAL, 0, 1e6, NULL},    // us, that frames start early or late
    {"grid", AT(grid), URI_WORD, 0, 0, "start|end"},      // what of exposures comes once a frame
    {"shift", AT(shift), URI_WORD, 0, 0, "no|yes"},       // whether a frame can be lengthened
};
const int feed_n_keys = (int)(sizeof feed_keys / sizeof feed_keys[0]);
const int feed_n_common = 12;

const struct feed_options feed_defaults = {
    .fps = 30.0,
    .step_us = 20.0,
    .longest_us = 2e6,
    .gain_max = 8.0,
    .first_us = 10000.0,
    .delay = 2,
    .gain_delay = 1,
    .claim = -2, // the truth
};

/* ---- clock ---- */

int64_t feed_now(const void *st)
{
    const struct feed *f = st;
    return f->opt.virtual ? f->clock_ns : clocks_now();
}

int64_t feed_own_now(const void *st)
{
    const struct feed *f = st;
    return f->opt.virtual ? f->clock_ns : 0;
}

/* The descriptor becomes readable when the next frame is due or ends. */
static void set_timer(const struct feed *f)
{
    int64_t t = f->fx.stalled ? 0 : f->timing.now.end_ns; // 0: never
    if (f->n_items > 0 && (t == 0 || f->item[0].due_ns < t))
        t = f->item[0].due_ns;
    if (f->opt.virtual || f->lost)
        t = 1; // now
    struct itimerspec spec = {.it_value = {t / 1000000000, t % 1000000000}};
    timerfd_settime(f->fd, TFD_TIMER_ABSTIME, &spec, NULL);
}

static err_t fail_unplugged(struct feed *f)
{
    f->lost = true;
    set_timer(f);
    return err_fail(ERR_LOST, "simulated camera: unplugged");
}

static bool node_missing(const struct feed *f)
{
    return f->opt.node[0] && access(f->opt.node, F_OK) != 0;
}

/* ---- open and close ---- */

static err_t check_config(const struct camera_cfg *cfg, const struct feed_source *s)
{
    if ((cfg->w && cfg->w != s->w) || (cfg->h && cfg->h != s->h))
        return err_fail(ERR_UNSUPPORTED, "%s: pictures are %d x %d px, asked for are %d x %d",
                        cfg->uri, s->w, s->h, cfg->w, cfg->h);
    if (cfg->format != CAMERA_ANY && cfg->format != s->format)
        return err_fail(ERR_UNSUPPORTED, "%s: the pixel format is %d, asked for is %d", cfg->uri,
                        s->format, cfg->format);
    if (cfg->buffers < 0 || cfg->buffers > CAMERA_BUFFERS_MAX)
        return err_fail(ERR_ARG, "%s: %d buffers, must be 0..%d", cfg->uri, cfg->buffers,
                        CAMERA_BUFFERS_MAX);
    return OK;
}

static err_t open_files(struct feed *f)
{
    if (node_missing(f))
        return err_fail(ERR_LOST, "%s: file is missing, the simulated camera counts as unplugged",
                        f->opt.node);
    f->fd = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
    if (f->fd < 0)
        return err_fail(ERR_IO, "simulated camera: timer: %s", strerror(errno));
    f->has_fd = true;
    if (f->opt.truth[0]) {
        f->truth = fopen(f->opt.truth, "ae");
        if (!f->truth)
            return err_fail(ERR_IO, "%s: %s", f->opt.truth, strerror(errno));
    }
    return f->opt.faults[0] ? fault_read(f->opt.faults, &f->script) : OK;
}

static size_t picture_bytes(const struct feed_source *s)
{
    return (size_t)s->w * (size_t)s->h * (size_t)s->bytes_per_px;
}

static err_t make_slots(struct feed *f, int n)
{
    for (int i = 0; i < n; i++, f->n_slots++) {
        f->slot[i].px = calloc(1, picture_bytes(&f->source));
        if (!f->slot[i].px)
            return err_fail(ERR_NOMEM, "simulated camera: no memory for %d buffers of %zu bytes", n,
                            picture_bytes(&f->source));
    }
    for (int i = 0; i < f->script.n && !f->former; i++)
        if (f->script.v[i].verb == FAULT_TEAR &&
            !(f->former = calloc(1, picture_bytes(&f->source))))
            return err_fail(ERR_NOMEM, "simulated camera: no memory for a torn picture");
    return OK;
}

static struct timing_cfg timing_of(const struct feed_options *o)
{
    return (struct timing_cfg){.period_s = 1.0 / o->fps,
                               .drift = o->drift_ppm * 1e-6,
                               .wobble_s = fmin(o->wobble_us * 1e-6, 0.25 / o->fps),
                               .step_s = o->step_us * 1e-6,
                               .longest_s = o->longest_us * 1e-6,
                               .gain_max = o->gain_max,
                               .delay = (int)o->delay,
                               .gain_delay = (int)o->gain_delay,
                               .jitter = (int)o->jitter,
                               .length = (enum timing_length)o->length};
}

err_t feed_open(struct feed *f, const struct camera_cfg *cfg, const struct feed_options *opt,
                const struct feed_source *source)
{
    memset(f, 0, sizeof *f);
    f->opt = *opt;
    f->source = *source;
    f->fx = (struct feed_effects){.gain = 1.0, .gain_step = 1.0, .balance = 1.0};
    f->fx.balance_step = f->fx.digital = 1.0;
    f->sequence = UINT32_MAX;
    err_t e = check_config(cfg, source);
    if (!e)
        e = open_files(f);
    return e ? e : make_slots(f, cfg->buffers ? cfg->buffers : 4);
}

void feed_start(struct feed *f)
{
    struct timing_cfg timing = timing_of(&f->opt);
    f->base_ns = f->clock_ns = f->opt.virtual ? VIRTUAL_START : clocks_now();
    timing_open(&f->timing, &timing, f->base_ns + (int64_t)(f->opt.skew_us * 1e3),
                f->opt.first_us * 1e-6);
    f->last_true = f->last_programmed = f->last_set =
        (struct exposure){f->timing.now.time_s, f->timing.now.gain};
    set_timer(f);
}

void feed_close(struct feed *f)
{
    for (int i = 0; i < f->n_slots; i++)
        free(f->slot[i].px);
    free(f->former);
    if (f->truth)
        fclose(f->truth);
    if (f->has_fd)
        close(f->fd);
    memset(f, 0, sizeof *f);
}

void feed_info(const void *st, struct camera_info *out)
{
    const struct feed *f = st;
    const struct timing_cfg *t = &f->timing.cfg;
    const struct feed_source *s = &f->source;
    *out = (struct camera_info){.w = s->w,
                                .h = s->h,
                                .stride = s->w * s->bytes_per_px,
                                .format = s->format,
                                .bits = s->bits,
                                .black = s->black,
                                .buffers = f->n_slots,
                                .period_s = t->period_s,
                                .time_min_s = s->time_min_s > 0.0 ? s->time_min_s : t->step_s,
                                .time_step_s = t->step_s,
                                .gain_max = t->gain_max,
                                .stamp = (enum camera_stamp)f->opt.stamp,
                                .ends_on_grid = f->opt.grid != 0,
                                .reports = f->opt.metadata != FEED_ABSENT,
                                .chooses = s->snap != NULL};
    memcpy(out->unit, s->unit, sizeof out->unit);
    out->time_max_s = timing_time(t, t->longest_s);
    out->exposure_delay = f->opt.claim >= -1 ? (int)f->opt.claim : t->delay;
    out->gain_delay = f->opt.claim >= -1 ? (int)f->opt.claim : t->gain_delay;
}

int feed_fd(const void *st)
{
    return ((const struct feed *)st)->fd;
}

/* ---- faults ---- */

static int64_t limit_count(double n)
{
    return n > 0.0 ? (int64_t)n : -1;
}

/* Faults that last beyond the frame that ends now. */
static void start_effect(struct feed *f, const struct fault *x)
{
    struct feed_effects *fx = &f->fx;
    switch (x->verb) {
    case FAULT_DROP:
        fx->drop = (int64_t)x->number;
        fx->drop_hidden = x->nogap;
        break;
    case FAULT_LOSE:
        fx->loss = x->number;
        break;
    case FAULT_TEAR:
        fx->tear = x->number;
        break;
    case FAULT_SEQUENCE_STUCK:
        fx->stuck = true;
        break;
    case FAULT_SEQUENCE_WRAP:
        fx->sequence_add = UINT32_MAX - 2 - f->sequence; // this frame is 2^32 - 2
        break;
    case FAULT_STAMP_ZERO:
        fx->stamp_zero = true;
        break;
    case FAULT_STAMP_REALTIME:
        fx->stamp_real = true;
        break;
    case FAULT_STAMP_BACK:
        fx->stamp_add_ns -= (int64_t)(x->number * 1e9);
        break;
    case FAULT_STAMP_JUMP:
        fx->stamp_add_ns += (int64_t)(x->number * 1e9);
        break;
    case FAULT_IGNORE:
        fx->ignore = limit_count(x->number);
        break;
    case FAULT_ROLLOVER:
        fx->rollover = (int64_t)x->number;
        break;
    case FAULT_QUANTUM:
        fx->quantum_s = x->number;
        break;
    case FAULT_GAIN:
        fx->gain_step = x->number;
        break;
    case FAULT_BALANCE:
        fx->balance_step = x->number;
        break;
    case FAULT_DIGITAL:
        fx->digital = x->number;
        break;
    case FAULT_REFUSE_ACCESS:
    case FAULT_REFUSE_BUSY:
    case FAULT_REFUSE_RANGE:
        fx->refuse = x->verb;
        fx->refuse_left = limit_count(x->number);
        break;
    case FAULT_FORMAT:
        fx->half = true;
        break;
    default:
        break; // see mark_frame
    }
}

/* Faults that mark the frame that ends now. */
static void mark_frame(struct feed *f, const struct fault *x, struct feed_item *item, int *copies)
{
    switch (x->verb) {
    case FAULT_DUPLICATE:
        *copies = 2;
        break;
    case FAULT_REPEAT:
        item->shot = f->last_shot;
        break;
    case FAULT_ERROR:
        item->error = true;
        break;
    case FAULT_SHORT:
        item->missing = (size_t)x->number;
        break;
    case FAULT_CORRUPT:
        item->noise = (size_t)x->number;
        break;
    case FAULT_LATE:
        item->due_ns += (int64_t)(x->number * 1e9);
        break;
    case FAULT_EIO:
        item->eio = true;
        break;
    case FAULT_INDEX:
        item->index = true;
        break;
    default:
        break;
    }
}

static bool is_due(const struct feed *f, int i)
{
    const struct fault *x = &f->script.v[i];
    if (f->fired[i])
        return false;
    return x->by_time ? f->timing.now.end_ns - f->base_ns >= x->time_ns
                      : f->timing.now.number >= x->frame;
}

/* ---- a frame ends ---- */

/* The exposure that the sensor really applies. */
static struct exposure true_exposure(struct feed *f, int64_t number, struct exposure e)
{
    struct feed_effects *fx = &f->fx;
    if (fx->rollover > 0 && f->timing.cfg.step_s > 0.0)
        e.time_s = fmod(floor(e.time_s / f->timing.cfg.step_s + 0.5), (double)fx->rollover) *
                   f->timing.cfg.step_s;
    if (fx->quantum_s > 0.0)
        e.time_s = fmax(floor(e.time_s / fx->quantum_s * (1.0 + 1e-9)), 1.0) * fx->quantum_s;
    if (number < f->opt.startup)
        e.time_s *= UNSETTLED;
    if (fx->ignore != 0) {
        e = f->last_true;
        fx->ignore -= fx->ignore > 0;
    }
    f->last_true = e;
    fx->gain *= fx->gain_step;
    fx->balance *= fx->balance_step;
    e.gain *= fx->gain;
    return e;
}

/* When the exposure of a frame begins, or ends. */
static int64_t exposure_at(const struct feed *f, const struct timing_frame *t, bool end)
{
    int64_t length = (int64_t)fmin(t->time_s * 1e9, (double)(t->end_ns - t->start_ns));
    int64_t begin = f->opt.grid ? t->end_ns - length : t->start_ns;
    return end ? begin + length : begin;
}

static int64_t stamp_of(const struct feed *f, const struct timing_frame *t)
{
    int64_t at = exposure_at(f, t, f->opt.stamp == CAMERA_STAMP_END);
    if (f->fx.stamp_real)
        at += clocks_at(0).realtime_ns;
    return f->fx.stamp_zero ? 0 : at + f->fx.stamp_add_ns;
}

static void queue_frame(struct feed *f, const struct feed_item *item)
{
    if (f->n_items + f->n_held + f->n_leaked >= f->n_slots)
        return; // no free buffer: the frame is lost
    f->item[f->n_items++] = *item;
}

static int snap_exposure(const struct feed *f, struct exposure *e, bool request)
{
    return f->source.snap ? f->source.snap(f->source.ctx, e, request) : 0;
}

static struct feed_item describe_frame(struct feed *f, const struct timing_frame *t)
{
    struct feed_item item = {.due_ns = t->end_ns, .stamp_ns = stamp_of(f, t)};
    struct exposure programmed = {t->time_s, t->gain};
    snap_exposure(f, &programmed, false);
    item.reported = f->opt.metadata == FEED_LATE ? f->last_programmed : programmed;
    f->last_programmed = programmed;
    item.shot =
        (struct feed_shot){.exposure = true_exposure(f, t->number, programmed),
                           .start_s = (double)(exposure_at(f, t, false) - f->base_ns) * 1e-9,
                           .number = t->number};
    item.shot.pick = snap_exposure(f, &item.shot.exposure, false);
    item.shot.red = f->fx.balance;
    item.shot.blue = 1.0 / f->fx.balance;
    item.shot.digital = f->fx.digital;
    item.half = f->fx.half;
    if (f->n_items > 0 && f->item[f->n_items - 1].due_ns > item.due_ns)
        item.due_ns = f->item[f->n_items - 1].due_ns;
    return item;
}

/* Whether a fault keeps the running frame from ending now. */
static bool delay_frame(struct feed *f)
{
    for (int i = 0; i < f->script.n; i++) {
        const struct fault *x = &f->script.v[i];
        if ((x->verb != FAULT_STALL && x->verb != FAULT_UNPLUG) || !is_due(f, i))
            continue;
        f->fired[i] = true;
        f->lost = x->verb == FAULT_UNPLUG;
        f->fx.stalled = x->number <= 0.0;
        timing_stall(&f->timing, (int64_t)(x->number * f->timing.cfg.period_s * 1e9));
        return true;
    }
    return false;
}

/* Draw the rows that show the frame before, by the fault `tear`. */
static void tear_frame(struct feed *f, struct feed_item *item)
{
    uint64_t key = ~1u, n = (uint64_t)item->shot.number;
    if (!(f->fx.tear > 0.0) || n == 0 || sensor_uniform(key, 2 * n) >= f->fx.tear)
        return;
    double share = 2.0 * sensor_uniform(key, 2 * n + 1) - 1.0;
    item->former = f->last_shot;
    item->torn = copysign(TORN_LEAST + (TORN_MOST - TORN_LEAST) * fabs(share), share);
}

/* End the running frame. */
static void finish_frame(struct feed *f)
{
    struct feed_effects *fx = &f->fx;
    int due[FAULT_MAX], n_due = 0, copies = 1;
    if (delay_frame(f))
        return;
    for (int i = 0; i < f->script.n; i++)
        if (is_due(f, i)) {
            f->fired[i] = true;
            due[n_due++] = i;
        }
    for (int i = 0; i < n_due; i++)
        start_effect(f, &f->script.v[due[i]]);
    struct timing_frame t = timing_step(&f->timing);
    struct feed_item item = describe_frame(f, &t);
    for (int i = 0; i < n_due; i++)
        mark_frame(f, &f->script.v[due[i]], &item, &copies);
    tear_frame(f, &item);
    f->last_shot = item.shot;
    bool drop = fx->drop > 0;
    fx->drop -= drop;
    if (!fx->stuck && !(drop && fx->drop_hidden))
        f->sequence += 1 + fx->sequence_add;
    fx->sequence_add = 0;
    item.sequence = f->sequence;
    drop |= fx->loss > 0.0 && sensor_uniform(~0u, (uint64_t)t.number) < fx->loss;
    for (int i = 0; i < copies && !drop; i++)
        queue_frame(f, &item);
}

/* End all frames whose time has come. */
static void finish_due_frames(struct feed *f)
{
    int64_t now = feed_now(f);
    while (!f->lost && !f->fx.stalled && f->timing.now.end_ns <= now)
        finish_frame(f);
}

/* Set the virtual clock to the end of the running frame. */
static void advance_clock(struct feed *f)
{
    int64_t end = f->timing.now.end_ns;
    if (f->fx.stalled)
        end = f->clock_ns + (int64_t)(f->timing.cfg.period_s * 1e9);
    if (end > f->clock_ns)
        f->clock_ns = end;
}

/* ---- operations ---- */

err_t feed_request(void *st, const struct exposure *requested, struct exposure *set)
{
    struct feed *f = st;
    if (!(requested->time_s > 0.0 && requested->gain > 0.0) || !isfinite(requested->time_s) ||
        !isfinite(requested->gain))
        return err_fail(ERR_ARG, "simulated camera: exposure of %g s at gain %g is not positive",
                        requested->time_s, requested->gain);
    if (!f->lost && !node_missing(f))
        finish_due_frames(f);
    if (f->lost || node_missing(f))
        return fail_unplugged(f);
    if (f->fx.refuse_left != 0) {
        f->fx.refuse_left -= f->fx.refuse_left > 0;
        if (f->fx.refuse == FAULT_REFUSE_BUSY)
            return err_fail(ERR_BUSY, "simulated camera: exposure: busy");
        if (f->fx.refuse == FAULT_REFUSE_RANGE)
            return err_fail(ERR_ARG, "simulated camera: exposure of %g s: out of range",
                            requested->time_s);
        return err_fail(ERR_UNSUPPORTED, "simulated camera: exposure: permission denied");
    }
    struct exposure e = *requested;
    snap_exposure(f, &e, true);
    timing_write(&f->timing, e.time_s, e.gain);
    e.time_s = timing_time(&f->timing.cfg, e.time_s);
    e.gain = timing_gain(&f->timing.cfg, e.gain);
    *set = f->opt.readback == FEED_CACHED   ? *requested
           : f->opt.readback == FEED_LAGGED ? f->last_set
                                            : e;
    f->last_set = e;
    return OK;
}

err_t feed_shift(void *st, double seconds, double *shift)
{
    struct feed *f = st;
    double step = f->source.line_s > 0.0 ? f->source.line_s : SHIFT_STEP_S;
    if (!f->opt.shift)
        return err_fail(ERR_UNSUPPORTED, "simulated camera: the length of frames is fixed");
    if (!f->lost && !node_missing(f))
        finish_due_frames(f);
    if (f->lost || node_missing(f))
        return fail_unplugged(f);
    double s = floor(fmin(fmax(seconds, 0.0), f->timing.cfg.period_s) / step + 0.5) * step;
    if (!timing_shift(&f->timing, (int64_t)llround(s * 1e9)))
        return err_fail(ERR_BUSY, "simulated camera: a frame is still to be lengthened");
    *shift = s;
    return OK;
}

static struct feed_item take_frame(struct feed *f)
{
    struct feed_item item = f->item[0];
    f->n_items--;
    memmove(f->item, f->item + 1, (size_t)f->n_items * sizeof f->item[0]);
    return item;
}

static void damage_pixels(const struct feed *f, const struct feed_item *item, uint8_t *px)
{
    size_t n = picture_bytes(&f->source), noise = item->noise < n ? item->noise : n;
    if (item->error)
        memset(px + n / 2, 0, n - n / 2);
    for (size_t i = n - noise; i < n; i++)
        px[i] = (uint8_t)(sensor_uniform(item->sequence, i) * 256.0);
}

static void write_truth(const struct feed *f, const struct frame *out, const struct feed_truth *t)
{
    if (!f->truth)
        return;
    fprintf(f->truth, "%u %lld %lld %.9g %.9g %.3g %lld\n", out->sequence,
            (long long)out->timestamp_ns, (long long)t->number, t->exposure.time_s,
            t->exposure.gain, t->torn, (long long)t->start_ns);
    fflush(f->truth);
}

static void fill_frame(struct feed *f, const struct feed_item *item, int i, struct frame *out)
{
    const struct feed_source *s = &f->source;
    struct feed_slot *slot = &f->slot[i];
    int w = item->half ? s->w / 2 : s->w, h = item->half ? s->h / 2 : s->h;
    size_t need = (size_t)w * (size_t)h * (size_t)s->bytes_per_px;
    *out = (struct frame){.data = slot->px,
                          .bytes = need - (item->missing < need ? item->missing : need),
                          .w = w,
                          .h = h,
                          .stride = w * s->bytes_per_px,
                          .format = s->format,
                          .sequence = item->sequence,
                          .timestamp_ns = item->stamp_ns,
                          .index = i};
    out->flags = (item->error ? FRAME_ERROR : 0u) | (out->bytes < need ? FRAME_SHORT : 0u);
    out->exposure_known = out->gains_known = f->opt.metadata != FEED_ABSENT;
    if (out->exposure_known) {
        out->exposure = item->reported;
        out->digital_gain = item->shot.digital;
        out->red_gain = item->shot.red;
        out->blue_gain = item->shot.blue;
    }
    slot->held = true;
    f->n_held++;
    slot->truth = (struct feed_truth){item->shot.number, item->shot.exposure, fabs(item->torn),
                                      f->base_ns + llround(item->shot.start_s * 1e9)};
    slot->truth.exposure.gain *= item->shot.digital;
    write_truth(f, out, &slot->truth);
}

static bool same_exposure(const struct exposure *a, const struct exposure *b)
{
    return a->time_s == b->time_s && a->gain == b->gain;
}

/* Code value i of a picture. */
static int code_at(const struct feed_source *s, const uint8_t *px, size_t i)
{
    return s->bytes_per_px == 2 ? px[2 * i] | px[2 * i + 1] << 8 : px[i];
}

/* Whether two pictures differ in the mean of a cell: `rows` rows from y on, TORN_CELL px from x. */
static bool cell_differs(const struct feed_source *s, const uint8_t *a, const uint8_t *b, size_t y,
                         size_t rows, size_t x)
{
    size_t numbers = s->bytes_per_px == 3 ? 3 : 1, pitch = (size_t)s->w * numbers;
    double sum = 0.0, sum2 = 0.0, n = (double)(rows * TORN_CELL * numbers);
    for (size_t i = y; i < y + rows; i++)
        for (size_t k = x * numbers; k < (x + TORN_CELL) * numbers; k++) {
            double d = code_at(s, a, i * pitch + k) - code_at(s, b, i * pitch + k);
            sum += d;
            sum2 += d * d;
        }
    double mean = sum / n, error = sqrt(fmax(sum2 / n - mean * mean, 0.0) / n);
    return fabs(mean) > TORN_CODES + TORN_ERRORS * error;
}

/* Whether `rows` rows of two pictures from `at` on differ in any cell. */
static bool rows_differ(const struct feed_source *s, const uint8_t *a, const uint8_t *b, size_t at,
                        size_t rows)
{
    size_t n = rows < TORN_CELL ? rows : TORN_CELL;
    for (size_t y = at; y < at + rows; y += n)
        for (size_t x = 0; x + TORN_CELL <= (size_t)s->w; x += TORN_CELL)
            if (cell_differs(s, a, b, y + n > at + rows ? at + rows - n : y, n, x))
                return true;
    return false;
}

/* Copy the rows of the frame before into a torn frame. Where the rows look the same it does not
 * count as torn. */
static err_t mix_rows(const struct feed *f, struct feed_item *item, uint8_t *px)
{
    const struct feed_source *s = &f->source;
    size_t row = (size_t)s->w * (size_t)s->bytes_per_px, h = (size_t)s->h;
    size_t rows = (size_t)llround(fabs(item->torn) * s->h), at = item->torn < 0.0 ? h - rows : 0;
    if (rows == 0)
        return OK;
    err_t e = s->expose(s->ctx, &item->former, f->former);
    if (e)
        return e;
    if (same_exposure(&item->former.exposure, &item->shot.exposure) ||
        !rows_differ(s, px, f->former, at, rows))
        item->torn = 0.0;
    memcpy(px + at * row, f->former + at * row, rows * row);
    return OK;
}

static err_t deliver_frame(struct feed *f, struct frame *out)
{
    struct feed_item item = take_frame(f);
    f->n_leaked += item.index;
    if (item.eio)
        return err_fail(ERR_IO, "simulated camera: frame %u: input/output error", item.sequence);
    if (item.index)
        return err_fail(ERR_IO, "simulated camera: frame %u is in buffer 1000, there are only %d",
                        item.sequence, f->n_slots);
    int i = 0;
    while (f->slot[i].held) // queue_frame has checked that one is free
        i++;
    err_t e = f->source.expose(f->source.ctx, &item.shot, f->slot[i].px);
    if (e)
        return e;
    e = mix_rows(f, &item, f->slot[i].px);
    if (e)
        return e;
    damage_pixels(f, &item, f->slot[i].px);
    fill_frame(f, &item, i, out);
    return OK;
}

err_t feed_next(void *st, struct frame *out)
{
    struct feed *f = st;
    memset(out, 0, sizeof *out);
    if (f->lost || node_missing(f))
        return fail_unplugged(f);
    if (f->opt.virtual && f->n_items == 0)
        advance_clock(f);
    finish_due_frames(f);
    if (f->n_items > 0 && f->opt.virtual && f->item[0].due_ns > f->clock_ns)
        f->clock_ns = f->item[0].due_ns;
    bool due = f->n_items > 0 && f->item[0].due_ns <= feed_now(f);
    err_t e = OK;
    if (due)
        e = deliver_frame(f, out);
    else if (f->lost)
        return fail_unplugged(f);
    else
        e = err_fail(ERR_AGAIN, "simulated camera: no frame yet");
    set_timer(f);
    return e;
}

void feed_release(void *st, struct frame *frame)
{
    struct feed *f = st;
    int i = frame->index;
    if (frame->data && i >= 0 && i < f->n_slots && f->slot[i].held) {
        f->slot[i].held = false;
        f->n_held--;
        set_timer(f);
    }
    memset(frame, 0, sizeof *frame);
}

struct feed_truth feed_truth(const void *st, const struct frame *frame)
{
    const struct feed *f = st;
    return f->slot[frame->index].truth;
}
