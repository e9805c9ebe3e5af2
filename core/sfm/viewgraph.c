/* 1. Relative poses of all pairs of views with enough common tracks: twoview_run.
 * 2. Rotations: spanning tree over the edges with most inliers and fewest contradictions in
 *    triplets; then all edges, in the tangent space, weights of L1, later Geman-McClure (Chatterjee
 *    and Govindu, "Efficient and robust large-scale rotation averaging", 2013). Edges that
 *    deviate by some degrees are wrong.
 * 3. Observations that contradict too many others of their track are removed.
 * 4. Centres C and points X for known rotations: sum of w |(I - d d^T)(X - C)|^2 over observations
 *    with rays d is quadratic. Points are eliminated; the eigenvector of the smallest eigenvalue,
 *    across common translations, is the solution up to scale and sign. Weights w bring residuals
 *    to angles (1 / depth^2) and make them robust (Cauchy); a few rounds. */
#include "core/sfm/viewgraph.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"

#include <math.h>
#include <string.h>

enum {
    MATCHES_MOST = 400,
    COMMON_LEAST = 12,
    ROUNDS_L1 = 10,
    ROUNDS_GM = 10,
    BLOCK = 256,
    CENTRE_ROUNDS = 8,
    POWER_STEPS = 20,
    PRODUCTS_MOST = 200000, // pairs of observations that centres are taken from, or so many a view:
    PRODUCTS_VIEW = 3125
};
static const double DEGREE = NUM_PI / 180, PLANE_MOST = 20;

static struct viewgraph_edge *edge_of(const struct viewgraph *g, int a, int b)
{
    return &g->edge[b * (b - 1) / 2 + a];
}

static double *pose_of(const struct adjust *a, int view)
{
    return a->pose + (size_t)ADJUST_POSE * (size_t)view;
}

/* ---- pairs ---- */

struct observation_ref {
    int track, at; // at: index of the observation
};

struct pairs_job {
    const struct run *r;
    const struct adjust *a;
    struct viewgraph *g;
    struct observation_ref *list; // observations by view, then track
    int *first, *fill;            // (n_views + 1) of each view in list; its next one
};

/* x/z and y/z of an observation's ray, not farther out than PLANE_MOST, and its expected error
 * there. */
static void plane_of(const struct adjust *a, const struct adjust_observation *s, double x[2],
                     double *sigma)
{
    double ray[3];
    adjust_ray(a, s, ray);
    const double z = fmax(ray[2], 1 / PLANE_MOST);
    for (int k = 0; k < 2; k++)
        x[k] = ray[k] / z;
    *sigma = 1 / ((double)s->weight * adjust_focal(a, s->view));
}

static struct twoview_match match_of(const struct adjust *a, int i, int j)
{
    const struct adjust_observation *s = &a->obs[i], *t = &a->obs[j];
    struct twoview_match m;
    plane_of(a, s, m.a, &m.sigma_a);
    plane_of(a, t, m.b, &m.sigma_b);
    return m;
}

/* Matches of two views, every stride-th of them; returns how many there are. */
static int gather_matches(const struct pairs_job *job, int a, int b, int stride,
                          struct twoview_match *out)
{
    const struct observation_ref *p = job->list + job->first[a], *q = job->list + job->first[b];
    const struct observation_ref *p_end = job->list + job->first[a + 1];
    const struct observation_ref *q_end = job->list + job->first[b + 1];
    int n = 0;
    while (p < p_end && q < q_end) {
        if (p->track == q->track) {
            if (out && n % stride == 0)
                out[n / stride] = match_of(job->a, p->at, q->at);
            n++;
        }
        int step = p->track - q->track;
        p += step <= 0;
        q += step >= 0;
    }
    return n;
}

static err_t pair_chunk(void *ctx, int chunk, int worker)
{
    struct pairs_job *job = ctx;
    struct twoview_match m[MATCHES_MOST];
    struct viewgraph_edge *e = &job->g->edge[chunk];
    int b = 1;
    (void)worker;
    while (b * (b + 1) / 2 <= chunk)
        b++;
    const int a = chunk - b * (b - 1) / 2;
    *e = (struct viewgraph_edge){.n = gather_matches(job, a, b, 1, NULL)};
    if (e->n < COMMON_LEAST)
        return OK;
    const int stride = (e->n + MATCHES_MOST - 1) / MATCHES_MOST;
    const int n = (e->n + stride - 1) / stride;
    gather_matches(job, a, b, stride, m);
    twoview_run(m, n, 1u + (uint32_t)chunk, &e->pose);
    e->ok = e->pose.inliers >= 10 + n / 5;
    return run_check(job->r, "relative poses");
}

