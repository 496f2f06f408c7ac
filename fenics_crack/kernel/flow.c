#include "flow.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "closed_sets.h"
#include "exponential.h"
#include "lapack.h"
#include "rounding.h"
#include "series.h"

/* Steps of the search for events in a piece, at most. */
enum { MAX_SEARCH_STEPS = STEPS_PER_RADIAN * MAX_PIECE_ANGLE };

struct flow {
    flow_parts of;
    int order; /* of the series of a piece */
    closed_sets *known;
    exponentials *exponential;
    double *room;
    double *columns;                 /* (m, p) P */
    double *weights;                 /* (TERMS, loads) of the load's rows */
    int rows;                        /* of contact, r */
    int loads;                       /* rows of the load, 2 K + 1 */
    double *series, *gaps, *answers; /* (TERMS, m), (TERMS, r), (TERMS, r) of q, s, i */
    double *forces, *reached;        /* (TERMS, r) of lambda and g, with friction only */
    double *held;                    /* (p) h */
    double *allowed;                 /* (r) what of a negative answer is rounding */
    double *value, *falling;         /* (STEPS + 1, r) answers at steps' ends; (r) */
    double *near, *force;            /* (r) s of a state, its forces */
    double *seen, *drag;             /* (r), (m) */
    double *turned;                  /* (loads, m + r) derivative of the load */
    double *pulled;                  /* (loads, m) of a load, (loads, r) */
    double *source, *motion;         /* (TERMS, m), (TERMS + 2, m) of another series */
    signed char *closed;             /* (p) */
    signed char *zeros;              /* (r) first terms of answers that are 0 by how a state began */
    double length, slope, fell;      /* of the piece; of the answer that fell first at an instant */
};

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

static long numbers_of_state(const flow *f)
{
    return 2L * f->of.modes + (f->of.friction ? f->of.pairs : 0);
}

/* A set turns no faster, nor does the load: contact may be stiffer than all modes. */
static double fastest(const flow *f, const closed_set *a, double omega)
{
    return fmax(fmax(a->size ? f->of.max_rate : f->of.max_open_rate, f->of.harmonics * omega), 1e-300);
}

/* y = C x of a damping. */
static void damp(const flow *f, const double *damping, const double *x, double *y)
{
    const int m = f->of.modes;
    if (f->of.coupled) multiply(m, m, damping, x, y);
    else
        for (int j = 0; j < m; j++) y[j] = damping[j] * x[j];
}

/* --- the series ------------------------------------------------------------------------------- */

/* Coefficients of the load's rows from a time on, in parts of a length; with `by_time` those of the
 * load times the time. */
static void wave(flow *f, double omega, double now, double length, int by_time)
{
    const int loads = f->loads;
    for (int k = 1; 2 * k < loads; k++) {
        const double own = k * omega, c = cos(own * now), s = sin(own * now);
        double *w = f->weights + 2 * k - 1, size = 1.0;
        for (int n = 0; n <= f->order; n++, w += loads) {
            const double sign = n & 2 ? -size : size;
            w[0] = n & 1 ? -sign * s : sign * c;
            w[1] = n & 1 ? sign * c : sign * s;
            size *= own * length / (n + 1);
        }
    }
    for (int n = 0; n <= f->order; n++) f->weights[n * loads] = n == 0;
    if (!by_time) return;
    for (int n = f->order; n >= 0; n--)
        for (int k = 0; k < loads; k++) {
            double *own = f->weights + n * loads + k;
            *own = now * *own + (n ? length * *(own - loads) : 0.0);
        }
}

/* Of a series over a length, times the largest frequency x, behind which the terms are rounding:
 * x^n / n!. */
static int order_for(double x)
{
    double term = 1.0;
    int n = 0;
    while (n < ORDER && term > 1e-18) term *= x / ++n;
    return n;
}

/* pulled = what a load and its gaps, through the forces of the closed pairs, drive. */
static void pull(flow *f, const closed_set *a, const double *force, const double *gap)
{
    const int m = f->of.modes, size = a->size;
    double *closed = f->pulled + f->loads * m;
    for (int k = 0, at = 0; k < f->loads; k++)
        for (int i = 0; i < size; i++) closed[at++] = gap[k * f->rows + a->members[i]];
    multiply_matrices(f->loads, size, m, closed, a->pushed, 0.0, f->pulled);
    for (int j = 0; j < f->loads * m; j++) f->pulled[j] = force[j] - f->pulled[j];
}

/* next += gain times what the places push at which pairs stick. */
static void hold(flow *f, const closed_set *a, double gain, double *next)
{
    const int m = f->of.modes, closing = a->closing, count = a->size - closing;
    for (int i = 0; i < count; i++)
        f->seen[i] = gain * f->held[a->members[closing + i] - f->of.pairs];
    add_rows(count, m, a->pushed + (long)closing * m, f->seen, next);
}

