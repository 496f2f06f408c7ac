/* Harmonic balance of contact seen through a static compliance, along a parameter. */
#ifndef COUPLED_H
#define COUPLED_H

#include "compliance.h"
#include "equations.h"

/*     F(s, p) = s - g_lin(p) + R~(p) b(lambda(s), p) = 0,      J = dF/ds = I + R~ T,
 *
 * with the gap s of the slow modes, what moves of the compliance, R~_k = R_k - R_inf, and the
 * coefficients b of the contact forces lambda(s) (coupled_forces.h) under
 *
 *     D(p) = R_inf + diag(e^{-growth p} springs) + softness |1 - p|^3.
 *
 * Where modes are fewer than pairs, R~_k = U R'_k U^T with an orthonormal basis U, and J is solved
 * with through I + R' U^T T U, of the same determinant. Where J is not formed turns of a path are
 * judged with 1 / k^2 for harmonic k: where the phase of the motion turns, that of harmonic k turns k
 * times as far, and a tangent's high harmonics are not small. All arrays are the caller's, and stay.
 */
typedef struct {
    seen_structure seen;   /* R~ in the place of R */
    double growth, softness;
    const double *residual; /* R_inf: (p, p) */
    const double *springs;  /* compliance in series with each pair: (p) */
    int seen_gaps;          /* columns of U, or p */
    const double *basis;    /* U: (p, seen_gaps); NULL where it is not needed */
    int formed;             /* whether J is formed; else it is applied alone (krylov.h) */
} coupled;

typedef struct coupled_point coupled_point;

/* NULL without memory. */
coupled_point *new_coupled_point(const coupled *given);
void free_coupled_point(coupled_point *at);
/* Its equations; evaluating them returns FOUND, NOT_FOUND where an instant has no forces,
 * SINGULAR_STRUCTURE or NO_MEMORY. */
equations *equations_of_coupled(coupled_point *at);
/* Largest sum of |R~_k| over a row of it at a parameter; infinite where the structure is singular. */
double largest_moving(coupled_point *at, double parameter);

#endif
