/* Unknowns in this order: 6 of each camera that moves, the free ones of each lens, 6 of each board
 * that moves. A twist acts on the left of a pose. Cauchy loss by weights 1 / (1 + e^2 / kernel^2).
 */
#include "core/sfm/boardfit.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/adjust.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { TWIST = 6, ROW = 2 * TWIST + BOARDFIT_LENS, TERMS_AT = 1, CENTRE_AT = 1 + LENS_TERMS };
static const double BEHIND = 1e8, // px^2, of a corner without pixel
    DONE = 1e-9,                  // relative gain of a last step
    DAMPED_OUT = 1e9, POINT_DAMPING = 1e-6;

/* ---- one corner ---- */

/* Corner in the world and in the camera. */
static void place_corner(const struct boardfit *b, const struct boardfit_corner *c, double world[3],
                         double cam[3])
{
    const double *board = b->board[c->take], *pose = b->pose[c->camera];
    for (int k = 0; k < 3; k++)
        world[k] = board[3 * k] * c->at[0] + board[3 * k + 1] * c->at[1] + board[9 + k];
    lin_apply(pose, world, cam);
    for (int k = 0; k < 3; k++)
        cam[k] += pose[9 + k];
}

bool boardfit_error(const struct boardfit *b, const struct boardfit_corner *c, double error[2])
{
    double world[3], cam[3], px[2];
    place_corner(b, c, world, cam);
    if (!lens_project(&b->lens[b->lens_of[c->camera]].lens, cam, px))
        return false;
    error[0] = px[0] - c->px[0];
    error[1] = px[1] - c->px[1];
    return true;
}

/* Derivative by a twist on the left of x, from that by x. */
static void by_twist(const double by[3], const double x[3], double out[TWIST])
{
    lin_cross(x, by, out);
    memcpy(out + 3, by, 3 * sizeof *out);
}

/* Derivatives by the unknowns of a lens from those by its parameters. */
static void set_lens_row(const struct lens *l, const double p[LENS_PARAMS],
                         double out[BOARDFIT_LENS])
{
    out[0] = l->fx * p[0] + l->fy * p[1];
    memcpy(out + TERMS_AT, p + 4, LENS_TERMS * sizeof *p);
    out[CENTRE_AT] = p[2];
    out[CENTRE_AT + 1] = p[3];
}

bool boardfit_jacobian(const struct boardfit *b, const struct boardfit_corner *c,
                       struct boardfit_jacobian *out)
{
    double world[3], cam[3], px[2], by_ray[6], by_param[2 * LENS_PARAMS];
    const struct lens *l = &b->lens[b->lens_of[c->camera]].lens;
    const double *pose = b->pose[c->camera];
    place_corner(b, c, world, cam);
    if (!lens_project_grad(l, cam, px, by_ray, by_param))
        return false;
    for (int i = 0; i < 2; i++) {
        const double *p = by_param + LENS_PARAMS * i;
        double by_world[3];
        out->error[i] = px[i] - c->px[i];
        by_twist(by_ray + 3 * i, cam, out->camera[i]);
        lin_apply_t(pose, by_ray + 3 * i, by_world);
        by_twist(by_world, world, out->board[i]);
        set_lens_row(l, p, out->lens[i]);
    }
    return true;
}

/* ---- one point in one camera ---- */

bool boardfit_sight_error(const struct boardfit *b, const struct boardfit_sight *s,
                          const double at[3], double error[2])
{
    const double *pose = b->pose[s->camera];
    double cam[3], px[2];
    lin_apply(pose, at, cam);
    for (int k = 0; k < 3; k++)
        cam[k] += pose[9 + k];
    if (!lens_project(&b->lens[b->lens_of[s->camera]].lens, cam, px))
        return false;
    error[0] = px[0] - s->px[0];
    error[1] = px[1] - s->px[1];
    return true;
}

