/* Newton's method in a plane, and tangents of a path: fenics_crack/numerics/newton.py. */
#ifndef BORDERED_H
#define BORDERED_H

#include "equations.h"

/* Options of Newton's method. `tolerance`: |F| / |x| of the solution. `max_parameter_change`: from
 * the guess. `min_damping`: shortest fraction of a step; below 0 every step is full.
 * `max_stalled_steps`: steps that may fail to halve the residual together, at most 30; 0: any
 * number. */
typedef struct {
    double tolerance, max_parameter_change, min_damping;
    int max_iterations, max_stalled_steps;
} correction;

/* Squared norm of a change at a solution:
 * weight (|x_oscillating|^2 + time_mean_weight |x_means|^2). */
typedef struct {
    double weight, time_mean_weight;
} norm;

/* Plane orthogonal to a tangent (t_x, t_p): normal t_x, slope t_p. */
typedef struct {
    const double *normal;
    double slope;
    norm metric;
} plane;

/* Relative residual of solutions with J by products, except for Newton's steps. */
extern const double SOLUTION_TOLERANCE;

/* Run Newton's method in a plane or, without a border (NULL), at a given parameter. unknown,
 * parameter: the guess, then the point found; n_iterations: steps taken. Returns FOUND or the
 * reason of the failure. */
int solve_in_plane(equations *system, const plane *border, const correction *options,
                   double *unknown, double *parameter, int *n_iterations);
/* Do the same with work space (3, n) for F, dx and J^-1 F_p. */
int correct_in_plane(equations *system, const plane *border, const correction *options, double *x,
                     double *p, int *n_iterations, double *work);

/* Return the norm at a solution x. Its size is that of the oscillation; the means add at most as
 * much again. If the means are larger, their weight falls accordingly. */
norm norm_of_solution(const equations *system, const double *x);
/* Return <x, y> in a norm. */
double product(const equations *system, norm metric, const double *x, const double *y);
/* Set x += s y; reverse a tangent. */
void add_scaled(int n, double *x, double s, const double *y);
void reverse_tangent(int n, double *tangent, double *slope);
/* Set the unit tangent towards growing p at the point evaluated last, and its norm. Return t_p. */
double unit_tangent(equations *system, int n, const double *x, double *tangent, norm *metric);

#endif
