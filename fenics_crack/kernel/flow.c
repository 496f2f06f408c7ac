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
enum { STEPS = GRID * FLOW_REACH };

struct flow {
    flow_parts of;
    int order; /* of the series of a piece */
    closed_sets *known;
    exponentials *exponential;
    double *room;
    double *columns;                 /* (m, p) P */
    double *weights;                 /* (TERMS, LOAD) of the load's rows */
    double *series, *gaps, *answers; /* (TERMS, m), (TERMS, p), (TERMS, p) of q, s, i */
    double *allowed;                 /* (p) what of a negative answer is rounding */
    double *value, *falling;         /* (STEPS + 1, p) answers at steps' ends; (p) */
    double *near, *force;            /* (p) s of a state, its forces */
    double *seen, *drag;             /* (p), (m) */
    double *turned;                  /* (LOAD, m + p) derivative of the load */
    double *pulled;                  /* (LOAD, m) of a load, (LOAD, p) */
    double *source, *motion;         /* (TERMS, m), (TERMS + 2, m) of another series */
    signed char *closed;             /* (p) */
};

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

/* No set turns faster, nor does the load. */
static double fastest(const flow *f, double omega)
{
    return fmax(fmax(f->of.fastest, omega), 1e-300);
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
    const double c = cos(omega * now), s = sin(omega * now);
    double *w = f->weights, size = 1.0;
    for (int n = 0; n <= f->order; n++, w += LOAD) {
        const double sign = n & 2 ? -size : size;
        w[MEAN] = n == 0;
        w[COSINE] = n & 1 ? -sign * s : sign * c;
        w[SINE] = n & 1 ? sign * c : sign * s;
        size *= omega * length / (n + 1);
    }
    if (!by_time) return;
    for (int n = f->order; n >= 0; n--)
        for (int k = 0; k < LOAD; k++) {
            double *own = f->weights + n * LOAD + k;
            *own = now * *own + (n ? length * *(own - LOAD) : 0.0);
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
    const int m = f->of.modes, p = f->of.pairs, size = a->size;
    double *closed = f->pulled + LOAD * m;
    for (int k = 0, at = 0; k < LOAD; k++)
        for (int i = 0; i < p; i++)
            if (a->closed[i]) closed[at++] = gap[k * p + i];
    multiply_matrices(LOAD, size, m, closed, a->pushed, 0.0, f->pulled);
    for (int j = 0; j < LOAD * m; j++) f->pulled[j] = force[j] - f->pulled[j];
}

/* Series of q of a piece, from a state; with `sources`, a load (TERMS, m) is added. */
WIDE static void expand(flow *f, const closed_set *a, const double *force, const double *gap,
                        const double *sources, double length, const double *state)
{
    const int m = f->of.modes, size = a->size;
    const double *restrict squares = f->of.squares;
    const double *restrict cosine = f->pulled + COSINE * m, *restrict sine = f->pulled + SINE * m;
    double *restrict seen = f->seen, *restrict drag = f->drag;
    pull(f, a, force, gap);
    memcpy(f->series, state, bytes(m));
    for (int j = 0; j < m; j++) f->series[m + j] = length * state[m + j];
    for (int n = 0; n + 2 <= f->order; n++) {
        const double *restrict now = f->series + (long)n * m, *restrict rate = now + m;
        double *restrict next = f->series + (long)(n + 2) * m;
        const double gain = length * length / ((n + 1) * (n + 2)), loss = length / (n + 2);
        const double *w = f->weights + n * LOAD;
        const double mean = gain * w[MEAN], c = gain * w[COSINE], s = gain * w[SINE];
        damp(f, f->of.damping, rate, drag);
        for (int j = 0; j < m; j++)
            next[j] = c * cosine[j] + s * sine[j] - gain * squares[j] * now[j] - loss * drag[j];
        if (mean != 0.0) add_rows(1, m, f->pulled, &mean, next);
        if (sources) add_rows(1, m, sources + (long)n * m, &gain, next);
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

/* Series of the gaps s and of the answers, and what is rounding in these where the series holds. */
static void answer(flow *f, const closed_set *a, const double *gap)
{
    const int m = f->of.modes, p = f->of.pairs, terms = f->order + 1;
    multiply_matrices(terms, LOAD, p, f->weights, gap, 0.0, f->gaps);
    multiply_matrices(terms, m, p, f->series, f->columns, 1.0, f->gaps);
    answer_gaps(f->known, a, terms, f->gaps, f->answers);
}

static void round_off(flow *f, const closed_set *a, double length)
{
    const double largest = series_size(f->of.pairs, f->order, f->gaps, length);
    for (int i = 0; i < f->of.pairs; i++) f->allowed[i] = AS_ZERO * largest * a->scale[i];
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
    const int p = f->of.pairs;
    double other, bottom, fall, rise;
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

/* The first pair that changes its state, and when; -1: none before `end`. */
static int next_event(flow *f, double step, double end, double *when)
{
    const int p = f->of.pairs;
    const int steps = (int)fmin(fmax(ceil(end / step), 3), STEPS); /* three show how answers bend */
    double at[TIMES];
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

/* The set of closed pairs of a state, from a guess or, with NULL, from its gaps; and their forces.
 * Returns 1 where none answers it. */
static int contact_at(flow *f, double omega, double time, const double *state, const signed char *guess)
{
    const int m = f->of.modes, p = f->of.pairs;
    wave(f, omega, time, 0.0, 0);
    multiply(p, m, f->of.rows, state, f->near);
    add_rows(LOAD, p, f->of.gap, f->weights, f->near);
    for (int i = 0; i < p; i++) f->closed[i] = guess ? guess[i] : f->near[i] > 0.0;
    if (!set_at(f->known, f->near, f->closed, f->force)) return 1;
    for (int i = 0; i < p; i++)
        if (!f->closed[i]) f->force[i] = 0.0;
    return 0;
}

/* The motion at the instants up to the end of a piece. */
static void sample(const flow *f, flow_motion *m, const signed char *closed, double length,
                   double end, int last)
{
    const int n = f->of.modes, p = f->of.pairs;
    for (; m->sampled < m->count; m->sampled++) {
        const double at = fmax(0.0, (m->instants[m->sampled] - m->now) / length);
        const long row = m->sampled;
        if (!last && at >= end) break;
        state_at(f, length, fmin(at, end), m->states + row * 2 * n);
        series_at(p, f->order, f->answers, fmin(at, end), m->answers + row * p, f->value);
        memcpy(m->closed + row * p, closed, (size_t)p);
    }
}

/* Another piece of the track, in the last interval or in a new one. */
static void passed(flow_motion *m, int p, const signed char *closed, double length)
{
    if (m->passed && !memcmp(m->sets + (long)(m->passed - 1) * p, closed, (size_t)p)) {
        m->lengths[m->passed - 1] += length;
        return;
    }
    memcpy(m->sets + (long)m->passed * p, closed, (size_t)p);
    m->lengths[m->passed++] = length;
}

static int finite_state(int count, const double *state)
{
    double sum = 0.0;
    for (int i = 0; i < count; i++) sum += 0.0 * state[i];
    return sum == 0.0;
}

/* With the set of closed pairs at its beginning, or NULL where none is near. */
static int advance(flow *f, flow_motion *m, const signed char *guess)
{
    const int p = f->of.pairs;
    const double rate = fastest(f, m->omega), longest = FLOW_REACH / rate;
    double stayed = 0.0, allowed = longest;
    signed char *closed = f->closed;
    if (contact_at(f, m->omega, m->now, m->state, guess)) return FLOW_LOST;
    for (; m->now < m->end; m->pieces++) {
        const double length = fmin(allowed, m->end - m->now);
        const double left = (m->end - m->now) / length;
        if (m->pieces + (m->end - m->now) / longest > m->most_pieces) return FLOW_PIECES;
        if (m->passed == m->most) return FLOW_INTERVALS;
        f->order = order_for(length * rate);
        const closed_set *a = closed_set_of(f->known, closed);
        if (!a) return FLOW_MEMORY;
        wave(f, m->omega, m->now, length, 0);
        expand(f, a, f->of.force, f->of.gap, NULL, length, m->state);
        answer(f, a, f->of.gap);
        double end = series_reach(f->of.modes, f->order, f->series, fmin(1.0, left));
        end = series_reach(p, f->order, f->gaps, end);
        if (!(end > 0.0)) return FLOW_LOST;
        round_off(f, a, end);
        double when = end;
        const int pair = next_event(f, 1.0 / (GRID * length * rate), end, &when);
        const int last = pair < 0 && end == left;
        sample(f, m, closed, length, when, last);
        state_at(f, length, when, m->state);
        if (!finite_state(2 * f->of.modes, m->state)) return FLOW_LOST;
        passed(m, p, closed, when * length);
        m->now = last ? m->end : m->now + when * length;
        stayed += when * length;
        allowed = longest;
        if (pair < 0) continue;
        closed[pair] = !closed[pair];
        /* Those between which a crack closes are short, and a short series has few terms. */
        allowed = fmin(longest, fmax(1.0 / (GRID * rate), 2.0 * stayed));
        stayed = 0.0;
        m->events++;
    }
    return FLOW_DONE;
}

int flow_advance(flow *f, flow_motion *m) { return advance(f, m, NULL); }

/* The set of an interval of a track, and the length of its pieces, none longer than that; NULL without
 * memory. */
static const closed_set *enter(flow *f, const flow_track *track, int interval, double longest,
                               double *length)
{
    const double whole = track->lengths[interval];
    *length = whole / ceil(whole / longest);
    f->order = order_for(*length / longest * FLOW_REACH);
    return closed_set_of(f->known, track->sets + (long)interval * f->of.pairs);
}

int flow_column(flow *f, const flow_track *track, const double *force, const double *gap,
                int by_time, double *state)
{
    const double longest = FLOW_REACH / fastest(f, track->omega);
    double now = track->start;
    for (int k = 0; k < track->intervals; k++) {
        double length;
        const closed_set *a = enter(f, track, k, longest, &length);
        if (!a) return FLOW_MEMORY;
        for (double left = length > 0.0 ? track->lengths[k] / length : 0.0; left > 0.0;) {
            wave(f, track->omega, now, length, by_time);
            expand(f, a, force, gap, NULL, length, state);
            const double end = series_reach(f->of.modes, f->order, f->series, fmin(1.0, left));
            if (!(end > 0.0)) return FLOW_LOST;
            state_at(f, length, end, state);
            left -= end;
            now += end * length;
        }
    }
    return FLOW_DONE;
}

int flow_by_omega(flow *f, const flow_track *track, double *state)
{
    /* d/d omega of c cos(omega t) + s sin(omega t) is t times s cos - c sin. */
    const int m = f->of.modes, p = f->of.pairs;
    double *force = f->turned, *gap = force + LOAD * m;
    memset(force, 0, bytes(m));
    memset(gap, 0, bytes(p));
    memset(state, 0, bytes(2 * m));
    for (int j = 0; j < m; j++) {
        force[m + j] = f->of.force[2 * m + j];
        force[2 * m + j] = -f->of.force[m + j];
    }
    for (int i = 0; i < p; i++) {
        gap[p + i] = f->of.gap[2 * p + i];
        gap[2 * p + i] = -f->of.gap[p + i];
    }
    return flow_column(f, track, force, gap, 1, state);
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
        for (int i = 0, at = 0; compliance && i < p; i++)
            if (a->closed[i]) f->seen[at++] = compliance[i] * f->answers[(long)n * p + i];
        if (compliance) add_rows(a->size, m, a->pushed, f->seen, source);
    }
}

int flow_by_structure(flow *f, const flow_track *track, const double *start, const double *damping,
                      const double *compliance, double *state)
{
    const double longest = FLOW_REACH / fastest(f, track->omega);
    const int m = f->of.modes;
    double *still = f->turned, *here = f->motion + (long)TERMS * m, *series = f->series;
    double now = track->start;
    memset(still, 0, bytes(LOAD * (m + f->of.pairs)));
    memset(state, 0, bytes(2 * m));
    memcpy(here, start, bytes(2 * m));
    for (int k = 0; k < track->intervals; k++) {
        double length;
        const closed_set *a = enter(f, track, k, longest, &length);
        if (!a) return FLOW_MEMORY;
        for (double left = length > 0.0 ? track->lengths[k] / length : 0.0; left > 0.0;) {
            wave(f, track->omega, now, length, 0);
            expand(f, a, f->of.force, f->of.gap, NULL, length, here);
            answer(f, a, f->of.gap);
            drive(f, a, damping, compliance, length);
            double end = series_reach(m, f->order, series, fmin(1.0, left));
            f->series = f->motion;
            expand(f, a, still, still + LOAD * m, f->source, length, state);
            end = series_reach(m, f->order, f->series, end);
            if (end > 0.0) state_at(f, length, end, state);
            f->series = series;
            if (!(end > 0.0)) return FLOW_LOST;
            state_at(f, length, end, here);
            left -= end;
            now += end * length;
        }
    }
    return finite_state(2 * m, state) ? FLOW_DONE : FLOW_LOST;
}

int flow_rate(flow *f, double omega, double time, const double *state, double *rate)
{
    const int m = f->of.modes;
    double *faster = rate + m;
    if (contact_at(f, omega, time, state, NULL)) return 1;
    memcpy(rate, state + m, bytes(m));
    multiply(m, f->of.pairs, f->columns, f->force, faster);
    damp(f, f->of.damping, rate, f->drag);
    for (int j = 0; j < m; j++)
        faster[j] = -faster[j] - f->drag[j] - f->of.squares[j] * state[j];
    add_rows(LOAD, m, f->of.force, f->weights, faster);
    return 0;
}

int flow_tangent(flow *f, const flow_track *track, double *tangent)
{
    const long size = 2L * f->of.modes, half = size * f->of.modes, p = f->of.pairs;
    const double unit = fastest(f, 0.0);
    int apart = 1;
    if (!f->exponential)
        f->exponential = new_exponentials(f->of.modes, f->of.coupled, f->of.squares,
                                          f->of.damping, unit);
    if (!f->exponential) return FLOW_MEMORY;
    memset(tangent, 0, bytes(2 * half));
    for (long i = 0; i < size; i++) tangent[i * (size + 1)] = i < f->of.modes ? unit : 1.0;
    for (int k = 0, next; k < track->intervals; k = next) {
        const signed char *closed = track->sets + k * p;
        const closed_set *a = closed_set_of(f->known, closed);
        double length = track->lengths[k];
        if (!a) return FLOW_MEMORY;
        for (next = k + 1; next < track->intervals; next++) {
            if (memcmp(track->sets + next * p, closed, (size_t)p)) break;
            length += track->lengths[next];
        }
        apart = multiply_exponential(f->exponential, a, length, apart, tangent);
    }
    for (long i = 0; i < half; i++) tangent[i] /= unit;
    return finite_state((int)(2 * half), tangent) ? FLOW_DONE : FLOW_LOST;
}

int flow_wave(flow *f, flow_motion *m, int nodes, double period, const double *states,
              double *moved, int *ends)
{
    const long size = 2L * f->of.modes;
    flow_motion part = *m;
    memcpy(moved, states, bytes(nodes * size));
    for (int i = 0; i < nodes; i++) {
        part.now = i * period / nodes, part.end = (i + 1) * period / nodes;
        part.state = moved + i * size;
        const int outcome = advance(f, &part, i ? f->closed : NULL);
        m->passed += part.passed;
        m->events = part.events;
        if (outcome != FLOW_DONE) return outcome;
        ends[i] = m->passed;
        part.most -= part.passed;
        part.sets += (long)part.passed * f->of.pairs;
        part.lengths += part.passed;
        part.passed = 0;
    }
    return FLOW_DONE;
}

int flow_carry(flow *f, const flow_track *track, int nodes, const int *ends, const double *excess,
               double *changes)
{
    const long size = 2L * f->of.modes;
    double *still = f->turned; /* no load */
    flow_track part = *track;
    memset(still, 0, bytes(LOAD * (f->of.modes + f->of.pairs)));
    for (int i = 0; i < nodes; i++, changes += size, excess += size) {
        double *next = changes + size;
        part.intervals = ends[i] - (i ? ends[i - 1] : 0);
        memcpy(next, changes, bytes(size));
        const int outcome = flow_column(f, &part, still, still + LOAD * f->of.modes, 0, next);
        if (outcome != FLOW_DONE) return outcome;
        for (long j = 0; j < size; j++) next[j] += excess[j];
        part.sets += (long)part.intervals * f->of.pairs;
        part.lengths += part.intervals;
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
    const long m = given->modes, p = given->pairs, damping = given->coupled ? m * m : m;
    const long room = m + damping + p * p + 2 * p * m + TERMS * (LOAD + m + 2 * p) + (STEPS + 2) * p
                      + 4 * p + m + 2 * LOAD * (m + p) + (2 * TERMS + 2) * m;
    flow *f = calloc(1, sizeof(flow));
    if (!f) return NULL;
    f->of = *given;
    f->room = malloc(bytes(room + 1));
    f->closed = malloc((size_t)p + 1);
    if (!f->room || !f->closed) {
        free_flow(f);
        return NULL;
    }
    double *place = f->room;
    f->of.squares = copied(&place, given->squares, m);
    f->of.damping = copied(&place, given->damping, damping);
    f->of.rows = copied(&place, given->rows, p * m);
    f->of.compliance = copied(&place, given->compliance, p * p);
    f->columns = taken(&place, m * p);
    for (long i = 0; i < p; i++)
        for (long j = 0; j < m; j++) f->columns[j * p + i] = given->rows[i * m + j];
    f->weights = taken(&place, TERMS * LOAD);
    f->series = taken(&place, TERMS * m);
    f->gaps = taken(&place, TERMS * p);
    f->answers = taken(&place, TERMS * p);
    f->value = taken(&place, (STEPS + 1) * p);
    f->falling = taken(&place, p);
    f->allowed = taken(&place, p);
    f->near = taken(&place, p);
    f->force = taken(&place, p);
    f->seen = taken(&place, p);
    f->drag = taken(&place, m);
    f->turned = taken(&place, LOAD * (m + p));
    f->pulled = taken(&place, LOAD * (m + p));
    f->source = taken(&place, TERMS * m);
    f->motion = taken(&place, (TERMS + 2) * m);
    f->known = new_closed_sets((int)m, (int)p, f->of.rows, f->of.compliance, given->most);
    if (f->known) return f;
    free_flow(f);
    return NULL;
}

void flow_damp(flow *f, const double *damping)
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
    free(f->room);
    free(f);
}
