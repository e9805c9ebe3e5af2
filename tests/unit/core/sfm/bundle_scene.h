/* bundle_scene.h - rooms seen by rigs of cameras, as tracks: points on walls and boxes, each seen
 * from directions near one of its own, with noise and wrong observations. */
#ifndef SFM_BUNDLE_SCENE_H
#define SFM_BUNDLE_SCENE_H

#include "core/base/lin.h"
#include "core/base/rotation.h"
#include "core/sfm/bundle.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { SCENE_SIZE = 448, SCENE_VIEWS = 128, SCENE_LENSES = 4 };

struct scene_rig {
    int n_views, n_points;
    double focal, noise; // px
    double wrong;        // share of tracks with wrong observations
    double reach;        // degrees from a point's own direction where it is still found
    uint32_t seed;
    struct camera cams[SCENE_VIEWS];
    int n_lenses; // 0: as cams have it; else view v looks through lens v % n_lenses
    struct lens lens[SCENE_LENSES];
};

struct scene_tracks {
    struct match_tracks t;
    double (*point)[3]; // (n_tracks) true
};

static uint32_t scene_state;

static double scene_uniform(double lo, double hi)
{
    scene_state = scene_state * 1664525u + 1013904223u;
    return lo + (hi - lo) * (double)(scene_state >> 8) / 16777216.0;
}

static double scene_normal(void)
{
    double u = scene_uniform(1e-9, 1), v = scene_uniform(0, 6.283185307179586);
    return sqrt(-2 * log(u)) * cos(v);
}

/* Camera at `from` that looks at `to`, y down. */
static inline struct camera scene_look(const double from[3], const double to[3], double focal)
{
    struct camera c = {SCENE_SIZE,     SCENE_SIZE,     (float)focal, (float)focal,
                       SCENE_SIZE / 2, SCENE_SIZE / 2, {0},          {0}};
    double r[9], q[4], t[3], *z = r + 6;
    const double down[3] = {0, 1, 0};
    for (int k = 0; k < 3; k++)
        z[k] = to[k] - from[k];
    lin_normalise(z);
    lin_cross(down, z, r);
    lin_normalise(r);
    lin_cross(z, r, r + 3);
    rotation_to_quat(r, q);
    lin_apply(r, from, t);
    for (int k = 0; k < 4; k++)
        c.q[k] = (float)q[k];
    for (int k = 0; k < 3; k++)
        c.t[k] = (float)-t[k];
    return c;
}

/* Camera 3 m from the middle of the room, degrees around and above. */
static inline struct camera scene_dome(double around, double above, double focal)
{
    const double d = 3.14159265358979323846 / 180, to[3] = {0, 0.1, 0};
    const double from[3] = {3 * sin(around * d) * cos(above * d), -3 * sin(above * d),
                            -3 * cos(around * d) * cos(above * d)};
    return scene_look(from, to, focal);
}

/* Every other view of a grid of 5 x 7 in steps of 2.5 and 5 degrees: 18 views. */
static inline void scene_grid(struct scene_rig *s)
{
    s->n_views = 0;
    for (int i = 0; i < 35; i += 2)
        s->cams[s->n_views++] = scene_dome(5.0 * (i % 7 - 3), 2.5 * (i / 7 - 2), s->focal);
}

static inline void scene_arc(struct scene_rig *s, int n, double degrees)
{
    s->n_views = n;
    for (int i = 0; i < n; i++)
        s->cams[i] = scene_dome(degrees * (i / (double)(n - 1) - 0.5), 6 * (i % 3), s->focal);
}

