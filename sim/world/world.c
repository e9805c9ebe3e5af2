/* world_make counts on room.c and yard.c to fill arrays of the largest size. Cameras: the arc
 * around the focus at a seeded distance; its span grows with `spread`, and it is moved to where its
 * directions meet the box to stand in. Along a direction the distance is clamped to the box. A
 * regular rig takes the arc in one to three rows of heights. A camera in a solid is moved towards
 * the middle of the box in steps; points are tested in the frame of the solid, with a margin. */
#include "sim/world/world.h"

#include "sim/world/park.h"
#include "sim/world/room.h"
#include "sim/world/yard.h"

#include <math.h>
#include <string.h>

static const float CLEAR = 0.12f; // m, between a camera and a surface
static const float ARC = 2.6f;    // rad, span of the arc at spread 1
static const float STEP = 0.5f;   // rad, largest step of the arc at spread 1
static const float RADIAN = 0.01745329252f;
static const float NEARER = 0.22f;         // of the ring, that a walk keeps to its sides
static const float ASIDE = 50.0f * RADIAN; // that the camera of a walk swings

enum { SWING = 20 };                   // cameras of a walk from one side to the other and back
enum { DIRECTIONS = 180, PULLS = 24 }; // tried on either side, 1 degree each; steps inwards

static err_t alloc_arrays(struct arena *keep, struct world *w)
{
    err_t e = arena_alloc(keep, WORLD_SOLIDS, sizeof *w->solids, &w->solids);
    if (e == OK)
        e = arena_alloc(keep, WORLD_MATERIALS, sizeof *w->materials, &w->materials);
    if (e == OK)
        e = arena_alloc(keep, WORLD_LIGHTS, sizeof *w->lights, &w->lights);
    return e;
}

void world_plan(struct plan *p)
{
    struct world w;
    (void)alloc_arrays(&p->keep, &w); // a counter is never full
}

err_t world_make(struct arena *keep, uint64_t seed, enum world_kind kind, struct world *out)
{
    memset(out, 0, sizeof *out);
    if ((int)kind < WORLD_ANY || (int)kind >= WORLD_KINDS)
        return err_fail(ERR_ARG, "world: kind is %d, must be %d..%d", (int)kind, WORLD_ANY,
                        WORLD_KINDS - 1);
    err_t e = alloc_arrays(keep, out);
    if (e != OK) {
        memset(out, 0, sizeof *out);
        return e;
    }
    struct builder b = {.w = out, .state = seed};
    bool yard = builder_chance(&b, 0.3f);
    if (kind == WORLD_ANY)
        kind = yard ? WORLD_YARD : WORLD_ROOM;
    out->kind = kind;
    b.plain = kind == WORLD_PLAIN;
    b.mirrors = kind == WORLD_MIRROR;
    b.timber = builder_material(&b, ROLE_TIMBER);
    for (int i = 0; i < BUILDER_BOOKS; i++)
        b.books[i] = builder_material(&b, ROLE_BOOK);
    if (kind == WORLD_YARD)
        yard_build(&b);
    else if (kind == WORLD_PARK)
        park_build(&b);
    else
        room_build(&b);
    return OK;
}

/* ---- cameras ------------------------------------------------------------------------------- */

static bool in_solid(const struct world_solid *s, const float p[3])
{
    float d[3], q[3];
    for (int c = 0; c < 3; c++)
        d[c] = p[c] - s->t[c];
    for (int c = 0; c < 3; c++)
        q[c] = s->r[c] * d[0] + s->r[3 + c] * d[1] + s->r[6 + c] * d[2];
    float x = fabsf(q[0]), y = fabsf(q[1]), z = fabsf(q[2]);
    const float *h = s->size;
    switch (s->shape) {
    case WORLD_BOX:
        return x < h[0] + CLEAR && y < h[1] + CLEAR && z < h[2] + CLEAR;
    case WORLD_RECT:
        return x < h[0] + CLEAR && y < h[1] + CLEAR && z < CLEAR;
    case WORLD_ELLIPSOID:
        x /= h[0] + CLEAR;
        y /= h[1] + CLEAR;
        z /= h[2] + CLEAR;
        return x * x + y * y + z * z < 1.0f;
    case WORLD_FRUSTUM: {
        float at = fminf(fmaxf(0.5f * (q[2] / h[2] + 1.0f), 0.0f), 1.0f);
        float wide = 1.0f + (s->taper - 1.0f) * at;
        x /= wide * h[0] + CLEAR;
        y /= wide * h[1] + CLEAR;
        return x * x + y * y < 1.0f && z < h[2] + CLEAR;
    }
    default: { // WORLD_TORUS
        float away = sqrtf(x * x + y * y) - h[0];
        return away * away + z * z < (h[1] + CLEAR) * (h[1] + CLEAR);
    }
    }
}

