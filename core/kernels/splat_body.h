/* splat_body.h - the splat kernels, written once and compiled once per instruction set.
 * Included by splat_<isa>.c after one SIMD_ macro. Formulas: core/splat/README.md 2 to 5; backward:
 * derived by the chain rule, with the 2x3 factor N = J R M of the 2-D covariance so that its
 * determinant never cancels (Lagrange's identity). */
#include "core/kernels/kernels.h"
#include "core/kernels/sh_body.h"
#include "core/kernels/simd.h"

/* Intermediate values of projection and of its chain rule, for LANES splats. */
struct proj {
    vf m[3], p[3], rz;  // centre in the world and in the camera; 1/z
    vm seen;            // between near and far
    vf qn[4], inv_norm; // unit quaternion; 1/|q|
    vf rot[9], s[3];    // rotation, scales
    vf w[9];            // R_cam rot
    vf cx, cy;          // x/z and y/z clamped for the Jacobian
    vf j00, j02, j11, j12;
    vf n0[3], n1[3];    // rows of N = J w diag(s)
    vf xx, xy, yy, det; // blurred 2-D covariance
    vf opacity;
};

MAP vf v_abs(vf a)
{
    return v_max(a, v_set(0.0f) - a);
}

MAP void proj_quat(struct proj *o, const struct gaussians *g, int i)
{
    vf q[4], big = v_set(0.0f);
    for (int k = 0; k < 4; k++) {
        q[k] = v_load(g->plane[G_QUAT + k] + i);
        big = v_max(v_abs(q[k]), big);
    }
    vm ok = v_lt(v_set(1e-30f), big);
    vf inv = v_set(1.0f) / v_sel(ok, big, v_set(1.0f));
    vf sum = v_set(0.0f);
    for (int k = 0; k < 4; k++) {
        q[k] = v_sel(ok, q[k] * inv, v_set(k == 0 ? 1.0f : 0.0f));
        sum = v_fma(q[k], q[k], sum);
    }
    vf len = v_set(1.0f) / v_sqrt(sum);
    for (int k = 0; k < 4; k++)
        o->qn[k] = q[k] * len;
    o->inv_norm = inv * len;
    vf w = o->qn[0], x = o->qn[1], y = o->qn[2], z = o->qn[3], two = v_set(2.0f), one = v_set(1.0f);
    o->rot[0] = one - two * (y * y + z * z);
    o->rot[1] = two * (x * y - w * z);
    o->rot[2] = two * (x * z + w * y);
    o->rot[3] = two * (x * y + w * z);
    o->rot[4] = one - two * (x * x + z * z);
    o->rot[5] = two * (y * z - w * x);
    o->rot[6] = two * (x * z - w * y);
    o->rot[7] = two * (y * z + w * x);
    o->rot[8] = one - two * (x * x + y * y);
}

MAP void proj_load(struct proj *o, const struct gaussians *g, const struct view_geom *v, int i)
{
    for (int k = 0; k < 3; k++) {
        o->m[k] = v_load(g->plane[G_MU + k] + i);
        o->s[k] = v_exp(v_load(g->plane[G_LOG_SCALE + k] + i));
    }
    for (int k = 0; k < 3; k++) {
        vf a = v_fma(v_set(v->r[3 * k]), o->m[0], v_set(v->t[k]));
        a = v_fma(v_set(v->r[3 * k + 1]), o->m[1], a);
        o->p[k] = v_fma(v_set(v->r[3 * k + 2]), o->m[2], a);
    }
    o->seen = m_and(v_le(v_set(RASTER_NEAR), o->p[2]), v_le(o->p[2], v_set(RASTER_FAR)));
    o->rz = v_set(1.0f) / v_sel(o->seen, o->p[2], v_set(1.0f));
    o->opacity = v_set(1.0f) / (v_set(1.0f) + v_exp(v_set(0.0f) - v_load(g->plane[G_LOGIT] + i)));
    proj_quat(o, g, i);
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) {
            vf a = v_set(v->r[3 * r]) * o->rot[c];
            a = v_fma(v_set(v->r[3 * r + 1]), o->rot[3 + c], a);
            o->w[3 * r + c] = v_fma(v_set(v->r[3 * r + 2]), o->rot[6 + c], a);
        }
    o->cx = v_clamp(o->p[0] * o->rz, -v->lim_x0, v->lim_x1);
    o->cy = v_clamp(o->p[1] * o->rz, -v->lim_y0, v->lim_y1);
    o->j00 = v_set(v->fx) * o->rz;
    o->j11 = v_set(v->fy) * o->rz;
    o->j02 = v_set(0.0f) - o->j00 * o->cx;
    o->j12 = v_set(0.0f) - o->j11 * o->cy;
    vf nn0 = v_set(0.0f), nn1 = nn0, n01 = nn0, along = nn0; // the last: variance along the view
    for (int c = 0; c < 3; c++) {
        const vf z = o->w[6 + c] * o->s[c];
        along = v_fma(z, z, along);
        o->n0[c] = (o->j00 * o->w[c] + o->j02 * o->w[6 + c]) * o->s[c];
        o->n1[c] = (o->j11 * o->w[3 + c] + o->j12 * o->w[6 + c]) * o->s[c];
        nn0 = v_fma(o->n0[c], o->n0[c], nn0);
        nn1 = v_fma(o->n1[c], o->n1[c], nn1);
        n01 = v_fma(o->n0[c], o->n1[c], n01);
    }
    o->seen = m_and(o->seen, v_le(v_set(RASTER_REACH * RASTER_REACH) * along, o->p[2] * o->p[2]));
    vf c0 = o->n0[1] * o->n1[2] - o->n0[2] * o->n1[1];
    vf c1 = o->n0[2] * o->n1[0] - o->n0[0] * o->n1[2];
    vf c2 = o->n0[0] * o->n1[1] - o->n0[1] * o->n1[0];
    o->det = c0 * c0 + c1 * c1 + c2 * c2 + v_set(RASTER_BLUR) * (nn0 + nn1) +
             v_set(RASTER_BLUR * RASTER_BLUR);
    o->xx = nn0 + v_set(RASTER_BLUR);
    o->yy = nn1 + v_set(RASTER_BLUR);
    o->xy = n01;
}

