#include "closed_sets.h"

#include <stdlib.h>
#include <string.h>

#include "lapack.h"

struct closed_sets {
    int modes, pairs;
    const double *rows;
    sets *contact;
    long most, kept;
    double *matrix; /* (p, p + m) */
    int next;       /* bucket that is emptied */
    closed_set *bucket[BUCKETS];
};

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

closed_sets *new_closed_sets(int modes, int pairs, const double *rows, sets *contact, long most)
{
    closed_sets *s = calloc(1, sizeof(closed_sets));
    if (!s) return NULL;
    s->modes = modes;
    s->pairs = pairs;
    s->rows = rows;
    s->contact = contact;
    s->most = most;
    s->matrix = malloc(bytes((long)pairs * (pairs + modes) + 1));
    if (s->matrix) return s;
    free(s);
    return NULL;
}

/* Whether products with P_A S P_A^T are shorter than with its factors. */
static int has_many(const closed_sets *s, int size) { return 2 * size > s->modes; }

static long numbers_of(const closed_sets *s, int size)
{
    const long m = s->modes, p = s->pairs;
    return p * p + 2 * m * size + p + (has_many(s, size) ? m * m : 0);
}

/* Forgets sets, bucket by bucket, until so many numbers are kept: of a motion that passes more sets
 * than there is room for, some are known when it is followed again. */
static void forget(closed_sets *s, long left)
{
    for (int tried = 0; s->kept > left && tried < BUCKETS; tried++) {
        closed_set *first = s->bucket[s->next], *next;
        for (; first; first = next) {
            next = first->next;
            s->kept -= numbers_of(s, first->size);
            free(first->answer);
            free(first);
        }
        s->bucket[s->next] = NULL;
        s->next = (s->next + 1) % BUCKETS;
    }
}

void free_closed_sets(closed_sets *s)
{
    forget(s, -1);
    free(s->matrix);
    free(s);
}

/* What a new set is known by: 0, or 1 where D_AA is singular. */
static int fill(closed_sets *s, closed_set *a)
{
    const int m = s->modes, p = s->pairs, size = a->size;
    double *inverse = s->matrix, *closed = inverse + (long)size * size;
    if (answer_anew(s->contact, a->closed, a->answer)) return 1;
    for (int i = 0, row = 0; i < p; i++) {
        a->scale[i] = a->closed[i] ? a->answer[(long)i * p + i] : 1.0;
        if (!a->closed[i]) continue;
        for (int j = 0, column = 0; j < p; j++)
            if (a->closed[j]) inverse[row * size + column++] = a->answer[(long)i * p + j];
        memcpy(closed + (long)row * m, s->rows + (long)i * m, bytes(m));
        for (int j = 0; j < m; j++) a->pairs[(long)j * size + row] = closed[(long)row * m + j];
        row++;
    }
    multiply_matrices(size, size, m, inverse, closed, 0.0, a->pushed);
    if (a->stiffness) multiply_matrices(m, size, m, a->pairs, a->pushed, 0.0, a->stiffness);
    for (int i = 0; i < p; i++)
        for (int j = 0; j < i; j++) {
            double *one = a->answer + (long)i * p + j, *other = a->answer + (long)j * p + i;
            const double held = *one;
            *one = *other;
            *other = held;
        }
    return 0;
}

/* NULL without memory. */
static closed_set *room_for(const closed_sets *s, int size, const signed char *closed)
{
    const long m = s->modes, p = s->pairs;
    closed_set *made = calloc(1, sizeof(closed_set) + (size_t)p);
    if (!made) return NULL;
    made->answer = malloc(bytes(numbers_of(s, size) + 1));
    if (!made->answer) {
        free(made);
        return NULL;
    }
    made->size = size;
    made->pairs = made->answer + p * p;
    made->pushed = made->pairs + m * size;
    made->scale = made->pushed + m * size;
    made->stiffness = has_many(s, size) ? made->scale + p : NULL;
    made->closed = (signed char *)(made + 1);
    memcpy(made->closed, closed, (size_t)p);
    return made;
}

const closed_set *closed_set_of(closed_sets *s, const signed char *closed)
{
    const int p = s->pairs;
    closed_set **bucket = &s->bucket[bucket_of(p, closed)];
    for (closed_set *a = *bucket; a; a = a->next)
        if (!memcmp(a->closed, closed, (size_t)p)) return a;
    int size = 0;
    for (int i = 0; i < p; i++) size += closed[i];
    const long needed = numbers_of(s, size);
    forget(s, s->most - needed);
    closed_set *made = room_for(s, size, closed);
    if (!made) return NULL;
    if (fill(s, made)) {
        free(made->answer);
        free(made);
        return NULL;
    }
    made->next = *bucket;
    *bucket = made;
    s->kept += needed;
    return made;
}
