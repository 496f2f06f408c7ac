#include "closed_sets.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"
#include "pivots.h"
#include "rounding.h"
#include "series.h"
#include "sets.h"

/* Largest number of sweeps of the relaxation; a hundred are many. */
enum { MAX_SWEEPS = 1000 };

struct closed_sets {
    int modes, n_pairs, n_rows; /* contacts: the rows r, with friction twice the pairs */
    const double *rows, *d, *friction;
    long max_numbers, n_kept_numbers;
    double *work;       /* twice (r, r), and (2, r, m) or three times (TERMS, r) */
    double *given_gaps; /* (r) gaps whose states are sought */
    int *pivots;   /* (r) */
    int next_bucket; /* bucket that is emptied */
    closed_set *bucket[N_BUCKETS];
};

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

closed_sets *new_closed_sets(int modes, int pairs, const double *rows, const double *d,
                             const double *friction, long max_numbers)
{
    const long rest = 2 * modes > 3 * TERMS ? 2 * modes : 3 * TERMS, contacts = friction ? 2L * pairs : pairs;
    closed_sets *s = calloc(1, sizeof(closed_sets));
    if (!s) return NULL;
    s->modes = modes;
    s->n_pairs = pairs;
    s->n_rows = (int)contacts;
    s->rows = rows;
    s->d = d;
    s->friction = friction;
    s->max_numbers = max_numbers;
    s->work = malloc(bytes(contacts * (2 * contacts + rest + 1) + 1));
    s->pivots = malloc((size_t)(contacts + 1) * sizeof(int));
    if (s->work && s->pivots) {
        s->given_gaps = s->work + contacts * (2 * contacts + rest);
        return s;
    }
    free_closed_sets(s);
    return NULL;
}

int count_pairs(const closed_sets *s) { return s->n_pairs; }

const double *get_compliance_row(const closed_sets *s, int row)
{
    return s->d + (long)row * s->n_rows;
}

/* Return whether products with P_A S P_A^T are shorter than with its factors. */
static int has_many(const closed_sets *s, int size) { return 2 * size > s->modes; }

/* Return how many numbers S or L^T takes (half of a symmetric S), and P_A, which P_A S P_A^T
 * replaces. */
static long inverse_size(const closed_sets *s, long size)
{
    return s->friction ? size * s->n_rows : size * (size + 1) / 2;
}

static long columns_size(const closed_sets *s, long size)
{
    return s->friction || !has_many(s, (int)size) ? size * s->modes : 0;
}

static long set_size(const closed_sets *s, long size)
{
    const long m = s->modes, inverse_and_columns = inverse_size(s, size) + columns_size(s, size);
    return inverse_and_columns + m * size + s->n_rows + (has_many(s, (int)size) ? m * m : 0);
}

/* Free sets, bucket by bucket, down to a number of kept numbers. A motion that passes more sets
 * than there is memory for finds some of them when it is followed again. */
static void free_sets_beyond(closed_sets *s, long max_numbers_left)
{
    for (int n_tried = 0; s->n_kept_numbers > max_numbers_left && n_tried < N_BUCKETS; n_tried++) {
        closed_set *set = s->bucket[s->next_bucket], *next;
        for (; set; set = next) {
            next = set->next;
            s->n_kept_numbers -= set_size(s, set->size);
            free(set->inverse);
            free(set);
        }
        s->bucket[s->next_bucket] = NULL;
        s->next_bucket = (s->next_bucket + 1) % N_BUCKETS;
    }
}

void free_closed_sets(closed_sets *s)
{
    free_sets_beyond(s, -1);
    free(s->work);
    free(s->pivots);
    free(s);
}

/* Set P_A, transposed, from the set's rows (size, m), and P_A S P_A^T if the set keeps it. `rows`
 * has as much work space after it. */
static void set_mode_columns(const closed_sets *s, closed_set *a, double *rows)
{
    const int m = s->modes, size = a->size;
    double *columns = a->mode_columns ? a->mode_columns : rows + (long)size * m;
    for (int i = 0; i < size; i++)
        for (int j = 0; j < m; j++) columns[(long)j * size + i] = rows[(long)i * m + j];
    if (a->stiffness) multiply_matrices(m, size, m, columns, a->modal_push, 0.0, a->stiffness);
}

/* Return the tangential force of a slipping pair over its normal force. */
static double friction_slope(const closed_sets *s, const closed_set *a, int pair)
{
    const int state = a->closed[pair];
    return state == SLIP_UP ? s->friction[pair] : state == SLIP_DOWN ? -s->friction[pair] : 0.0;
}