static bool inside_solid(const struct world *w, const float p[3])
{
    for (int i = 0; i < w->n_solids; i++)
        if (in_solid(&w->solids[i], p))
            return true;
    return false;
}

static void pull_inwards(const struct world *w, float p[3])
{
    const float from[3] = {p[0], p[1], p[2]};
    for (int i = 0; i <= PULLS && inside_solid(w, p); i++)
        for (int c = 0; c < 3; c++) {
            float middle = 0.5f * (w->stand[0][c] + w->stand[1][c]);
            p[c] = from[c] + (middle - from[c]) * (float)i / (float)PULLS;
        }
}

/* Distances from the focus at which the direction (c, s) is inside the box for cameras. */
static bool range_in_stand(const struct world *w, const float dir[2], float range[2])
{
    range[0] = 0.3f;
    range[1] = 1e3f;
    for (int k = 0; k < 2; k++) {
        float a = w->stand[0][k] - w->focus[k], b = w->stand[1][k] - w->focus[k];
        if (fabsf(dir[k]) < 1e-6f) {
            if (a > 0.0f || b < 0.0f)
                return false;
            continue;
        }
        float t0 = a / dir[k], t1 = b / dir[k];
        range[0] = fmaxf(range[0], fminf(t0, t1));
        range[1] = fminf(range[1], fmaxf(t0, t1));
    }
    return range[1] - range[0] > 0.15f;
}

void world_switch_light(struct world *w, uint64_t seed, bool on)
{
    static const float RADIUS = 0.06f;
    struct builder b = {.w = w, .state = seed ^ 0x9fb21c651e98df25ull};
    const struct frame whole = {.c = 1};
    const bool outdoors = w->kind == WORLD_YARD || w->kind == WORLD_PARK;
    if (outdoors && w->sun[0] > 0) {
        for (int c = 0; c < 3 && !on; c++)
            w->sun[c] = 0;
        return;
    }
    float c, s, turn = builder_draw(&b, 0, 360 * RADIAN), away = builder_draw(&b, 0.4f, 1.4f);
    float top = fminf(w->hi[2], 3.2f), z = builder_draw(&b, 0.6f, 0.85f) * top;
    float power = 4 * builder_power(builder_draw(&b, -3, 0)), cold = builder_draw(&b, 0.1f, 0.7f);
    builder_turn(turn, &c, &s);
    float p[3] = {w->focus[0] + away * c, w->focus[1] + away * s, z};
    for (int k = 0; k < 2; k++)
        p[k] = fminf(fmaxf(p[k], w->lo[k] + 0.3f), w->hi[k] - 0.3f);
    pull_inwards(w, p);
    const int glow = builder_glow(&b, on ? power / (RADIUS * RADIUS) : 0, cold);
    builder_lamp(&b, builder_add(&b, &whole,
                                 &(struct part){WORLD_ELLIPSOID,
                                                {RADIUS, RADIUS, RADIUS},
                                                {p[0], p[1], p[2]},
                                                .material = glow}));
}

struct arc {
    float from, to;    // rad, of the directions from the focus that are used
    float radius;      // m
    float low, height; // m
    int rows;
    float tilt; // share of the height by which the arc rises
};

/* Directions that meet the box, by degrees to both sides of `middle`. */
static void limit_directions(const struct world *w, float middle, float out[2])
{
    for (int side = 0; side < 2; side++) {
        out[side] = middle;
        for (int i = 1; i <= DIRECTIONS; i++) {
            float angle = middle + (side ? 1.0f : -1.0f) * RADIAN * (float)i, dir[2], range[2];
            builder_turn(angle, &dir[0], &dir[1]);
            if (!range_in_stand(w, dir, range))
                break;
            out[side] = angle;
        }
    }
}

/* Angle of a direction, by whole degrees and then the small angle that is left; libm's arc tangent
 * differs between machines. */
static float angle_of(const float d[2])
{
    float best = 0.0f, most = -1.0f, left = 0.0f;
    float len = sqrtf(d[0] * d[0] + d[1] * d[1]) + 1e-9f;
    for (int i = 0; i < 2 * DIRECTIONS; i++) {
        float c, s;
        builder_turn(RADIAN * (float)i, &c, &s);
        float along = (c * d[0] + s * d[1]) / len;
        if (along > most) {
            most = along;
            best = RADIAN * (float)i;
            left = (c * d[1] - s * d[0]) / len;
        }
    }
    return best + left;
}

