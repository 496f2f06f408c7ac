/* What rounding is taken for, and what makes it large. */
#ifndef ROUNDING_H
#define ROUNDING_H

/* Relative to what it is the rest of: what counts as zero of sums. Of the largest gap: excursions
 * below are none. */
static const double ZERO_TOLERANCE = 1e-14;
/* What solutions leave of zero, relative to the largest: an answer to gaps with a larger error is
 * computed anew, and a diagonal so small beside that of the compliance is 0; of a piece of the flow:
 * the least time. */
static const double ROUNDING = 1e-12;

/* Smallest of a positive definite matrix's eigenvalues, relative to the largest, with which a small
 * residual shows that the error is small; of a compliance: what is softer by as much is rigid. */
static const double REGULAR_EIGENVALUE_RATIO = 1e-6;

#endif
