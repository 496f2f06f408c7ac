#include "events.h"

#include <complex.h>
#include <math.h>
#include <string.h>

#include "lapack.h"

/* Weights below this are nothing, and would be slow. Grid points between looks at them. */
static const double TINY = 1e-200;
enum { BLOCK = 64 };

/* Where a search stands: weights at its start. */
typedef struct {
    const exact_flow *flow;
    const regime *r;
    double start;
    const double *first;
    double *room; /* size */
} search;

/* y = exp(L t) x. */
static void carry(const regime *r, double t, const double *x, double *y)
{
    const int m = r->turning;
    for (int j = 0; j < m; j++) {
        const double size = exp(r->decay[j] * t);
        const double c = size * cos(r->turn[j] * t), s = size * sin(r->turn[j] * t);
        const double one = x[j], two = x[m + j];
        y[j] = c * one + s * two;
        y[m + j] = c * two - s * one;
    }
    for (int j = 2 * m; j < r->size; j++) y[j] = exp(r->decay[j] * t) * x[j];
}

/* Factors of the same: c, s (m) and those of the others (r). */
static void factors(const regime *r, double t, double *c, double *s, double *others)
{
    for (int j = 0; j < r->turning; j++) {
        const double size = exp(r->decay[j] * t);
        c[j] = size * cos(r->turn[j] * t);
        s[j] = size * sin(r->turn[j] * t);
    }
    for (int j = 2 * r->turning; j < r->size; j++) *others++ = exp(r->decay[j] * t);
}

static void turn_by(const regime *r, const double *restrict c, const double *restrict s,
                    const double *restrict others, double *restrict y)
{
    const int m = r->turning;
    double *restrict z = y + m;
    for (int j = 0; j < m; j++) {
        const double one = y[j], two = z[j];
        y[j] = c[j] * one + s[j] * two;
        z[j] = c[j] * two - s[j] * one;
    }
    for (int j = 2 * m; j < r->size; j++) y[j] *= *others++;
}

/* A derivative of a pair's signed gap from the weights, with the load's cosine and sine. */
static double gap_of(const search *s, int pair, int order, const double *y, double cosine,
                     double sine)
{
    const double *forced = s->r->forced + 3 * pair, w = s->flow->omega;
    const double free = dot(s->r->size, s->r->free + (size_t)(order * s->flow->pairs + pair)
                                                         * s->r->size, y);
    if (order == 0) return free + forced[0] + forced[1] * cosine + forced[2] * sine;
    if (order == 1) return free + w * (forced[2] * cosine - forced[1] * sine);
    return free - w * w * (forced[1] * cosine + forced[2] * sine);
}

static double at(const search *s, int pair, int order, double t, double *slope)
{
    const double phase = s->flow->omega * (s->start + t), c = cos(phase), d = sin(phase);
    carry(s->r, t, s->first, s->room);
    if (slope) *slope = gap_of(s, pair, order + 1, s->room, c, d);
    return gap_of(s, pair, order, s->room, c, d);
}

/* What rounding leaves of a gap. */
static double rounding(const search *s, int pair)
{
    const double *row = s->r->free + (size_t)pair * s->r->size, *forced = s->r->forced + 3 * pair;
    double size = fabs(forced[0]) + hypot(forced[1], forced[2]);
    for (int j = 0; j < s->r->size; j++) size += fabs(row[j] * s->first[j]);
    return 1e-14 * size;
}

/* Where a gap (order 0) or its slope (1) vanishes between instants at which its signs differ:
 * Newton's method, kept in the bracket by bisection. */
static double zero_of(const search *s, int pair, int order, double low, double high)
{
    double slope, root = 0.5 * (low + high);
    const int rises = at(s, pair, order, high, NULL) > 0.0;
    for (int turn = 0; turn < 100 && high - low > 1e-16 * high; turn++) {
        const double now = at(s, pair, order, root, &slope);
        if (now == 0.0) return root;
        if ((now > 0.0) == rises) high = root;
        else low = root;
        const double newton = root - now / slope;
        if (newton > low && newton < high) {
            if (fabs(newton - root) <= 1e-11 * high) return newton;
            root = newton;
        } else {
            /* At the root but for rounding, or too far away. */
            if (fabs(newton - root) <= 1e-14 * high) return root;
            root = 0.5 * (low + high);
        }
    }
    return root;
}

/* Root of a gap that is inside at `low` and outside at `high`. */
static double crossing(const search *s, int pair, double low, double high)
{
    if (at(s, pair, 0, low, NULL) >= 0.0) return low;
    if (at(s, pair, 0, high, NULL) <= 0.0) return high; /* but for rounding */
    return zero_of(s, pair, 0, low, high);
}

/* When a pair that has switched at time 0 switches back before `high`, or NAN. It goes in first and
 * comes out again, so there is an extreme between. */
static double back_again(const search *s, int pair, double high)
{
    if (at(s, pair, 1, 0.0, NULL) >= 0.0 || at(s, pair, 1, high, NULL) <= 0.0) return NAN;
    const double deepest = zero_of(s, pair, 1, 0.0, high);
    if (!(at(s, pair, 0, deepest, NULL) < 0.0 && at(s, pair, 0, high, NULL) > 0.0)) return NAN;
    return crossing(s, pair, deepest, high);
}

