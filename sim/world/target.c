#include "sim/world/target.h"

#include "core/base/rotation.h"
#include "sim/world/builder.h"
#include "sim/world/solid.h"
#include "sim/world/vec.h"

#include <string.h>

enum { TRIES = 64 };
static const float WHITE = 0.85f, BLACK = 0.035f; // reflectance of paper and toner
static const float TILT_MIN = 0.1f, TILT_MAX = 0.7f, ROLL = 0.44f, ASIDE = 0.2f, NEARER = 0.15f;

/* Where the cameras are together: middle of their centres, mean axis, and their right. */
struct viewpoint {
    float at[3], axis[3], right[3];
};

static void mean_viewpoint(const struct target *t, const struct camera *cams, struct viewpoint *out)
{
    const float share = 1.0f / (float)(t->last - t->first + 1);
    memset(out, 0, sizeof *out);
    for (int i = t->first; i <= t->last; i++) {
        double r[9], c[3];
        rotation_of_camera(&cams[i], r);
        rotation_centre(&cams[i], c);
        for (int k = 0; k < 3; k++) {
            out->at[k] += share * (float)c[k];
            out->axis[k] += (float)r[6 + k];
            out->right[k] += (float)r[k];
        }
    }
    vec_unit(out->axis);
    const float along = vec_dot(out->axis, out->right);
    for (int k = 0; k < 3; k++)
        out->right[k] -= along * out->axis[k];
    vec_unit(out->right);
}

static void cross(const float a[3], const float b[3], float out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

/* Frame of the sheet: x right and y down as it is read, z away from the cameras. */
static void draw_pose(struct builder *b, const struct target *t, const struct viewpoint *v,
                      struct world_solid *s)
{
    float down[3], x[3], y[3], z[3], c, sn;
    const float distance = t->distance * builder_draw(b, 1 - NEARER, 1 + NEARER);
    cross(v->axis, v->right, down);
    builder_turn(builder_draw(b, -3.14159265f, 3.14159265f), &c, &sn);
    const float tilt = builder_draw(b, TILT_MIN, TILT_MAX);
    const float a = distance * builder_draw(b, -ASIDE, ASIDE),
                d = distance * builder_draw(b, -ASIDE, ASIDE);
    for (int k = 0; k < 3; k++) {
        s->t[k] = v->at[k] + distance * v->axis[k] + a * v->right[k] + d * down[k];
        z[k] = v->axis[k] + tilt * (c * v->right[k] + sn * down[k]);
    }
    vec_unit(z);
    builder_turn(builder_draw(b, -ROLL, ROLL), &c, &sn);
    for (int k = 0; k < 3; k++)
        x[k] = c * v->right[k] + sn * down[k];
    const float along = vec_dot(x, z);
    for (int k = 0; k < 3; k++)
        x[k] -= along * z[k];
    vec_unit(x);
    cross(z, x, y);
    for (int k = 0; k < 3; k++) {
        s->r[3 * k] = x[k];
        s->r[3 * k + 1] = y[k];
        s->r[3 * k + 2] = z[k];
    }
}

/* Corners and middle of the sheet that solids hide from the cameras. */
static int count_hidden(const struct world *w, const struct target *t, const struct camera *cams,
                        const struct world_solid *s)
{
    int hidden = 0;
    for (int i = 0; i < w->n_solids; i++) {
        struct solid solid;
        solid_of(&w->solids[i], &solid);
        for (int k = 0; k < 5 * (t->last - t->first + 1); k++) {
            const int corner = k % 5;
            const float local[3] = {corner == 4 ? 0 : s->size[0] * (float)(2 * (corner & 1) - 1),
                                    corner == 4 ? 0 : s->size[1] * (float)((corner & 2) - 1), 0};
            double centre[3];
            float at[3], from[3], d[3];
            rotation_centre(&cams[t->first + k / 5], centre);
            vec_turn(s->r, local, at);
            for (int c = 0; c < 3; c++) {
                from[c] = (float)centre[c];
                d[c] = at[c] + s->t[c] - from[c];
            }
            hidden += solid_hit(&solid, from, d, 1) < 1;
        }
    }
    return hidden;
}

err_t target_add(struct world *w, const struct target *t, const struct camera *cams, int n)
{
    struct builder b = {.w = w, .state = t->seed ^ 0x2545f4914f6cdd1dull};
    struct viewpoint v;
    if (t->first < 0 || t->last < t->first || t->last >= n)
        return err_fail(ERR_ARG, "a target before cameras %d to %d of %d", t->first + 1,
                        t->last + 1, n);
    if (w->n_solids >= WORLD_SOLIDS || w->n_materials >= WORLD_MATERIALS)
        return err_fail(ERR_LIMIT, "no room for a target in this world");
    const float half[2] = {0.5f * t->cells.size * (float)t->cells.cols,
                           0.5f * t->cells.size * (float)t->cells.rows};
    struct world_solid s = {.shape = WORLD_RECT,
                            .size = {half[0], half[1], 0},
                            .material = w->n_materials};
    int least = -1;
    mean_viewpoint(t, cams, &v);
    for (int i = 0; i < TRIES && least != 0; i++) {
        draw_pose(&b, t, &v, &s);
        const int hidden = count_hidden(w, t, cams, &s);
        if (least < 0 || hidden < least) {
            least = hidden;
            w->solids[w->n_solids] = s;
        }
    }
    w->n_solids++;
    struct world_material *m = &w->materials[w->n_materials++];
    *m = (struct world_material){.albedo = {.cells = &t->cells, .scale = 1}};
    for (int c = 0; c < 3; c++) {
        m->albedo.colour[0][c] = WHITE;
        m->albedo.colour[1][c] = BLACK;
    }
    return OK;
}