/* In expected errors; `board` is the derivative by the point itself, three numbers. */
static bool sight_jacobian(const struct boardfit *b, const struct boardfit_sight *s,
                           const double at[3], struct boardfit_jacobian *out)
{
    const double *pose = b->pose[s->camera];
    const struct lens *l = &b->lens[b->lens_of[s->camera]].lens;
    double cam[3], px[2], by_ray[6], by_param[2 * LENS_PARAMS];
    lin_apply(pose, at, cam);
    for (int k = 0; k < 3; k++)
        cam[k] += pose[9 + k];
    if (!lens_project_grad(l, cam, px, by_ray, by_param))
        return false;
    for (int i = 0; i < 6; i++)
        by_ray[i] /= s->sigma;
    for (int i = 0; i < 2 * LENS_PARAMS; i++)
        by_param[i] /= s->sigma;
    for (int i = 0; i < 2; i++) {
        out->error[i] = (px[i] - s->px[i]) / s->sigma;
        by_twist(by_ray + 3 * i, cam, out->camera[i]);
        lin_apply_t(pose, by_ray + 3 * i, out->board[i]);
        set_lens_row(l, by_param + LENS_PARAMS * i, out->lens[i]);
    }
    return true;
}

/* ---- unknowns ---- */

static int lens_freedom(const struct boardfit_lens *l)
{
    int n = 0;
    for (int k = 0; k < BOARDFIT_LENS; k++)
        n += l->free[k];
    return n;
}

static int count_free(const bool *is_free, int n)
{
    int sum = 0;
    for (int i = 0; i < n; i++)
        sum += is_free[i];
    return sum;
}

int boardfit_camera_at(const struct boardfit *b, int camera)
{
    return b->camera_free[camera] ? TWIST * count_free(b->camera_free, camera) : -1;
}

int boardfit_lens_at(const struct boardfit *b, int lens)
{
    int at = TWIST * count_free(b->camera_free, b->n_cameras);
    for (int i = 0; i < lens; i++)
        at += lens_freedom(&b->lens[i]);
    return at;
}

static int board_at(const struct boardfit *b, int take)
{
    return b->board_free[take]
               ? boardfit_lens_at(b, b->n_lenses) + TWIST * count_free(b->board_free, take)
               : -1;
}

int boardfit_unknowns(const struct boardfit *b)
{
    return boardfit_lens_at(b, b->n_lenses) + TWIST * count_free(b->board_free, b->n_takes);
}

static double lens_unknown(const struct lens *l, int k)
{
    if (k == 0)
        return log(l->fx);
    return k < CENTRE_AT ? l->term[k - TERMS_AT] : k == CENTRE_AT ? l->cx : l->cy;
}

/* ---- normal equations ---- */

struct normal {
    int n;
    double *h, *factor, *g, *step; // (n, n) lower triangles, (n)
    int *slot;                     // (n) in the block of the point at work, -1: not there
    double (*moved)[3];            // (points)
};

static err_t layout(struct arena *tmp, int n, int n_points, struct normal *out)
{
    const size_t size = (size_t)n;
    out->n = n;
    err_t e = arena_alloc(tmp, size * size, sizeof *out->h, &out->h);
    if (!e)
        e = arena_alloc(tmp, size * size, sizeof *out->factor, &out->factor);
    if (!e)
        e = arena_alloc(tmp, size, sizeof *out->g, &out->g);
    if (!e)
        e = arena_alloc(tmp, size, sizeof *out->slot, &out->slot);
    if (!e)
        e = arena_alloc(tmp, (size_t)n_points, sizeof *out->moved, &out->moved);
    return e ? e : arena_alloc(tmp, size, sizeof *out->step, &out->step);
}

/* The unknowns of a camera and its lens that an observation touches, ascending, and its two rows of
 * them. */
static int gather_camera(const struct boardfit *b, int camera, const struct boardfit_jacobian *j,
                         int at[ROW], double row[2][ROW])
{
    const int pose = boardfit_camera_at(b, camera), lens = b->lens_of[camera];
    int n = 0, from = boardfit_lens_at(b, lens);
    for (int k = 0; k < TWIST && pose >= 0; k++, n++) {
        at[n] = pose + k;
        row[0][n] = j->camera[0][k];
        row[1][n] = j->camera[1][k];
    }
    for (int k = 0; k < BOARDFIT_LENS; k++)
        if (b->lens[lens].free[k]) {
            at[n] = from++;
            row[0][n] = j->lens[0][k];
            row[1][n++] = j->lens[1][k];
        }
    return n;
}