/* Series of q of a piece, from a state; with `sources`, a load (TERMS, m) is added. */
WIDE static void expand(flow *f, const closed_set *a, const double *force, const double *gap,
                        const double *sources, double length, const double *state)
{
    const int m = f->of.modes, size = a->size;
    const double *restrict squares = f->of.squares;
    const double *restrict cosine = f->pulled + m, *restrict sine = cosine + m;
    double *restrict seen = f->seen, *restrict drag = f->drag;
    pull(f, a, force, gap);
    memcpy(f->series, state, bytes(m));
    for (int j = 0; j < m; j++) f->series[m + j] = length * state[m + j];
    for (int n = 0; n + 2 <= f->order; n++) {
        const double *restrict now = f->series + (long)n * m, *restrict rate = now + m;
        double *restrict next = f->series + (long)(n + 2) * m;
        const double gain = length * length / ((n + 1) * (n + 2)), loss = length / (n + 2);
        const double *w = f->weights + n * f->loads;
        const double mean = gain * w[0], c = gain * w[1], s = gain * w[2];
        damp(f, f->of.damping, rate, drag);
        for (int j = 0; j < m; j++)
            next[j] = c * cosine[j] + s * sine[j] - gain * squares[j] * now[j] - loss * drag[j];
        if (mean != 0.0) add_rows(1, m, f->pulled, &mean, next);
        for (int k = 3; k < f->loads; k++) {
            const double weight = gain * w[k];
            add_rows(1, m, f->pulled + (long)k * m, &weight, next);
        }
        if (sources) add_rows(1, m, sources + (long)n * m, &gain, next);
        if (n == 0 && f->of.friction) hold(f, a, gain, next);
        if (a->stiffness) {
            for (int j = 0; j < m; j++) drag[j] = -gain * now[j];
            add_rows(m, m, a->stiffness, drag, next);
        } else if (size) {
            memset(seen, 0, bytes(size));
            add_rows(m, size, a->pairs, now, seen);
            for (int i = 0; i < size; i++) seen[i] *= -gain;
            add_rows(size, m, a->pushed, seen, next);
        }
    }
}

/* Answers with friction, whose first terms are 0 where a state has just begun so. */
static void answer_states(flow *f, const closed_set *a)
{
    const int p = f->of.pairs, r = f->rows, terms = f->order + 1;
    for (int i = 0; i < p; i++) {
        const int state = a->closed[i];
        const double mu = f->of.friction[i], way = state == SLIP_UP ? 1.0 : -1.0;
        for (int n = 0; n < terms; n++) {
            const double *force = f->forces + (long)n * r, *gap = f->reached + (long)n * r;
            double *one = f->answers + (long)n * r + i, *other = one + p;
            if (state == OPEN) {
                *one = -gap[i];
                *other = n == 0;
            } else if (state == STICK) {
                *one = mu * force[i] - force[p + i];
                *other = mu * force[i] + force[p + i];
            } else {
                *one = force[i];
                *other = n + 1 < terms ? way * (n + 1) * gap[r + p + i] : 0.0;
            }
        }
    }
    for (int k = 0; k < r; k++)
        for (int n = 0; n < f->zeros[k]; n++) f->answers[(long)n * r + k] = 0.0;
}

/* Series of the gaps s and of the answers, and what is rounding in these where the series holds. */
static void answer(flow *f, const closed_set *a, const double *gap)
{
    const int m = f->of.modes, r = f->rows, terms = f->order + 1;
    multiply_matrices(terms, f->loads, r, f->weights, gap, 0.0, f->gaps);
    multiply_matrices(terms, m, r, f->series, f->columns, 1.0, f->gaps);
    if (!f->of.friction) {
        make_answers(f->known, a, terms, f->gaps, f->answers);
        return;
    }
    memcpy(f->reached, f->gaps, bytes((long)terms * r));
    solve_friction_forces(f->known, a, terms, f->held, f->reached, f->forces);
    answer_states(f, a);
}

static void round_off(flow *f, const closed_set *a, double length)
{
    const double largest = series_size(f->rows, f->order, f->gaps, length);
    for (int i = 0; i < f->rows; i++) f->allowed[i] = ZERO_TOLERANCE * largest * a->scale[i];
}

static void state_at(const flow *f, double length, double time, double *state)
{
    const int m = f->of.modes;
    series_at(m, f->order, f->series, time, state, state + m);
    for (int j = m; j < 2 * m; j++) state[j] /= length;
}

/* --- events ----------------------------------------------------------------------------------- */

/* When an answer becomes negative in a step of the search, from its values at the ends; NAN: it does
 * not, or not before another one. Where several change at one instant, as in mirror images, each of
 * the others is found to fall from zero in a next piece: one is changed after the other, the first of
 * them first, which ends (Murty, Opsearch 11 (1974) 90). */
static double falls(const flow *f, int pair, double low, double high, double before, double first,
                    double last)
{
    const int p = f->rows;
    double other, bottom, fall, rise;
    /* Rates jump where another pair leaves its state. */
    if (f->of.friction && first < -f->allowed[pair]) return fmax(low, ROUNDING);
    if (last >= -f->allowed[pair]) {
        /* Both ends positive, but a minimum between them may not be. */
        column_at(p, f->order, f->answers, pair, 0, low, &fall);
        column_at(p, f->order, f->answers, pair, 0, high, &rise);
        if (!(fall < 0.0 && rise > 0.0 && first + (high - low) * fall < 0.0)) return NAN;
        high = column_zero(p, f->order, f->answers, pair, 1, low, high);
        bottom = column_at(p, f->order, f->answers, pair, 0, high, &other);
        if (bottom >= -f->allowed[pair]) return NAN;
    }
    if (first <= f->allowed[pair]) {
        low = fmax(low, ROUNDING); /* the time of pairs that should have changed with the one before */
        if (low >= high || column_at(p, f->order, f->answers, pair, 0, low, &other) <= 0.0) return low;
    }
    if (before < high) {
        if (column_at(p, f->order, f->answers, pair, 0, before, &other) > 0.0) return NAN;
        high = before;
    }
    return column_zero(p, f->order, f->answers, pair, 0, low, high);
}

/* Whether one of the answers (p) may be negative in a step, and which, from values at its ends and at
 * four ends of steps in a row about it: an answer that is at the end, or that may bend to there:
 * between two values it falls below both by an eighth of the second difference at most; twice that
 * is allowed for. */
