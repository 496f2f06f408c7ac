#include "implicit.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "lapack.h"
#include "rounding.h"

/* y = a x, by mode. */
static void by_mode(const vibration *v, const double *a, const double *restrict x,
                    double *restrict y)
{
    if (v->coupled)
        multiply(v->modes, v->modes, a, x, y);
    else
        for (int j = 0; j < v->modes; j++) y[j] = a[j] * x[j];
}

/* y += weight sum_i x_i row_i with rows (p, n). */
static void add(const vibration *v, double weight, const double *rows, const double *x,
                double *restrict y)
{
    for (int i = 0; i < v->pairs; i++, rows += v->modes)
        for (int j = 0; j < v->modes && x[i] != 0.0; j++) y[j] += weight * x[i] * rows[j];
}

/* y = P^T q - g0; rates, without the clearance, where `moving`. */
static void seen(const vibration *v, const double *q, int moving, double *y)
{
    for (int i = 0; i < v->pairs; i++)
        y[i] = dot(v->modes, v->rows + (size_t)i * v->modes, q) - (moving ? 0.0 : v->clearance[i]);
}

/* --- the penalty law ------------------------------------------------------------------------- */

/* What is known of a step's forces: free gap, and at the forces `at` the gap, h and its slope. */
typedef struct {
    const generalised_alpha *of;
    const double *start, *free;
    double *reached, *answer, *slope;
} attempt;

/* h(g) = (V(g) - V(g_n)) / (g - g_n) + (1/2 - af) (lambda(g) - lambda_n) of g = free - D at. */
static void respond_to(const attempt *now, const double *at)
{
    const vibration *v = &now->of->body;
    const int p = v->pairs;
    const double shift = 0.5 - now->of->af;
    memcpy(now->reached, now->free, p * sizeof(double));
    for (int i = 0; i < p; i++)
        for (int j = 0; j < p; j++) now->reached[j] -= at[i] * now->of->compliance[i * p + j];
    for (int i = 0; i < p; i++) {
        const double k = v->springs[i], g = now->reached[i], begun = now->start[i];
        const double force = g > 0.0 ? k * g : 0.0, before = begun > 0.0 ? k * begun : 0.0;
        double mean = 0.5 * (force + before), slope = g > 0.0 || begun > 0.0 ? 0.5 * k : 0.0;
        if (g * begun < 0.0) {
            mean = 0.5 * (force * g - before * begun) / (g - begun);
            slope = (force - mean) / (g - begun);
        }
        now->answer[i] = mean + shift * (force - before);
        now->slope[i] = slope + (g > 0.0 ? shift * k : 0.0);
    }
}

/* moved^T (at - h). */
static double along(int p, const double *moved, const double *at, const double *answer)
{
    double sum = 0.0;
    for (int i = 0; i < p; i++) sum += moved[i] * (at[i] - answer[i]);
    return sum;
}

/* h of a step from `held`, by Newton's method as solve_forces in model/contact.py: 0, or 1 where it
 * fails. */
static int find_mean_forces(generalised_alpha *s, const double *start, const double *free,
                            double *room)
{
    const int p = s->body.pairs;
    attempt now = {s, start, free, room, room + p, room + 2 * p};
    double *force = s->held, *change = room + 3 * p, *moved = change + p, *before = moved + p;
    double *matrix = before + p;
    respond_to(&now, force);
    for (int turn = 0; turn < s->most; turn++) {
        double size = 0.0, largest = 0.0;
        int off = 0;
        for (int i = 0; i < p; i++) {
            change[i] = now.answer[i] - force[i];
            off |= change[i] != 0.0;
            size = fmax(size, fabs(free[i]) + fabs(free[i] - now.reached[i]));
            for (int j = 0; j < p; j++)
                matrix[i * p + j] = (i == j) + now.slope[i] * s->compliance[i * p + j];
        }
        if (!off) return 0;
        if (factor(p, matrix, s->pivots)) return 1;
        solve_factored(p, matrix, s->pivots, change);
        memcpy(before, force, p * sizeof(double));
        for (int i = 0; i < p; i++) {
            moved[i] = 0.0;
            for (int j = 0; j < p; j++) moved[i] += change[j] * s->compliance[j * p + i];
            if (!isfinite(force[i] += change[i])) return 1;
            largest = fmax(largest, fabs(moved[i]));
        }
        if (largest <= ROUNDING * size) return 0;
        const double flat = -0.1 * along(p, moved, before, now.answer);
        respond_to(&now, force);
        double slope = along(p, moved, force, now.answer), share = 1.0, part = 1.0;
        if (!(flat > 0.0 && slope > flat)) continue;
        /* The convex function is lowest between both. */
        for (int half = 0; half < DBL_MANT_DIG && fabs(slope) > flat; half++) {
            part *= 0.5;
            share -= copysign(part, slope);
            for (int i = 0; i < p; i++) force[i] = before[i] + share * change[i];
            respond_to(&now, force);
            slope = along(p, moved, force, now.answer);
        }
    }
    return 1;
}