/* Those of a corner. */
static int gather_row(const struct boardfit *b, const struct boardfit_corner *c,
                      const struct boardfit_jacobian *j, int at[ROW], double row[2][ROW])
{
    const int board = board_at(b, c->take);
    int n = gather_camera(b, c->camera, j, at, row);
    for (int k = 0; k < TWIST && board >= 0; k++, n++) {
        at[n] = board + k;
        row[0][n] = j->board[0][k];
        row[1][n] = j->board[1][k];
    }
    return n;
}

static void add_corner(const struct boardfit *b, const struct boardfit_corner *c, double kernel,
                       struct normal *m)
{
    struct boardfit_jacobian j;
    double row[2][ROW];
    int at[ROW];
    if (!boardfit_jacobian(b, c, &j))
        return;
    const double e2 = j.error[0] * j.error[0] + j.error[1] * j.error[1],
                 w = 1 / (1 + e2 / (kernel * kernel)) / (b->sigma * b->sigma);
    const int n = gather_row(b, c, &j, at, row);
    for (int i = 0; i < n; i++) {
        double *to = m->h + (size_t)at[i] * (size_t)m->n;
        for (int k = 0; k <= i; k++)
            to[at[k]] += w * (row[0][i] * row[0][k] + row[1][i] * row[1][k]);
        m->g[at[i]] -= w * (row[0][i] * j.error[0] + row[1][i] * j.error[1]);
    }
}

/* ---- points ---- */

/* A point in the normal equations: h of its own, and its product with what its cameras touch. */
struct point_block {
    double h[9], inverse[9], g[3];
    int n, at[BOARDFIT_SEEN * ROW]; // unknowns touched
    double w[BOARDFIT_SEEN * ROW][3];
};

static double cauchy_weight(const double e[2], double kernel)
{
    return 1 / (1 + (e[0] * e[0] + e[1] * e[1]) / (kernel * kernel));
}

/* Add a sight to the block, and to the equations of its camera. */
static void add_sight(const struct boardfit *b, const struct boardfit_sight *s,
                      const double point[3], struct normal *m, struct point_block *p)
{
    struct boardfit_jacobian j;
    double row[2][ROW];
    int at[ROW];
    if (!sight_jacobian(b, s, point, &j))
        return;
    const double w = cauchy_weight(j.error, b->points.kernel);
    const int n = gather_camera(b, s->camera, &j, at, row);
    for (int i = 0; i < 9; i++)
        p->h[i] +=
            w * (j.board[0][i / 3] * j.board[0][i % 3] + j.board[1][i / 3] * j.board[1][i % 3]);
    for (int k = 0; k < 3; k++)
        p->g[k] -= w * (j.board[0][k] * j.error[0] + j.board[1][k] * j.error[1]);
    for (int i = 0; i < n; i++) {
        double *to = m->h + (size_t)at[i] * (size_t)m->n;
        for (int k = 0; k <= i; k++)
            to[at[k]] += w * (row[0][i] * row[0][k] + row[1][i] * row[1][k]);
        m->g[at[i]] -= w * (row[0][i] * j.error[0] + row[1][i] * j.error[1]);
        if (m->slot[at[i]] < 0) {
            m->slot[at[i]] = p->n;
            p->at[p->n] = at[i];
            memset(p->w[p->n++], 0, sizeof p->w[0]);
        }
        for (int k = 0; k < 3; k++)
            p->w[m->slot[at[i]]][k] += w * (row[0][i] * j.board[0][k] + row[1][i] * j.board[1][k]);
    }
}

static bool invert_block(struct point_block *p)
{
    double damped[9];
    memcpy(damped, p->h, sizeof damped);
    for (int k = 0; k < 3; k++)
        damped[4 * k] *= 1 + POINT_DAMPING;
    return lin_inverse3(damped, p->inverse);
}

/* Eliminate a point. */
static void add_point(const struct boardfit *b, int i, struct normal *m, struct point_block *p)
{
    const struct boardfit_points *all = &b->points;
    memset(p->h, 0, sizeof p->h);
    memset(p->g, 0, sizeof p->g);
    p->n = 0;
    for (int k = all->first[i]; k < all->first[i + 1]; k++)
        add_sight(b, &all->sight[k], all->at[i], m, p);
    const bool good = invert_block(p);
    for (int u = 0; u < p->n; u++) {
        double x[3];
        m->slot[p->at[u]] = -1;
        lin_apply(p->inverse, p->w[u], x);
        if (!good)
            continue;
        double *to = m->h + (size_t)p->at[u] * (size_t)m->n;
        for (int v = 0; v < p->n; v++)
            to[p->at[v]] -= p->at[v] <= p->at[u] ? lin_dot(x, p->w[v]) : 0;
        m->g[p->at[u]] -= lin_dot(x, p->g);
    }
}

