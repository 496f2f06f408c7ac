#include "condensed.h"
#include "path.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static double inner(int n, const double *x, const double *y)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += x[i] * y[i];
    return sum;
}

/* x += s y */
static void add(int n, double *x, double s, const double *y)
{
    for (int i = 0; i < n; i++) x[i] += s * y[i];
}

/* -J^-1 dF/dp. */
static void slope_at(point *at, int n, double *slope)
{
    by_parameter(at, slope);
    solve(at, slope);
    for (int i = 0; i < n; i++) slope[i] = -slope[i];
}

/* solve_in_plane with room for F, dx and J^-1 F_p: (3, n). */
static int correct(point *at, int n, double *x, double *p, const double *across, double slope,
                   double weight, double tolerance, int iterations, double reach,
                   double least_damping, int *taken, double *room)
{
    double *F = room, *change = room + n, *rate = change + n;
    const double guess = *p;
    double shift = 0.0, damping = 1.0, before = INFINITY;
    *taken = 0;
    for (int i = 0; i < 4 * iterations; i++) {
        const int outcome = evaluate(at, x, *p);
        if (outcome != FOUND) return outcome;
        residual_at(at, F);
        const double square = inner(n, F, F);
        const double size = sqrt((across ? weight : 1.0 / fmax(inner(n, x, x), 1e-300)) * square);
        if (size <= tolerance) return FOUND;
        if (!isfinite(size)) return NOT_FOUND;
        if (least_damping >= 0.0 && !(size < before)) { /* a shorter step */
            damping *= 0.5;
            if (damping < least_damping) return NOT_FOUND;
            add(n, x, -damping, change), *p -= damping * shift;
            continue;
        }
        if (*taken == iterations) return NOT_FOUND;
        /* (dx, dp) = (a + dp b, dp), J a = -F, J b = -F_p, dp = -w <t_x, a> / (w <t_x, b> + t_p) */
        for (int j = 0; j < n; j++) change[j] = -F[j];
        solve(at, change);
        shift = 0.0;
        if (across) {
            slope_at(at, n, rate);
            const double along = weight * inner(n, across, rate) + slope + 1e-300; /* not 0 */
            shift = -weight * inner(n, across, change) / along;
            add(n, change, shift, rate);
            if (!(fabs(*p + shift - guess) <= reach)) return NOT_FOUND; /* another branch, or none */
        }
        damping = 1.0, before = size;
        ++*taken;
        add(n, x, 1.0, change), *p += shift;
    }
    return NOT_FOUND;
}

int solve_in_plane(point *at, double *unknown, double *parameter, int bordered,
                   const double *across, double slope, double weight, double tolerance,
                   int iterations, double reach, double least_damping, int *taken)
{
    const int n = unknowns_of(at);
    double *room = malloc(3 * (size_t)n * sizeof(double));
    const int outcome = !room ? NO_MEMORY
                              : correct(at, n, unknown, parameter, bordered ? across : NULL, slope,
                                        weight, tolerance, iterations, reach, least_damping, taken,
                                        room);
    free(room);
    return outcome;
}

/* x, p += the quadratic and cubic terms of Hermite's polynomial through the last two points, in the
 * distance along the last tangent; none where these could not help. */
static void bend(int n, const path *at, double step, double *x, double *p, double *room)
{
    if (at->known < 2) return;
    const int last = at->known - 1;
    const double *here = at->unknowns + (size_t)last * n, *before = here - n;
    const double *tangent = at->tangents + (size_t)last * n, *old = tangent - n;
    const double weight = at->weights[last], slope = at->slopes[last];
    const double old_slope = at->slopes[last - 1], rise = at->parameters[last] -
                                                           at->parameters[last - 1];
    double back = rise * slope;
    for (int i = 0; i < n; i++) back += weight * (here[i] - before[i]) * tangent[i];
    const double size = sqrt(weight * inner(n, old, old) + old_slope * old_slope);
    const double along = (weight * inner(n, old, tangent) + old_slope * slope) / size;
    if (!(back > 0.0 && along > 0.5)) return;
    /* x(s) = x + s t + s^2 A + s^2 (s + back) B, by divided differences with double nodes. */
    double far = 0.0, mean, second, third;
    for (int i = 0; i <= n; i++) {
        const double end = i < n ? tangent[i] : slope, start = i < n ? old[i] : old_slope;
        mean = (i < n ? here[i] - before[i] : rise) / back;
        second = (end - mean) / back;
        third = (second - (mean - start / (size * along)) / back) / back;
        room[i] = step * step * (second + (step + back) * third);
        far += (i < n ? weight : 1.0) * room[i] * room[i];
    }
    if (far < 0.1 * step * step) add(n, x, 1.0, room), *p += room[n];
}

