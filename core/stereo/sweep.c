/* For each view: choose neighbours by distance and exposure; sweep planes of equal inverse depth
 * rho, one step being at most about one pixel in the widest neighbour, with the cost of match.h;
 * keep the best half of the neighbours, of which the others are at most a little worse than the
 * best (occlusion); smooth by eight-path semi-global matching (Hirschmueller, PAMI 2008); refine by
 * a parabola. A first sweep on quarter size narrows the range of rho. Then slant.h makes the maps
 * with few neighbours finer, and points that other views confirm get confidence and the mean of the
 * confirming depths. */
#include "core/stereo/sweep.h"

#include "core/base/num.h"
#include "core/base/share.h"
#include "core/photo/response.h"
#include "core/stereo/match.h"
#include "core/stereo/sgm.h"
#include "core/stereo/slant.h"
#include "core/stereo/speck.h"
#include "core/stereo/transfer.h"

#include <math.h>
#include <string.h>

enum {
    WORK_SIZE = 256,  // px; largest size that is matched
    CHECK_MAX = 10,   // neighbours asked to confirm
    SLANT_FEW = 3,    // neighbours; with more, scenes are no better for it (tests/measured.md)
    SPECK_LEAST = 6,  // px, of pieces that one neighbour confirms
    SPECK_FEW = 24,   // with two neighbours, of which the cost counts the better one alone
    PLANES_MAX = 144, // multiple of 16
    COARSE = 4,       // the first sweep is this much smaller
    SUMS = 3,         // weighted moments of a window, D = I - J: w, wD, wDD
    COST_UNIT = 100,  // the cost 1.0 in sgm
    FINE = 3200,      // cost of 1.0 of one neighbour
    HIDDEN = (int)(MATCH_HIDDEN * FINE),
    COST_TOP = 16000 // above every cost of a neighbour, in FINE
};

/* Share of the best-seen depth that the nearest one has: ground at the lower border is in few
 * pictures. */
static const double SEEN_LEAST = 0.15;
static const double STEP_PX = 1.2;     // path of the fastest pixel per plane
static const float FAINT_VAR = 0.002f; // stops^2: fainter windows match any other
static const float ALIKE = 1;          // stop, two views of one surface

struct sweep {
    const struct run *run;
    const struct views *v;
    struct depthmaps *out;
    struct response_table table;
    struct transfer_pose *pose;       // (n)
    struct match_light *light_map[2]; // (n) fine, coarse
    int (*near)[CHECK_MAX];           // (n) other views, best first
    int *n_near;                      // (n)
    float *rho, *sure; // (maps) inverse depth of the sweep and its confidence 0..1; in `out` until
                       // the check
    float *fine, *fine_sure; // (maps) both made finer
    float (*range)[2];       // (n) inverse depth of the first and last plane
    struct scratch *scratch; // (workers)
    atomic_int done;         // views
};

/* Scratch of one worker, for the largest picture and number of planes. */
struct scratch {
    struct sgm sgm;
    float *contrast; // (y, x)
    float *mapped;   // (2, x) where the pixels of one row fall
    float *ring;     // (MATCH_NEAR_MAX, MATCH_TAPS, SUMS, x) moments of the rows of the window
    float *column;   // (MATCH_NEAR_MAX, SUMS, x + 2 MATCH_RADIUS) sums of `ring`
    int16_t *best;   // (MATCH_NEAR_MAX / 2 + 1, x) smallest costs of one row; then one row to merge
    int *list;       // (y, x)
    float *slope;    // (y, x, 2)
    float *cost;     // (y, x)
};

/* One sweep of one view. */
struct task {
    struct sweep *s;
    struct scratch *m;
    int i_view, level, w, rows, planes, n_near; // rows of w px
    float rho0, step;
    double h[MATCH_NEAR_MAX][12]; // to each neighbour: pixel, 1, rho -> pixel, homogeneous
};

/* ---- geometry ---- */

enum { GRID = 5, TRIES = 64 };

static const double UNIT[4] = {1, 1, 1, 1};

/* Share of a grid of pixels of view a at rho that falls into view b. */
static double shared_view(const double *h, double rho)
{
    int n = 0;
    for (int i = 0; i < GRID * GRID; i++) {
        double p[3], u = (i % GRID + 0.5) / GRID, v = (i / GRID + 0.5) / GRID;
        n += transfer_apply(h, u, v, rho, p) && p[0] > 0 && p[0] < 1 && p[1] > 0 && p[1] < 1;
    }
    return (double)n / (GRID * GRID);
}

