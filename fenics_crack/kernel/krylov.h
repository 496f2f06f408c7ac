/* Solutions with a matrix that is only applied: GMRES, which leaves an approximate inverse behind. */
#ifndef KRYLOV_H
#define KRYLOV_H

#include "equations.h"

/* The vectors W of a solution, of which J V = W H, H = Q R (V: all but the last one), leave
 *
 *     B = I + (V R^-1 - W Q) Q^T W^T,
 *
 * an inverse that is exact on W Q, where J differs most from I. The next solution, with J at a point
 * nearby, is found for J B in few products, and makes the inverse B B' better; and so on, until the
 * vectors are twice those of the first solution, and all begins anew. Source: de Sturler,
 * Journal of Computational and Applied Mathematics 67 (1996) 15 (GCRO).
 */
typedef struct krylov krylov;

enum { MAX_KRYLOV_VECTORS = 600 }; /* of a solution, and of former solutions together */

/* For n unknowns; NULL without memory. */
krylov *new_krylov(int n);
void free_krylov(krylov *k);
/* Set x = J^-1 x at the point evaluated last, up to |J x - r| <= tolerance |r|, or the best result
 * of MAX_KRYLOV_VECTORS products. */
void solve_by_products(krylov *k, equations *system, double *x, double tolerance);

#endif