static double point_cost(const struct boardfit *b, int i, const double at[3])
{
    const struct boardfit_points *all = &b->points;
    const double k2 = all->kernel * all->kernel;
    double sum = 0;
    for (int k = all->first[i]; k < all->first[i + 1]; k++) {
        const struct boardfit_sight *s = &all->sight[k];
        double e[2];
        const double e2 = boardfit_sight_error(b, s, at, e)
                              ? (e[0] * e[0] + e[1] * e[1]) / (s->sigma * s->sigma)
                              : BEHIND;
        sum += k2 * log1p(fmin(e2, BEHIND) / k2);
    }
    return sum;
}

/* Where points go once the cameras have moved by m->step, into m->moved: before they do. */
static void solve_points(const struct boardfit *b, struct normal *m)
{
    const struct boardfit_points *all = &b->points;
    struct point_block p;
    for (int i = 0; i < all->n; i++) {
        memset(p.h, 0, sizeof p.h);
        memset(p.g, 0, sizeof p.g);
        for (int k = all->first[i]; k < all->first[i + 1]; k++) {
            struct boardfit_jacobian j;
            double row[2][ROW], along[2] = {0, 0};
            int at[ROW];
            if (!sight_jacobian(b, &all->sight[k], all->at[i], &j))
                continue;
            const double w = cauchy_weight(j.error, all->kernel);
            const int n = gather_camera(b, all->sight[k].camera, &j, at, row);
            for (int u = 0; u < 2 * n; u++)
                along[u % 2] += row[u % 2][u / 2] * m->step[at[u / 2]];
            for (int u = 0; u < 9; u++)
                p.h[u] += w * (j.board[0][u / 3] * j.board[0][u % 3] +
                               j.board[1][u / 3] * j.board[1][u % 3]);
            for (int d = 0; d < 3; d++)
                p.g[d] -= w * (j.board[0][d] * (j.error[0] + along[0]) +
                               j.board[1][d] * (j.error[1] + along[1]));
        }
        double by[3] = {0, 0, 0};
        if (invert_block(&p))
            lin_apply(p.inverse, p.g, by);
        for (int d = 0; d < 3; d++)
            m->moved[i][d] = all->at[i][d] + by[d];
    }
}

/* Points move only where that is better for them. */
static void move_points(const struct boardfit *b, const struct normal *m)
{
    for (int i = 0; i < b->points.n; i++)
        if (point_cost(b, i, m->moved[i]) < point_cost(b, i, b->points.at[i]))
            memcpy(b->points.at[i], m->moved[i], sizeof m->moved[i]);
}

static void add_priors(const struct boardfit *b, struct normal *m)
{
    for (int l = 0; l < b->n_lenses; l++) {
        const struct boardfit_lens *p = &b->lens[l];
        int at = boardfit_lens_at(b, l);
        for (int k = 0; k < BOARDFIT_LENS; k++) {
            if (!p->free[k])
                continue;
            const double w = p->prior[k] * p->prior[k];
            m->h[(size_t)at * (size_t)m->n + (size_t)at] += w;
            m->g[at++] -= w * (lens_unknown(&p->lens, k) - p->mean[k]);
        }
    }
}

static void collect(const struct boardfit *b, double kernel, struct normal *m)
{
    memset(m->h, 0, (size_t)m->n * (size_t)m->n * sizeof *m->h);
    memset(m->g, 0, (size_t)m->n * sizeof *m->g);
    for (int i = 0; i < b->n; i++)
        add_corner(b, &b->corner[i], kernel, m);
    struct point_block block;
    memset(m->slot, 0xff, (size_t)m->n * sizeof *m->slot);
    for (int i = 0; i < b->points.n; i++)
        add_point(b, i, m, &block);
    add_priors(b, m);
}

