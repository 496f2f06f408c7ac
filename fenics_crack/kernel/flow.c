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
    flow_parts parts;
    int order; /* of the series of a piece */
    closed_sets *sets;
    exponentials *exponential;
    double *work;
    double *columns;                 /* (m, p) P */
    double *weights;                 /* (TERMS, loads) of the load's rows */
    int n_rows;                      /* of contact, r */
    int n_loads;                     /* rows of the load, 2 K + 1 */
    double *series, *gaps, *answers; /* (TERMS, m), (TERMS, r), (TERMS, r) of q, s, i */
    double *forces, *contact_gaps;   /* (TERMS, r) of lambda and g, with friction only */
    double *stick_places;            /* (p) h */
    double *rounding;                /* (r) what of a negative answer is rounding */
    double *step_values, *may_fall;  /* (MAX_SEARCH_STEPS + 1, r), (r) */
    double *state_gaps, *state_forces;     /* (r) s of a state, its forces */
    double *row_work, *damping_force;      /* (r), (m) */
    double *load_rate;                     /* (loads, m + r) derivative of the load */
    double *modal_drive;                   /* (loads, m) of a load, (loads, r) */
    double *source_series, *second_series; /* (TERMS, m), (TERMS + 2, m) of another series */
    signed char *closed;             /* (p) */
    signed char *n_zero_terms; /* (r) first terms of answers that are 0 by how a state began */
    double piece_length, event_slope,
        fallen_answer; /* of the piece; of the answer that fell first at an instant */
};

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

static long numbers_of_state(const flow *f)
{
    return 2L * f->parts.modes + (f->parts.friction ? f->parts.pairs : 0);
}

/* Return a bound of the rate of a set and of the load. Contact may be stiffer than all modes. */
static double max_rate_of(const flow *f, const closed_set *a, double omega)
{
    return fmax(
        fmax(a->size ? f->parts.max_rate : f->parts.max_open_rate, f->parts.harmonics * omega),
        1e-300);
}

/* Set y = C x. */
static void apply_damping(const flow *f, const double *damping, const double *x, double *y)
{
    const int m = f->parts.modes;
    if (f->parts.coupled) multiply(m, m, damping, x, y);
    else
        for (int j = 0; j < m; j++) y[j] = damping[j] * x[j];
}

/* --- the series ------------------------------------------------------------------------------- */

/* Set Taylor coefficients of the load's rows from a time on, in units of a length; with `by_time`
 * those of the load multiplied by the time. */
static void set_load_weights(flow *f, double omega, double time, double length, int by_time)
{
    const int loads = f->n_loads;
    for (int k = 1; 2 * k < loads; k++) {
        const double order_omega = k * omega, c = cos(order_omega * time),
                     s = sin(order_omega * time);
        double *w = f->weights + 2 * k - 1, factor = 1.0;
        for (int n = 0; n <= f->order; n++, w += loads) {
            const double sign = n & 2 ? -factor : factor;
            w[0] = n & 1 ? -sign * s : sign * c;
            w[1] = n & 1 ? sign * c : sign * s;
            factor *= order_omega * length / (n + 1);
        }
    }
    for (int n = 0; n <= f->order; n++) f->weights[n * loads] = n == 0;
    if (!by_time) return;
    for (int n = f->order; n >= 0; n--)
        for (int k = 0; k < loads; k++) {
            double *weight = f->weights + n * loads + k;
            *weight = time * *weight + (n ? length * *(weight - loads) : 0.0);
        }
}

/* Return the order of a series over a length; x: length times the largest frequency. Terms of
 * higher order are rounding: x^n / n!. */
static int choose_order(double x)
{
    double term = 1.0;
    int n = 0;
    while (n < ORDER && term > 1e-18) term *= x / ++n;
    return n;
}

/* Set modal_drive: modal forces of a load and, through the closed pairs, of its gaps. */
static void set_modal_drive(flow *f, const closed_set *a, const double *force, const double *gap)
{
    const int m = f->parts.modes, size = a->size;
    double *closed_gaps = f->modal_drive + f->n_loads * m;
    for (int k = 0, index = 0; k < f->n_loads; k++)
        for (int i = 0; i < size; i++) closed_gaps[index++] = gap[k * f->n_rows + a->rows[i]];
    multiply_matrices(f->n_loads, size, m, closed_gaps, a->modal_push, 0.0, f->modal_drive);
    for (int j = 0; j < f->n_loads * m; j++) f->modal_drive[j] = force[j] - f->modal_drive[j];
}

/* Add the modal forces of the places at which pairs stick, times a gain. */
static void add_stick_forces(flow *f, const closed_set *a, double gain, double *next)
{
    const int m = f->parts.modes, closing = a->n_normals, count = a->size - closing;
    for (int i = 0; i < count; i++)
        f->row_work[i] = gain * f->stick_places[a->rows[closing + i] - f->parts.pairs];
    add_rows(count, m, a->modal_push + (long)closing * m, f->row_work, next);
}

/* Set the series of q over a piece, from a state; `sources`: a further load (TERMS, m), or NULL. */
WIDE static void expand_motion(flow *f, const closed_set *a, const double *force, const double *gap,
                               const double *sources, double length, const double *state)
{
    const int m = f->parts.modes, size = a->size;
    const double *restrict squares = f->parts.squares;
    const double *restrict cosine = f->modal_drive + m, *restrict sine = cosine + m;
    double *restrict row_work = f->row_work, *restrict damping_force = f->damping_force;
    set_modal_drive(f, a, force, gap);
    memcpy(f->series, state, bytes(m));
    for (int j = 0; j < m; j++) f->series[m + j] = length * state[m + j];
    for (int n = 0; n + 2 <= f->order; n++) {
        const double *restrict term = f->series + (long)n * m, *restrict next_term = term + m;
        double *restrict new_term = f->series + (long)(n + 2) * m;
        const double gain = length * length / ((n + 1) * (n + 2)), loss = length / (n + 2);
        const double *w = f->weights + n * f->n_loads;
        const double mean_weight = gain * w[0], cosine_weight = gain * w[1],
                     sine_weight = gain * w[2];
        apply_damping(f, f->parts.damping, next_term, damping_force);
        for (int j = 0; j < m; j++)
            new_term[j] = cosine_weight * cosine[j] + sine_weight * sine[j] -
                          gain * squares[j] * term[j] - loss * damping_force[j];
        if (mean_weight != 0.0) add_rows(1, m, f->modal_drive, &mean_weight, new_term);
        for (int k = 3; k < f->n_loads; k++) {
            const double weight = gain * w[k];
            add_rows(1, m, f->modal_drive + (long)k * m, &weight, new_term);
        }
        if (sources) add_rows(1, m, sources + (long)n * m, &gain, new_term);
        if (n == 0 && f->parts.friction) add_stick_forces(f, a, gain, new_term);
        if (a->stiffness) {
            for (int j = 0; j < m; j++) damping_force[j] = -gain * term[j];
            add_rows(m, m, a->stiffness, damping_force, new_term);
        } else if (size) {
            memset(row_work, 0, bytes(size));
            add_rows(m, size, a->mode_columns, term, row_work);
            for (int i = 0; i < size; i++) row_work[i] *= -gain;
            add_rows(size, m, a->modal_push, row_work, new_term);
        }
    }
}

