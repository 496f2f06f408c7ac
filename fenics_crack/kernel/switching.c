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

#define MAX_HALVINGS DBL_MANT_DIG /* halvings of a cell; much earlier it is shorter than rounding */

typedef struct {
    double left, width, low, high; /* [left, left + width], g at both ends */
} cell;

typedef struct {
    int harmonics, n_pairs; /* of the coefficients of one pair */
    const double *gap;
    double *values, *quarter_sums; /* g on the first grid (cells + 1), room (4, cells / 4 + 1) */
    int cells, next_cell;          /* of the first grid */
    double max_curvature;          /* M = sum_k k^2 (|a_k| + |b_k|) >= |g''| */
    double resolution;
    int n_waiting; /* number of cells that wait for a decision, the leftmost one last */
    cell waiting_cells[MAX_HALVINGS + 2];
} change_search;

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

static int allocate_search(change_search *s, int harmonics, int pairs)
{
    s->harmonics = harmonics;
    s->n_pairs = pairs;
    s->cells = switching_cells(harmonics);
    s->values = malloc((s->cells + 1) * sizeof(double));
    s->quarter_sums = malloc((s->cells + 4) * sizeof(double));
    return s->values && s->quarter_sums ? 0 : -1;
}

static void free_search(change_search *s)
{
    free(s->values);
    free(s->quarter_sums);
}

/* Values on the first grid. The quarters of a period share their waves: with the sums over even
 * and odd k of a_k cos(k theta) and b_k sin(k theta),
 *     g(theta), g(pi - theta), g(pi + theta), g(-theta) = a0 + ce +- co +- se +- so. */