/* Candidate inverse depths for a baseline b: 0, then from 1/(300 b) to 1/(0.5 b). */
static double candidate_rho(int k, double baseline)
{
    return k == 0 ? 0.0 : pow(600.0, (k - 1) / (double)(TRIES - 2)) / (300.0 * baseline);
}

/* ---- neighbours and range ---- */

/* Choose other views of the same surfaces; near ones with similar exposure come first. */
static void choose_near(struct sweep *s, int i)
{
    double score[CHECK_MAX];
    const struct transfer_pose *a = &s->pose[i];
    double scale = 0.0;
    for (int j = 0; j < s->v->n; j++)
        scale = fmax(scale, transfer_distance(a, &s->pose[j]));
    s->n_near[i] = 0;
    for (int j = 0; j < s->v->n; j++) {
        double h[12], seen = 0.0, d = transfer_distance(a, &s->pose[j]);
        if (j == i || d <= 1e-4 * scale)
            continue;
        transfer_map(a, &s->pose[j], UNIT, h);
        for (int k = 0; k < TRIES; k++)
            seen = fmax(seen, shared_view(h, candidate_rho(k, d)));
        if (seen < 0.25)
            continue;
        double cost = d * (1.0 + 0.1 * fabs((double)(s->v->log2t[i] - s->v->log2t[j]))) / seen;
        int k = s->n_near[i] < CHECK_MAX ? s->n_near[i]++ : CHECK_MAX;
        if (k == CHECK_MAX && score[--k] <= cost)
            continue;
        for (; k > 0 && score[k - 1] > cost; k--) {
            score[k] = score[k - 1];
            s->near[i][k] = s->near[i][k - 1];
        }
        score[k] = cost;
        s->near[i][k] = j;
    }
}

/* Choose the range of inverse depths at which the neighbours share much of the picture. */
static void choose_range(struct sweep *s, int i)
{
    int n = num_min(s->n_near[i], MATCH_NEAR_MAX);
    double baseline = 0.0, seen[TRIES] = {0}, top = 0.0;
    s->range[i][0] = s->range[i][1] = 0.0f;
    for (int k = 0; k < n; k++)
        baseline += transfer_distance(&s->pose[i], &s->pose[s->near[i][k]]) / n;
    for (int k = 0; k < n; k++) {
        double h[12];
        transfer_map(&s->pose[i], &s->pose[s->near[i][k]], UNIT, h);
        for (int t = 0; t < TRIES; t++)
            seen[t] += shared_view(h, candidate_rho(t, baseline));
    }
    for (int t = 0; t < TRIES; t++)
        top = fmax(top, seen[t]);
    int first = TRIES, last = 0;
    for (int t = 0; t < TRIES; t++) {
        if (seen[t] >= SEEN_LEAST * top) {
            first = num_min(first, t);
            last = t;
        }
    }
    if (n > 0) {
        s->range[i][0] = (float)candidate_rho(first, baseline);
        s->range[i][1] = (float)candidate_rho(last, baseline);
    }
}

/* Length of the path of a pixel in a neighbour over a range of inverse depth, px; 0 if it goes
 * behind the camera. */
static double path_px(const double *h, double u, double v, const float *range)
{
    double p[3], q[3], way = 0.0;
    if (!transfer_apply(h, u, v, (double)range[0], p))
        return 0.0;
    for (int j = 1; j <= 8; j++) {
        if (!transfer_apply(h, u, v, (double)range[0] + (double)(range[1] - range[0]) * j / 8, q))
            return 0.0;
        way += hypot(q[0] - p[0], q[1] - p[1]);
        memcpy(p, q, sizeof p);
    }
    return way;
}

/* Number of planes that makes a step STEP_PX where pixels move fastest; a multiple of 16. */
static int count_planes(const struct task *t, const float *range)
{
    double longest = 0.0;
    for (int k = 0; k < t->n_near; k++) {
        for (int i = 0; i < 9; i++) {
            double way = path_px(t->h[k], t->w * (i % 3) / 2.0, t->rows * (i / 3) / 2.0, range);
            longest = fmax(longest, way);
        }
    }
    return num_min(PLANES_MAX, ((int)fmin(longest / STEP_PX, 1e4) + 16) / 16 * 16);
}

/* ---- pictures ---- */

/* Log2 luminance and reliability of scale x scale pixels of a picture from their mean radiance.
 * w: px, of the picture. */