static double total_cost(const struct boardfit *b, double kernel)
{
    const double k2 = kernel * kernel;
    double sum = 0;
    for (int i = 0; i < b->n; i++) {
        double e[2];
        const double e2 = boardfit_error(b, &b->corner[i], e) ? e[0] * e[0] + e[1] * e[1] : BEHIND;
        sum += k2 * log1p(fmin(e2, BEHIND) / k2);
    }
    sum /= b->sigma * b->sigma;
    for (int i = 0; i < b->points.n; i++)
        sum += point_cost(b, i, b->points.at[i]);
    for (int l = 0; l < b->n_lenses; l++)
        for (int k = 0; k < BOARDFIT_LENS; k++) {
            const struct boardfit_lens *p = &b->lens[l];
            const double e = (lens_unknown(&p->lens, k) - p->mean[k]) * p->prior[k];
            sum += p->free[k] ? e * e : 0;
        }
    return sum;
}

/* ---- steps ---- */

/* The state before a step. */
struct backup {
    double (*pose)[BOARDFIT_POSE], (*board)[BOARDFIT_POSE];
    struct boardfit_lens *lens;
    double (*point)[3];
};

static err_t layout_backup(struct arena *tmp, const struct boardfit *b, struct backup *out)
{
    err_t e = arena_alloc(tmp, (size_t)b->n_cameras, sizeof *out->pose, &out->pose);
    if (!e)
        e = arena_alloc(tmp, (size_t)b->n_takes, sizeof *out->board, &out->board);
    if (!e)
        e = arena_alloc(tmp, (size_t)b->points.n, sizeof *out->point, &out->point);
    return e ? e : arena_alloc(tmp, (size_t)b->n_lenses, sizeof *out->lens, &out->lens);
}

static void copy_state(const struct boardfit *b, const struct backup *s, bool back)
{
    const size_t pose = (size_t)b->n_cameras * sizeof *b->pose,
                 board = (size_t)b->n_takes * sizeof *b->board,
                 lens = (size_t)b->n_lenses * sizeof *b->lens;
    memcpy(back ? b->pose : s->pose, back ? s->pose : b->pose, pose);
    memcpy(back ? b->board : s->board, back ? s->board : b->board, board);
    memcpy(back ? b->lens : s->lens, back ? s->lens : b->lens, lens);
    if (b->points.n > 0)
        memcpy(back ? b->points.at : s->point, back ? s->point : b->points.at,
               (size_t)b->points.n * sizeof *s->point);
}

static bool move_lens(struct boardfit_lens *p, const double *step)
{
    struct lens *l = &p->lens;
    double *const to[BOARDFIT_LENS] = {NULL,        &l->term[0], &l->term[1], &l->term[2],
                                       &l->term[3], &l->cx,      &l->cy};
    if (p->free[0]) {
        l->fx *= exp(fmin(fmax(*step++, -1), 1));
        l->fy = l->fx;
    }
    for (int k = 1; k < BOARDFIT_LENS; k++)
        if (p->free[k])
            *to[k] += *step++;
    return lens_init(l) == OK;
}

static bool move_all(struct boardfit *b, const double *step)
{
    bool ok = true;
    for (int i = 0; i < b->n_cameras; i++)
        if (b->camera_free[i])
            adjust_move_pose(b->pose[i], step + boardfit_camera_at(b, i));
    for (int i = 0; i < b->n_lenses; i++)
        ok = move_lens(&b->lens[i], step + boardfit_lens_at(b, i)) && ok;
    for (int i = 0; i < b->n_takes; i++)
        if (b->board_free[i])
            adjust_move_pose(b->board[i], step + board_at(b, i));
    return ok;
}

/* The step for a damping; false if it cannot be had. */
static bool find_step(struct normal *m, double damping)
{
    const size_t n = (size_t)m->n;
    memcpy(m->factor, m->h, n * n * sizeof *m->h);
    memcpy(m->step, m->g, n * sizeof *m->g);
    for (size_t i = 0; i < n; i++)
        m->factor[(n + 1) * i] += damping * m->h[(n + 1) * i] + DBL_MIN;
    if (!lin_cholesky(m->factor, m->n))
        return false;
    lin_solve(m->factor, m->n, m->step);
    for (size_t i = 0; i < n; i++)
        if (!isfinite(m->step[i]))
            return false;
    return true;
}

static bool try_step(struct boardfit *b, struct normal *m, double damping)
{
    if (!find_step(m, damping))
        return false;
    solve_points(b, m);
    if (!move_all(b, m->step))
        return false;
    move_points(b, m);
    return true;
}