/* Fill a set with friction. Returns 0, or 1 if det A is not positive. */
static int fill_friction_set(closed_sets *s, closed_set *a)
{
    const int m = s->modes, p = s->n_pairs, r = s->n_rows, size = a->size;
    double *matrix = s->work, *columns = matrix + (long)size * size, *set_rows = s->work;
    for (int i = 0, n_normal = 0, n_tangent = a->n_normals; i < p; i++) {
        if (a->closed[i]) a->rows[n_normal++] = i;
        if (a->closed[i] == STICK) a->rows[n_tangent++] = p + i;
    }
    for (int i = 0; i < size; i++) {
        const double *d = s->d + (long)a->rows[i] * r;
        for (int j = 0; j < size; j++) {
            const int row = a->rows[j];
            double *entry = matrix + (long)i * size + j;
            *entry = d[row];
            if (j < a->n_normals) *entry += friction_slope(s, a, row) * d[p + row];
        }
    }
    if (factor(size, matrix, s->pivots) || !(sign_of_factored(size, matrix, s->pivots) > 0.0))
        return 1;
    memset(a->inverse, 0, bytes((long)size * r));
    for (int k = 0; k < r; k++) a->answer_scale[k] = 1.0;
    memset(columns, 0, bytes((long)size * size));
    for (int j = 0; j < size; j++) columns[(long)j * (size + 1)] = 1.0;
    solve_factored(size, size, matrix, s->pivots, columns);
    for (int j = 0; j < size; j++) {
        const double *column = columns + (long)j * size;
        double *forces = a->inverse + (long)j * r;
        for (int i = 0; i < size; i++) {
            const int row = a->rows[i];
            forces[row] += column[i];
            if (i < a->n_normals) forces[p + row] += friction_slope(s, a, row) * column[i];
        }
        a->answer_scale[a->rows[j]] = fabs(forces[a->rows[j]]);
    }
    multiply_matrices(size, r, m, a->inverse, s->rows, 0.0, a->modal_push);
    for (int i = 0; i < size; i++)
        memcpy(set_rows + (long)i * m, s->rows + (long)a->rows[i] * m, bytes(m));
    set_mode_columns(s, a, set_rows);
    return 0;
}

void solve_friction_forces(closed_sets *s, const closed_set *a, int count,
                           const double *stick_places, double *gaps, double *forces)
{
    const int r = s->n_rows, size = a->size;
    double *set_gaps = s->work;
    for (int t = 0; t < count; t++)
        for (int i = 0; i < size; i++)
            set_gaps[(long)t * size + i] = gaps[(long)t * r + a->rows[i]];
    for (int i = a->n_normals; i < size; i++) set_gaps[i] -= stick_places[a->rows[i] - s->n_pairs];
    multiply_matrices(count, size, r, set_gaps, a->inverse, 0.0, forces);
    multiply_matrices(count, r, r, forces, s->d, -1.0, gaps); /* D = D^T */
    for (long i = 0; i < (long)count * r; i++) gaps[i] = -gaps[i];
}

/* Fill a set without friction. Returns 0, or 1 if D_AA is singular. */
static int fill_set(closed_sets *s, closed_set *a)
{
    if (s->friction) return fill_friction_set(s, a);
    const int m = s->modes, p = s->n_pairs, size = a->size;
    double *inverse = s->work, *closed = inverse + (long)p * p, *half_inverse = a->inverse;
    for (int i = 0, n_inside = 0, n_outside = size; i < p; i++)
        a->rows[a->closed[i] ? n_inside++ : n_outside++] = i;
    for (int i = 0; i < size; i++) {
        const double *d = s->d + (long)a->rows[i] * p;
        for (int j = 0; j < size; j++) inverse[(long)i * size + j] = d[a->rows[j]];
    }
    if (invert_positive(size, inverse)) return 1;
    for (int i = 0; i < size; i++, half_inverse += i)
        memcpy(half_inverse, inverse + (long)i * size, bytes(i + 1));
    for (int i = 0; i < p; i++) a->answer_scale[i] = 1.0;
    for (int i = 0; i < size; i++) {
        a->answer_scale[a->rows[i]] = inverse[(long)i * (size + 1)];
        memcpy(closed + (long)i * m, s->rows + (long)a->rows[i] * m, bytes(m));
    }
    multiply_matrices(size, size, m, inverse, closed, 0.0, a->modal_push);
    set_mode_columns(s, a, closed);
    return 0;
}