static err_t layout_list(struct pairs_job *j, struct arena *tmp, int n_views, int n_obs)
{
    const size_t n = (size_t)n_views + 1;
    err_t e = arena_alloc(tmp, (size_t)n_obs, sizeof *j->list, &j->list);
    if (!e)
        e = arena_zalloc(tmp, n, sizeof *j->first, &j->first);
    return e ? e : arena_zalloc(tmp, n, sizeof *j->fill, &j->fill);
}

err_t viewgraph_pairs(const struct run *r, const struct adjust *a, struct viewgraph *g)
{
    struct pairs_job job = {.r = r, .a = a, .g = g};
    const size_t mark = arena_mark(r->tmp);
    g->n_views = a->n_views;
    err_t e = layout_list(&job, r->tmp, a->n_views, a->first[a->n_tracks]);
    if (!e) {
        for (int i = 0; i < a->first[a->n_tracks]; i++)
            job.first[a->obs[i].view + 1]++;
        for (int v = 0; v < a->n_views; v++) {
            job.fill[v] = job.first[v];
            job.first[v + 1] += job.first[v];
        }
        for (int t = 0; t < a->n_tracks; t++)
            for (int i = a->first[t]; i < a->first[t + 1]; i++)
                job.list[job.fill[a->obs[i].view]++] = (struct observation_ref){t, i};
        e = pool_for(r->pool, viewgraph_edges(a->n_views), pair_chunk, &job);
    }
    arena_reset(r->tmp, mark);
    return e;
}

/* ---- rotations ---- */

/* Rotation from view i to view j along their edge. */
static void relative_rotation(const struct viewgraph *g, int i, int j, double r[9])
{
    if (i < j) {
        memcpy(r, edge_of(g, i, j)->pose.r, 9 * sizeof *r);
        return;
    }
    const double *s = edge_of(g, j, i)->pose.r;
    for (int k = 0; k < 9; k++)
        r[k] = s[3 * (k % 3) + k / 3];
}

static bool is_linked(const struct viewgraph *g, int i, int j)
{
    return i < j ? edge_of(g, i, j)->ok : i > j && edge_of(g, j, i)->ok;
}

/* Angle of the rotation around a loop of three views, radians; 0 if they agree. */
static double loop_error(const struct viewgraph *g, int i, int j, int k)
{
    double ij[9], jk[9], ki[9], two[9], all[9], w[3];
    relative_rotation(g, i, j, ij);
    relative_rotation(g, j, k, jk);
    relative_rotation(g, k, i, ki);
    lin_product(jk, ij, two);
    lin_product(ki, two, all);
    rotation_log(all, w);
    return sqrt(lin_dot(w, w));
}

/* Inliers times the share of triplets that close. */
static double edge_trust(const struct viewgraph *g, int i, int j)
{
    int good = 0, bad = 0;
    if (!is_linked(g, i, j))
        return 0;
    for (int k = 0; k < g->n_views; k++)
        if (is_linked(g, i, k) && is_linked(g, j, k)) {
            bool closes = loop_error(g, i, j, k) < 3 * DEGREE;
            good += closes;
            bad += !closes;
        }
    const struct viewgraph_edge *e = i < j ? edge_of(g, i, j) : edge_of(g, j, i);
    return e->pose.inliers * (good + 0.5) / (good + bad + 0.5);
}

/* Dense systems over the views. */
struct averaging {
    double *weight, *h, *x; // (n, n) trust of edges; (n, n) Laplacian; (3, n) right-hand sides
    int *part, *size;       // (n) number of the part that a view is connected with; its views
};

