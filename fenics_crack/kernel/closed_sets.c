#include "closed_sets.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"
#include "pivots.h"
#include "rounding.h"
#include "series.h"
#include "sets.h"

/* Of a relaxation, at most; a hundred are many. */
enum { MAX_SWEEPS = 1000 };

struct closed_sets {
    int modes, pairs, contacts; /* contacts: the rows r, with friction twice the pairs */
    const double *rows, *d, *friction;
    long most, kept;
    double *room;  /* twice (r, r), and (2, r, m) or three times (TERMS, r) */
    double *given; /* (r) gaps whose states are sought */
    int *pivots;   /* (r) */
    int next;      /* bucket that is emptied */
    closed_set *bucket[N_BUCKETS];
};

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

closed_sets *new_closed_sets(int modes, int pairs, const double *rows, const double *d,
                             const double *friction, long most)
{
    const long rest = 2 * modes > 3 * TERMS ? 2 * modes : 3 * TERMS, contacts = friction ? 2L * pairs : pairs;
    closed_sets *s = calloc(1, sizeof(closed_sets));
    if (!s) return NULL;
    s->modes = modes;
    s->pairs = pairs;
    s->contacts = (int)contacts;
    s->rows = rows;
    s->d = d;
    s->friction = friction;
    s->most = most;
    s->room = malloc(bytes(contacts * (2 * contacts + rest + 1) + 1));
    s->pivots = malloc((size_t)(contacts + 1) * sizeof(int));
    if (s->room && s->pivots) {
        s->given = s->room + contacts * (2 * contacts + rest);
        return s;
    }
    free_closed_sets(s);
    return NULL;
}

int count_pairs(const closed_sets *s) { return s->pairs; }

const double *get_compliance_row(const closed_sets *s, int row)
{
    return s->d + (long)row * s->contacts;
}

/* Whether products with P_A S P_A^T are shorter than with its factors. */
static int has_many(const closed_sets *s, int size) { return 2 * size > s->modes; }

/* Numbers of S, of which half are kept, or of L^T; and of P_A, which P_A S P_A^T replaces. */
static long numbers_of_inverse(const closed_sets *s, long size)
{
    return s->friction ? size * s->contacts : size * (size + 1) / 2;
}

static long numbers_of_pairs(const closed_sets *s, long size)
{
    return s->friction || !has_many(s, (int)size) ? size * s->modes : 0;
}

static long numbers_of(const closed_sets *s, long size)
{
    const long m = s->modes, own = numbers_of_inverse(s, size) + numbers_of_pairs(s, size);
    return own + m * size + s->contacts + (has_many(s, (int)size) ? m * m : 0);
}

/* Forgets sets, bucket by bucket, until so many numbers are kept: of a motion that passes more sets
 * than there is room for, some are known when it is followed again. */
static void forget(closed_sets *s, long left)
{
    for (int tried = 0; s->kept > left && tried < N_BUCKETS; tried++) {
        closed_set *first = s->bucket[s->next], *next;
        for (; first; first = next) {
            next = first->next;
            s->kept -= numbers_of(s, first->size);
            free(first->inverse);
            free(first);
        }
        s->bucket[s->next] = NULL;
        s->next = (s->next + 1) % N_BUCKETS;
    }
}

void free_closed_sets(closed_sets *s)
{
    forget(s, -1);
    free(s->room);
    free(s->pivots);
    free(s);
}

/* How a set presses on the modes, by its own rows (size, m), behind which is room for as many
 * numbers, and what they push. */
static void press(const closed_sets *s, closed_set *a, double *own)
{
    const int m = s->modes, size = a->size;
    double *pairs = a->pairs ? a->pairs : own + (long)size * m;
    for (int i = 0; i < size; i++)
        for (int j = 0; j < m; j++) pairs[(long)j * size + i] = own[(long)i * m + j];
    if (a->stiffness) multiply_matrices(m, size, m, pairs, a->pushed, 0.0, a->stiffness);
}

/* The tangential force of a slipping pair, relative to its normal one. */
static double slope_of(const closed_sets *s, const closed_set *a, int pair)
{
    const int state = a->closed[pair];
    return state == SLIP_UP ? s->friction[pair] : state == SLIP_DOWN ? -s->friction[pair] : 0.0;
}

