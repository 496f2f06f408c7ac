/* Newton's method bordered by a plane, and tangents: fenics_crack/numerics/newton.py. */
#ifndef BORDERED_H
#define BORDERED_H

#include "equations.h"

/* Of Newton's method: |F| / |x| of the solution, how far the parameter may go, and how much a step
 * may be shortened (below 0: not at all); steps, and those that may together fail to halve the
 * residual (0: any number; else at most 30). */
typedef struct {
    double tolerance, max_parameter_change, min_damping;
    int max_iterations, max_stalled_steps;
} correction;

/* How changes are measured beside a solution: weight times their square, of which that of means
 * counts so much. */
typedef struct {
    double weight, mean_weight;
} norm;

/* What is orthogonal to a tangent (t_x, t_p). */
typedef struct {
    const double *normal;
    double slope;
    norm metric;
} plane;

/* Relative residual of other solutions with J that take products. */
extern const double SOLUTION_TOLERANCE;

/* Newton's method in a plane, or where this is NULL at a given parameter. unknown, parameter: the
 * guess, and the point found; taken: iterations. Returns FOUND, or why not. */
int solve_in_plane(equations *system, const plane *border, const correction *options,
                   double *unknown, double *parameter, int *n_iterations);
/* The same with room for F, dx and J^-1 F_p: (3, n). */
int correct_in_plane(equations *system, const plane *border, const correction *options, double *x,
                     double *p, int *n_iterations, double *work);

/* Of a solution x: its size is that of what moves, to which its means contribute no more than all
 * else; and where they are larger they change by parts of themselves. */
norm norm_of_solution(const equations *system, const double *x);
/* <x, y> in a norm. */
double product(const equations *system, norm metric, const double *x, const double *y);
/* x += s y; the opposite direction. */
void add_scaled(int n, double *x, double s, const double *y);
void reverse_tangent(int n, double *tangent, double *slope);
/* The unit tangent towards growing p at a point that has been evaluated, and its norm; its slope
 * t_p. */
double unit_tangent(equations *system, int n, const double *x, double *tangent, norm *metric);

#endif
