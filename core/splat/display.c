/* Degree 0 is solved directly, in double. For higher degrees the function on the other side of the
 * transfer is sampled on RINGS circles of latitude (Gauss-Legendre in z) in STEPS even steps and
 * projected back:  f_k = sum over directions of  weight * value * Y_k.
 * On one ring Y_(l,+-m) = p_lm(z) {cos, sin}(m phi), so both ways are short Fourier sums.
 * The rule is exact up to polynomials of degree 15: harmonics of degree 3 come back unchanged as
 * long as the sampled function has no bands above 12.
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
    WAVES = SH_DEGREE_MAX + 1,
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

static double log_radiance(double value, double shift)
{
    return clamp_log(fmax(decode_log(value), log((double)DISPLAY_FLOOR)) - shift);
}

/* Values of one ring, log radiance to display value less 0.5 and back; shift = ev ln 2. */
typedef void ring_fn(double shift, double v[STEPS]);

static void to_display(double shift, double v[STEPS])
{
    float knee = logf((float)knee_linear);
    for (int j = 0; j < STEPS; j++) {
        float u = (float)(clamp_log(v[j]) + shift);
        float shown = u > knee ? 1.055f * expf(u / 2.4f) - 0.055f : 12.92f * expf(u);
        v[j] = (double)shown - 0.5;
    }
}

static void to_log(double shift, double v[STEPS])
{
    for (int j = 0; j < STEPS; j++)
        v[j] = log_radiance(v[j] + 0.5, shift);
}

/* ---- the fit ---- */

/* p_lm(z) with the factor sqrt 2 of m > 0. */
static void ring_terms(double z, double p[TERMS])
{
    double zz = z * z, s = sqrt(1 - zz), s2 = s * s, s3 = s2 * s;
    p[0] = sh_c0;
    p[1] = 0.48860251190292 * z;
    p[2] = -0.48860251190292 * s;
    p[3] = 0.9461746957575601 * zz - 0.3153915652525201;
    p[4] = -1.092548430592079 * z * s;
    p[5] = 0.5462742152960395 * s2;
    p[6] = z * (1.865881662950577 * zz - 1.119528997770346);
    p[7] = (0.4570457994644658 - 2.285228997322329 * zz) * s;
    p[8] = 1.445305721320277 * z * s2;
    p[9] = -0.5900435899266435 * s3;
    p[10] = 1.984313483298443 * z * p[6] - 1.006230589874905 * p[3];
    p[11] = z * (2.007139630671868 - 4.683325804901025 * zz) * s;
    p[12] = (3.31161143515146 * zz - 0.47308734787878) * s2;
    p[13] = -1.770130769779931 * z * s3;
    p[14] = 0.6258357354491763 * s2 * s2;
}

/* cos and sin of m phi on the steps. */
struct waves {
    double cosine[WAVES][STEPS], sine[WAVES][STEPS];
};

static void waves_init(struct waves *w)
{
    static const double quarter[STEPS / 4 + 1] = {1, 0.9238795325112867, 0.7071067811865476,
                                                  0.3826834323650898, 0};
    double turn[STEPS];
    for (int j = 0; j < STEPS; j++) {
        int k = j <= STEPS / 2 ? j : STEPS - j;
        turn[j] = k <= STEPS / 4 ? quarter[k] : -quarter[STEPS / 2 - k];
    }
    for (int m = 0; m < WAVES; m++)
        for (int j = 0; j < STEPS; j++) {
            w->cosine[m][j] = turn[m * j % STEPS];
            w->sine[m][j] = turn[(m * j + 3 * STEPS / 4) % STEPS];
        }
}

/* Harmonics of one colour (every third number) on the ring with terms p. */
static void sample(const struct waves *w, const double p[TERMS], const float *sh, int degree,
                   double v[STEPS])
{
    memset(v, 0, STEPS * sizeof *v);
    for (int m = 0; m <= degree; m++) {
        double a = 0, b = 0;
        for (int l = m; l <= degree; l++) {
            double term = p[l * (l + 1) / 2 + m];
            a += term * (double)sh[3 * (l * l + l + m)];
            b += term * (double)sh[3 * (l * l + l - m)];
        }
        if (m == 0)
            b = 0;
        for (int j = 0; j < STEPS; j++)
            v[j] += a * w->cosine[m][j] + b * w->sine[m][j];
    }
}

