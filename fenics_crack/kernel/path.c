#include "path.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    SIGN_LOST = FAILED + 1, /* of points: they do not go with the next sign */
    MAX_UNCHECKED_POINTS = 8            /* points without a sign in a row: a branch that crosses twice is missed */
};
/* Of the longest step: within as little a path that changes its sign straight on crosses a branch, and
 * a corner is passed. CORNER: the shortest step around one. */
#define LOCAL_STEP_RATIO 1e-2
#define CORNER_STEP_RATIO 1e-7

/* The norm of a point's tangent. */
static norm norm_of(const path *points, int place)
{
    return (norm){points->weights[place], points->mean_weights[place]};
}

/* x, p += the quadratic and cubic terms of Hermite's polynomial through the last two points, in the
 * distance along the last tangent; none where these could not help. */
static void bend(const equations *at, const path *points, double step, double *x, double *p,
                 double *room)
{
    if (points->n_known < 2) return;
    const int n = at->unknowns, last = points->n_known - 1;
    const double *here = points->unknowns + (size_t)last * n, *before = here - n;
    const double *tangent = points->tangents + (size_t)last * n, *old = tangent - n;
    const double slope = points->slopes[last], old_slope = points->slopes[last - 1];
    const norm own = norm_of(points, last);
    const double rise = points->parameters[last] - points->parameters[last - 1];
    for (int i = 0; i < n; i++) room[i] = here[i] - before[i];
    const double back = product(at, own, room, tangent) + rise * slope;
    const double size = sqrt(product(at, own, old, old) + old_slope * old_slope);
    const double along = (product(at, own, old, tangent) + old_slope * slope) / size;
    if (!(back > 0.0 && along > 0.5)) return;
    /* x(s) = x + s t + s^2 A + s^2 (s + back) B, by divided differences with double nodes. */
    for (int i = 0; i <= n; i++) {
        const double end = i < n ? tangent[i] : slope, start = i < n ? old[i] : old_slope;
        const double mean = (i < n ? room[i] : rise) / back, second = (end - mean) / back;
        const double third = (second - (mean - start / (size * along)) / back) / back;
        room[i] = step * step * (second + (step + back) * third);
    }
    const double far = product(at, own, room, room) + room[n] * room[n];
    if (far < 0.1 * step * step) add_scaled(n, x, 1.0, room), *p += room[n];
}

/* Where solutions take products with J, the sign of det J is dear, and asked for now and then. Where
 * it is wrong, the points since the last one are followed again, each with its own. */
typedef struct {
    int sure;    /* the last point with its sign, */
    double step; /* and the step behind it */
    int own;     /* points before this one need their own */
    int spent;   /* iterations since the last point, those of steps that were too long, too */
} sign_check;

/* Of two directions y and z, the second with its norm, as turns are judged. */
static double along_of(const equations *at, norm own, const double *y, double y_p, const double *z,
                       double z_p)
{
    const double *counts = at->angle_weights;
    double sum = 0.0;
    if (!counts) return product(at, own, y, z) + y_p * z_p;
    for (int i = 0; i < at->unknowns; i++) sum += counts[i] * y[i] * z[i];
    return own.weight * sum + y_p * z_p;
}

/* Cosine of the angle between them. */
static double cosine_of(const equations *at, norm own, const double *y, double y_p,
                        const double *z, double z_p)
{
    const double square = along_of(at, own, y, y_p, y, y_p) * along_of(at, own, z, z_p, z, z_p);
    return square > 0.0 ? along_of(at, own, y, y_p, z, z_p) / sqrt(square) : 0.0;
}

/* The exact tangent at a point that has been evaluated. The determinant of the bordered matrix
 * keeps its sign along a path: it shows where the path goes on. Where it is not known the tangent
 * is taken that goes on at the smaller angle to the one before, with its slope. */
static double tangent_onwards(equations *at, int n, double orientation, const double *x,
                              const double *before, double old_slope, double *tangent,
                              norm *own)
{
    double slope = unit_tangent(at, n, x, tangent, own);
    const double sign = isnan(orientation) ? NAN : at->sign(at);
    const int onwards = isnan(sign) ? along_of(at, *own, tangent, slope, before, old_slope) >= 0.0
                                    : sign == orientation;
    if (!onwards) reverse_tangent(n, tangent, &slope);
    return slope;
}