static void mean_light(const struct sweep *s, const uint8_t *rgb, int w, float shift, float *out)
{
    const int scale = s->out->scale;
    float sum = 0.0f, known = 0.0f;
    for (int k = 0; k < scale * scale; k++) {
        const uint8_t *p = rgb + 3 * ((size_t)(k / scale) * (size_t)w + (size_t)(k % scale));
        for (int c = 0; c < 3; c++) {
            sum += s->table.linear[c][p[c]];
            known += s->table.linear[c][p[c]] * s->table.weight[c][p[c]];
        }
    }
    out[0] = log2f(sum / (float)(3 * scale * scale) + 1e-9f) - shift;
    out[1] = known / (sum + 1e-12f);
}

static void shrink_light_map(const struct match_light *fine, const struct match_light *coarse)
{
    for (int k = 0; k < coarse->w * coarse->h; k++) {
        int x0 = k % coarse->w * COARSE, y0 = k / coarse->w * COARSE;
        float value = 0.0f, known = 0.0f;
        for (int j = 0; j < COARSE * COARSE; j++) {
            const float *px = fine->px + 2 * ((y0 + j / COARSE) * fine->w + x0 + j % COARSE);
            value += px[0] * (px[1] + 1e-6f); // the plain mean if none is reliable
            known += px[1] + 1e-6f;
        }
        coarse->px[2 * k] = value / known;
        coarse->px[2 * k + 1] = known / (COARSE * COARSE);
    }
}

static err_t make_light_map(void *ctx, int i, int worker)
{
    struct sweep *s = ctx;
    (void)worker;
    const int w = s->out->extent[i].w, full = s->v->extent[i].w;
    const size_t scale = (size_t)s->out->scale;
    const float shift = s->v->log2t[i] - s->v->mid_log2t;
    for (int k = 0; k < w * s->out->extent[i].h; k++) {
        size_t at = (size_t)(k / w) * scale * (size_t)full + (size_t)(k % w) * scale;
        float *px = s->light_map[0][i].px + 2 * (size_t)k;
        mean_light(s, views_rgb(s->v, i) + 3 * at, full, shift, px);
        if (sweep_hides(s->out, s->v, i, k))
            px[0] = px[1] = 0;
    }
    shrink_light_map(&s->light_map[0][i], &s->light_map[1][i]);
    return OK;
}

/* ---- matching cost ---- */

/* Map one row of w px at rho into the neighbour `to`, px; u is -1 outside its pixel centres. */
static void map_row(const double *h, const struct match_light *to, const int y_w[2], double rho,
                    float *u, float *v)
{
    const float du[3] = {(float)h[0], (float)h[4], (float)h[8]};
    const float right = (float)to->w - 1.0f, bottom = (float)to->h - 1.0f;
    const int y = y_w[0], w = y_w[1];
    float base[3];
    for (int i = 0; i < 3; i++)
        base[i] =
            (float)(h[4 * i] * 0.5 + h[4 * i + 1] * (y + 0.5) + h[4 * i + 2] + h[4 * i + 3] * rho);
    for (int x = 0; x < w; x++) {
        float z = base[2] + du[2] * (float)x, inv = 1.0f / z;
        u[x] = (base[0] + du[0] * (float)x) * inv - 0.5f;
        v[x] = (base[1] + du[1] * (float)x) * inv - 0.5f;
        bool in = (z > 1e-6f) & (u[x] >= 0.0f) & (v[x] >= 0.0f) & (u[x] < right) & (v[x] < bottom);
        u[x] = in ? u[x] : -1.0f;
    }
}

/* One row of moments at rho: weight, and differences to the neighbour at the mapped points. */
static void moment_row(const struct task *t, int k, int y, float rho, float *row)
{
    const int w = t->w;
    const float *p = t->s->light_map[t->level][t->i_view].px + 2 * (size_t)y * (size_t)w;
    const struct match_light *other = &t->s->light_map[t->level][t->s->near[t->i_view][k]];
    float *u = t->m->mapped, *v = u + w;
    map_row(t->h[k], other, (const int[2]){y, w}, (double)rho, u, v);
    for (int x = 0; x < w; x++) {
        if (u[x] < 0.0f) {
            row[x] = row[w + x] = row[2 * w + x] = 0.0f;
            continue;
        }
        float q[2];
        match_sample(other, u[x], v[x], q);
        const float weight = q[1] * p[2 * x + 1] + MATCH_INSIDE, diff = p[2 * x] - q[0];
        row[x] = weight;
        row[w + x] = weight * diff;
        row[2 * w + x] = weight * diff * diff;
    }
}

/* Cost of one row, in FINE per 1.0, from the column sums (padded by MATCH_RADIUS on both sides),
 * the weights of the row itself and the contrast of the view. */