/* Set the answers with friction. Their first terms are 0 if a state has just begun so. */
static void expand_friction_answers(flow *f, const closed_set *a)
{
    const int p = f->parts.pairs, r = f->n_rows, terms = f->order + 1;
    for (int i = 0; i < p; i++) {
        const int state = a->closed[i];
        const double mu = f->parts.friction[i], direction = state == SLIP_UP ? 1.0 : -1.0;
        for (int n = 0; n < terms; n++) {
            const double *force = f->forces + (long)n * r, *gap = f->contact_gaps + (long)n * r;
            double *first_answer = f->answers + (long)n * r + i, *second_answer = first_answer + p;
            if (state == OPEN) {
                *first_answer = -gap[i];
                *second_answer = n == 0;
            } else if (state == STICK) {
                *first_answer = mu * force[i] - force[p + i];
                *second_answer = mu * force[i] + force[p + i];
            } else {
                *first_answer = force[i];
                *second_answer = n + 1 < terms ? direction * (n + 1) * gap[r + p + i] : 0.0;
            }
        }
    }
    for (int k = 0; k < r; k++)
        for (int n = 0; n < f->n_zero_terms[k]; n++) f->answers[(long)n * r + k] = 0.0;
}

/* Set the series of the gaps s and of the answers. */
static void expand_answers(flow *f, const closed_set *a, const double *gap)
{
    const int m = f->parts.modes, r = f->n_rows, terms = f->order + 1;
    multiply_matrices(terms, f->n_loads, r, f->weights, gap, 0.0, f->gaps);
    multiply_matrices(terms, m, r, f->series, f->columns, 1.0, f->gaps);
    if (!f->parts.friction) {
        make_answers(f->sets, a, terms, f->gaps, f->answers);
        return;
    }
    memcpy(f->contact_gaps, f->gaps, bytes((long)terms * r));
    solve_friction_forces(f->sets, a, terms, f->stick_places, f->contact_gaps, f->forces);
    expand_friction_answers(f, a);
}

static void set_rounding(flow *f, const closed_set *a, double length)
{
    const double largest = series_size(f->n_rows, f->order, f->gaps, length);
    for (int i = 0; i < f->n_rows; i++)
        f->rounding[i] = ZERO_TOLERANCE * largest * a->answer_scale[i];
}

static void state_at(const flow *f, double length, double time, double *state)
{
    const int m = f->parts.modes;
    series_at(m, f->order, f->series, time, state, state + m);
    for (int j = m; j < 2 * m; j++) state[j] /= length;
}

/* --- events ----------------------------------------------------------------------------------- */

/* Return the time at which an answer becomes negative in a step of the search, from its values at
 * the ends; NAN if it does not, or not before `earliest`. If several change at one instant, as in
 * mirror images, each of the others falls from zero in a next piece. They change one after the
 * other, the first pair first, which ends (Murty, Opsearch 11 (1974) 90). */
static double find_fall(const flow *f, int pair, double low, double high, double earliest,
                        double low_value, double high_value)
{
    const int p = f->n_rows;
    double slope, minimum, low_slope, high_slope;
    /* Rates jump where another pair leaves its state. */
    if (f->parts.friction && low_value < -f->rounding[pair]) return fmax(low, ROUNDING);
    if (high_value >= -f->rounding[pair]) {
        /* Both ends positive, but a minimum between them may not be. */
        column_at(p, f->order, f->answers, pair, 0, low, &low_slope);
        column_at(p, f->order, f->answers, pair, 0, high, &high_slope);
        if (!(low_slope < 0.0 && high_slope > 0.0 && low_value + (high - low) * low_slope < 0.0))
            return NAN;
        high = column_zero(p, f->order, f->answers, pair, 1, low, high);
        minimum = column_at(p, f->order, f->answers, pair, 0, high, &slope);
        if (minimum >= -f->rounding[pair]) return NAN;
    }
    if (low_value <= f->rounding[pair]) {
        low = fmax(low, ROUNDING); /* pairs that should have changed with the one before */
        if (low >= high || column_at(p, f->order, f->answers, pair, 0, low, &slope) <= 0.0)
            return low;
    }
    if (earliest < high) {
        if (column_at(p, f->order, f->answers, pair, 0, earliest, &slope) > 0.0) return NAN;
        high = earliest;
    }
    return column_zero(p, f->order, f->answers, pair, 0, low, high);
}

/* Mark the answers (p) that may become negative in a step; return whether any may. An answer is
 * marked if it is negative at the end, or may dip below zero. Between two values it dips below both
 * by at most an eighth of the second difference, estimated from four neighbouring ends of steps;
 * twice that is allowed for. */
