/* Contact at one instant. */
#ifndef INSTANT_H
#define INSTANT_H

/* Primal-dual active sets for 0 <= f, D f - g >= 0, f^T (D f - g) = 0 with D (n, n):
 * pairs taken as closed have (D f - g) = 0, the others f = 0; those then pulled are opened, those
 * that penetrate more than `allowed` are closed, until the set stays the same.
 * (Hintermueller, Ito and Kunisch, SIAM Journal on Optimization 13 (2002) 865.)
 *
 * closed: (n), a first guess, and the set found. force: (n). matrix, pivots, reached: room for
 * n * n, n, n numbers. Returns 0, or 1 where it does not end (it may cycle) or D_AA is singular.
 */
int active_sets(int n, const double *d, const double *g, double allowed, int most,
                signed char *closed, double *force, double *matrix, int *pivots, double *reached);

#endif
