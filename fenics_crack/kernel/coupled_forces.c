#include "coupled_forces.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "equations.h"
#include "intervals.h"
#include "lapack.h"
#include "rounding.h"

struct coupled_forces {
    breathing_pairs found;       /* the sets, with room for `most` events */
    int harmonics, pairs, instants, events;
    waves *gaps, *steps;   /* H harmonics at N instants, and 2H */
    double *behind;        /* of each event: a wave that is 1 behind it and 0 before, cut off, as */
    double *shares;        /* coefficients (4H+1, events), and as values (N, events) */
    double *jumps;         /* room: (N, events), */
    double *values, *moved, *forces, *stiffness; /* (N, p) three times, (p, p) */
    double *room;
};

static double *numbers(size_t count) { return malloc((count + 1) * sizeof(double)); }

/* Room for so many events: 0, or 1 without memory. */
static int make_room(coupled_forces *at, int most)
{
    breathing_pairs *m = &at->found;
    const size_t count = most, p = at->pairs, n = at->instants;
    free(m->theta), free(m->event_pairs);
    m->event_pairs = malloc((count + 1) * sizeof(int));
    m->theta = numbers(count * (2 + p + 4 * (size_t)at->harmonics + 1 + 2 * n));
    if (!m->theta || !m->event_pairs) return 1;
    m->max_events = most;
    m->gains = m->theta + count, m->vectors = m->gains + count;
    at->behind = m->vectors + count * p;
    at->shares = at->behind + count * (4 * (size_t)at->harmonics + 1);
    at->jumps = at->shares + count * n;
    free_waves(at->steps);
    at->steps = new_waves(2 * at->harmonics, at->instants, most);
    return !at->steps;
}

coupled_forces *new_coupled_forces(int harmonics, int pairs)
{
    coupled_forces *at = calloc(1, sizeof(coupled_forces));
    if (!at) return NULL;
    breathing_pairs *m = &at->found;
    const size_t p = pairs, square = p * p, instants = 4 * (harmonics + 1);
    at->harmonics = harmonics, at->pairs = pairs, at->instants = (int)instants;
    m->cells = interval_cells(harmonics, pairs), m->n_waves = 2 * harmonics + 1;
    m->contact.pairs = pairs;
    const size_t work = interval_work_size(pairs, harmonics, m->cells);
    at->room = numbers(3 * square + 4 * p + work + 3 * instants * p);
    m->first_set = malloc(2 * p + 1);
    at->gaps = new_waves(harmonics, (int)instants, pairs);
    m->waves = new_waves(harmonics, m->cells, pairs);
    if (!at->room || !m->first_set || !at->gaps || !m->waves || make_room(at, 4 * pairs + 16)) {
        free_coupled_forces(at);
        return NULL;
    }
    m->contact.closed = m->first_set + p;
    m->stiffness = at->room, m->contact.table = m->stiffness + square;
    m->contact.room = m->contact.table + square, m->work = m->contact.room + 4 * p;
    at->values = m->work + work, at->moved = at->values + instants * p;
    at->forces = at->moved + instants * p, at->stiffness = at->forces + instants * p;
    return at;
}

void free_coupled_forces(coupled_forces *at)
{
    if (!at) return;
    free_waves(at->gaps), free_waves(at->steps), free_waves(at->found.waves);
    free(at->found.first_set), free(at->found.theta), free(at->found.event_pairs);
    free(at->room);
    free(at);
}

/* What is behind each event, from the means of exp(i m theta) there, m = 0 to 2H. */
static void set_shares(coupled_forces *at)
{
    const breathing_pairs *m = &at->found;
    const long events = at->events;
    for (long e = 0; e < events; e++) {
        const double c1 = cos(m->theta[e]), s1 = sin(m->theta[e]);
        double c = 1.0, s = 0.0, *wave = at->behind + e;
        wave[0] = 1.0 - m->theta[e] / TWO_PI;
        for (int k = 1; k <= 2 * at->harmonics; k++) {
            const double turned = c * c1 - s * s1, size = 2.0 / (TWO_PI * k);
            s = s * c1 + c * s1, c = turned;
            wave[(2 * k - 1) * events] = -size * s;
            wave[2 * k * events] = size * (c - 1.0);
        }
    }
    if (events) waves_to_values(at->steps, (int)events, at->behind, at->shares);
}

void forces_by_gap(coupled_forces *at, const double *change, double *found)
{
    const breathing_pairs *m = &at->found;
    const int p = at->pairs, n = at->instants, events = at->events;
    waves_to_values(at->gaps, p, change, at->values);
    multiply_matrices(n, p, p, at->values, m->stiffness, 0.0, at->forces);
    multiply_transposed(n, p, events, at->values, m->vectors, at->jumps);
    for (long i = 0; i < n; i++)
        for (long e = 0; e < events; e++)
            at->jumps[i * events + e] *= at->shares[i * events + e] * m->gains[e];
    if (events) multiply_matrices(n, events, p, at->jumps, m->vectors, 1.0, at->forces);
    values_to_waves(at->gaps, p, at->forces, found);
}

