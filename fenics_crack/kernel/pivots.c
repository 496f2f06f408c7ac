#include "pivots.h"

#include <math.h>
#include <string.h>

#include "lapack.h"
#include "rounding.h"

void open_all_pairs(pivot_table *s)
{
    const size_t n = s->pairs;
    memcpy(s->table, s->compliance, n * n * sizeof(double));
    memset(s->closed, 0, n);
}

/* Update answers x (count, n) by a pivot, with u and d of the table before. */
static void update_answers(int n, int count, int k, const double *u, double d, double *x)
{
    for (; count > 0; count--, x += n) {
        const double pair_answer = x[k], weight = pair_answer / d;
        for (int i = 0; i < n; i++) x[i] -= u[i] * weight;
        x[k] = pair_answer / fabs(d);
    }
}

int toggle_pair(pivot_table *s, int k, int count, double *answers, double *v, double *gain)
{
    const int n = s->pairs;
    double *u = s->work, *pair_row = s->table + (long)k * n;
    memcpy(u, pair_row, n * sizeof(double));
    const double d = u[k];
    if (!(s->closed[k] ? d < 0.0 : d > ROUNDING * s->compliance[(long)k * n + k])) return 1;
    if (v) {
        for (int i = 0; i < n; i++) v[i] = s->closed[i] ? u[i] : 0.0;
        if (!s->closed[k]) v[k] = -1.0;
        *gain = 1.0 / d;
    }
    for (int i = 0; i < n; i++) {
        double *row = s->table + (long)i * n;
        const double weight = u[i] / d;
        for (int j = 0; j < n; j++) row[j] -= weight * u[j];
        row[k] = u[i] / fabs(d);
    }
    for (int i = 0; i < n; i++) pair_row[i] = u[i] / fabs(d);
    pair_row[k] = -1.0 / d;
    update_answers(n, count, k, u, d, answers);
    s->closed[k] = !s->closed[k];
    return 0;
}

int recompute_if_inaccurate(pivot_table *s)
{
    /* With gaps of 1 the closed pairs' forces must close these, and leave the others what T says. */
    const int n = s->pairs;
    double *ones = s->work, *table_answers = ones + n, *force = table_answers + n,
           *closed_gaps = force + n;
    for (int i = 0; i < n; i++) ones[i] = s->closed[i];
    multiply(n, n, s->table, ones, table_answers);
    for (int i = 0; i < n; i++) force[i] = s->closed[i] ? -table_answers[i] : 0.0;
    multiply(n, n, s->compliance, force, closed_gaps);
    int is_accurate = 1;
    for (int i = 0; i < n && is_accurate; i++) {
        const double expected = s->closed[i] ? 1.0 : table_answers[i];
        is_accurate = fabs(closed_gaps[i] - expected) <= ROUNDING * (1.0 + fabs(expected));
    }
    if (is_accurate) return 0;
    signed char *closed_set = (signed char *)(s->work + 3 * n);
    memcpy(closed_set, s->closed, n);
    open_all_pairs(s);
    for (int i = 0; i < n; i++)
        if (closed_set[i]) toggle_pair(s, i, 0, NULL, NULL, NULL);
    return 1;
}

void get_inverse(const pivot_table *s, double *inverse)
{
    const long n = s->pairs;
    for (long i = 0; i < n; i++)
        for (long j = 0; j < n; j++)
            inverse[i * n + j] = s->closed[i] && s->closed[j] ? -s->table[i * n + j] : 0.0;
}

void transform_gaps(const pivot_table *s, int count, const double *gaps, double *closed_gaps,
                    double *answers)
{
    const int n = s->pairs;
    for (int row = 0; row < count; row++)
        for (int i = 0; i < n; i++) {
            const double gap = gaps[(long)row * n + i];
            closed_gaps[(long)row * n + i] = s->closed[i] ? -gap : 0.0;
            answers[(long)row * n + i] = s->closed[i] ? 0.0 : gap;
        }
    multiply_matrices(count, n, n, closed_gaps, s->table, 1.0, answers);
}

void bound_answers(const pivot_table *s, const double *gaps, double *answers)
{
    const int n = s->pairs;
    for (int i = 0; i < n; i++) answers[i] = s->closed[i] ? 0.0 : gaps[i];
    for (int j = 0; j < n; j++) {
        const double *row = s->table + (long)j * n, weight = gaps[j];
        for (int i = 0; i < n && s->closed[j]; i++) answers[i] += weight * fabs(row[i]);
    }
}
