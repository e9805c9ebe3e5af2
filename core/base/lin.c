/* Cholesky by panels of columns. */
#include "core/base/lin.h"

#include <math.h>

enum { PANEL = 64, TILE = 16 }; // columns

double lin_normalise(double x[3])
{
    double len = sqrt(lin_dot(x, x));
    if (len > 0 && isfinite(len))
        for (int k = 0; k < 3; k++)
            x[k] /= len;
    return len;
}

void lin_tangents(const double t[3], double b1[3], double b2[3])
{
    int small = fabs(t[0]) < fabs(t[1]) ? 0 : 1;
    small = fabs(t[2]) < fabs(t[small]) ? 2 : small;
    const double e[3] = {small == 0, small == 1, small == 2};
    lin_cross(t, e, b1);
    lin_normalise(b1);
    lin_cross(t, b1, b2);
}

void lin_product(const double a[9], const double b[9], double out[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

void lin_product_t(const double a[9], const double b[9], double out[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = lin_dot(a + 3 * i, b + 3 * j);
}

void lin_add_equation(double *h, double *g, int n, const double *row, double w, double error)
{
    for (int i = 0; i < n; i++) {
        g[i] -= w * row[i] * error;
        for (int j = 0; j <= i; j++)
            h[(long)i * n + j] += w * row[i] * row[j];
    }
}

/* Columns from..end, from which the products with the columns before have been subtracted. */
static bool finish_columns(double *a, int n, int from, int end)
{
    for (int i = from; i < n; i++) {
        double *ai = a + (long)i * n;
        for (int j = from; j <= i && j < end; j++) {
            const double *aj = a + (long)j * n;
            double sum = ai[j];
            for (int k = from; k < j; k++)
                sum -= ai[k] * aj[k];
            if (j < i)
                ai[j] = sum / aj[j];
            else if (sum > 0 && isfinite(sum))
                ai[i] = sqrt(sum);
            else
                return false;
        }
    }
    return true;
}

static bool all_zero(const double *x, int n)
{
    for (int i = 0; i < n; i++)
        if (x[i] != 0)
            return false;
    return true;
}

/* A tile of columns from `at` on -= products of the rows' entries in columns from..end. */
static void subtract_columns(double *a, int n, const int column[2], int at)
{
    const int from = column[0], depth = column[1] - from, wide = n - at < TILE ? n - at : TILE;
    double tile[PANEL * TILE] = {0}; // the rows `at`.. of these columns, transposed
    for (int j = 0; j < wide; j++)
        for (int k = 0; k < depth; k++)
            tile[k * TILE + j] = a[(long)(at + j) * n + from + k];
    for (int i = at; i < n; i++) {
        double *ai = a + (long)i * n, sum[TILE] = {0};
        const int most = i - at + 1 < wide ? i - at + 1 : wide;
        if (all_zero(ai + from, depth)) // views that see nothing in common
            continue;
        for (int j = 0; j < most; j++)
            sum[j] = ai[at + j];
        for (int k = 0; k < depth; k++)
            for (int j = 0; j < TILE; j++)
                sum[j] -= ai[from + k] * tile[k * TILE + j];
        for (int j = 0; j < most; j++)
            ai[at + j] = sum[j];
    }
}

/* From panel to panel of columns. Products are subtracted from an entry in the order of columns,
 * so that panels do not change a bit of it. Where a row has nothing in a panel there is nothing to
 * subtract. */
bool lin_cholesky(double *a, int n)
{
    for (int from = 0; from < n; from += PANEL) {
        const int end = from + PANEL < n ? from + PANEL : n;
        if (!finish_columns(a, n, from, end))
            return false;
        for (int at = end; at < n; at += TILE)
            subtract_columns(a, n, (const int[2]){from, end}, at);
    }
    return true;
}

void lin_solve(const double *factor, int n, double *x)
{
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++)
            x[i] -= factor[(long)i * n + k] * x[k];
        x[i] /= factor[(long)i * n + i];
    }
    for (int i = n - 1; i >= 0; i--) {
        x[i] /= factor[(long)i * n + i];
        for (int k = 0; k < i; k++)
            x[k] -= factor[(long)i * n + k] * x[i];
    }
}

bool lin_inverse3(const double a[9], double out[9])
{
    const double c0 = a[4] * a[8] - a[5] * a[7], c1 = a[5] * a[6] - a[3] * a[8];
    const double c2 = a[3] * a[7] - a[4] * a[6];
    const double det = a[0] * c0 + a[1] * c1 + a[2] * c2;
    if (!(fabs(det) > 0) || !isfinite(det))
        return false;
    out[0] = c0 / det;
    out[1] = out[3] = c1 / det;
    out[2] = out[6] = c2 / det;
    out[4] = (a[0] * a[8] - a[2] * a[6]) / det;
    out[5] = out[7] = (a[2] * a[3] - a[0] * a[5]) / det;
    out[8] = (a[0] * a[4] - a[1] * a[3]) / det;
    return true;
}
