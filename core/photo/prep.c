/* Pillow's resize (core/photo/README.md 1.1): a horizontal and then a vertical pass, with an 8-bit
 * picture between. Per axis, n_in -> n_out: scale = n_in / n_out, f = max(scale, 1), centre c = (i
 * + 0.5) scale, taps from trunc(c - 2f + 0.5) to trunc(c + 2f + 0.5) exclusive, clipped to the
 * picture; weights K((j - c + 0.5) / f) normalised in double and rounded half away from zero to
 * 22-bit fixed point. A sample is clamp((sum + 2^21) >> 22). On an axis that keeps its size the
 * weights are exactly (0, 1, 0, 0), so the copy that Pillow makes needs no case of its own. */
#include "core/photo/prep.h"

#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum { WEIGHT_BITS = 22, SIDE_MAX = 1 << 20 };

static const double EXPOSURE_MIN = 1e-8; // core/photo/README.md 1.2

/* Weights of one axis: output i reads inputs first[i] .. first[i] + count[i] - 1. */
struct axis {
    int taps;        // capacity per output
    int *first;      // (n_out)
    int *count;      // (n_out)
    int32_t *weight; // (n_out, taps)
};

struct scratch {
    struct axis x, y;
    double *row;  // (taps) weights before rounding
    uint8_t *mid; // (h, size, 3) after the horizontal pass
};

static int taps_of(int n_in, int n_out)
{
    double scale = (double)n_in / n_out;
    return (int)ceil(2.0 * (scale > 1.0 ? scale : 1.0)) * 2 + 1;
}

static err_t axis_alloc(struct axis *a, int n_in, int n_out, struct arena *tmp)
{
    a->taps = taps_of(n_in, n_out);
    err_t e = arena_alloc(tmp, (size_t)n_out, sizeof *a->first, &a->first);
    if (!e)
        e = arena_alloc(tmp, (size_t)n_out, sizeof *a->count, &a->count);
    if (!e)
        e = arena_alloc(tmp, (size_t)n_out * (size_t)a->taps, sizeof *a->weight, &a->weight);
    return e;
}

static err_t scratch_alloc(struct scratch *s, int w, int h, int size, struct arena *tmp)
{
    err_t e = axis_alloc(&s->x, w, size, tmp);
    if (!e)
        e = axis_alloc(&s->y, h, size, tmp);
    if (!e)
        e = arena_alloc(tmp, (size_t)num_max(s->x.taps, s->y.taps), sizeof *s->row, &s->row);
    if (!e)
        e = arena_alloc(tmp, (size_t)h * (size_t)size, 3, &s->mid);
    return e;
}

/* Keys' cubic with a = -0.5. */
static double cubic_weight(double t)
{
    const double a = -0.5;
    t = fabs(t);
    if (t < 1.0)
        return ((a + 2.0) * t - (a + 3.0)) * t * t + 1.0;
    if (t < 2.0)
        return (((t - 5.0) * t + 8.0) * t - 4.0) * a;
    return 0.0;
}

static void axis_fill(struct axis *a, int n_in, int n_out, double *row)
{
    double scale = (double)n_in / n_out, f = scale > 1.0 ? scale : 1.0, support = 2.0 * f,
           inv = 1.0 / f;
    a->taps = taps_of(n_in, n_out);
    for (int i = 0; i < n_out; i++) {
        double c = (i + 0.5) * scale, sum = 0.0;
        int lo = num_max((int)(c - support + 0.5), 0), hi = (int)(c + support + 0.5);
        hi = hi < n_in ? hi : n_in;
        a->first[i] = lo;
        a->count[i] = hi - lo;
        for (int j = 0; j < hi - lo; j++) {
            row[j] = cubic_weight((j + lo - c + 0.5) * inv);
            sum += row[j];
        }
        int32_t *weight = a->weight + (size_t)i * (size_t)a->taps;
        for (int j = 0; j < hi - lo; j++) {
            double v = sum != 0.0 ? row[j] / sum : row[j];
            weight[j] = (int32_t)(v * (1 << WEIGHT_BITS) + (v < 0.0 ? -0.5 : 0.5));
        }
    }
}

static uint8_t clip8(int32_t sum)
{
    int32_t v = sum >> WEIGHT_BITS;
    return (uint8_t)(v < 0 ? 0 : v > 255 ? 255 : v);
}

/* in (w, 3) -> out (n_out, 3) */
static void row_across(const struct axis *a, const uint8_t *in, int n_out, uint8_t *out)
{
    for (int i = 0; i < n_out; i++) {
        const int32_t *weight = a->weight + (size_t)i * (size_t)a->taps;
        const uint8_t *px = in + 3 * (size_t)a->first[i];
        int32_t sum[3] = {1 << (WEIGHT_BITS - 1), 1 << (WEIGHT_BITS - 1), 1 << (WEIGHT_BITS - 1)};
        for (int j = 0; j < a->count[i]; j++)
            for (int c = 0; c < 3; c++)
                sum[c] += weight[j] * px[3 * j + c];
        for (int c = 0; c < 3; c++)
            out[3 * i + c] = clip8(sum[c]);
    }
}