static void draw_arc(struct builder *b, const struct world_path *path, struct arc *a)
{
    const struct world *w = b->w;
    float d[2], far = 0.0f;
    for (int k = 0; k < 2; k++) {
        float t = builder_draw(b, 0.25f, 0.75f);
        d[k] = w->stand[0][k] + t * (w->stand[1][k] - w->stand[0][k]) - w->focus[k];
        far += d[k] * d[k];
    }
    a->radius = sqrtf(far);
    float spread = fminf(fmaxf(path->spread, 0.0f), 1.0f);
    float middle = angle_of(d), side[2];
    limit_directions(w, middle, side);
    a->rows = 1;
    if (!path->jitter && path->n >= 6)
        a->rows = 1 + builder_pick(b, path->n >= 12 ? 3 : 2);
    int columns = (path->n + a->rows - 1) / a->rows;
    float span = fminf(ARC * spread, STEP * spread * (float)(columns > 1 ? columns - 1 : 0));
    span = fminf(span, side[1] - side[0]);
    a->from = fminf(fmaxf(middle - 0.5f * span, side[0]), side[1] - span);
    a->to = a->from + span;
    float room = w->stand[1][2] - w->stand[0][2], t = builder_draw(b, 0.0f, 1.0f);
    a->height = room * fminf(1.0f, 1.2f * spread) * 0.8f;
    a->low = w->stand[0][2] + t * (room - a->height);
    a->tilt = builder_draw(b, -0.8f, 0.8f);
}

/* Where camera i of the rig stands. */
static void place_camera(struct builder *b, const struct world_path *path, const struct arc *a,
                         int i, float p[3])
{
    const struct world *w = b->w;
    float spread = fminf(fmaxf(path->spread, 0.0f), 1.0f);
    int columns = (path->n + a->rows - 1) / a->rows, row = i / columns;
    float along = columns > 1 ? (float)(i % columns) / (float)(columns - 1) : 0.5f;
    float up = a->rows > 1 ? (float)row / (float)(a->rows - 1) : 0.5f + a->tilt * (along - 0.5f);
    float radius = a->radius, dir[2], range[2];
    if (path->jitter) {
        along += builder_draw(b, -0.35f, 0.35f) / (float)(columns > 1 ? columns - 1 : 1);
        along = fminf(fmaxf(along, 0.0f), 1.0f);
        up = builder_draw(b, 0.0f, 1.0f);
        radius *= 1.0f + spread * builder_draw(b, -0.25f, 0.25f);
    }
    builder_turn(a->from + (a->to - a->from) * along, &dir[0], &dir[1]);
    if (!range_in_stand(w, dir, range))
        range[0] = range[1] = radius;
    radius = fminf(fmaxf(radius, range[0]), range[1]);
    p[0] = w->focus[0] + radius * dir[0];
    p[1] = w->focus[1] + radius * dir[1];
    p[2] = a->low + up * a->height;
    pull_inwards(w, p);
}

/* Where a camera stands on the ring around the focus: at `away` of its radius in a direction,
 * further out if something is in the way. */
static void place_on_ring(struct builder *b, const struct world_path *path, float turn, float away,
                          float p[3])
{
    const struct world *w = b->w;
    float c, s, radius = w->around * away, up = 0.5f;
    builder_turn(turn, &c, &s);
    if (path->jitter) {
        radius *= 1.0f + builder_draw(b, -0.15f, 0.15f);
        up = builder_draw(b, 0.0f, 1.0f);
    }
    p[2] = w->stand[0][2] + up * (w->stand[1][2] - w->stand[0][2]);
    for (int k = 0; k <= PULLS; k++, radius *= 1.02f) {
        p[0] = w->focus[0] + radius * c;
        p[1] = w->focus[1] + radius * s;
        if (!inside_solid(w, p))
            break;
    }
}

/* Rotation whose rows are right, down, forward; roll in rad. */
static void rotation_towards(const float from[3], const float at[3], float roll, float r[9])
{
    float f[3], len = 0.0f, c, s;
    for (int k = 0; k < 3; k++) {
        f[k] = at[k] - from[k];
        len += f[k] * f[k];
    }
    len = sqrtf(len);
    for (int k = 0; k < 3; k++)
        f[k] = len > 1e-6f ? f[k] / len : (k == 0 ? 1.0f : 0.0f);
    float flat = sqrtf(f[0] * f[0] + f[1] * f[1]);
    const float right[3] = {flat > 1e-6f ? f[1] / flat : 1.0f, flat > 1e-6f ? -f[0] / flat : 0.0f,
                            0.0f};
    const float down[3] = {f[1] * right[2] - f[2] * right[1], f[2] * right[0] - f[0] * right[2],
                           f[0] * right[1] - f[1] * right[0]};
    builder_turn(roll, &c, &s);
    for (int k = 0; k < 3; k++) {
        r[k] = c * right[k] + s * down[k];
        r[3 + k] = c * down[k] - s * right[k];
        r[6 + k] = f[k];
    }
}