/* Unit direction from the camera centre, its length, and log radiance of one colour. */
MAP void proj_dir(const struct proj *o, const struct view_geom *v, vf dir[3], vf *len)
{
    vf sum =
        v_set(1e-36f); // a splat on the camera has no direction; it is culled by the near plane
    for (int k = 0; k < 3; k++) {
        dir[k] = o->m[k] - v_set(v->centre[k]);
        sum = v_fma(dir[k], dir[k], sum);
    }
    *len = v_sqrt(sum);
    for (int k = 0; k < 3; k++)
        dir[k] = dir[k] / *len;
}

MAP vf proj_colour(const struct gaussians *g, int i, int colour, const vf *basis)
{
    int n = (g->degree + 1) * (g->degree + 1);
    vf sum = basis[0] * v_load(g->plane[G_SH + colour] + i);
    for (int k = 1; k < n; k++)
        sum = v_fma(basis[k], v_load(g->plane[G_SH + 3 * k + colour] + i), sum);
    return sum;
}

MAP vm proj_alive(const struct proj *o)
{
    vf trace = o->xx + o->yy;
    return m_and(o->seen, m_and(v_lt(trace, v_set(RASTER_COV_MAX)), v_lt(v_set(0.0f), o->det)));
}

/* Splats with a NaN or infinity in any plane are not drawn; x * 0 is 0 only for finite x. */
MAP vm proj_finite(const struct gaussians *g, int i)
{
    vf sum = v_set(0.0f);
    for (int p = 0; p < G_SH + 3 * (g->degree + 1) * (g->degree + 1); p++)
        sum = v_fma(v_load(g->plane[p] + i), v_set(0.0f), sum);
    return v_le(v_set(0.0f), sum);
}

/* Inclusive pixel range of one axis, empty if lo > hi.
 * radius: gsplat's circle, decides the tiles; extent: where alpha can reach 1/255, cuts pixels and
 * tiles further. */
MAP void axis_range(vf centre, vf radius, vf extent, int size, vf *lo, vf *hi)
{
    float tiles = (float)((size + TILE - 1) / TILE);
    vf inv = v_set(1.0f / TILE), half = v_set(0.5f), zero = v_set(0.0f);
    vf t0 = v_max(v_floor((centre - radius) * inv), zero);
    vf t1 = v_min(zero - v_floor((zero - centre - radius) * inv), v_set(tiles));
    vf x1 = v_min(t1 * v_set((float)TILE), v_set((float)size)) - v_set(1.0f);
    *lo = v_max(zero - v_floor(extent + half - centre), t0 * v_set((float)TILE));
    *hi = v_min(v_floor(centre + extent - half), x1);
    *lo = v_clamp(*lo, 0.0f, (float)size);
    *hi = v_clamp(*hi, -1.0f, (float)size - 1.0f);
}

enum {
    F_U,
    F_V,
    F_ACROSS,
    F_SHEAR,
    F_ALONG,
    F_TOP,
    F_R,
    F_G,
    F_BL,
    F_Z,
    F_X0,
    F_X1,
    F_Y0,
    F_Y1,
    N_FIELDS
};

static const float LOG2_E = 1.44269504f, LOG2_ALPHA_MIN = -7.99435344f; // log2(1/255)

