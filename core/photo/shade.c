#include "core/photo/shade.h"

#include "core/base/num.h"

enum { SIDE = SHADE_CELLS + 1, ROWS = 16 };

void shade_map(const struct lens *lens, int w, int h, const struct camera *view, struct shade *out)
{
    for (int i = 0; i < SHADE_NODES; i++) {
        const double x = (double)(i % SIDE) / SHADE_CELLS * view->w;
        const double y = (double)(i / SIDE) / SHADE_CELLS * view->h;
        double at[2] = {x - (double)view->cx, y - (double)view->cy}, wide = view->w, high = view->h;
        if (lens) {
            const double ray[3] = {at[0] / (double)view->fx, at[1] / (double)view->fy, 1};
            double px[2];
            wide = w;
            high = h;
            /* what has no pixel is as far as a corner */
            const bool seen = lens_project(lens, ray, px);
            at[0] = seen ? px[0] - lens->cx : 0.5 * w;
            at[1] = seen ? px[1] - lens->cy : 0.5 * h;
        }
        const double r2 = 4 * (at[0] * at[0] + at[1] * at[1]) / (wide * wide + high * high);
        out->r2[i] = (float)fmin(r2, 4);
    }
}

/* Cell and share of the next node for a place 0..1. */
static int cell_of(float at, float *share)
{
    const float x = fminf(fmaxf(at, 0), 1) * SHADE_CELLS;
    const int cell = num_min((int)x, SHADE_CELLS - 1);
    *share = x - (float)cell;
    return cell;
}

float shade_r2(const struct shade *s, float x, float y)
{
    float right, down;
    const int column = cell_of(x, &right), row = cell_of(y, &down);
    const float *a = s->r2 + row * SIDE + column, *b = a + SIDE;
    return (1 - down) * ((1 - right) * a[0] + right * a[1]) +
           down * ((1 - right) * b[0] + right * b[1]);
}

static float vignette_at(const struct shade_model *m, float r2)
{
    float sum = 0;
    for (int k = SHADE_TERMS - 1; k >= 0; k--)
        sum = (sum + (float)m->term[k]) * r2;
    return sum;
}

void shade_stops(const struct shade_model *m, float r2, float out[3])
{
    const float all = vignette_at(m, r2);
    for (int c = 0; c < 3; c++)
        out[c] = all + (float)m->gain[c];
}

struct job {
    const struct shade *s;
    int w, h;
    float *radiance, gain[3];
};

static err_t apply_rows(void *ctx, int chunk, int worker)
{
    const struct job *j = ctx;
    const size_t plane = (size_t)j->w * (size_t)j->h;
    (void)worker;
    for (int y = chunk * ROWS; y < num_min((chunk + 1) * ROWS, j->h); y++)
        for (int x = 0; x < j->w; x++) {
            const float r2 =
                shade_r2(j->s, ((float)x + 0.5f) / (float)j->w, ((float)y + 0.5f) / (float)j->h);
            const float all = exp2f(vignette_at(&j->s->model, r2));
            float *at = j->radiance + (size_t)y * (size_t)j->w + (size_t)x;
            for (size_t c = 0; c < 3; c++)
                at[c * plane] *= all * j->gain[c];
        }
    return OK;
}

void shade_apply(struct pool *pool, const struct shade *s, int w, int h, float *radiance)
{
    struct job j = {s, w, h, radiance, {0}};
    for (int c = 0; c < 3; c++)
        j.gain[c] = exp2f((float)s->model.gain[c]);
    const err_t e = pool_for(pool, (h + ROWS - 1) / ROWS, apply_rows, &j);
    (void)e; // no chunk fails
}

double shade_most(const struct shade_model *m)
{
    double most = 0;
    for (int i = 0; i <= SHADE_CELLS; i++) {
        float stops[3];
        shade_stops(m, (float)i / SHADE_CELLS, stops);
        for (int c = 0; c < 3; c++)
            most = fmax(most, fabs((double)stops[c]));
    }
    return most;
}