WIDE static int mark_falling_answers(int p, const double *restrict low, const double *restrict high,
                                     const double *restrict neighbours,
                                     double *restrict is_candidate)
{
    const double *second = neighbours + p, *third = second + p, *fourth = third + p;
    double count = 0.0;
    for (int i = 0; i < p; i++) {
        const double first_bend = fabs(neighbours[i] - 2.0 * second[i] + third[i]);
        const double second_bend = fabs(second[i] - 2.0 * third[i] + fourth[i]);
        const double min_value = low[i] < high[i] ? low[i] : high[i];
        const double max_dip = 0.25 * (first_bend > second_bend ? first_bend : second_bend);
        is_candidate[i] = high[i] < 0.0 || min_value < max_dip ? 1.0 : 0.0;
        count += is_candidate[i];
    }
    return count > 0.0;
}

/* Return the answer that falls first and set its time; -1 if none falls before `end`. */
static int next_event(flow *f, double step, double end, double *time_out)
{
    const int p = f->n_rows;
    const int steps =
        (int)fmin(fmax(ceil(end / step), 3), MAX_SEARCH_STEPS); /* three show how answers bend */
    double times[MAX_TIMES];
    for (int k = 0; k <= steps; k++) times[k] = k < steps ? k * end / steps : end;
    values_at(p, f->order, f->answers, steps + 1, times, f->step_values);
    for (int k = 0; k < steps && p; k++) {
        const double *low = f->step_values + (long)k * p, *high = low + p;
        const int first_neighbour = k == 0 ? 0 : k + 3 <= steps ? k - 1 : steps - 3;
        int fallen = -1;
        if (!mark_falling_answers(p, low, high, f->step_values + (long)first_neighbour * p,
                                  f->may_fall))
            continue;
        for (int i = 0; i < p; i++) {
            if (f->may_fall[i] == 0.0) continue;
            const double earliest = fallen >= 0 ? *time_out : INFINITY;
            const double root = find_fall(f, i, times[k], times[k + 1], earliest, low[i], high[i]);
            if (isnan(root) || (fallen >= 0 && root >= *time_out)) continue;
            fallen = i;
            *time_out = root;
        }
        if (fallen >= 0) return fallen;
    }
    return -1;
}

/* --- motions ---------------------------------------------------------------------------------- */

/* Set the gaps s of a state. */
static void set_state_gaps(flow *f, double omega, double time, const double *state)
{
    set_load_weights(f, omega, time, 0.0, 0);
    multiply(f->n_rows, f->parts.modes, f->parts.rows, state, f->state_gaps);
    add_rows(f->n_loads, f->n_rows, f->parts.gap, f->weights, f->state_gaps);
}

/* Find the set of closed pairs of a state and its forces, from a guess or (NULL) from its gaps.
 * Returns 0, or 1 if there is none. */
static int find_state_set(flow *f, double omega, double time, const double *state,
                          const signed char *guessed_set)
{
    const int m = f->parts.modes, p = f->parts.pairs;
    set_state_gaps(f, omega, time, state);
    for (int i = 0; i < p; i++)
        f->closed[i] = guessed_set ? guessed_set[i] : f->state_gaps[i] > 0.0;
    if (f->parts.friction) {
        memcpy(f->stick_places, state + 2 * m, bytes(p));
        return !find_states(f->sets, f->stick_places, f->closed, f->state_gaps, f->state_forces);
    }
    if (!find_closed_set(f->sets, f->state_gaps, f->closed, f->state_forces)) return 1;
    for (int i = 0; i < p; i++)
        if (!f->closed[i]) f->state_forces[i] = 0.0;
    return 0;
}

/* Record the motion at the instants up to the end of a piece. */
static void record_samples(const flow *f, flow_motion *m, const signed char *closed, double length,
                           double end, int is_last)
{
    const int n = f->parts.modes, p = f->parts.pairs, r = f->n_rows,
              n_answers = f->parts.friction ? 2 * r : p;
    for (; m->n_samples < m->n_instants; m->n_samples++) {
        const double position = fmax(0.0, (m->instants[m->n_samples] - m->time) / length);
        const double time = fmin(position, end);
        const long sample_index = m->n_samples;
        double *answers = m->answers + sample_index * n_answers;
        if (!is_last && position >= end) break;
        state_at(f, length, time, m->states + sample_index * 2 * n);
        series_at(r, f->order, f->parts.friction ? f->forces : f->answers, time, answers,
                  f->step_values);
        if (f->parts.friction)
            series_at(r, f->order, f->contact_gaps, time, answers + r, f->step_values);
        memcpy(m->closed + sample_index * p, closed, (size_t)p);
    }
}

/* Record a piece of the track, in the last interval or in a new one. */
static void record_piece(const flow *f, flow_motion *m, const signed char *closed, double length)
{
    const int p = f->parts.pairs, last_interval = m->n_intervals - 1;
    const int continues_interval =
        f->parts.friction
            ? last_interval >= 0 && m->causes[last_interval] < 0
            : last_interval >= 0 && !memcmp(m->sets + (long)last_interval * p, closed, (size_t)p);
    if (continues_interval) {
        m->lengths[last_interval] += length;
        return;
    }
    memcpy(m->sets + (long)m->n_intervals * p, closed, (size_t)p);
    if (f->parts.friction) m->causes[m->n_intervals] = -1;
    m->lengths[m->n_intervals++] = length;
}

/* Change the state of the pair whose answer fell at a time of the piece. is_first: no other answer
 * fell before at this instant. The last interval keeps what derivatives need. */
static void change_pair_state(flow *f, flow_motion *m, int fallen, double time, int is_first)
{
    const int p = f->parts.pairs, r = f->n_rows, pair = fallen % p, interval = m->n_intervals - 1;
    const int state = f->closed[pair], by_rate = state >= SLIP_UP && fallen >= p;
    signed char *zeros = f->n_zero_terms;
    double slope, rate;
    if (is_first) memset(zeros, 0, (size_t)r);
    m->causes[interval] = fallen;
    m->is_first[interval] = (signed char)is_first;
    const double place = column_at(r, f->order, f->contact_gaps, p + pair, 0, time, &rate);
    column_at(r, f->order, f->answers, fallen, 0, time, &slope);
    if (is_first) f->event_slope = slope / f->piece_length;
    m->ratios[interval] = by_rate && is_first ? 0.0 : rate / f->piece_length / f->event_slope;
    f->closed[pair] = state == OPEN || by_rate ? STICK
                      : state == STICK         ? (fallen < p ? SLIP_UP : SLIP_DOWN)
                                               : OPEN;
    if (!(by_rate && is_first))
        for (int k = 0; k < r; k++) zeros[k] = zeros[k] != 0;
    zeros[pair] = zeros[p + pair] = 0;
    if (f->closed[pair] == STICK) {
        f->stick_places[pair] = place;
        if (state != SLIP_DOWN) zeros[pair] = 1;
        if (state != SLIP_UP) zeros[p + pair] = 1;
        if (by_rate && is_first) zeros[state == SLIP_UP ? pair : p + pair] = 2;
    }
    if (f->closed[pair] == OPEN) zeros[pair] = 1;
}

