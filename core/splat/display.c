/* Degree 0 is solved directly, in double. For higher degrees the transferred function is sampled on
 * RINGS circles of latitude (Gauss-Legendre in z) in STEPS even steps and fitted. On one ring
 * Y_(l,+-m) = p_lm(z) {cos, sin}(m phi), so sums over k and over directions are short Fourier sums.
 * The rule is exact for polynomials up to degree 15. To display values the least-squares fit is the
 * projection f_k = sum weight value Y_k. The inverse is fitted in the logarithm, where an error at
 * a display value v appears (v + 0.055) / 2.4 times as large. The square of that is the weight of a
 * least-squares fit by conjugate gradients, which start at the projection.
 * Nodes and weights: Abramowitz and Stegun, table 25.4. Harmonics: core/splat/README.md 4.
 * Transfer: IEC 61966-2-1. */
#include "core/splat/display.h"

#include "core/base/num.h"
#include "core/kernels/kernels.h"
#include "core/photo/tonemap.h"

#include <math.h>
#include <string.h>

enum {
    RINGS = 8,
    STEPS = 16,
    HALF = STEPS / 2,
    DIRECTIONS = RINGS * STEPS,
    WAVES = SH_DEGREE_MAX + 1,
    ITERATIONS = 4,                 // more gain less than 1 dB
    TERMS = WAVES * (WAVES + 1) / 2 // p_lm at l (l + 1) / 2 + m
};

static const double ring_z[RINGS / 2] = {0.1834346424956498, 0.5255324099163290, 0.7966664774136267,
                                         0.9602898564975363};
static const double ring_weight[RINGS / 2] = {0.3626837833783620, 0.3137066458778873,
                                              0.2223810344533745, 0.1012285362903763};

static const double ln2 = 0.6931471805599453;
static const double knee_linear = 0.0031308, knee_value = 0.04045;

/* ---- the transfer ---- */

static double srgb_encode(double linear)
{
    if (!(linear > knee_linear))
        return 12.92 * linear;
    return 1.055 * pow(linear, 1 / 2.4) - 0.055;
}

/* Natural logarithm of the linear value. */
static double srgb_decode_log(double value)
{
    if (!(value > knee_value))
        return log(fmax(value, 0) / 12.92);
    return 2.4 * log((value + 0.055) / 1.055);
}

float display_encode(float linear)
{
    return (float)srgb_encode((double)linear);
}

float display_decode(float value)
{
    if (!((double)value > knee_value))
        return (float)((double)value / 12.92);
    return (float)pow(((double)value + 0.055) / 1.055, 2.4);
}

static double clamp_log(double v)
{
    return fmin(fmax(v, -(double)RASTER_LOG_MAX), (double)RASTER_LOG_MAX);
}

/* ---- lanes ---- */

typedef float lanes __attribute__((vector_size(16))); // red, green, blue and one that is 0
typedef int32_t truths __attribute__((vector_size(16)));
typedef uint32_t words __attribute__((vector_size(16)));

static lanes lanes_all(float v)
{
    return (lanes){v, v, v, v};
}

static lanes lanes_select(truths which, lanes yes, lanes no)
{
    return (lanes)((which & (truths)yes) | (~which & (truths)no));
}

/* `lo` for NaN. */
static lanes lanes_max(lanes v, float lo)
{
    return lanes_select(v > lo, v, lanes_all(lo));
}

static lanes lanes_clamp(lanes v, float lo, float hi)
{
    v = lanes_max(v, lo);
    return lanes_select(v < hi, v, lanes_all(hi));
}

/* Natural logarithm of v > 0 that is not denormal: v = 2^e (1 + t), sqrt(1/2) <= 1 + t < sqrt(2).
 * Polynomial: Cephes, logf.c. */
static lanes lanes_log(lanes v)
{
    const uint32_t root = 0x3f3504f3, one = 0x3f800000, mantissa = 0x7fffff;
    truths bits = (truths)((words)v + (one - root)), e = (bits >> 23) - 127;
    lanes t = (lanes)(((words)bits & mantissa) + root) - 1;
    lanes p = 7.0376836292e-2f * t - 1.1514610310e-1f;
    p = (p * t + 1.1676998740e-1f) * t - 1.2420140846e-1f;
    p = (p * t + 1.4249322787e-1f) * t - 1.6668057665e-1f;
    p = (p * t + 2.0000714765e-1f) * t - 2.4999993993e-1f;
    p = p * t + 3.3333331174e-1f;
    lanes n = __builtin_convertvector(e, lanes), tt = t * t;
    return t + (t * tt * p + n * -2.12194440e-4f - 0.5f * tt) + n * 0.693359375f;
}

