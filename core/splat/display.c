/* Degree 0 is solved directly, in double. For higher degrees the function on the other side of the
 * transfer is sampled on RINGS circles of latitude (Gauss-Legendre in z) in STEPS even steps and
 * fitted. On one ring Y_(l,+-m) = p_lm(z) {cos, sin}(m phi), so sums over k and over directions are
 * short Fourier sums. The rule is exact for polynomials up to degree 15.
 * To display values the least-squares fit is the projection f_k = sum weight value Y_k. The way
 * back is fitted in the logarithm, where an error at a display value v is seen (v + 0.055) / 2.4
 * times: least squares with the square of that as weights, by conjugate gradients that begin at
 * the projection.
 * Nodes and weights: Abramowitz and Stegun, table 25.4. Harmonics: sh_body.h (model-spec 2.13).
 * Transfer: IEC 61966-2-1. */
#include "core/splat/display.h"

#include "core/kernels/kernels.h"
#include "core/net/tonemap.h"

#include <math.h>
#include <string.h>

enum {
    RINGS = 8,
    STEPS = 16,
    DIRECTIONS = RINGS * STEPS,
    WAVES = SH_DEGREE_MAX + 1,
    ITERATIONS = 4,                 // more gain less than 1 dB
    TERMS = WAVES * (WAVES + 1) / 2 // p_lm at l (l + 1) / 2 + m
};

static const double ring_z[RINGS / 2] = {0.1834346424956498, 0.5255324099163290, 0.7966664774136267,
                                         0.9602898564975363};
static const double ring_weight[RINGS / 2] = {0.3626837833783620, 0.3137066458778873,
                                              0.2223810344533745, 0.1012285362903763};

static const double sh_c0 = 0.2820947917738781;
static const double pi = 3.141592653589793, ln2 = 0.6931471805599453;
static const double knee_linear = 0.0031308, knee_value = 0.04045;

/* ---- the transfer ---- */

static double encode(double linear)
{
    if (!(linear > knee_linear))
        return 12.92 * linear;
    return 1.055 * pow(linear, 1 / 2.4) - 0.055;
}

/* Natural logarithm of the linear value. */
static double decode_log(double value)
{
    if (!(value > knee_value))
        return log(fmax(value, 0) / 12.92);
    return 2.4 * log((value + 0.055) / 1.055);
}