void make_answers(closed_sets *s, const closed_set *a, int count, const double *gaps,
                  double *answers)
{
    const int p = s->n_pairs, size = a->size, n_open = p - size;
    const int *closed_rows = a->rows, *open_rows = closed_rows + size;
    double *cross_compliance = s->work, *inverse = cross_compliance + (long)p * p,
           *closed = inverse + (long)p * p;
    double *forces = closed + (long)count * p, *openings = forces + (long)count * size;
    const double *half_inverse = a->inverse;
    for (int i = 0; i < size; i++) {
        const double *d = s->d + (long)closed_rows[i] * p;
        for (int j = 0; j <= i; j++)
            inverse[(long)i * size + j] = inverse[(long)j * size + i] = *half_inverse++;
        for (int j = 0; j < n_open; j++) cross_compliance[(long)i * n_open + j] = d[open_rows[j]];
    }
    for (int t = 0; t < count; t++) {
        const double *row = gaps + (long)t * p;
        for (int i = 0; i < size; i++) closed[(long)t * size + i] = row[closed_rows[i]];
        for (int j = 0; j < n_open; j++) openings[(long)t * n_open + j] = row[open_rows[j]];
    }
    multiply_matrices(count, size, size, closed, inverse, 0.0, forces);
    multiply_matrices(count, size, n_open, forces, cross_compliance, -1.0, openings);
    for (int t = 0; t < count; t++) {
        double *row = answers + (long)t * p;
        for (int i = 0; i < size; i++) row[closed_rows[i]] = forces[(long)t * size + i];
        for (int j = 0; j < n_open; j++) row[open_rows[j]] = openings[(long)t * n_open + j];
    }
}

/* Allocate a set; NULL without memory. */
static closed_set *allocate_set(const closed_sets *s, int size, const signed char *closed)
{
    const long m = s->modes, p = s->n_pairs, r = s->n_rows, pairs = columns_size(s, size);
    closed_set *set = calloc(1, sizeof(closed_set) + (size_t)r * sizeof(int) + (size_t)p);
    if (!set) return NULL;
    set->inverse = malloc(bytes(set_size(s, size) + 1));
    if (!set->inverse) {
        free(set);
        return NULL;
    }
    set->size = size;
    set->modal_push = set->inverse + inverse_size(s, size);
    set->mode_columns = pairs ? set->modal_push + m * size : NULL;
    set->answer_scale = set->modal_push + m * size + pairs;
    set->stiffness = has_many(s, size) ? set->answer_scale + r : NULL;
    set->rows = (int *)(set + 1);
    set->closed = (signed char *)(set->rows + r);
    memcpy(set->closed, closed, (size_t)p);
    return set;
}

const closed_set *get_closed_set(closed_sets *s, const signed char *closed)
{
    const int p = s->n_pairs;
    closed_set **bucket = &s->bucket[hash_set(p, closed)];
    for (closed_set *a = *bucket; a; a = a->next)
        if (!memcmp(a->closed, closed, (size_t)p)) return a;
    int closing = 0, size;
    for (int i = 0; i < p; i++) closing += closed[i] != OPEN;
    size = closing;
    for (int i = 0; s->friction && i < p; i++) size += closed[i] == STICK;
    const long needed = set_size(s, size);
    free_sets_beyond(s, s->max_numbers - needed);
    closed_set *new_set = allocate_set(s, size, closed);
    if (!new_set) return NULL;
    new_set->n_normals = closing;
    if (fill_set(s, new_set)) {
        free(new_set->inverse);
        free(new_set);
        return NULL;
    }
    new_set->next = *bucket;
    *bucket = new_set;
    s->n_kept_numbers += needed;
    return new_set;
}

const closed_set *find_closed_set(closed_sets *s, const double *gap, signed char *closed,
                                  double *answers)
{
    const int p = s->n_pairs;
    for (long iteration = 0; iteration < MAX_TRUSTED_PIVOTS + 20L * p; iteration++) {
        const closed_set *a = get_closed_set(s, closed);
        if (!a) return NULL;
        make_answers(s, a, 1, gap, answers);
        int is_wrong = 0;
        for (int i = 0; i < p; i++) {
            /* A pair without force is open. */
            if (closed[i] ? answers[i] > 0.0 : answers[i] >= 0.0) continue;
            if (!is_wrong || iteration < MAX_TRUSTED_PIVOTS) closed[i] = !closed[i];
            is_wrong = 1;
        }
        if (!is_wrong) return a;
    }
    return NULL;
}

/* Return the state of a pair after its forces, gaps and place in the present state. Forces and gaps
 * up to the two limits are rounding. */
