#include "march.h"

#include <string.h>

#include "lapack.h"
#include "rounding.h"

/* y -= sum_i weight_i row_i with rows (p, n). */
static void take(int p, int n, const double *rows, const double *weight, double *restrict y)
{
    for (int i = 0; i < p; i++) {
        const double *row = rows + (size_t)i * n, w = weight[i];
        if (w == 0.0) continue;
        for (int j = 0; j < n; j++) y[j] -= w * row[j];
    }
}

/* y = P^T q - g0. */
static void gaps_of(const vibration *v, const double *q, double *y)
{
    for (int i = 0; i < v->pairs; i++)
        y[i] = dot(v->modes, v->rows + (size_t)i * v->modes, q) - v->clearance[i];
}

static void penalty(const vibration *v, const double *gap, double *force)
{
    for (int i = 0; i < v->pairs; i++) force[i] = gap[i] > 0.0 ? v->springs[i] * gap[i] : 0.0;
}

/* --- central differences --------------------------------------------------------------------- */

int march_central(const central_differences *s, int first, int steps, double *gap, double *force,
                  double *shape)
{
    const vibration *v = &s->body;
    const int n = v->modes, p = v->pairs;
    const double *mean = v->load, *cosine = mean + n, *sine = cosine + n;
    double *restrict q = s->shape, *restrict d = s->increment;
    double *restrict r = v->room, *restrict a = r + n, *restrict reached = a + n;
    for (int step = 0; step < steps; step++, gap += p, force += p, shape += n) {
        const double *wave = v->waves + 3 * (size_t)(first + step);
        memcpy(shape, q, n * sizeof(double));
        gaps_of(v, q, gap);
        /* r = f - w^2 q - P lambda. */
        for (int j = 0; j < n; j++)
            r[j] = mean[j] + wave[1] * cosine[j] + wave[2] * sine[j] - v->squares[j] * q[j];
        if (v->springs) {
            penalty(v, gap, force);
            take(p, n, v->rows, force, r);
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
                reached[i] = gap[i] + dot(n, v->rows + (size_t)i * n, d);
            if (forces_at(s->contact, reached, ROUNDING, NULL, s->closed, force)) return step;
            take(p, n, s->push, force, d);
        }
        for (int j = 0; j < n; j++) q[j] += d[j];
    }
    return steps;
}

/* --- exponential steps ----------------------------------------------------------------------- */

/* y = E x with x, y (2 n, w). */
static void transition(const exponential *s, int w, const double *restrict x, double *restrict y)
{
    const int n = s->modes;
    if (s->coupled) {
        if (w == 1) multiply(2 * n, 2 * n, s->moved, x, y);
        else multiply_matrices(2 * n, 2 * n, w, s->moved, x, 0.0, y);
        return;
    }
    const double *qq = s->moved, *qv = qq + n, *vq = qv + n, *vv = vq + n;
    for (int j = 0; j < n; j++) {
        const double *q = x + (size_t)j * w, *v = q + (size_t)n * w;
        double *to = y + (size_t)j * w, *rate = to + (size_t)n * w;
        for (int i = 0; i < w; i++) to[i] = qq[j] * q[i] + qv[j] * v[i];
        for (int i = 0; i < w; i++) rate[i] = vq[j] * q[i] + vv[j] * v[i];
    }
}

int march_exponential(const exponential *s, int steps, double *states, double *forces,
                      signed char *closed)
{
    const int n = s->modes, p = s->pairs;
    double *restrict z = s->room, *restrict reached = z + 2 * n, *restrict gap = reached + 2 * n;
    double *restrict both = gap + p;
    for (int j = 0; j < 2 * n; j++) z[j] = states[j] - s->steady[j];
    for (int step = 1; step <= steps; step++) {
        const size_t phase = step % s->instants;
        const double *before = forces, *linear = s->linear + phase * p;
        const double *steady = s->steady + phase * 2 * n;
        const signed char *guess = closed;
        states += 2 * n;
        forces += p;
        closed += p;
        /* s = Q (E z - G lambda) + l. */
        transition(s, 1, z, reached);
        for (int i = 0; i < p; i++) {
            gap[i] = linear[i] + dot(n, s->rows + (size_t)i * n, reached)
                     - dot(p, s->gaps + (size_t)i * p, before);
            closed[i] = guess[i];
        }
        if (forces_at(s->contact, gap, ROUNDING, NULL, closed, forces)) return step - 1;
        for (int i = 0; i < p; i++) both[i] = before[i] + forces[i];
        take(p, 2 * n, s->pushed, both, reached);
        for (int j = 0; j < 2 * n; j++) {
            z[j] = reached[j];
            states[j] = z[j] + steady[j];
        }
    }
    return steps;
}

