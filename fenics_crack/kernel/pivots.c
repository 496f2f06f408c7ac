#include "pivots.h"

#include <math.h>
#include <string.h>

/* Error of gaps with which all is computed anew; a diagonal so small relative to that of D is 0. */
static const double ACCURATE = 1e-12, SINGULAR = 1e-12;

void open_all(pivot_table *s)
{
    const size_t n = s->pairs;
    memcpy(s->table, s->d, n * n * sizeof(double));
    memcpy(s->answer, s->gaps, s->columns * n * sizeof(double));
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

int turn_pair(pivot_table *s, int k, int count, double *others, double *v, double *gain)
{
    const int n = s->pairs;
    double *u = s->room, *scaled = u + n, *own = s->table + (long)k * n;
    memcpy(u, own, (k + 1) * sizeof(double));
    for (int i = k + 1; i < n; i++) u[i] = s->table[(long)i * n + k];
    const double d = u[k];
    if (!(s->closed[k] ? d < 0.0 : d > SINGULAR * s->d[(long)k * n + k])) return 1;
    if (v) {
        for (int i = 0; i < n; i++) v[i] = s->closed[i] ? u[i] : 0.0;
        if (!s->closed[k]) v[k] = -1.0;
        *gain = 1.0 / d;
    }
    for (int i = 0; i < n; i++) scaled[i] = u[i] / d;
    for (int i = 0; i < n; i++) {
        double *row = s->table + (long)i * n;
        const double weight = u[i];
        for (int j = 0; j <= i; j++) row[j] -= weight * scaled[j];
    }
    for (int i = 0; i < n; i++) (i < k ? own + i : s->table + (long)i * n + k)[0] = u[i] / fabs(d);
    own[k] = -1.0 / d;
    carry(n, s->columns, k, u, d, s->answer);
    carry(n, count, k, u, d, others);
    s->closed[k] = !s->closed[k];
    return 0;
}

/* y = A x with a symmetric matrix of which the part below the diagonal is read. */
static void multiply_symmetric(int n, const double *a, const double *x, double *y)
{
    for (int i = 0; i < n; i++) {
        const double *row = a + (long)i * n, weight = x[i];
        double sum = row[i] * weight;
        for (int j = 0; j < i; j++) y[j] += row[j] * weight;
        for (int j = 0; j < i; j++) sum += row[j] * x[j];
        y[i] = sum;
    }
}

int refresh(pivot_table *s)
{
    /* With gaps of 1 the closed pairs' forces must close these, and leave the others what T says. */
    const int n = s->pairs;
    double *ones = s->room, *said = ones + n, *force = said + n, *found = force + n;
    for (int i = 0; i < n; i++) ones[i] = s->closed[i];
    multiply_symmetric(n, s->table, ones, said);
    for (int i = 0; i < n; i++) force[i] = s->closed[i] ? -said[i] : 0.0;
    multiply_symmetric(n, s->d, force, found);
    int good = 1;
    for (int i = 0; i < n && good; i++) {
        const double expected = s->closed[i] ? 1.0 : said[i];
        good = fabs(found[i] - expected) <= ACCURATE * (1.0 + fabs(expected));
    }
    if (good) return 0;
    signed char *wanted = (signed char *)(s->room + 3 * n);
    memcpy(wanted, s->closed, n);
    open_all(s);
    for (int i = 0; i < n; i++)
        if (wanted[i]) turn_pair(s, i, 0, NULL, NULL, NULL);
    return 1;
}

void inverse_of(const pivot_table *s, double *inverse)
{
    const int n = s->pairs;
    for (long i = 0; i < n; i++)
        for (long j = 0; j <= i; j++) {
            const double entry = s->closed[i] && s->closed[j] ? -s->table[i * n + j] : 0.0;
            inverse[i * n + j] = inverse[j * n + i] = entry;
        }
}