int find_forces(coupled_forces *at, const double *compliance, const double *gap, double *force)
{
    breathing_pairs *m = &at->found;
    const int p = at->pairs;
    double largest = 0.0;
    for (int i = 0; i < p; i++) {
        double sum = 0.0;
        for (int row = 0; row < m->n_waves; row++) sum += fabs(gap[(long)row * p + i]);
        if (!(sum <= largest)) largest = sum;
    }
    if (!isfinite(largest)) return NOT_FOUND;
    m->contact.compliance = compliance, m->gaps = gap, m->tolerance = ZERO_TOLERANCE * largest;
    while ((at->events = find_intervals(m)) == -1)
        if (make_room(at, 2 * m->max_events)) return NO_MEMORY;
    if (at->events < 0) return NOT_FOUND;
    set_shares(at);
    forces_by_gap(at, gap, force);
    return FOUND;
}

void forces_by_compliance(coupled_forces *at, const double *rate, double *found)
{
    const breathing_pairs *m = &at->found;
    const int p = at->pairs, n = at->instants, events = at->events;
    double *stiffness = at->stiffness; /* S of one interval after the other */
    memcpy(stiffness, m->stiffness, (size_t)p * p * sizeof(double));
    waves_to_values(at->gaps, p, m->gaps, at->values);
    memset(at->forces, 0, (size_t)n * p * sizeof(double));
    for (long e = 0; e <= events; e++) { /* the interval that ends with the event */
        multiply_matrices(n, p, p, at->values, stiffness, 0.0, at->moved);
        for (long i = 0; i < n; i++) {
            const double *share = at->shares + i * events;
            const double here = (e ? share[e - 1] : 1.0) - (e < events ? share[e] : 0.0);
            for (long j = 0; j < p; j++) at->moved[i * p + j] *= -rate[j] * here;
        }
        multiply_matrices(n, p, p, at->moved, stiffness, 1.0, at->forces);
        const double *v = m->vectors + e * p;
        for (long i = 0; i < p && e < events; i++)
            for (long j = 0; j < p; j++) stiffness[i * p + j] += m->gains[e] * v[i] * v[j];
    }
    values_to_waves(at->gaps, p, at->forces, found);
}

/* U^T S U of a matrix (p, p), or S itself. */
static void seen_by(int p, int q, const double *basis, const double *matrix, double *room,
                    double *found)
{
    if (!basis) {
        memcpy(found, matrix, (size_t)p * p * sizeof(double));
        return;
    }
    multiply_matrices(p, p, q, matrix, basis, 0.0, room);
    for (int a = 0; a < q; a++)
        for (int b = 0; b < q; b++) {
            double sum = 0.0;
            for (int i = 0; i < p; i++) sum += basis[i * q + a] * room[i * q + b];
            found[a * q + b] = sum;
        }
}

int means_of_stiffness(const coupled_forces *at, const double *basis, int q, double *means)
{
    const breathing_pairs *m = &at->found;
    const size_t p = at->pairs, square = (size_t)q * q, events = at->events;
    const int rows = 4 * at->harmonics + 1;
    double *products = numbers((events + 1) * square + q + p * q);
    double *seen = products + (events + 1) * square;
    if (!products) return 1;
    for (size_t e = 0; e < events; e++) { /* gain v v^T, v as it is seen */
        const double *v = m->vectors + e * p;
        double *product = products + e * square;
        if (basis) multiply_matrices(1, (int)p, q, v, basis, 0.0, seen);
        else memcpy(seen, v, p * sizeof(double));
        for (int i = 0; i < q; i++)
            for (int j = 0; j < q; j++) *product++ = m->gains[e] * seen[i] * seen[j];
    }
    multiply_matrices(rows, (int)events, (int)square, at->behind, products, 0.0, means);
    for (size_t i = square; i < rows * square; i++) means[i] *= 0.5;
    /* The mean of the first set, which the events change. */
    double *first = products;
    seen_by((int)p, q, basis, m->stiffness, seen + q, first);
    for (size_t i = 0; i < square; i++) means[i] += first[i];
    free(products);
    return 0;
}

void tangent_of_harmonic(int harmonics, int q, int k, const double *means, double *found)
{
    const size_t rows = 2 * harmonics + 1, row = rows * q, square = (size_t)q * q;
    for (int j = 0; j <= harmonics; j++) {
        const int lag = k > j ? k - j : j - k, sum = k + j;
        const double *cl = means + (lag ? 2 * lag - 1 : 0) * square, *sl = means + 2 * lag * square;
        const double *cs = means + (sum ? 2 * sum - 1 : 0) * square, *ss = means + 2 * sum * square;
        const double odd = !lag ? 0.0 : k > j ? 1.0 : -1.0, twice = k && !j ? 2.0 : 1.0;
        for (int a = 0; a < q; a++) {
            double *cosine = found + a * row + (size_t)(j ? 2 * j - 1 : 0) * q;
            double *sine = cosine + q * row; /* of the rows of b_k */
            for (int b = 0; b < q; b++) {
                const size_t i = (size_t)a * q + b;
                const double even = cl[i], skew = lag ? odd * sl[i] : 0.0;
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
