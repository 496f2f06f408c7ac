#include "path.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    SIGN_LOST = FAILED + 1, /* points have the other sign of det J */
    /* points without a check: two crossings within are missed */
    MAX_UNCHECKED_POINTS = 8
};
/* Fractions of the longest step. Within LOCAL_STEP_RATIO, a path that changes its sign straight on
 * crosses a branch, and a corner is passed. CORNER_STEP_RATIO: shortest step around a corner. */
#define LOCAL_STEP_RATIO 1e-2
#define CORNER_STEP_RATIO 1e-7

/* Return the norm of a point's tangent. */
static norm metric_at(const path *points, int place)
{
    return (norm){points->unknowns_weights[place], points->time_mean_weights[place]};
}

/* Add the quadratic and cubic terms of Hermite's polynomial through the last two points, in the
 * distance along the last tangent; none if they could not help. */
static void add_curvature(const equations *system, const path *points, double step, double *x,
                          double *p, double *work)
{
    if (points->n_known < 2) return;
    const int n = system->unknowns, last = points->n_known - 1;
    const double *point = points->unknowns + (size_t)last * n, *previous_point = point - n;
    const double *tangent = points->unknown_tangents + (size_t)last * n,
                 *previous_tangent = tangent - n;
    const double slope = points->parameter_tangents[last],
                 previous_slope = points->parameter_tangents[last - 1];
    const norm metric = metric_at(points, last);
    const double parameter_change = points->parameters[last] - points->parameters[last - 1];
    for (int i = 0; i < n; i++) work[i] = point[i] - previous_point[i];
    const double back_distance = product(system, metric, work, tangent) + parameter_change * slope;
    const double size = sqrt(product(system, metric, previous_tangent, previous_tangent) +
                             previous_slope * previous_slope);
    const double cosine =
        (product(system, metric, previous_tangent, tangent) + previous_slope * slope) / size;
    if (!(back_distance > 0.0 && cosine > 0.5)) return;
    /* x(s) = x + s t + s^2 A + s^2 (s + back) B, by divided differences with double nodes. */
    for (int i = 0; i <= n; i++) {
        const double end = i < n ? tangent[i] : slope,
                     start = i < n ? previous_tangent[i] : previous_slope;
        const double mean = (i < n ? work[i] : parameter_change) / back_distance,
                     second = (end - mean) / back_distance;
        const double third =
            (second - (mean - start / (size * cosine)) / back_distance) / back_distance;
        work[i] = step * step * (second + (step + back_distance) * third);
    }
    const double correction_squared = product(system, metric, work, work) + work[n] * work[n];
    if (correction_squared < 0.1 * step * step) add_scaled(n, x, 1.0, work), *p += work[n];
}

/* Checks of the sign of det J, which is expensive if solutions take products with J. If a check
 * fails, the points since the last check are followed again, each with its own. */
typedef struct {
    int last_checked; /* last point with a check, */
    double step; /* step after this point */
    int checked_end;  /* points before this one need a check */
    int n_iterations; /* iterations since the last point, too long steps included */
} sign_check;

/* Return the product of two directions for angles; the norm is that of z. */
static double direction_product(const equations *system, norm metric, const double *y, double y_p,
                                const double *z, double z_p)
{
    const double *weights = system->angle_weights;
    double sum = 0.0;
    if (!weights) return product(system, metric, y, z) + y_p * z_p;
    for (int i = 0; i < system->unknowns; i++) sum += weights[i] * y[i] * z[i];
    return metric.weight * sum + y_p * z_p;
}

/* Return the cosine of the angle between two directions. */
static double direction_cosine(const equations *system, norm metric, const double *y, double y_p,
                               const double *z, double z_p)
{
    const double product_of_squares = direction_product(system, metric, y, y_p, y, y_p) *
                                      direction_product(system, metric, z, z_p, z, z_p);
    return product_of_squares > 0.0
               ? direction_product(system, metric, y, y_p, z, z_p) / sqrt(product_of_squares)
               : 0.0;
}

/* Set the exact tangent at the point evaluated last; return its slope. The determinant of the
 * bordered matrix keeps its sign along a path: it shows the forward direction. If the sign is
 * unknown, the tangent with the smaller angle to the last one is taken. */
static double forward_tangent(equations *system, int n, double orientation, const double *x,
                              const double *last_tangent, double last_slope, double *tangent,
                              norm *metric)
{
    double slope = unit_tangent(system, n, x, tangent, metric);
    const double sign = isnan(orientation) ? NAN : system->sign(system);
    const int is_forward = isnan(sign) ? direction_product(system, *metric, tangent, slope,
                                                           last_tangent, last_slope) >= 0.0
                                       : sign == orientation;
    if (!is_forward) reverse_tangent(n, tangent, &slope);
    return slope;
}