static int is_finite(int count, const double *state)
{
    double sum = 0.0;
    for (int i = 0; i < count; i++) sum += 0.0 * state[i];
    return sum == 0.0;
}

/* Store the places of the pairs at the end of a motion: where they stick, or where they are. */
static void store_stick_places(const flow *f, double time, double *state)
{
    const int p = f->parts.pairs;
    double rate;
    for (int i = 0; i < p; i++)
        state[2 * f->parts.modes + i] =
            f->closed[i] == STICK
                ? f->stick_places[i]
                : column_at(f->n_rows, f->order, f->contact_gaps, p + i, 0, time, &rate);
}

/* Follow a motion, from a guess of its first set of closed pairs, or NULL. */
static int advance(flow *f, flow_motion *m, const signed char *guessed_set)
{
    const int p = f->parts.pairs, has_friction = f->parts.friction != NULL;
    double interval_duration = 0.0, max_length = INFINITY;
    int n_simultaneous = 0; /* events at one instant */
    signed char *states = f->closed;
    if (find_state_set(f, m->omega, m->time, m->state, guessed_set)) return FLOW_FAILED;
    memset(f->n_zero_terms, 0, (size_t)f->n_rows);
    for (; m->time < m->end; m->n_pieces++) {
        const closed_set *a = get_closed_set(f->sets, states);
        if (!a) return has_friction ? FLOW_FAILED : FLOW_NO_MEMORY;
        const double rate = max_rate_of(f, a, m->omega), max_reach = MAX_PIECE_ANGLE / rate;
        /* Pieces between closing events are short, and a short series has few terms. */
        const double length_limit =
            fmin(max_reach, fmax(1.0 / (STEPS_PER_RADIAN * rate), max_length));
        const double length = fmin(length_limit, m->end - m->time),
                     remaining = (m->end - m->time) / length;
        if (m->n_pieces + (m->end - m->time) / max_reach > m->max_pieces)
            return FLOW_TOO_MANY_PIECES;
        if (m->n_intervals == m->max_intervals) return FLOW_TOO_MANY_INTERVALS;
        f->order = choose_order(length * rate);
        set_load_weights(f, m->omega, m->time, length, 0);
        expand_motion(f, a, f->parts.force, f->parts.gap, NULL, length, m->state);
        expand_answers(f, a, f->parts.gap);
        double end = series_reach(f->parts.modes, f->order, f->series, fmin(1.0, remaining));
        end = series_reach(f->n_rows, f->order, f->gaps, end);
        if (!(end > 0.0)) return FLOW_FAILED;
        set_rounding(f, a, end);
        double time = end;
        const int fallen = next_event(f, 1.0 / (STEPS_PER_RADIAN * length * rate), end, &time);
        const int is_last = fallen < 0 && end == remaining;
        record_samples(f, m, states, length, time, is_last);
        state_at(f, length, time, m->state);
        if (!is_finite(2 * f->parts.modes, m->state)) return FLOW_FAILED;
        record_piece(f, m, states, time * length);
        m->time = is_last ? m->end : m->time + time * length;
        interval_duration += time * length;
        max_length = INFINITY;
        if (has_friction && is_last) store_stick_places(f, time, m->state);
        if (fallen < 0) memset(f->n_zero_terms, 0, (size_t)f->n_rows);
        n_simultaneous = fallen < 0 ? 0 : time > ROUNDING ? 1 : n_simultaneous + 1;
        if (fallen < 0) continue;
        if (has_friction) {
            f->piece_length = length;
            change_pair_state(f, m, fallen, time, n_simultaneous == 1);
            if (n_simultaneous > 6 * p) return FLOW_FAILED;
        } else states[fallen] = !states[fallen];
        max_length = 2.0 * interval_duration;
        interval_duration = 0.0;
        m->n_events++;
    }
    return FLOW_DONE;
}

int flow_advance(flow *f, flow_motion *m) { return advance(f, m, NULL); }

/* Return the set of an interval and set the length of its pieces; NULL without memory. */
static const closed_set *enter_interval(flow *f, const flow_track *track, int interval,
                                        double *length)
{
    const closed_set *a = get_closed_set(f->sets, track->sets + (long)interval * f->parts.pairs);
    if (!a) return NULL;
    const double duration = track->lengths[interval], rate = max_rate_of(f, a, track->omega);
    *length = duration / ceil(duration * rate / MAX_PIECE_ANGLE);
    f->order = choose_order(*length * rate);
    return a;
}

/* --- changes where pairs stick ---------------------------------------------------------------- */

/* Set the weights (r) of the forces in an answer, and the sign of the gap or its rate in it. Return
 * this gap's row, or -1 if the answer holds forces alone. */
static int set_answer_weights(const flow *f, const closed_set *a, int k, double *weights,
                              double *sign)
{
    const int p = f->parts.pairs, r = f->n_rows, i = k % p, state = a->closed[i];
    const double tangent_sign = k < p ? -1.0 : 1.0;
    memset(weights, 0, bytes(r));
    *sign = state == OPEN ? -1.0 : state == SLIP_UP ? 1.0 : -1.0;
    if (state == STICK) {
        weights[i] = f->parts.friction[i];
        weights[p + i] = tangent_sign;
        return -1;
    }
    if (state != OPEN && k < p) {
        weights[i] = 1.0;
        return -1;
    }
    const int row = state == OPEN ? i : k;
    for (int q = 0; q < r; q++) weights[q] = -*sign * f->parts.compliance[(long)row * r + q];
    return row;
}