/* Fields of the records of LANES splats. returns: one bit per splat, set if it is drawn. */
MAP int project_lanes(const struct gaussians *g, const struct view_geom *v, int i,
                      float f[N_FIELDS][LANES])
{
    struct proj o;
    proj_load(&o, g, v, i);
    vm alive = m_and(proj_alive(&o), proj_finite(g, i));
    vf inv = v_set(1.0f) / o.yy, lo[2], hi[2];
    vf top = v_log2(v_max(o.opacity, v_set(1e-30f)));
    vf reach = v_set(2.0f / LOG2_E) * (top - v_set(LOG2_ALPHA_MIN)); // 2 ln(255 opacity)
    alive = m_and(alive, v_le(v_set(0.0f), reach));
    vf half = v_set(0.5f) * (o.xx - o.yy);
    vf root = v_sqrt(v_max(half * half + o.xy * o.xy, v_set(0.01f)));
    vf r = v_sqrt(v_set(0.5f) * (o.xx + o.yy) + root) * v_set(RASTER_REACH);
    r = v_set(0.0f) - v_floor(v_set(0.0f) - r);
    vf u = v_fma(v_set(v->fx), o.p[0] * o.rz, v_set(v->cx));
    vf w = v_fma(v_set(v->fy), o.p[1] * o.rz, v_set(v->cy));
    /* slightly too large: the per-pixel test decides */
    vf ex = v_fma(v_sqrt(reach * o.xx), v_set(1.001f), v_set(0.01f));
    vf ey = v_fma(v_sqrt(reach * o.yy), v_set(1.001f), v_set(0.01f));
    axis_range(u, r, ex, v->w, &lo[0], &hi[0]);
    axis_range(w, r, ey, v->h, &lo[1], &hi[1]);
    alive = m_and(alive, m_and(v_le(lo[0], hi[0]), v_le(lo[1], hi[1])));
    alive = m_and(alive, m_and(v_lt(v_abs(u), v_set(1e9f)), v_lt(v_abs(w), v_set(1e9f))));
    v_store(f[F_U], u);
    v_store(f[F_V], w);
    v_store(f[F_ACROSS], v_set(0.5f * LOG2_E) * o.yy / o.det);
    v_store(f[F_SHEAR], o.xy * inv);
    v_store(f[F_ALONG], v_set(0.5f * LOG2_E) * inv);
    v_store(f[F_TOP], top);
    v_store(f[F_Z], o.p[2]);
    v_store(f[F_X0], lo[0]);
    v_store(f[F_X1], hi[0]);
    v_store(f[F_Y0], lo[1]);
    v_store(f[F_Y1], hi[1]);
    if (!m_any(alive))
        return 0;
    vf basis[SH_COEFS_MAX], dir[3] = {v_set(0.0f), v_set(0.0f), v_set(0.0f)}, len;
    if (g->degree > 0)
        proj_dir(&o, v, dir, &len);
    sh_basis(g->degree, dir, basis);
    for (int c = 0; c < 3; c++)
        v_store(f[F_R + c],
                v_exp(v_clamp(proj_colour(g, i, c, basis), -RASTER_LOG_MAX, RASTER_LOG_MAX)));
    return m_bits(alive);
}

static void project(const struct gaussians *g, const struct view_geom *v, int first, int count,
                    struct splat2d *out)
{
    for (int i = first; i < first + count; i += LANES) {
        float f[N_FIELDS][LANES];
        int alive = project_lanes(g, v, i, f);
        for (int l = 0; l < LANES && i + l < first + count; l++) {
            struct splat2d *s = &out[i + l];
            s->x0 = 0;
            s->x1 = -1;
            if (!(alive >> l & 1))
                continue;
            int x0 = (int)f[F_X0][l], x1 = (int)f[F_X1][l], y0 = (int)f[F_Y0][l],
                y1 = (int)f[F_Y1][l];
            *s = (struct splat2d){.u = f[F_U][l],
                                  .v = f[F_V][l],
                                  .across = f[F_ACROSS][l],
                                  .shear = f[F_SHEAR][l],
                                  .along = f[F_ALONG][l],
                                  .top = f[F_TOP][l],
                                  .rgb = {f[F_R][l], f[F_G][l], f[F_BL][l]},
                                  .z = f[F_Z][l],
                                  .x0 = (int16_t)x0,
                                  .x1 = (int16_t)x1,
                                  .y0 = (int16_t)y0,
                                  .y1 = (int16_t)y1,
                                  .tx0 = (uint8_t)(x0 / TILE),
                                  .tx1 = (uint8_t)(x1 / TILE + 1),
                                  .ty0 = (uint8_t)(y0 / TILE),
                                  .ty1 = (uint8_t)(y1 / TILE + 1)};
        }
    }
}

MAP vf finite_or_0(vf a)
{
    return v_sel(v_lt(v_abs(a), v_set(1e30f)), a, v_set(0.0f));
}

