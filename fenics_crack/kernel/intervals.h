/* When which pairs are closed over a period, for contact that couples the pairs. */
#ifndef INTERVALS_H
#define INTERVALS_H

#include "sets.h"

/* Waves s (p) of H harmonics, s(theta) = Re sum_k S_k exp(i k theta), on `cells` equal cells of the
 * period, so short that Taylor polynomials about their middles are the waves to rounding.
 *
 * Between two events the set A of closed pairs stays, and with it answer_of(A) s: the forces of the
 * closed pairs and the openings of the others. An event is the first root of one of these. A cell
 * is searched where the sets at its ends differ, or where two tangents meet below zero; in it the
 * first root is bracketed on a few points and on the minima between them; behind it the set differs
 * by one pair; and so on to the cell's end, where the set of the next instant is taken if it is
 * another one.
 *
 * harmonics: (H + 1, p) complex, real and imaginary parts in turns. values, rates: (cells, p), s and
 * its change per cell by its slope. theta: (most), closed: (most, p): where each interval begins,
 * the first at 0, and its set. work: as many numbers as intervals_room says. Returns the number of
 * intervals, -1 where that is more than `most`, or -2 where an instant has no forces.
 */
int intervals(sets *contact, int pairs, int highest, int cells, const double *harmonics,
              const double *values, const double *rates, double allowed, int most, double *theta,
              signed char *closed, double *work);
long intervals_room(int pairs);

#endif