static void cost_row(const float *column, const float *centre, const float *contrast, int w,
                     int16_t *restrict out)
{
    const float *c0 = column, *c1 = c0 + w + 2 * MATCH_RADIUS, *c2 = c1 + w + 2 * MATCH_RADIUS;
    for (int x = 0; x < w; x++) {
        const float m[SUMS] = {c0[x] + c0[x + 1] + c0[x + 2] + c0[x + 3] + c0[x + 4],
                               c1[x] + c1[x + 1] + c1[x + 2] + c1[x + 3] + c1[x + 4],
                               c2[x] + c2[x + 1] + c2[x + 2] + c2[x + 3] + c2[x + 4]};
        const float in = match_min(centre[x] * (1.0f / MATCH_INSIDE), 1.0f);
        const float cost = MATCH_OUTSIDE + in * (match_cost(m, contrast[x]) - MATCH_OUTSIDE);
        out[x] = (int16_t)(int)(cost * FINE);
    }
}

/* The smaller costs go to `low`, the larger stay in `cost`. */
static void keep_smallest(int16_t *restrict low, int16_t *restrict cost, int w)
{
    for (int x = 0; x < w; x++) {
        int16_t a = low[x], b = cost[x];
        int16_t least = a < b ? a : b;
        cost[x] = (int16_t)(a + b - least);
        low[x] = least;
    }
}

/* Move the window of neighbour k down to row y: add the row that enters, subtract the one that
 * leaves. */
static void move_window(const struct task *t, int k, int y, float rho)
{
    const int w = t->w, enter = y + MATCH_RADIUS;
    float *ring = t->m->ring +
                  (size_t)((k * MATCH_TAPS + (enter + MATCH_TAPS) % MATCH_TAPS) * SUMS) * (size_t)w;
    float *column =
        t->m->column + (size_t)(k * SUMS) * (size_t)(w + 2 * MATCH_RADIUS) + MATCH_RADIUS;
    for (int q = 0; q < SUMS && enter >= MATCH_TAPS; q++) {
        float *restrict c = column + q * (w + 2 * MATCH_RADIUS);
        for (int x = 0; x < w; x++)
            c[x] -= ring[q * w + x];
    }
    if (enter >= t->rows) {
        memset(ring, 0, (size_t)(SUMS * w) * sizeof *ring);
        return;
    }
    moment_row(t, k, enter, rho, ring);
    for (int q = 0; q < SUMS; q++) {
        float *restrict c = column + q * (w + 2 * MATCH_RADIUS);
        for (int x = 0; x < w; x++)
            c[x] += ring[q * w + x];
    }
}

static void cost_plane(const struct task *t, int d)
{
    const int w = t->w, kept = (t->n_near + 1) / 2;
    const float rho = t->rho0 + t->step * (float)d;
    struct scratch *m = t->m;
    memset(m->column, 0, (size_t)(MATCH_NEAR_MAX * SUMS * (w + 2 * MATCH_RADIUS)) * sizeof(float));
    for (int y = -MATCH_RADIUS; y < t->rows; y++) {
        for (int i = 0; i < kept * w; i++)
            m->best[i] = COST_TOP;
        for (int k = 0; k < t->n_near; k++) {
            move_window(t, k, y, rho);
            if (y < 0)
                continue;
            const float *centre =
                m->ring + (size_t)((k * MATCH_TAPS + y % MATCH_TAPS) * SUMS) * (size_t)w;
            int16_t *cost = m->best + kept * w;
            cost_row(m->column + k * SUMS * (w + 2 * MATCH_RADIUS), centre,
                     m->contrast + (size_t)y * (size_t)w, w, cost);
            for (int j = 0; j < kept; j++)
                keep_smallest(m->best + j * w, cost, w);
        }
        uint8_t *c = m->sgm.cost + ((size_t)y * (size_t)t->planes + (size_t)d) * (size_t)w;
        for (int x = 0; x < w && y >= 0; x++) {
            int sum = m->best[x];
            for (int k = 1; k < kept; k++)
                sum += num_min(m->best[k * w + x], m->best[x] + HIDDEN);
            sum = sum * COST_UNIT / (kept * FINE);
            c[x] = (uint8_t)(sum < 0 ? 0 : num_min(sum, 255));
        }
    }
}

/* ---- one view ---- */

/* Of a matching cost, and of half the inverse variance of the window. */
static float sure_of(float cost, float contrast)
{
    const float var = fmaxf(0.5f / contrast - MATCH_NOISE_VAR, 0.0f);
    const float match = (MATCH_BLIND - 0.02f - cost) / (0.5f * MATCH_BLIND);
    return fminf(fmaxf(match, 0.0f), 1.0f) * var / (var + FAINT_VAR);
}

