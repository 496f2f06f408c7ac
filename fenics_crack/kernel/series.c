#include "series.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "lapack.h"

static double larger(double a, double b) { return a > b ? a : b; }

WIDE void add_rows(int count, int n, const double *restrict rows, const double *restrict weights,
                   double *restrict sum)
{
    int k = 0;
    if (n == 1) {
        *sum += dot(count, rows, weights);
        return;
    }
    for (; k + 3 < count; k += 4, rows += 4L * n) {
        const double a = weights[k], b = weights[k + 1], c = weights[k + 2], d = weights[k + 3];
        const double *one = rows + n, *two = one + n, *three = two + n;
        for (int i = 0; i < n; i++)
            sum[i] += (a * rows[i] + b * one[i]) + (c * two[i] + d * three[i]);
    }
    if (k + 2 < count) {
        const double a = weights[k], b = weights[k + 1], c = weights[k + 2];
        for (int i = 0; i < n; i++)
            sum[i] += (a * rows[i] + b * rows[n + i]) + c * rows[2L * n + i];
        return;
    }
    for (; k < count; k++, rows += n)
        for (int i = 0; i < n; i++) sum[i] += weights[k] * rows[i];
}

/* Of `count` functions at once, as many as a processor finishes while it waits for the first. */
static inline __attribute__((always_inline)) void
some_at(int count, int n, int order, const double *restrict row, double time,
        double *restrict value, double *restrict slope)
{
    double v[4 * BLOCK] = {0.0}, d[4 * BLOCK] = {0.0};
    row += (long)order * n;
    for (int k = order; k >= 0; k--, row -= n)
        for (int i = 0; i < count; i++) {
            d[i] = d[i] * time + v[i];
            v[i] = v[i] * time + row[i];
        }
    memcpy(value, v, (size_t)count * sizeof(double));
    memcpy(slope, d, (size_t)count * sizeof(double));
}

WIDE void series_at(int n, int order, const double *restrict terms, double time,
                    double *restrict value, double *restrict slope)
{
    int i = 0;
    for (; i + 4 * BLOCK <= n; i += 4 * BLOCK)
        some_at(4 * BLOCK, n, order, terms + i, time, value + i, slope + i);
    for (; i + 2 * BLOCK <= n; i += 2 * BLOCK)
        some_at(2 * BLOCK, n, order, terms + i, time, value + i, slope + i);
    for (; i + BLOCK <= n; i += BLOCK)
        some_at(BLOCK, n, order, terms + i, time, value + i, slope + i);
    if (i < n) some_at(n - i, n, order, terms + i, time, value + i, slope + i);
}

WIDE void series_at_times(int n, int order, const double *restrict terms,
                          const double *restrict times, double *restrict value,
                          double *restrict slope)
{
    for (int i = 0; i < n; i++) {
        const double *row = terms + (long)order * n + i;
        double v[BLOCK] = {0.0}, d[BLOCK] = {0.0};
        for (int k = order; k >= 0; k--, row -= n)
            for (int j = 0; j < BLOCK; j++) {
                d[j] = d[j] * times[j] + v[j];
                v[j] = v[j] * times[j] + *row;
            }
        for (int j = 0; j < BLOCK; j++) {
            value[j * n + i] = v[j];
            slope[j * n + i] = d[j];
        }
    }
}

double column_at(int n, int order, const double *terms, int column, int slopes, double time,
                 double *slope)
{
    double v = 0.0, d = 0.0;
    for (int k = order; k >= slopes; k--) {
        const double term = terms[(long)k * n + column];
        d = d * time + v;
        v = v * time + (slopes ? k * term : term);
    }
    *slope = d;
    return v;
}

double column_zero(int n, int order, const double *terms, int column, int slopes, double low,
                   double high)
{
    double slope, zero = 0.5 * (low + high);
    for (int turn = 0; turn < DBL_MANT_DIG && high - low > 0.5 * DBL_EPSILON * high; turn++) {
        const double now = column_at(n, order, terms, column, slopes, zero, &slope);
        const double newton = zero - now / slope;
        if (now == 0.0) return zero;
        if ((now > 0.0) == !slopes) low = zero;
        else high = zero;
        if (fabs(newton - zero) <= 4.0 * DBL_EPSILON * high) return zero;
        zero = newton > low && newton < high ? newton : 0.5 * (low + high);
    }
    return zero;
}

WIDE void series_sizes(int n, int order, const double *restrict terms, double *restrict sizes)
{
    for (int k = order + 1; k < TERMS; k++) sizes[k] = 0.0;
    for (int k = 0; k <= order; k++, terms += n) {
        double most[4] = {0.0};
        int i = 0;
        for (; i + 3 < n; i += 4)
            for (int j = 0; j < 4; j++) most[j] = larger(fabs(terms[i + j]), most[j]);
        for (; i < n; i++) most[0] = larger(fabs(terms[i]), most[0]);
        sizes[k] = larger(larger(most[0], most[1]), larger(most[2], most[3]));
    }
}

double series_reach(const double *sizes, double within)
{
    double largest = 0.0;
    for (int k = 0; k < TERMS; k++) largest = larger(sizes[k], largest);
    /* The last terms are to be less than the largest one's rounding. */
    const double tail = larger(sizes[ORDER - 1], sizes[ORDER]), least = 0.5 * DBL_EPSILON * largest;
    if (tail * pow(within, ORDER - 1) <= least) return within;
    return fmin(within, pow(least / tail, 1.0 / (ORDER - 1)));
}
