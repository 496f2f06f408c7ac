#include "friction_waves.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"
#include "rounding.h"
#include "series.h"

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

/* Whether the pairs are in the states and places in which they were at this instant a period ago, to a
 * rounding: all that follows is as it was. */
static int repeats(int p, const signed char *now, const signed char *states, const double *held,
                   const double *places, double rounding)
{
    for (int i = 0; i < p; i++)
        if (now[i] != states[i] || fabs(held[i] - places[i]) > rounding) return 0;
    return 1;
}

int march_friction(closed_sets *s, int count, int turns, const double *gaps, double *held,
                   double *forces, signed char *states, double *places, int *origins)
{
    const int p = count_pairs(s), r = 2 * p;
    double *gap = malloc(bytes(r + 1)), largest = 0.0;
    signed char *now = calloc((size_t)p + 1, 1);
    int failed = !gap || !now;
    memset(origins, 0, (size_t)p * sizeof(int));
    for (long i = 0; i < (long)count * r; i++) largest = fmax(largest, fabs(gaps[i]));
    for (long t = 0; t < (long)turns * count && !failed; t++) {
        const long at = t % count;
        memcpy(gap, gaps + at * r, bytes(r));
        failed = step_friction(s, held, now, gap, forces + at * r);
        if (t >= count && repeats(p, now, states + at * p, held, places + at * p, ROUNDING * largest)) break;
        for (int i = 0; i < p; i++)
            if (now[i] != STICK) origins[i] = (int)at;
        memcpy(states + at * p, now, (size_t)p);
        memcpy(places + at * p, held, bytes(p));
    }
    free(gap);
    free(now);
    return failed;
}

/* Whether a pair begins to stick behind an instant, which is when its place is held. */
static int begins_to_stick(const signed char *now, const signed char *next, int pair)
{
    return now[pair] != STICK && next[pair] == STICK;
}

static int some_begin_to_stick(const signed char *now, const signed char *next, int pairs)
{
    for (int i = 0; i < pairs; i++)
        if (begins_to_stick(now, next, i)) return 1;
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
    double *held = calloc((size_t)p + 1, sizeof(double));
    if (!held) return 1;
    for (int i = 0; i < p; i++)
        if (always_sticks(count, states, p, i)) held[i] = gaps[(long)origins[i] * r + p + i];
    for (long t = 0; t < 2L * count; t++) {
        const long at = t % count;
        const signed char *next = states + (t + 1) % count * p;
        const int memory = some_begin_to_stick(states + at * p, next, p);
        if (t < count && !memory) continue;
        const closed_set *a = get_closed_set(s, states + at * p);
        if (!a) {
            free(held);
            return 1;
        }
        const double *gap = gaps + at * r;
        double *force = forces + at * r;
        memset(force, 0, bytes(r));
        for (int i = 0; i < a->size; i++) {
            const int row = a->members[i];
            const double moved = gap[row] - (i < a->closing ? 0.0 : held[row - p]);
            add_rows(1, r, a->inverse + (long)i * r, &moved, force);
        }
        for (int i = 0; i < p && memory; i++)
            if (begins_to_stick(a->closed, next, i))
                held[i] = gap[p + i] - dot(r, get_compliance_row(s, p + i), force);
    }
    free(held);
    return 0;
}

int friction_tangent(closed_sets *s, int count, const signed char *states, const int *origins,
                     int rows, const double *waves, const double *means, int n, const double *basis,
                     double *tangent)
{
    const int p = count_pairs(s), r = 2 * p;
    const long columns = (long)rows * n;
    double *room = malloc(bytes(columns * (r + p + n) + (long)r * n + 2L * r + 1));
    if (!room) return 1;
    double *change = room, *held = change + columns * r, *moved = held + columns * p;
    double *seen = moved + columns * n, *weights = seen + (long)r * n;
    memset(held, 0, bytes(columns * p));
    memset(tangent, 0, bytes(columns * columns));
    for (int i = 0; i < p; i++)
        if (always_sticks(count, states, p, i))
            for (int j = 0; j < rows; j++)
                for (int b = 0; b < n; b++)
                    held[i * columns + (long)j * n + b] =
                        waves[(long)origins[i] * rows + j] * basis[(long)(p + i) * n + b];
    for (long t = 0; t < 2L * count; t++) {
        const long at = t % count;
        const signed char *next = states + (t + 1) % count * p;
        if (t < count && !some_begin_to_stick(states + at * p, next, p)) continue;
        const closed_set *a = get_closed_set(s, states + at * p);
        const double *wave = waves + at * rows, *mean = means + at * rows;
        if (!a) {
            free(room);
            return 1;
        }
        for (int i = 0; i < a->size; i++) { /* ds - dh of the set's rows */
            const double *own = basis + (long)a->members[i] * n;
            double *row = change + i * columns;
            for (int j = 0; j < rows; j++)
                for (int b = 0; b < n; b++) row[(long)j * n + b] = wave[j] * own[b];
            if (i < a->closing) continue;
            const double *place = held + (a->members[i] - p) * columns;
            for (long c = 0; c < columns; c++) row[c] -= place[c];
        }
        for (int i = 0; i < p; i++) { /* dh = U w - D_t L r */
            if (!begins_to_stick(a->closed, next, i)) continue;
            const double *d = get_compliance_row(s, p + i), *own = basis + (long)(p + i) * n;
            double *place = held + i * columns;
            for (int j = 0; j < rows; j++)
                for (int b = 0; b < n; b++) place[(long)j * n + b] = wave[j] * own[b];
            for (int k = 0; k < a->size; k++) weights[k] = -dot(r, d, a->inverse + (long)k * r);
            add_rows(a->size, (int)columns, change, weights, place);
        }
        if (t < count || !a->size) continue;
        /* U^T d lambda = (L^T U)^T r, and its coefficients. */
        multiply_matrices(a->size, r, n, a->inverse, basis, 0.0, seen);
        memset(moved, 0, bytes(columns * n));
        for (int b = 0; b < n; b++) {
            for (int k = 0; k < a->size; k++) weights[k] = seen[(long)k * n + b];
            add_rows(a->size, (int)columns, change, weights, moved + b * columns);
        }
        for (int j = 0; j < rows; j++)
            for (long c = 0; c < columns * n; c++)
                tangent[(long)j * n * columns + c] += mean[j] * moved[c];
    }
    free(room);
    return 0;
}
