/* Fourier coefficients of contact forces that follow from the gaps of all pairs, lambda(s). */
#ifndef COUPLED_FORCES_H
#define COUPLED_FORCES_H

/* lambda = S s, with the stiffness S of the set of closed pairs (intervals.h), a matrix that jumps
 * by gain v v^T at each event. The coefficients b of lambda for waves s of H harmonics, and T = db/ds,
 * need no more of S than its harmonics up to 2H. So a product with T is: s, or a change of it, to N
 * > 4H instants, times S cut off, and back.
 */
typedef struct coupled_forces coupled_forces;

/* NULL without memory. */
coupled_forces *new_coupled_forces(int harmonics, int pairs);
void free_coupled_forces(coupled_forces *self);
/* Find b (2H+1, p) of waves s (2H+1, p) under the compliance D (p, p). Returns FOUND, NOT_FOUND if
 * an instant has no forces, or NO_MEMORY. */
int find_forces(coupled_forces *self, const double *compliance, const double *gap, double *force);
/* Set T ds of a change ds (2H+1, p), with T at the forces found last. */
void forces_by_gap(coupled_forces *self, const double *change, double *force_change_out);
/* Set the derivative of b if the diagonal of D grows by rate (p): the coefficients of -S diag(rate)
 * S s. */
void forces_by_compliance(coupled_forces *self, const double *rate, double *force_rate_out);
/* Set the means c_m + i s_m of U^T S U exp(i m theta) over the period, m = 0 to 2H, with U (p, q);
 * without a basis (NULL), of S with q = p. Rows c_0, c_1, s_1, ...: (4H+1, q, q). Returns 0, or 1
 * without memory. */
int means_of_stiffness(const coupled_forces *self, const double *basis, int q, double *means);
/* Set the rows of T of harmonic k from these means: (q or 2 q, n) for unknowns ordered (row, q). */
void tangent_of_harmonic(int harmonics, int q, int k, const double *means, double *tangent_out);

#endif
