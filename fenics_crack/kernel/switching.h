/* Switching instants of gaps, and the exact integrals of their contact forces between them. */
#ifndef SWITCHING_H
#define SWITCHING_H

/* Gaps are coefficients (2H+1, pairs) in C's order, rows a0, a1, b1, ..., aH, bH:
 *
 *     g(theta) = a0 + sum_k a_k cos(k theta) + b_k sin(k theta),      theta in [0, 2 pi].
 */

/* Return the number of cells of the first grid, a multiple of 4. */
int switching_cells(int harmonics);
/* Set the waves of the first grid: cos(k theta), sin(k theta) for k = 1 to H at the instants of the
 * first quarter of the period, (H, 2, cells / 4 + 1). */
void switching_waves(int harmonics, double *waves);

/* Find all sign changes of the gap of one pair, in order. theta (capacity): phases; closing
 * (capacity): +1 if the gap becomes positive, else -1; closed: whether the gap is positive at 0.
 * Returns their number, of which at most `capacity` are written, or -1 without memory. */
int switching_instants(int harmonics, int pairs, const double *gap, const double *waves,
                       int capacity, double *theta, double *closing, signed char *closed);

/* Set the coefficients of the forces k max(g, 0), (2H+1, pairs), and their derivatives by the gap's
 * coefficients, (pairs, 2H+1, 2H+1). stiffness: (pairs); means: work space for (pairs, 2H+1)
 * complex numbers. Returns -1 without memory. */
int contact_integrals(int harmonics, int pairs, const double *gap, const double *stiffness,
                      const double *waves, double *means, double *force, double *tangent);

#endif