static int next_state(const closed_sets *s, const closed_set *a, int pair,
                      const double *stick_places, const double *gaps, const double *forces,
                      double force_rounding, double gap_rounding)
{
    const int tangent_row = s->n_pairs + pair, state = a->closed[pair];
    const double normal_force = forces[pair], tangential_force = forces[tangent_row],
                 slip = gaps[tangent_row] - stick_places[pair];
    const double friction_limit = s->friction[pair] * normal_force;
    if (state == OPEN) return gaps[pair] > gap_rounding ? STICK : OPEN;
    if (normal_force <= 0.0) return OPEN;
    if (state == STICK)
        return tangential_force > friction_limit + force_rounding    ? SLIP_UP
               : tangential_force < -friction_limit - force_rounding ? SLIP_DOWN
                                                                     : STICK;
    return (state == SLIP_UP ? slip : -slip) < -gap_rounding ? STICK : state;
}

/* Find states pair by pair, with fixed forces on the other pairs, until the forces hardly change
 * (Jourdan, Alart and Jean, Computer Methods in Applied Mechanics and Engineering 155 (1998) 31).
 */
static void relax_states(const closed_sets *s, const double *stick_places, const double *gaps,
                         signed char *closed, double *forces)
{
    const int p = s->n_pairs, r = s->n_rows;
    double max_change = INFINITY, max_force = 0.0;
    memset(forces, 0, bytes(r));
    for (int sweep = 0; sweep < MAX_SWEEPS && max_change > ZERO_TOLERANCE * max_force; sweep++) {
        max_change = max_force = 0.0;
        for (int i = 0; i < p; i++) {
            const double *normal = s->d + (long)i * r, *tangent = normal + (long)p * r;
            const double mu = s->friction[i], nn = normal[i], nt = normal[p + i], tt = tangent[p + i];
            double *normal_force = forces + i, *tangential_force = normal_force + p;
            const double last_normal_force = *normal_force,
                         last_tangential_force = *tangential_force;
            *normal_force = *tangential_force = 0.0;
            const double s_n = gaps[i] - dot(r, normal, forces);
            const double s_t = gaps[p + i] - stick_places[i] - dot(r, tangent, forces);
            closed[i] = s_n > 0.0 ? STICK : OPEN;
            if (closed[i] == STICK) {
                *normal_force = (tt * s_n - nt * s_t) / (nn * tt - nt * nt);
                *tangential_force = (nn * s_t - nt * s_n) / (nn * tt - nt * nt);
            }
            if (fabs(*tangential_force) > mu * *normal_force) {
                const double slope = *tangential_force > 0.0 ? mu : -mu;
                closed[i] = *tangential_force > 0.0 ? SLIP_UP : SLIP_DOWN;
                *normal_force = fmax(0.0, s_n / (nn + slope * nt));
                *tangential_force = slope * *normal_force;
            }
            max_change = fmax(max_change, fmax(fabs(*normal_force - last_normal_force),
                                               fabs(*tangential_force - last_tangential_force)));
            max_force = fmax(max_force, fmax(*normal_force, fabs(*tangential_force)));
        }
    }
}

const closed_set *find_states(closed_sets *s, const double *stick_places, signed char *closed,
                              double *gaps, double *forces)
{
    const int p = s->n_pairs, r = s->n_rows;
    double *given_gaps = s->given_gaps, max_size = 0.0;
    for (int i = 0; i < r; i++) max_size = fmax(max_size, fabs(gaps[i]));
    for (int i = 0; i < p; i++) max_size = fmax(max_size, fabs(stick_places[i]));
    memcpy(given_gaps, gaps, bytes(r));
    for (long iteration = 0; iteration < 2 * MAX_TRUSTED_PIVOTS; iteration++) {
        if (iteration == MAX_TRUSTED_PIVOTS)
            relax_states(s, stick_places, given_gaps, closed, forces);
        const closed_set *a = get_closed_set(s, closed);
        if (!a) return NULL;
        memcpy(gaps, given_gaps, bytes(r));
        solve_friction_forces(s, a, 1, stick_places, gaps, forces);
        int is_wrong = 0;
        for (int i = 0; i < p; i++) {
            const double gap = ZERO_TOLERANCE * max_size, force = gap * a->answer_scale[i];
            const int next = next_state(s, a, i, stick_places, gaps, forces, force, gap);
            is_wrong |= next != closed[i];
            closed[i] = (signed char)next;
        }
        if (!is_wrong) return a;
    }
    return NULL;
}

int step_friction(closed_sets *s, double *stick_places, signed char *closed, double *gaps,
                  double *forces)
{
    if (!find_states(s, stick_places, closed, gaps, forces)) return 1;
    for (int i = 0; i < s->n_pairs; i++)
        if (closed[i] != STICK) stick_places[i] = gaps[s->n_pairs + i];
    return 0;
}