/* ---- the sphere ---- */

struct sphere {
    lanes p[RINGS][TERMS], weighted[RINGS][TERMS]; // weighted: times the weight of a direction
    lanes cosine[HALF][WAVES], sine[HALF][WAVES];
};

/* p_lm(z) with the factor sqrt 2 of m > 0. */
static void ring_terms(double z, float p[TERMS])
{
    double zz = z * z, s = sqrt(1 - zz), s2 = s * s, s3 = s2 * s;
    double p3 = 0.9461746957575601 * zz - 0.3153915652525201;
    double p6 = z * (1.865881662950577 * zz - 1.119528997770346);
    p[0] = (float)SH_BASIS0;
    p[1] = (float)(0.48860251190292 * z);
    p[2] = (float)(-0.48860251190292 * s);
    p[3] = (float)p3;
    p[4] = (float)(-1.092548430592079 * z * s);
    p[5] = (float)(0.5462742152960395 * s2);
    p[6] = (float)p6;
    p[7] = (float)((0.4570457994644658 - 2.285228997322329 * zz) * s);
    p[8] = (float)(1.445305721320277 * z * s2);
    p[9] = (float)(-0.5900435899266435 * s3);
    p[10] = (float)(1.984313483298443 * z * p6 - 1.006230589874905 * p3);
    p[11] = (float)(z * (2.007139630671868 - 4.683325804901025 * zz) * s);
    p[12] = (float)((3.31161143515146 * zz - 0.47308734787878) * s2);
    p[13] = (float)(-1.770130769779931 * z * s3);
    p[14] = (float)(0.6258357354491763 * s2 * s2);
}

static void sphere_init(struct sphere *s)
{
    static const float quarter[STEPS / 4 + 1] = {1, 0.923879533f, 0.707106781f, 0.382683432f, 0};
    float turn[STEPS]; // cosine of a step
    for (int j = 0; j < STEPS; j++) {
        int k = j <= STEPS / 2 ? j : STEPS - j;
        turn[j] = k <= STEPS / 4 ? quarter[k] : -quarter[STEPS / 2 - k];
    }
    for (int m = 0; m < WAVES; m++)
        for (int j = 0; j < HALF; j++) {
            s->cosine[j][m] = lanes_all(turn[m * j % STEPS]);
            s->sine[j][m] = lanes_all(turn[(m * j + 3 * STEPS / 4) % STEPS]);
        }
    for (int r = 0; r < RINGS; r++) {
        float p[TERMS], weight = (float)(ring_weight[r / 2] * 2 * NUM_PI / STEPS);
        ring_terms(r % 2 ? -ring_z[r / 2] : ring_z[r / 2], p);
        for (int t = 0; t < TERMS; t++) {
            s->p[r][t] = lanes_all(p[t]);
            s->weighted[r][t] = lanes_all(weight * p[t]);
        }
    }
}

/* v = sum_k sh_k Y_k. */
static void sphere_sample(const struct sphere *s, const lanes *sh, int degree, lanes v[DIRECTIONS])
{
    for (int r = 0; r < RINGS; r++, v += STEPS) {
        lanes a[WAVES] = {0}, b[WAVES] = {0};
        for (int m = 0; m <= degree; m++) {
            lanes x = {0}, y = {0};
            for (int l = m; l <= degree; l++) {
                x += s->p[r][l * (l + 1) / 2 + m] * sh[l * l + l + m];
                y += s->p[r][l * (l + 1) / 2 + m] * sh[l * l + l - m];
            }
            a[m] = x;
            b[m] = y;
        }
        for (int j = 0; j < HALF; j++) {
            const lanes *c = s->cosine[j], *d = s->sine[j];
            lanes even = a[0] + a[2] * c[2] + b[2] * d[2] + a[4] * c[4] + b[4] * d[4];
            lanes odd = a[1] * c[1] + b[1] * d[1] + a[3] * c[3] + b[3] * d[3];
            v[j] = even + odd;
            v[j + HALF] = even - odd;
        }
    }
}

/* sh_k = sum of weight v Y_k. */
static void sphere_project(const struct sphere *s, const lanes v[DIRECTIONS], int degree, lanes *sh)
{
    memset(sh, 0, SH_COEFS_MAX * sizeof *sh);
    for (int r = 0; r < RINGS; r++, v += STEPS) {
        lanes a[WAVES] = {0}, b[WAVES] = {0};
        for (int j = 0; j < HALF; j++) {
            const lanes *c = s->cosine[j], *d = s->sine[j];
            lanes even = v[j] + v[j + HALF], odd = v[j] - v[j + HALF];
            a[0] += even;
            a[1] += odd * c[1];
            b[1] += odd * d[1];
            a[2] += even * c[2];
            b[2] += even * d[2];
            a[3] += odd * c[3];
            b[3] += odd * d[3];
            a[4] += even * c[4];
            b[4] += even * d[4];
        }
        for (int l = 0; l <= degree; l++)
            for (int m = 0; m <= l; m++) {
                lanes term = s->weighted[r][l * (l + 1) / 2 + m];
                sh[l * l + l + m] += term * a[m];
                sh[l * l + l - m] += term * b[m]; // 0 for m = 0
            }
    }
}