/* Forget the points behind the last one that is sure; 0 where there are none. */
static int go_back(sign_check *in, path *points)
{
    if (in->sure == points->n_known - 1) return 0;
    in->own = points->n_known, points->n_known = in->sure + 1, points->step = in->step;
    return 1;
}

/* The prediction x, p of the next point. */
static void predict(const equations *at, const path *points, double *x, double *p, double *room)
{
    const int n = at->unknowns, last = points->n_known - 1;
    memcpy(x, points->unknowns + (size_t)last * n, n * sizeof(double));
    add_scaled(n, x, points->step, points->tangents + (size_t)last * n);
    *p = points->parameters[last] + points->step * points->slopes[last];
    bend(at, points, points->step, x, p, room);
}

/* How the end of a step is corrected: points must be known better than steps are long. */
static correction correction_of(const stepping *how, double step)
{
    correction found = how->correction;
    found.tolerance = fmax(how->rounding, fmin(found.tolerance, 1e-4 * step));
    found.max_parameter_change *= step;
    return found;
}

/* One more point, whose unknowns and tangent are in their places. */
static void append(equations *at, path *points, double p, double slope, norm own,
                   int taken, int crossing, double *room)
{
    const int n = at->unknowns, next = points->n_known++;
    const double *x = points->unknowns + (size_t)next * n, rise = p - points->parameters[next - 1];
    for (int i = 0; i < n; i++) room[i] = x[i] - x[i - n];
    points->parameters[next] = p, points->slopes[next] = slope;
    points->weights[next] = own.weight, points->mean_weights[next] = own.mean_weight;
    points->iterations[next] = taken, points->crossings[next] = crossing;
    if (points->records) at->record(at, points->records + (size_t)next * at->records);
    const double square = product(at, norm_of(points, next - 1), room, room);
    points->lengths[next] = sqrt(square + rise * rise);
}

/* Leaves the last point where the path turns more sharply than steps can resolve, as where stiff
 * contact begins to graze and J changes by orders of magnitude over the smallest distance. The path
 * goes on as the tangent just behind the point says; where the sign of det J is not known, that or
 * its opposite, unless this leads straight back. FOUND, or NOT_FOUND where it ends. */
static int round_corner(equations *at, int n, const stepping *how, path *points, sign_check *in,
                        double *room)
{
    const int last = points->n_known - 1;
    const double *here = points->unknowns + (size_t)last * n;
    const double *old = points->tangents + (size_t)last * n, old_slope = points->slopes[last];
    double *x = points->unknowns + (size_t)points->n_known * n;
    double *tangent = points->tangents + (size_t)points->n_known * n, *way = room + 3 * (n + 1);
    double step = fmax(CORNER_STEP_RATIO * how->max_step, how->min_step);
    for (; step <= LOCAL_STEP_RATIO * how->max_step; step *= sqrt(10.0)) {
        double p = points->parameters[last] + step * old_slope;
        norm of_way, own;
        memcpy(x, here, n * sizeof(double)), add_scaled(n, x, step, old);
        const int outcome = at->evaluate(at, x, p);
        in->spent++;
        if (outcome != FOUND) return outcome;
        double slope_of_way =
            tangent_onwards(at, n, points->orientation, x, old, old_slope, way, &of_way);
        const double straight =
            cosine_of(at, norm_of(points, last), way, slope_of_way, old, old_slope);
        const int unsure = isnan(points->orientation) && straight < how->min_cosine;
        for (int ways = 0; ways <= unsure; ways++, reverse_tangent(n, way, &slope_of_way)) {
            int taken;
            memcpy(x, here, n * sizeof(double)), add_scaled(n, x, step, way);
            p = points->parameters[last] + step * slope_of_way;
            const plane across = {way, slope_of_way, of_way};
            const correction newton = correction_of(how, step);
            const int corrected = correct_in_plane(at, &across, &newton, x, &p, &taken, room);
            in->spent += taken;
            if (corrected != FOUND) continue;
            const double slope =
                tangent_onwards(at, n, points->orientation, x, way, slope_of_way, tangent, &own);
            if (!(cosine_of(at, of_way, tangent, slope, way, slope_of_way) > 0.5)) continue;
            append(at, points, p, slope, own, in->spent, 0, room);
            points->step = step, in->spent = 0;
            return FOUND;
        }
    }
    return NOT_FOUND;
}

