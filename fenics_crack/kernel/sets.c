#include "sets.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"
#include "pivots.h"
#include "rounding.h"

typedef struct set_answer {
    struct set_answer *next;
    double *answer;
    signed char *closed;
    int n_pivots;
} set_answer;

struct sets {
    int n_pairs;
    long n_kept, max_kept;
    double *d;
    set_answer *bucket[N_BUCKETS], *last_answer; /* last_answer: of the last request */
    double *moved_gaps, *matrix, *column;        /* room */
    int *pivots, *closed_pairs;
};

/* Free all answers but one (NULL: all of them). */
static void drop_answers(sets *s, const set_answer *kept_answer)
{
    s->n_kept = 0;
    for (int b = 0; b < N_BUCKETS; b++) {
        set_answer *first = s->bucket[b], *next;
        s->bucket[b] = NULL;
        for (; first; first = next) {
            next = first->next;
            if (first == kept_answer) {
                first->next = NULL;
                s->bucket[b] = first;
                s->n_kept = 1;
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

static double *allocate(size_t count) { return malloc((count + 1) * sizeof(double)); }

sets *new_sets(int n, const double *d, long max_kept)
{
    const size_t size = n;
    sets *s = calloc(1, sizeof(sets));
    if (!s) return NULL;
    s->n_pairs = n;
    s->max_kept = max_kept;
    s->d = allocate(size * size);
    s->matrix = allocate(size * size);
    s->moved_gaps = allocate(size);
    s->column = allocate(size);
    s->pivots = malloc((size + 1) * sizeof(int));
    s->closed_pairs = malloc((size + 1) * sizeof(int));
    if (!(s->d && s->matrix && s->moved_gaps && s->column && s->pivots && s->closed_pairs)) {
        free_sets(s);
        return NULL;
    }
    memcpy(s->d, d, size * size * sizeof(double));
    return s;
}

void free_sets(sets *s)
{
    drop_answers(s, NULL);
    free(s->d);
    free(s->matrix);
    free(s->moved_gaps);
    free(s->column);
    free(s->pivots);
    free(s->closed_pairs);
    free(s);
}

/* Compute the answer of a set by factors of D_AA. Returns 0, or 1 if D_AA is singular. */
static int compute_answer(sets *s, const signed char *closed, double *answer)
{
    const int n = s->n_pairs;
    int size = 0;
    for (int i = 0; i < n; i++)
        if (closed[i]) s->closed_pairs[size++] = i;
    for (int i = 0; i < size; i++)
        for (int j = 0; j < size; j++)
            s->matrix[i * size + j] = s->d[s->closed_pairs[i] * n + s->closed_pairs[j]];
    if (factor(size, s->matrix, s->pivots)) return 1;
    for (int i = 0; i < n * n; i++) answer[i] = 0.0;
    for (int j = 0; j < size; j++) {
        for (int i = 0; i < size; i++) s->column[i] = i == j;
        solve_factored(size, 1, s->matrix, s->pivots, s->column);
        for (int i = 0; i < size; i++)
            answer[s->closed_pairs[i] * n + s->closed_pairs[j]] = s->column[i];
    }
    for (int i = 0; i < n; i++) {
        if (closed[i]) continue;
        double *row = answer + i * n;
        for (int k = 0; k < size; k++) {
            const double weight = s->d[i * n + s->closed_pairs[k]];
            const double *inverse = answer + s->closed_pairs[k] * n;
            for (int j = 0; j < n; j++) row[j] += weight * inverse[j];
        }
        row[i] -= 1.0;
    }
    return 0;
}

/* Open or close one pair k of a set by a principal pivot, which changes the answer a in O(n^2). A
 * pair with the row a_k that opens gives up its force, and each row its part a_ik of that. A pair
 * that closes makes its opening zero by a force, under which each row moves by p_i. Returns 0, or 1
 * if D_AA would be singular. */
static int pivot_pair(sets *s, signed char *closed, int k, double *a)
{
    const int n = s->n_pairs;
    double *pair_row = a + (long)k * n, *row = s->column, *p = s->moved_gaps;
    if (closed[k])
        for (int i = 0; i < n; i++) p[i] = a[(long)i * n + k];
    else {
        multiply(n, n, s->d, pair_row, p);
        for (int i = 0; i < n; i++) p[i] = closed[i] ? -pair_row[i] : -p[i];
    }
    const double pivot = p[k], min_pivot = closed[k] ? 0.0 : ROUNDING * s->d[(long)k * n + k];
    if (!(pivot > min_pivot)) return 1;
    for (int j = 0; j < n; j++) row[j] = -pair_row[j] / pivot;
    for (int i = 0; i < n; i++) {
        double *other_row = a + (long)i * n;
        if (i == k || p[i] == 0.0) continue;
        for (int j = 0; j < n; j++) other_row[j] += p[i] * row[j];
    }
    memcpy(pair_row, row, n * sizeof(double));
    closed[k] = !closed[k];
    return 0;
}

/* Return whether rounding has spoilt an answer: with gaps of 1 the closed pairs' forces must close
 * these gaps, and leave the others with the openings in the answer. */
static int is_inaccurate(sets *s, const signed char *closed, const double *answer)
{
    const int n = s->n_pairs;
    double *ones = s->column, *answer_gaps = s->moved_gaps, *closed_gaps = s->matrix;
    for (int i = 0; i < n; i++) ones[i] = 1.0;
    multiply(n, n, answer, ones, answer_gaps);
    for (int i = 0; i < n; i++) ones[i] = closed[i] ? answer_gaps[i] : 0.0;
    multiply(n, n, s->d, ones, closed_gaps);
    for (int i = 0; i < n; i++) {
        const double expected = closed[i] ? 1.0 : 1.0 + answer_gaps[i];
        if (!(fabs(closed_gaps[i] - expected) <= ROUNDING * (1.0 + fabs(expected)))) return 1;
    }
    return 0;
}

/* Compute the answer of a set from another answer. Returns 0, or 1 if factors of D_AA are better.
 */
static int update_answer(sets *s, const set_answer *known_answer, set_answer *new_answer)
{
    const size_t n = s->n_pairs;
    double size = 0.0, changes = 0.0;
    for (size_t i = 0; i < n; i++) {
        size += new_answer->closed[i];
        changes += new_answer->closed[i] != known_answer->closed[i];
    }
    const double new_cost = 2.0 * size * size * size + 2.0 * (n - size) * size * n;
    if (known_answer->n_pivots + changes > MAX_TRUSTED_PIVOTS || 4.0 * changes * n * n > new_cost)
        return 1;
    signed char *closed = malloc(n + 1);
    if (!closed) return 1;
    memcpy(closed, known_answer->closed, n);
    memcpy(new_answer->answer, known_answer->answer, n * n * sizeof(double));
    new_answer->n_pivots = known_answer->n_pivots;
    int failed = 0;
    for (size_t k = 0; k < n && !failed; k++)
        if (closed[k] != new_answer->closed[k]) {
            failed = pivot_pair(s, closed, (int)k, new_answer->answer);
            new_answer->n_pivots++;
        }
    free(closed);
    return failed || is_inaccurate(s, new_answer->closed, new_answer->answer);
}

const double *get_answer(sets *s, const signed char *closed)
{
    const size_t n = s->n_pairs;
    set_answer **bucket = &s->bucket[hash_set(s->n_pairs, closed)];
    for (set_answer *k = *bucket; k; k = k->next)
        if (!memcmp(k->closed, closed, n)) {
            s->last_answer = k;
            return k->answer;
        }
    if (s->n_kept >= s->max_kept) drop_answers(s, s->last_answer);
    set_answer *new_answer = malloc(sizeof(set_answer));
    set_answer draft = {*bucket, allocate(n * n), malloc(n + 1), 0};
    int failed = !new_answer || !draft.answer || !draft.closed;
    if (!failed) {
        memcpy(draft.closed, closed, n);
        if (!s->last_answer || update_answer(s, s->last_answer, &draft)) {
            draft.n_pivots = 0;
            failed = compute_answer(s, closed, draft.answer);
        }
    }
    if (failed) {
        free(new_answer);
        free(draft.answer);
        free(draft.closed);
        return NULL;
    }
    *new_answer = draft;
    *bucket = s->last_answer = new_answer;
    s->n_kept++;
    return new_answer->answer;
}

int solve_instant(sets *s, const double *gap, const signed char *may_close, signed char *closed,
                  double *force)
{
    const int n = s->n_pairs;
    double largest = 0.0;
    for (int i = 0; i < n; i++) largest = fmax(largest, fabs(gap[i]));
    const double min_gap = -ZERO_TOLERANCE * largest;
    for (long iteration = 0; iteration < MAX_TRUSTED_PIVOTS + 20L * n * n; iteration++) {
        const double *answer = get_answer(s, closed);
        if (!answer) return 1;
        multiply(n, n, answer, gap, s->moved_gaps);
        int is_wrong = 0;
        for (int i = 0; i < n; i++) {
            if (may_close && !may_close[i]) continue;
            if (closed[i] ? s->moved_gaps[i] > 0.0 : !(s->moved_gaps[i] < min_gap)) continue;
            if (!is_wrong || iteration < MAX_TRUSTED_PIVOTS) closed[i] = !closed[i];
            is_wrong = 1;
        }
        if (is_wrong) continue;
        for (int i = 0; i < n; i++) force[i] = closed[i] ? s->moved_gaps[i] : 0.0;
        return 0;
    }
    return 1;
}

void solve_instants(sets *s, int count, const double *gap, signed char *closed, double *force,
                    signed char *failed)
{
    for (int t = 0; t < count; t++, gap += s->n_pairs, closed += s->n_pairs, force += s->n_pairs)
        failed[t] = solve_instant(s, gap, NULL, closed, force);
}

int invert_sets(sets *s, int count, const signed char *closed, double *inverse)
{
    const size_t n = s->n_pairs;
    for (int t = 0; t < count; t++, closed += n, inverse += n * n) {
        const double *answer = get_answer(s, closed);
        if (!answer) return 1;
        for (size_t i = 0; i < n * n; i++) inverse[i] = closed[i / n] ? answer[i] : 0.0;
    }
    return 0;
}