/* Output row i from the rows of mid (h, n), n samples each. */
static void row_down(const struct axis *a, const uint8_t *mid, size_t n, int i, uint8_t *out)
{
    const int32_t *weight = a->weight + (size_t)i * (size_t)a->taps;
    const uint8_t *px = mid + (size_t)a->first[i] * n;
    for (size_t x = 0; x < n; x++) {
        int32_t sum = 1 << (WEIGHT_BITS - 1);
        for (int j = 0; j < a->count[i]; j++)
            sum += weight[j] * px[(size_t)j * n + x];
        out[x] = clip8(sum);
    }
}

static void resize_image(const struct image8 *in, int size, struct scratch *s, uint8_t *out)
{
    size_t n = 3 * (size_t)size;
    axis_fill(&s->x, in->w, size, s->row);
    axis_fill(&s->y, in->h, size, s->row);
    for (int y = 0; y < in->h; y++)
        row_across(&s->x, in->px + 3 * (size_t)y * (size_t)in->w, size, s->mid + (size_t)y * n);
    for (int y = 0; y < size; y++)
        row_down(&s->y, s->mid, n, y, out + (size_t)y * n);
}

static err_t check_image(const char *name, const struct image8 *im, bool has_pixels)
{
    if (!has_pixels || im->channels != 3 || im->w < 1 || im->h < 1 || im->w > SIDE_MAX ||
        im->h > SIDE_MAX)
        return err_fail(ERR_ARG,
                        "%s: picture of %d x %d px, %d channels, must be RGB of 1..%d px a side",
                        name, im->w, im->h, im->channels, SIDE_MAX);
    return OK;
}

static err_t check_size(int size)
{
    if (size < 1 || size > PREP_SIZE_MAX)
        return err_fail(ERR_ARG, "prep: views of %d px asked, allowed are 1 to %d", size,
                        PREP_SIZE_MAX);
    return OK;
}

err_t prep_resize(const struct image8 *in, int size, struct arena *tmp, uint8_t *out)
{
    err_t e = check_size(size);
    if (!e)
        e = check_image("prep", in, in->px != NULL);
    if (e)
        return e;
    size_t mark = arena_mark(tmp);
    struct scratch s;
    e = scratch_alloc(&s, in->w, in->h, size, tmp);
    if (!e)
        resize_image(in, size, &s, out);
    arena_reset(tmp, mark);
    return e;
}

int prep_places(const struct capture *c)
{
    int n = 0;
    for (int i = 0; i < c->n; i++)
        n += i == 0 || !c->shots[i].again;
    return n;
}

struct image8 prep_largest(const struct capture *c)
{
    struct image8 out = {.w = 1, .h = 1};
    for (int i = 0; i < c->n; i++) {
        out.w = num_max(out.w, c->shots[i].image.w);
        out.h = num_max(out.h, c->shots[i].image.h);
    }
    return out;
}

static err_t check_shot(const struct shot *s, const struct prep_source *from)
{
    err_t e = check_image(s->name, &s->image, from || s->image.px);
    if (e)
        return e;
    if (s->exposure == 0.0)
        return err_fail(ERR_ARG, "%s: its exposure is not known", s->name);
    if (!isfinite(s->exposure) || s->exposure < 0.0)
        return err_fail(ERR_ARG, "%s: exposure %g is not a finite number above 0", s->name,
                        s->exposure);
    if (s->has_camera && (s->cam.w != s->image.w || s->cam.h != s->image.h))
        return err_fail(ERR_ARG, "%s: its camera is for %d x %d px, the picture has %d x %d",
                        s->name, s->cam.w, s->cam.h, s->image.w, s->image.h);
    return OK;
}

static err_t check_capture(const struct capture *c, const struct prep_source *from, int size)
{
    err_t e = check_size(size);
    if (!e && c->n < 1)
        e = err_fail(ERR_ARG, "prep: the capture has no photograph");
    for (int i = 0; i < c->n && !e; i++)
        e = check_shot(&c->shots[i], from);
    return e;
}

static struct camera scaled_camera(const struct camera *cam, int size)
{
    struct camera s = *cam;
    float sx = (float)size / (float)cam->w, sy = (float)size / (float)cam->h;
    s.w = s.h = size;
    s.fx *= sx;
    s.cx *= sx;
    s.fy *= sy;
    s.cy *= sy;
    return s;
}

static err_t layout_views(struct views *v, struct arena *keep, int n_shots, int size)
{
    size_t n = (size_t)n_shots;
    err_t e = arena_alloc(keep, n, sizeof *v->names, &v->names);
    if (!e)
        e = arena_alloc(keep, n, 3 * (size_t)size * (size_t)size, &v->rgb);
    if (!e)
        e = arena_alloc(keep, n, sizeof *v->log2t, &v->log2t);
    if (!e)
        e = arena_alloc(keep, n, sizeof *v->cams, &v->cams);
    return e ? e : arena_alloc(keep, n, sizeof *v->place, &v->place);
}