float display_encode(float linear)
{
    return (float)encode((double)linear);
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

/* ---- the sphere ---- */

struct sphere {
    float p[RINGS][TERMS], weight[RINGS]; // weights of a direction
    float cosine[WAVES][STEPS], sine[WAVES][STEPS];
};

/* p_lm(z) with the factor sqrt 2 of m > 0. */
static void ring_terms(double z, float p[TERMS])
{
    double zz = z * z, s = sqrt(1 - zz), s2 = s * s, s3 = s2 * s;
    double p3 = 0.9461746957575601 * zz - 0.3153915652525201;
    double p6 = z * (1.865881662950577 * zz - 1.119528997770346);
    p[0] = (float)sh_c0;
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
        for (int j = 0; j < STEPS; j++) {
            s->cosine[m][j] = turn[m * j % STEPS];
            s->sine[m][j] = turn[(m * j + 3 * STEPS / 4) % STEPS];
        }
    for (int r = 0; r < RINGS; r++) {
        ring_terms(r % 2 ? -ring_z[r / 2] : ring_z[r / 2], s->p[r]);
        s->weight[r] = (float)(ring_weight[r / 2] * 2 * pi / STEPS);
    }
}

/* v = sum_k sh_k Y_k. */
static void sample(const struct sphere *s, const float *sh, int degree, float v[DIRECTIONS])
{
    memset(v, 0, DIRECTIONS * sizeof *v);
    for (int r = 0; r < RINGS; r++, v += STEPS)
        for (int m = 0; m <= degree; m++) {
            float a = 0, b = 0;
            for (int l = m; l <= degree; l++) {
                a += s->p[r][l * (l + 1) / 2 + m] * sh[l * l + l + m];
                b += s->p[r][l * (l + 1) / 2 + m] * sh[l * l + l - m];
            }
            for (int j = 0; j < STEPS; j++)
                v[j] += a * s->cosine[m][j] + b * s->sine[m][j]; // the sine of m = 0 is 0
        }
}

/* sh_k = sum of weight v Y_k. */
static void project(const struct sphere *s, const float v[DIRECTIONS], int degree, float *sh)
{
    memset(sh, 0, SH_COEFS_MAX * sizeof *sh);
    for (int r = 0; r < RINGS; r++, v += STEPS)
        for (int m = 0; m <= degree; m++) {
            float a = 0, b = 0;
            for (int j = 0; j < STEPS; j++) {
                a += v[j] * s->cosine[m][j];
                b += v[j] * s->sine[m][j];
            }
            for (int l = m; l <= degree; l++) {
                float term = s->weight[r] * s->p[r][l * (l + 1) / 2 + m];
                sh[l * l + l + m] += term * a;
                sh[l * l + l - m] += term * b; // of m = 0: 0
            }
        }
}

/* ---- the fits ---- */

static int coefs_of(int degree)
{
    return (degree + 1) * (degree + 1);
}

static void fit_display(const struct sphere *s, int degree, float shift, float sh[SH_COEFS_MAX])
{
    const float knee = logf((float)knee_linear);
    float v[DIRECTIONS];
    sample(s, sh, degree, v);
    for (int i = 0; i < DIRECTIONS; i++) {
        float u = fminf(fmaxf(v[i], -RASTER_LOG_MAX), RASTER_LOG_MAX) + shift;
        v[i] = (u > knee ? 1.055f * expf(u / 2.4f) - 0.055f : 12.92f * expf(u)) - 0.5f;
    }
    project(s, v, degree, sh);
}

static float dot(const float *a, const float *b, int n)
{
    float sum = 0;
    for (int k = 0; k < n; k++)
        sum += a[k] * b[k];
    return sum;
}

/* out = projection of weighted values of sh. */
static void apply(const struct sphere *s, const float seen[DIRECTIONS], int degree, const float *sh,
                  float *out)
{
    float v[DIRECTIONS];
    sample(s, sh, degree, v);
    for (int i = 0; i < DIRECTIONS; i++)
        v[i] *= seen[i];
    project(s, v, degree, out);
}

static void fit_log(const struct sphere *s, int degree, float shift, float sh[SH_COEFS_MAX])
{
    float v[DIRECTIONS], seen[DIRECTIONS], weighted[DIRECTIONS];
    float residual[SH_COEFS_MAX], step[SH_COEFS_MAX], image[SH_COEFS_MAX];
    int n = coefs_of(degree);
    sample(s, sh, degree, v);
    for (int i = 0; i < DIRECTIONS; i++) {
        float shown = v[i] + 0.5f, slope = fminf(fmaxf(shown, 0), 1) + 0.055f;
        seen[i] = slope * slope;
        float log_linear = shown > (float)knee_value
                               ? 2.4f * logf((shown + 0.055f) / 1.055f)
                               : logf(fmaxf(shown / 12.92f, DISPLAY_FLOOR_FIT));
        v[i] = fminf(fmaxf(log_linear - shift, -RASTER_LOG_MAX), RASTER_LOG_MAX);
        weighted[i] = seen[i] * v[i];
    }
    project(s, v, degree, sh);
    apply(s, seen, degree, sh, image);
    project(s, weighted, degree, residual);
    for (int k = 0; k < n; k++)
        step[k] = residual[k] -= image[k];
    float length = dot(residual, residual, n), enough = 1e-10f * length;
    for (int i = 0; i < ITERATIONS && length > enough; i++) {
        apply(s, seen, degree, step, image);
        float go = length / dot(step, image, n), before = length;
        for (int k = 0; k < n; k++) {
            sh[k] += go * step[k];
            residual[k] -= go * image[k];
        }
        length = dot(residual, residual, n);
        for (int k = 0; k < n; k++)
            step[k] = residual[k] + length / before * step[k];
    }
}

/* Degree 0, both ways. shift: natural logarithm. */
static double shown_of(double log_radiance, double shift)
{
    return (encode(exp(clamp_log(sh_c0 * log_radiance) + shift)) - 0.5) / sh_c0;
}

static double log_of(double shown, double shift)
{
    double linear = fmax(decode_log(0.5 + sh_c0 * shown), log((double)DISPLAY_FLOOR));
    return clamp_log(linear - shift) / sh_c0;
}

/* Of degree 0, and of any other. */
struct conversion {
    double (*flat)(double sh, double shift);
    void (*fit)(const struct sphere *s, int degree, float shift, float sh[SH_COEFS_MAX]);
};

/* top: degree of out. A colour of which some coefficient is not finite becomes NaN. */
static void convert(const struct conversion *how, const float *in, int degree, int top, float ev,
                    float *out)
{
    const double shift = (double)ev * ln2;
    struct sphere s;
    if (degree > 0)
        sphere_init(&s);
    for (int c = 0; c < 3; c++) {
        float sh[SH_COEFS_MAX];
        bool finite = true;
        for (int k = 0; k < coefs_of(degree); k++) {
            sh[k] = in[3 * k + c];
            finite &= isfinite(sh[k]) != 0;
        }
        if (degree > 0)
            how->fit(&s, degree, (float)shift, sh);
        else
            sh[0] = (float)how->flat((double)sh[0], shift);
        for (int k = 0; k < coefs_of(top); k++)
            out[3 * k + c] = finite ? sh[k] : NAN;
    }
}

void display_from_radiance(const float *log_sh, int degree, float ev, float *out)
{
    static const struct conversion how = {shown_of, fit_display};
    convert(&how, log_sh, degree, degree < DISPLAY_DEGREE_MAX ? degree : DISPLAY_DEGREE_MAX, ev,
            out);
}

void display_to_radiance(const float *f, int degree, float ev, float *out)
{
    static const struct conversion how = {log_of, fit_log};
    convert(&how, f, degree, degree, ev, out);
}

/* ---- tone curves ---- */

static double middle_log2(void) // of linear light that sRGB shows as 0.5
{
    return decode_log(0.5) / ln2;
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

/* Unit 0 carries the line of the dark, the others bend it at display values that are densest near
 * black and white, one of them at 0.5; above the last the curve is level. What the curve adds to
 * radiance is taken off at 0.5, so that display_ev gives ev again. */
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
        double value = 0.5 - 0.5 * cos(pi * (i + 0.5) / knots); // at the next knot
        double next_x = decode_log(value) / ln2 - stops, next_y = log(value / (1 - value));
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
