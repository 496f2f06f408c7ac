/* Harmonic balance condensed onto uncoupled pairs with a unilateral penalty, along a parameter. */
#ifndef CONDENSED_H
#define CONDENSED_H

#include "compliance.h"
#include "equations.h"

/*     F(g, p) = g - g_lin(p) + R(p) b(g, p) = 0,    J = dF/dg = I + R T,
 *
 * with g_lin and R as in compliance.h, the coefficients b of the contact forces k(p) max(g, 0), k(p)
 * = k e^{growth p}, and their derivative T. All arrays are the caller's, and stay.
 */
typedef struct {
    seen_structure seen;
    double growth;
    const double *stiffness; /* k: (pairs) */
} condensed;

/* The equations at one point, with room for all of their parts. */
typedef struct point point;

/* NULL without memory. */
point *new_point(const condensed *given);
void free_point(point *at);
/* Its equations; evaluating them returns FOUND, SINGULAR_STRUCTURE or NO_MEMORY. */
equations *equations_of(point *at);
/* Largest sum of |R_k| over a row of it at a parameter; infinite where the structure is singular. */
double largest_compliance(point *at, double parameter);

/* R T for unknowns ordered (row, pair), from R (H+1, pairs, pairs), complex, and
 * T (pairs, 2H+1, columns): (n, columns pairs), ordered (column, pair) too. */
void respond_to_columns(int harmonics, int pairs, int columns, const double *matrices,
                        const double *tangent, double *product);

#endif