static err_t views_alloc(const struct run *r, const struct capture *c, int size, struct views *v)
{
    err_t e = layout_views(v, r->keep, c->n, size);
    v->n = prep_places(c);
    v->n_more = c->n - v->n;
    v->size = size;
    for (int i = 0; i < c->n; i++)
        if (!c->shots[i].has_camera)
            v->cams = NULL;
    return e;
}

static void fill_photo(const struct shot *s, int k, struct views *v)
{
    memcpy(v->names[k], s->name, NAME_CAP);
    v->names[k][NAME_CAP - 1] = 0;
    v->log2t[k] = log2f((float)fmax(s->exposure, EXPOSURE_MIN));
}

/* Names, exposures and cameras. slot: index in *v of each shot; the first of a place comes first.
 * */
static void fill_metadata(const struct capture *c, struct views *v, int *slot)
{
    float low = INFINITY, high = -INFINITY;
    int place = 0, more = 0;
    for (int i = 0; i < c->n; i++) {
        bool again = i > 0 && c->shots[i].again;
        slot[i] = again ? v->n + more : place;
        if (again)
            v->place[more++] = place - 1;
        else if (v->cams)
            v->cams[place] = scaled_camera(&c->shots[i].cam, v->size);
        place += !again;
        fill_photo(&c->shots[i], slot[i], v);
        low = fminf(low, v->log2t[slot[i]]);
        high = fmaxf(high, v->log2t[slot[i]]);
    }
    v->mid_log2t = (low + high) / 2;
    v->aspect = (float)c->shots[0].image.h / (float)c->shots[0].image.w;
}

struct job {
    const struct run *r;
    const struct capture *c;
    const struct prep_source *from;
    struct views *v;
    int *slot;
    struct scratch *scratch; // one per worker
};

static err_t resize_shot(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    size_t view = 3 * (size_t)j->v->size * (size_t)j->v->size;
    struct image8 im = j->c->shots[chunk].image;
    err_t e = run_check(j->r, "prep");
    if (!e && j->from)
        e = j->from->decode(j->from->ctx, chunk, &im);
    if (e)
        return e;
    resize_image(&im, j->v->size, &j->scratch[worker], j->v->rgb + (size_t)j->slot[chunk] * view);
    if (j->from)
        j->from->release(&im);
    return OK;
}

static err_t layout(struct job *j, struct arena *tmp, int n, struct image8 most,
                    const int size_threads[2])
{
    const int threads = size_threads[1];
    err_t e = arena_alloc(tmp, (size_t)n, sizeof *j->slot, &j->slot);
    if (!e)
        e = arena_alloc(tmp, (size_t)threads, sizeof *j->scratch, &j->scratch);
    for (int i = 0; i < threads && !e; i++) {
        struct scratch s;
        e = scratch_alloc(&s, most.w, most.h, size_threads[0], tmp);
        if (!e && !tmp->counts)
            j->scratch[i] = s;
    }
    return e;
}

void prep_plan(struct plan *p, int n, struct image8 largest, int size)
{
    struct views v;
    struct job j;
    const size_t mark = arena_mark(&p->tmp);
    if (layout_views(&v, &p->keep, n, size) ||
        layout(&j, &p->tmp, n, largest, (int[2]){size, p->threads}))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t prep_read(const struct run *r, const struct capture *c, const struct prep_source *from,
                int size, struct views *out)
{
    memset(out, 0, sizeof *out);
    err_t e = check_capture(c, from, size);
    if (e)
        return e;
    struct views v = {0};
    size_t keep = arena_mark(r->keep), tmp = arena_mark(r->tmp);
    struct job j = {.r = r, .c = c, .from = from, .v = &v};
    e = views_alloc(r, c, size, &v);
    if (!e)
        e = layout(&j, r->tmp, c->n, prep_largest(c), (int[2]){size, pool_size(r->pool)});
    if (!e) {
        fill_metadata(c, &v, j.slot);
        e = pool_for(r->pool, c->n, resize_shot, &j);
    }
    arena_reset(r->tmp, tmp);
    if (e) {
        arena_reset(r->keep, keep);
        return e;
    }
    *out = v;
    return OK;
}

err_t prep_run(const struct run *r, const struct capture *c, int size, struct views *out)
{
    return prep_read(r, c, NULL, size, out);
}

void prep_to_float(const uint8_t *rgb, int size, float *out)
{
    float value[256];
    for (int i = 0; i < 256; i++) {
        float x = (float)i / 255.0f;
        x = x * 2.0f;
        x = x - 1.0f;
        x = x + 1.0f;
        value[i] = x * 0.5f;
    }
    size_t n = (size_t)size * (size_t)size;
    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 3; c++)
            out[c * n + i] = value[rgb[3 * i + c]];
}