static err_t layout_averaging(struct averaging *m, struct arena *tmp, int n_views)
{
    const size_t n = (size_t)n_views;
    err_t e = arena_alloc(tmp, n * n, sizeof *m->weight, &m->weight);
    if (!e)
        e = arena_alloc(tmp, n * n, sizeof *m->h, &m->h);
    if (!e)
        e = arena_alloc(tmp, 3 * n, sizeof *m->x, &m->x);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *m->part, &m->part);
    return e ? e : arena_zalloc(tmp, n, sizeof *m->size, &m->size);
}

/* The first view of the largest part that edges of some trust connect; its size. */
static int find_largest(const struct averaging *m, int n, int *most)
{
    int root = 0;
    for (int v = 0; v < n; v++)
        m->part[v] = v;
    for (int i = 0; i < n * n; i++) {
        const int from = m->part[i / n], to = m->part[i % n];
        for (int v = 0; v < n && m->weight[i] > 0 && from != to; v++)
            m->part[v] = m->part[v] == from ? to : m->part[v];
    }
    for (int v = 0; v < n; v++)
        m->size[m->part[v]]++;
    for (int v = 0; v < n; v++)
        root = m->size[m->part[v]] > m->size[m->part[root]] ? v : root;
    *most = m->size[m->part[root]];
    return root;
}

/* Set the rotations of the views that can be reached from the root, along the most trusted edges.
 */
static void spread_rotations(const struct viewgraph *g, const double *weight, int root,
                             struct adjust *a)
{
    const int n = g->n_views;
    for (int v = 0; v < n; v++) {
        a->placed[v] = v == root;
        memset(pose_of(a, v), 0, ADJUST_POSE * sizeof *a->pose);
        for (int k = 0; k < 3; k++)
            pose_of(a, v)[4 * k] = 1;
    }
    for (;;) {
        int from = -1, to = -1;
        double most = 0, r[9];
        for (int i = 0; i < n * n; i++)
            if (a->placed[i / n] && !a->placed[i % n] && weight[i] > most) {
                most = weight[i];
                from = i / n;
                to = i % n;
            }
        if (to < 0)
            return;
        relative_rotation(g, from, to, r);
        lin_product(r, pose_of(a, from), pose_of(a, to));
        a->placed[to] = true;
    }
}

/* Error of an edge in the world's axes: the rotation that view j lacks relative to view i.
 * returns: its angle. */
static double edge_error(const struct viewgraph *g, const struct adjust *a, int i, int j,
                         double out[3])
{
    double r[9], expected[9], all[9];
    relative_rotation(g, i, j, r);
    lin_product(r, pose_of(a, i), expected);
    for (int p = 0; p < 3; p++)
        for (int q = 0; q < 3; q++)
            all[3 * p + q] = pose_of(a, j)[p] * expected[q] +
                             pose_of(a, j)[3 + p] * expected[3 + q] +
                             pose_of(a, j)[6 + p] * expected[6 + q];
    rotation_log(all, out);
    return sqrt(lin_dot(out, out));
}

/* One weighted round: Laplacian of the graph, three right-hand sides. */
static void average_rotations(const struct viewgraph *g, const struct averaging *m, bool l1,
                              struct adjust *a)
{
    const int n = g->n_views;
    const double width = 1 * DEGREE;
    double *h = m->h, *x[3] = {m->x, m->x + n, m->x + 2 * n};
    memset(h, 0, (size_t)n * (size_t)n * sizeof *h);
    memset(m->x, 0, 3 * (size_t)n * sizeof *m->x);
    for (int j = 0; j < n; j++)
        for (int i = 0; i < j; i++) {
            double e[3], w = m->weight[i * n + j];
            if (!(w > 0) || !a->placed[i] || !a->placed[j])
                continue;
            double size = edge_error(g, a, i, j, e);
            double soft = width * width / (width * width + size * size);
            w *= l1 ? width / fmax(size, 0.1 * width) : soft * soft;
            h[j * n + i] -= w;
            h[i * n + i] += w;
            h[j * n + j] += w;
            for (int k = 0; k < 3; k++) {
                x[k][j] += w * e[k];
                x[k][i] -= w * e[k];
            }
        }
    for (int i = 0; i < n; i++)
        h[i * n + i] += h[i * n + i] > 0 ? 1e-9 * h[i * n + i] : 1;
    if (!lin_cholesky(h, n))
        return;
    for (int k = 0; k < 3; k++)
        lin_solve(h, n, x[k]);
    for (int v = 0; v < n; v++) {
        const double w[3] = {x[0][v], x[1][v], x[2][v]};
        double turn[9], old[9];
        rotation_exp(w, turn);
        memcpy(old, pose_of(a, v), sizeof old);
        lin_product(old, turn, pose_of(a, v));
    }
}