/* What a set is known by with friction: 0, or 1 where det A is not positive. */
static int fill_with_friction(closed_sets *s, closed_set *a)
{
    const int m = s->modes, p = s->pairs, r = s->contacts, size = a->size;
    double *matrix = s->room, *columns = matrix + (long)size * size, *own = s->room;
    for (int i = 0, normal = 0, tangent = a->closing; i < p; i++) {
        if (a->closed[i]) a->members[normal++] = i;
        if (a->closed[i] == STICK) a->members[tangent++] = p + i;
    }
    for (int i = 0; i < size; i++) {
        const double *d = s->d + (long)a->members[i] * r;
        for (int j = 0; j < size; j++) {
            const int row = a->members[j];
            double *entry = matrix + (long)i * size + j;
            *entry = d[row];
            if (j < a->closing) *entry += slope_of(s, a, row) * d[p + row];
        }
    }
    if (factor(size, matrix, s->pivots) || !(sign_of_factored(size, matrix, s->pivots) > 0.0))
        return 1;
    memset(a->inverse, 0, bytes((long)size * r));
    for (int k = 0; k < r; k++) a->scale[k] = 1.0;
    memset(columns, 0, bytes((long)size * size));
    for (int j = 0; j < size; j++) columns[(long)j * (size + 1)] = 1.0;
    solve_factored(size, size, matrix, s->pivots, columns);
    for (int j = 0; j < size; j++) {
        const double *column = columns + (long)j * size;
        double *forces = a->inverse + (long)j * r;
        for (int i = 0; i < size; i++) {
            const int row = a->members[i];
            forces[row] += column[i];
            if (i < a->closing) forces[p + row] += slope_of(s, a, row) * column[i];
        }
        a->scale[a->members[j]] = fabs(forces[a->members[j]]);
    }
    multiply_matrices(size, r, m, a->inverse, s->rows, 0.0, a->pushed);
    for (int i = 0; i < size; i++)
        memcpy(own + (long)i * m, s->rows + (long)a->members[i] * m, bytes(m));
    press(s, a, own);
    return 0;
}

void solve_friction_forces(closed_sets *s, const closed_set *a, int count, const double *held, double *gaps,
                double *forces)
{
    const int r = s->contacts, size = a->size;
    double *own = s->room;
    for (int t = 0; t < count; t++)
        for (int i = 0; i < size; i++) own[(long)t * size + i] = gaps[(long)t * r + a->members[i]];
    for (int i = a->closing; i < size; i++) own[i] -= held[a->members[i] - s->pairs];
    multiply_matrices(count, size, r, own, a->inverse, 0.0, forces);
    multiply_matrices(count, r, r, forces, s->d, -1.0, gaps); /* D = D^T */
    for (long i = 0; i < (long)count * r; i++) gaps[i] = -gaps[i];
}

/* What a set is known by, whatever has been asked for before: 0, or 1 where D_AA is singular. */
static int fill(closed_sets *s, closed_set *a)
{
    if (s->friction) return fill_with_friction(s, a);
    const int m = s->modes, p = s->pairs, size = a->size;
    double *inverse = s->room, *closed = inverse + (long)p * p, *half = a->inverse;
    for (int i = 0, in = 0, out = size; i < p; i++) a->members[a->closed[i] ? in++ : out++] = i;
    for (int i = 0; i < size; i++) {
        const double *d = s->d + (long)a->members[i] * p;
        for (int j = 0; j < size; j++) inverse[(long)i * size + j] = d[a->members[j]];
    }
    if (invert_positive(size, inverse)) return 1;
    for (int i = 0; i < size; i++, half += i)
        memcpy(half, inverse + (long)i * size, bytes(i + 1));
    for (int i = 0; i < p; i++) a->scale[i] = 1.0;
    for (int i = 0; i < size; i++) {
        a->scale[a->members[i]] = inverse[(long)i * (size + 1)];
        memcpy(closed + (long)i * m, s->rows + (long)a->members[i] * m, bytes(m));
    }
    multiply_matrices(size, size, m, inverse, closed, 0.0, a->pushed);
    press(s, a, closed);
    return 0;
}

