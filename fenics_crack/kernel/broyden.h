/* Newton's method in the plane across a path, with the LU factors of a former point. */
#ifndef BROYDEN_H
#define BROYDEN_H

#include "equations.h"

/* A point of a path, z = (x, p), has n unknowns x and a parameter p; <y, z> = weight y.z + y_p z_p.
 * Steps s with J s_x + F_p s_p = - r stay in the plane <across, s> = 0. With the factors of J_0 at
 * a point whose tangent was `along`, they are s = - B^-1 r,
 *
 *     B^-1 r = d - along <across, d> / <across, along>,      d = (J_0^-1 r, 0),
 *
 * which Broyden's "good" method corrects by each step and by q, what B^-1 makes of the residual
 * left behind it:
 *
 *     B^-1 <- (I + c s^T) B^-1,     c = - q / (|s|^2 + <s, q>),     the next step being |s|^2 c.
 *
 * So an iteration takes some n^2 operations where a factorisation takes n^3. Source: Kelley,
 * Solving Nonlinear Equations with Newton's Method, 2003, chapter 4.
 */
typedef struct {
    int unknowns, known;              /* n; pairs (s, c) that are known */
    double weight;
    double *across, *along, *rate;    /* (n+1), (n+1), F_p: (n) */
    double *steps, *gains;            /* s, c: (BROYDEN_PAIRS, n+1) */
    double *residual, *step, *answer; /* r: (n), and room for n+1 numbers each */
} broyden;

enum {
    BROYDEN_PAIRS = 32,
    BROYDEN_MOST = 16 /* iterations of a solution */
};

/* z += s until sqrt(weight) |r| <= tolerance, with the J and F_p of the point evaluated last; 0
 * where that takes too long. taken: iterations, counted on. */
int solve_by_former(equations *at, broyden *by, double *z, double tolerance, int *taken);
/* F(z) = 0 by Newton's method with such steps; returns and takes what solve_in_plane in path.h
 * does. No pairs are known before; work: iterations of all steps, counted on. */
int correct_by_former(equations *at, broyden *by, double *z, double tolerance, int iterations,
                      double reach, int *taken, int *work);

#endif
