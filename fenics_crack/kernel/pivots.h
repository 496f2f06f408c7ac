/* One set of closed pairs under a compliance, which changes pair by pair. */
#ifndef PIVOTS_H
#define PIVOTS_H

/* Number of changes of a set after which rounding is checked, and number of iterations with all
 * wrong pairs at once, before the first one changes alone. */
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

/* Open all pairs. */
void open_all_pairs(pivot_table *s);
/* Open or close one pair, and update `count` answers X, (count, p). v (p) and gain = 1 / d: the
 * change of S; v may be NULL. Returns 0, or 1 without any change if D_AA would be singular. */
int toggle_pair(pivot_table *s, int pair, int count, double *answers, double *v, double *gain);
/* Compute T from D again if it has lost accuracy. Returns 1 if so. */
int recompute_if_inaccurate(pivot_table *s);
/* Set S (p, p), zero outside A. */
void get_inverse(const pivot_table *s, double *inverse);
/* Set X (count, p) of gaps (count, p), with as much work space. */
void transform_gaps(const pivot_table *s, int count, const double *gaps, double *work,
                    double *answers);
/* Set bounds (p) of |X| from bounds (p) of the gaps. */
void bound_answers(const pivot_table *s, const double *gaps, double *answers);

#endif