/* When a pair leaves its state in a cell of the grid, from gaps and slopes at its ends; or NAN. */
static double leaves(const search *s, int pair, int switched, double low, const double *value,
                     const double *slope)
{
    double high = low + s->r->step;
    if (!(value[0] <= 0.0 && value[1] > 0.0)) {
        /* Both ends inside, but a summit between them may reach out. */
        if (!(slope[0] > 0.0 && slope[1] < 0.0 && value[0] + s->r->step * slope[0] > 0.0))
            return NAN;
        if (!(at(s, pair, 1, low, NULL) > 0.0 && at(s, pair, 1, high, NULL) < 0.0)) return NAN;
        high = zero_of(s, pair, 1, low, high);
        if (at(s, pair, 0, high, NULL) <= rounding(s, pair)) return NAN;
    }
    return pair == switched && low == 0.0 ? back_again(s, pair, high)
                                          : crossing(s, pair, low, high);
}

/* The first pair that changes its state, and when; -1 and the duration if none does. The grid
 * resolves the fastest mode, and the slopes show extremes between its points. */
static int next_event(const search *s, double duration, int switched, double *room, double *when)
{
    const int p = s->flow->pairs, size = s->r->size, m = s->r->turning;
    double *y = room, *c = y + size, *d = c + m, *others = d + m;
    double *value = others + size, *slope = value + 2 * p;
    memcpy(y, s->first, size * sizeof(double));
    factors(s->r, s->r->step, c, d, others);
    for (long point = 0; p; point++) {
        const double t = s->r->step * point, phase = s->flow->omega * (s->start + t);
        const double cosine = cos(phase), sine = sin(phase);
        int found = -1;
        if (point) turn_by(s->r, c, d, others, y);
        if (point % BLOCK == 0)
            for (int j = 0; j < size; j++)
                if (fabs(y[j]) < TINY) y[j] = 0.0;
        for (int i = 0; i < p; i++) {
            value[2 * i] = value[2 * i + 1];
            slope[2 * i] = slope[2 * i + 1];
            value[2 * i + 1] = gap_of(s, i, 0, y, cosine, sine);
            slope[2 * i + 1] = gap_of(s, i, 1, y, cosine, sine);
            if (!point) { /* all are in their states: what is outside is rounding */
                value[2 * i + 1] = i == switched ? 0.0 : fmin(value[2 * i + 1], 0.0);
                continue;
            }
            const double root =
                leaves(s, i, switched, s->r->step * (point - 1), value + 2 * i, slope + 2 * i);
            if (isnan(root) || (found >= 0 && root >= *when)) continue;
            found = i;
            *when = root;
        }
        if (found >= 0 && *when < duration) return found;
        if (found >= 0 || t >= duration) break;
    }
    *when = duration;
    return -1;
}

/* Weights at the instants of an interval. */
static void sample(const regime *r, motion *m, double end, int last,
                   const double *first, double *room)
{
    const int size = r->size;
    double *c = room, *s = c + r->turning, *others = s + r->turning;
    int known = 0;
    for (; m->sampled < m->count; m->sampled++) {
        const double t = m->instants[m->sampled];
        double *y = m->weights + (size_t)m->sampled * size;
        if (!last && t >= end) break;
        m->sets[m->sampled] = m->closed;
        if (known && m->spacing > 0.0) {
            if (known++ == 1) factors(r, m->spacing, c, s, others);
            memcpy(y, y - size, size * sizeof(double));
            turn_by(r, c, s, others, y);
        } else {
            carry(r, t - m->now, first, y);
            known = 1;
        }
        if (m->sampled % BLOCK == 0)
            for (int j = 0; j < size; j++)
                if (fabs(y[j]) < TINY) y[j] = 0.0;
    }
}

static void steady(const exact_flow *f, const regime *r, double time, double sign, double *z)
{
    const double c = cos(f->omega * time), s = sin(f->omega * time);
    const double *mean = r->steady, *cosine = mean + r->size, *sine = cosine + r->size;
    for (int j = 0; j < r->size; j++) z[j] += sign * (mean[j] + c * cosine[j] + s * sine[j]);
}

int closed_at(const exact_flow *f, const double *state)
{
    const int half = f->size / 2;
    double largest = 0.0, farthest = 0.0;
    int closed = 0;
    for (int i = 0; i < f->pairs * half; i++) largest = fmax(largest, fabs(f->rows[i]));
    for (int i = 0; i < f->size; i++) farthest = fmax(farthest, fabs(state[i]));
    for (int pair = 0; pair < f->pairs; pair++) {
        const double *row = f->rows + (size_t)pair * half;
        const double gap = dot(half, row, state) - f->clearance[pair];
        const int grazes = fabs(gap) <= 1e-14 * largest * farthest;
        const double inside = grazes ? dot(half, row, state + half) : gap;
        if (inside > 0.0) closed |= 1 << pair;
    }
    return closed;
}

