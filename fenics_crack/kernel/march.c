#include "march.h"

#include <string.h>

#include "lapack.h"

/* Subtract weighted rows (p, n): y -= sum_i weight_i row_i. */
static void subtract_rows(int p, int n, const double *rows, const double *weight,
                          double *restrict y)
{
    for (int i = 0; i < p; i++) {
        const double *row = rows + (size_t)i * n, w = weight[i];
        if (w == 0.0) continue;
        for (int j = 0; j < n; j++) y[j] -= w * row[j];
    }
}

/* Set y = P^T q - g0. */
static void compute_gaps(const vibration *v, const double *q, double *y)
{
    for (int i = 0; i < v->pairs; i++)
        y[i] = dot(v->modes, v->rows + (size_t)i * v->modes, q) - v->clearance[i];
}

static void penalty_forces(const vibration *v, const double *gap, double *force)
{
    for (int i = 0; i < v->pairs; i++) force[i] = gap[i] > 0.0 ? v->springs[i] * gap[i] : 0.0;
}

/* --- central differences --------------------------------------------------------------------- */

int march_central(const central_differences *s, int first, int steps, double *gap, double *force,
                  double *shape)
{
    const vibration *v = &s->vibration;
    const int n = v->modes, p = v->pairs;
    double *restrict q = s->displacements, *restrict d = s->increment;
    double *restrict r = v->work, *restrict a = r + n, *restrict predicted_gaps = a + n;
    for (int step = 0; step < steps; step++, gap += p, force += p, shape += n) {
        const double *wave = v->waves + v->loads * (size_t)(first + step);
        memcpy(shape, q, n * sizeof(double));
        compute_gaps(v, q, gap);
        /* r = f - w^2 q - P lambda. */
        memcpy(r, v->load, n * sizeof(double));
        for (int k = 1; k < v->loads; k++) {
            const double *row = v->load + (size_t)k * n;
            for (int j = 0; j < n; j++) r[j] += wave[k] * row[j];
        }
        for (int j = 0; j < n; j++) r[j] -= v->squares[j] * q[j];
        if (v->springs) {
            if (v->friction) {
                memcpy(predicted_gaps, gap, p * sizeof(double));
                if (step_friction(v->friction, v->stick_places, v->pair_states, predicted_gaps,
                                  force))
                    return step;
            } else penalty_forces(v, gap, force);
            subtract_rows(p, n, v->rows, force, r);
        }
        /* d = keep d + gain r. */
        if (v->coupled) {
            multiply(n, n, s->keep, d, a);
            multiply(n, n, s->gain, r, d);
            for (int j = 0; j < n; j++) d[j] += a[j];
        } else {
            for (int j = 0; j < n; j++) d[j] = s->keep[j] * d[j] + s->gain[j] * r[j];
        }
        if (!v->springs) {
            for (int i = 0; i < p; i++)
                predicted_gaps[i] = gap[i] + dot(n, v->rows + (size_t)i * n, d);
            if (solve_instant(s->contact, predicted_gaps, NULL, s->closed, force)) return step;
            subtract_rows(p, n, s->push, force, d);
        }
        for (int j = 0; j < n; j++) q[j] += d[j];
    }
    return steps;
}

/* --- exponential steps ----------------------------------------------------------------------- */

/* Set y = E x. */
static void apply_transition(const exponential *s, const double *restrict x, double *restrict y)
{
    const int n = s->modes;
    if (s->coupled) {
        multiply(2 * n, 2 * n, s->transition, x, y);
        return;
    }
    const double *qq = s->transition, *qv = qq + n, *vq = qv + n, *vv = vq + n;
    for (int j = 0; j < n; j++) {
        y[j] = qq[j] * x[j] + qv[j] * x[n + j];
        y[n + j] = vq[j] * x[j] + vv[j] * x[n + j];
    }
}

int march_exponential(const exponential *s, int steps, double *states, double *forces,
                      signed char *closed)
{
    const int n = s->modes, p = s->pairs, pairs = s->friction ? p / 2 : p;
    double *restrict z = s->work, *restrict predicted_state = z + 2 * n,
                     *restrict gap = predicted_state + 2 * n;
    double *restrict force_sum = gap + p;
    for (int j = 0; j < 2 * n; j++) z[j] = states[j] - s->steady[j];
    for (int step = 1; step <= steps; step++) {
        const size_t phase = step % s->instants;
        const double *last_forces = forces, *linear = s->linear + phase * p;
        const double *steady = s->steady + phase * 2 * n;
        const signed char *guess = closed;
        states += 2 * n;
        forces += p;
        closed += pairs;
        /* s = Q (E z - G lambda) + l. */
        apply_transition(s, z, predicted_state);
        for (int i = 0; i < p; i++) {
            gap[i] = linear[i] + dot(n, s->rows + (size_t)i * n, predicted_state) -
                     dot(p, s->gap_response + (size_t)i * p, last_forces);
        }
        memcpy(closed, guess, (size_t)pairs);
        if (s->friction ? step_friction(s->friction, s->stick_places, closed, gap, forces)
                        : solve_instant(s->contact, gap, NULL, closed, forces))
            return step - 1;
        for (int i = 0; i < p; i++) force_sum[i] = last_forces[i] + forces[i];
        subtract_rows(p, 2 * n, s->force_response, force_sum, predicted_state);
        for (int j = 0; j < 2 * n; j++) {
            z[j] = predicted_state[j];
            states[j] = z[j] + steady[j];
        }
    }
    return steps;
}
