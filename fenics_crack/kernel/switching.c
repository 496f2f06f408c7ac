/* Certified switching instants, every sign change of real trigonometric polynomials.
 *
 * A grid alone misses pairs of roots between its points, where a pair only grazes. Here a
 * cell [a, a + w] is settled by a bound or not at all. With |g''| <= M = sum_k k^2 (|a_k| + |b_k|),
 *
 * - equal signs and min(|g(a)|, |g(a + w)|) > M w^2 / 8: no root, g lies that close to its chord;
 * - opposite signs and |g(a + w) - g(a)| > M w^2 / 2: one root, g' keeps its sign;
 * - else the cell is halved, until all that could be missed is an excursion below 1e-14 times the
 *   largest |g|. */
#include "switching.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "lapack.h"
#include "rounding.h"
#include "waves.h"

#define MAX_HALVINGS DBL_MANT_DIG /* halvings of a cell: long before, it is shorter than rounding */

typedef struct {
    double left, width, low, high; /* [left, left + width], g at both ends */
} cell;

typedef struct {
    int harmonics, stride; /* of the coefficients of one pair */
    const double *gap;
    double *values, *sums; /* g on the first grid (cells + 1), room (4, cells / 4 + 1) */
    int cells, next;       /* of the first grid */
    double curvature;      /* M = sum_k k^2 (|a_k| + |b_k|) >= |g''| */
    double resolution;
    int open; /* cells still to be looked at, the leftmost one last */
    cell waiting[MAX_HALVINGS + 2];
} search;

int switching_cells(int harmonics)
{
    int cells = 16;
    while (cells < 4 * (harmonics + 1)) cells *= 2;
    return cells;
}

void switching_waves(int harmonics, double *waves)
{
    const int cells = switching_cells(harmonics), quarter = cells / 4 + 1;
    for (int k = 1; k <= harmonics; k++, waves += 2 * quarter)
        for (int i = 0; i < quarter; i++) {
            const double theta = TWO_PI * (((long)k * i) % cells) / cells;
            waves[i] = cos(theta);
            waves[quarter + i] = sin(theta);
        }
}

static int prepare(search *s, int harmonics, int pairs)
{
    s->harmonics = harmonics;
    s->stride = pairs;
    s->cells = switching_cells(harmonics);
    s->values = malloc((s->cells + 1) * sizeof(double));
    s->sums = malloc((s->cells + 4) * sizeof(double));
    return s->values && s->sums ? 0 : -1;
}

static void finish(search *s)
{
    free(s->values);
    free(s->sums);
}

/* Values on the first grid. The quarters of a period share their waves: with the sums over even
 * and odd k of a_k cos(k theta) and b_k sin(k theta),
 *     g(theta), g(pi - theta), g(pi + theta), g(-theta) = a0 + ce +- co +- se +- so. */
static void begin(search *s, const double *gap, const double *waves)
{
    const int quarter = s->cells / 4 + 1, half = s->cells / 2;
    double *even[2] = {s->sums, s->sums + quarter};
    double *odd[2] = {s->sums + 2 * quarter, s->sums + 3 * quarter};
    s->gap = gap;
    s->next = s->open = 0;
    s->curvature = 0.0;
    for (int i = 0; i < 4 * quarter; i++) s->sums[i] = 0.0;
    for (int k = 1; k <= s->harmonics; k++, waves += 2 * quarter) {
        const double a = gap[(2 * k - 1) * s->stride], b = gap[2 * k * s->stride];
        double *c = k % 2 ? odd[0] : even[0], *d = k % 2 ? odd[1] : even[1];
        for (int i = 0; i < quarter; i++) c[i] += a * waves[i];
        for (int i = 0; i < quarter; i++) d[i] += b * waves[quarter + i];
        s->curvature += (double)k * k * (fabs(a) + fabs(b));
    }
    double largest = 0.0, *g = s->values;
    for (int i = 0; i < quarter; i++) {
        const double ce = gap[0] + even[0][i], se = even[1][i], co = odd[0][i], so = odd[1][i];
        g[i] = ce + co + (se + so);
        g[half - i] = ce - co - (se - so);
        g[half + i] = ce - co + (se - so);
        g[s->cells - i] = ce + co - (se + so);
    }
    for (int i = 0; i <= s->cells; i++)
        if (fabs(g[i]) > largest) largest = fabs(g[i]);
    s->resolution = ZERO_TOLERANCE * largest;
    if (!isfinite(s->curvature + gap[0])) { /* a diverged iterate: no roots, but the search ends */
        s->next = s->cells;
        g[0] = 0.0;
    }
}

