/* A path of equations, and what lies between two of its points. */
#ifndef PATH_H
#define PATH_H

#include "bordered.h"

/* The method: fenics_crack/numerics/path.py. A point of a path has n unknowns, a parameter and a
 * unit tangent (t_x, t_p) in its norm. */

typedef struct {
    double max_step, min_step, min_cosine, rounding;
    double min_parameter, max_parameter; /* a call ends outside of these */
    correction correction; /* its max_parameter_change is in steps; short steps have a smaller
                            * tolerance */
} stepping;

/* Points of a path: (capacity, n), (capacity), ... The first `n_known` are known, the last one or
 * two of them with tangents. */
typedef struct {
    int capacity, n_known;
    double *unknowns, *parameters, *unknown_tangents, *parameter_tangents; /* x, p, t_x, t_p */
    double *unknowns_weights, *time_mean_weights; /* of the norm */
    double *chord_lengths;                        /* from the point before */
    int *iterations;
    signed char *crosses_branch; /* whether another branch crosses before the point */
    double *records; /* (capacity, equations.n_record_entries), or NULL: not kept */
    double step, orientation; /* sign of t_p det J along the path; 0: not asked for yet */
} path;

/* Follow the path until its arrays are full or the parameter leaves its range. Returns FOUND or a
 * reason of failure: NOT_FOUND if steps would be too short.
 *
 * If solutions take products with J, the sign of det J is compared with the path's only at every
 * eighth point and the last one of a call. If it differs, the points since the last check are
 * followed again, with a check at each. */
int follow_path(equations *system, const stepping *options, path *points);

/* Find the point between the first two of `ends` (3 rows) at which the parameter turns back, or
 * (target not NULL) is equal to the target, up to a distance min_step. Its row is then
 * ends->n_known. Returns FOUND or a reason of failure. */
int find_point_between(equations *system, const stepping *options, const double *target,
                       path *ends);

#endif
