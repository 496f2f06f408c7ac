/* A path of equations, and what lies between two of its points. */
#ifndef PATH_H
#define PATH_H

#include "bordered.h"

/* What is done and why is said in fenics_crack/numerics/path.py. A point of a path has n unknowns, a
 * parameter and a unit tangent (t_x, t_p), of x in its norm. */

typedef struct {
    double max_step, min_step, min_cosine, rounding;
    double min_parameter, max_parameter; /* parameters between which a call goes on */
    correction correction; /* its reach in steps; short ones are corrected more sharply */
} stepping;

/* A path's points one after the other: (room, n), (room), ..., of which `known` are known, the last
 * one or two of them with their tangents. */
typedef struct {
    int capacity, n_known;
    double *unknowns, *parameters, *tangents, *slopes, *weights, *mean_weights, *lengths;
    int *iterations;
    signed char *crossings; /* whether another branch crosses before the point */
    double *records; /* (room, equations.records), or NULL: not kept */
    double step, orientation; /* sign of t_p det J along the path; 0: not asked for yet */
} path;

/* Where solutions take products with J the sign of its determinant is compared with the path's at
 * every eighth point and the last one of a call; where it has changed the points since are followed
 * again, each with its own.
 *
 * Follow the path until there is no more room or the parameter leaves its range. Returns FOUND,
 * or why it ended before: NOT_FOUND where steps would be too short. */
int follow_path(equations *system, const stepping *options, path *points);

/* The point between two, the first rows of `ends` (3 rows), where the parameter turns back, or
 * unless NULL where it is a target, to a distance how->shortest; its row is then ends->known. Returns
 * FOUND, or why not. */
int find_point_between(equations *system, const stepping *options, const double *target,
                       path *ends);

#endif