/* Columns of derivatives: (m, c) of q and of its rate, (p, c) of h. */
typedef struct {
    int n_columns;
    double *displacements, *velocities, *stick_places;
    double *terms;         /* (3, m, c) of a series */
    double *place_push;    /* (m, c) modal forces of the places */
    double *to_modes,
        *from_modes;  /* (m, m) stiffness of a set, or of one with few rows (m, size), (size, m) */
    double *row_work; /* (size, c) products with these */
    double *fallen_change, *place_change; /* (c) of the answer that fell first, (c) of a place */
    double *weights;       /* (r) */
} changes;

/* Set the changes (c) of an answer: sign times one gap (or its rate), and forces with the weights.
 * x (m, c): changes of q or of its rate; the places enter only with those of q. */
static void answer_change(const flow *f, const closed_set *a, const changes *c, int row,
                          double sign, const double *modal_changes, double *change_out)
{
    const int m = f->parts.modes, p = f->parts.pairs, r = f->n_rows;
    memset(change_out, 0, bytes(c->n_columns));
    multiply(a->size, r, a->inverse, c->weights, f->row_work);
    for (int j = 0; j < m; j++) {
        double weight = dot(a->size, a->mode_columns + (long)j * a->size, f->row_work);
        if (row >= 0) weight += sign * f->parts.rows[(long)row * m + j];
        add_rows(1, c->n_columns, modal_changes + (long)j * c->n_columns, &weight, change_out);
    }
    if (modal_changes != c->displacements) return;
    for (int i = a->n_normals; i < a->size; i++) {
        const double weight = -f->row_work[i];
        add_rows(1, c->n_columns, c->stick_places + (long)(a->rows[i] - p) * c->n_columns, &weight,
                 change_out);
    }
}

/* Set place_change: change of the place of a pair that does not stick. */
static void change_place(const flow *f, const closed_set *a, int pair, changes *c)
{
    const int row = f->parts.pairs + pair, r = f->n_rows;
    for (int q = 0; q < r; q++) c->weights[q] = -f->parts.compliance[(long)row * r + q];
    answer_change(f, a, c, row, 1.0, c->displacements, c->place_change);
}

static int sticks_throughout(const flow *f, const flow_track *track, int pair)
{
    for (int k = 0; k < track->n_intervals; k++)
        if (track->sets[(long)k * f->parts.pairs + pair] != STICK) return 0;
    return 1;
}

/* Change the place of the pair whose state changes at the end of an interval. */
static void apply_state_change(flow *f, const flow_track *track, int interval, const closed_set *a,
                               changes *c)
{
    const int p = f->parts.pairs, fallen = track->causes[interval];
    if (fallen < 0) return;
    const int pair = fallen % p, state = a->closed[pair], by_rate = state >= SLIP_UP && fallen >= p;
    if (track->is_first[interval]) {
        double sign;
        const int row = set_answer_weights(f, a, fallen, c->weights, &sign);
        answer_change(f, a, c, row, sign, by_rate ? c->velocities : c->displacements,
                      c->fallen_change);
    }
    double *place_changes = c->stick_places + (long)pair * c->n_columns;
    if (state == OPEN || by_rate) {
        const double time_shift = -track->ratios[interval];
        change_place(f, a, pair, c);
        memcpy(place_changes, c->place_change, bytes(c->n_columns));
        if (time_shift != 0.0)
            add_rows(1, c->n_columns, c->fallen_change, &time_shift, place_changes);
    } else memset(place_changes, 0, bytes(c->n_columns));
}

/* Set A^T of A (rows, columns). */
static void transpose(int rows, int columns, const double *a, double *transpose_out)
{
    for (long i = 0; i < rows; i++)
        for (long j = 0; j < columns; j++) transpose_out[j * rows + i] = a[i * columns + j];
}

/* Advance the changes over a length. */
static void advance_changes(flow *f, const closed_set *a, double length, changes *c)
{
    const int m = f->parts.modes, p = f->parts.pairs, n_stuck = a->size - a->n_normals,
              n = c->n_columns;
    const long size = (long)m * n;
    const double rate = max_rate_of(f, a, 0.0);
    const int pieces = (int)ceil(length * rate / MAX_PIECE_ANGLE);
    double *term = c->terms, *next_term = term + size, *new_term = next_term + size;
    if (a->stiffness) transpose(m, m, a->stiffness, c->to_modes);
    else {
        c->from_modes = c->to_modes + (long)m * a->size;
        transpose(a->size, m, a->modal_push, c->to_modes);
        transpose(m, a->size, a->mode_columns, c->from_modes);
    }
    memset(c->place_push, 0, bytes(size));
    for (int i = 0; i < n_stuck; i++)
        for (int j = 0; j < m; j++)
            add_rows(1, n, c->stick_places + (long)(a->rows[a->n_normals + i] - p) * n,
                     a->modal_push + (long)(a->n_normals + i) * m + j, c->place_push + (long)j * n);
    if (pieces) length /= pieces;
    f->order = choose_order(length * rate);
    for (int piece = 0; piece < pieces; piece++) {
        memcpy(term, c->displacements, bytes(size));
        for (long i = 0; i < size; i++) next_term[i] = length * c->velocities[i];
        for (long i = 0; i < size; i++) c->displacements[i] += next_term[i];
        for (int k = 0; k + 2 <= f->order; k++) {
            const double gain = -length * length / ((k + 1) * (k + 2)), loss = -length / (k + 2);
            double *old_term = term;
            if (a->stiffness) multiply_matrices(m, m, n, c->to_modes, term, 0.0, new_term);
            else {
                multiply_matrices(a->size, m, n, c->from_modes, term, 0.0, c->row_work);
                multiply_matrices(m, a->size, n, c->to_modes, c->row_work, 0.0, new_term);
            }
            for (int j = 0; j < m; j++)
                for (long i = (long)j * n; i < (long)(j + 1) * n; i++)
                    new_term[i] += f->parts.squares[j] * term[i];
            if (k == 0)
                for (long i = 0; i < size; i++) new_term[i] -= c->place_push[i];
            if (f->parts.coupled) {
                multiply_matrices(m, m, n, f->parts.damping, next_term, gain / loss, new_term);
                for (long i = 0; i < size; i++) new_term[i] *= loss;
            } else
                for (int j = 0; j < m; j++)
                    for (long i = (long)j * n; i < (long)(j + 1) * n; i++)
                        new_term[i] =
                            gain * new_term[i] + loss * f->parts.damping[j] * next_term[i];
            for (long i = 0; i < size; i++) {
                c->displacements[i] += new_term[i];
                c->velocities[i] += (k + 2) / length * new_term[i];
            }
            term = next_term;
            next_term = new_term;
            new_term = old_term;
        }
    }
}