/* out += weight * ring of values, projected. */
static void project(const struct waves *w, const double p[TERMS], const double v[STEPS], int degree,
                    double out[SH_COEFS_MAX])
{
    for (int m = 0; m <= degree; m++) {
        double a = 0, b = 0;
        for (int j = 0; j < STEPS; j++) {
            a += v[j] * w->cosine[m][j];
            b += v[j] * w->sine[m][j];
        }
        for (int l = m; l <= degree; l++) {
            double term = p[l * (l + 1) / 2 + m];
            out[l * l + l + m] += term * a;
            if (m > 0)
                out[l * l + l - m] += term * b;
        }
    }
}

struct fit {
    int degree_in, degree_out;
    double shift;
    ring_fn *fn;
};

static void fit_run(const struct fit *f, const float *in, float *out)
{
    struct waves w;
    double sum[3][SH_COEFS_MAX] = {0};
    waves_init(&w);
    for (int r = 0; r < RINGS; r++) {
        double p[TERMS], z = ring_z[r / 2], weight = ring_weight[r / 2] * 2 * pi / STEPS;
        ring_terms(r % 2 ? -z : z, p);
        for (int c = 0; c < 3; c++) {
            double v[STEPS];
            sample(&w, p, in + c, f->degree_in, v);
            f->fn(f->shift, v);
            for (int j = 0; j < STEPS; j++)
                v[j] *= weight;
            project(&w, p, v, f->degree_out, sum[c]);
        }
    }
    for (int k = 0; k < (f->degree_out + 1) * (f->degree_out + 1); k++)
        for (int c = 0; c < 3; c++)
            out[3 * k + c] = (float)sum[c][k];
}

/* NaN for a colour of which some coefficient is not finite. */
static void spread_nan(const float *in, int degree_in, int degree_out, float *out)
{
    for (int c = 0; c < 3; c++) {
        bool finite = true;
        for (int k = 0; k < (degree_in + 1) * (degree_in + 1); k++)
            finite &= isfinite(in[3 * k + c]) != 0;
        for (int k = 0; k < (degree_out + 1) * (degree_out + 1) && !finite; k++)
            out[3 * k + c] = NAN;
    }
}

void display_from_radiance(const float *log_sh, int degree, float ev, float *out)
{
    double shift = (double)ev * ln2;
    int top = degree < DISPLAY_DEGREE_MAX ? degree : DISPLAY_DEGREE_MAX;
    for (int c = 0; c < 3 && degree == 0; c++) {
        double shown = encode(exp(clamp_log(sh_c0 * (double)log_sh[c]) + shift));
        out[c] = (float)((shown - 0.5) / sh_c0);
    }
    if (degree > 0)
        fit_run(&(struct fit){degree, top, shift, to_display}, log_sh, out);
    spread_nan(log_sh, degree, top, out);
}

void display_to_radiance(const float *f, int degree, float ev, float *out)
{
    double shift = (double)ev * ln2;
    for (int c = 0; c < 3 && degree == 0; c++)
        out[c] = (float)(log_radiance(0.5 + sh_c0 * (double)f[c], shift) / sh_c0);
    if (degree > 0)
        fit_run(&(struct fit){degree, degree, shift, to_log}, f, out);
    spread_nan(f, degree, degree, out);
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
    for (int s = 0; s <= c->n; s++) {
        double lo = s > 0 ? fmax((double)c->knot[s - 1], lowest) : lowest;
        double hi = s < c->n ? fmin((double)c->knot[s], highest) : highest;
        double a = (double)c->a[s], b = (double)c->b[s];
        if (lo < hi && a * lo + b <= 0 && a * hi + b > 0) {
            *x = -b / a;
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
 * black and white, one of them at 0.5; above the last the curve is level. What the curve adds to radiance is
 * taken off at 0.5, so that display_ev gives ev again. */
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
        slope += (double)p[2 * TONE_HIDDEN + i]; // as rounded, so that the end is level
        x = next_x;
        y = next_y;
    }
    for (int c = 1; c < 3; c++)
        memcpy(out->p + c * TONE_PER_COLOUR, out->p, TONE_PER_COLOUR * sizeof(float));
}