void make_answers(closed_sets *s, const closed_set *a, int count, const double *gaps, double *answers)
{
    const int p = s->pairs, size = a->size, others = p - size;
    const int *in = a->members, *out = in + size;
    double *across = s->room, *inverse = across + (long)p * p, *closed = inverse + (long)p * p;
    double *forces = closed + (long)count * p, *openings = forces + (long)count * size;
    const double *half = a->inverse;
    for (int i = 0; i < size; i++) {
        const double *d = s->d + (long)in[i] * p;
        for (int j = 0; j <= i; j++)
            inverse[(long)i * size + j] = inverse[(long)j * size + i] = *half++;
        for (int j = 0; j < others; j++) across[(long)i * others + j] = d[out[j]];
    }
    for (int t = 0; t < count; t++) {
        const double *row = gaps + (long)t * p;
        for (int i = 0; i < size; i++) closed[(long)t * size + i] = row[in[i]];
        for (int j = 0; j < others; j++) openings[(long)t * others + j] = row[out[j]];
    }
    multiply_matrices(count, size, size, closed, inverse, 0.0, forces);
    multiply_matrices(count, size, others, forces, across, -1.0, openings);
    for (int t = 0; t < count; t++) {
        double *row = answers + (long)t * p;
        for (int i = 0; i < size; i++) row[in[i]] = forces[(long)t * size + i];
        for (int j = 0; j < others; j++) row[out[j]] = openings[(long)t * others + j];
    }
}

/* NULL without memory. */
static closed_set *room_for(const closed_sets *s, int size, const signed char *closed)
{
    const long m = s->modes, p = s->pairs, r = s->contacts, pairs = numbers_of_pairs(s, size);
    closed_set *made = calloc(1, sizeof(closed_set) + (size_t)r * sizeof(int) + (size_t)p);
    if (!made) return NULL;
    made->inverse = malloc(bytes(numbers_of(s, size) + 1));
    if (!made->inverse) {
        free(made);
        return NULL;
    }
    made->size = size;
    made->pushed = made->inverse + numbers_of_inverse(s, size);
    made->pairs = pairs ? made->pushed + m * size : NULL;
    made->scale = made->pushed + m * size + pairs;
    made->stiffness = has_many(s, size) ? made->scale + r : NULL;
    made->members = (int *)(made + 1);
    made->closed = (signed char *)(made->members + r);
    memcpy(made->closed, closed, (size_t)p);
    return made;
}

const closed_set *get_closed_set(closed_sets *s, const signed char *closed)
{
    const int p = s->pairs;
    closed_set **bucket = &s->bucket[hash_set(p, closed)];
    for (closed_set *a = *bucket; a; a = a->next)
        if (!memcmp(a->closed, closed, (size_t)p)) return a;
    int closing = 0, size;
    for (int i = 0; i < p; i++) closing += closed[i] != OPEN;
    size = closing;
    for (int i = 0; s->friction && i < p; i++) size += closed[i] == STICK;
    const long needed = numbers_of(s, size);
    forget(s, s->most - needed);
    closed_set *made = room_for(s, size, closed);
    if (!made) return NULL;
    made->closing = closing;
    if (fill(s, made)) {
        free(made->inverse);
        free(made);
        return NULL;
    }
    made->next = *bucket;
    *bucket = made;
    s->kept += needed;
    return made;
}

const closed_set *find_closed_set(closed_sets *s, const double *gap, signed char *closed, double *answers)
{
    const int p = s->pairs;
    for (long turn = 0; turn < MAX_TRUSTED_PIVOTS + 20L * p; turn++) {
        const closed_set *a = get_closed_set(s, closed);
        if (!a) return NULL;
        make_answers(s, a, 1, gap, answers);
        int wrong = 0;
        for (int i = 0; i < p; i++) {
            /* Without force a pair is open. */
            if (closed[i] ? answers[i] > 0.0 : answers[i] >= 0.0) continue;
            if (!wrong || turn < MAX_TRUSTED_PIVOTS) closed[i] = !closed[i];
            wrong = 1;
        }
        if (!wrong) return a;
    }
    return NULL;
}

/* The state of a pair that follows from its forces, gaps and place in one; up to a force and a gap they
 * are rounding. */
