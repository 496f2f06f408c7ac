#include "coupled_forces.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "equations.h"
#include "intervals.h"
#include "lapack.h"
#include "rounding.h"

struct coupled_forces {
    breathing_pairs pairs; /* the sets, with space for `max_events` events */
    int harmonics, n_pairs, instants, n_events;
    waves *gap_waves, *step_waves; /* H harmonics at N instants, and 2H harmonics */
    double *
        step_coefficients; /* of each event: a step (0 before the event, 1 after), truncated, */
    double *step_values;   /* as coefficients (4H+1, events), as values (N, events) */
    double *jump_work;     /* work space: (N, events), */
    double *gap_values, *scaled_gaps, *force_values, *stiffness; /* (N, p) three times, (p, p) */
    double *work;
};

static double *allocate(size_t count) { return malloc((count + 1) * sizeof(double)); }

/* Allocate a number of events. Returns 0, or 1 without memory. */
static int allocate_events(coupled_forces *self, int max_events)
{
    breathing_pairs *m = &self->pairs;
    const size_t count = max_events, p = self->n_pairs, n = self->instants;
    free(m->theta), free(m->event_pairs);
    m->event_pairs = malloc((count + 1) * sizeof(int));
    m->theta = allocate(count * (2 + p + 4 * (size_t)self->harmonics + 1 + 2 * n));
    if (!m->theta || !m->event_pairs) return 1;
    m->max_events = max_events;
    m->gains = m->theta + count, m->vectors = m->gains + count;
    self->step_coefficients = m->vectors + count * p;
    self->step_values = self->step_coefficients + count * (4 * (size_t)self->harmonics + 1);
    self->jump_work = self->step_values + count * n;
    free_waves(self->step_waves);
    self->step_waves = new_waves(2 * self->harmonics, self->instants, max_events);
    return !self->step_waves;
}

coupled_forces *new_coupled_forces(int harmonics, int pairs)
{
    coupled_forces *self = calloc(1, sizeof(coupled_forces));
    if (!self) return NULL;
    breathing_pairs *m = &self->pairs;
    const size_t p = pairs, square = p * p, instants = 4 * (harmonics + 1);
    self->harmonics = harmonics, self->n_pairs = pairs, self->instants = (int)instants;
    m->cells = interval_cells(harmonics, pairs), m->n_waves = 2 * harmonics + 1;
    m->contact.pairs = pairs;
    const size_t work = interval_work_size(pairs, harmonics, m->cells);
    self->work = allocate(3 * square + 4 * p + work + 3 * instants * p);
    m->first_set = malloc(2 * p + 1);
    self->gap_waves = new_waves(harmonics, (int)instants, pairs);
    m->waves = new_waves(harmonics, m->cells, pairs);
    if (!self->work || !m->first_set || !self->gap_waves || !m->waves ||
        allocate_events(self, 4 * pairs + 16)) {
        free_coupled_forces(self);
        return NULL;
    }
    m->contact.closed = m->first_set + p;
    m->stiffness = self->work, m->contact.table = m->stiffness + square;
    m->contact.work = m->contact.table + square, m->work = m->contact.work + 4 * p;
    self->gap_values = m->work + work, self->scaled_gaps = self->gap_values + instants * p;
    self->force_values = self->scaled_gaps + instants * p,
    self->stiffness = self->force_values + instants * p;
    return self;
}

void free_coupled_forces(coupled_forces *self)
{
    if (!self) return;
    free_waves(self->gap_waves), free_waves(self->step_waves), free_waves(self->pairs.waves);
    free(self->pairs.first_set), free(self->pairs.theta), free(self->pairs.event_pairs);
    free(self->work);
    free(self);
}

/* Set the step of each event, from the means of exp(i m theta) after it, m = 0 to 2H. */
static void set_steps(coupled_forces *self)
{
    const breathing_pairs *m = &self->pairs;
    const long events = self->n_events;
    for (long e = 0; e < events; e++) {
        const double c1 = cos(m->theta[e]), s1 = sin(m->theta[e]);
        double c = 1.0, s = 0.0, *wave = self->step_coefficients + e;
        wave[0] = 1.0 - m->theta[e] / TWO_PI;
        for (int k = 1; k <= 2 * self->harmonics; k++) {
            const double next_cosine = c * c1 - s * s1, factor = 2.0 / (TWO_PI * k);
            s = s * c1 + c * s1, c = next_cosine;
            wave[(2 * k - 1) * events] = -factor * s;
            wave[2 * k * events] = factor * (c - 1.0);
        }
    }
    if (events)
        waves_to_values(self->step_waves, (int)events, self->step_coefficients, self->step_values);
}

void forces_by_gap(coupled_forces *self, const double *change, double *force_change_out)
{
    const breathing_pairs *m = &self->pairs;
    const int p = self->n_pairs, n = self->instants, events = self->n_events;
    waves_to_values(self->gap_waves, p, change, self->gap_values);
    multiply_matrices(n, p, p, self->gap_values, m->stiffness, 0.0, self->force_values);
    multiply_transposed(n, p, events, self->gap_values, m->vectors, self->jump_work);
    for (long i = 0; i < n; i++)
        for (long e = 0; e < events; e++)
            self->jump_work[i * events + e] *= self->step_values[i * events + e] * m->gains[e];
    if (events)
        multiply_matrices(n, events, p, self->jump_work, m->vectors, 1.0, self->force_values);
    values_to_waves(self->gap_waves, p, self->force_values, force_change_out);
}