/* ---- the fits ---- */

static int coefs_of(int degree)
{
    return (degree + 1) * (degree + 1);
}

static void fit_display(const struct sphere *s, int degree, float shift, lanes sh[SH_COEFS_MAX])
{
    const float knee = logf((float)knee_linear);
    lanes v[DIRECTIONS];
    sphere_sample(s, sh, degree, v);
    for (int i = 0; i < DIRECTIONS; i++) {
        lanes u = lanes_clamp(v[i], -RASTER_LOG_MAX, RASTER_LOG_MAX) + shift;
        for (int c = 0; c < 3; c++)
            u[c] = u[c] > knee ? 1.055f * expf(u[c] / 2.4f) - 0.055f : 12.92f * expf(u[c]);
        v[i] = u - 0.5f;
    }
    sphere_project(s, v, degree, sh);
}

static lanes lanes_dot(const lanes *a, const lanes *b, int n)
{
    lanes sum = {0};
    for (int k = 0; k < n; k++)
        sum += a[k] * b[k];
    return sum;
}

/* Display values less 0.5 become logarithms of radiance.
 * out: seen, the weights of the fit. */
static void to_logarithms(float shift, lanes v[DIRECTIONS], lanes seen[DIRECTIONS])
{
    for (int i = 0; i < DIRECTIONS; i++) {
        lanes shown = v[i] + 0.5f, slope = lanes_clamp(shown, 0, 1) + 0.055f;
        truths curved = shown > (float)knee_value;
        lanes linear = lanes_max(shown * (1 / 12.92f), DISPLAY_FLOOR_FIT);
        lanes logs = lanes_log(lanes_select(curved, (shown + 0.055f) * (1 / 1.055f), linear));
        v[i] = lanes_clamp(lanes_select(curved, 2.4f * logs, logs) - shift, -RASTER_LOG_MAX,
                           RASTER_LOG_MAX);
        seen[i] = slope * slope;
    }
}

/* A colour that already fits stays as it is: its error would be a divisor near 0. */
static void fit_log(const struct sphere *s, int degree, float shift, lanes sh[SH_COEFS_MAX])
{
    const lanes none = {0};
    const int n = coefs_of(degree);
    lanes v[DIRECTIONS], seen[DIRECTIONS], w[DIRECTIONS];
    lanes residual[SH_COEFS_MAX], step[SH_COEFS_MAX], image[SH_COEFS_MAX];
    sphere_sample(s, sh, degree, v);
    to_logarithms(shift, v, seen);
    sphere_project(s, v, degree, sh);
    sphere_sample(s, sh, degree, w);
    for (int i = 0; i < DIRECTIONS; i++)
        w[i] = seen[i] * (v[i] - w[i]);
    sphere_project(s, w, degree, residual);
    memcpy(step, residual, sizeof step);
    lanes length = lanes_dot(residual, residual, n), enough = 1e-10f * length;
    for (int i = 0; i < ITERATIONS; i++) {
        sphere_sample(s, step, degree, w);
        for (int j = 0; j < DIRECTIONS; j++)
            w[j] *= seen[j];
        sphere_project(s, w, degree, image);
        truths on = length > enough;
        lanes go = lanes_select(on, length / lanes_dot(step, image, n), none), before = length;
        for (int k = 0; k < n; k++) {
            sh[k] += go * step[k];
            residual[k] -= go * image[k];
        }
        length = lanes_dot(residual, residual, n);
        lanes keep = lanes_select(on, length / before, none);
        for (int k = 0; k < n; k++)
            step[k] = residual[k] + keep * step[k];
    }
}

/* Degree 0 in both directions. shift: natural logarithm. */
static double flat_to_display(double log_radiance, double shift)
{
    return (srgb_encode(exp(clamp_log(SH_BASIS0 * log_radiance) + shift)) - 0.5) / SH_BASIS0;
}

static double flat_to_log(double shown, double shift)
{
    double linear = fmax(srgb_decode_log(0.5 + SH_BASIS0 * shown), log((double)DISPLAY_FLOOR));
    return clamp_log(linear - shift) / SH_BASIS0;
}

