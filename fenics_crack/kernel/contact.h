/* Harmonic balance of contact pairs, along a parameter. */
#ifndef CONTACT_H
#define CONTACT_H

#include "compliance.h"
#include "equations.h"

/*     F(s, p) = s - g_lin(p) + R~(p) b(lambda(s), p) = 0,      J = dF/ds = I + R~ T,
 *
 * with the gap s of what moves, its compliance R~_k = R_k - R_inf, and the coefficients b of the
 * contact forces lambda(s), T their derivative, under
 *
 *     D(p) = R_inf + diag(e^{-growth p} springs) + softness |1 - p|^3.
 *
 * Where D is diagonal, each pair has its own force max(s, 0) / D (switching.h); else the pairs are
 * coupled (coupled_forces.h). Solutions take products with J where these are quicker than factors
 * (krylov.h).
 *
 * Where modes are fewer than coupled pairs, R~_k = U R'_k U^T with an orthonormal basis U, and J is
 * solved with through I + R' U^T T U, of the same determinant. Where J is not formed turns of a path
 * are judged with 1 / k^2 for harmonic k: where the phase of the motion turns, that of harmonic k
 * turns k times as far, and a tangent's high harmonics are not small. All arrays are the caller's,
 * and stay.
 */
typedef struct {
    structure_at_pairs structure; /* with R~ in the place of R */
    double growth, softness;
    int has_coupled_pairs;             /* whether D is not diagonal */
    const double *residual_compliance; /* R_inf: (p, p) */
    const double *spring_compliances;  /* compliance in series with each pair: (p) */
    int n_basis_gaps;                  /* columns of U, or p */
    const double *basis;    /* U: (p, n_basis_gaps); NULL where it is not needed */
    int forms_jacobian;     /* whether J is formed; else it is only applied */
} contact_pairs;

typedef struct contact_point contact_point;

/* NULL without memory. */
contact_point *new_contact_point(const contact_pairs *parameters);
void free_contact_point(contact_point *point);
/* Return the equations. An evaluation returns FOUND, NOT_FOUND if an instant has no forces,
 * SINGULAR_STRUCTURE or NO_MEMORY. */
equations *equations_of_contact(contact_point *point);
/* Return the largest row sum of |R~_k| at a parameter; infinite if the structure is singular. */
double largest_dynamic_row_sum(contact_point *point, double parameter);

/* Set R T, (n, columns pairs), from R (H+1, pairs, pairs), complex, and T (pairs, 2H+1, columns).
 * Rows are ordered (row, pair), columns (column, pair). */
void respond_to_columns(int harmonics, int pairs, int columns, const double *matrices,
                        const double *tangent, double *product);

#endif