/* The derivative (2 m + p, 2 m + p) by z and h. */
static int tangent_with_friction(flow *f, const flow_track *track, double *tangent)
{
    const closed_set *a = NULL;
    const long m = f->parts.modes, p = f->parts.pairs, r = f->n_rows, n = 2 * m + p;
    double *work = malloc(bytes(4 * m * n + m * m + 2 * n + r + m / 2 * n));
    if (!work) return FLOW_NO_MEMORY;
    changes c = {.n_columns = (int)n,
                 .displacements = tangent,
                 .velocities = tangent + m * n,
                 .stick_places = tangent + 2 * m * n,
                 .terms = work,
                 .place_push = work + 3 * m * n};
    c.to_modes = c.place_push + m * n;
    c.fallen_change = c.to_modes + m * m;
    c.place_change = c.fallen_change + n;
    c.weights = c.place_change + n;
    c.row_work = c.weights + r;
    memset(tangent, 0, bytes(n * n));
    for (long i = 0; i < n; i++) tangent[i * (n + 1)] = 1.0;
    for (int k = 0; k < track->n_intervals; k++) {
        a = get_closed_set(f->sets, track->sets + (long)k * p);
        if (!a) {
            free(work);
            return FLOW_NO_MEMORY;
        }
        advance_changes(f, a, track->lengths[k], &c);
        apply_state_change(f, track, k, a, &c);
    }
    for (int i = 0; i < p && a; i++) {
        double *place = c.stick_places + i * n;
        if (a->closed[i] != STICK) {
            change_place(f, a, i, &c);
            memcpy(place, c.place_change, bytes(n));
        } else if (sticks_throughout(f, track, i)) memset(place, 0, bytes(n));
    }
    free(work);
    return is_finite((int)(n * n), tangent) ? FLOW_DONE : FLOW_FAILED;
}

/* Update the places at the end of an interval: of the pair that changes its state, with the change
 * `fallen_answer` of the answer that fell, and at the end of the motion of all pairs. */
static void update_stick_places(flow *f, const flow_track *track, int interval, const closed_set *a,
                                const double *gap, double length, double end)
{
    const int m = f->parts.modes, p = f->parts.pairs, r = f->n_rows, terms = f->order + 1;
    const int fallen = track->causes[interval], is_last = interval + 1 == track->n_intervals;
    double *forces = f->state_forces, *gaps = f->state_gaps, *rates = f->may_fall, sign;
    if (fallen < 0 && !is_last) return;
    multiply_matrices(terms, f->n_loads, r, f->weights, gap, 0.0, f->contact_gaps);
    multiply_matrices(terms, m, r, f->series, f->columns, 1.0, f->contact_gaps);
    solve_friction_forces(f->sets, a, terms, f->stick_places, f->contact_gaps, f->forces);
    series_at(r, f->order, f->forces, end, forces, rates);
    series_at(r, f->order, f->contact_gaps, end, gaps, rates);
    if (fallen >= 0) {
        const int pair = fallen % p, state = a->closed[pair], by_rate = state >= SLIP_UP && fallen >= p;
        if (track->is_first[interval]) {
            const int row = set_answer_weights(f, a, fallen, f->step_values, &sign);
            f->fallen_answer = row < 0 ? dot(r, forces, f->step_values)
                                       : sign * (by_rate ? rates[row] / length : gaps[row]);
        }
        f->stick_places[pair] = state == OPEN || by_rate
                                    ? gaps[p + pair] - track->ratios[interval] * f->fallen_answer
                                    : 0.0;
    }
    for (int i = 0; i < p && is_last; i++)
        if (a->closed[i] != STICK) f->stick_places[i] = gaps[p + i];
}

int flow_by_load(flow *f, const flow_track *track, const double *force, const double *gap,
                 int by_time, double *state)
{
    double time = track->start, *stick_places = state + 2 * f->parts.modes;
    if (f->parts.friction) memcpy(f->stick_places, stick_places, bytes(f->parts.pairs));
    for (int k = 0; k < track->n_intervals; k++) {
        double length;
        const closed_set *a = enter_interval(f, track, k, &length);
        if (!a) return FLOW_NO_MEMORY;
        for (double remaining = length > 0.0 ? track->lengths[k] / length : 0.0; remaining > 0.0;) {
            set_load_weights(f, track->omega, time, length, by_time);
            expand_motion(f, a, force, gap, NULL, length, state);
            const double end =
                series_reach(f->parts.modes, f->order, f->series, fmin(1.0, remaining));
            if (!(end > 0.0)) return FLOW_FAILED;
            state_at(f, length, end, state);
            remaining -= end;
            time += end * length;
            if (f->parts.friction && !(remaining > 0.0))
                update_stick_places(f, track, k, a, gap, length, end);
        }
    }
    if (f->parts.friction) memcpy(stick_places, f->stick_places, bytes(f->parts.pairs));
    return FLOW_DONE;
}

/* d/d omega of c cos(k omega t) + s sin(k omega t) is t times k (s cos - c sin). */
static void differentiate_load(int loads, int n, const double *rows, double *rate_out)
{
    memset(rate_out, 0, bytes(n));
    for (int k = 1; 2 * k < loads; k++) {
        const double *cosine = rows + (2L * k - 1) * n, *sine = cosine + n;
        double *rate = rate_out + (2L * k - 1) * n;
        for (int j = 0; j < n; j++) rate[j] = k * sine[j], rate[n + j] = -k * cosine[j];
    }
}