/* Discard the points after the last check; return 0 if there are none. */
static int discard_unchecked(sign_check *check, path *points)
{
    if (check->last_checked == points->n_known - 1) return 0;
    check->checked_end = points->n_known, points->n_known = check->last_checked + 1,
    points->step = check->step;
    return 1;
}

/* Predict the next point x, p. */
static void predict(const equations *system, const path *points, double *x, double *p, double *work)
{
    const int n = system->unknowns, last = points->n_known - 1;
    memcpy(x, points->unknowns + (size_t)last * n, n * sizeof(double));
    add_scaled(n, x, points->step, points->unknown_tangents + (size_t)last * n);
    *p = points->parameters[last] + points->step * points->parameter_tangents[last];
    add_curvature(system, points, points->step, x, p, work);
}

/* Return the options of a correction after a step: the error must be far smaller than the step. */
static correction step_correction(const stepping *options, double step)
{
    correction correction_options = options->correction;
    correction_options.tolerance =
        fmax(options->rounding, fmin(correction_options.tolerance, 1e-4 * step));
    correction_options.max_parameter_change *= step;
    return correction_options;
}

/* Append a point whose unknowns and tangent are already in the arrays. */
static void append(equations *system, path *points, double p, double slope, norm metric,
                   int n_iterations, int crosses_branch, double *work)
{
    const int n = system->unknowns, next = points->n_known++;
    const double *x = points->unknowns + (size_t)next * n,
                 parameter_change = p - points->parameters[next - 1];
    for (int i = 0; i < n; i++) work[i] = x[i] - x[i - n];
    points->parameters[next] = p, points->parameter_tangents[next] = slope;
    points->unknowns_weights[next] = metric.weight;
    points->time_mean_weights[next] = metric.time_mean_weight;
    points->iterations[next] = n_iterations, points->crosses_branch[next] = crosses_branch;
    if (points->records)
        system->record(system, points->records + (size_t)next * system->n_record_entries);
    const double square = product(system, metric_at(points, next - 1), work, work);
    points->chord_lengths[next] = sqrt(square + parameter_change * parameter_change);
}

/* Pass a corner after the last point, which steps cannot resolve, as when stiff contact begins to
 * graze and J changes by orders of magnitude over the smallest distance. The path goes on along the
 * tangent just after the point. If the sign of det J is unknown, its opposite is tried as well,
 * unless this leads straight back. Returns FOUND, or NOT_FOUND if the path ends. */
static int pass_corner(equations *system, int n, const stepping *options, path *points,
                       sign_check *check, double *work)
{
    const int last = points->n_known - 1;
    const double *point = points->unknowns + (size_t)last * n;
    const double *last_tangent = points->unknown_tangents + (size_t)last * n,
                 last_slope = points->parameter_tangents[last];
    double *x = points->unknowns + (size_t)points->n_known * n;
    double *tangent = points->unknown_tangents + (size_t)points->n_known * n,
           *corner_tangent = work + 3 * (n + 1);
    double step = fmax(CORNER_STEP_RATIO * options->max_step, options->min_step);
    for (; step <= LOCAL_STEP_RATIO * options->max_step; step *= sqrt(10.0)) {
        double p = points->parameters[last] + step * last_slope;
        norm corner_metric, metric;
        memcpy(x, point, n * sizeof(double)), add_scaled(n, x, step, last_tangent);
        const int outcome = system->evaluate(system, x, p);
        check->n_iterations++;
        if (outcome != FOUND) return outcome;
        double corner_slope = forward_tangent(system, n, points->orientation, x, last_tangent,
                                              last_slope, corner_tangent, &corner_metric);
        const double corner_cosine =
            direction_cosine(system, metric_at(points, last), corner_tangent, corner_slope,
                             last_tangent, last_slope);
        const int has_two_ways = isnan(points->orientation) && corner_cosine < options->min_cosine;
        for (int way = 0; way <= has_two_ways;
             way++, reverse_tangent(n, corner_tangent, &corner_slope)) {
            int n_iterations;
            memcpy(x, point, n * sizeof(double)), add_scaled(n, x, step, corner_tangent);
            p = points->parameters[last] + step * corner_slope;
            const plane border = {corner_tangent, corner_slope, corner_metric};
            const correction correction_options = step_correction(options, step);
            const int correction_outcome =
                correct_in_plane(system, &border, &correction_options, x, &p, &n_iterations, work);
            check->n_iterations += n_iterations;
            if (correction_outcome != FOUND) continue;
            const double slope = forward_tangent(system, n, points->orientation, x, corner_tangent,
                                                 corner_slope, tangent, &metric);
            if (!(direction_cosine(system, corner_metric, tangent, slope, corner_tangent,
                                   corner_slope) > 0.5))
                continue;
            append(system, points, p, slope, metric, check->n_iterations, 0, work);
            points->step = step, check->n_iterations = 0;
            return FOUND;
        }
    }
    return NOT_FOUND;
}

