/* One set of closed pairs under a compliance, which changes pair by pair. */
#ifndef PIVOTS_H
#define PIVOTS_H

/* Changes of a set, one after the other, that are trusted: behind as many pivots rounding is looked
 * for, and behind as many turns of all wrong pairs at once the first one goes alone. */
enum { MAX_TRUSTED_PIVOTS = 32 };

/* With the pairs of A closed, B the others, and S = (D_AA)^-1, gaps s have the answer X = S s_A, the
 * forces, in the rows of A, and X = s_B - D_BA f, less than nothing where a pair is open, in the
 * others. A is right where X > 0 at the pairs of A and nowhere else. The table
 *
 *         [ -S       S D_AB              ]
 *     T = [ D_BA S   D_BB - D_BA S D_AB  ]
 *
 * is symmetric. With u = T_.k and d = T_kk, a pair k that closes (d > 0) or opens (d < 0) changes
 *
 *     T -= u u^T / d,   then T_.k = u / |d|, T_kk = -1 / d;      X -= u X_k / d,   then X_k /= |d|;
 *     S += v v^T / d,   v = u at the pairs closed before, and -1 at k if it closes
 *
 * (principal pivots: Cottle, Pang and Stone, The Linear Complementarity Problem, 1992, section 2.3).
 */
typedef struct {
    int pairs;
    const double *compliance; /* (p, p) D */
    double *table;        /* (p, p) T */
    signed char *closed;  /* (p) */
    double *work;         /* (4 p) */
} pivot_table;

/* All pairs open. */
void open_all_pairs(pivot_table *s);
/* Opens or closes one pair; carries `count` answers X along, (count, p). v (p) and gain
 * 1 / d: how S changes; v: or NULL. Returns 0, or 1, with nothing done, where D_AA would be singular.
 */
int toggle_pair(pivot_table *s, int pair, int count, double *answers, double *v, double *gain);
/* Leaves rounding behind where it has grown: T from D again. Returns 1 where it did. */
int recompute_if_inaccurate(pivot_table *s);
/* S (p, p), zero outside A. */
void get_inverse(const pivot_table *s, double *inverse);
/* X (count, p) of gaps (count, p), with room for as many numbers. */
void transform_gaps(const pivot_table *s, int count, const double *gaps, double *work,
                    double *answers);
/* Bounds of |X| where those of the gaps are known, (p) each. */
void bound_answers(const pivot_table *s, const double *gaps, double *answers);

#endif
