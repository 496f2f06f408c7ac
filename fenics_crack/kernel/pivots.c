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

/* What a pivot does to answers x (count, n), with u and d of the table before. */
static void carry(int n, int count, int k, const double *u, double d, double *x)
{
    for (; count > 0; count--, x += n) {
        const double own = x[k], share = own / d;
        for (int i = 0; i < n; i++) x[i] -= u[i] * share;
        x[k] = own / fabs(d);
    }
}

int toggle_pair(pivot_table *s, int k, int count, double *answers, double *v, double *gain)
{
    const int n = s->pairs;
    double *u = s->room, *own = s->table + (long)k * n;
    memcpy(u, own, n * sizeof(double));
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
    for (int i = 0; i < n; i++) own[i] = u[i] / fabs(d);
    own[k] = -1.0 / d;
    carry(n, count, k, u, d, answers);
    s->closed[k] = !s->closed[k];
    return 0;
}

int recompute_if_inaccurate(pivot_table *s)
{
    /* With gaps of 1 the closed pairs' forces must close these, and leave the others what T says. */
    const int n = s->pairs;
    double *ones = s->room, *said = ones + n, *force = said + n, *found = force + n;
    for (int i = 0; i < n; i++) ones[i] = s->closed[i];
    multiply(n, n, s->table, ones, said);
    for (int i = 0; i < n; i++) force[i] = s->closed[i] ? -said[i] : 0.0;
    multiply(n, n, s->compliance, force, found);
    int good = 1;
    for (int i = 0; i < n && good; i++) {
        const double expected = s->closed[i] ? 1.0 : said[i];
        good = fabs(found[i] - expected) <= ROUNDING * (1.0 + fabs(expected));
    }
    if (good) return 0;
    signed char *wanted = (signed char *)(s->room + 3 * n);
    memcpy(wanted, s->closed, n);
    open_all_pairs(s);
    for (int i = 0; i < n; i++)
        if (wanted[i]) toggle_pair(s, i, 0, NULL, NULL, NULL);
    return 1;
}

void get_inverse(const pivot_table *s, double *inverse)
{
    const long n = s->pairs;
    for (long i = 0; i < n; i++)
        for (long j = 0; j < n; j++)
            inverse[i * n + j] = s->closed[i] && s->closed[j] ? -s->table[i * n + j] : 0.0;
}

void transform_gaps(const pivot_table *s, int count, const double *gaps, double *masked, double *answers)
{
    const int n = s->pairs;
    for (int row = 0; row < count; row++)
        for (int i = 0; i < n; i++) {
            const double gap = gaps[(long)row * n + i];
            masked[(long)row * n + i] = s->closed[i] ? -gap : 0.0;
            answers[(long)row * n + i] = s->closed[i] ? 0.0 : gap;
        }
    multiply_matrices(count, n, n, masked, s->table, 1.0, answers);
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