/* Take one step. Returns FOUND, NOT_FOUND if the step is too long, SINGULAR_STRUCTURE, or SIGN_LOST
 * if points before it must be followed again. */
static int advance(equations *system, int n, const stepping *options, path *points,
                   sign_check *check, double *work)
{
    const int last = points->n_known - 1;
    const double step = points->step;
    const norm last_metric = metric_at(points, last);
    const double last_slope = points->parameter_tangents[last];
    const double *last_point = points->unknowns + (size_t)last * n;
    const double *last_tangent = points->unknown_tangents + (size_t)last * n;
    double *x = points->unknowns + (size_t)points->n_known * n, p;
    double *tangent = points->unknown_tangents + (size_t)points->n_known * n;
    const correction correction_options = step_correction(options, step);
    const plane border = {last_tangent, last_slope, last_metric};
    int n_iterations, crosses_branch = 0;
    norm metric;
    predict(system, points, x, &p, work);
    const int outcome =
        correct_in_plane(system, &border, &correction_options, x, &p, &n_iterations, work);
    check->n_iterations += n_iterations;
    if (outcome != FOUND) return outcome;
    const int is_last = points->n_known + 1 == points->capacity || p < options->min_parameter ||
                        p > options->max_parameter;
    const int knows_sign = !system->uses_products || is_last ||
                           points->n_known <= check->checked_end ||
                           points->n_known - check->last_checked >= MAX_UNCHECKED_POINTS;
    double slope = forward_tangent(system, n, knows_sign ? points->orientation : NAN, x,
                                   last_tangent, last_slope, tangent, &metric);
    /* The angle shows whether the step has left the path. */
    const double cosine =
        direction_cosine(system, last_metric, tangent, slope, last_tangent, last_slope);
    if (!(cosine > options->min_cosine)) {
        if (check->last_checked < last && cosine < 0.0) return SIGN_LOST;
        if (!(cosine < -0.999 && step < LOCAL_STEP_RATIO * options->max_step)) return NOT_FOUND;
        /* A short step straight on, but the sign has changed: another branch crosses. */
        crosses_branch = 1, points->orientation = -points->orientation;
        reverse_tangent(n, tangent, &slope);
    }
    for (int i = 0; i < n; i++) work[i] = x[i] - last_point[i];
    const double parameter_change = p - points->parameters[last];
    if (isnan(points->orientation) && /* lest a step across a narrow turn leads back */
        !(direction_cosine(system, last_metric, work, parameter_change, last_tangent, last_slope) >
              options->min_cosine &&
          direction_cosine(system, metric, work, parameter_change, tangent, slope) >
              options->min_cosine))
        return NOT_FOUND;
    append(system, points, p, slope, metric, check->n_iterations, crosses_branch, work);
    check->n_iterations = 0;
    if (n_iterations <= 3) points->step = fmin(options->max_step, 1.7 * step);
    else if (n_iterations > 5) points->step *= 0.7;
    if (knows_sign) check->last_checked = points->n_known - 1, check->step = points->step;
    return FOUND;
}

int follow_path(equations *system, const stepping *options, path *points)
{
    const int n = system->unknowns;
    double *work = malloc(4 * ((size_t)n + 1) * sizeof(double));
    int outcome = work ? FOUND : NO_MEMORY, is_inside = 1;
    sign_check check = {points->n_known - 1, points->step, 0, 0};
    if (outcome == FOUND && points->orientation == 0.0) {
        const double *x = points->unknowns + (size_t)(points->n_known - 1) * n;
        outcome = system->evaluate(system, x, points->parameters[points->n_known - 1]);
        const double sign = outcome == FOUND ? system->sign(system) : NAN;
        points->orientation = points->parameter_tangents[points->n_known - 1] > 0.0 ? sign : -sign;
    }
    while (outcome == FOUND && points->n_known < points->capacity && is_inside) {
        do outcome = advance(system, n, options, points, &check, work);
        while (outcome == NOT_FOUND && (points->step *= 0.5) >= options->min_step);
        if (outcome != FOUND && discard_unchecked(&check, points)) outcome = FOUND;
        if (outcome == NOT_FOUND &&
            (outcome = pass_corner(system, n, options, points, &check, work)) == FOUND)
            check.last_checked = points->n_known - 1, check.step = points->step;
        const double p = points->parameters[points->n_known - 1];
        is_inside = p >= options->min_parameter && p <= options->max_parameter;
    }
    free(work);
    return outcome;
}