int find_forces(coupled_forces *self, const double *compliance, const double *gap, double *force)
{
    breathing_pairs *m = &self->pairs;
    const int p = self->n_pairs;
    double max_gap = 0.0;
    for (int i = 0; i < p; i++) {
        double gap_bound = 0.0;
        for (int row = 0; row < m->n_waves; row++) gap_bound += fabs(gap[(long)row * p + i]);
        if (!(gap_bound <= max_gap)) max_gap = gap_bound;
    }
    if (!isfinite(max_gap)) return NOT_FOUND;
    m->contact.compliance = compliance, m->gaps = gap, m->tolerance = ZERO_TOLERANCE * max_gap;
    while ((self->n_events = find_intervals(m)) == -1)
        if (allocate_events(self, 2 * m->max_events)) return NO_MEMORY;
    if (self->n_events < 0) return NOT_FOUND;
    set_steps(self);
    forces_by_gap(self, gap, force);
    return FOUND;
}

void forces_by_compliance(coupled_forces *self, const double *rate, double *force_rate_out)
{
    const breathing_pairs *m = &self->pairs;
    const int p = self->n_pairs, n = self->instants, events = self->n_events;
    double *stiffness = self->stiffness; /* S of one interval after the other */
    memcpy(stiffness, m->stiffness, (size_t)p * p * sizeof(double));
    waves_to_values(self->gap_waves, p, m->gaps, self->gap_values);
    memset(self->force_values, 0, (size_t)n * p * sizeof(double));
    for (long e = 0; e <= events; e++) { /* the interval that ends with the event */
        multiply_matrices(n, p, p, self->gap_values, stiffness, 0.0, self->scaled_gaps);
        for (long i = 0; i < n; i++) {
            const double *step_value = self->step_values + i * events;
            const double fraction =
                (e ? step_value[e - 1] : 1.0) - (e < events ? step_value[e] : 0.0);
            for (long j = 0; j < p; j++) self->scaled_gaps[i * p + j] *= -rate[j] * fraction;
        }
        multiply_matrices(n, p, p, self->scaled_gaps, stiffness, 1.0, self->force_values);
        const double *v = m->vectors + e * p;
        for (long i = 0; i < p && e < events; i++)
            for (long j = 0; j < p; j++) stiffness[i * p + j] += m->gains[e] * v[i] * v[j];
    }
    values_to_waves(self->gap_waves, p, self->force_values, force_rate_out);
}

/* Set U^T S U of a matrix S (p, p), or without a basis S itself. */
static void project_matrix(int p, int q, const double *basis, const double *matrix, double *work,
                           double *projection_out)
{
    if (!basis) {
        memcpy(projection_out, matrix, (size_t)p * p * sizeof(double));
        return;
    }
    multiply_matrices(p, p, q, matrix, basis, 0.0, work);
    for (int a = 0; a < q; a++)
        for (int b = 0; b < q; b++) {
            double sum = 0.0;
            for (int i = 0; i < p; i++) sum += basis[i * q + a] * work[i * q + b];
            projection_out[a * q + b] = sum;
        }
}

int means_of_stiffness(const coupled_forces *self, const double *basis, int q, double *means)
{
    const breathing_pairs *m = &self->pairs;
    const size_t p = self->n_pairs, square = (size_t)q * q, events = self->n_events;
    const int rows = 4 * self->harmonics + 1;
    double *products = allocate((events + 1) * square + q + p * q);
    double *projected_vector = products + (events + 1) * square;
    if (!products) return 1;
    for (size_t e = 0; e < events; e++) { /* gain v v^T, v as it is seen */
        const double *v = m->vectors + e * p;
        double *product = products + e * square;
        if (basis) multiply_matrices(1, (int)p, q, v, basis, 0.0, projected_vector);
        else memcpy(projected_vector, v, p * sizeof(double));
        for (int i = 0; i < q; i++)
            for (int j = 0; j < q; j++)
                *product++ = m->gains[e] * projected_vector[i] * projected_vector[j];
    }
    multiply_matrices(rows, (int)events, (int)square, self->step_coefficients, products, 0.0,
                      means);
    for (size_t i = square; i < rows * square; i++) means[i] *= 0.5;
    /* The mean of the first set, which the events change. */
    double *first = products;
    project_matrix((int)p, q, basis, m->stiffness, projected_vector + q, first);
    for (size_t i = 0; i < square; i++) means[i] += first[i];
    free(products);
    return 0;
}

void tangent_of_harmonic(int harmonics, int q, int k, const double *means, double *tangent_out)
{
    const size_t rows = 2 * harmonics + 1, row = rows * q, square = (size_t)q * q;
    for (int j = 0; j <= harmonics; j++) {
        const int difference_order = k > j ? k - j : j - k, sum_order = k + j;
        const double *cl = means + (difference_order ? 2 * difference_order - 1 : 0) * square,
                     *sl = means + 2 * difference_order * square;
        const double *cs = means + (sum_order ? 2 * sum_order - 1 : 0) * square,
                     *ss = means + 2 * sum_order * square;
        const double odd = !difference_order ? 0.0
                           : k > j           ? 1.0
                                             : -1.0,
                     twice = k && !j ? 2.0 : 1.0;
        for (int a = 0; a < q; a++) {
            double *cosine = tangent_out + a * row + (size_t)(j ? 2 * j - 1 : 0) * q;
            double *sine = cosine + q * row; /* of the rows of b_k */
            for (int b = 0; b < q; b++) {
                const size_t i = (size_t)a * q + b;
                const double even = cl[i], skew = difference_order ? odd * sl[i] : 0.0;
                if (!k || !j) { /* lag and sum are one */
                    cosine[b] = twice * even;
                    if (j) cosine[q + b] = ss[i];
                    if (k) sine[b] = twice * ss[i];
                    continue;
                }
                cosine[b] = even + cs[i], cosine[q + b] = ss[i] - skew;
                sine[b] = ss[i] + skew, sine[q + b] = even - cs[i];
            }
        }
    }
}