int flow_by_omega(flow *f, const flow_track *track, double *state)
{
    const int m = f->parts.modes;
    double *force = f->load_rate, *gap = force + f->n_loads * m;
    memset(state, 0, bytes(numbers_of_state(f)));
    differentiate_load(f->n_loads, m, f->parts.force, force);
    differentiate_load(f->n_loads, f->n_rows, f->parts.gap, gap);
    return flow_by_load(f, track, force, gap, 1, state);
}

/* Set the sources of the derivative of a motion with known series: -C' q' and P_A S D' lambda, the
 * derivative of -P_A S s. */
static void set_sources(flow *f, const closed_set *a, const double *damping,
                        const double *compliance, double length)
{
    const int m = f->parts.modes, p = f->parts.pairs;
    memset(f->source_series, 0, bytes((f->order + 1L) * m));
    for (int n = 0; n < f->order; n++) {
        double *source = f->source_series + (long)n * m;
        if (damping) {
            apply_damping(f, damping, f->series + (n + 1L) * m, f->damping_force);
            for (int j = 0; j < m; j++) source[j] = -(n + 1) / length * f->damping_force[j];
        }
        for (int i = 0; compliance && i < a->size; i++) {
            const int row = a->rows[i];
            f->row_work[i] = compliance[row] * f->answers[(long)n * p + row];
        }
        if (compliance) add_rows(a->size, m, a->modal_push, f->row_work, source);
    }
}

int flow_by_structure(flow *f, const flow_track *track, const double *start, const double *damping,
                      const double *compliance, double *state)
{
    const int m = f->parts.modes;
    double *zero_load = f->load_rate, *state_on_motion = f->second_series + (long)TERMS * m,
           *series = f->series;
    double time = track->start;
    if (f->parts.friction) return FLOW_FAILED; /* not implemented: the places of sticking pairs
                                                * change as well */
    memset(zero_load, 0, bytes(f->n_loads * (m + f->n_rows)));
    memset(state, 0, bytes(2 * m));
    memcpy(state_on_motion, start, bytes(2 * m));
    for (int k = 0; k < track->n_intervals; k++) {
        double length;
        const closed_set *a = enter_interval(f, track, k, &length);
        if (!a) return FLOW_NO_MEMORY;
        for (double remaining = length > 0.0 ? track->lengths[k] / length : 0.0; remaining > 0.0;) {
            set_load_weights(f, track->omega, time, length, 0);
            expand_motion(f, a, f->parts.force, f->parts.gap, NULL, length, state_on_motion);
            expand_answers(f, a, f->parts.gap);
            set_sources(f, a, damping, compliance, length);
            double end = series_reach(m, f->order, series, fmin(1.0, remaining));
            f->series = f->second_series;
            expand_motion(f, a, zero_load, zero_load + f->n_loads * m, f->source_series, length,
                          state);
            end = series_reach(m, f->order, f->series, end);
            if (end > 0.0) state_at(f, length, end, state);
            f->series = series;
            if (!(end > 0.0)) return FLOW_FAILED;
            state_at(f, length, end, state_on_motion);
            remaining -= end;
            time += end * length;
        }
    }
    return is_finite(2 * m, state) ? FLOW_DONE : FLOW_FAILED;
}

int flow_rate(flow *f, double omega, double time, const signed char *closed, const double *state,
              double *rate)
{
    const int m = f->parts.modes, p = f->parts.pairs, r = f->n_rows;
    const closed_set *a = f->parts.friction ? get_closed_set(f->sets, closed) : NULL;
    double *accelerations = rate + m;
    if (f->parts
            .friction) { /* with friction, places do not tell the states */
        if (!a) return 1;
        set_state_gaps(f, omega, time, state);
        memcpy(f->stick_places, state + 2 * m, bytes(p));
        solve_friction_forces(f->sets, a, 1, f->stick_places, f->state_gaps, f->state_forces);
    } else if (find_state_set(f, omega, time, state, NULL)) return 1;
    memcpy(rate, state + m, bytes(m));
    multiply(m, f->n_rows, f->columns, f->state_forces, accelerations);
    apply_damping(f, f->parts.damping, rate, f->damping_force);
    for (int j = 0; j < m; j++)
        accelerations[j] = -accelerations[j] - f->damping_force[j] - f->parts.squares[j] * state[j];
    add_rows(f->n_loads, m, f->parts.force, f->weights, accelerations);
    if (!f->parts.friction) return 0;
    f->order = 1;
    set_load_weights(f, omega, time, 1.0, 0);
    multiply(r, m, f->parts.rows, rate, f->state_gaps);
    add_rows(f->n_loads, r, f->parts.gap, f->weights + f->n_loads, f->state_gaps);
    memset(f->stick_places, 0, bytes(p)); /* places where pairs stick stay */
    solve_friction_forces(f->sets, a, 1, f->stick_places, f->state_gaps, f->state_forces);
    for (int i = 0; i < p; i++) rate[2 * m + i] = closed[i] == STICK ? 0.0 : f->state_gaps[p + i];
    return 0;
}

int flow_tangent(flow *f, const flow_track *track, double *tangent)
{
    const long size = 2L * f->parts.modes, half = size * f->parts.modes, p = f->parts.pairs;
    const double unit = fmax(f->parts.max_rate, 1e-300);
    int are_modes_apart = 1;
    if (f->parts.friction) return tangent_with_friction(f, track, tangent);
    if (!f->exponential)
        f->exponential = new_exponentials(f->parts.modes, f->parts.coupled, f->parts.squares,
                                          f->parts.damping, unit);
    if (!f->exponential) return FLOW_NO_MEMORY;
    memset(tangent, 0, bytes(2 * half));
    for (long i = 0; i < size; i++) tangent[i * (size + 1)] = i < f->parts.modes ? unit : 1.0;
    for (int k = 0, next_interval; k < track->n_intervals;
         k = next_interval) { /* neighbouring intervals with the same set */
        const signed char *closed = track->sets + k * p;
        const closed_set *a = get_closed_set(f->sets, closed);
        double length = track->lengths[k];
        if (!a) return FLOW_NO_MEMORY;
        for (next_interval = k + 1; next_interval < track->n_intervals; next_interval++) {
            if (memcmp(track->sets + next_interval * p, closed, (size_t)p)) break;
            length += track->lengths[next_interval];
        }
        are_modes_apart = multiply_exponential(f->exponential, a, length, are_modes_apart, tangent);
    }
    add_kicks(f->exponential, tangent);
    for (long i = 0; i < half; i++) tangent[i] /= unit;
    return is_finite((int)(2 * half), tangent) ? FLOW_DONE : FLOW_FAILED;
}

