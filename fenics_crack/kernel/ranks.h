/* The contact's tangent by what it has of a rank, and the small matrix that follows from that. */
#ifndef RANKS_H
#define RANKS_H

/* Pairs that are closed for a part of the period only have a T of low rank. With the weights of waves,
 * E = diag(sqrt(2), 1, ..., 1), it is symmetric and, where the force does not fall, semidefinite:
 * E T E^-1 = C C^T by Cholesky's method, the largest pivot first. r: columns of C of all pairs.
 *
 * E commutes with R, so that T = P Q, P = E^-1 C, Q = C^T E makes Q R P = C^T R C.
 */

/* C^T (r, 2H+1), pair by pair, with room for (2H+1) pairs rows, of T (pairs, 2H+1, 2H+1); ranks: how
 * many each pair has. Pivots below `tolerance` times the first of a pair are left out. Room:
 * (2H+1)^2 numbers. Returns r, or -1 where for some pair the trace of the rest is more than `lost`
 * times that pivot: not such a matrix. */
int tangent_rows(int harmonics, int pairs, const double *tangent, double tolerance, double lost,
                 int *ranks, double *rows, double *room);
/* I + C^T R C (r, r) from C^T, C (2H+1, r) and R (H+1, pairs, pairs), complex; room: (2H+1) r. */
void small_matrix(int harmonics, int pairs, const int *ranks, const double *rows,
                  const double *columns, const double *compliance, double *room, double *found);

#endif