WIDE static int may_fall(int p, const double *restrict low, const double *restrict high,
                         const double *restrict around, double *restrict found)
{
    const double *one = around + p, *two = one + p, *last = two + p;
    double count = 0.0;
    for (int i = 0; i < p; i++) {
        const double bend = fabs(around[i] - 2.0 * one[i] + two[i]);
        const double other = fabs(one[i] - 2.0 * two[i] + last[i]);
        const double left = low[i] < high[i] ? low[i] : high[i];
        const double most = 0.25 * (bend > other ? bend : other);
        found[i] = high[i] < 0.0 || left < most ? 1.0 : 0.0;
        count += found[i];
    }
    return count > 0.0;
}

/* The answer that falls first, and when; -1: none before `end`. */
static int next_event(flow *f, double step, double end, double *when)
{
    const int p = f->rows;
    const int steps = (int)fmin(fmax(ceil(end / step), 3), MAX_SEARCH_STEPS); /* three show how answers bend */
    double at[MAX_TIMES];
    for (int k = 0; k <= steps; k++) at[k] = k < steps ? k * end / steps : end;
    values_at(p, f->order, f->answers, steps + 1, at, f->value);
    for (int k = 0; k < steps && p; k++) {
        const double *low = f->value + (long)k * p, *high = low + p;
        const int around = k == 0 ? 0 : k + 3 <= steps ? k - 1 : steps - 3;
        int found = -1;
        if (!may_fall(p, low, high, f->value + (long)around * p, f->falling)) continue;
        for (int i = 0; i < p; i++) {
            if (f->falling[i] == 0.0) continue;
            const double before = found >= 0 ? *when : INFINITY;
            const double root = falls(f, i, at[k], at[k + 1], before, low[i], high[i]);
            if (isnan(root) || (found >= 0 && root >= *when)) continue;
            found = i;
            *when = root;
        }
        if (found >= 0) return found;
    }
    return -1;
}

/* --- motions ---------------------------------------------------------------------------------- */

/* The gaps s of a state. */
static void gaps_at(flow *f, double omega, double time, const double *state)
{
    wave(f, omega, time, 0.0, 0);
    multiply(f->rows, f->of.modes, f->of.rows, state, f->near);
    add_rows(f->loads, f->rows, f->of.gap, f->weights, f->near);
}

/* The set of closed pairs of a state, from a guess or, with NULL, from its gaps; and their forces.
 * Returns 1 where none answers it. */
static int contact_at(flow *f, double omega, double time, const double *state,
                      const signed char *guess)
{
    const int m = f->of.modes, p = f->of.pairs;
    gaps_at(f, omega, time, state);
    for (int i = 0; i < p; i++) f->closed[i] = guess ? guess[i] : f->near[i] > 0.0;
    if (f->of.friction) {
        memcpy(f->held, state + 2 * m, bytes(p));
        return !find_states(f->known, f->held, f->closed, f->near, f->force);
    }
    if (!find_closed_set(f->known, f->near, f->closed, f->force)) return 1;
    for (int i = 0; i < p; i++)
        if (!f->closed[i]) f->force[i] = 0.0;
    return 0;
}

/* The motion at the instants up to the end of a piece. */
static void sample(const flow *f, flow_motion *m, const signed char *closed, double length,
                   double end, int last)
{
    const int n = f->of.modes, p = f->of.pairs, r = f->rows, both = f->of.friction ? 2 * r : p;
    for (; m->n_samples < m->n_instants; m->n_samples++) {
        const double at = fmax(0.0, (m->instants[m->n_samples] - m->time) / length);
        const double time = fmin(at, end);
        const long row = m->n_samples;
        double *found = m->answers + row * both;
        if (!last && at >= end) break;
        state_at(f, length, time, m->states + row * 2 * n);
        series_at(r, f->order, f->of.friction ? f->forces : f->answers, time, found, f->value);
        if (f->of.friction) series_at(r, f->order, f->reached, time, found + r, f->value);
        memcpy(m->closed + row * p, closed, (size_t)p);
    }
}

/* Another piece of the track, in the last interval or in a new one. */
static void passed(const flow *f, flow_motion *m, const signed char *closed, double length)
{
    const int p = f->of.pairs, last = m->n_intervals - 1;
    const int goes_on = f->of.friction ? last >= 0 && m->causes[last] < 0
                                       : last >= 0 && !memcmp(m->sets + (long)last * p, closed, (size_t)p);
    if (goes_on) {
        m->lengths[last] += length;
        return;
    }
    memcpy(m->sets + (long)m->n_intervals * p, closed, (size_t)p);
    if (f->of.friction) m->causes[m->n_intervals] = -1;
    m->lengths[m->n_intervals++] = length;
}

/* A pair leaves its state, as one of the answers fell at a time of the piece behind others at the same
 * instant or, `first`, not; of the last interval is kept what changes of it will need. */
static void turn(flow *f, flow_motion *m, int fallen, double when, int first)
{
    const int p = f->of.pairs, r = f->rows, pair = fallen % p, interval = m->n_intervals - 1;
    const int state = f->closed[pair], by_rate = state >= SLIP_UP && fallen >= p;
    signed char *zeros = f->zeros;
    double slope, rate;
    if (first) memset(zeros, 0, (size_t)r);
    m->causes[interval] = fallen;
    m->is_first[interval] = (signed char)first;
    const double place = column_at(r, f->order, f->reached, p + pair, 0, when, &rate);
    column_at(r, f->order, f->answers, fallen, 0, when, &slope);
    if (first) f->slope = slope / f->length;
    m->ratios[interval] = by_rate && first ? 0.0 : rate / f->length / f->slope;
    f->closed[pair] = state == OPEN || by_rate ? STICK
                      : state == STICK         ? (fallen < p ? SLIP_UP : SLIP_DOWN)
                                               : OPEN;
    if (!(by_rate && first))
        for (int k = 0; k < r; k++) zeros[k] = zeros[k] != 0;
    zeros[pair] = zeros[p + pair] = 0;
    if (f->closed[pair] == STICK) {
        f->held[pair] = place;
        if (state != SLIP_DOWN) zeros[pair] = 1;
        if (state != SLIP_UP) zeros[p + pair] = 1;
        if (by_rate && first) zeros[state == SLIP_UP ? pair : p + pair] = 2;
    }
    if (f->closed[pair] == OPEN) zeros[pair] = 1;
}