static int next_state(const closed_sets *s, const closed_set *a, int pair, const double *held,
                      const double *gaps, const double *forces, double force, double gap)
{
    const int other = s->pairs + pair, state = a->closed[pair];
    const double pressed = forces[pair], pulled = forces[other], moved = gaps[other] - held[pair];
    const double cone = s->friction[pair] * pressed;
    if (state == OPEN) return gaps[pair] > gap ? STICK : OPEN;
    if (pressed <= 0.0) return OPEN;
    if (state == STICK)
        return pulled > cone + force ? SLIP_UP : pulled < -cone - force ? SLIP_DOWN : STICK;
    return (state == SLIP_UP ? moved : -moved) < -gap ? STICK : state;
}

/* States by one pair after the other, each as if the forces on the others stayed, until these hardly
 * change (Jourdan, Alart and Jean, Computer Methods in Applied Mechanics and Engineering 155 (1998)
 * 31). */
static void relax(const closed_sets *s, const double *held, const double *given, signed char *closed,
                  double *forces)
{
    const int p = s->pairs, r = s->contacts;
    double moved = INFINITY, largest = 0.0;
    memset(forces, 0, bytes(r));
    for (int sweep = 0; sweep < MAX_SWEEPS && moved > ZERO_TOLERANCE * largest; sweep++) {
        moved = largest = 0.0;
        for (int i = 0; i < p; i++) {
            const double *normal = s->d + (long)i * r, *tangent = normal + (long)p * r;
            const double mu = s->friction[i], nn = normal[i], nt = normal[p + i], tt = tangent[p + i];
            double *press = forces + i, *pull = press + p;
            const double before = *press, away = *pull;
            *press = *pull = 0.0;
            const double s_n = given[i] - dot(r, normal, forces);
            const double s_t = given[p + i] - held[i] - dot(r, tangent, forces);
            closed[i] = s_n > 0.0 ? STICK : OPEN;
            if (closed[i] == STICK) {
                *press = (tt * s_n - nt * s_t) / (nn * tt - nt * nt);
                *pull = (nn * s_t - nt * s_n) / (nn * tt - nt * nt);
            }
            if (fabs(*pull) > mu * *press) {
                const double slope = *pull > 0.0 ? mu : -mu;
                closed[i] = *pull > 0.0 ? SLIP_UP : SLIP_DOWN;
                *press = fmax(0.0, s_n / (nn + slope * nt));
                *pull = slope * *press;
            }
            moved = fmax(moved, fmax(fabs(*press - before), fabs(*pull - away)));
            largest = fmax(largest, fmax(*press, fabs(*pull)));
        }
    }
}

const closed_set *find_states(closed_sets *s, const double *held, signed char *closed, double *gaps,
                            double *forces)
{
    const int p = s->pairs, r = s->contacts;
    double *given = s->given, largest = 0.0;
    for (int i = 0; i < r; i++) largest = fmax(largest, fabs(gaps[i]));
    for (int i = 0; i < p; i++) largest = fmax(largest, fabs(held[i]));
    memcpy(given, gaps, bytes(r));
    for (long turn = 0; turn < 2 * MAX_TRUSTED_PIVOTS; turn++) {
        if (turn == MAX_TRUSTED_PIVOTS) relax(s, held, given, closed, forces);
        const closed_set *a = get_closed_set(s, closed);
        if (!a) return NULL;
        memcpy(gaps, given, bytes(r));
        solve_friction_forces(s, a, 1, held, gaps, forces);
        int wrong = 0;
        for (int i = 0; i < p; i++) {
            const double gap = ZERO_TOLERANCE * largest, force = gap * a->scale[i];
            const int next = next_state(s, a, i, held, gaps, forces, force, gap);
            wrong |= next != closed[i];
            closed[i] = (signed char)next;
        }
        if (!wrong) return a;
    }
    return NULL;
}

int step_friction(closed_sets *s, double *held, signed char *closed, double *gaps, double *forces)
{
    if (!find_states(s, held, closed, gaps, forces)) return 1;
    for (int i = 0; i < s->pairs; i++)
        if (closed[i] != STICK) held[i] = gaps[s->pairs + i];
    return 0;
}
