#include "march.h"

#include <math.h>
#include <string.h>

#include "lapack.h"

static const double ROUNDING = 1e-14; /* gaps relative to the largest one that count as zero */

/* y -= sum_i weight_i row_i with rows (p, n). */
static void take(int p, int n, const double *rows, const double *weight, double *restrict y)
{
    for (int i = 0; i < p; i++) {
        const double *row = rows + (size_t)i * n, w = weight[i];
        if (w == 0.0) continue;
        for (int j = 0; j < n; j++) y[j] -= w * row[j];
    }
}

/* y = m x, m by mode. */
static void times(const vibration *v, const double *m, const double *x, double *restrict y)
{
    if (v->coupled) {
        multiply(v->modes, v->modes, m, x, y);
        return;
    }
    for (int j = 0; j < v->modes; j++) y[j] = m[j] * x[j];
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

/* --- generalised alpha ----------------------------------------------------------------------- */

/* Mean of the penalty law's force between two gaps, (V(end) - V(start)) / (end - start), and its
 * derivative by the end. */
static double mean_force(double k, double start, double end, double *slope)
{
    if (start * end >= 0.0) { /* both closed, or both open: linear */
        const int closed = start + end > 0.0;
        *slope = closed ? 0.5 * k : 0.0;
        return closed ? 0.5 * k * (start + end) : 0.0;
    }
    const double above = fmax(start, 0.0), after = fmax(end, 0.0), change = end - start;
    const double mean = 0.5 * k * (after * after - above * above) / change;
    *slope = (k * after - mean) / change;
    return mean;
}

/* Forces of the penalty law in a step: what h = x leaves, and the derivative of h by the gap. */
static void unbalance(const generalised_alpha *s, const double *start, const double *free,
                      const double *x, double *reached, double *excess, double *slope)
{
    const int p = s->body.pairs;
    const double shift = 0.5 - s->af;
    multiply(p, p, s->compliance, x, reached);
    for (int i = 0; i < p; i++) {
        const double k = s->body.springs[i];
        reached[i] = free[i] - reached[i];
        double h = mean_force(k, start[i], reached[i], &slope[i]);
        h += shift * k * (fmax(reached[i], 0.0) - fmax(start[i], 0.0));
        if (reached[i] > 0.0) slope[i] += shift * k;
        excess[i] = x[i] - h;
    }
}

static double largest(int n, const double *x)
{
    double found = 0.0;
    for (int i = 0; i < n; i++) found = fmax(found, fabs(x[i]));
    return found;
}

/* Newton's method for h, in s->held: the minimum of a convex function, along whose slope a step
 * that goes too far is shortened. Returns 0, or 1 where it does not converge. */
static int held_forces(const generalised_alpha *s, const double *start, const double *free,
                       double *room)
{
    enum { MOST = 100, HALVINGS = 20 };
    const int p = s->body.pairs;
    double *x = s->held, *reached = room, *excess = reached + p, *slope = excess + p;
    double *change = slope + p, *moved = change + p, *trial = moved + p;
    unbalance(s, start, free, x, reached, excess, slope);
    for (int turn = 0; turn < MOST; turn++) {
        if (largest(p, excess) == 0.0) return 0;
        for (int i = 0; i < p; i++) {
            for (int j = 0; j < p; j++)
                s->matrix[i * p + j] = (i == j) + slope[i] * s->compliance[i * p + j];
            change[i] = -excess[i];
        }
        if (factor(p, s->matrix, s->pivots)) return 1;
        solve_factored(p, s->matrix, s->pivots, change);
        multiply(p, p, s->compliance, change, moved);
        double away = 0.0;
        for (int i = 0; i < p; i++) {
            away = fmax(away, fabs(free[i] - reached[i]));
            trial[i] = x[i] + change[i];
            if (!isfinite(change[i])) return 1;
        }
        if (largest(p, moved) <= ROUNDING * (largest(p, free) + away)) {
            memcpy(x, trial, p * sizeof(double));
            return 0;
        }
        const double before = dot(p, moved, excess);
        unbalance(s, start, free, trial, reached, excess, slope);
        if (before < 0.0 && dot(p, moved, excess) > -0.1 * before) {
            double low = 0.0, high = 1.0; /* the lowest point lies between */
            for (int half = 0; half < HALVINGS; half++) {
                const double share = 0.5 * (low + high);
                for (int i = 0; i < p; i++) trial[i] = x[i] + share * change[i];
                unbalance(s, start, free, trial, reached, excess, slope);
                if (dot(p, moved, excess) > 0.0) high = share;
                else low = share;
            }
        }
        memcpy(x, trial, p * sizeof(double));
    }
    return 1;
}

/* Impulses that keep the pairs that are closed at the end of a rigid step from closing further. */
static int stopping(const generalised_alpha *s, const double *velocity, double *rate, double *stop)
{
    const vibration *v = &s->body;
    const int n = v->modes, p = v->pairs;
    signed char *first = s->closed + p;
    int any = 0;
    for (int i = 0; i < p; i++) {
        rate[i] = s->closed[i] ? dot(n, v->rows + (size_t)i * n, velocity) : 0.0;
        first[i] = rate[i] > 0.0;
        any |= first[i];
        stop[i] = 0.0;
    }
    return any ? forces_at(s->stops, rate, ROUNDING, s->closed, first, stop) : 0;
}

int march_alpha(generalised_alpha *s, int first, int steps, double *gap, double *force,
                double *shape)
{
    const vibration *v = &s->body;
    const int n = v->modes, p = v->pairs;
    const double dt = s->dt, now = 1.0 - s->af, *load = v->load;
    double *restrict q = s->shape, *restrict u = s->velocity, *restrict a = s->acceleration;
    double *restrict moved = v->room, *restrict faster = moved + n, *restrict found = faster + n;
    double *restrict r = found + n, *restrict rate = r + n, *restrict drag = rate + n;
    double *room = drag + n;
    for (int step = 0; step < steps; step++, gap += p, force += p, shape += n) {
        const double *wave = v->waves + 3 * (size_t)(first + step);
        const double c = now * wave[4] + s->af * wave[1], b = now * wave[5] + s->af * wave[2];
        memcpy(shape, q, n * sizeof(double));
        gaps_of(v, q, gap);
        /* What Newmark's formulas know of q and v, and the acceleration without contact. */
        for (int j = 0; j < n; j++) {
            moved[j] = q[j] + dt * u[j] + dt * dt * (0.5 - s->beta) * a[j];
            faster[j] = u[j] + dt * (1.0 - s->gamma) * a[j];
            rate[j] = now * faster[j] + s->af * u[j];
        }
        times(v, s->damping, rate, drag);
        for (int j = 0; j < n; j++)
            r[j] = load[j] + c * load[n + j] + b * load[2 * n + j] - s->am * a[j] - drag[j]
                   - v->squares[j] * (now * moved[j] + s->af * q[j]);
        times(v, s->inverse, r, found);
        for (int j = 0; j < n; j++) r[j] = moved[j] + s->beta * dt * dt * found[j];
        double *free = room;
        gaps_of(v, r, free);
        if (v->springs) {
            penalty(v, gap, force);
            if (held_forces(s, gap, free, room + p)) return step;
        } else {
            if (forces_at(s->ends, free, ROUNDING, NULL, s->closed, s->held)) return step;
            take(p, n, s->kick, s->held, u);
            take(p, n, s->kick, s->held, faster);
            for (int i = 0; i < p; i++) free[i] = dt * s->held[i];
            take(p, n, s->kick, free, moved);
        }
        take(p, n, s->pull, s->held, found);
        for (int j = 0; j < n; j++) {
            q[j] = moved[j] + s->beta * dt * dt * found[j];
            faster[j] += s->gamma * dt * found[j];
            rate[j] = 0.5 * (u[j] + faster[j]);
        }
        times(v, s->damping, rate, drag);
        s->lost += dt * dot(n, rate, drag);
        if (!v->springs) {
            double *stop = room;
            if (stopping(s, faster, room + p, stop)) return step;
            take(p, n, s->kick, stop, faster);
            for (int i = 0; i < p; i++) force[i] = (s->held[i] + stop[i]) / dt;
        }
        memcpy(u, faster, n * sizeof(double));
        memcpy(a, found, n * sizeof(double));
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