static int finite_state(int count, const double *state)
{
    double sum = 0.0;
    for (int i = 0; i < count; i++) sum += 0.0 * state[i];
    return sum == 0.0;
}

/* The places of a state where a motion ends: where pairs stick, or where they are. */
static void place_at_end(const flow *f, double when, double *state)
{
    const int p = f->of.pairs;
    double rate;
    for (int i = 0; i < p; i++)
        state[2 * f->of.modes + i] =
            f->closed[i] == STICK ? f->held[i]
                                  : column_at(f->rows, f->order, f->reached, p + i, 0, when, &rate);
}

/* With the set of closed pairs at its beginning, or NULL where none is near. */
static int advance(flow *f, flow_motion *m, const signed char *guess)
{
    const int p = f->of.pairs, friction = f->of.friction != NULL;
    double stayed = 0.0, allowed = INFINITY;
    int at_once = 0; /* events at one instant */
    signed char *closed = f->closed;
    if (contact_at(f, m->omega, m->time, m->state, guess)) return FLOW_FAILED;
    memset(f->zeros, 0, (size_t)f->rows);
    for (; m->time < m->end; m->n_pieces++) {
        const closed_set *a = get_closed_set(f->known, closed);
        if (!a) return friction ? FLOW_FAILED : FLOW_NO_MEMORY;
        const double rate = fastest(f, a, m->omega), longest = MAX_PIECE_ANGLE / rate;
        /* Those between which a crack closes are short, and a short series has few terms. */
        const double reach = fmin(longest, fmax(1.0 / (STEPS_PER_RADIAN * rate), allowed));
        const double length = fmin(reach, m->end - m->time), left = (m->end - m->time) / length;
        if (m->n_pieces + (m->end - m->time) / longest > m->max_pieces) return FLOW_TOO_MANY_PIECES;
        if (m->n_intervals == m->max_intervals) return FLOW_TOO_MANY_INTERVALS;
        f->order = order_for(length * rate);
        wave(f, m->omega, m->time, length, 0);
        expand(f, a, f->of.force, f->of.gap, NULL, length, m->state);
        answer(f, a, f->of.gap);
        double end = series_reach(f->of.modes, f->order, f->series, fmin(1.0, left));
        end = series_reach(f->rows, f->order, f->gaps, end);
        if (!(end > 0.0)) return FLOW_FAILED;
        round_off(f, a, end);
        double when = end;
        const int fallen = next_event(f, 1.0 / (STEPS_PER_RADIAN * length * rate), end, &when);
        const int last = fallen < 0 && end == left;
        sample(f, m, closed, length, when, last);
        state_at(f, length, when, m->state);
        if (!finite_state(2 * f->of.modes, m->state)) return FLOW_FAILED;
        passed(f, m, closed, when * length);
        m->time = last ? m->end : m->time + when * length;
        stayed += when * length;
        allowed = INFINITY;
        if (friction && last) place_at_end(f, when, m->state);
        if (fallen < 0) memset(f->zeros, 0, (size_t)f->rows);
        at_once = fallen < 0 ? 0 : when > ROUNDING ? 1 : at_once + 1;
        if (fallen < 0) continue;
        if (friction) {
            f->length = length;
            turn(f, m, fallen, when, at_once == 1);
            if (at_once > 6 * p) return FLOW_FAILED;
        } else closed[fallen] = !closed[fallen];
        allowed = 2.0 * stayed;
        stayed = 0.0;
        m->n_events++;
    }
    return FLOW_DONE;
}

int flow_advance(flow *f, flow_motion *m) { return advance(f, m, NULL); }

/* The set of an interval of a track, and the length of its pieces; NULL without memory. */
static const closed_set *enter(flow *f, const flow_track *track, int interval, double *length)
{
    const closed_set *a = get_closed_set(f->known, track->sets + (long)interval * f->of.pairs);
    if (!a) return NULL;
    const double whole = track->lengths[interval], rate = fastest(f, a, track->omega);
    *length = whole / ceil(whole * rate / MAX_PIECE_ANGLE);
    f->order = order_for(*length * rate);
    return a;
}

/* --- changes where pairs stick ---------------------------------------------------------------- */

/* What the answer k is of forces, with weights u (r), and of one gap or its rate: its row is returned,
 * and -1 where it is of forces alone. */
static int answer_row(const flow *f, const closed_set *a, int k, double *u, double *sign)
{
    const int p = f->of.pairs, r = f->rows, i = k % p, state = a->closed[i];
    const double other = k < p ? -1.0 : 1.0;
    memset(u, 0, bytes(r));
    *sign = state == OPEN ? -1.0 : state == SLIP_UP ? 1.0 : -1.0;
    if (state == STICK) {
        u[i] = f->of.friction[i];
        u[p + i] = other;
        return -1;
    }
    if (state != OPEN && k < p) {
        u[i] = 1.0;
        return -1;
    }
    const int row = state == OPEN ? i : k;
    for (int q = 0; q < r; q++) u[q] = -*sign * f->of.compliance[(long)row * r + q];
    return row;
}