static double evaluate_cubic(const double *cubic, double s)
{
    return ((cubic[0] * s + cubic[1]) * s + cubic[2]) * s + cubic[3];
}

/* Return a root of a cubic polynomial between 0 and 1, by bisection; the nearer end if rounding has
 * hidden the change of sign. */
static double cubic_root(const double *cubic)
{
    double low = 0.0, high = 1.0;
    const double low_value = evaluate_cubic(cubic, low), high_value = evaluate_cubic(cubic, high);
    if (low_value == 0.0 || high_value == 0.0 || (low_value > 0.0) == (high_value > 0.0))
        return fabs(low_value) < fabs(high_value) ? low : high;
    for (int i = 0; i < DBL_MANT_DIG; i++) {
        const double middle = 0.5 * (low + high);
        if ((evaluate_cubic(cubic, middle) > 0.0) == (low_value > 0.0)) low = middle;
        else high = middle;
    }
    return 0.5 * (low + high);
}

/* find_point_between with work space (3, n). */
static int search_between(equations *system, int n, const stepping *options, const double *target,
                          path *ends, double *work)
{
    int first = 0, last = 1, next = 2, must_halve = 0;
    for (int count = 0; count < DBL_MANT_DIG; count++) {
        const double *first_point = ends->unknowns + (size_t)first * n;
        const double *last_point = ends->unknowns + (size_t)last * n;
        const double *tangent = ends->unknown_tangents + (size_t)first * n;
        const double slope = ends->parameter_tangents[first];
        const norm metric = metric_at(ends, first);
        const double p = ends->parameters[first], parameter_change = ends->parameters[last] - p;
        for (int i = 0; i < n; i++) work[i] = last_point[i] - first_point[i];
        const double length = product(system, metric, work, tangent) + parameter_change * slope;
        const double *last_tangent = ends->unknown_tangents + (size_t)last * n;
        const double tangent_cosine =
            product(system, metric, last_tangent, tangent) + ends->parameter_tangents[last] * slope;
        if (!(length > 0.0 && tangent_cosine > 0.0)) return NOT_FOUND;
        /* p(s) or dp/ds, of s / length */
        const double first_rate = length * slope,
                     last_rate = length * ends->parameter_tangents[last] / tangent_cosine;
        const double cubic_term = first_rate + last_rate - 2.0 * parameter_change,
                     square_term = 3.0 * parameter_change - 2.0 * first_rate - last_rate;
        const double slope_cubic[4] = {0.0, 3.0 * cubic_term, 2.0 * square_term, first_rate};
        const double value_cubic[4] = {cubic_term, square_term, first_rate,
                                       target ? p - *target : 0.0};
        double fraction = cubic_root(target ? value_cubic : slope_cubic);
        ends->n_known = fraction < 0.5 ? first : last;
        if (fmin(fraction, 1.0 - fraction) * length <= options->min_step) return FOUND;
        if (must_halve) fraction = 0.5;
        const double step = fraction * length;
        double *x = ends->unknowns + (size_t)next * n,
               *next_tangent = ends->unknown_tangents + (size_t)next * n;
        ends->parameters[next] = p + step * slope;
        memcpy(x, first_point, n * sizeof(double));
        add_scaled(n, x, step, tangent);
        const plane border = {tangent, slope, metric};
        correction correction_options = options->correction;
        correction_options.max_parameter_change *= step;
        const int outcome =
            correct_in_plane(system, &border, &correction_options, x, ends->parameters + next,
                             ends->iterations + next, work);
        if (outcome != FOUND) return outcome;
        norm next_metric;
        ends->parameter_tangents[next] = unit_tangent(system, n, x, next_tangent, &next_metric);
        ends->unknowns_weights[next] = next_metric.weight,
        ends->time_mean_weights[next] = next_metric.time_mean_weight;
        if (product(system, metric, next_tangent, tangent) +
                ends->parameter_tangents[next] * slope <
            0.0)
            reverse_tangent(n, next_tangent, ends->parameter_tangents + next);
        const int is_before = target ? (ends->parameters[next] - *target) * (p - *target) > 0.0
                                     : ends->parameter_tangents[next] * slope > 0.0;
        const int replaced_index = is_before ? first : last;
        if (is_before) first = next;
        else last = next;
        next = replaced_index;
        must_halve = count >= 3 && (is_before ? 1.0 - fraction : fraction) > 0.5 && !must_halve;
    }
    return NOT_FOUND;
}

int find_point_between(equations *system, const stepping *options, const double *target, path *ends)
{
    const int n = system->unknowns;
    double *work = malloc(3 * (size_t)n * sizeof(double));
    const int outcome = work ? search_between(system, n, options, target, ends, work) : NO_MEMORY;
    free(work);
    return outcome;
}