/* Take `ok` from edges that contradict the rotations; views with such edges only are not placed.
 * returns: their number. */
static int remove_wrong(struct viewgraph *g, struct adjust *a)
{
    const int n = g->n_views;
    int lost = 0;
    double e[3];
    for (int j = 0; j < n; j++)
        for (int i = 0; i < j; i++)
            if (a->placed[i] && a->placed[j] && edge_error(g, a, i, j, e) > 4 * DEGREE)
                edge_of(g, i, j)->ok = false;
    for (int i = 0; i < n; i++) {
        bool any = false;
        for (int j = 0; j < n; j++)
            any |= a->placed[j] && is_linked(g, i, j);
        if (a->placed[i] && !any) {
            a->placed[i] = false;
            lost++;
        }
    }
    return lost;
}

err_t viewgraph_rotations(const struct run *r, struct viewgraph *g, struct adjust *a, int *n_placed)
{
    const size_t mark = arena_mark(r->tmp);
    const int n = g->n_views;
    struct averaging m;
    int most;
    *n_placed = 0;
    err_t e = layout_averaging(&m, r->tmp, n);
    if (e)
        return e;
    for (int i = 0; i < n * n; i++)
        m.weight[i] = edge_trust(g, i / n, i % n);
    spread_rotations(g, m.weight, find_largest(&m, n, &most), a);
    for (int k = 0; k < ROUNDS_L1 + ROUNDS_GM && !e; k++) {
        average_rotations(g, &m, k < ROUNDS_L1, a);
        e = run_check(r, "rotations of cameras");
    }
    most -= remove_wrong(g, a);
    *n_placed = most > 1 ? most : 0;
    arena_reset(r->tmp, mark);
    return e;
}

/* ---- core ---- */

/* What the edges of view v say of distances to the views that are chosen, or to all that are
 * placed. */
static int64_t sum_parallax(const struct viewgraph *g, const struct adjust *a, const bool *chosen,
                            int v)
{
    int64_t sum = 0;
    for (int u = 0; u < g->n_views; u++) {
        if (!is_linked(g, u, v) || !(chosen ? chosen[u] : a->placed[u]))
            continue;
        const struct viewgraph_edge *e = u < v ? edge_of(g, u, v) : edge_of(g, v, u);
        sum += e->pose.parallax ? e->pose.inliers : 0;
    }
    return sum;
}

void viewgraph_core(const struct viewgraph *g, int most, struct adjust *a)
{
    bool chosen[VIEWGRAPH_VIEWS_MAX] = {false};
    for (int n = 0; n < most; n++) {
        int64_t best = 0;
        int next = -1;
        for (int v = 0; v < g->n_views; v++) {
            const int64_t sum =
                a->placed[v] && !chosen[v] ? sum_parallax(g, a, n ? chosen : NULL, v) : 0;
            if (sum > best) {
                best = sum;
                next = v;
            }
        }
        if (next < 0)
            break;
        chosen[next] = true;
    }
    memcpy(a->placed, chosen, (size_t)g->n_views * sizeof *chosen);
}

/* ---- votes ---- */

struct vote_job {
    const struct run *r;
    const struct viewgraph *g;
    struct adjust *a;
};

static bool is_consistent(const struct viewgraph *g, const struct adjust *a, int i, int j)
{
    const struct twoview_match m = match_of(a, i, j);
    const struct viewgraph_edge *e = edge_of(g, a->obs[i].view, a->obs[j].view);
    return twoview_distance(&e->pose, &m) < 4.0 * TWOVIEW_GATE * TWOVIEW_GATE;
}

/* Other observations of a track that are in and can be compared with one, and those that agree. */
struct votes {
    int known, good;
};

/* Add (by 1) or take away (by -1) what observation j and those before `end` that are in say of each
 * other. vote: of the track. */