/* A place on the walls of the room or on one of the boxes in it. */
static inline void scene_point(double x[3])
{
    const double room[3] = {2.6, 1.6, 1.7};
    double half[3], at[3];
    int box = (int)scene_uniform(0, 9), side = (int)scene_uniform(0, 3);
    for (int k = 0; k < 3; k++) {
        half[k] = box < 4 ? room[k] : 0.15 + 0.08 * ((box * 7 + k * 3) % 5);
        at[k] = box < 4 ? 0 : room[k] * 0.5 * sin(box * 2.4 + k * 1.7);
        x[k] = at[k] + half[k] * scene_uniform(-1, 1);
    }
    x[side] = at[side] + half[side] * (scene_uniform(-1, 1) > 0 ? 1 : -1);
}

/* Where the camera sees x, through lens l if there is one; false outside the picture or behind. */
static inline bool scene_see(const struct camera *c, const struct lens *l, const double x[3],
                             double *u, double *v)
{
    const double q[4] = {(double)c->q[0], (double)c->q[1], (double)c->q[2], (double)c->q[3]};
    double r[9], y[3];
    rotation_from_quat(q, r);
    lin_apply(r, x, y);
    for (int k = 0; k < 3; k++)
        y[k] += (double)c->t[k];
    *u = (double)c->fx * y[0] / y[2] + (double)c->cx;
    *v = (double)c->fy * y[1] / y[2] + (double)c->cy;
    if (l) {
        double px[2];
        if (!lens_project(l, y, px))
            return false;
        *u = px[0] + SCENE_SIZE / 2;
        *v = px[1] + SCENE_SIZE / 2;
    }
    return y[2] > 0.1 && *u > 0 && *u<c->w && * v> 0 && *v < c->h;
}

/* Angle of view i's axis to view j's, degrees. */
static inline double scene_between(const struct camera *a, const struct camera *b)
{
    double dot = 0;
    for (int k = 0; k < 4; k++)
        dot += (double)a->q[k] * (double)b->q[k];
    return 2 * acos(fmin(1, fabs(dot))) * 180 / 3.14159265358979323846;
}

/* Move an observation to somewhere else, or to the next repeat of a pattern. */
static inline void scene_spoil(struct match_observation *s)
{
    bool repeat = scene_uniform(0, 1) < 0.5;
    s->u = repeat ? s->u + (scene_uniform(0, 1) < 0.5 ? 30 : -30)
                  : (float)scene_uniform(0, SCENE_SIZE);
    s->v = repeat ? s->v : (float)scene_uniform(0, SCENE_SIZE);
}

/* Tracks of the rig; freed by scene_free. */
static inline void scene_make(const struct scene_rig *s, struct scene_tracks *out)
{
    out->t.obs = calloc((size_t)(s->n_points * s->n_views), sizeof *out->t.obs);
    out->point = calloc((size_t)s->n_points, sizeof *out->point);
    out->t.n = out->t.n_tracks = 0;
    scene_state = s->seed;
    for (int i = 0; i < s->n_points; i++) {
        struct match_observation *obs = out->t.obs + out->t.n;
        double *x = out->point[out->t.n_tracks], u, v;
        int n = 0, own = (int)scene_uniform(0, s->n_views);
        bool spoilt = scene_uniform(0, 1) < s->wrong;
        scene_point(x);
        for (int k = 0; k < s->n_views; k++) {
            const struct lens *l = s->n_lenses ? &s->lens[k % s->n_lenses] : NULL;
            if (scene_between(&s->cams[own], &s->cams[k]) > s->reach ||
                !scene_see(&s->cams[k], l, x, &u, &v) || scene_uniform(0, 1) > 0.7)
                continue;
            obs[n] = (struct match_observation){out->t.n_tracks, k,
                                                (float)(u + s->noise * scene_normal()),
                                                (float)(v + s->noise * scene_normal()), 0.5f};
            if (spoilt && (n == 1 || scene_uniform(0, 1) < 0.5))
                scene_spoil(&obs[n]);
            n++;
        }
        if (n > 1) {
            out->t.n += n;
            out->t.n_tracks++;
        }
    }
}

static inline void scene_free(struct scene_tracks *t)
{
    free(t->t.obs);
    free(t->point);
}

#endif