/* One step: FOUND, NOT_FOUND where the step is too long, or SINGULAR_STRUCTURE. */
static int advance(point *at, int n, const stepping *how, path *points, double *room)
{
    const int last = points->known - 1;
    const double step = points->step, weight = points->weights[last];
    const double *here = points->unknowns + (size_t)last * n, old_slope = points->slopes[last];
    const double *old = points->tangents + (size_t)last * n;
    double *x = points->unknowns + (size_t)points->known * n, p;
    double *tangent = points->tangents + (size_t)points->known * n;
    const double sharp = fmax(how->rounding, fmin(how->tolerance, 1e-4 * step));
    int taken, crossing = 0;
    memcpy(x, here, n * sizeof(double));
    add(n, x, step, old), p = points->parameters[last] + step * old_slope;
    bend(n, points, step, x, &p, room);
    const int outcome = correct(at, n, x, &p, old, old_slope, weight, sharp, how->iterations,
                                how->reach * step, how->least_damping, &taken, room);
    if (outcome != FOUND) return outcome;
    /* The determinant of the bordered matrix keeps its sign along a path: it tells where the path
     * goes on, and the angle whether the step has left it. */
    slope_at(at, n, tangent);
    const double own = 1.0 / fmax(inner(n, x, x), 1e-300);
    const double length = sqrt(own * inner(n, tangent, tangent) + 1.0);
    const double direction = determinant_sign(at) == points->orientation ? 1.0 / length : -1.0 / length;
    double slope = direction;
    for (int i = 0; i < n; i++) tangent[i] *= direction;
    const double square = weight * inner(n, tangent, tangent) + slope * slope;
    const double cosine = square > 0.0 ? (weight * inner(n, tangent, old) + slope * old_slope) /
                                             sqrt(square)
                                       : 0.0;
    if (!(cosine > how->least_cosine)) {
        if (!(cosine < -0.999 && step < how->branching_step * how->longest)) return NOT_FOUND;
        /* A short step straight on, but the sign has changed: another branch crosses. */
        crossing = 1, slope = -slope, points->orientation = -points->orientation;
        for (int i = 0; i < n; i++) tangent[i] = -tangent[i];
    }
    double chord = 0.0;
    for (int i = 0; i < n; i++) chord += (x[i] - here[i]) * (x[i] - here[i]);
    const double rise = p - points->parameters[last];
    points->parameters[points->known] = p, points->slopes[points->known] = slope;
    points->weights[points->known] = own, points->iterations[points->known] = taken;
    points->lengths[points->known] = sqrt(weight * chord + rise * rise);
    points->crossings[points->known++] = crossing;
    if (taken <= 3) points->step = fmin(how->longest, 1.7 * step);
    else if (taken > 5) points->step *= 0.7;
    return FOUND;
}

int follow(point *at, const stepping *how, path *points)
{
    const int n = unknowns_of(at);
    double *room = malloc((3 * (size_t)n + 1) * sizeof(double));
    int outcome = room ? FOUND : NO_MEMORY, inside = 1;
    while (outcome == FOUND && points->known < points->room && inside) {
        outcome = NOT_FOUND;
        while (points->step > 0.0 &&
               (outcome = advance(at, n, how, points, room)) == NOT_FOUND) {
            points->step *= 0.5;
            if (points->step < how->shortest) points->step = 0.0; /* as the caller will see */
        }
        const double p = points->parameters[points->known - 1];
        inside = p >= how->lowest && p <= how->highest;
    }
    free(room);
    return outcome;
}