/* x -= G_A (D_AA)^-1 Q_A source with x, source (2 n, w); A: closed. */
static int push(const exponential *s, sets *kept, const signed char *closed, int w,
                const double *source, double *x, double *work)
{
    const int n = s->modes, p = s->pairs;
    int size = 0;
    for (int i = 0; i < p; i++) size += closed[i];
    if (!size) return 0;
    const double *answer = answer_of(kept, closed);
    if (!answer) return 1;
    double *rows = work, *inverse = rows + (size_t)p * 2 * n, *gap = inverse + (size_t)p * p;
    double *force = gap + (size_t)p * w;
    for (int i = 0, a = 0; i < p; i++) {
        if (!closed[i]) continue;
        memcpy(rows + (size_t)a * n, s->rows + (size_t)i * n, n * sizeof(double));
        for (int k = 0, b = 0; k < p; k++)
            if (closed[k]) inverse[a * size + b++] = answer[i * p + k];
        a++;
    }
    multiply_matrices(size, n, w, rows, source, 0.0, gap);
    multiply_matrices(size, size, w, inverse, gap, 0.0, force);
    for (int j = 0; j < 2 * n; j++)
        for (int i = 0, a = 0; i < p; i++)
            if (closed[i]) rows[j * size + a++] = -s->pushed[(size_t)i * 2 * n + j];
    multiply_matrices(2 * n, size, w, rows, force, 1.0, x);
    return 0;
}

/* x = (tangent of a step) x between sets of closed pairs. */
static int tangent(const exponential *s, const signed char *before, const signed char *after,
                   double *x, double *moved, double *work)
{
    const int w = 2 * s->modes;
    transition(s, w, x, moved);
    if (push(s, s->now, before, w, x, moved, work)) return 1;
    memcpy(x, moved, (size_t)w * w * sizeof(double));
    return push(s, s->contact, after, w, moved, x, work);
}

/* x = y x; work: room for a matrix. */
static void compose(int w, const double *y, double *x, double *work)
{
    multiply_matrices(w, w, w, y, x, 0.0, work);
    memcpy(x, work, (size_t)w * w * sizeof(double));
}

int tangent_of_steps(const exponential *s, int steps, const signed char *closed, double *product,
                     double *work)
{
    enum { SHORT = 12 }; /* equal steps that are not worth a power */
    const int p = s->pairs, w = 2 * s->modes;
    const size_t whole = (size_t)w * w;
    double *moved = work, *power = moved + whole, *rest = power + whole;
    for (int step = 0, equal; step < steps; step += equal) {
        const signed char *here = closed + (size_t)step * p;
        for (equal = 0; step + equal < steps; equal++)
            if (p && memcmp(here, here + (size_t)(equal + 1) * p, p)) break;
        if (equal <= SHORT) {
            if (!equal) equal = 1;
            for (int k = 0; k < equal; k++, here += p)
                if (tangent(s, here, here + p, product, moved, rest)) return 1;
            continue;
        }
        for (size_t i = 0; i < whole; i++) power[i] = i % (w + 1) == 0;
        if (tangent(s, here, here, power, moved, rest)) return 1;
        for (int left = equal; left; left >>= 1) {
            if (left & 1) compose(w, power, product, moved);
            if (left > 1) compose(w, power, power, moved);
        }
    }
    return 0;
}
