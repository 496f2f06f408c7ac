/* When which pairs are closed over a period, for contact that couples the pairs. */
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
    int cells, max_events, n_waves; /* columns: 2H+1 */
    const double *gaps;       /* (2H+1, p) s_j */
    waves *waves;             /* of H harmonics where cells begin */
    double tolerance;         /* penetration that counts as none */
    signed char *first_set;   /* (p) the set at phase zero */
    double *stiffness;        /* (p, p) its S, zero outside */
    double *theta;            /* (most) phase of each event, ascending */
    int *event_pairs;         /* (most) who opens or closes there */
    double *vectors;          /* (most, p) v, */
    double *gains;            /* (most) by which S changes there: S += gain v v^T */
    double *work;             /* as many numbers as interval_work_size says */
} breathing_pairs;

/* Cells for H harmonics: 16 and more to the shortest wave, and in the period 4 and more to every
 * pair: few events in a cell. Of 1,500 random waves of 2 to 39 pairs, 4 and 128 cells to a pair give
 * the same events. */
int interval_cells(int harmonics, int pairs);
/* Returns the number of events, -1 where that is more than `most`, or -2 where an instant has no
 * forces. */
int find_intervals(breathing_pairs *m);
long interval_work_size(int pairs, int harmonics, int cells);

#endif
