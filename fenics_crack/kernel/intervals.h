/* Closed pairs over a period, if contact couples the pairs. */
#ifndef INTERVALS_H
#define INTERVALS_H

#include "pivots.h"
#include "waves.h"

/* Gaps s(theta) = sum_j w_j(theta) s_j with the waves w = 1, cos theta, sin theta, cos 2 theta, ...
 * of H harmonics are followed through `cells` equal cells of the period, so short that Taylor
 * polynomials about their middles are the waves to rounding.
 *
 * Where waves are fewer than pairs, the answers to the s_j are carried from set to set, and those to
 * s are their sums; else those to s are found anew.
 *
 * Between two events the set A of closed pairs stays, and with it the answers X (pivots.h), the
 * forces of the closed pairs and, less than nothing, the openings of the others. An event is the
 * first root of one of these. A cell is searched where a sign is wrong at its end, or where two
 * tangents meet on the wrong side of zero; in it the first root is bracketed on a few points and on
 * the minima between them; behind it the set differs by one pair, and each answer by a part of rank
 * one; and so on to the cell's end, where a set that is wrong is turned into the right one.
 */
typedef struct {
    pivot_table contact;
    int cells, max_events, n_waves; /* n_waves: 2H+1 */
    const double *gaps;       /* (2H+1, p) s_j */
    waves *waves;             /* of H harmonics, at the starts of cells */
    double tolerance;         /* largest gap that does not count as penetration */
    signed char *first_set;   /* (p) closed pairs at phase zero */
    double *stiffness;        /* (p, p) S of this set, zero outside */
    double *theta;            /* (max_events) phases, ascending */
    int *event_pairs;         /* (max_events) pair that opens or closes */
    double *vectors;          /* (max_events, p) v and */
    double *gains;            /* (max_events) gain of S += gain v v^T */
    double *work;             /* interval_work_size() numbers */
} breathing_pairs;

/* Return the number of cells for H harmonics: at least 16 for the shortest wave, and 4 in the
 * period for every pair, so that a cell has few events. For 1,500 random waves of 2 to 39 pairs, 4
 * and 128 cells for a pair give the same events. */
int interval_cells(int harmonics, int pairs);
/* Find all events. Returns their number, -1 if it exceeds `max_events`, or -2 if an instant has no
 * forces. */
int find_intervals(breathing_pairs *m);
long interval_work_size(int pairs, int harmonics, int cells);

#endif