/* Gradient of the colours by the SH planes, and by the centre through the direction (d_m). */
MAP void grad_colour(const struct gaussians *g, const struct view_geom *v, const struct proj *o,
                     int i, const vf d_rgb[3], float *grad, vf d_m[3])
{
    int n = (g->degree + 1) * (g->degree + 1);
    vf basis[SH_COEFS_MAX], dir[3], len = v_set(1.0f), d_log[3];
    if (g->degree > 0)
        proj_dir(o, v, dir, &len);
    else
        dir[0] = dir[1] = dir[2] = v_set(0.0f);
    sh_basis(g->degree, dir, basis);
    for (int c = 0; c < 3; c++) {
        vf log_rad = proj_colour(g, i, c, basis);
        vm inside = v_lt(v_abs(log_rad), v_set(RASTER_LOG_MAX));
        d_log[c] = v_sel(inside, d_rgb[c] * v_exp(log_rad), v_set(0.0f));
        for (int k = 0; k < n; k++)
            v_store(grad + (G_SH + 3 * k + c) * SPLAT_BLOCK, finite_or_0(basis[k] * d_log[c]));
    }
    if (g->degree == 0)
        return;
    vf w[SH_COEFS_MAX], d_dir[3] = {v_set(0.0f), v_set(0.0f), v_set(0.0f)};
    for (int k = 1; k < n; k++) {
        w[k] = d_log[0] * v_load(g->plane[G_SH + 3 * k] + i);
        w[k] = v_fma(d_log[1], v_load(g->plane[G_SH + 3 * k + 1] + i), w[k]);
        w[k] = v_fma(d_log[2], v_load(g->plane[G_SH + 3 * k + 2] + i), w[k]);
    }
    sh_basis_grad(g->degree, dir, w, d_dir);
    vf dot = d_dir[0] * dir[0] + d_dir[1] * dir[1] + d_dir[2] * dir[2];
    for (int k = 0; k < 3; k++)
        d_m[k] = (d_dir[k] - dot * dir[k]) / len;
}

/* dL/d unit quaternion from dL/d rotation, then dL/d stored quaternion. */
MAP void grad_quat(const struct proj *o, const vf r[9], vf out[4])
{
    vf w = o->qn[0], x = o->qn[1], y = o->qn[2], z = o->qn[3], two = v_set(2.0f), d[4];
    d[0] = two * (x * (r[7] - r[5]) + y * (r[2] - r[6]) + z * (r[3] - r[1]));
    d[1] =
        two * (y * (r[1] + r[3]) + z * (r[2] + r[6]) + w * (r[7] - r[5]) - two * x * (r[4] + r[8]));
    d[2] =
        two * (x * (r[1] + r[3]) + z * (r[5] + r[7]) + w * (r[2] - r[6]) - two * y * (r[0] + r[8]));
    d[3] =
        two * (x * (r[2] + r[6]) + y * (r[5] + r[7]) + w * (r[3] - r[1]) - two * z * (r[0] + r[4]));
    vf dot = d[0] * w + d[1] * x + d[2] * y + d[3] * z;
    for (int k = 0; k < 4; k++)
        out[k] = (d[k] - dot * o->qn[k]) * o->inv_norm;
}

struct geom_grad {
    vf p[3];    // dL/d centre in the camera
    vf w[9];    // dL/d (R_cam rot)
    vf s[3];    // dL/d log scale
    vf intr[4]; // dL/d fx fy cx cy
};