/* Best plane, refined by a parabola through its neighbours. */
static void pick_planes(const struct task *t, float *rho, float *sure)
{
    const int w = t->w, planes = t->planes;
    for (int i = 0; i < w * t->rows; i++) {
        size_t at = (size_t)(i / w) * (size_t)planes * (size_t)w + (size_t)(i % w);
        const int16_t *s = t->m->sgm.total + at;
        int best = 0;
        for (int d = 1; d < planes; d++)
            best = s[d * w] < s[best * w] ? d : best;
        float shift = 0.0f;
        if (best > 0 && best < planes - 1) {
            float lo = s[(best - 1) * w], mid = s[best * w], hi = s[(best + 1) * w];
            float bend = lo + hi - 2.0f * mid;
            shift = bend > 0.0f ? 0.5f * (lo - hi) / bend : 0.0f;
        }
        rho[i] = t->rho0 + t->step * ((float)best + shift);
        sure[i] =
            sure_of((float)t->m->sgm.cost[at + (size_t)(best * w)] / COST_UNIT, t->m->contrast[i]);
    }
}

static void begin_level(struct task *t, int level)
{
    struct sweep *s = t->s;
    const float *range = s->range[t->i_view];
    const struct match_light *own = &s->light_map[level][t->i_view];
    t->level = level;
    t->w = own->w;
    t->rows = own->h;
    t->n_near = num_min(s->n_near[t->i_view], MATCH_NEAR_MAX);
    for (int k = 0; k < t->n_near; k++) {
        const int j = s->near[t->i_view][k];
        const struct match_light *other = &s->light_map[level][j];
        transfer_map(&s->pose[t->i_view], &s->pose[j],
                     (const double[4]){t->w, t->rows, other->w, other->h}, t->h[k]);
    }
    t->planes = count_planes(t, range);
    t->rho0 = range[0];
    t->step = (range[1] - range[0]) / (float)(t->planes - 1);
    for (int k = 0; k < t->w * t->rows; k++)
        t->m->contrast[k] = match_contrast(own, k % t->w, k / t->w);
}

static err_t check_cancel(const struct sweep *s, int i)
{
    if (s->run->cancel && atomic_load(s->run->cancel))
        return err_fail(ERR_CANCELLED, "sweep: cancelled at view %d", i);
    return OK;
}

static err_t sweep_level(struct task *t, int level, float *rho, float *sure)
{
    begin_level(t, level);
    for (int d = 0; d < t->planes; d++)
        cost_plane(t, d);
    t->m->sgm.w = t->w;
    t->m->sgm.h = t->rows;
    t->m->sgm.planes = t->planes;
    t->m->sgm.light = t->s->light_map[level][t->i_view].px;
    sgm_run(&t->m->sgm);
    pick_planes(t, rho, sure);
    return check_cancel(t->s, t->i_view);
}

/* Narrow the range to the confident pixels of the coarse sweep, with a margin. */
static void narrow_range(const struct task *t, const float *rho, const float *sure)
{
    int hist[PLANES_MAX] = {0}, total = 0, lo = 0, hi = t->planes - 1;
    for (int i = 0; i < t->w * t->rows; i++) {
        int d = (int)((rho[i] - t->rho0) / fmaxf(t->step, 1e-30f) + 0.5f);
        if (sure[i] > 0.4f && d >= 0 && d < t->planes) {
            hist[d]++;
            total++;
        }
    }
    if (total < t->w)
        return;
    for (int sum = hist[0]; sum * 500 < total; sum += hist[++lo])
        ;
    for (int sum = hist[hi]; sum * 500 < total; sum += hist[--hi])
        ;
    float *range = t->s->range[t->i_view], low = range[0];
    range[0] = fmaxf(t->rho0 + t->step * ((float)lo - 2.0f), low);
    range[1] = fminf(t->rho0 + t->step * ((float)hi + 2.0f), range[1]);
}

static err_t match_view(struct sweep *s, int i, int worker)
{
    struct task t = {.s = s, .m = &s->scratch[worker], .i_view = i};
    const size_t plane = extent_pixels(&s->out->extent[i]), at = s->out->extent[i].at;
    float *rho = s->rho + at, *sure = s->sure + at;
    choose_near(s, i);
    choose_range(s, i);
    if (s->range[i][1] <= s->range[i][0]) {
        for (size_t k = 0; k < plane; k++) {
            rho[k] = s->range[i][1] > 0.0f ? s->range[i][1] : 1.0f;
            sure[k] = 0.0f;
        }
        return OK;
    }
    if (num_min(s->light_map[1][i].w, s->light_map[1][i].h) >= 16) {
        err_t e = sweep_level(&t, 1, rho, sure);
        if (e)
            return e;
        narrow_range(&t, rho, sure);
    }
    return sweep_level(&t, 0, rho, sure);
}