int flow_advance_parts(flow *f, flow_motion *m, int n_parts, double period, const double *states,
                       double *end_states, int *interval_counts)
{
    const long size = numbers_of_state(f);
    flow_motion part = *m;
    memcpy(end_states, states, bytes(n_parts * size));
    for (int i = 0; i < n_parts; i++) {
        part.time = i * period / n_parts, part.end = (i + 1) * period / n_parts;
        part.state = end_states + i * size;
        const int outcome = advance(f, &part, i ? f->closed : NULL);
        m->n_intervals += part.n_intervals;
        m->n_events = part.n_events;
        if (outcome != FLOW_DONE) return outcome;
        interval_counts[i] = m->n_intervals;
        part.max_intervals -= part.n_intervals;
        part.sets += (long)part.n_intervals * f->parts.pairs;
        part.lengths += part.n_intervals;
        if (f->parts.friction)
            part.causes += part.n_intervals, part.is_first += part.n_intervals,
                part.ratios += part.n_intervals;
        part.n_intervals = 0;
    }
    return FLOW_DONE;
}

int flow_carry_changes(flow *f, const flow_track *track, int n_parts, const int *interval_counts,
                       const double *excess, double *changes)
{
    const long size = numbers_of_state(f);
    double *zero_load = f->load_rate; /* no load */
    flow_track part = *track;
    memset(zero_load, 0, bytes(f->n_loads * (f->parts.modes + f->n_rows)));
    for (int i = 0; i < n_parts; i++, changes += size, excess += size) {
        double *next_change = changes + size;
        part.n_intervals = interval_counts[i] - (i ? interval_counts[i - 1] : 0);
        memcpy(next_change, changes, bytes(size));
        const int outcome = flow_by_load(f, &part, zero_load,
                                         zero_load + f->n_loads * f->parts.modes, 0, next_change);
        if (outcome != FLOW_DONE) return outcome;
        for (long j = 0; j < size; j++) next_change[j] += excess[j];
        part.sets += (long)part.n_intervals * f->parts.pairs;
        part.lengths += part.n_intervals;
        if (f->parts.friction)
            part.causes += part.n_intervals, part.is_first += part.n_intervals,
                part.ratios += part.n_intervals;
    }
    return FLOW_DONE;
}

/* --- made and freed --------------------------------------------------------------------------- */

static double *take_room(double **place, long count)
{
    double *array = *place;
    *place += count;
    return array;
}

static double *copy_to_room(double **place, const double *source, long count)
{
    return memcpy(take_room(place, count), source, bytes(count));
}

flow *new_flow(const flow_parts *parts)
{
    const long m = parts->modes, pairs = parts->pairs, damping = parts->coupled ? m * m : m;
    const long p = parts->friction ? 2 * pairs : pairs, loads = 2L * parts->harmonics + 1;
    const long size = m + damping + p * p + 2 * p * m + TERMS * (loads + m + 4 * p) +
                      (MAX_SEARCH_STEPS + 2) * p + 6 * p + m + 2 * loads * (m + p) +
                      (2 * TERMS + 2) * m;
    flow *f = calloc(1, sizeof(flow));
    if (!f) return NULL;
    f->parts = *parts;
    f->work = malloc(bytes(size + 1));
    f->closed = malloc((size_t)p + 1);
    f->n_zero_terms = calloc((size_t)p + 1, 1);
    f->n_rows = (int)p;
    f->n_loads = (int)loads;
    if (!f->work || !f->closed || !f->n_zero_terms) {
        free_flow(f);
        return NULL;
    }
    double *next = f->work;
    f->parts.squares = copy_to_room(&next, parts->squares, m);
    f->parts.damping = copy_to_room(&next, parts->damping, damping);
    f->parts.rows = copy_to_room(&next, parts->rows, p * m);
    f->parts.compliance = copy_to_room(&next, parts->compliance, p * p);
    if (parts->friction) f->parts.friction = copy_to_room(&next, parts->friction, pairs);
    f->stick_places = take_room(&next, p);
    f->forces = take_room(&next, TERMS * p);
    f->contact_gaps = take_room(&next, TERMS * p);
    f->columns = take_room(&next, m * p);
    for (long i = 0; i < p; i++)
        for (long j = 0; j < m; j++) f->columns[j * p + i] = parts->rows[i * m + j];
    f->weights = take_room(&next, TERMS * loads);
    f->series = take_room(&next, TERMS * m);
    f->gaps = take_room(&next, TERMS * p);
    f->answers = take_room(&next, TERMS * p);
    f->step_values = take_room(&next, (MAX_SEARCH_STEPS + 1) * p);
    f->may_fall = take_room(&next, p);
    f->rounding = take_room(&next, p);
    f->state_gaps = take_room(&next, p);
    f->state_forces = take_room(&next, p);
    f->row_work = take_room(&next, p);
    f->damping_force = take_room(&next, m);
    f->load_rate = take_room(&next, loads * (m + p));
    f->modal_drive = take_room(&next, loads * (m + p));
    f->source_series = take_room(&next, TERMS * m);
    f->second_series = take_room(&next, (TERMS + 2) * m);
    f->sets = new_closed_sets((int)m, (int)pairs, f->parts.rows, f->parts.compliance,
                              f->parts.friction, parts->max_set_numbers);
    if (f->sets) return f;
    free_flow(f);
    return NULL;
}

void flow_set_damping(flow *f, const double *damping)
{
    const long m = f->parts.modes;
    memcpy((double *)f->parts.damping, damping, bytes(f->parts.coupled ? m * m : m));
    if (f->exponential) free_exponentials(f->exponential);
    f->exponential = NULL;
}

void free_flow(flow *f)
{
    if (f->sets) free_closed_sets(f->sets);
    if (f->exponential) free_exponentials(f->exponential);
    free(f->closed);
    free(f->n_zero_terms);
    free(f->work);
    free(f);
}
