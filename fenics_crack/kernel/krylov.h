/* Solutions with a matrix that is only applied: GMRES, which leaves an approximate inverse behind. */
#ifndef KRYLOV_H
#define KRYLOV_H

#include "equations.h"

/* The vectors V and the Hessenberg matrix H of a solution approximate the inverse on what they span,
 *
 *     A^-1 = B,      B = I + V (H^-1 - I) V^T,
 *
 * where the other eigenvalues of A are close to 1. The next solution, with J at a point nearby, is
 * found for J B in few products, and makes the inverse B B' better; and so on, until the vectors are
 * KEPT times those of the first solution, and all begins anew. Source: Saad, Iterative Methods for
 * Sparse Linear Systems, 2003, sections 6.5 and 9.3.
 */
typedef struct krylov krylov;

/* For n unknowns; NULL without memory. */
krylov *new_krylov(int n);
void free_krylov(krylov *k);
/* x = J^-1 x at the point that has been evaluated, to |J x - r| <= tolerance |r|, or the best of MOST
 * products. */
void solve_by_products(krylov *k, equations *at, double *x, double tolerance);
/* x = B x. */
void solve_by_kept(const krylov *k, double *x);
/* Whether there is a B. */
int has_kept(const krylov *k);

#endif