/* Columns (m, c) of changes of q and of their rates, and (p, c) of h. */
typedef struct {
    int count;
    double *moved, *rate, *held;
    double *terms;         /* (3, m, c) of a series */
    double *push;          /* (m, c) by the places */
    double *matrix, *read; /* (m, m) stiffness of a set, or of one with few rows (m, size), (size, m) */
    double *seen;          /* (size, c) by these */
    double *fell, *own;    /* (c) of the answer that fell first; (c) */
    double *weights;       /* (r) */
} changes;

/* found (c) = sign times a gap and weights u (r) of forces, of changes x (m, c) of q or of their
 * rates, of which those of places know nothing. */
static void changed(const flow *f, const closed_set *a, const changes *c, int row, double sign,
                    const double *x, double *found)
{
    const int m = f->of.modes, p = f->of.pairs, r = f->rows;
    memset(found, 0, bytes(c->count));
    multiply(a->size, r, a->inverse, c->weights, f->seen);
    for (int j = 0; j < m; j++) {
        double weight = dot(a->size, a->pairs + (long)j * a->size, f->seen);
        if (row >= 0) weight += sign * f->of.rows[(long)row * m + j];
        add_rows(1, c->count, x + (long)j * c->count, &weight, found);
    }
    if (x != c->moved) return;
    for (int i = a->closing; i < a->size; i++) {
        const double weight = -f->seen[i];
        add_rows(1, c->count, c->held + (long)(a->members[i] - p) * c->count, &weight, found);
    }
}

/* c->own = change of where a pair is that does not stick. */
static void change_place(const flow *f, const closed_set *a, int pair, changes *c)
{
    const int row = f->of.pairs + pair, r = f->rows;
    for (int q = 0; q < r; q++) c->weights[q] = -f->of.compliance[(long)row * r + q];
    changed(f, a, c, row, 1.0, c->moved, c->own);
}

static int sticks_throughout(const flow *f, const flow_track *track, int pair)
{
    for (int k = 0; k < track->n_intervals; k++)
        if (track->sets[(long)k * f->of.pairs + pair] != STICK) return 0;
    return 1;
}

/* At the end of an interval a pair leaves its state. */
static void change_state(flow *f, const flow_track *track, int interval, const closed_set *a,
                         changes *c)
{
    const int p = f->of.pairs, fallen = track->causes[interval];
    if (fallen < 0) return;
    const int pair = fallen % p, state = a->closed[pair], by_rate = state >= SLIP_UP && fallen >= p;
    if (track->is_first[interval]) {
        double sign;
        const int row = answer_row(f, a, fallen, c->weights, &sign);
        changed(f, a, c, row, sign, by_rate ? c->rate : c->moved, c->fell);
    }
    double *held = c->held + (long)pair * c->count;
    if (state == OPEN || by_rate) {
        const double late = -track->ratios[interval];
        change_place(f, a, pair, c);
        memcpy(held, c->own, bytes(c->count));
        if (late != 0.0) add_rows(1, c->count, c->fell, &late, held);
    } else memset(held, 0, bytes(c->count));
}

/* found = A^T of (rows, columns). */
static void transpose(int rows, int columns, const double *a, double *found)
{
    for (long i = 0; i < rows; i++)
        for (long j = 0; j < columns; j++) found[j * rows + i] = a[i * columns + j];
}

/* Changes over a length. */
static void change_along(flow *f, const closed_set *a, double length, changes *c)
{
    const int m = f->of.modes, p = f->of.pairs, stuck = a->size - a->closing, n = c->count;
    const long all = (long)m * n;
    const double rate = fastest(f, a, 0.0);
    const int pieces = (int)ceil(length * rate / MAX_PIECE_ANGLE);
    double *before = c->terms, *now = before + all, *next = now + all;
    if (a->stiffness) transpose(m, m, a->stiffness, c->matrix);
    else {
        c->read = c->matrix + (long)m * a->size;
        transpose(a->size, m, a->pushed, c->matrix);
        transpose(m, a->size, a->pairs, c->read);
    }
    memset(c->push, 0, bytes(all));
    for (int i = 0; i < stuck; i++)
        for (int j = 0; j < m; j++)
            add_rows(1, n, c->held + (long)(a->members[a->closing + i] - p) * n,
                     a->pushed + (long)(a->closing + i) * m + j, c->push + (long)j * n);
    if (pieces) length /= pieces;
    f->order = order_for(length * rate);
    for (int piece = 0; piece < pieces; piece++) {
        memcpy(before, c->moved, bytes(all));
        for (long i = 0; i < all; i++) now[i] = length * c->rate[i];
        for (long i = 0; i < all; i++) c->moved[i] += now[i];
        for (int k = 0; k + 2 <= f->order; k++) {
            const double gain = -length * length / ((k + 1) * (k + 2)), loss = -length / (k + 2);
            double *spent = before;
            if (a->stiffness) multiply_matrices(m, m, n, c->matrix, before, 0.0, next);
            else {
                multiply_matrices(a->size, m, n, c->read, before, 0.0, c->seen);
                multiply_matrices(m, a->size, n, c->matrix, c->seen, 0.0, next);
            }
            for (int j = 0; j < m; j++)
                for (long i = (long)j * n; i < (long)(j + 1) * n; i++)
                    next[i] += f->of.squares[j] * before[i];
            if (k == 0)
                for (long i = 0; i < all; i++) next[i] -= c->push[i];
            if (f->of.coupled) {
                multiply_matrices(m, m, n, f->of.damping, now, gain / loss, next);
                for (long i = 0; i < all; i++) next[i] *= loss;
            } else
                for (int j = 0; j < m; j++)
                    for (long i = (long)j * n; i < (long)(j + 1) * n; i++)
                        next[i] = gain * next[i] + loss * f->of.damping[j] * now[i];
            for (long i = 0; i < all; i++) {
                c->moved[i] += next[i];
                c->rate[i] += (k + 2) / length * next[i];
            }
            before = now;
            now = next;
            next = spent;
        }
    }
}

