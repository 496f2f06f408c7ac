/* Harmonic balance condensed onto uncoupled pairs with a unilateral penalty, along a parameter. */
#ifndef CONDENSED_H
#define CONDENSED_H

#include "equations.h"

/*     F(g, p) = g - g_lin(p) + R(p) b(g, p) = 0,    J = dF/dg = I + R T,
 *
 * with the coefficients b of the contact forces k(p) max(g, 0) and their derivative T, and
 *
 *     k(p)     = k e^{growth p},
 *     R_k(p)   = R_k,  or  P^T h_k P            with h_kj = 1 / (s_j - (k w)^2 + i k w d c_j),
 *     g_lin(p) = linear + p linear_rate  +  P^T h_k l_k,
 *     w(p)     = omega + p omega_rate,          d(p) = damping + p damping_rate.
 *
 * Coefficients stand as in switching.h, n = (2H+1) pairs of them; complex numbers one part after
 * the other. All arrays are the caller's, and stay.
 */
typedef struct {
    int harmonics, pairs, modes;              /* 0 modes where R is given */
    double growth;
    const double *stiffness;                  /* k: (pairs) */
    const double *linear, *linear_rate;       /* (2H+1, pairs) */
    const double *compliance;                 /* R: (H+1, pairs, pairs), complex */
    double omega, omega_rate, damping, damping_rate;
    const double *squares, *rates;            /* s, c: (modes) */
    const double *shapes;                     /* P: (modes, pairs) */
    const double *load;                       /* l: (H+1, modes), complex */
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

/* R lambda of coefficients lambda (2H+1, pairs), from R (H+1, pairs, pairs), complex. */
void respond(int harmonics, int pairs, const double *compliance, const double *force, double *gap);
/* R T for unknowns ordered (row, pair), from R (H+1, pairs, pairs), complex, and
 * T (pairs, 2H+1, columns): (n, columns pairs), ordered (column, pair) too. */
void respond_to_columns(int harmonics, int pairs, int columns, const double *compliance,
                        const double *tangent, double *product);

#endif
