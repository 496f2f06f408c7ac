#include "broyden.h"

#include <math.h>
#include <string.h>

#include "lapack.h"

#define LEAST 0.1  /* of |s|^2: Broyden's correction would lengthen the next step tenfold */
#define FIRST 0.02 /* of a residual that is left by the first of Newton's steps, */
#define ENOUGH 0.02 /* and of the tolerance, by the last */

static double inner(const broyden *by, const double *y, const double *z)
{
    return by->weight * dot(by->unknowns, y, z) + y[by->unknowns] * z[by->unknowns];
}

/* z += share y */
static void add(const broyden *by, double *z, double share, const double *y)
{
    for (int i = 0; i <= by->unknowns; i++) z[i] += share * y[i];
}

static double size_of(const broyden *by, const double *r)
{
    return sqrt(by->weight * dot(by->unknowns, r, r));
}

/* B^-1 r, in place. */
static void answer(equations *at, const broyden *by, double *r)
{
    const int n = by->unknowns;
    at->solve_nearly(at, r);
    r[n] = 0.0;
    add(by, r, -inner(by, by->across, r) / inner(by, by->across, by->along), by->along);
    for (int i = 0; i < by->known; i++) {
        const size_t row = (size_t)i * (n + 1);
        add(by, r, inner(by, by->steps + row, r), by->gains + row);
    }
}

/* The next step from the last one and q; 0 where it would be too long. */
static int learn(broyden *by, double *s, const double *q)
{
    const int n = by->unknowns;
    const double square = inner(by, s, s), sum = square + inner(by, s, q);
    const size_t row = (size_t)by->known * (n + 1);
    if (!(sum > LEAST * square) || by->known == BROYDEN_PAIRS) return 0;
    memcpy(by->steps + row, s, (n + 1) * sizeof(double));
    for (int i = 0; i <= n; i++) by->gains[row + i] = -q[i] / sum;
    for (int i = 0; i <= n; i++) s[i] = square * by->gains[row + i];
    by->known++;
    return 1;
}

int solve_by_former(equations *at, broyden *by, double *z, double tolerance, int *taken)
{
    const int n = by->unknowns;
    double *r = by->residual, *s = by->step, *q = by->answer, before = INFINITY;
    for (int count = 0; count < BROYDEN_MOST; count++) {
        const double size = size_of(by, r);
        if (size <= tolerance) return 1;
        if (!(size < before)) return 0;
        before = size, ++*taken;
        memcpy(q, r, n * sizeof(double));
        answer(at, by, q);
        if (!count)
            for (int i = 0; i <= n; i++) s[i] = -q[i];
        else if (!learn(by, s, q)) return 0;
        add(by, z, 1.0, s);
        at->apply(at, s, q);
        for (int i = 0; i < n; i++) r[i] += q[i] + s[n] * by->rate[i];
    }
    return 0;
}

int correct_by_former(equations *at, broyden *by, double *z, double tolerance, int iterations,
                      double reach, int *taken, int *work)
{
    const int n = by->unknowns;
    const double guess = z[n];
    double before = INFINITY;
    by->known = 0;
    for (*taken = 0;; ++*taken) {
        const int outcome = at->evaluate(at, z, z[n]);
        if (outcome != FOUND) return outcome;
        at->residual(at, by->residual);
        const double size = size_of(by, by->residual);
        if (size <= tolerance) return FOUND;
        if (!(size < before) || *taken == iterations) return NOT_FOUND;
        /* As much as the last step has left, squared, is left by the next: Eisenstat and Walker,
         * SIAM J. Sci. Comput. 17, 1996. */
        const double left = *taken ? (size / before) * (size / before) : FIRST;
        before = size;
        at->by_parameter(at, by->rate);
        if (!solve_by_former(at, by, z, fmax(left * size, ENOUGH * tolerance), work) ||
            !(fabs(z[n] - guess) <= reach))
            return NOT_FOUND;
    }
}
