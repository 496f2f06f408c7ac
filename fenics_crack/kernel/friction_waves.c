#include "friction_waves.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"
#include "rounding.h"
#include "series.h"

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

/* Return whether states and places repeat those of a period ago, up to rounding: then all that
 * follows repeats. */
static int repeats(int p, const signed char *current_states, const signed char *old_states,
                   const double *stick_places, const double *old_places, double rounding)
{
    for (int i = 0; i < p; i++)
        if (current_states[i] != old_states[i] || fabs(stick_places[i] - old_places[i]) > rounding)
            return 0;
    return 1;
}

int march_friction(closed_sets *s, int count, int max_periods, const double *gaps,
                   double *stick_places, double *forces, signed char *states, double *places,
                   int *origins)
{
    const int p = count_pairs(s), r = 2 * p;
    double *gap = malloc(bytes(r + 1)), max_gap = 0.0;
    signed char *current_states = calloc((size_t)p + 1, 1);
    int failed = !gap || !current_states;
    memset(origins, 0, (size_t)p * sizeof(int));
    for (long i = 0; i < (long)count * r; i++) max_gap = fmax(max_gap, fabs(gaps[i]));
    for (long t = 0; t < (long)max_periods * count && !failed; t++) {
        const long instant = t % count;
        memcpy(gap, gaps + instant * r, bytes(r));
        failed = step_friction(s, stick_places, current_states, gap, forces + instant * r);
        if (t >= count && repeats(p, current_states, states + instant * p, stick_places,
                                  places + instant * p, ROUNDING * max_gap))
            break;
        for (int i = 0; i < p; i++)
            if (current_states[i] != STICK) origins[i] = (int)instant;
        memcpy(states + instant * p, current_states, (size_t)p);
        memcpy(places + instant * p, stick_places, bytes(p));
    }
    free(gap);
    free(current_states);
    return failed;
}

/* Return whether a pair begins to stick after an instant, which is when its place is held. */
static int begins_to_stick(const signed char *current_states, const signed char *next_states,
                           int pair)
{
    return current_states[pair] != STICK && next_states[pair] == STICK;
}

static int some_begin_to_stick(const signed char *current_states, const signed char *next_states,
                               int pairs)
{
    for (int i = 0; i < pairs; i++)
        if (begins_to_stick(current_states, next_states, i)) return 1;
    return 0;
}

static int always_sticks(int count, const signed char *states, int pairs, int pair)
{
    for (long t = 0; t < count; t++)
        if (states[t * pairs + pair] != STICK) return 0;
    return 1;
}

int friction_changes(closed_sets *s, int count, const signed char *states, const int *origins,
                     const double *gaps, double *forces)
{
    const int p = count_pairs(s), r = 2 * p;
    double *stick_places = calloc((size_t)p + 1, sizeof(double));
    if (!stick_places) return 1;
    for (int i = 0; i < p; i++)
        if (always_sticks(count, states, p, i))
            stick_places[i] = gaps[(long)origins[i] * r + p + i];
    for (long t = 0; t < 2L * count; t++) {
        const long instant = t % count;
        const signed char *next_states = states + (t + 1) % count * p;
        const int has_new_places = some_begin_to_stick(states + instant * p, next_states, p);
        if (t < count && !has_new_places) continue;
        const closed_set *a = get_closed_set(s, states + instant * p);
        if (!a) {
            free(stick_places);
            return 1;
        }
        const double *gap = gaps + instant * r;
        double *force = forces + instant * r;
        memset(force, 0, bytes(r));
        for (int i = 0; i < a->size; i++) {
            const int row = a->rows[i];
            const double gap_change = gap[row] - (i < a->n_normals ? 0.0 : stick_places[row - p]);
            add_rows(1, r, a->inverse + (long)i * r, &gap_change, force);
        }
        for (int i = 0; i < p && has_new_places; i++)
            if (begins_to_stick(a->closed, next_states, i))
                stick_places[i] = gap[p + i] - dot(r, get_compliance_row(s, p + i), force);
    }
    free(stick_places);
    return 0;
}

int friction_tangent(closed_sets *s, int count, const signed char *states, const int *origins,
                     int rows, const double *waves, const double *means, int n, const double *basis,
                     double *tangent)
{
    const int p = count_pairs(s), r = 2 * p;
    const long columns = (long)rows * n;
    double *work = malloc(bytes(columns * (r + p + n) + (long)r * n + 2L * r + 1));
    if (!work) return 1;
    double *gap_changes = work, *stick_places = gap_changes + columns * r,
           *product = stick_places + columns * p;
    double *projected = product + columns * n, *weights = projected + (long)r * n;
    memset(stick_places, 0, bytes(columns * p));
    memset(tangent, 0, bytes(columns * columns));
    for (int i = 0; i < p; i++)
        if (always_sticks(count, states, p, i))
            for (int j = 0; j < rows; j++)
                for (int b = 0; b < n; b++)
                    stick_places[i * columns + (long)j * n + b] =
                        waves[(long)origins[i] * rows + j] * basis[(long)(p + i) * n + b];
    for (long t = 0; t < 2L * count; t++) {
        const long instant = t % count;
        const signed char *next_states = states + (t + 1) % count * p;
        if (t < count && !some_begin_to_stick(states + instant * p, next_states, p)) continue;
        const closed_set *a = get_closed_set(s, states + instant * p);
        const double *wave = waves + instant * rows, *mean = means + instant * rows;
        if (!a) {
            free(work);
            return 1;
        }
        for (int i = 0; i < a->size; i++) { /* ds - dh of the set's rows */
            const double *basis_row = basis + (long)a->rows[i] * n;
            double *row = gap_changes + i * columns;
            for (int j = 0; j < rows; j++)
                for (int b = 0; b < n; b++) row[(long)j * n + b] = wave[j] * basis_row[b];
            if (i < a->n_normals) continue;
            const double *place = stick_places + (a->rows[i] - p) * columns;
            for (long c = 0; c < columns; c++) row[c] -= place[c];
        }
        for (int i = 0; i < p; i++) { /* dh = U w - D_t L r */
            if (!begins_to_stick(a->closed, next_states, i)) continue;
            const double *d = get_compliance_row(s, p + i), *basis_row = basis + (long)(p + i) * n;
            double *place = stick_places + i * columns;
            for (int j = 0; j < rows; j++)
                for (int b = 0; b < n; b++) place[(long)j * n + b] = wave[j] * basis_row[b];
            for (int k = 0; k < a->size; k++) weights[k] = -dot(r, d, a->inverse + (long)k * r);
            add_rows(a->size, (int)columns, gap_changes, weights, place);
        }
        if (t < count || !a->size) continue;
        /* U^T d lambda = (L^T U)^T r, and its coefficients. */
        multiply_matrices(a->size, r, n, a->inverse, basis, 0.0, projected);
        memset(product, 0, bytes(columns * n));
        for (int b = 0; b < n; b++) {
            for (int k = 0; k < a->size; k++) weights[k] = projected[(long)k * n + b];
            add_rows(a->size, (int)columns, gap_changes, weights, product + b * columns);
        }
        for (int j = 0; j < rows; j++)
            for (long c = 0; c < columns * n; c++)
                tangent[(long)j * n * columns + c] += mean[j] * product[c];
    }
    free(work);
    return 0;
}