static err_t layout_all(struct arena *tmp, const struct boardfit *b, struct normal *m,
                        struct backup *before)
{
    err_t e = layout(tmp, boardfit_unknowns(b), b->points.n, m);
    return e ? e : layout_backup(tmp, b, before);
}

size_t boardfit_plan(int n_cameras, int n_takes, int n_lenses, int n_points)
{
    const struct boardfit b = {.n_cameras = n_cameras,
                               .n_takes = n_takes,
                               .n_lenses = n_lenses,
                               .points = {.n = n_points}};
    const int unknowns = TWIST * (n_cameras + n_takes) + BOARDFIT_LENS * n_lenses;
    struct arena a = arena_counter();
    struct backup before;
    struct normal m;
    arena_hold(&a, arena_need((size_t)n_cameras * BOARDFIT_POSE, sizeof(double)));
    (void)layout(&a, unknowns, n_points, &m); // a counter is never full
    (void)layout_backup(&a, &b, &before);
    return a.peak;
}

err_t boardfit_run(struct arena *tmp, struct boardfit *b, double kernel, int steps, double *cost)
{
    struct normal m;
    struct backup before;
    double damping = 1e-3;
    const size_t mark = arena_mark(tmp);
    err_t e = layout_all(tmp, b, &m, &before);
    *cost = total_cost(b, kernel);
    for (int k = 0; k < steps && !e && damping < DAMPED_OUT; k++) {
        double now = INFINITY;
        collect(b, kernel, &m);
        copy_state(b, &before, false);
        while (damping < DAMPED_OUT) {
            now = try_step(b, &m, damping) ? total_cost(b, kernel) : INFINITY;
            if (now < *cost)
                break;
            copy_state(b, &before, true);
            damping *= 8;
        }
        if (!(now < *cost))
            break;
        const double gain = (*cost - now) / fmax(*cost, DBL_MIN);
        *cost = now;
        damping = fmax(damping / 10, 1e-12);
        if (gain < DONE)
            break;
    }
    arena_reset(tmp, mark);
    return e;
}

/* The gauge of the cameras that are free: their twists are the first unknowns. */
static err_t fix_gauge(struct arena *tmp, const struct boardfit *b, struct normal *m,
                       struct covariance_gauge *g)
{
    const int n = count_free(b->camera_free, b->n_cameras);
    double *pose;
    err_t e = arena_alloc(tmp, (size_t)n * BOARDFIT_POSE, sizeof *pose, &pose);
    if (e)
        return e;
    for (int i = 0, k = 0; i < b->n_cameras; i++)
        if (b->camera_free[i])
            memcpy(pose + BOARDFIT_POSE * k++, b->pose[i], sizeof b->pose[i]);
    *g = covariance_find_gauge(pose, NULL, n, false);
    covariance_fix_gauge(g, m->h, m->n);
    return OK;
}

err_t boardfit_covariance(struct arena *tmp, struct boardfit *b, double (*pose)[COVARIANCE_POSE],
                          double (*lens)[BOARDFIT_LENS])
{
    const size_t mark = arena_mark(tmp);
    struct covariance_gauge g;
    struct normal m;
    err_t e = layout(tmp, boardfit_unknowns(b), b->points.n, &m);
    if (!e) {
        collect(b, INFINITY, &m);
        e = fix_gauge(tmp, b, &m, &g);
    }
    if (!e && !lin_cholesky(m.h, m.n))
        e = err_fail(ERR_ARG, "the board does not determine all cameras and lenses");
    for (int i = 0, k = 0; i < b->n_cameras && !e; i++) {
        memset(pose[i], 0, sizeof pose[i]);
        if (b->camera_free[i])
            covariance_of_pose(&g, m.h, m.n, k++, m.step, pose[i]);
    }
    for (int i = 0; i < b->n_lenses && !e; i++)
        for (int k = 0, at = boardfit_lens_at(b, i); k < BOARDFIT_LENS; k++) {
            lens[i][k] = 0;
            if (b->lens[i].free[k])
                lens[i][k] = sqrt(covariance_of_unknown(m.h, m.n, at++, m.step));
        }
    arena_reset(tmp, mark);
    return e;
}
