/* Sets of closed pairs under a compliance, with the inverse of each kept. */
#ifndef SETS_H
#define SETS_H

/* Solve 0 <= f, D f - g >= 0, f^T (D f - g) = 0 at one instant after the other. A motion goes to
 * and fro between few sets A of closed pairs, so the answer (n, n) of each set to the gaps g is
 * kept:
 *
 *     rows of A:   (D_AA)^-1             forces of the closed pairs,
 *     the others:  D_.A (D_AA)^-1 - I    openings D f - g;
 *
 * A is right if no entry of answer * g is negative. */
typedef struct sets sets;

/* Return the row of a hash table, below N_BUCKETS, in which a set is kept. */
enum { N_BUCKETS = 4096 };
int hash_set(int n, const signed char *closed);

/* Make a store for D (n, n), which is copied. It keeps at most `max_kept` answers. NULL without
 * memory. */
sets *new_sets(int n, const double *d, long max_kept);
void free_sets(sets *s);
/* Return the answer of a set (n), valid until the next request; NULL if D_AA is singular. */
const double *get_answer(sets *s, const signed char *closed);
/* Find the forces (n) and the set of gaps (n), from a guess of the set. Closed pairs under tension
 * open, and pairs that penetrate by more than rounding of the largest gap close, all at once
 * (Hintermueller, Ito and Kunisch, SIAM Journal on Optimization 13 (2002) 865). If that cycles,
 * only the first of them changes, which ends for a positive definite D (Murty, Opsearch 11 (1974)
 * 90). may_close: NULL, or (n) pairs that may be closed at all. Returns 0, or 1 if it does not end.
 */
int solve_instant(sets *s, const double *gap, const signed char *may_close, signed char *closed,
                  double *force);
/* Do the same at `count` independent instants; failed (count): results of solve_instant. */
void solve_instants(sets *s, int count, const double *gap, signed char *closed, double *force,
                    signed char *failed);

/* Set (D_AA)^-1, zero outside A, of `count` sets: inverse (count, n, n). Returns 1 if one is
 * singular. */
int invert_sets(sets *s, int count, const signed char *closed, double *inverse);

#endif
