#include "waves.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"

enum { EVEN_COSINES, ODD_COSINES, EVEN_SINES, ODD_SINES, KINDS };

struct waves {
    int harmonics, instants, quarter;      /* quarter: its instants, both ends among them */
    double *there[KINDS], *back[KINDS];    /* (quarter, orders), (orders, quarter) with weights */
    double *part[KINDS], *sum[KINDS];      /* room: (orders, columns), (quarter, columns) */
    double *room;
};

/* Orders k = first, first + 2, ... of a kind. */
static int first_of(int kind) { return kind == EVEN_SINES ? 2 : kind % 2; }

static int orders_of(int harmonics, int kind)
{
    const int first = first_of(kind);
    return harmonics < first ? 0 : (harmonics - first) / 2 + 1;
}

/* Row of a coefficient a_k or b_k. */
static int row_of(int kind, int k) { return k ? 2 * k - (kind < EVEN_SINES) : 0; }

waves *new_waves(int harmonics, int instants, int columns)
{
    waves *at = calloc(1, sizeof(waves));
    if (!at) return NULL;
    const size_t quarter = instants / 4 + 1, most = harmonics / 2 + 1;
    at->harmonics = harmonics, at->instants = instants, at->quarter = (int)quarter;
    at->room = malloc(KINDS * (2 * quarter * most + (quarter + most) * columns) * sizeof(double));
    if (!at->room) {
        free(at);
        return NULL;
    }
    double *room = at->room;
    for (int kind = 0; kind < KINDS; kind++) {
        const int orders = orders_of(harmonics, kind);
        at->there[kind] = room, at->back[kind] = room + quarter * most;
        at->part[kind] = room + 2 * quarter * most;
        at->sum[kind] = at->part[kind] + most * columns;
        room = at->sum[kind] + quarter * columns;
        for (size_t i = 0; i < quarter; i++)
            for (int j = 0; j < orders; j++) {
                const long k = first_of(kind) + 2 * j, turned = k * (long)i % instants;
                const double phase = TWO_PI * turned / instants;
                const double wave = kind < EVEN_SINES ? cos(phase) : sin(phase);
                const double share = (k ? 2.0 : 1.0) / instants;
                const int shared = i == 0 || i + 1 == quarter; /* by two quarters */
                at->there[kind][i * orders + j] = wave;
                at->back[kind][j * quarter + i] = (shared ? 0.5 : 1.0) * share * wave;
            }
    }
    return at;
}

void free_waves(waves *at)
{
    if (at) free(at->room);
    free(at);
}

void waves_to_values(waves *at, int columns, const double *coefficients, double *values)
{
    const size_t row = columns, half = at->instants / 2, all = at->instants;
    for (int kind = 0; kind < KINDS; kind++) {
        const int orders = orders_of(at->harmonics, kind);
        for (int j = 0; j < orders; j++) {
            const int k = first_of(kind) + 2 * j;
            memcpy(at->part[kind] + j * row, coefficients + row_of(kind, k) * row,
                   row * sizeof(double));
        }
        multiply_matrices(at->quarter, orders, columns, at->there[kind], at->part[kind], 0.0,
                          at->sum[kind]);
    }
    for (size_t i = 0; i < (size_t)at->quarter; i++) {
        const double *ce = at->sum[EVEN_COSINES] + i * row, *co = at->sum[ODD_COSINES] + i * row;
        const double *se = at->sum[EVEN_SINES] + i * row, *so = at->sum[ODD_SINES] + i * row;
        double *first = values + i * row, *second = values + (half - i) * row;
        double *third = values + (half + i) * row, *fourth = values + (all - i) % all * row;
        for (size_t j = 0; j < row; j++) {
            const double even = ce[j] + co[j], odd = ce[j] - co[j];
            const double rising = se[j] + so[j], falling = se[j] - so[j];
            fourth[j] = even - rising, first[j] = even + rising;
            second[j] = odd - falling, third[j] = odd + falling;
        }
    }
}

void values_to_waves(waves *at, int columns, const double *values, double *coefficients)
{
    const size_t row = columns, half = at->instants / 2, all = at->instants;
    for (size_t i = 0; i < (size_t)at->quarter; i++) {
        const double *first = values + i * row, *second = values + (half - i) * row;
        const double *third = values + (half + i) * row, *fourth = values + (all - i) % all * row;
        double *ce = at->sum[EVEN_COSINES] + i * row, *co = at->sum[ODD_COSINES] + i * row;
        double *se = at->sum[EVEN_SINES] + i * row, *so = at->sum[ODD_SINES] + i * row;
        for (size_t j = 0; j < row; j++) {
            const double ends = first[j] + fourth[j], middle = second[j] + third[j];
            const double rising = first[j] - fourth[j], falling = second[j] - third[j];
            ce[j] = ends + middle, co[j] = ends - middle;
            se[j] = rising - falling, so[j] = rising + falling;
        }
    }
    for (int kind = 0; kind < KINDS; kind++) {
        const int orders = orders_of(at->harmonics, kind);
        multiply_matrices(orders, at->quarter, columns, at->back[kind], at->sum[kind], 0.0,
                          at->part[kind]);
        for (int j = 0; j < orders; j++) {
            const int k = first_of(kind) + 2 * j;
            memcpy(coefficients + row_of(kind, k) * row, at->part[kind] + j * row,
                   row * sizeof(double));
        }
    }
}
