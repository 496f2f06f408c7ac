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
    for (int i = 0; i < v->n_rows; i++)
        y[i] = dot(v->n_modes, v->gap_rows + (size_t)i * v->n_modes, q) - v->clearance[i];
}

static void penalty_forces(const vibration *v, const double *gap, double *force)
{
    for (int i = 0; i < v->n_rows; i++)
        force[i] = gap[i] > 0.0 ? v->spring_stiffnesses[i] * gap[i] : 0.0;
}

/* --- central differences --------------------------------------------------------------------- */

int march_central(const central_differences *s, int first, int steps, double *gap, double *force,
                  double *shape)
{
    const vibration *v = &s->vibration;
    const int n = v->n_modes, p = v->n_rows;
    double *restrict q = s->displacements, *restrict d = s->increment;
    double *restrict r = v->work, *restrict a = r + n, *restrict predicted_gaps = a + n;
    for (int step = 0; step < steps; step++, gap += p, force += p, shape += n) {
        const double *wave = v->load_basis + v->n_load_rows * (size_t)(first + step);
        memcpy(shape, q, n * sizeof(double));
        compute_gaps(v, q, gap);
        /* r = f - w^2 q - P lambda. */
        memcpy(r, v->load_rows, n * sizeof(double));
        for (int k = 1; k < v->n_load_rows; k++) {
            const double *row = v->load_rows + (size_t)k * n;
            for (int j = 0; j < n; j++) r[j] += wave[k] * row[j];
        }
        for (int j = 0; j < n; j++) r[j] -= v->squared_frequencies[j] * q[j];
        if (v->spring_stiffnesses) {
            if (v->friction_solver) {
                memcpy(predicted_gaps, gap, p * sizeof(double));
                if (step_friction(v->friction_solver, v->sticking_places, v->pair_states,
                                  predicted_gaps, force))
                    return step;
            } else penalty_forces(v, gap, force);
            subtract_rows(p, n, v->gap_rows, force, r);
        }
        /* d = alpha d + beta r. */
        if (v->has_coupled_modes) {
            multiply(n, n, s->increment_factor, d, a);
            multiply(n, n, s->force_factor, r, d);
            for (int j = 0; j < n; j++) d[j] += a[j];
        } else {
            for (int j = 0; j < n; j++)
                d[j] = s->increment_factor[j] * d[j] + s->force_factor[j] * r[j];
        }
        if (!v->spring_stiffnesses) {
            for (int i = 0; i < p; i++)
                predicted_gaps[i] = gap[i] + dot(n, v->gap_rows + (size_t)i * n, d);
            if (solve_instant(s->contact_solver, predicted_gaps, NULL, s->is_closed, force))
                return step;
            subtract_rows(p, n, s->increment_per_force, force, d);
        }
        for (int j = 0; j < n; j++) q[j] += d[j];
    }
    return steps;
}

/* --- exponential steps ----------------------------------------------------------------------- */

/* Set y = E x. */
static void apply_transition(const exponential *s, const double *restrict x, double *restrict y)
{
    const int n = s->n_modes;
    if (s->has_coupled_modes) {
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
    const int n = s->n_modes, p = s->n_rows, pairs = s->friction_solver ? p / 2 : p;
    double *restrict z = s->work, *restrict predicted_state = z + 2 * n,
                     *restrict gap = predicted_state + 2 * n;
    double *restrict force_sum = gap + p;
    for (int j = 0; j < 2 * n; j++) z[j] = states[j] - s->steady_states[j];
    for (int step = 1; step <= steps; step++) {
        const size_t phase = step % s->n_instants;
        const double *last_forces = forces, *linear = s->steady_gap + phase * p;
        const double *steady = s->steady_states + phase * 2 * n;
        const signed char *guess = closed;
        states += 2 * n;
        forces += p;
        closed += pairs;
        /* s = Q (E z - G lambda) + l. */
        apply_transition(s, z, predicted_state);
        for (int i = 0; i < p; i++) {
            gap[i] = linear[i] + dot(n, s->gap_rows + (size_t)i * n, predicted_state) -
                     dot(p, s->gap_response + (size_t)i * p, last_forces);
        }
        memcpy(closed, guess, (size_t)pairs);
        if (s->friction_solver
                ? step_friction(s->friction_solver, s->sticking_places, closed, gap, forces)
                : solve_instant(s->contact_solver, gap, NULL, closed, forces))
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