/* The derivative (2 m + p, 2 m + p) by z and h. */
static int tangent_with_friction(flow *f, const flow_track *track, double *tangent)
{
    const closed_set *a = NULL;
    const long m = f->of.modes, p = f->of.pairs, r = f->rows, n = 2 * m + p;
    double *room = malloc(bytes(4 * m * n + m * m + 2 * n + r + m / 2 * n));
    if (!room) return FLOW_NO_MEMORY;
    changes c = {.count = (int)n, .moved = tangent, .rate = tangent + m * n,
                 .held = tangent + 2 * m * n, .terms = room, .push = room + 3 * m * n};
    c.matrix = c.push + m * n;
    c.fell = c.matrix + m * m;
    c.own = c.fell + n;
    c.weights = c.own + n;
    c.seen = c.weights + r;
    memset(tangent, 0, bytes(n * n));
    for (long i = 0; i < n; i++) tangent[i * (n + 1)] = 1.0;
    for (int k = 0; k < track->n_intervals; k++) {
        a = get_closed_set(f->known, track->sets + (long)k * p);
        if (!a) {
            free(room);
            return FLOW_NO_MEMORY;
        }
        change_along(f, a, track->lengths[k], &c);
        change_state(f, track, k, a, &c);
    }
    for (int i = 0; i < p && a; i++) {
        double *place = c.held + i * n;
        if (a->closed[i] != STICK) {
            change_place(f, a, i, &c);
            memcpy(place, c.own, bytes(n));
        } else if (sticks_throughout(f, track, i)) memset(place, 0, bytes(n));
    }
    free(room);
    return finite_state((int)(n * n), tangent) ? FLOW_DONE : FLOW_FAILED;
}

/* At the end of a series of changes a pair may leave its state, and the motion end: that of the answer
 * that fell is f->fell, and f->held those of h. */
static void change_places(flow *f, const flow_track *track, int interval, const closed_set *a,
                          const double *gap, double length, double end)
{
    const int m = f->of.modes, p = f->of.pairs, r = f->rows, terms = f->order + 1;
    const int fallen = track->causes[interval], last = interval + 1 == track->n_intervals;
    double *force = f->force, *near = f->near, *rate = f->falling, sign;
    if (fallen < 0 && !last) return;
    multiply_matrices(terms, f->loads, r, f->weights, gap, 0.0, f->reached);
    multiply_matrices(terms, m, r, f->series, f->columns, 1.0, f->reached);
    solve_friction_forces(f->known, a, terms, f->held, f->reached, f->forces);
    series_at(r, f->order, f->forces, end, force, rate);
    series_at(r, f->order, f->reached, end, near, rate);
    if (fallen >= 0) {
        const int pair = fallen % p, state = a->closed[pair], by_rate = state >= SLIP_UP && fallen >= p;
        if (track->is_first[interval]) {
            const int row = answer_row(f, a, fallen, f->value, &sign);
            f->fell = row < 0 ? dot(r, force, f->value)
                              : sign * (by_rate ? rate[row] / length : near[row]);
        }
        f->held[pair] = state == OPEN || by_rate
                            ? near[p + pair] - track->ratios[interval] * f->fell
                            : 0.0;
    }
    for (int i = 0; i < p && last; i++)
        if (a->closed[i] != STICK) f->held[i] = near[p + i];
}

int flow_by_load(flow *f, const flow_track *track, const double *force, const double *gap,
                int by_time, double *state)
{
    double now = track->start, *places = state + 2 * f->of.modes;
    if (f->of.friction) memcpy(f->held, places, bytes(f->of.pairs));
    for (int k = 0; k < track->n_intervals; k++) {
        double length;
        const closed_set *a = enter(f, track, k, &length);
        if (!a) return FLOW_NO_MEMORY;
        for (double left = length > 0.0 ? track->lengths[k] / length : 0.0; left > 0.0;) {
            wave(f, track->omega, now, length, by_time);
            expand(f, a, force, gap, NULL, length, state);
            const double end = series_reach(f->of.modes, f->order, f->series, fmin(1.0, left));
            if (!(end > 0.0)) return FLOW_FAILED;
            state_at(f, length, end, state);
            left -= end;
            now += end * length;
            if (f->of.friction && !(left > 0.0)) change_places(f, track, k, a, gap, length, end);
        }
    }
    if (f->of.friction) memcpy(places, f->held, bytes(f->of.pairs));
    return FLOW_DONE;
}

/* d/d omega of c cos(k omega t) + s sin(k omega t) is t times k (s cos - c sin). */
static void turn_load(int loads, int n, const double *rows, double *turned)
{
    memset(turned, 0, bytes(n));
    for (int k = 1; 2 * k < loads; k++) {
        const double *cosine = rows + (2L * k - 1) * n, *sine = cosine + n;
        double *own = turned + (2L * k - 1) * n;
        for (int j = 0; j < n; j++) own[j] = k * sine[j], own[n + j] = -k * cosine[j];
    }
}