void respond_to_load(const exact_flow *f, regime *r)
{
    const int m = r->turning, size = r->size;
    double *cosine = f->room, *sine = cosine + size;
    const double *load = r->load, w = f->omega;
    for (int j = 0; j < size; j++) {
        const int turns = j < m, second = turns ? m + j : j;
        const double b = turns ? r->turn[j] : 0.0;
        const double complex left = I * w - r->decay[j];
        const double complex one = load[j] - I * load[size + j];
        const double complex two = load[second] - I * load[size + second];
        double complex y = 0.0, z = 0.0; /* without a load there is none, on resonance either */
        if (j >= m && j < 2 * m) continue; /* done with its first one */
        if (one != 0.0 || two != 0.0) {
            const double complex square = left * left + b * b;
            y = turns ? (left * one + b * two) / square : one / left;
            z = (left * two - b * one) / square;
        }
        cosine[j] = creal(y), sine[j] = -cimag(y);
        if (turns) cosine[second] = creal(z), sine[second] = -cimag(z);
    }
    multiply(size, size, r->vectors, cosine, r->steady + size);
    multiply(size, size, r->vectors, sine, r->steady + 2 * size);
    for (int pair = 0; pair < f->pairs; pair++) {
        r->forced[3 * pair + 1] = dot(size, r->free + (size_t)pair * size, cosine);
        r->forced[3 * pair + 2] = dot(size, r->free + (size_t)pair * size, sine);
    }
    r->omega = w;
}

void set_frequency(exact_flow *f, double omega)
{
    f->omega = omega;
    for (long set = 0; set < 1L << f->pairs; set++)
        if (f->known[set] && f->known[set]->omega != omega) respond_to_load(f, f->known[set]);
}

int follow_exactly(const exact_flow *f, motion *m, double longest)
{
    const int size = f->size;
    double *first = f->room, *y = first + size, *room = y + size;
    while (1) {
        const regime *r = f->known[m->closed];
        if (!r) return UNKNOWN;
        if (m->passed == m->most) return FULL;
        if (!((m->end - m->now) / r->step < longest)) return FAST;
        /* y = V^-1 (z - z_p). */
        steady(f, r, m->now, -1.0, m->state);
        multiply(size, size, r->inverse, m->state, first);
        const search s = {f, r, m->now, first, y};
        double length = 0.0;
        const int pair = next_event(&s, m->end - m->now, m->switched, room, &length);
        sample(r, m, m->now + length, pair < 0, first, room);
        carry(r, length, first, y);
        m->now += length;
        multiply(size, size, r->vectors, y, m->state);
        steady(f, r, m->now, 1.0, m->state);
        m->passed_sets[m->passed] = m->closed;
        m->lengths[m->passed++] = length;
        m->switched = pair;
        if (pair < 0) return DONE;
        m->closed ^= 1 << pair;
        m->events++;
    }
}

/* Rows of weights (size, size) move as weights do. */
static void turn_rows(const regime *r, double length, double *weights, double *room)
{
    const int size = r->size, m = r->turning;
    double *c = room, *s = c + m, *others = s + m;
    factors(r, length, c, s, others);
    for (int j = 0; j < m; j++) {
        double *restrict one = weights + (size_t)j * size;
        double *restrict two = one + (size_t)m * size;
        for (int i = 0; i < size; i++) {
            const double x = one[i], z = two[i];
            one[i] = c[j] * x + s[j] * z;
            two[i] = c[j] * z - s[j] * x;
        }
    }
    for (int j = 2 * m; j < size; j++)
        for (int i = 0; i < size; i++) weights[(size_t)j * size + i] *= others[j - 2 * m];
}

/* From the weights of one set to those of the next, which differs in one pair; NULL: not known. */
static const double *between(const regime *r, int change)
{
    int pair = 0;
    while (change >> pair > 1) pair++;
    return change == 1 << pair ? r->into[pair] : NULL;
}

void derivative_of(const exact_flow *f, int intervals, const int *sets, const double *lengths,
                   double *product, double *work)
{
    const int size = f->size;
    double *now = work, *next = product, *room = work + (size_t)size * size;
    if (!intervals) return;
    /* ... V exp(L t) V^-1 V_0 exp(L_0 t_0) V_0^-1 product. */
    multiply_matrices(size, size, size, f->known[sets[0]]->inverse, product, 0.0, now);
    for (int k = 0; k < intervals; k++) {
        const regime *r = f->known[sets[k]];
        const int last = k + 1 == intervals;
        const double *change = last ? r->vectors : between(r, sets[k] ^ sets[k + 1]);
        turn_rows(r, lengths[k], now, room);
        if (change) {
            multiply_matrices(size, size, size, change, now, 0.0, next);
            double *other = now;
            now = next, next = other;
            continue;
        }
        multiply_matrices(size, size, size, r->vectors, now, 0.0, next);
        multiply_matrices(size, size, size, f->known[sets[k + 1]]->inverse, next, 0.0, now);
    }
    if (now != product) memcpy(product, now, (size_t)size * size * sizeof(double));
}