/* Quaternion w,x,y,z of a rotation: the largest of the four by its diagonal, the others by sums. */
static void quaternion_from(const float r[9], float q[4])
{
    const float d[4] = {1 + r[0] + r[4] + r[8], 1 + r[0] - r[4] - r[8], 1 - r[0] + r[4] - r[8],
                        1 - r[0] - r[4] + r[8]};
    int k = 0;
    for (int i = 1; i < 4; i++)
        if (d[i] > d[k])
            k = i;
    const float sum[4][4] = {
        {d[0], r[7] - r[5], r[2] - r[6], r[3] - r[1]},
        {r[7] - r[5], d[1], r[1] + r[3], r[2] + r[6]},
        {r[2] - r[6], r[1] + r[3], d[2], r[5] + r[7]},
        {r[3] - r[1], r[2] + r[6], r[5] + r[7], d[3]},
    };
    float len = 0.0f;
    for (int i = 0; i < 4; i++)
        len += sum[k][i] * sum[k][i];
    len = 1.0f / sqrtf(len);
    for (int i = 0; i < 4; i++)
        q[i] = sum[k][i] * len;
}

/* aside: rad, to the left of the focus as seen from the camera. */
static void aim_camera(struct builder *b, const struct world_path *path, const float p[3],
                       float aside, struct camera *cam)
{
    float at[3], r[9], roll = 0.0f, loose = 0.25f * fminf(fmaxf(path->spread, 0.0f), 1.0f) + 0.05f;
    for (int c = 0; c < 3; c++)
        at[c] = b->w->focus[c];
    if (path->jitter) {
        for (int c = 0; c < 3; c++)
            at[c] += builder_draw(b, -loose, loose);
        roll = builder_draw(b, -0.09f, 0.09f);
    }
    if (aside != 0) {
        const float to[2] = {at[0] - p[0], at[1] - p[1]};
        float c, s;
        builder_turn(aside, &c, &s);
        at[0] = p[0] + c * to[0] - s * to[1];
        at[1] = p[1] + s * to[0] + c * to[1];
    }
    rotation_towards(p, at, roll, r);
    quaternion_from(r, cam->q);
    for (int k = 0; k < 3; k++)
        cam->t[k] = -(r[3 * k] * p[0] + r[3 * k + 1] * p[1] + r[3 * k + 2] * p[2]);
}

void world_cameras(const struct world *w, const struct world_path *path, uint64_t seed, int size,
                   struct camera *cams)
{
    struct world view = *w; // only read through the builder
    struct builder b = {.w = &view, .state = seed ^ 0x5851f42d4c957f2dull};
    struct arc a;
    float fov = builder_draw(&b, 40.0f, 85.0f), c, s;
    if (path->fov_deg > 0.0f)
        fov = fminf(fmaxf(path->fov_deg, 20.0f), 120.0f);
    builder_turn(0.5f * RADIAN * fov, &c, &s);
    const bool room = w->around > 0.0f, walk = path->walk && room;
    const bool orbit = path->orbit_deg > 0.0f && room && !walk;
    const float first = orbit || walk ? builder_draw(&b, 0.0f, 360.0f * RADIAN) : 0.0f;
    draw_arc(&b, path, &a);
    for (int i = 0; i < path->n; i++) {
        const float along = 360.0f * RADIAN * (float)i / (float)path->n;
        float p[3], aside = 0, unused;
        cams[i] = (struct camera){.w = size, .h = size};
        cams[i].fx = cams[i].fy = 0.5f * (float)size * c / s;
        cams[i].cx = cams[i].cy = 0.5f * (float)size;
        if (walk) {
            float near;
            builder_turn(along, &near, &unused);
            builder_turn(360.0f * RADIAN * (float)i / SWING, &unused, &aside);
            place_on_ring(&b, path, first + 2 * along, 1 + NEARER * near, p);
        } else if (orbit)
            place_on_ring(&b, path, first + RADIAN * path->orbit_deg * (float)i, 1, p);
        else
            place_camera(&b, path, &a, i, p);
        aim_camera(&b, path, p, ASIDE * aside, &cams[i]);
    }
}
