/* Friction of waves of gaps, by alternating between frequency and time (AFT) with memory. */
#ifndef FRICTION_WAVES_H
#define FRICTION_WAVES_H

#include "closed_sets.h"

/* Of gaps s at `count` instants of a period (count, r), r = 2 p, marched from places h (p), which
 * are others behind, until the places repeat, through `turns` periods at most: forces lambda (count, r), states (count, p) of
 * the pairs, and places (count, p), of the last period. 0, or 1 where an instant has no forces. */
int march_friction(closed_sets *s, int count, int turns, const double *gaps, double *held,
                   double *forces, signed char *states, double *places);
/* What changes ds (count, r) of the gaps change of the forces, (count, r), through the states of a
 * march; dh = start (p) of pairs that stick at all instants. 0, or 1 without memory. */
int friction_changes(closed_sets *s, int count, const signed char *states, const double *gaps,
                     const double *start, double *forces);
/* The derivative of the coefficients of U^T lambda, rows a_0, a_1, b_1, ... of `rows` waves, by those
 * of changes U c of the gaps, U (r, n): tangent (rows n, rows n), both ordered (row, column of U).
 * Through the states of a march (count, p), of which h is known from its last but one period on:
 *
 *     d lambda = L (ds - dh),     dh = dg_t of pairs that do not stick,
 *
 * and dh = dg_t at the first instant of those that always stick.
 *
 * waves, means (count, rows): values of the waves, and what makes coefficients of values. 0, or 1
 * without memory. */
int friction_tangent(closed_sets *s, int count, const signed char *states, int rows,
                     const double *waves, const double *means, int n, const double *basis,
                     double *tangent);

#endif
