#include "bordered.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

enum { MAX_STALLED_STEPS = 32 };
#define NEWTON_STEP_TOLERANCE 1e-4 /* residual of a step of Newton's method that is found with products */
const double SOLUTION_TOLERANCE = 1e-9;

/* x^T y from an entry on. */
static double inner_product(const equations *at, int first, const double *x, const double *y)
{
    double sum = 0.0;
    for (int i = first; i < at->unknowns; i++) sum += x[i] * y[i];
    return sum;
}

norm norm_of_solution(const equations *at, const double *x)
{
    const double whole = inner_product(at, 0, x, x);
    double means = 0.0;
    for (int i = 0; i < at->means; i++) means += x[i] * x[i];
    const double moving = fmax(whole - means, sqrt(DBL_EPSILON) * whole);
    const double square = fmax(moving + fmin(means, moving), 1e-300);
    return (norm){1.0 / square, means > moving ? moving / means : 1.0};
}

double product(const equations *at, norm in, const double *x, const double *y)
{
    if (in.mean_weight == 1.0) return in.weight * inner_product(at, 0, x, y);
    double means = 0.0;
    for (int i = 0; i < at->means; i++) means += x[i] * y[i];
    return in.weight * (inner_product(at, at->means, x, y) + in.mean_weight * means);
}

void add_scaled(int n, double *x, double s, const double *y)
{
    for (int i = 0; i < n; i++) x[i] += s * y[i];
}

/* -J^-1 dF/dp. */
static void slope_at(equations *at, int n, double sharp, double *slope)
{
    at->by_parameter(at, slope);
    at->solve_tolerance = sharp;
    at->solve(at, slope);
    for (int i = 0; i < n; i++) slope[i] = -slope[i];
}

double unit_tangent(equations *at, int n, const double *x, double *tangent, norm *own)
{
    slope_at(at, n, SOLUTION_TOLERANCE, tangent);
    *own = norm_of_solution(at, x);
    const double slope = 1.0 / sqrt(product(at, *own, tangent, tangent) + 1.0);
    for (int i = 0; i < n; i++) tangent[i] *= slope;
    return slope;
}

void reverse_tangent(int n, double *tangent, double *slope)
{
    for (int i = 0; i < n; i++) tangent[i] = -tangent[i];
    *slope = -*slope;
}

int correct_in_plane(equations *at, const plane *in, const correction *how, double *x, double *p,
                     int *taken, double *room)
{
    const int n = at->unknowns, stall = how->max_stalled_steps;
    double *F = room, *change = room + n, *rate = change + n;
    const double guess = *p;
    double shift = 0.0, damping = 1.0, before = INFINITY;
    double sizes[MAX_STALLED_STEPS], smallest = INFINITY; /* of the steps before the last `stall` */
    *taken = 0;
    for (int i = 0; i < 4 * how->max_iterations; i++) {
        const int outcome = at->evaluate(at, x, *p);
        if (outcome != FOUND) return outcome;
        at->residual(at, F);
        const double square = inner_product(at, 0, F, F);
        const double own = in ? in->metric.weight : 1.0 / fmax(inner_product(at, 0, x, x), 1e-300);
        const double size = sqrt(own * square);
        if (size <= how->tolerance) return FOUND;
        if (!isfinite(size)) return NOT_FOUND;
        if (how->min_damping >= 0.0 && !(size < before)) { /* a shorter step */
            damping *= 0.5;
            if (damping < how->min_damping) return NOT_FOUND;
            add_scaled(n, x, -damping, change), *p -= damping * shift;
            continue;
        }
        if (stall) {
            sizes[*taken % MAX_STALLED_STEPS] = size;
            if (*taken >= stall) smallest = fmin(smallest, sizes[(*taken - stall) % MAX_STALLED_STEPS]);
        }
        if (*taken == how->max_iterations || 0.5 * smallest < size) return NOT_FOUND;
        /* (dx, dp) = (a + dp b, dp), J a = -F, J b = -F_p, dp = -w <t_x, a> / (w <t_x, b> + t_p) */
        for (int j = 0; j < n; j++) change[j] = -F[j];
        at->solve_tolerance = NEWTON_STEP_TOLERANCE;
        at->solve(at, change);
        shift = 0.0;
        if (in) {
            slope_at(at, n, NEWTON_STEP_TOLERANCE, rate);
            const double along = product(at, in->metric, in->normal, rate) + in->slope;
            const double off = product(at, in->metric, in->normal, change);
            shift = -off / (along + 1e-300); /* not 0 */
            add_scaled(n, change, shift, rate);
            if (!(fabs(*p + shift - guess) <= how->max_parameter_change))
                return NOT_FOUND; /* another branch, or none */
        }
        damping = 1.0, before = size;
        ++*taken;
        add_scaled(n, x, 1.0, change), *p += shift;
    }
    return NOT_FOUND;
}

int solve_in_plane(equations *at, const plane *in, const correction *how, double *unknown,
                   double *parameter, int *taken)
{
    double *room = malloc(3 * (size_t)at->unknowns * sizeof(double));
    const int outcome =
        room ? correct_in_plane(at, in, how, unknown, parameter, taken, room) : NO_MEMORY;
    free(room);
    return outcome;
}
