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

enum {
    WEIGHT_BITS = 22,
    SIDE_MAX = 1 << 20,
    RIM = 2 // px, reach of a cubic
};

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
    double *row;  // weights of one output before rounding
    uint8_t *mid; // (h in, w out, 3) after the horizontal pass
    uint16_t *mid16;
};

static int taps_of(int n_in, int n_out)
{
    double scale = (double)n_in / n_out;
    return (int)ceil(2.0 * (scale > 1.0 ? scale : 1.0)) * 2 + 1;
}

/* For at most n_in and n_out; taps_of times n_out never needs more weights. */
static err_t axis_alloc(struct axis *a, int n_in, int n_out, struct arena *tmp)
{
    const size_t weights = 4 * (size_t)num_max(n_in, n_out) + 3 * (size_t)n_out;
    err_t e = arena_alloc(tmp, (size_t)n_out, sizeof *a->first, &a->first);
    if (!e)
        e = arena_alloc(tmp, (size_t)n_out, sizeof *a->count, &a->count);
    return e ? e : arena_alloc(tmp, weights, sizeof *a->weight, &a->weight);
}

/* For pictures up to w x h px that become at most `size` px wide and high. */
static err_t scratch_alloc(struct scratch *s, int w, int h, int size, bool deep, struct arena *tmp)
{
    err_t e = axis_alloc(&s->x, w, size, tmp);
    if (!e)
        e = axis_alloc(&s->y, h, size, tmp);
    if (!e)
        e = arena_alloc(tmp, (size_t)num_max(num_max(w, h), size) + 5, sizeof *s->row, &s->row);
    if (!e)
        e = arena_alloc(tmp, (size_t)h * (size_t)size, 3, &s->mid);
    if (!e && deep)
        e = arena_alloc(tmp, (size_t)h * (size_t)size, 6, &s->mid16);
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

static void resize_image(const struct image8 *in, int w, int h, struct scratch *s, uint8_t *out)
{
    size_t n = 3 * (size_t)w;
    axis_fill(&s->x, in->w, w, s->row);
    axis_fill(&s->y, in->h, h, s->row);
    for (int y = 0; y < in->h; y++)
        row_across(&s->x, in->px + 3 * (size_t)y * (size_t)in->w, w, s->mid + (size_t)y * n);
    for (int y = 0; y < h; y++)
        row_down(&s->y, s->mid, n, y, out + (size_t)y * n);
}

static uint16_t clip16(int64_t sum)
{
    const int64_t v = sum >> WEIGHT_BITS;
    return (uint16_t)(v < 0 ? 0 : v > 65535 ? 65535 : v);
}

/* Out of n samples that lie `apart` values apart: output i of an axis, in 16 bits. */
static uint16_t sample16(const struct axis *a, const uint16_t *in, size_t apart, int i)
{
    const int32_t *weight = a->weight + (size_t)i * (size_t)a->taps;
    const uint16_t *px = in + (size_t)a->first[i] * apart;
    int64_t sum = 1 << (WEIGHT_BITS - 1);
    for (int j = 0; j < a->count[i]; j++)
        sum += (int64_t)weight[j] * px[(size_t)j * apart];
    return clip16(sum);
}

/* The same in 16 bits; out8: rounded. */
static void resize_image16(const struct image16 *in, const struct extent *to, struct scratch *s,
                           uint16_t *out, uint8_t *out8)
{
    const size_t n = 3 * (size_t)to->w;
    axis_fill(&s->x, in->w, to->w, s->row);
    axis_fill(&s->y, in->h, to->h, s->row);
    for (size_t y = 0; y < (size_t)in->h; y++)
        for (size_t x = 0; x < n; x++)
            s->mid16[y * n + x] =
                sample16(&s->x, in->px + 3 * y * (size_t)in->w + x % 3, 3, (int)(x / 3));
    for (int y = 0; y < to->h; y++)
        for (size_t x = 0; x < n; x++, out++) {
            *out = sample16(&s->y, s->mid16 + x, n, y);
            *out8++ = (uint8_t)((*out + 128) / 257);
        }
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

static err_t check_edge(int edge)
{
    if (edge < 1 || edge > PREP_SIZE_MAX)
        return err_fail(ERR_ARG, "prep: views of %d px requested, allowed are 1 to %d", edge,
                        PREP_SIZE_MAX);
    return OK;
}

err_t prep_resize(const struct image8 *in, int size, struct arena *tmp, uint8_t *out)
{
    err_t e = check_edge(size);
    if (!e)
        e = check_image("prep", in, in->px != NULL);
    if (e)
        return e;
    size_t mark = arena_mark(tmp);
    struct scratch s;
    e = scratch_alloc(&s, in->w, in->h, size, false, tmp);
    if (!e)
        resize_image(in, size, size, &s, out);
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

/* Exposures of one place are compared pixel by pixel. */
static err_t check_again(const struct shot *s, const struct shot *before)
{
    if (s->again && (s->image.w != before->image.w || s->image.h != before->image.h))
        return err_fail(ERR_ARG,
                        "%s: %d x %d px, but %s from the same place has %d x %d; exposures of one "
                        "place must have one size",
                        s->name, s->image.w, s->image.h, before->name, before->image.w,
                        before->image.h);
    return OK;
}

static err_t check_capture(const struct capture *c, const struct prep_source *from, int edge)
{
    err_t e = check_edge(edge);
    if (!e && c->n < 1)
        e = err_fail(ERR_ARG, "prep: the capture has no photograph");
    for (int i = 0; i < c->n && !e; i++) {
        e = check_shot(&c->shots[i], from);
        if (!e && i > 0)
            e = check_again(&c->shots[i], &c->shots[i - 1]);
    }
    return e;
}

static struct camera scaled_camera(const struct camera *cam, const struct extent *to)
{
    struct camera s = *cam;
    float sx = (float)to->w / (float)cam->w, sy = (float)to->h / (float)cam->h;
    s.w = to->w;
    s.h = to->h;
    s.fx *= sx;
    s.cx *= sx;
    s.fy *= sy;
    s.cy *= sy;
    return s;
}

struct extent prep_extent(struct prep_size size, int w, int h)
{
    const int most = num_max(w, h);
    const int edge = num_min(size.edge, num_max(most, PREP_ENLARGED));
    struct extent out = {edge, edge, 0};
    if (size.square)
        return (struct extent){size.edge, size.edge, 0};
    if (w < most)
        out.w = num_max(1, (int)lround((double)w * edge / most));
    if (h < most)
        out.h = num_max(1, (int)lround((double)h * edge / most));
    return out;
}

/* Index of each shot among the views: the first of a place comes before all that are `again`. */
static int slot_of(const struct capture *c, int i)
{
    int places = 0, more = 0;
    for (int k = 0; k < i; k++)
        *(k > 0 && c->shots[k].again ? &more : &places) += 1;
    return i > 0 && c->shots[i].again ? prep_places(c) + more : places;
}

void prep_extents(const struct capture *c, struct prep_size size, struct extent *out)
{
    size_t at = 0;
    for (int i = 0; i < c->n; i++)
        out[slot_of(c, i)] = prep_extent(size, c->shots[i].image.w, c->shots[i].image.h);
    for (int i = 0; i < c->n; at += extent_pixels(&out[i++]))
        out[i].at = at;
}

/* What is kept of the shots. */
struct content {
    bool deep, masked;
};

static err_t layout_views(struct views *v, struct arena *keep, int n_shots, size_t pixels,
                          struct content has)
{
    size_t n = (size_t)n_shots;
    err_t e = arena_alloc(keep, n, sizeof *v->names, &v->names);
    if (!e)
        e = arena_alloc(keep, n, sizeof *v->extent, &v->extent);
    if (!e)
        e = arena_alloc(keep, pixels, 3, &v->rgb);
    if (!e && has.deep)
        e = arena_alloc(keep, pixels, 6, &v->rgb16);
    if (!e && has.masked)
        e = arena_alloc(keep, pixels, 1, &v->masked);
    if (!e)
        e = arena_alloc(keep, n, sizeof *v->log2t, &v->log2t);
    if (!e)
        e = arena_alloc(keep, n, sizeof *v->cams, &v->cams);
    return e ? e : arena_alloc(keep, n, sizeof *v->place, &v->place);
}

static size_t count_pixels(const struct capture *c, struct prep_size size)
{
    size_t sum = 0;
    for (int i = 0; i < c->n; i++) {
        const struct extent e = prep_extent(size, c->shots[i].image.w, c->shots[i].image.h);
        sum += extent_pixels(&e);
    }
    return sum;
}

static err_t views_alloc(const struct run *r, const struct capture *c, struct prep_size size,
                         struct content has, struct views *v)
{
    err_t e = layout_views(v, r->keep, c->n, count_pixels(c, size), has);
    if (e)
        return e;
    v->n = prep_places(c);
    v->n_more = c->n - v->n;
    v->size = size.edge;
    v->deep = has.deep;
    v->srgb = c->shots[0].linear;
    v->aspect = size.square ? (float)c->shots[0].image.h / (float)c->shots[0].image.w : 1;
    prep_extents(c, size, v->extent);
    for (int i = 0; i < c->n; i++)
        if (!c->shots[i].has_camera)
            v->cams = NULL;
    return OK;
}

static void fill_photo(const struct shot *s, int k, struct views *v)
{
    memcpy(v->names[k], s->name, NAME_CAP);
    v->names[k][NAME_CAP - 1] = 0;
    v->log2t[k] = log2f((float)fmax(s->exposure, EXPOSURE_MIN));
}

/* Names, exposures and cameras. */
static void fill_metadata(const struct capture *c, struct views *v)
{
    float low = INFINITY, high = -INFINITY;
    for (int i = 0, place = -1, more = 0; i < c->n; i++) {
        const int k = slot_of(c, i);
        place += k < v->n;
        if (k >= v->n)
            v->place[more++] = place;
        else if (v->cams)
            v->cams[place] = scaled_camera(&c->shots[i].cam, &v->extent[k]);
        fill_photo(&c->shots[i], k, v);
        low = fminf(low, v->log2t[k]);
        high = fmaxf(high, v->log2t[k]);
    }
    v->mid_log2t = (low + high) / 2;
}

struct job {
    const struct run *r;
    const struct capture *c;
    const struct prep_source *from;
    struct views *v;
    struct scratch *scratch; // one per worker
};

static err_t resize_deep(const struct job *j, int i, int k, struct scratch *s)
{
    struct image16 im;
    err_t e = j->from->decode16(j->from->ctx, i, &im);
    if (e)
        return e;
    resize_image16(&im, &j->v->extent[k], s, views_rgb16(j->v, k), views_rgb(j->v, k));
    j->from->release16(&im);
    return OK;
}

void prep_mask(const uint8_t *rgb, const struct extent *px, uint8_t *masked)
{
    for (int k = 0; k < px->w * px->h; k++) {
        const int x = k % px->w, y = k / px->w;
        const int x0 = num_max(x - RIM, 0), x1 = num_min(x + RIM + 1, px->w);
        const int y1 = num_min(y + RIM + 1, px->h);
        masked[k] = 0;
        for (int v = num_max(y - RIM, 0); v < y1; v++)
            for (int u = x0; u < x1; u++)
                masked[k] |= rgb[3 * ((size_t)v * (size_t)px->w + (size_t)u)] < 255;
    }
}

/* The view's own pixels serve as workspace: they are written afterwards. */
static err_t resize_mask(const struct job *j, int i, int k, struct scratch *s)
{
    const struct extent *to = &j->v->extent[k];
    struct image8 im;
    memset(views_masked(j->v, k), 0, extent_pixels(to));
    if (!j->c->shots[i].masked)
        return OK;
    err_t e = j->from->decode_mask(j->from->ctx, i, &im);
    if (e)
        return e;
    resize_image(&im, to->w, to->h, s, views_rgb(j->v, k));
    prep_mask(views_rgb(j->v, k), to, views_masked(j->v, k));
    j->from->release(&im);
    return OK;
}

static err_t resize_shot(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    const int k = slot_of(j->c, chunk);
    const struct extent *to = &j->v->extent[k];
    struct image8 im = j->c->shots[chunk].image;
    err_t e = run_check(j->r, "prep");
    if (!e && j->v->masked)
        e = resize_mask(j, chunk, k, &j->scratch[worker]);
    if (!e && j->v->deep)
        return resize_deep(j, chunk, k, &j->scratch[worker]);
    if (!e && j->from)
        e = j->from->decode(j->from->ctx, chunk, &im);
    if (e)
        return e;
    resize_image(&im, to->w, to->h, &j->scratch[worker], views_rgb(j->v, k));
    if (j->from)
        j->from->release(&im);
    return OK;
}

static err_t layout(struct job *j, struct arena *tmp, struct image8 most, int edge, int threads,
                    bool deep)
{
    err_t e = arena_alloc(tmp, (size_t)threads, sizeof *j->scratch, &j->scratch);
    for (int i = 0; i < threads && !e; i++) {
        struct scratch s;
        e = scratch_alloc(&s, most.w, most.h, edge, deep, tmp);
        if (!e && !tmp->counts)
            j->scratch[i] = s;
    }
    return e;
}

bool prep_is_deep(const struct capture *c, const struct prep_source *from)
{
    bool deep = from && from->decode16;
    for (int i = 0; i < c->n; i++)
        deep = deep && c->shots[i].deep;
    return deep;
}

static struct content content_of(const struct capture *c, const struct prep_source *from)
{
    struct content out = {.deep = prep_is_deep(c, from)};
    for (int i = 0; i < c->n; i++)
        out.masked = out.masked || (from && from->decode_mask && c->shots[i].masked);
    return out;
}

static void plan_views(struct plan *p, int n, size_t pixels, struct image8 largest, int edge,
                       struct content has)
{
    struct views v;
    struct job j;
    const size_t mark = arena_mark(&p->tmp);
    if (layout_views(&v, &p->keep, n, pixels, has) ||
        layout(&j, &p->tmp, largest, edge, p->threads, has.deep))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

void prep_plan(struct plan *p, int n, size_t pixels, struct image8 largest, int edge)
{
    plan_views(p, n, pixels, largest, edge, (struct content){false, false});
}

void prep_plan_capture(struct plan *p, const struct capture *c, const struct prep_source *from,
                       struct prep_size size)
{
    plan_views(p, c->n, count_pixels(c, size), prep_largest(c), size.edge, content_of(c, from));
}

err_t prep_read(const struct run *r, const struct capture *c, const struct prep_source *from,
                struct prep_size size, struct views *out)
{
    memset(out, 0, sizeof *out);
    err_t e = check_capture(c, from, size.edge);
    if (e)
        return e;
    struct views v = {0};
    size_t keep = arena_mark(r->keep), tmp = arena_mark(r->tmp);
    struct job j = {.r = r, .c = c, .from = from, .v = &v};
    const struct content has = content_of(c, from);
    e = views_alloc(r, c, size, has, &v);
    if (!e)
        e = layout(&j, r->tmp, prep_largest(c), size.edge, pool_size(r->pool), has.deep);
    if (!e) {
        fill_metadata(c, &v);
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

err_t prep_run(const struct run *r, const struct capture *c, struct prep_size size,
               struct views *out)
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