/* From the sums of tile_grad to the camera-space quantities. */
MAP void grad_geom(const struct proj *o, const struct view_geom *v, const vf *sum,
                   struct geom_grad *d)
{
    vf inv = v_set(1.0f) / o->det, half = v_set(0.5f);
    vf a = o->yy * inv, b = (v_set(0.0f) - o->xy) * inv, c = o->xx * inv;
    vf du = a * sum[0] + b * sum[1], dv = b * sum[0] + c * sum[1];
    /* V = -P G P with G the gradient of the conic P */
    vf ga = half * sum[2], gb = half * sum[3], gc = half * sum[4];
    vf t00 = a * ga + b * gb, t01 = a * gb + b * gc, t10 = b * ga + c * gb, t11 = b * gb + c * gc;
    vf v00 = v_set(-2.0f) * (t00 * a + t01 * b), v01 = v_set(-2.0f) * (t00 * b + t01 * c);
    vf v11 = v_set(-2.0f) * (t10 * b + t11 * c);
    vf d_j00 = v_set(0.0f), d_j02 = d_j00, d_j11 = d_j00, d_j12 = d_j00;
    for (int k = 0; k < 3; k++) {
        vf dn0 = v00 * o->n0[k] + v01 * o->n1[k], dn1 = v01 * o->n0[k] + v11 * o->n1[k];
        d->s[k] = dn0 * o->n0[k] + dn1 * o->n1[k];
        vf dt0 = dn0 * o->s[k], dt1 = dn1 * o->s[k];
        d->w[k] = o->j00 * dt0;
        d->w[3 + k] = o->j11 * dt1;
        d->w[6 + k] = o->j02 * dt0 + o->j12 * dt1;
        d_j00 = v_fma(dt0, o->w[k], d_j00);
        d_j02 = v_fma(dt0, o->w[6 + k], d_j02);
        d_j11 = v_fma(dt1, o->w[3 + k], d_j11);
        d_j12 = v_fma(dt1, o->w[6 + k], d_j12);
    }
    vf x = o->p[0] * o->rz, y = o->p[1] * o->rz, zero = v_set(0.0f);
    vm in_x = m_and(v_le(v_set(-v->lim_x0), x), v_le(x, v_set(v->lim_x1)));
    vm in_y = m_and(v_le(v_set(-v->lim_y0), y), v_le(y, v_set(v->lim_y1)));
    /* j02 = -fx cx / z; the bound of cx is (a - c_x) / fx or -(b + c_x) / fx, so it
     * moves with fx and c_x */
    vf d_cx = zero - d_j02 * o->j00, d_cy = zero - d_j12 * o->j11;
    vf dx = du * v_set(v->fx) + v_sel(in_x, d_cx, zero); // d / d (x/z)
    vf dy = dv * v_set(v->fy) + v_sel(in_y, d_cy, zero);
    d->p[0] = dx * o->rz;
    d->p[1] = dy * o->rz;
    vf scale = d_j00 * o->j00 + d_j02 * o->j02 + d_j11 * o->j11 +
               d_j12 * o->j12; // all J are proportional to 1/z
    d->p[2] = sum[GRAD_Z] - (dx * x + dy * y + scale) * o->rz;
    vf out_x = v_sel(in_x, zero, d_cx), out_y = v_sel(in_y, zero, d_cy);
    d->intr[0] = du * x + (d_j00 * o->j00 + d_j02 * o->j02 - out_x * o->cx) / v_set(v->fx);
    d->intr[1] = dv * y + (d_j11 * o->j11 + d_j12 * o->j12 - out_y * o->cy) / v_set(v->fy);
    d->intr[2] = du - out_x / v_set(v->fx);
    d->intr[3] = dv - out_y / v_set(v->fy);
}

MAP void grad_pose(const struct proj *o, const struct view_geom *v, const struct geom_grad *d,
                   const vf d_dir[3], int lanes, float *pose)
{
    float buf[LANES];
    vf ray[3]; // d centre of the camera, turned into the camera frame
    for (int r = 0; r < 3; r++) {
        ray[r] = v_set(v->r[3 * r]) * d_dir[0] + v_set(v->r[3 * r + 1]) * d_dir[1];
        ray[r] = v_fma(v_set(v->r[3 * r + 2]), d_dir[2], ray[r]);
    }
    vf out[POSE_GRAD];
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) {
            vf a = d->p[r] * o->m[c] + v_set(v->t[r]) * d_dir[c];
            for (int k = 0; k < 3; k++)
                a = v_fma(d->w[3 * r + k], o->rot[3 * c + k], a);
            out[3 * r + c] = a;
        }
    for (int k = 0; k < 3; k++)
        out[9 + k] = d->p[k] + ray[k];
    for (int k = 0; k < 4; k++)
        out[12 + k] = d->intr[k];
    for (int k = 0; k < POSE_GRAD; k++) {
        v_store(buf, finite_or_0(out[k]));
        for (int l = 0; l < lanes; l++)
            pose[k] += buf[l];
    }
}

static void project_grad(const struct gaussians *g, const struct view_geom *v, int first, int count,
                         const float *sums, float *grad, float *pose)
{
    for (int j = 0; j < count; j += LANES, sums += LANES, grad += LANES) {
        struct proj o;
        struct geom_grad d;
        vf sum[GRAD2D], d_m[3] = {v_set(0.0f), v_set(0.0f), v_set(0.0f)};
        proj_load(&o, g, v, first + j);
        vm alive = proj_alive(&o);
        for (int k = 0; k < GRAD2D; k++)
            sum[k] = v_sel(alive, v_load(sums + k * SPLAT_BLOCK), v_set(0.0f));
        grad_geom(&o, v, sum, &d);
        grad_colour(g, v, &o, first + j, sum + GRAD_RGB, grad, d_m);
        int lanes = count - j < LANES ? count - j : LANES;
        if (pose)
            grad_pose(&o, v, &d, d_m, lanes, pose);
        vf d_rot[9], d_q[4];
        for (int r = 0; r < 3; r++) {
            vf a = d_m[r];
            for (int k = 0; k < 3; k++)
                a = v_fma(v_set(v->r[3 * k + r]), d.p[k], a);
            v_store(grad + (G_MU + r) * SPLAT_BLOCK, finite_or_0(a));
            v_store(grad + (G_LOG_SCALE + r) * SPLAT_BLOCK, finite_or_0(d.s[r]));
            for (int c = 0; c < 3; c++) {
                vf b = v_set(v->r[r]) * d.w[c];
                b = v_fma(v_set(v->r[3 + r]), d.w[3 + c], b);
                d_rot[3 * r + c] = v_fma(v_set(v->r[6 + r]), d.w[6 + c], b);
            }
        }
        grad_quat(&o, d_rot, d_q);
        for (int k = 0; k < 4; k++)
            v_store(grad + (G_QUAT + k) * SPLAT_BLOCK, finite_or_0(d_q[k]));
        v_store(grad + G_LOGIT * SPLAT_BLOCK, finite_or_0((o.opacity - v_set(1.0f)) * sum[5]));
    }
}