/* --- steps ----------------------------------------------------------------------------------- */

/* q'' at the end of a step from what Newmark's formulas know of q and q' there. */
static void without_contact(const generalised_alpha *s, int first, int step, const double *moved,
                            const double *faster, double *x, double *y, double *found)
{
    const vibration *v = &s->body;
    const int n = v->modes;
    const double *here = v->waves + 3 * (size_t)first, *next = v->waves + 3 * (size_t)step;
    const double w = 1.0 - s->af;
    double wave[3];
    for (int i = 0; i < 3; i++) wave[i] = w * next[i] + s->af * here[i];
    for (int j = 0; j < n; j++) x[j] = w * faster[j] + s->af * s->velocity[j];
    by_mode(v, s->damping, x, y);
    for (int j = 0; j < n; j++) {
        const double load = wave[0] * v->load[j] + wave[1] * v->load[n + j]
                            + wave[2] * v->load[2 * n + j];
        x[j] = load - v->squares[j] * (w * moved[j] + s->af * s->shape[j]) - s->am * s->change[j]
               - y[j];
    }
    by_mode(v, s->inverse, x, found);
}

/* Impulses that keep pairs which have pressed from closing further: 0, or 1. */
static int stop(const generalised_alpha *s, double *faster, double *rates, double *impulse)
{
    const int p = s->body.pairs;
    signed char *among = s->closed + p;
    int any = 0;
    for (int i = 0; i < p; i++) any |= among[i] = s->held[i] > 0.0;
    memset(impulse, 0, p * sizeof(double));
    if (!any) return 0;
    seen(&s->body, faster, 1, rates);
    for (int i = 0; i < p; i++) {
        if (!among[i]) rates[i] = 0.0;
        s->closed[i] = rates[i] > 0.0;
    }
    if (forces_at(s->stops, rates, among, s->closed, impulse)) return 1;
    add(&s->body, -1.0, s->kick, impulse, faster);
    return 0;
}

int march_implicit(generalised_alpha *s, int first, int steps, double *gap, double *force,
                   double *shape)
{
    const vibration *v = &s->body;
    const int n = v->modes, p = v->pairs, rigid = !v->springs;
    const double dt = s->dt, end = s->beta * dt * dt, before = (0.5 - s->beta) * dt * dt;
    double *moved = s->room, *faster = moved + n, *found = faster + n, *x = found + n, *y = x + n;
    double *free = y + n, *rest = free + p;
    for (int step = 0; step < steps; step++, gap += p, force += p, shape += n) {
        memcpy(shape, s->shape, n * sizeof(double));
        seen(v, s->shape, 0, gap);
        for (int j = 0; j < n; j++) {
            moved[j] = s->shape[j] + dt * s->velocity[j] + before * s->change[j];
            faster[j] = s->velocity[j] + dt * (1.0 - s->gamma) * s->change[j];
        }
        const int at = first + step, next = (at + 1) % s->instants;
        without_contact(s, at, next, moved, faster, x, y, found);
        for (int j = 0; j < n; j++) x[j] = moved[j] + end * found[j];
        seen(v, x, 0, free);
        if (rigid) {
            if (forces_at(s->contact, free, NULL, s->closed, s->held)) return step;
            add(v, -1.0, s->kick, s->held, s->velocity);
            add(v, -1.0, s->kick, s->held, faster);
            add(v, -dt, s->kick, s->held, moved);
        } else {
            for (int i = 0; i < p; i++) force[i] = gap[i] > 0.0 ? v->springs[i] * gap[i] : 0.0;
            if (find_mean_forces(s, gap, free, rest)) return step;
        }
        add(v, 1.0, s->pull, s->held, found);
        for (int j = 0; j < n; j++) {
            s->shape[j] = moved[j] + end * found[j];
            faster[j] += s->gamma * dt * found[j];
            x[j] = 0.5 * (s->velocity[j] + faster[j]);
        }
        by_mode(v, s->damping, x, y);
        s->lost += dt * dot(n, x, y);
        if (rigid) {
            if (stop(s, faster, free, rest)) return step;
            for (int i = 0; i < p; i++) {
                force[i] = (s->held[i] + rest[i]) / dt;
                s->closed[i] = force[i] > 0.0;
            }
        }
        memcpy(s->velocity, faster, n * sizeof(double));
        memcpy(s->change, found, n * sizeof(double));
    }
    return steps;
}
