/* Tolerances of rounding, and what makes it large. */
#ifndef ROUNDING_H
#define ROUNDING_H

/* Zero of a sum, relative to its terms. Also, relative to the largest gap: excursions of a gap that
 * are ignored. */
static const double ZERO_TOLERANCE = 1e-14;
/* Residual of a solution, relative to the largest entry. An answer to gaps with a larger error is
 * computed anew; a diagonal that small, relative to that of the compliance, is 0. Also the shortest
 * time, relative to a piece of the flow. */
static const double ROUNDING = 1e-12;

/* Smallest eigenvalue of a positive definite matrix, relative to the largest one, with which a
 * small residual proves a small error. Also of a compliance: relative softness that counts as
 * rigid. */
static const double REGULAR_EIGENVALUE_RATIO = 1e-6;

#endif
