#include "sets.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"
#include "pivots.h"
#include "rounding.h"

typedef struct known {
    struct known *next;
    double *answer;
    signed char *closed;
    int pivots;
} known;

struct sets {
    int n;
    long kept, most;
    double *d;
    known *bucket[N_BUCKETS], *last; /* last: whose answer was asked for last */
    double *reached, *matrix, *column; /* room */
    int *pivots, *members;
};

/* All answers but one, or none. */
static void forget(sets *s, const known *kept)
{
    s->kept = 0;
    for (int b = 0; b < N_BUCKETS; b++) {
        known *first = s->bucket[b], *next;
        s->bucket[b] = NULL;
        for (; first; first = next) {
            next = first->next;
            if (first == kept) {
                first->next = NULL;
                s->bucket[b] = first;
                s->kept = 1;
                continue;
            }
            free(first->answer);
            free(first->closed);
            free(first);
        }
    }
}

int hash_set(int n, const signed char *closed)
{
    unsigned hash = 2166136261u; /* of Fowler, Noll and Vo */
    for (int i = 0; i < n; i++) hash = (hash ^ (unsigned)closed[i]) * 16777619u;
    return (int)((hash ^ hash >> 16) % N_BUCKETS);
}

static double *room(size_t count) { return malloc((count + 1) * sizeof(double)); }

sets *new_sets(int n, const double *d, long most)
{
    const size_t size = n;
    sets *s = calloc(1, sizeof(sets));
    if (!s) return NULL;
    s->n = n;
    s->most = most;
    s->d = room(size * size);
    s->matrix = room(size * size);
    s->reached = room(size);
    s->column = room(size);
    s->pivots = malloc((size + 1) * sizeof(int));
    s->members = malloc((size + 1) * sizeof(int));
    if (!(s->d && s->matrix && s->reached && s->column && s->pivots && s->members)) {
        free_sets(s);
        return NULL;
    }
    memcpy(s->d, d, size * size * sizeof(double));
    return s;
}

void free_sets(sets *s)
{
    forget(s, NULL);
    free(s->d);
    free(s->matrix);
    free(s->reached);
    free(s->column);
    free(s->pivots);
    free(s->members);
    free(s);
}

/* The answer of a set by factors of D_AA, whatever has been asked for before: 0, or 1 where it is
 * singular. */
static int answer_anew(sets *s, const signed char *closed, double *answer)
{
    const int n = s->n;
    int size = 0;
    for (int i = 0; i < n; i++)
        if (closed[i]) s->members[size++] = i;
    for (int i = 0; i < size; i++)
        for (int j = 0; j < size; j++)
            s->matrix[i * size + j] = s->d[s->members[i] * n + s->members[j]];
    if (factor(size, s->matrix, s->pivots)) return 1;
    for (int i = 0; i < n * n; i++) answer[i] = 0.0;
    for (int j = 0; j < size; j++) {
        for (int i = 0; i < size; i++) s->column[i] = i == j;
        solve_factored(size, 1, s->matrix, s->pivots, s->column);
        for (int i = 0; i < size; i++) answer[s->members[i] * n + s->members[j]] = s->column[i];
    }
    for (int i = 0; i < n; i++) {
        if (closed[i]) continue;
        double *row = answer + i * n;
        for (int k = 0; k < size; k++) {
            const double weight = s->d[i * n + s->members[k]];
            const double *inverse = answer + s->members[k] * n;
            for (int j = 0; j < n; j++) row[j] += weight * inverse[j];
        }
        row[i] -= 1.0;
    }
    return 0;
}

/* Principal pivot: opens or closes one pair k of a set, whose answer a it changes, in O(n^2). With
 * its row a_k, a pair that opens gives up its force, and each row its part a_ik of that; a pair that
 * closes makes its opening zero by a force, under which each row moves by p_i. 0, or 1 where D_AA
 * would be singular. */
static int turn(sets *s, signed char *closed, int k, double *a)
{
    const int n = s->n;
    double *own = a + (long)k * n, *row = s->column, *p = s->reached;
    if (closed[k])
        for (int i = 0; i < n; i++) p[i] = a[(long)i * n + k];
    else {
        multiply(n, n, s->d, own, p);
        for (int i = 0; i < n; i++) p[i] = closed[i] ? -own[i] : -p[i];
    }
    const double pivot = p[k], least = closed[k] ? 0.0 : ROUNDING * s->d[(long)k * n + k];
    if (!(pivot > least)) return 1;
    for (int j = 0; j < n; j++) row[j] = -own[j] / pivot;
    for (int i = 0; i < n; i++) {
        double *other = a + (long)i * n;
        if (i == k || p[i] == 0.0) continue;
        for (int j = 0; j < n; j++) other[j] += p[i] * row[j];
    }
    memcpy(own, row, n * sizeof(double));
    closed[k] = !closed[k];
    return 0;
}

