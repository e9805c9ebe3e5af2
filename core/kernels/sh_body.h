/* sh_body.h - real spherical harmonics of degree 0 to 4 and their gradient; formulas in
 * core/splat/README.md 4. Included by splat_body.h, once per instruction set. */
#include "core/kernels/simd.h"

#define MAP static inline __attribute__((always_inline))

static const float sh_c[] = {0.2820947917738781f, 0.48860251190292f};

/* Real spherical harmonics of a unit direction up to `degree` (core/splat/README.md 4). */
MAP void sh_basis(int degree, const vf d[3], vf *b)
{
    vf x = d[0], y = d[1], z = d[2];
    b[0] = v_set(sh_c[0]);
    if (degree < 1)
        return;
    b[1] = v_set(-sh_c[1]) * y;
    b[2] = v_set(sh_c[1]) * z;
    b[3] = v_set(-sh_c[1]) * x;
    if (degree < 2)
        return;
    vf zz = z * z, c1 = x * x - y * y, s1 = v_set(2.0f) * x * y;
    b[4] = v_set(0.5462742152960395f) * s1;
    b[5] = v_set(-1.092548430592079f) * z * y;
    b[6] = v_fma(v_set(0.9461746957575601f), zz, v_set(-0.3153915652525201f));
    b[7] = v_set(-1.092548430592079f) * z * x;
    b[8] = v_set(0.5462742152960395f) * c1;
    if (degree < 3)
        return;
    vf c2 = x * c1 - y * s1, s2 = x * s1 + y * c1;
    vf p11 = v_fma(v_set(-2.285228997322329f), zz, v_set(0.4570457994644658f));
    b[9] = v_set(-0.5900435899266435f) * s2;
    b[10] = v_set(1.445305721320277f) * z * s1;
    b[11] = p11 * y;
    b[12] = z * v_fma(v_set(1.865881662950577f), zz, v_set(-1.119528997770346f));
    b[13] = p11 * x;
    b[14] = v_set(1.445305721320277f) * z * c1;
    b[15] = v_set(-0.5900435899266435f) * c2;
    if (degree < 4)
        return;
    vf c3 = x * c2 - y * s2, s3 = x * s2 + y * c2;
    vf p18 = v_fma(v_set(3.31161143515146f), zz, v_set(-0.47308734787878f));
    vf p19 = z * v_fma(v_set(-4.683325804901025f), zz, v_set(2.007139630671868f));
    b[16] = v_set(0.6258357354491763f) * s3;
    b[17] = v_set(-1.770130769779931f) * z * s2;
    b[18] = p18 * s1;
    b[19] = p19 * y;
    b[20] = v_set(1.984313483298443f) * z * b[12] - v_set(1.006230589874905f) * b[6];
    b[21] = p19 * x;
    b[22] = p18 * c1;
    b[23] = v_set(-1.770130769779931f) * z * c2;
    b[24] = v_set(0.6258357354491763f) * c3;
}

/* Gradients by the polynomials from which the basis is built:
 * c1 + i s1 = (x + i y)^2, c2 + i s2 = (x + i y)^3; z is the sum for the coordinate itself. */
struct sh_grad {
    vf c1, s1, c2, s2, z;
};