static void evaluate_grid(change_search *s, const double *gap, const double *waves)
{
    const int quarter = s->cells / 4 + 1, half = s->cells / 2;
    double *even[2] = {s->quarter_sums, s->quarter_sums + quarter};
    double *odd[2] = {s->quarter_sums + 2 * quarter, s->quarter_sums + 3 * quarter};
    s->gap = gap;
    s->next_cell = s->n_waiting = 0;
    s->max_curvature = 0.0;
    for (int i = 0; i < 4 * quarter; i++) s->quarter_sums[i] = 0.0;
    for (int k = 1; k <= s->harmonics; k++, waves += 2 * quarter) {
        const double a = gap[(2 * k - 1) * s->n_pairs], b = gap[2 * k * s->n_pairs];
        double *c = k % 2 ? odd[0] : even[0], *d = k % 2 ? odd[1] : even[1];
        for (int i = 0; i < quarter; i++) c[i] += a * waves[i];
        for (int i = 0; i < quarter; i++) d[i] += b * waves[quarter + i];
        s->max_curvature += (double)k * k * (fabs(a) + fabs(b));
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
    if (!isfinite(s->max_curvature +
                  gap[0])) { /* a diverged iterate: no roots, but the search ends */
        s->next_cell = s->cells;
        g[0] = 0.0;
    }
}

/* Set g, g' and g'' at a phase. */
static void evaluate_derivatives(const change_search *s, double theta, double *derivatives_out)
{
    const double c1 = cos(theta), s1 = sin(theta);
    double cosine = 1.0, sine = 0.0, value = s->gap[0], slope = 0.0, bend = 0.0;
    const double *coefficients = s->gap + s->n_pairs;
    for (int k = 1; k <= s->harmonics; k++, coefficients += 2 * s->n_pairs) {
        const double next_cosine = cosine * c1 - sine * s1, a = coefficients[0],
                     b = coefficients[s->n_pairs];
        sine = sine * c1 + cosine * s1;
        cosine = next_cosine;
        const double wave = a * cosine + b * sine;
        value += wave;
        slope += k * (b * cosine - a * sine);
        bend -= (double)k * k * wave;
    }
    derivatives_out[0] = value;
    derivatives_out[1] = slope;
    derivatives_out[2] = bend;
}

/* Return g at a phase. */
static double value_at(const change_search *s, double theta)
{
    const double c1 = cos(theta), s1 = sin(theta), *coefficients = s->gap + s->n_pairs;
    double cosine = c1, sine = s1, value = s->gap[0];
    for (int k = 1; k <= s->harmonics; k++, coefficients += 2 * s->n_pairs) {
        value += coefficients[0] * cosine + coefficients[s->n_pairs] * sine;
        const double next_cosine = cosine * c1 - sine * s1;
        sine = sine * c1 + cosine * s1;
        cosine = next_cosine;
    }
    return value;
}

/* Return a root by Newton's method, kept in a bracket, from its middle. */
static double find_bracketed_root(const change_search *s, double left, double right,
                                  double left_value)
{
    double theta = 0.5 * (left + right), g[3];
    for (int i = 0; i < 100; i++) {
        evaluate_derivatives(s, theta, g);
        if ((g[0] > 0.0) == (left_value > 0.0)) left = theta;
        else right = theta;
        const double newton = theta - g[0] / g[1]; /* not finite where g' = 0 */
        const double updated = newton >= left && newton <= right ? newton : 0.5 * (left + right);
        if (fabs(updated - theta) <= 5e-16 * TWO_PI) break;
        theta = updated;
    }
    return theta;
}

/* Return a root by Halley's method from the chord's root; if it leaves the cell, by Newton's method
 * with bisection. A step d leaves an error of about d (M d / g')^2: after the last step only
 * rounding is left. */
static double find_root(const change_search *s, const cell *bracket)
{
    const double right = bracket->left + bracket->width;
    double theta = bracket->left - bracket->width * bracket->low / (bracket->high - bracket->low),
           g[3];
    for (int i = 0; i < 6; i++) {
        evaluate_derivatives(s, theta, g);
        const double step = g[0] * g[1] / (g[1] * g[1] - 0.5 * g[0] * g[2]);
        theta -= step;
        if (fabs(step) * s->max_curvature <= 1e-5 * fabs(g[1])) {
            if (theta >= bracket->left && theta <= right) return theta;
            break;
        }
    }
    return find_bracketed_root(s, bracket->left, right, bracket->low);
}

/* Find the next sign change: +1 or -1, or 0 if there is none. */
static int find_next_change(change_search *s, double *theta)
{
    const double cell_width = TWO_PI / s->cells;
    for (;;) {
        cell current;
        if (s->n_waiting) {
            current = s->waiting_cells[--s->n_waiting];
        } else if (s->next_cell < s->cells) {
            const int i = s->next_cell++;
            current = (cell){i * cell_width, cell_width, s->values[i], s->values[i + 1]};
        } else {
            return 0;
        }
        const double bound = s->max_curvature * current.width * current.width;
        const int has_change = (current.low > 0.0) != (current.high > 0.0);
        /* One sign change or none is certain: g' keeps its sign, or g lies close to its chord. */
        const int is_certain = has_change
                                   ? fabs(current.high - current.low) > 0.5 * bound
                                   : fmin(fabs(current.low), fabs(current.high)) > 0.125 * bound;
        if (is_certain || bound <= 8.0 * s->resolution || s->n_waiting > MAX_HALVINGS) {
            if (!has_change) continue;
            *theta = find_root(s, &current);
            return current.high > current.low ? 1 : -1;
        }
        const double width = 0.5 * current.width, middle = current.left + width,
                     g = value_at(s, middle);
        s->waiting_cells[s->n_waiting++] = (cell){middle, width, g, current.high};
        s->waiting_cells[s->n_waiting++] = (cell){current.left, width, current.low, g};
    }
}

int switching_instants(int harmonics, int pairs, const double *gap, const double *waves,
                       int capacity, double *theta, double *closing, signed char *closed)
{
    change_search s;
    int count = 0, failed = allocate_search(&s, harmonics, pairs), change;
    if (!failed) {
        double instant;
        evaluate_grid(&s, gap, waves);
        *closed = s.values[0] > 0.0;
        for (; (change = find_next_change(&s, &instant)); count++)
            if (count < capacity) {
                theta[count] = instant;
                closing[count] = change;
            }
    }
    free_search(&s);
    return failed ? -1 : count;
}

/* Set the means of exp(i m theta), m = 0 to highest, over the closed part of the period: complex
 * numbers (pairs, highest + 1). Returns -1 without memory. */
static int closed_means(int harmonics, int pairs, const double *gap, const double *waves,
                        int highest, double *means)
{
    change_search s;
    const int failed = allocate_search(&s, harmonics, pairs);
    for (int pair = 0; pair < pairs && !failed; pair++, means += 2 * (highest + 1)) {
        double theta;
        int direction;
        for (int m = 0; m < 2 * (highest + 1); m++) means[m] = 0.0;
        evaluate_grid(&s, gap + pair, waves);
        means[0] = s.values[0] > 0.0 ? TWO_PI : 0.0;
        while ((direction = find_next_change(&s, &theta))) {
            /* int exp(i m theta) = exp(i m theta) / (i m): + where the pair opens, - where it
             * closes. */
            const double c1 = cos(theta), s1 = sin(theta);
            double c = 1.0, d = 0.0;
            means[0] -= direction * theta;
            for (int m = 1; m <= highest; m++) {
                const double next_cosine = c * c1 - d * s1;
                d = d * c1 + c * s1;
                c = next_cosine;
                means[2 * m] -= direction * d / m;
                means[2 * m + 1] += direction * c / m;
            }
        }
        for (int m = 0; m < 2 * (highest + 1); m++) means[m] *= 1.0 / TWO_PI;
    }
    free_search(&s);
    return failed;
}

/* Set k times the Toeplitz plus Hankel matrix of c_m + i s_m, (2H+1, 2H+1):
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
