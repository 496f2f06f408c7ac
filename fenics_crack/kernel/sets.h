/* Sets of closed pairs under a compliance, with the inverse of each kept. */
#ifndef SETS_H
#define SETS_H

/* For 0 <= f, D f - g >= 0, f^T (D f - g) = 0 at one instant after the other. Between few sets A of
 * closed pairs a motion goes to and fro, so of each the answer (n, n) to the gaps g is kept:
 *
 *     rows of A:   (D_AA)^-1             forces of the closed pairs,
 *     the others:  D_.A (D_AA)^-1 - I    openings D f - g;
 *
 * A is right where no number of answer * g is negative.
 */
typedef struct sets sets;

/* Where a set is looked for in a table of known ones: below BUCKETS. */
enum { N_BUCKETS = 4096 };
int hash_set(int n, const signed char *closed);

/* Of D (n, n), which is copied; at most `most` answers are kept. NULL without memory. */
sets *new_sets(int n, const double *d, long max_kept);
void free_sets(sets *s);
/* The answer of a set (n), valid until the next one is asked for; NULL where D_AA is singular. */
const double *get_answer(sets *s, const signed char *closed);
/* Forces (n) and the set of gaps (n) from a guess of the set: pairs pulled are opened, those that
 * penetrate, by more than rounding of the largest gap, are closed, all at once (Hintermueller,
 * Ito and Kunisch, SIAM Journal on Optimization 13 (2002) 865); where that goes round, the first of
 * them alone, which for a positive definite D ends (Murty, Opsearch 11 (1974) 90).
 * among: NULL, or (n) which pairs may be closed at all.
 * Returns 0, or 1 where it does not end. */
int solve_instant(sets *s, const double *gap, const signed char *may_close, signed char *closed,
                  double *force);
/* The same at `count` instants by themselves; failed (count): what forces_at returns of each. */
void solve_instants(sets *s, int count, const double *gap, signed char *closed, double *force,
                    signed char *failed);

/* (D_AA)^-1, zero outside A, of `count` sets: inverse (count, n, n). Returns 1 where one is
 * singular. */
int invert_sets(sets *s, int count, const signed char *closed, double *inverse);

#endif