static void count_votes(const struct viewgraph *g, const struct adjust *a, const int at[3], int by,
                        struct votes *vote)
{
    const int from = at[0], j = at[1], end = at[2];
    for (int i = from; i < end; i++) {
        if (i == j || !a->in[i] || !is_linked(g, a->obs[i].view, a->obs[j].view))
            continue;
        const int good = by * is_consistent(g, a, num_min(i, j), num_max(i, j));
        vote[i - from].known += by;
        vote[j - from].known += by;
        vote[i - from].good += good;
        vote[j - from].good += good;
    }
}

/* Remove the observation that agrees with the smallest share of the others, until all agree with 60
 * %. */
static void vote_track(const struct viewgraph *g, struct adjust *a, int track)
{
    const int from = a->first[track], n = a->first[track + 1] - from;
    struct votes vote[VIEWGRAPH_VIEWS_MAX] = {{0}};
    for (int j = from; j < from + n; j++) {
        a->in[j] = a->placed[a->obs[j].view];
        if (a->in[j])
            count_votes(g, a, (const int[3]){from, j, j}, 1, vote);
    }
    for (;;) {
        int worst = -1;
        double least = 0.6;
        for (int i = 0; i < n; i++) {
            if (!a->in[from + i])
                continue;
            double share = vote[i].known ? vote[i].good / (double)vote[i].known : 0;
            if (share < least) {
                least = share;
                worst = from + i;
            }
        }
        if (worst < 0)
            break;
        a->in[worst] = false;
        count_votes(g, a, (const int[3]){from, worst, from + n}, -1, vote);
    }
}

static err_t vote_block(void *ctx, int chunk, int worker)
{
    struct vote_job *job = ctx;
    (void)worker;
    for (int t = chunk * BLOCK; t < num_min((chunk + 1) * BLOCK, job->a->n_tracks); t++)
        vote_track(job->g, job->a, t);
    return run_check(job->r, "votes of tracks");
}

err_t viewgraph_vote(const struct run *r, const struct viewgraph *g, struct adjust *a)
{
    struct vote_job job = {r, g, a};
    return pool_for(r->pool, (a->n_tracks + BLOCK - 1) / BLOCK, vote_block, &job);
}

/* ---- centres ---- */

struct centres {
    struct adjust *a;
    int n;           // 3 V
    double *sum;     // (n, n)
    double *x;       // (n) centres
    double *weight;  // (observations)
    double *sighted; // (n) sums of weights, three times each
    int stride;      // of the tracks that are used
};

static void world_direction(const struct adjust *a, int at, double d[3])
{
    const struct adjust_observation *s = &a->obs[at];
    double ray[3];
    adjust_ray(a, s, ray);
    lin_apply_t(pose_of(a, s->view), ray, d);
}

/* w (I - d d^T) */
static void ray_projector(const double d[3], double w, double p[9])
{
    for (int k = 0; k < 9; k++)
        p[k] = w * ((k % 4 == 0) - d[k / 3] * d[k % 3]);
}

/* Inverse of the sum of the track's projections; false if it is seen only once. */
static bool track_inverse(const struct centres *c, int track, double inverse[9])
{
    double sum[9] = {0}, p[9], d[3];
    int n = 0;
    for (int i = c->a->first[track]; i < c->a->first[track + 1]; i++) {
        if (!c->a->in[i])
            continue;
        world_direction(c->a, i, d);
        ray_projector(d, c->weight[i], p);
        for (int k = 0; k < 9; k++)
            sum[k] += p[k];
        n++;
    }
    double trace = sum[0] + sum[4] + sum[8];
    for (int k = 0; k < 3; k++)
        sum[4 * k] += 1e-9 * trace;
    return n > 1 && lin_inverse3(sum, inverse);
}