int flow_by_omega(flow *f, const flow_track *track, double *state)
{
    const int m = f->of.modes;
    double *force = f->turned, *gap = force + f->loads * m;
    memset(state, 0, bytes(numbers_of_state(f)));
    turn_load(f->loads, m, f->of.force, force);
    turn_load(f->loads, f->rows, f->of.gap, gap);
    return flow_by_load(f, track, force, gap, 1, state);
}

/* What drives the derivative of a motion, of which the series are known: -C' q' and P_A S D' lambda,
 * the derivative of -P_A S s. */
static void drive(flow *f, const closed_set *a, const double *damping, const double *compliance,
                  double length)
{
    const int m = f->of.modes, p = f->of.pairs;
    memset(f->source, 0, bytes((f->order + 1L) * m));
    for (int n = 0; n < f->order; n++) {
        double *source = f->source + (long)n * m;
        if (damping) {
            damp(f, damping, f->series + (n + 1L) * m, f->drag);
            for (int j = 0; j < m; j++) source[j] = -(n + 1) / length * f->drag[j];
        }
        for (int i = 0; compliance && i < a->size; i++) {
            const int row = a->members[i];
            f->seen[i] = compliance[row] * f->answers[(long)n * p + row];
        }
        if (compliance) add_rows(a->size, m, a->pushed, f->seen, source);
    }
}

int flow_by_structure(flow *f, const flow_track *track, const double *start, const double *damping,
                      const double *compliance, double *state)
{
    const int m = f->of.modes;
    double *still = f->turned, *here = f->motion + (long)TERMS * m, *series = f->series;
    double now = track->start;
    if (f->of.friction) return FLOW_FAILED; /* not yet: where pairs stick changes, too */
    memset(still, 0, bytes(f->loads * (m + f->rows)));
    memset(state, 0, bytes(2 * m));
    memcpy(here, start, bytes(2 * m));
    for (int k = 0; k < track->n_intervals; k++) {
        double length;
        const closed_set *a = enter(f, track, k, &length);
        if (!a) return FLOW_NO_MEMORY;
        for (double left = length > 0.0 ? track->lengths[k] / length : 0.0; left > 0.0;) {
            wave(f, track->omega, now, length, 0);
            expand(f, a, f->of.force, f->of.gap, NULL, length, here);
            answer(f, a, f->of.gap);
            drive(f, a, damping, compliance, length);
            double end = series_reach(m, f->order, series, fmin(1.0, left));
            f->series = f->motion;
            expand(f, a, still, still + f->loads * m, f->source, length, state);
            end = series_reach(m, f->order, f->series, end);
            if (end > 0.0) state_at(f, length, end, state);
            f->series = series;
            if (!(end > 0.0)) return FLOW_FAILED;
            state_at(f, length, end, here);
            left -= end;
            now += end * length;
        }
    }
    return finite_state(2 * m, state) ? FLOW_DONE : FLOW_FAILED;
}

int flow_rate(flow *f, double omega, double time, const signed char *closed, const double *state,
              double *rate)
{
    const int m = f->of.modes, p = f->of.pairs, r = f->rows;
    const closed_set *a = f->of.friction ? get_closed_set(f->known, closed) : NULL;
    double *faster = rate + m;
    if (f->of.friction) { /* where a pair slips its place does not tell which way, or if at all */
        if (!a) return 1;
        gaps_at(f, omega, time, state);
        memcpy(f->held, state + 2 * m, bytes(p));
        solve_friction_forces(f->known, a, 1, f->held, f->near, f->force);
    } else if (contact_at(f, omega, time, state, NULL)) return 1;
    memcpy(rate, state + m, bytes(m));
    multiply(m, f->rows, f->columns, f->force, faster);
    damp(f, f->of.damping, rate, f->drag);
    for (int j = 0; j < m; j++)
        faster[j] = -faster[j] - f->drag[j] - f->of.squares[j] * state[j];
    add_rows(f->loads, m, f->of.force, f->weights, faster);
    if (!f->of.friction) return 0;
    f->order = 1;
    wave(f, omega, time, 1.0, 0);
    multiply(r, m, f->of.rows, rate, f->near);
    add_rows(f->loads, r, f->of.gap, f->weights + f->loads, f->near);
    memset(f->held, 0, bytes(p)); /* places where pairs stick stay */
    solve_friction_forces(f->known, a, 1, f->held, f->near, f->force);
    for (int i = 0; i < p; i++) rate[2 * m + i] = closed[i] == STICK ? 0.0 : f->near[p + i];
    return 0;
}

int flow_tangent(flow *f, const flow_track *track, double *tangent)
{
    const long size = 2L * f->of.modes, half = size * f->of.modes, p = f->of.pairs;
    const double unit = fmax(f->of.max_rate, 1e-300);
    int apart = 1;
    if (f->of.friction) return tangent_with_friction(f, track, tangent);
    if (!f->exponential)
        f->exponential = new_exponentials(f->of.modes, f->of.coupled, f->of.squares,
                                          f->of.damping, unit);
    if (!f->exponential) return FLOW_NO_MEMORY;
    memset(tangent, 0, bytes(2 * half));
    for (long i = 0; i < size; i++) tangent[i * (size + 1)] = i < f->of.modes ? unit : 1.0;
    for (int k = 0, next; k < track->n_intervals; k = next) { /* those of one set together */
        const signed char *closed = track->sets + k * p;
        const closed_set *a = get_closed_set(f->known, closed);
        double length = track->lengths[k];
        if (!a) return FLOW_NO_MEMORY;
        for (next = k + 1; next < track->n_intervals; next++) {
            if (memcmp(track->sets + next * p, closed, (size_t)p)) break;
            length += track->lengths[next];
        }
        apart = multiply_exponential(f->exponential, a, length, apart, tangent);
    }
    add_kicks(f->exponential, tangent);
    for (long i = 0; i < half; i++) tangent[i] /= unit;
    return finite_state((int)(2 * half), tangent) ? FLOW_DONE : FLOW_FAILED;
}