/* Worker 0, the thread that runs the job, reports the progress of all: each view is seen twice. */
static void report(struct sweep *s, int worker)
{
    const struct run *r = s->run;
    const int done = atomic_fetch_add(&s->done, 1) + 1;
    if (worker == 0 && r->progress)
        r->progress(r->progress_ctx, "sweep", done, 2 * team_own(r->team, s->v->n), NULL);
}

static err_t sweep_view(void *ctx, int i, int worker)
{
    struct sweep *s = ctx;
    const err_t e = match_view(s, i, worker);
    if (!e)
        report(s, worker);
    return e;
}

/* Make a map with few neighbours finer; the maps of all views are there. */
static err_t slant_view(void *ctx, int i, int worker)
{
    struct sweep *s = ctx;
    struct scratch *m = &s->scratch[worker];
    struct task t = {.s = s, .m = m, .i_view = i};
    const size_t at = s->out->extent[i].at, plane = extent_pixels(&s->out->extent[i]);
    memcpy(s->fine + at, s->rho + at, plane * sizeof *s->fine);
    memcpy(s->fine_sure + at, s->sure + at, plane * sizeof *s->fine_sure);
    if (s->range[i][1] > s->range[i][0] && s->n_near[i] <= SLANT_FEW) {
        begin_level(&t, 0);
        struct slant p = {.own = &s->light_map[0][i],
                          .n_near = t.n_near,
                          .contrast = m->contrast,
                          .step = t.step,
                          .slope = m->slope,
                          .cost = m->cost};
        for (int k = 0; k < t.n_near; k++) {
            const int j = s->near[i][k];
            const size_t to = s->out->extent[j].at;
            p.near[k] = (struct slant_neighbour){
                .light = &s->light_map[0][j], .rho = s->rho + to, .sure = s->sure + to};
            memcpy(p.near[k].h, t.h[k], sizeof t.h[k]);
        }
        slant_refine(&p, s->fine + at);
        for (size_t k = 0; k < plane; k++)
            s->fine_sure[at + k] = sure_of(m->cost[k], m->contrast[k]);
    }
    report(s, worker);
    return check_cancel(s, i);
}

/* ---- agreement between the views ---- */

/* Whether pixel a of view i, if it is black or saturated, may show the surface of pixel b of
 * another view, which is measured. */
static bool is_bounded(const struct sweep *s, int i, const float *a, const float *b)
{
    const float shift = s->v->log2t[i] - s->v->mid_log2t;
    float range[2];
    response_bounds(&s->table, 1, a[0] + shift, a[1], range);
    return !(range[0] < range[1]) ||
           (b[0] + shift > range[0] - ALIKE && b[0] + shift < range[1] + ALIKE);
}

/* Depths of view i that other views confirm become the mean of all; the number of views gives the
 * confidence. */
static err_t confirm_view(void *ctx, int i, int worker)
{
    struct sweep *s = ctx;
    const struct extent *own = &s->out->extent[i];
    const int w = own->w, n = s->n_near[i];
    const float *rho = s->fine + own->at, *sure = s->fine_sure + own->at;
    const float *light = s->light_map[0][i].px;
    const float floor = 0.02f * s->range[i][1] + 1e-9f,
                step = (s->range[i][1] - s->range[i][0]) / 64.0f;
    double h[CHECK_MAX][12];
    for (int k = 0; k < n; k++) {
        const struct extent *to = &s->out->extent[s->near[i][k]];
        transfer_map(&s->pose[i], &s->pose[s->near[i][k]],
                     (const double[4]){own->w, own->h, to->w, to->h}, h[k]);
    }
    for (int at = 0; at < w * own->h; at++) {
        float sum = rho[at] * (sure[at] + 0.05f), weight = sure[at] + 0.05f, votes = 0.0f;
        for (int k = 0; k < n; k++) {
            const struct extent *to = &s->out->extent[s->near[i][k]];
            double p[3];
            if (!transfer_apply(h[k], at % w + 0.5, at / w + 0.5, (double)rho[at], p) || p[0] < 0 ||
                p[1] < 0 || p[0] >= to->w || p[1] >= to->h)
                continue;
            size_t j = to->at + (size_t)p[1] * (size_t)to->w + (size_t)p[0];
            float seen = s->fine[j] * (float)p[2];
            if (fabsf(seen - rho[at]) > fmaxf(step, 0.01f * rho[at]) ||
                !is_bounded(s, i, light + 2 * at,
                            s->light_map[0][s->near[i][k]].px + 2 * (j - to->at)))
                continue;
            sum += seen * s->fine_sure[j];
            weight += s->fine_sure[j];
            votes += s->fine_sure[j];
        }
        s->out->depth[own->at + (size_t)at] = 1.0f / fmaxf(sum / weight, floor);
        s->out->conf[own->at + (size_t)at] = fminf(votes / 2.0f, 1.0f) * (0.5f + 0.5f * sure[at]);
    }
    speck_drop(&(struct speck_map){w, own->h, s->out->depth + own->at, s->out->conf + own->at,
                                   SWEEP_CONF_USABLE, SWEEP_CONF_CONFIRMED,
                                   n > 2 ? SPECK_LEAST : SPECK_FEW, s->scratch[worker].list});
    return OK;
}