/* g, g' and g'' at a phase. */
static void derivatives(const search *s, double theta, double *found)
{
    const double c1 = cos(theta), s1 = sin(theta);
    double c = 1.0, d = 0.0, value = s->gap[0], slope = 0.0, bend = 0.0;
    const double *at = s->gap + s->stride;
    for (int k = 1; k <= s->harmonics; k++, at += 2 * s->stride) {
        const double turned = c * c1 - d * s1, a = at[0], b = at[s->stride];
        d = d * c1 + c * s1;
        c = turned;
        const double wave = a * c + b * d;
        value += wave;
        slope += k * (b * c - a * d);
        bend -= (double)k * k * wave;
    }
    found[0] = value;
    found[1] = slope;
    found[2] = bend;
}

/* g at a phase. */
static double value_at(const search *s, double theta)
{
    const double c1 = cos(theta), s1 = sin(theta), *at = s->gap + s->stride;
    double c = c1, d = s1, value = s->gap[0];
    for (int k = 1; k <= s->harmonics; k++, at += 2 * s->stride) {
        value += at[0] * c + at[s->stride] * d;
        const double turned = c * c1 - d * s1;
        d = d * c1 + c * s1;
        c = turned;
    }
    return value;
}

/* Newton's method kept inside a bracket, from its middle. */
static double bracketed(const search *s, double left, double right, double low)
{
    double theta = 0.5 * (left + right), g[3];
    for (int i = 0; i < 100; i++) {
        derivatives(s, theta, g);
        if ((g[0] > 0.0) == (low > 0.0)) left = theta;
        else right = theta;
        const double newton = theta - g[0] / g[1]; /* not finite where g' = 0 */
        const double updated = newton >= left && newton <= right ? newton : 0.5 * (left + right);
        if (fabs(updated - theta) <= 5e-16 * TWO_PI) break;
        theta = updated;
    }
    return theta;
}

/* Halley's method from the chord's root; where it strays, Newton's with bisection. A step d leaves
 * an error of about d (M d / g')^2; after the last one only rounding is left. */
static double polished(const search *s, const cell *at)
{
    const double right = at->left + at->width;
    double theta = at->left - at->width * at->low / (at->high - at->low), g[3];
    for (int i = 0; i < 6; i++) {
        derivatives(s, theta, g);
        const double step = g[0] * g[1] / (g[1] * g[1] - 0.5 * g[0] * g[2]);
        theta -= step;
        if (fabs(step) * s->curvature <= 1e-5 * fabs(g[1])) {
            if (theta >= at->left && theta <= right) return theta;
            break;
        }
    }
    return bracketed(s, at->left, right, at->low);
}

/* The next sign change: +1 or -1, or 0 where there is no more. */
static int next_change(search *s, double *theta)
{
    const double first = TWO_PI / s->cells;
    for (;;) {
        cell at;
        if (s->open) {
            at = s->waiting[--s->open];
        } else if (s->next < s->cells) {
            const int i = s->next++;
            at = (cell){i * first, first, s->values[i], s->values[i + 1]};
        } else {
            return 0;
        }
        const double bound = s->curvature * at.width * at.width;
        const int change = (at.low > 0.0) != (at.high > 0.0);
        /* One sign change or none is certain: g' keeps its sign, or g lies close to its chord. */
        const int certain = change ? fabs(at.high - at.low) > 0.5 * bound
                                   : fmin(fabs(at.low), fabs(at.high)) > 0.125 * bound;
        if (certain || bound <= 8.0 * s->resolution || s->open > MAX_HALVINGS) {
            if (!change) continue;
            *theta = polished(s, &at);
            return at.high > at.low ? 1 : -1;
        }
        const double width = 0.5 * at.width, middle = at.left + width, g = value_at(s, middle);
        s->waiting[s->open++] = (cell){middle, width, g, at.high};
        s->waiting[s->open++] = (cell){at.left, width, at.low, g};
    }
}

