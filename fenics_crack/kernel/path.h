/* Corrections along a path of equations, and the path itself. */
#ifndef PATH_H
#define PATH_H

#include "equations.h"

/* What is done and why is said in fenics_crack/numerics/bordered.py and path.py. A point of a path has n unknowns, a parameter and
 * a unit tangent (t_x, t_p) in the norm weight |x|^2 + p^2.
 */

/* Of Newton's method: |F| / |x| of the solution, how far the parameter may go, and how much a step
 * may be shortened (below 0: not at all); steps, and those that may together fail to halve the
 * residual (0: any number; else at most 30). */
typedef struct {
    double tolerance, reach, least_damping;
    int iterations, patience;
} correction;

/* What is orthogonal to a tangent (t_x, t_p). */
typedef struct {
    const double *across;
    double slope, weight;
} plane;

/* Newton's method in a plane, or where this is NULL at a given parameter. unknown, parameter: the
 * guess, and the point found; taken: iterations. Returns FOUND, or why not. */
int solve_in_plane(equations *at, const plane *in, const correction *how, double *unknown,
                   double *parameter, int *taken);

typedef struct {
    double longest, shortest, least_cosine, rounding;
    double lowest, highest; /* parameters between which a call goes on */
    correction newton;      /* its reach in steps; short ones are corrected more sharply */
} stepping;

/* A path's points one after the other: (room, n), (room), ..., of which `known` are known, the last
 * one or two of them with their tangents. */
typedef struct {
    int room, known;
    double *unknowns, *parameters, *tangents, *slopes, *weights, *lengths;
    int *iterations;
    signed char *crossings; /* whether another branch crosses before the point */
    double step, orientation; /* sign of t_p det J along the path; 0: not asked for yet */
} path;

/* From 100 unknowns on points share LU factors (broyden.h): J is factored where this has become
 * slow, where the path may turn, and at the last point of a call. There the sign of its determinant
 * is compared with the path's; where it has changed the points since are followed again, each with
 * factors of its own.
 *
 * Follow the path until there is no more room or the parameter leaves its range. Returns FOUND,
 * or why it ended before: NOT_FOUND where steps would be too short. */
int follow(equations *at, const stepping *how, path *points);

/* The point between two, the first rows of `ends` (3 rows), where the parameter turns back, or
 * unless NULL where it is a target, to a distance how->shortest, by at most so many points; its row
 * is then ends->known. Returns FOUND, or why not. */
int find_between(equations *at, const stepping *how, int most, const double *target, path *ends);

#endif