/* ---- memory and entry ---- */

int sweep_extents(const struct views *v, struct extent *out)
{
    const int scale = (v->size + WORK_SIZE - 1) / WORK_SIZE;
    size_t at = 0;
    for (int i = 0; i < v->n; at += extent_pixels(&out[i++]))
        out[i] = (struct extent){v->extent[i].w / scale, v->extent[i].h / scale, at};
    return scale;
}

static err_t layout_scratch(struct scratch *m, struct arena *a, struct extent most)
{
    const size_t w = (size_t)most.w;
    err_t e = sgm_init(&m->sgm, a, most.w, most.at, PLANES_MAX);
    if (!e)
        e = arena_alloc(a, most.at, sizeof *m->contrast, &m->contrast);
    if (!e)
        e = arena_alloc(a, 2 * w, sizeof *m->mapped, &m->mapped);
    if (!e)
        e = arena_alloc(a, MATCH_NEAR_MAX * MATCH_TAPS * SUMS * w, sizeof *m->ring, &m->ring);
    if (!e)
        e = arena_alloc(a, MATCH_NEAR_MAX * SUMS * (w + 2 * MATCH_RADIUS), sizeof *m->column,
                        &m->column);
    if (!e)
        e = arena_alloc(a, ((MATCH_NEAR_MAX + 1) / 2 + 1) * w, sizeof *m->best, &m->best);
    if (!e)
        e = arena_alloc(a, most.at, sizeof *m->list, &m->list);
    if (!e)
        e = arena_alloc(a, 2 * most.at, sizeof *m->slope, &m->slope);
    if (!e)
        e = arena_alloc(a, most.at, sizeof *m->cost, &m->cost);
    return e;
}

static err_t layout_extents(struct depthmaps *m, struct arena *keep, int n)
{
    return arena_alloc(keep, (size_t)n, sizeof *m->extent, &m->extent);
}

static err_t layout_maps(struct depthmaps *m, struct arena *keep, size_t pixels)
{
    err_t e = arena_alloc(keep, pixels, sizeof *m->depth, &m->depth);
    return e ? e : arena_alloc(keep, pixels, sizeof *m->conf, &m->conf);
}

static err_t make_maps(const struct run *r, const struct views *v, struct depthmaps *out)
{
    err_t e = layout_extents(out, r->keep, v->n);
    if (e)
        return e;
    out->n = v->n;
    out->scale = sweep_extents(v, out->extent);
    return layout_maps(out, r->keep, extent_total(out->extent, v->n));
}

static err_t layout_light_maps(struct sweep *s, struct arena *a, const struct extent *maps, int n)
{
    err_t e = OK;
    for (int level = 0; level < 2 && !e; level++)
        e = arena_alloc(a, (size_t)n, sizeof *s->light_map[0], &s->light_map[level]);
    for (int i = 0; i < 2 * n && !e; i++) {
        const int shrink = i % 2 ? COARSE : 1;
        struct match_light one = {.w = maps[i / 2].w / shrink, .h = maps[i / 2].h / shrink};
        e = arena_alloc(a, 2 * (size_t)one.w * (size_t)one.h, sizeof *one.px, &one.px);
        if (!e && !a->counts)
            s->light_map[i % 2][i / 2] = one;
    }
    return e;
}