/* Whether rounding has spoilt an answer: with gaps of 1 the closed pairs' forces must close these,
 * and leave the others the openings that the answer says. */
static int spoilt(sets *s, const signed char *closed, const double *answer)
{
    const int n = s->n;
    double *ones = s->column, *said = s->reached, *found = s->matrix;
    for (int i = 0; i < n; i++) ones[i] = 1.0;
    multiply(n, n, answer, ones, said);
    for (int i = 0; i < n; i++) ones[i] = closed[i] ? said[i] : 0.0;
    multiply(n, n, s->d, ones, found);
    for (int i = 0; i < n; i++) {
        const double expected = closed[i] ? 1.0 : 1.0 + said[i];
        if (!(fabs(found[i] - expected) <= ROUNDING * (1.0 + fabs(expected)))) return 1;
    }
    return 0;
}

/* The answer of a set from that of another one: 0, or 1 where it is better computed anew. */
static int follow(sets *s, const known *from, known *made)
{
    const size_t n = s->n;
    double size = 0.0, changes = 0.0;
    for (size_t i = 0; i < n; i++) {
        size += made->closed[i];
        changes += made->closed[i] != from->closed[i];
    }
    const double anew = 2.0 * size * size * size + 2.0 * (n - size) * size * n;
    if (from->pivots + changes > MAX_TRUSTED_PIVOTS || 4.0 * changes * n * n > anew) return 1;
    signed char *now = malloc(n + 1);
    if (!now) return 1;
    memcpy(now, from->closed, n);
    memcpy(made->answer, from->answer, n * n * sizeof(double));
    made->pivots = from->pivots;
    int failed = 0;
    for (size_t k = 0; k < n && !failed; k++)
        if (now[k] != made->closed[k]) {
            failed = turn(s, now, (int)k, made->answer);
            made->pivots++;
        }
    free(now);
    return failed || spoilt(s, made->closed, made->answer);
}

const double *get_answer(sets *s, const signed char *closed)
{
    const size_t n = s->n;
    known **bucket = &s->bucket[hash_set(s->n, closed)];
    for (known *k = *bucket; k; k = k->next)
        if (!memcmp(k->closed, closed, n)) {
            s->last = k;
            return k->answer;
        }
    if (s->kept >= s->most) forget(s, s->last);
    known *made = malloc(sizeof(known));
    known filled = {*bucket, room(n * n), malloc(n + 1), 0};
    int failed = !made || !filled.answer || !filled.closed;
    if (!failed) {
        memcpy(filled.closed, closed, n);
        if (!s->last || follow(s, s->last, &filled)) {
            filled.pivots = 0;
            failed = answer_anew(s, closed, filled.answer);
        }
    }
    if (failed) {
        free(made);
        free(filled.answer);
        free(filled.closed);
        return NULL;
    }
    *made = filled;
    *bucket = s->last = made;
    s->kept++;
    return made->answer;
}

int solve_instant(sets *s, const double *gap, const signed char *among, signed char *closed,
              double *force)
{
    const int n = s->n;
    double largest = 0.0;
    for (int i = 0; i < n; i++) largest = fmax(largest, fabs(gap[i]));
    const double allowed = -ZERO_TOLERANCE * largest;
    for (long turn = 0; turn < MAX_TRUSTED_PIVOTS + 20L * n * n; turn++) {
        const double *answer = get_answer(s, closed);
        if (!answer) return 1;
        multiply(n, n, answer, gap, s->reached);
        int wrong = 0;
        for (int i = 0; i < n; i++) {
            if (among && !among[i]) continue;
            if (closed[i] ? s->reached[i] > 0.0 : !(s->reached[i] < allowed)) continue;
            if (!wrong || turn < MAX_TRUSTED_PIVOTS) closed[i] = !closed[i];
            wrong = 1;
        }
        if (wrong) continue;
        for (int i = 0; i < n; i++) force[i] = closed[i] ? s->reached[i] : 0.0;
        return 0;
    }
    return 1;
}

void solve_instants(sets *s, int count, const double *gap, signed char *closed, double *force,
               signed char *failed)
{
    for (int t = 0; t < count; t++, gap += s->n, closed += s->n, force += s->n)
        failed[t] = solve_instant(s, gap, NULL, closed, force);
}

int invert_sets(sets *s, int count, const signed char *closed, double *inverse)
{
    const size_t n = s->n;
    for (int t = 0; t < count; t++, closed += n, inverse += n * n) {
        const double *answer = get_answer(s, closed);
        if (!answer) return 1;
        for (size_t i = 0; i < n * n; i++) inverse[i] = closed[i / n] ? answer[i] : 0.0;
    }
    return 0;
}