/* Tile-local maps: TILE rows of TILE pixels. A pixel whose transmittance is negative is full. */
struct tile_state {
    float t[TILE * TILE], rgbz[4][TILE * TILE], stop[TILE * TILE], front[TILE * TILE];
};

/* A splat as the row loops read it. */
struct tile_splat {
    float u, v, shear, along, top;
    vf across, rgb[3], z;
    int y0, y1, v0, v1; // rows and vectors of the tile that it can touch, inclusive
};

MAP struct tile_splat tile_splat_of(const struct splat2d *s, const struct tile *t)
{
    int a = s->x0 - t->x0, b = s->x1 - t->x0, c = s->y0 - t->y0, d = s->y1 - t->y0;
    return (struct tile_splat){.u = s->u - ((float)t->x0 + 0.5f),
                               .v = s->v - ((float)t->y0 + 0.5f),
                               .shear = s->shear,
                               .along = s->along,
                               .top = s->top,
                               .across = v_set(s->across),
                               .rgb = {v_set(s->rgb[0]), v_set(s->rgb[1]), v_set(s->rgb[2])},
                               .z = v_set(s->z),
                               .y0 = c < 0 ? 0 : c,
                               .y1 = d > TILE - 1 ? TILE - 1 : d,
                               .v0 = a < 0 ? 0 : a / LANES,
                               .v1 = b > TILE - 1 ? (TILE - 1) / LANES : b / LANES};
}

static const float lane_index[TILE] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};

/* log2 alpha of a row of pixels: a sum of two squares is never negative and does not cancel for
 * needles. Floored, because powers that are denormal numbers cost a hundred cycles. */
MAP vf tile_log2_alpha(const struct tile_splat *p, vf dx, float dy)
{
    vf d = dx - v_set(p->shear * dy);
    return v_max(v_fnma(p->across * d, d, v_set(p->top - p->along * dy * dy)), v_set(-64.0f));
}

enum { WITH_DEPTH = 1, WITH_FRONT = 2 }; // maps that are wanted, known when compiled

/* No branch on the pixels: a mispredicted one costs more than a row without hits.
 * returns: the pixels that became full. */
MAP vm tile_row(const struct tile_splat *p, vf dx, float dy, struct tile_state *st, int at,
                int with)
{
    vf log_alpha = tile_log2_alpha(p, dx, dy), t = v_load(st->t + at);
    vm hit = m_and(v_le(v_set(LOG2_ALPHA_MIN), log_alpha), v_lt(v_set(0.0f), t));
    vf alpha = v_sel(hit, v_min(v_exp2(log_alpha), v_set(RASTER_ALPHA_MAX)), v_set(0.0f));
    vf next = v_fnma(t, alpha, t);
    vm stop = m_and(hit, v_le(next, v_set(RASTER_STOP)));
    vf w = v_sel(stop, v_set(0.0f), alpha * t);
    for (int c = 0; c < 3; c++)
        v_store(st->rgbz[c] + at, v_fma(w, p->rgb[c], v_load(st->rgbz[c] + at)));
    if (with & WITH_DEPTH)
        v_store(st->rgbz[3] + at, v_fma(w, p->z, v_load(st->rgbz[3] + at)));
    if (with & WITH_FRONT) {
        vm front = m_andnot(v_lt(next, v_set(RASTER_FRONT)), v_lt(t, v_set(RASTER_FRONT)));
        v_store(st->front + at, v_sel(front, p->z, v_load(st->front + at)));
    }
    v_store(st->t + at, v_sel(stop, v_set(0.0f) - t, next));
    return stop;
}

/* Note the list index of the splat that filled pixels. returns: whether any pixel is still open. */
static int tile_note_stops(struct tile_state *st, int index, int n)
{
    vm room = m_none();
    for (int i = 0; i < TILE * TILE; i += LANES) {
        vm open = v_lt(v_set(0.0f), v_load(st->t + i));
        vf stop = v_load(st->stop + i);
        vm now = m_andnot(v_le(v_set((float)n), stop), open);
        v_store(st->stop + i, v_sel(now, v_set((float)index), stop));
        room = m_or(room, open);
    }
    return m_any(room);
}