/* One step: FOUND, NOT_FOUND where the step is too long, SINGULAR_STRUCTURE, or DOUBTED where
 * points before it must be followed again. */
static int advance(equations *at, int n, const stepping *how, path *points, sign_check *in, double *room)
{
    const int last = points->n_known - 1;
    const double step = points->step;
    const norm of_last = norm_of(points, last);
    const double old_slope = points->slopes[last];
    const double *here = points->unknowns + (size_t)last * n;
    const double *old = points->tangents + (size_t)last * n;
    double *x = points->unknowns + (size_t)points->n_known * n, p;
    double *tangent = points->tangents + (size_t)points->n_known * n;
    const correction newton = correction_of(how, step);
    const plane across = {old, old_slope, of_last};
    int taken, crossing = 0;
    norm own;
    predict(at, points, x, &p, room);
    const int outcome = correct_in_plane(at, &across, &newton, x, &p, &taken, room);
    in->spent += taken;
    if (outcome != FOUND) return outcome;
    const int ends = points->n_known + 1 == points->capacity || p < how->min_parameter || p > how->max_parameter;
    const int sure = !at->uses_products || ends || points->n_known <= in->own ||
                     points->n_known - in->sure >= MAX_UNCHECKED_POINTS;
    double slope =
        tangent_onwards(at, n, sure ? points->orientation : NAN, x, old, old_slope, tangent, &own);
    /* The angle shows whether the step has left the path. */
    const double cosine = cosine_of(at, of_last, tangent, slope, old, old_slope);
    if (!(cosine > how->min_cosine)) {
        if (in->sure < last && cosine < 0.0) return SIGN_LOST;
        if (!(cosine < -0.999 && step < LOCAL_STEP_RATIO * how->max_step)) return NOT_FOUND;
        /* A short step straight on, but the sign has changed: another branch crosses. */
        crossing = 1, points->orientation = -points->orientation;
        reverse_tangent(n, tangent, &slope);
    }
    for (int i = 0; i < n; i++) room[i] = x[i] - here[i];
    const double rise = p - points->parameters[last];
    if (isnan(points->orientation) && /* lest a step across a narrow turn leads back */
        !(cosine_of(at, of_last, room, rise, old, old_slope) > how->min_cosine &&
          cosine_of(at, own, room, rise, tangent, slope) > how->min_cosine))
        return NOT_FOUND;
    append(at, points, p, slope, own, in->spent, crossing, room);
    in->spent = 0;
    if (taken <= 3) points->step = fmin(how->max_step, 1.7 * step);
    else if (taken > 5) points->step *= 0.7;
    if (sure) in->sure = points->n_known - 1, in->step = points->step;
    return FOUND;
}

int follow_path(equations *at, const stepping *how, path *points)
{
    const int n = at->unknowns;
    double *room = malloc(4 * ((size_t)n + 1) * sizeof(double));
    int outcome = room ? FOUND : NO_MEMORY, inside = 1;
    sign_check in = {points->n_known - 1, points->step, 0, 0};
    if (outcome == FOUND && points->orientation == 0.0) {
        const double *x = points->unknowns + (size_t)(points->n_known - 1) * n;
        outcome = at->evaluate(at, x, points->parameters[points->n_known - 1]);
        const double sign = outcome == FOUND ? at->sign(at) : NAN;
        points->orientation = points->slopes[points->n_known - 1] > 0.0 ? sign : -sign;
    }
    while (outcome == FOUND && points->n_known < points->capacity && inside) {
        do outcome = advance(at, n, how, points, &in, room);
        while (outcome == NOT_FOUND && (points->step *= 0.5) >= how->min_step);
        if (outcome != FOUND && go_back(&in, points)) outcome = FOUND;
        if (outcome == NOT_FOUND && (outcome = round_corner(at, n, how, points, &in, room)) == FOUND)
            in.sure = points->n_known - 1, in.step = points->step;
        const double p = points->parameters[points->n_known - 1];
        inside = p >= how->min_parameter && p <= how->max_parameter;
    }
    free(room);
    return outcome;
}

