/* Friction of waves of gaps, by alternating between frequency and time (AFT) with memory. */
#ifndef FRICTION_WAVES_H
#define FRICTION_WAVES_H

#include "closed_sets.h"

/* March through gaps s at `count` instants of a period (count, r), r = 2 p, from places h (p),
 * which are updated, until the places repeat, through `max_periods` periods at most. Sets the
 * forces lambda (count, r), the states of the pairs (count, p) and their places (count, p) in the
 * last period; and origins (p), the last instants at which pairs did not stick, or 0. Returns 0, or
 * 1 if an instant has no forces. */
int march_friction(closed_sets *s, int count, int max_periods, const double *gaps,
                   double *stick_places, double *forces, signed char *states, double *places,
                   int *origins);
/* Set the changes (count, r) of the forces due to changes ds (count, r) of the gaps, through the
 * states of a march. A pair that always sticks has dh = ds at its origin. Returns 0, or 1 without
 * memory. */
int friction_changes(closed_sets *s, int count, const signed char *states, const int *origins,
                     const double *gaps, double *forces);
/* The derivative of the coefficients of U^T lambda, rows a_0, a_1, b_1, ... of `rows` waves, by those
 * of changes U c of the gaps, U (r, n): tangent (rows n, rows n), both ordered (row, column of U).
 * Through the states of a march (count, p), of which h is known from its last but one period on:
 *
 *     d lambda = L (ds - dh),     dh = dg_t of pairs that do not stick,
 *
 * and dh = dg_t at its origin, where it may have slipped by a limit that is taken as fixed, of a
 * pair that always sticks.
 *
 * waves, means (count, rows): values of the waves, and what makes coefficients of values. 0, or 1
 * without memory. */
int friction_tangent(closed_sets *s, int count, const signed char *states, const int *origins,
                     int rows, const double *waves, const double *means, int n, const double *basis,
                     double *tangent);

#endif