static void tile_start(const struct tile *t, struct tile_state *st)
{
    memset(st->rgbz, 0, sizeof st->rgbz);
    for (int y = 0; y < TILE; y++)
        for (int x = 0; x < TILE; x++) {
            int inside = t->x0 + x < t->w && t->y0 + y < t->h;
            st->stop[y * TILE + x] = inside ? (float)t->n : 0.0f;
            st->t[y * TILE + x] = inside ? 1.0f : -1.0f;
            st->front[y * TILE + x] = RASTER_FAR;
        }
}

static void tile_finish(const struct tile *t, const struct tile_state *st)
{
    size_t plane = (size_t)t->w * (size_t)t->h;
    int nx = t->w - t->x0 < TILE ? t->w - t->x0 : TILE,
        ny = t->h - t->y0 < TILE ? t->h - t->y0 : TILE;
    for (int y = 0; y < ny; y++)
        for (int x = 0; x < nx; x++) {
            int at = y * TILE + x;
            size_t o = (size_t)(t->y0 + y) * (size_t)t->w + (size_t)(t->x0 + x);
            float trans = fabsf(st->t[at]);
            for (int c = 0; c < 3; c++)
                t->radiance[(size_t)c * plane + o] = st->rgbz[c][at] + trans * t->background[c];
            if (t->depth)
                t->depth[o] = st->rgbz[3][at];
            t->alpha[o] = 1.0f - trans;
            t->trans[o] = trans;
            if (t->front)
                t->front[o] = st->front[at];
            t->stop[o] = (int32_t)st->stop[at];
        }
}

MAP void tile_blend(const struct tile *t, int with)
{
    struct tile_state st;
    tile_start(t, &st);
    for (int i = 0; i < t->n; i++) {
        if (i + 8 < t->n)
            __builtin_prefetch(&t->splats[t->list[i + 8]]);
        struct tile_splat p = tile_splat_of(&t->splats[t->list[i]], t);
        vm stopped = m_none();
        for (int y = p.y0; y <= p.y1; y++)
            for (int k = p.v0; k <= p.v1; k++)
                stopped = m_or(stopped, tile_row(&p, v_set(p.u) - v_load(lane_index + k * LANES),
                                                 p.v - (float)y, &st, y * TILE + k * LANES, with));
        if (m_any(stopped) && !tile_note_stops(&st, i, t->n))
            break;
    }
    tile_finish(t, &st);
}

static void tile(const struct tile *t)
{
    if (t->front && t->depth)
        tile_blend(t, WITH_FRONT | WITH_DEPTH);
    else if (t->front)
        tile_blend(t, WITH_FRONT);
    else if (t->depth)
        tile_blend(t, WITH_DEPTH);
    else
        tile_blend(t, 0);
}

/* Backward state per pixel. rest: the part of dL/dT from later splats and the background. */
struct grad_state {
    float t[TILE * TILE], stop[TILE * TILE], rest[TILE * TILE], d[4][TILE * TILE];
    float behind[TILE * TILE]; // depth from which splats are hidden
    int top;                   // highest `stop` of the tile
};

static void grad_start(const struct tile *t, struct grad_state *st)
{
    size_t plane = (size_t)t->w * (size_t)t->h;
    memset(st, 0, sizeof *st);
    int nx = t->w - t->x0 < TILE ? t->w - t->x0 : TILE,
        ny = t->h - t->y0 < TILE ? t->h - t->y0 : TILE;
    for (int y = 0; y < ny; y++)
        for (int x = 0; x < nx; x++) {
            int at = y * TILE + x;
            size_t o = (size_t)(t->y0 + y) * (size_t)t->w + (size_t)(t->x0 + x);
            float back = 0;
            for (int c = 0; c < 3; c++) {
                st->d[c][at] = t->d_radiance[(size_t)c * plane + o];
                back += st->d[c][at] * t->background[c];
            }
            st->d[3][at] = t->d_depth ? t->d_depth[o] : 0.0f;
            st->t[at] = t->trans[o];
            st->behind[at] = RASTER_BEHIND * t->front[o];
            st->stop[at] = (float)t->stop[o];
            st->rest[at] = t->trans[o] * (back - (t->d_alpha ? t->d_alpha[o] : 0.0f));
            st->top = t->stop[o] > st->top ? t->stop[o] : st->top;
        }
}