MAP void sh_grad_4(const vf d[3], const vf *w, struct sh_grad *g, vf out[3])
{
    vf x = d[0], y = d[1], z = d[2], zz = z * z, k = v_set(-1.770130769779931f);
    vf c1 = x * x - y * y, s1 = v_set(2.0f) * x * y;
    vf c2 = x * c1 - y * s1, s2 = x * s1 + y * c1;
    vf g_s3 = v_set(0.6258357354491763f) * w[16], g_c3 = v_set(0.6258357354491763f) * w[24];
    vf p18 = v_fma(v_set(3.31161143515146f), zz, v_set(-0.47308734787878f));
    vf p19 = z * v_fma(v_set(-4.683325804901025f), zz, v_set(2.007139630671868f));
    vf dp19 = v_fma(v_set(-3 * 4.683325804901025f), zz, v_set(2.007139630671868f));
    vf p12 = z * v_fma(v_set(1.865881662950577f), zz, v_set(-1.119528997770346f));
    vf dp12 = v_fma(v_set(3 * 1.865881662950577f), zz, v_set(-1.119528997770346f));
    vf dp20 = v_set(1.984313483298443f) * (p12 + z * dp12) -
              v_set(2 * 1.006230589874905f * 0.9461746957575601f) * z;
    g->s2 = g->s2 + k * z * w[17];
    g->c2 = g->c2 + k * z * w[23];
    g->s1 = g->s1 + p18 * w[18];
    g->c1 = g->c1 + p18 * w[22];
    out[0] = out[0] + p19 * w[21];
    out[1] = out[1] + p19 * w[19];
    g->z = g->z + k * (s2 * w[17] + c2 * w[23]) + dp19 * (y * w[19] + x * w[21]);
    g->z = g->z + v_set(2 * 3.31161143515146f) * z * (s1 * w[18] + c1 * w[22]);
    g->z = g->z + dp20 * w[20];
    /* c3 = x c2 - y s2, s3 = x s2 + y c2 */
    out[0] = out[0] + c2 * g_c3 + s2 * g_s3;
    out[1] = out[1] - s2 * g_c3 + c2 * g_s3;
    g->c2 = g->c2 + x * g_c3 + y * g_s3;
    g->s2 = g->s2 - y * g_c3 + x * g_s3;
}

/* Degrees 3 and 4. */
MAP void sh_grad_3(int degree, const vf d[3], const vf *w, struct sh_grad *g, vf out[3])
{
    vf x = d[0], y = d[1], z = d[2], zz = z * z, k = v_set(1.445305721320277f);
    vf c1 = x * x - y * y, s1 = v_set(2.0f) * x * y;
    vf p11 = v_fma(v_set(-2.285228997322329f), zz, v_set(0.4570457994644658f));
    vf dp12 = v_fma(v_set(3 * 1.865881662950577f), zz, v_set(-1.119528997770346f));
    g->s2 = v_set(-0.5900435899266435f) * w[9];
    g->c2 = v_set(-0.5900435899266435f) * w[15];
    g->s1 = g->s1 + k * z * w[10];
    g->c1 = g->c1 + k * z * w[14];
    out[0] = out[0] + p11 * w[13];
    out[1] = out[1] + p11 * w[11];
    g->z = g->z + k * (s1 * w[10] + c1 * w[14]) +
           v_set(-2 * 2.285228997322329f) * z * (y * w[11] + x * w[13]);
    g->z = g->z + dp12 * w[12];
    if (degree >= 4)
        sh_grad_4(d, w, g, out);
    /* c2 = x c1 - y s1, s2 = x s1 + y c1 */
    out[0] = out[0] + c1 * g->c2 + s1 * g->s2;
    out[1] = out[1] - s1 * g->c2 + c1 * g->s2;
    g->c1 = g->c1 + x * g->c2 + y * g->s2;
    g->s1 = g->s1 - y * g->c2 + x * g->s2;
}

/* out[a] += sum_k w[k] d b_k / d d[a], sh_basis as polynomials of free x, y, z. */
MAP void sh_basis_grad(int degree, const vf d[3], const vf *w, vf out[3])
{
    vf x = d[0], y = d[1], z = d[2], two = v_set(2.0f), k = v_set(-1.092548430592079f);
    if (degree < 1)
        return;
    out[0] = out[0] - v_set(sh_c[1]) * w[3];
    out[1] = out[1] - v_set(sh_c[1]) * w[1];
    out[2] = out[2] + v_set(sh_c[1]) * w[2];
    if (degree < 2)
        return;
    struct sh_grad g;
    g.s1 = v_set(0.5462742152960395f) * w[4];
    g.c1 = v_set(0.5462742152960395f) * w[8];
    g.z = k * (y * w[5] + x * w[7]) + v_set(2 * 0.9461746957575601f) * z * w[6];
    out[0] = out[0] + k * z * w[7];
    out[1] = out[1] + k * z * w[5];
    if (degree >= 3)
        sh_grad_3(degree, d, w, &g, out);
    out[0] = out[0] + two * (x * g.c1 + y * g.s1);
    out[1] = out[1] + two * (x * g.s1 - y * g.c1);
    out[2] = out[2] + g.z;
}