/* A counting arena has no memory for the lists themselves. */
static err_t layout(struct sweep *s, struct arena *a, const struct extent *maps, int workers)
{
    const size_t n = (size_t)s->v->n, pixels = extent_total(maps, s->v->n);
    err_t e = arena_alloc(a, n, sizeof *s->pose, &s->pose);
    if (!e)
        e = layout_light_maps(s, a, maps, s->v->n);
    if (!e)
        e = arena_alloc(a, n, sizeof *s->near, &s->near);
    if (!e)
        e = arena_alloc(a, n, sizeof *s->n_near, &s->n_near);
    if (!e)
        e = arena_alloc(a, n, sizeof *s->range, &s->range);
    if (!e)
        e = arena_alloc(a, pixels, sizeof *s->fine, &s->fine);
    if (!e)
        e = arena_alloc(a, pixels, sizeof *s->fine_sure, &s->fine_sure);
    if (!e)
        e = arena_alloc(a, (size_t)workers, sizeof *s->scratch, &s->scratch);
    for (int k = 0; k < workers && !e; k++) {
        struct scratch one = {0};
        e = layout_scratch(&one, a, extent_cover(maps, s->v->n));
        if (!e && !a->counts)
            s->scratch[k] = one;
    }
    return e;
}

void sweep_plan(struct plan *p, const struct views *v, const struct extent *maps)
{
    struct sweep s = {.v = v};
    struct depthmaps out;
    const size_t mark = arena_mark(&p->tmp);
    if (layout_extents(&out, &p->keep, v->n) ||
        layout_maps(&out, &p->keep, extent_total(maps, v->n)) ||
        layout(&s, &p->tmp, maps, p->threads))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

static err_t check_input(const struct views *v)
{
    if (v->n < 1 || !v->cams)
        return err_fail(ERR_ARG, "sweep: %d views %s cameras, must be at least 1 with cameras",
                        v->n, v->cams ? "with" : "without");
    for (int i = 0; i < v->n; i++) {
        const struct camera *c = &v->cams[i];
        if (num_min(v->extent[i].w, v->extent[i].h) < SWEEP_SIZE_MIN)
            return err_fail(ERR_ARG, "sweep: view %d has %d x %d px, must be at least %d a side", i,
                            v->extent[i].w, v->extent[i].h, SWEEP_SIZE_MIN);
        float sum = v->log2t[i] + c->fx + c->fy + c->cx + c->cy;
        float q = c->q[0] * c->q[0] + c->q[1] * c->q[1] + c->q[2] * c->q[2] + c->q[3] * c->q[3];
        if (!isfinite(sum + q + c->t[0] + c->t[1] + c->t[2]) || c->w < 1 || c->h < 1)
            return err_fail(ERR_ARG, "sweep: camera or exposure of view %d is not finite", i);
        if (c->fx <= 0.0f || c->fy <= 0.0f || q < 1e-12f)
            return err_fail(ERR_ARG,
                            "sweep: view %d has focal lengths %g, %g px and rotation of length %g, "
                            "all must be above 0",
                            i, (double)c->fx, (double)c->fy, sqrt((double)q));
    }
    return OK;
}

err_t sweep_run(const struct run *r, const struct views *v, const struct tonemap *tone,
                struct depthmaps *out)
{
    struct sweep s = {.run = r, .v = v, .out = out};
    size_t mark = arena_mark(r->tmp), keep = arena_mark(r->keep);
    memset(out, 0, sizeof *out);
    err_t e = check_input(v);
    if (e)
        return e;
    e = make_maps(r, v, out);
    s.rho = out->depth;
    s.sure = out->conf;
    if (!e)
        e = layout(&s, r->tmp, out->extent, pool_size(r->pool));
    if (!e) {
        response_tabulate(tone, &s.table);
        for (int i = 0; i < v->n; i++)
            transfer_pose_set(&v->cams[i], &s.pose[i]);
        e = pool_for(r->pool, v->n, make_light_map, &s);
    }
    if (!e)
        e = share_for(r, v->n, sweep_view, &s);
    if (!e)
        e = share_gather(r, s.rho, sizeof *s.rho, out->extent, v->n);
    if (!e)
        e = share_gather(r, s.sure, sizeof *s.sure, out->extent, v->n);
    if (!e)
        e = share_for(r, v->n, slant_view, &s);
    if (!e)
        e = share_gather(r, s.fine, sizeof *s.fine, out->extent, v->n);
    if (!e)
        e = share_gather(r, s.fine_sure, sizeof *s.fine_sure, out->extent, v->n);
    if (!e)
        e = share_for(r, v->n, confirm_view, &s);
    if (!e)
        e = share_gather(r, out->depth, sizeof *out->depth, out->extent, v->n);
    if (!e)
        e = share_gather(r, out->conf, sizeof *out->conf, out->extent, v->n);
    arena_reset(r->tmp, mark);
    if (e) {
        arena_reset(r->keep, keep);
        memset(out, 0, sizeof *out);
    }
    return e;
}
