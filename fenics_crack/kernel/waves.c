#include "waves.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"

enum { EVEN_COSINES, ODD_COSINES, EVEN_SINES, ODD_SINES, KINDS };

struct waves {
    int harmonics, instants, n_quarter; /* n_quarter: instants of a quarter, both ends included */
    double *to_values[KINDS],
        *to_coefficients[KINDS]; /* (quarter, orders), (orders, quarter) with weights */
    double *coefficient_part[KINDS],
        *quarter_sums[KINDS]; /* work space: (orders, columns), (n_quarter, columns) */
    double *work;
};

/* Return the first order k of a kind; the next ones are k + 2, ... */
static int first_order(int kind) { return kind == EVEN_SINES ? 2 : kind % 2; }

static int count_orders(int harmonics, int kind)
{
    const int first = first_order(kind);
    return harmonics < first ? 0 : (harmonics - first) / 2 + 1;
}

/* Return the row of a coefficient a_k or b_k. */
static int coefficient_row(int kind, int k) { return k ? 2 * k - (kind < EVEN_SINES) : 0; }

waves *new_waves(int harmonics, int instants, int columns)
{
    waves *self = calloc(1, sizeof(waves));
    if (!self) return NULL;
    const size_t n_quarter = instants / 4 + 1, max_orders = harmonics / 2 + 1;
    self->harmonics = harmonics, self->instants = instants, self->n_quarter = (int)n_quarter;
    self->work = malloc(KINDS * (2 * n_quarter * max_orders + (n_quarter + max_orders) * columns) *
                        sizeof(double));
    if (!self->work) {
        free(self);
        return NULL;
    }
    double *next = self->work;
    for (int kind = 0; kind < KINDS; kind++) {
        const int orders = count_orders(harmonics, kind);
        self->to_values[kind] = next, self->to_coefficients[kind] = next + n_quarter * max_orders;
        self->coefficient_part[kind] = next + 2 * n_quarter * max_orders;
        self->quarter_sums[kind] = self->coefficient_part[kind] + max_orders * columns;
        next = self->quarter_sums[kind] + n_quarter * columns;
        for (size_t i = 0; i < n_quarter; i++)
            for (int j = 0; j < orders; j++) {
                const long k = first_order(kind) + 2 * j, instant_index = k * (long)i % instants;
                const double phase = TWO_PI * instant_index / instants;
                const double wave = kind < EVEN_SINES ? cos(phase) : sin(phase);
                const double factor = (k ? 2.0 : 1.0) / instants;
                const int is_shared = i == 0 || i + 1 == n_quarter; /* by two quarters */
                self->to_values[kind][i * orders + j] = wave;
                self->to_coefficients[kind][j * n_quarter + i] =
                    (is_shared ? 0.5 : 1.0) * factor * wave;
            }
    }
    return self;
}

void free_waves(waves *self)
{
    if (self) free(self->work);
    free(self);
}

void waves_to_values(waves *self, int columns, const double *coefficients, double *values)
{
    const size_t stride = columns, half = self->instants / 2, n_instants = self->instants;
    for (int kind = 0; kind < KINDS; kind++) {
        const int orders = count_orders(self->harmonics, kind);
        for (int j = 0; j < orders; j++) {
            const int k = first_order(kind) + 2 * j;
            memcpy(self->coefficient_part[kind] + j * stride,
                   coefficients + coefficient_row(kind, k) * stride, stride * sizeof(double));
        }
        multiply_matrices(self->n_quarter, orders, columns, self->to_values[kind],
                          self->coefficient_part[kind], 0.0, self->quarter_sums[kind]);
    }
    for (size_t i = 0; i < (size_t)self->n_quarter; i++) {
        const double *ce = self->quarter_sums[EVEN_COSINES] + i * stride,
                     *co = self->quarter_sums[ODD_COSINES] + i * stride;
        const double *se = self->quarter_sums[EVEN_SINES] + i * stride,
                     *so = self->quarter_sums[ODD_SINES] + i * stride;
        double *first = values + i * stride, *second = values + (half - i) * stride;
        double *third = values + (half + i) * stride,
               *fourth = values + (n_instants - i) % n_instants * stride;
        for (size_t j = 0; j < stride; j++) {
            const double even = ce[j] + co[j], odd = ce[j] - co[j];
            const double rising = se[j] + so[j], falling = se[j] - so[j];
            fourth[j] = even - rising, first[j] = even + rising;
            second[j] = odd - falling, third[j] = odd + falling;
        }
    }
}

void values_to_waves(waves *self, int columns, const double *values, double *coefficients)
{
    const size_t stride = columns, half = self->instants / 2, n_instants = self->instants;
    for (size_t i = 0; i < (size_t)self->n_quarter; i++) {
        const double *first = values + i * stride, *second = values + (half - i) * stride;
        const double *third = values + (half + i) * stride,
                     *fourth = values + (n_instants - i) % n_instants * stride;
        double *ce = self->quarter_sums[EVEN_COSINES] + i * stride,
               *co = self->quarter_sums[ODD_COSINES] + i * stride;
        double *se = self->quarter_sums[EVEN_SINES] + i * stride,
               *so = self->quarter_sums[ODD_SINES] + i * stride;
        for (size_t j = 0; j < stride; j++) {
            const double ends = first[j] + fourth[j], middle = second[j] + third[j];
            const double rising = first[j] - fourth[j], falling = second[j] - third[j];
            ce[j] = ends + middle, co[j] = ends - middle;
            se[j] = rising - falling, so[j] = rising + falling;
        }
    }
    for (int kind = 0; kind < KINDS; kind++) {
        const int orders = count_orders(self->harmonics, kind);
        multiply_matrices(orders, self->n_quarter, columns, self->to_coefficients[kind],
                          self->quarter_sums[kind], 0.0, self->coefficient_part[kind]);
        for (int j = 0; j < orders; j++) {
            const int k = first_order(kind) + 2 * j;
            memcpy(coefficients + coefficient_row(kind, k) * stride,
                   self->coefficient_part[kind] + j * stride, stride * sizeof(double));
        }
    }
}
