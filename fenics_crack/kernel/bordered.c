#include "bordered.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

enum { MAX_STALLED_STEPS = 32 };
#define NEWTON_STEP_TOLERANCE                                                                      \
    1e-4 /* relative residual of a Newton step by products with J */
const double SOLUTION_TOLERANCE = 1e-9;

/* Return x^T y from one entry on. */
static double inner_product(const equations *system, int first, const double *x, const double *y)
{
    double sum = 0.0;
    for (int i = first; i < system->unknowns; i++) sum += x[i] * y[i];
    return sum;
}

norm norm_of_solution(const equations *system, const double *x)
{
    const double size_squared = inner_product(system, 0, x, x);
    double means = 0.0;
    for (int i = 0; i < system->means; i++) means += x[i] * x[i];
    const double oscillation = fmax(size_squared - means, sqrt(DBL_EPSILON) * size_squared);
    const double square = fmax(oscillation + fmin(means, oscillation), 1e-300);
    return (norm){1.0 / square, means > oscillation ? oscillation / means : 1.0};
}

double product(const equations *system, norm metric, const double *x, const double *y)
{
    if (metric.time_mean_weight == 1.0) return metric.weight * inner_product(system, 0, x, y);
    double means = 0.0;
    for (int i = 0; i < system->means; i++) means += x[i] * y[i];
    return metric.weight *
           (inner_product(system, system->means, x, y) + metric.time_mean_weight * means);
}

void add_scaled(int n, double *x, double s, const double *y)
{
    for (int i = 0; i < n; i++) x[i] += s * y[i];
}

/* Set the derivative of the solution by the parameter, -J^-1 dF/dp. */
static void solution_rate(equations *system, int n, double tolerance, double *derivative_out)
{
    system->by_parameter(system, derivative_out);
    system->solve_tolerance = tolerance;
    system->solve(system, derivative_out);
    for (int i = 0; i < n; i++) derivative_out[i] = -derivative_out[i];
}

double unit_tangent(equations *system, int n, const double *x, double *tangent, norm *metric)
{
    solution_rate(system, n, SOLUTION_TOLERANCE, tangent);
    *metric = norm_of_solution(system, x);
    const double slope = 1.0 / sqrt(product(system, *metric, tangent, tangent) + 1.0);
    for (int i = 0; i < n; i++) tangent[i] *= slope;
    return slope;
}

void reverse_tangent(int n, double *tangent, double *slope)
{
    for (int i = 0; i < n; i++) tangent[i] = -tangent[i];
    *slope = -*slope;
}

int correct_in_plane(equations *system, const plane *border, const correction *options, double *x,
                     double *p, int *n_iterations, double *work)
{
    const int n = system->unknowns, stall = options->max_stalled_steps;
    double *F = work, *change = work + n, *rate = change + n;
    const double guess = *p;
    double parameter_change = 0.0, damping = 1.0, last_size = INFINITY;
    double sizes[MAX_STALLED_STEPS], smallest = INFINITY; /* residuals, and the smallest one before
                                                           * the last `stall` steps */
    *n_iterations = 0;
    for (int i = 0; i < 4 * options->max_iterations; i++) {
        const int outcome = system->evaluate(system, x, *p);
        if (outcome != FOUND) return outcome;
        system->residual(system, F);
        const double square = inner_product(system, 0, F, F);
        const double weight =
            border ? border->metric.weight : 1.0 / fmax(inner_product(system, 0, x, x), 1e-300);
        const double size = sqrt(weight * square);
        if (size <= options->tolerance) return FOUND;
        if (!isfinite(size)) return NOT_FOUND;
        if (options->min_damping >= 0.0 && !(size < last_size)) { /* a shorter step */
            damping *= 0.5;
            if (damping < options->min_damping) return NOT_FOUND;
            add_scaled(n, x, -damping, change), *p -= damping * parameter_change;
            continue;
        }
        if (stall) {
            sizes[*n_iterations % MAX_STALLED_STEPS] = size;
            if (*n_iterations >= stall)
                smallest = fmin(smallest, sizes[(*n_iterations - stall) % MAX_STALLED_STEPS]);
        }
        if (*n_iterations == options->max_iterations || 0.5 * smallest < size) return NOT_FOUND;
        /* (dx, dp) = (a + dp b, dp), J a = -F, J b = -F_p, dp = -w <t_x, a> / (w <t_x, b> + t_p) */
        for (int j = 0; j < n; j++) change[j] = -F[j];
        system->solve_tolerance = NEWTON_STEP_TOLERANCE;
        system->solve(system, change);
        parameter_change = 0.0;
        if (border) {
            solution_rate(system, n, NEWTON_STEP_TOLERANCE, rate);
            const double normal_rate =
                product(system, border->metric, border->normal, rate) + border->slope;
            const double distance = product(system, border->metric, border->normal, change);
            parameter_change = -distance / (normal_rate + 1e-300); /* not 0 */
            add_scaled(n, change, parameter_change, rate);
            if (!(fabs(*p + parameter_change - guess) <= options->max_parameter_change))
                return NOT_FOUND; /* another branch, or none */
        }
        damping = 1.0, last_size = size;
        ++*n_iterations;
        add_scaled(n, x, 1.0, change), *p += parameter_change;
    }
    return NOT_FOUND;
}

int solve_in_plane(equations *system, const plane *border, const correction *options,
                   double *unknown, double *parameter, int *n_iterations)
{
    double *work = malloc(3 * (size_t)system->unknowns * sizeof(double));
    const int outcome =
        work ? correct_in_plane(system, border, options, unknown, parameter, n_iterations, work)
             : NO_MEMORY;
    free(work);
    return outcome;
}