MAP void grad_row(const struct tile_splat *p, vf dx, float dy, struct grad_state *st, int at,
                  vf index, int depth, vf *acc)
{
    vf log_alpha = tile_log2_alpha(p, dx, dy), zero = v_set(0.0f), one = v_set(1.0f);
    vm hit = m_and(v_le(v_set(LOG2_ALPHA_MIN), log_alpha), v_lt(index, v_load(st->stop + at)));
    vf raw = v_exp2(log_alpha);
    vf alpha = v_sel(hit, v_min(raw, v_set(RASTER_ALPHA_MAX)), zero);
    vf inv = v_recip(one - alpha);
    vf t = v_load(st->t + at) * inv;
    vf f = alpha * t, dot = zero;
    for (int c = 0; c < (depth ? 4 : 3); c++) {
        vf d = v_load(st->d[c] + at);
        dot = v_fma(c < 3 ? p->rgb[c] : p->z, d, dot);
        acc[GRAD_RGB + c] = v_fma(f, d, acc[GRAD_RGB + c]);
    }
    vf rest = v_load(st->rest + at);
    vf d_alpha = v_fnma(rest, inv, t * dot);
    v_store(st->rest + at, v_fma(f, dot, rest));
    v_store(st->t + at, t);
    vm behind = v_lt(v_load(st->behind + at), p->z);
    acc[GRAD_SHOWN] = v_fnma(alpha, v_set(RASTER_SHOWN), acc[GRAD_SHOWN] + v_sel(behind, f, alpha));
    vm free = m_and(hit, v_le(raw, v_set(RASTER_ALPHA_MAX)));
    vf d_sigma = v_sel(free, zero - raw * d_alpha, zero);
    vf x = d_sigma * dx, y = d_sigma * v_set(dy);
    acc[0] = acc[0] + x;
    acc[1] = acc[1] + y;
    acc[2] = v_fma(x, dx, acc[2]);
    acc[3] = v_fma(y, dx, acc[3]);
    acc[4] = v_fma(y, v_set(dy), acc[4]);
    acc[5] = acc[5] + d_sigma;
}

MAP void tile_blend_grad(const struct tile *t, int depth)
{
    struct grad_state st;
    grad_start(t, &st);
    int tx = t->x0 / TILE, ty = t->y0 / TILE;
    for (int i = t->n - 1; i >= 0; i--) {
        const struct splat2d *s = &t->splats[t->list[i]];
        float *slot = t->slots + (size_t)SLOT * tile_slot(s, t, tx, ty);
        if (i >= st.top) {
            memset(slot, 0, SLOT * sizeof *slot);
            continue;
        }
        if (i >= 8)
            __builtin_prefetch(&t->splats[t->list[i - 8]]);
        vf acc[GRAD2D], index = v_set((float)i);
        for (int k = 0; k < GRAD2D; k++)
            acc[k] = v_set(0.0f);
        struct tile_splat p = tile_splat_of(s, t);
        for (int y = p.y0; y <= p.y1; y++)
            for (int k = p.v0; k <= p.v1; k++)
                grad_row(&p, v_set(p.u) - v_load(lane_index + k * LANES), p.v - (float)y, &st,
                         y * TILE + k * LANES, index, depth, acc);
        for (int k = 0; k < GRAD2D; k++)
            slot[k] = v_sum(acc[k]);
        for (int k = GRAD2D; k < SLOT; k++)
            slot[k] = 0;
    }
}

static void tile_grad(const struct tile *t)
{
    if (t->d_depth)
        tile_blend_grad(t, 1);
    else
        tile_blend_grad(t, 0);
}

static void adam(const struct adam_step *s, int n, const float *seen, const float *grad,
                 float *param, float *m1, float *m2)
{
    int i = 0;
    for (; i + LANES <= n; i += LANES) {
        vm on = v_lt(v_set(0.0f), v_load(seen + i));
        if (!m_any(on))
            continue;
        vf g = v_load(grad + i), a = v_load(m1 + i), b = v_load(m2 + i), p = v_load(param + i);
        vf a1 = v_fma(v_set(s->beta1), a, v_set(1.0f - s->beta1) * g);
        vf b1 = v_fma(v_set(s->beta2), b, v_set(1.0f - s->beta2) * g * g);
        vf step = a1 * v_set(s->fix1 * s->lr) / (v_sqrt(b1 * v_set(s->fix2)) + v_set(s->eps));
        v_store(m1 + i, v_sel(on, a1, a));
        v_store(m2 + i, v_sel(on, b1, b));
        v_store(param + i, v_sel(on, p - step, p));
    }
    for (; i < n; i++) {
        if (seen[i] == 0.0f)
            continue;
        m1[i] = s->beta1 * m1[i] + (1.0f - s->beta1) * grad[i];
        m2[i] = s->beta2 * m2[i] + (1.0f - s->beta2) * grad[i] * grad[i];
        param[i] -= s->lr * s->fix1 * m1[i] / (sqrtf(s->fix2 * m2[i]) + s->eps);
    }
}

static void splat_fill(struct kernels *k)
{
    k->project = project;
    k->project_grad = project_grad;
    k->tile = tile;
    k->tile_grad = tile_grad;
    k->adam = adam;
}