int flow_advance_parts(flow *f, flow_motion *m, int nodes, double period, const double *states,
              double *moved, int *ends)
{
    const long size = numbers_of_state(f);
    flow_motion part = *m;
    memcpy(moved, states, bytes(nodes * size));
    for (int i = 0; i < nodes; i++) {
        part.time = i * period / nodes, part.end = (i + 1) * period / nodes;
        part.state = moved + i * size;
        const int outcome = advance(f, &part, i ? f->closed : NULL);
        m->n_intervals += part.n_intervals;
        m->n_events = part.n_events;
        if (outcome != FLOW_DONE) return outcome;
        ends[i] = m->n_intervals;
        part.max_intervals -= part.n_intervals;
        part.sets += (long)part.n_intervals * f->of.pairs;
        part.lengths += part.n_intervals;
        if (f->of.friction)
            part.causes += part.n_intervals, part.is_first += part.n_intervals, part.ratios += part.n_intervals;
        part.n_intervals = 0;
    }
    return FLOW_DONE;
}

int flow_carry_changes(flow *f, const flow_track *track, int nodes, const int *ends, const double *excess,
               double *changes)
{
    const long size = numbers_of_state(f);
    double *still = f->turned; /* no load */
    flow_track part = *track;
    memset(still, 0, bytes(f->loads * (f->of.modes + f->rows)));
    for (int i = 0; i < nodes; i++, changes += size, excess += size) {
        double *next = changes + size;
        part.n_intervals = ends[i] - (i ? ends[i - 1] : 0);
        memcpy(next, changes, bytes(size));
        const int outcome = flow_by_load(f, &part, still, still + f->loads * f->of.modes, 0, next);
        if (outcome != FLOW_DONE) return outcome;
        for (long j = 0; j < size; j++) next[j] += excess[j];
        part.sets += (long)part.n_intervals * f->of.pairs;
        part.lengths += part.n_intervals;
        if (f->of.friction)
            part.causes += part.n_intervals, part.is_first += part.n_intervals, part.ratios += part.n_intervals;
    }
    return FLOW_DONE;
}

/* --- made and freed --------------------------------------------------------------------------- */

static double *taken(double **place, long count)
{
    double *found = *place;
    *place += count;
    return found;
}

static double *copied(double **place, const double *from, long count)
{
    return memcpy(taken(place, count), from, bytes(count));
}

flow *new_flow(const flow_parts *given)
{
    const long m = given->modes, pairs = given->pairs, damping = given->coupled ? m * m : m;
    const long p = given->friction ? 2 * pairs : pairs, loads = 2L * given->harmonics + 1;
    const long room = m + damping + p * p + 2 * p * m + TERMS * (loads + m + 4 * p) + (MAX_SEARCH_STEPS + 2) * p
                      + 6 * p + m + 2 * loads * (m + p) + (2 * TERMS + 2) * m;
    flow *f = calloc(1, sizeof(flow));
    if (!f) return NULL;
    f->of = *given;
    f->room = malloc(bytes(room + 1));
    f->closed = malloc((size_t)p + 1);
    f->zeros = calloc((size_t)p + 1, 1);
    f->rows = (int)p;
    f->loads = (int)loads;
    if (!f->room || !f->closed || !f->zeros) {
        free_flow(f);
        return NULL;
    }
    double *place = f->room;
    f->of.squares = copied(&place, given->squares, m);
    f->of.damping = copied(&place, given->damping, damping);
    f->of.rows = copied(&place, given->rows, p * m);
    f->of.compliance = copied(&place, given->compliance, p * p);
    if (given->friction) f->of.friction = copied(&place, given->friction, pairs);
    f->held = taken(&place, p);
    f->forces = taken(&place, TERMS * p);
    f->reached = taken(&place, TERMS * p);
    f->columns = taken(&place, m * p);
    for (long i = 0; i < p; i++)
        for (long j = 0; j < m; j++) f->columns[j * p + i] = given->rows[i * m + j];
    f->weights = taken(&place, TERMS * loads);
    f->series = taken(&place, TERMS * m);
    f->gaps = taken(&place, TERMS * p);
    f->answers = taken(&place, TERMS * p);
    f->value = taken(&place, (MAX_SEARCH_STEPS + 1) * p);
    f->falling = taken(&place, p);
    f->allowed = taken(&place, p);
    f->near = taken(&place, p);
    f->force = taken(&place, p);
    f->seen = taken(&place, p);
    f->drag = taken(&place, m);
    f->turned = taken(&place, loads * (m + p));
    f->pulled = taken(&place, loads * (m + p));
    f->source = taken(&place, TERMS * m);
    f->motion = taken(&place, (TERMS + 2) * m);
    f->known = new_closed_sets((int)m, (int)pairs, f->of.rows, f->of.compliance, f->of.friction,
                               given->max_set_numbers);
    if (f->known) return f;
    free_flow(f);
    return NULL;
}

void flow_set_damping(flow *f, const double *damping)
{
    const long m = f->of.modes;
    memcpy((double *)f->of.damping, damping, bytes(f->of.coupled ? m * m : m));
    if (f->exponential) free_exponentials(f->exponential);
    f->exponential = NULL;
}

void free_flow(flow *f)
{
    if (f->known) free_closed_sets(f->known);
    if (f->exponential) free_exponentials(f->exponential);
    free(f->closed);
    free(f->zeros);
    free(f->room);
    free(f);
}
