#include "series.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "lapack.h"

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

/* Numbers in a register, and registers in use at once: a processor works on the others while it
 * waits for the first. More or longer ones would not stay in registers. */
enum { LANES = 4, N_BLOCKS = 6 };
typedef double block __attribute__((vector_size(LANES * sizeof(double))));

/* Numbers after the last function are the last block once more. */
WIDE void series_at(int n, int order, const double *restrict terms, double time,
                    double *restrict value, double *restrict slope)
{
    if (n < BLOCK) {
        for (int i = 0; i < n; i++) value[i] = column_at(n, order, terms, i, 0, time, slope + i);
        return;
    }
    for (int block_start = 0; block_start < n; block_start += N_BLOCKS * LANES) {
        block values[N_BLOCKS] = {{0.0}}, slopes[N_BLOCKS] = {{0.0}}, term;
        int offsets[N_BLOCKS];
        for (int j = 0; j < N_BLOCKS; j++)
            offsets[j] = block_start + (j + 1) * LANES <= n ? block_start + j * LANES : n - LANES;
        const double *row = terms + (long)order * n;
        for (int k = order; k >= 0; k--, row -= n)
            for (int j = 0; j < N_BLOCKS; j++) {
                memcpy(&term, row + offsets[j], sizeof term);
                slopes[j] = slopes[j] * time + values[j];
                values[j] = values[j] * time + term;
            }
        for (int j = 0; j < N_BLOCKS; j++) {
            memcpy(value + offsets[j], values + j, sizeof term);
            memcpy(slope + offsets[j], slopes + j, sizeof term);
        }
    }
}

/* Evaluate few functions at all times at once. */
WIDE static void values_of_few(int n, int order, const double *restrict terms, int count,
                               const double *restrict times, double *restrict values)
{
    double padded_times[MAX_TIMES] = {0.0};
    memcpy(padded_times, times, (size_t)count * sizeof(double));
    for (int i = 0; i < n; i++) {
        const double *row = terms + (long)order * n + i;
        double sums[MAX_TIMES] = {0.0};
        for (int k = order; k >= 0; k--, row -= n)
            for (int j = 0; j < MAX_TIMES; j++) sums[j] = sums[j] * padded_times[j] + *row;
        for (int j = 0; j < count; j++) values[(long)j * n + i] = sums[j];
    }
}

void values_at(int n, int order, const double *terms, int count, const double *times,
               double *values)
{
    double powers[MAX_TIMES * TERMS];
    if (n < BLOCK) {
        values_of_few(n, order, terms, count, times, values);
        return;
    }
    for (int k = 0; k <= order; k++)
        for (int j = 0; j < count; j++) {
            double *power = powers + j * (order + 1) + k;
            *power = k ? power[-1] * times[j] : 1.0;
        }
    multiply_matrices(count, order + 1, n, powers, terms, 0.0, values);
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
    double slope, root = 0.5 * (low + high);
    for (int iteration = 0; iteration < DBL_MANT_DIG && high - low > 0.5 * DBL_EPSILON * high;
         iteration++) {
        const double current_value = column_at(n, order, terms, column, slopes, root, &slope);
        const double newton = root - current_value / slope;
        if (current_value == 0.0) return root;
        if ((current_value > 0.0) == !slopes) low = root;
        else high = root;
        if (fabs(newton - root) <= 4.0 * DBL_EPSILON * high) return root;
        root = newton > low && newton < high ? newton : 0.5 * (low + high);
    }
    return root;
}

/* Return the largest modulus, by its bits: compilers do not find the largest double in blocks. */
WIDE static double max_modulus(long count, const double *x)
{
    int64_t max_bits = 0;
    double largest;
    for (long i = 0; i < count; i++) {
        int64_t bits;
        memcpy(&bits, x + i, sizeof bits);
        bits &= INT64_MAX; /* without the sign */
        max_bits = bits > max_bits ? bits : max_bits;
    }
    memcpy(&largest, &max_bits, sizeof largest);
    return largest;
}

double series_size(int n, int order, const double *terms, double time)
{
    double largest = 0.0, power = 1.0;
    for (int k = 0; k <= order; k++, power *= time, terms += n)
        largest = fmax(power * max_modulus(n, terms), largest);
    return largest;
}

double series_reach(int n, int order, const double *terms, double max_time)
{
    /* The last terms are to be less than the largest one's rounding. */
    const int last_order = ORDER - 1;
    if (order < last_order) return max_time;
    const double max_tail = 0.5 * DBL_EPSILON * max_modulus((long)n * (order + 1), terms);
    const double tail =
        max_modulus((long)n * (order + 1 - last_order), terms + (long)n * last_order);
    if (tail * pow(max_time, last_order) <= max_tail) return max_time;
    return fmin(max_time, pow(max_tail / tail, 1.0 / last_order));
}