int switching_instants(int harmonics, int pairs, const double *gap, const double *waves, int room,
                       double *theta, double *closing, signed char *closed)
{
    search s;
    int count = 0, failed = prepare(&s, harmonics, pairs), change;
    if (!failed) {
        double at;
        begin(&s, gap, waves);
        *closed = s.values[0] > 0.0;
        for (; (change = next_change(&s, &at)); count++)
            if (count < room) {
                theta[count] = at;
                closing[count] = change;
            }
    }
    finish(&s);
    return failed ? -1 : count;
}

/* Means of exp(i m theta), m = 0 to highest, over the closed part of the period: complex numbers
 * (pairs, highest + 1). Returns -1 without memory. */
static int closed_means(int harmonics, int pairs, const double *gap, const double *waves,
                        int highest, double *means)
{
    search s;
    const int failed = prepare(&s, harmonics, pairs);
    for (int pair = 0; pair < pairs && !failed; pair++, means += 2 * (highest + 1)) {
        double theta;
        int change;
        for (int m = 0; m < 2 * (highest + 1); m++) means[m] = 0.0;
        begin(&s, gap + pair, waves);
        means[0] = s.values[0] > 0.0 ? TWO_PI : 0.0;
        while ((change = next_change(&s, &theta))) {
            /* int exp(i m theta) = exp(i m theta) / (i m): + where the pair opens, - where it
             * closes. */
            const double c1 = cos(theta), s1 = sin(theta);
            double c = 1.0, d = 0.0;
            means[0] -= change * theta;
            for (int m = 1; m <= highest; m++) {
                const double turned = c * c1 - d * s1;
                d = d * c1 + c * s1;
                c = turned;
                means[2 * m] -= change * d / m;
                means[2 * m + 1] += change * c / m;
            }
        }
        for (int m = 0; m < 2 * (highest + 1); m++) means[m] *= 1.0 / TWO_PI;
    }
    finish(&s);
    return failed;
}

/* k times the Toeplitz plus Hankel matrix of c_m + i s_m, (2H+1, 2H+1):
 *
 *     d a_i/d a_j:  c_{i-j} + c_{i+j}      d a_i/d b_j:  s_{i+j} - s_{i-j}
 *     d b_i/d a_j:  s_{i+j} + s_{i-j}      d b_i/d b_j:  c_{i-j} - c_{i+j},
 *
 * with c_0, c_j, s_j in the row of the mean and 2 c_i, 2 s_i in its column. */
static void toeplitz_hankel(int harmonics, double k, const double *means, double *matrix)
{
    const int n = 2 * harmonics + 1;
    matrix[0] = k * means[0];
    for (int i = 1; i <= harmonics; i++) {
        double *a = matrix + (2 * i - 1) * n, *b = a + n;
        matrix[2 * i - 1] = k * means[2 * i], matrix[2 * i] = k * means[2 * i + 1];
        a[0] = 2.0 * k * means[2 * i], b[0] = 2.0 * k * means[2 * i + 1];
        for (int j = 1; j <= harmonics; j++) {
            const double *lag = means + 2 * (i > j ? i - j : j - i), *sum = means + 2 * (i + j);
            const double odd = i > j ? lag[1] : -lag[1];
            a[2 * j - 1] = k * (lag[0] + sum[0]), a[2 * j] = k * (sum[1] - odd);
            b[2 * j - 1] = k * (sum[1] + odd), b[2 * j] = k * (lag[0] - sum[0]);
        }
    }
}

int contact_integrals(int harmonics, int pairs, const double *gap, const double *stiffness,
                      const double *waves, double *means, double *force, double *tangent)
{
    const int n = 2 * harmonics + 1;
    if (closed_means(harmonics, pairs, gap, waves, 2 * harmonics, means)) return -1;
    for (int pair = 0; pair < pairs; pair++) {
        double *matrix = tangent + (size_t)pair * n * n;
        toeplitz_hankel(harmonics, stiffness[pair], means + 2 * (size_t)pair * n, matrix);
        /* Since lambda = kappa g, the force's coefficients are the tangent times the gap's. */
        double *column = means + 2 * (size_t)pair * n, *product = column + n;
        for (int i = 0; i < n; i++) column[i] = gap[i * pairs + pair];
        multiply(n, n, matrix, column, product);
        for (int i = 0; i < n; i++) force[i * pairs + pair] = product[i];
    }
    return 0;
}