static double polynomial(const double *cubic, double s)
{
    return ((cubic[0] * s + cubic[1]) * s + cubic[2]) * s + cubic[3];
}

/* A root of a cubic polynomial between 0 and 1, by halves; the nearer end where rounding has hidden
 * the change of sign. */
static double root_within(const double *cubic)
{
    double first = 0.0, last = 1.0;
    const double begin = polynomial(cubic, first), end = polynomial(cubic, last);
    if (begin == 0.0 || end == 0.0 || (begin > 0.0) == (end > 0.0))
        return fabs(begin) < fabs(end) ? first : last;
    for (int i = 0; i < DBL_MANT_DIG; i++) {
        const double middle = 0.5 * (first + last);
        if ((polynomial(cubic, middle) > 0.0) == (begin > 0.0)) first = middle;
        else last = middle;
    }
    return 0.5 * (first + last);
}

/* The same with room (3, n). */
static int between(equations *at, int n, const stepping *how, const double *target, path *ends,
                   double *room)
{
    int first = 0, last = 1, next = 2, halve = 0;
    for (int count = 0; count < DBL_MANT_DIG; count++) {
        const double *here = ends->unknowns + (size_t)first * n;
        const double *there = ends->unknowns + (size_t)last * n;
        const double *tangent = ends->tangents + (size_t)first * n;
        const double slope = ends->slopes[first];
        const norm own = norm_of(ends, first);
        const double p = ends->parameters[first], rise = ends->parameters[last] - p;
        for (int i = 0; i < n; i++) room[i] = there[i] - here[i];
        const double length = product(at, own, room, tangent) + rise * slope;
        const double *after = ends->tangents + (size_t)last * n;
        const double onwards = product(at, own, after, tangent) + ends->slopes[last] * slope;
        if (!(length > 0.0 && onwards > 0.0)) return NOT_FOUND;
        /* p(s) or dp/ds, of s / length */
        const double begin = length * slope, end = length * ends->slopes[last] / onwards;
        const double third = begin + end - 2.0 * rise, second = 3.0 * rise - 2.0 * begin - end;
        const double turns[4] = {0.0, 3.0 * third, 2.0 * second, begin};
        const double meets[4] = {third, second, begin, target ? p - *target : 0.0};
        double share = root_within(target ? meets : turns);
        ends->n_known = share < 0.5 ? first : last;
        if (fmin(share, 1.0 - share) * length <= how->min_step) return FOUND;
        if (halve) share = 0.5;
        const double step = share * length;
        double *x = ends->unknowns + (size_t)next * n, *ahead = ends->tangents + (size_t)next * n;
        ends->parameters[next] = p + step * slope;
        memcpy(x, here, n * sizeof(double));
        add_scaled(n, x, step, tangent);
        const plane in = {tangent, slope, own};
        correction newton = how->correction;
        newton.max_parameter_change *= step;
        const int outcome =
            correct_in_plane(at, &in, &newton, x, ends->parameters + next,
                             ends->iterations + next, room);
        if (outcome != FOUND) return outcome;
        norm of_next;
        ends->slopes[next] = unit_tangent(at, n, x, ahead, &of_next);
        ends->weights[next] = of_next.weight, ends->mean_weights[next] = of_next.mean_weight;
        if (product(at, own, ahead, tangent) + ends->slopes[next] * slope < 0.0)
            reverse_tangent(n, ahead, ends->slopes + next);
        const int before = target ? (ends->parameters[next] - *target) * (p - *target) > 0.0
                                  : ends->slopes[next] * slope > 0.0;
        const int replaced = before ? first : last;
        if (before) first = next;
        else last = next;
        next = replaced;
        halve = count >= 3 && (before ? 1.0 - share : share) > 0.5 && !halve;
    }
    return NOT_FOUND;
}

int find_point_between(equations *at, const stepping *how, const double *target, path *ends)
{
    const int n = at->unknowns;
    double *room = malloc(3 * (size_t)n * sizeof(double));
    const int outcome = room ? between(at, n, how, target, ends, room) : NO_MEMORY;
    free(room);
    return outcome;
}