static void add_track(struct centres *c, int track)
{
    const struct adjust *a = c->a;
    double inverse[9], p[9], q[9], d[3], half[9], block[9];
    if (!track_inverse(c, track, inverse))
        return;
    for (int i = a->first[track]; i < a->first[track + 1]; i++) {
        if (!a->in[i])
            continue;
        world_direction(a, i, d);
        ray_projector(d, c->weight[i], p);
        lin_product(p, inverse, half);
        const int vi = 3 * a->obs[i].view;
        for (int k = 0; k < 3; k++)
            c->sighted[vi + k] += c->weight[i];
        for (int j = a->first[track]; j <= i; j++) {
            if (!a->in[j])
                continue;
            const int vj = 3 * a->obs[j].view;
            world_direction(a, j, d);
            ray_projector(d, c->weight[j], q);
            lin_product(half, q, block);
            for (int k = 0; k < 9; k++)
                c->sum[(size_t)(vi + k / 3) * (size_t)c->n + (size_t)(vj + k % 3)] +=
                    (i == j ? p[k] : 0) - block[k];
        }
    }
}

/* Subtract the common translation from the centres x. */
static void remove_mean(const struct centres *c, double *x)
{
    double mean[3] = {0}, total = 0;
    for (int i = 0; i < c->n; i += 3) {
        for (int k = 0; k < 3; k++)
            mean[k] += c->sighted[i] * x[i + k];
        total += c->sighted[i];
    }
    for (int i = 0; i < c->n; i++)
        x[i] -= total > 0 ? mean[i % 3] / total : 0;
}

/* Smallest eigenvector of the scaled form D^-1/2 S D^-1/2 by inverse iteration. */
static bool smallest_eigenvector(struct centres *c)
{
    const int n = c->n;
    uint32_t state = 7;
    for (int i = 0; i < n; i++) {
        double si = c->sighted[i] > 0 ? sqrt(c->sighted[i]) : 1;
        for (int j = 0; j <= i; j++) {
            double sj = c->sighted[j] > 0 ? sqrt(c->sighted[j]) : 1;
            c->sum[(size_t)i * (size_t)n + (size_t)j] /= si * sj;
        }
        c->sum[(size_t)i * (size_t)n + (size_t)i] += c->sighted[i] > 0 ? 1e-9 : 1;
        state = state * 1664525u + 1013904223u;
        c->x[i] = c->sighted[i] > 0 ? (state >> 8) * 0x1p-23 - 1 : 0;
    }
    if (!lin_cholesky(c->sum, n))
        return false;
    for (int k = 0; k < POWER_STEPS; k++) {
        double len = 0;
        for (int pass = 0; pass < 2; pass++) { // scaled to centres and back
            for (int i = 0; i < n; i++)
                c->x[i] *= c->sighted[i] > 0 ? pow(c->sighted[i], pass ? 0.5 : -0.5) : 0;
            if (pass == 0)
                remove_mean(c, c->x);
        }
        lin_solve(c->sum, n, c->x);
        for (int i = 0; i < n; i++)
            len += c->x[i] * c->x[i];
        if (!(len > 0) || !isfinite(len))
            return false;
        for (int i = 0; i < n; i++)
            c->x[i] /= sqrt(len);
    }
    for (int i = 0; i < n; i++)
        c->x[i] = c->sighted[i] > 0 ? c->x[i] / sqrt(c->sighted[i]) : 0;
    remove_mean(c, c->x);
    return true;
}

/* New weights of a track's observations. returns: number in front of their views minus behind. */
static int reweigh_track(struct centres *c, int track, double kernel, double nearest)
{
    const struct adjust *a = c->a;
    double inverse[9], sum[3] = {0}, x[3], d[3], p[9], px[3];
    int side = 0;
    if (!track_inverse(c, track, inverse))
        return 0;
    for (int i = a->first[track]; i < a->first[track + 1]; i++) {
        if (!a->in[i])
            continue;
        world_direction(a, i, d);
        ray_projector(d, c->weight[i], p);
        lin_apply(p, c->x + 3 * a->obs[i].view, px);
        for (int k = 0; k < 3; k++)
            sum[k] += px[k];
    }
    lin_apply(inverse, sum, x);
    for (int i = a->first[track]; i < a->first[track + 1]; i++) {
        if (!a->in[i])
            continue;
        const double *centre = c->x + 3 * a->obs[i].view;
        const double to[3] = {x[0] - centre[0], x[1] - centre[1], x[2] - centre[2]};
        world_direction(a, i, d);
        double depth = lin_dot(d, to), off2 = lin_dot(to, to) - depth * depth;
        double far = fmax(fabs(depth), nearest), s = (double)a->obs[i].weight;
        s *= adjust_focal(a, a->obs[i].view);
        side += depth > 0 ? 1 : -1;
        c->weight[i] =
            1 / (far * far) / (1 + fmax(off2, 0) * s * s / (far * far) / kernel / kernel);
    }
    return side;
}