/* flat is for degree 0, fit for the others. */
struct conversion {
    double (*flat)(double sh, double shift);
    void (*fit)(const struct sphere *s, int degree, float shift, lanes sh[SH_COEFS_MAX]);
};

/* top: degree of out. A colour with a coefficient that is not finite becomes NaN. */
static void convert_splat(const struct conversion *how, const float *in, int degree, int top,
                          float ev, float *out)
{
    const double shift = (double)ev * ln2;
    lanes sh[SH_COEFS_MAX] = {0};
    bool finite[3] = {true, true, true};
    for (int j = 0; j < 3 * coefs_of(degree); j++) {
        sh[j / 3][j % 3] = in[j];
        finite[j % 3] &= isfinite(in[j]) != 0;
    }
    if (degree > 0) {
        struct sphere s;
        sphere_init(&s);
        how->fit(&s, degree, (float)shift, sh);
    }
    for (int c = 0; c < 3 && degree == 0; c++)
        sh[0][c] = (float)how->flat((double)in[c], shift);
    for (int j = 0; j < 3 * coefs_of(top); j++)
        out[j] = finite[j % 3] ? sh[j / 3][j % 3] : NAN;
}

void display_from_radiance(const float *log_sh, int degree, float ev, float *out)
{
    static const struct conversion how = {flat_to_display, fit_display};
    convert_splat(&how, log_sh, degree, degree < DISPLAY_DEGREE_MAX ? degree : DISPLAY_DEGREE_MAX,
                  ev, out);
}

void display_to_radiance(const float *f, int degree, float ev, float *out)
{
    static const struct conversion how = {flat_to_log, fit_log};
    convert_splat(&how, f, degree, degree, ev, out);
}

/* ---- tone curves ---- */

static double middle_log2(void) // linear light that sRGB shows as 0.5
{
    return srgb_decode_log(0.5) / ln2;
}

/* log2 exposure where the curve first rises through 0.5. */
static bool find_middle(const struct tonemap_curve *c, double *x)
{
    double lowest = log2(2 * (double)TONEMAP_FLOOR), highest = (double)RASTER_LOG_MAX / ln2;
    bool below = false;
    for (int s = 0; s <= c->n; s++) {
        double lo = s > 0 ? fmax((double)c->knot[s - 1], lowest) : lowest;
        double hi = s < c->n ? fmin((double)c->knot[s], highest) : highest;
        double a = (double)c->a[s], b = (double)c->b[s];
        if (!(lo < hi))
            continue;
        below |= a * lo + b <= 0; // perhaps only on the segment before, if 0.5 is at a knot
        if (below && a * hi + b > 0) {
            *x = fmin(fmax(-b / a, lo), hi);
            return true;
        }
    }
    return false;
}

float display_ev(const struct tonemap *t)
{
    struct tonemap_table table;
    double sum = 0, x;
    int n = 0;
    tonemap_table_init(&table, t);
    for (int c = 0; c < 3; c++)
        if (find_middle(&table.c[c], &x)) {
            sum += middle_log2() - log2(exp2(x) - (double)TONEMAP_FLOOR);
            n++;
        }
    return n > 0 ? (float)(sum / n) : 0;
}

/* Unit 0 is the line through the dark; the others bend it at display values that are densest near
 * black and white, one of them at 0.5. Above the last the curve is level. TONEMAP_FLOOR, which the
 * curve adds to radiance, is compensated at 0.5, so that display_ev returns ev. */
void display_tonemap(float ev, struct tonemap *out)
{
    const int knots = TONE_HIDDEN - 1;
    const double far = -40; // stops below white
    double stops = middle_log2() - log2(exp2(middle_log2() - (double)ev) + (double)TONEMAP_FLOOR);
    double x = far - stops, y = log(12.92) + far * ln2, slope = 0;
    float *p = out->p;
    memset(out, 0, sizeof *out);
    p[3 * TONE_HIDDEN] = (float)y;
    for (int i = 0; i < TONE_HIDDEN; i++) {
        double value = 0.5 - 0.5 * cos(NUM_PI * (i + 0.5) / knots); // at the next knot
        double next_x = srgb_decode_log(value) / ln2 - stops, next_y = log(value / (1 - value));
        double next_slope = i < knots ? (next_y - y) / (next_x - x) : 0;
        p[i] = 1;
        p[TONE_HIDDEN + i] = (float)-x;
        p[2 * TONE_HIDDEN + i] = (float)(next_slope - slope);
        slope = next_slope;
        x = next_x;
        y = next_y;
    }
    for (int c = 1; c < 3; c++)
        memcpy(out->p + c * TONE_PER_COLOUR, out->p, TONE_PER_COLOUR * sizeof(float));
}