static bool solve_centres(struct centres *c)
{
    const int seen = c->a->first[c->a->n_tracks];
    double kernel = 30, nearest = 1;
    for (int i = 0; i < seen; i++)
        c->weight[i] = 1;
    for (int round = 0; round < CENTRE_ROUNDS; round++) {
        int side = 0;
        double size = 0;
        memset(c->sum, 0, (size_t)c->n * (size_t)c->n * sizeof *c->sum);
        memset(c->sighted, 0, (size_t)c->n * sizeof *c->sighted);
        for (int t = 0; t < c->a->n_tracks; t += c->stride)
            add_track(c, t);
        if (!smallest_eigenvector(c))
            return false;
        for (int i = 0; i < c->n; i++)
            size += c->x[i] * c->x[i] / c->n;
        nearest = sqrt(size);
        for (int t = 0; t < c->a->n_tracks; t += c->stride)
            side += reweigh_track(c, t, kernel, nearest);
        for (int i = 0; i < c->n; i++)
            c->x[i] /= side < 0 ? -nearest : nearest;
        for (int i = 0; i < seen; i++)
            c->weight[i] *= size;
        kernel = fmax(kernel * 0.7, 4);
    }
    return true;
}

static bool any_parallax(const struct viewgraph *g, const struct adjust *a)
{
    for (int j = 0; j < g->n_views; j++)
        for (int i = 0; i < j; i++)
            if (a->placed[i] && a->placed[j] && edge_of(g, i, j)->ok &&
                edge_of(g, i, j)->pose.parallax)
                return true;
    return false;
}

static err_t layout_centres(struct centres *c, struct arena *tmp, int n_views, int n_obs)
{
    const size_t n = 3 * (size_t)n_views;
    c->n = (int)n;
    err_t e = arena_alloc(tmp, n * n, sizeof(double), &c->sum);
    if (!e)
        e = arena_zalloc(tmp, n, sizeof(double), &c->x);
    if (!e)
        e = arena_alloc(tmp, n, sizeof(double), &c->sighted);
    return e ? e : arena_alloc(tmp, (size_t)n_obs, sizeof(double), &c->weight);
}

size_t viewgraph_plan(int n_views, int n_obs)
{
    struct arena tmp = arena_counter();
    struct pairs_job pairs;
    struct averaging rotations;
    struct centres c;
    if (layout_list(&pairs, &tmp, n_views, n_obs))
        return SIZE_MAX;
    arena_reset(&tmp, 0);
    if (layout_averaging(&rotations, &tmp, n_views))
        return SIZE_MAX;
    arena_reset(&tmp, 0);
    return layout_centres(&c, &tmp, n_views, n_obs) ? SIZE_MAX : tmp.peak;
}

err_t viewgraph_centres(const struct run *r, const struct viewgraph *g, struct adjust *a,
                        bool *found)
{
    const size_t mark = arena_mark(r->tmp);
    struct centres c = {.a = a};
    size_t products = 0;
    *found = false;
    if (!any_parallax(g, a))
        return OK;
    for (int t = 0; t < a->n_tracks; t++)
        products +=
            (size_t)(a->first[t + 1] - a->first[t]) * (size_t)(a->first[t + 1] - a->first[t]);
    c.stride = 1 + (int)(products / (size_t)num_max(PRODUCTS_MOST, PRODUCTS_VIEW * a->n_views));
    err_t e = layout_centres(&c, r->tmp, a->n_views, a->first[a->n_tracks]);
    if (!e)
        *found = solve_centres(&c);
    for (int v = 0; v < a->n_views && *found; v++) {
        double t[3];
        lin_apply(pose_of(a, v), c.x + 3 * v, t);
        for (int k = 0; k < 3; k++)
            pose_of(a, v)[9 + k] = -t[k];
    }
    arena_reset(r->tmp, mark);
    return e ? e : run_check(r, "centres of cameras");
}
