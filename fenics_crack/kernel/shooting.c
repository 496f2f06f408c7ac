#include "shooting.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "dense.h"

struct shooting_point {
    dense common;
    shooting_equations of;
    flow_motion moved;
    int rows;  /* of contact, r */
    int loads; /* rows of the load */
    int known; /* whether M is */
    double parameter;
    double *scale, *residual, *state, *rate, *tangent;
    double *force, *gap; /* load_0 */
    double *start, *damping;
};

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

/* The load at a parameter. */
static void change_load(const shooting_point *at, double p)
{
    const shooting_equations *of = &at->of;
    for (int i = 0; i < at->loads * of->modes; i++) of->force[i] = at->force[i] + p * of->force_rate[i];
    for (int i = 0; i < at->loads * at->rows; i++) of->gap[i] = at->gap[i] + p * of->gap_rate[i];
}

static int evaluate(equations *own, const double *x, double p)
{
    shooting_point *at = (shooting_point *)own;
    const int n = own->unknowns;
    flow_motion *m = &at->moved;
    at->known = at->common.factored = 0;
    at->parameter = p;
    for (int i = 0; i < n; i++) {
        const double rest = at->of.rest_states ? at->of.rest_states[i] + p * at->of.rest_states[n + i] : 0.0;
        at->start[i] = at->state[i] = (x[i] + rest) / at->scale[i];
    }
    if (at->of.force) change_load(at, p);
    if (at->of.n_damping) {
        for (int i = 0; i < at->of.n_damping; i++)
            at->damping[i] = at->of.damping[i] + p * at->of.damping_rate[i];
        flow_set_damping(at->of.flow, at->damping);
    }
    m->omega = at->of.base + p * at->of.rate;
    m->time = 0.0;
    m->end = at->of.turns / m->omega;
    m->state = at->state;
    m->n_pieces = m->n_intervals = m->n_events = 0;
    const int outcome = m->omega > 0.0 ? flow_advance(at->of.flow, m) : FLOW_FAILED;
    if (outcome == FLOW_NO_MEMORY) return NO_MEMORY;
    if (outcome != FLOW_DONE) return NOT_FOUND;
    for (int i = 0; i < n; i++) at->residual[i] = at->scale[i] * (at->state[i] - at->start[i]);
    return FOUND;
}

static void residual(const equations *own, double *found)
{
    memcpy(found, ((const shooting_point *)own)->residual, bytes(own->unknowns));
}

static flow_track track_of(const shooting_point *at)
{
    const flow_motion *m = &at->moved;
    return (flow_track){.omega = m->omega, .n_intervals = m->n_intervals, .sets = m->sets,
                        .lengths = m->lengths, .causes = m->causes, .is_first = m->is_first,
                        .ratios = m->ratios};
}

/* M in the unknowns; not a number where it is not known. */
static void know(shooting_point *at)
{
    const int n = at->common.size;
    if (at->known) return;
    const flow_track track = track_of(at);
    const int outcome = flow_tangent(at->of.flow, &track, at->tangent);
    for (long i = 0; i < n; i++)
        for (long j = 0; j < n; j++)
            at->tangent[i * n + j] *= outcome == FLOW_DONE ? at->scale[i] / at->scale[j] : NAN;
    at->known = 1;
}

static void form_jacobian(dense *common)
{
    shooting_point *at = (shooting_point *)common;
    const long n = common->size;
    know(at);
    memcpy(common->matrix, at->tangent, bytes(n * n));
    for (long i = 0; i < n; i++) common->matrix[i * (n + 1)] -= 1.0;
}

/* What omega does to the load, and to when the period ends; 0, or 1 where that is not known. */
static int by_omega(shooting_point *at, const flow_track *track, double *found)
{
    const flow_motion *m = &at->moved;
    if (flow_by_omega(at->of.flow, track, found)) return 1;
    const signed char *closed = m->sets + (long)(m->n_intervals - 1) * at->of.pairs;
    if (flow_rate(at->of.flow, m->omega, m->end, closed, m->state, at->rate)) return 1;
    for (int i = 0; i < at->common.size; i++)
        found[i] = at->of.rate * (found[i] - m->end / m->omega * at->rate[i]);
    return 0;
}

static void by_parameter(equations *own, double *found)
{
    shooting_point *at = (shooting_point *)own;
    const int n = own->unknowns;
    const flow_track track = track_of(at);
    const shooting_equations *of = &at->of;
    memset(found, 0, bytes(n));
    const int failed =
        of->force   ? flow_by_load(of->flow, &track, of->force_rate, of->gap_rate, 0, found)
        : of->n_damping ? flow_by_structure(of->flow, &track, at->start, of->damping_rate, NULL, found)
                    : by_omega(at, &track, found);
    for (int i = 0; i < n; i++) found[i] = failed ? NAN : at->scale[i] * found[i];
    if (!of->rest_states) return;
    const double *moved = of->rest_states + n; /* (M - I) x_1 */
    know(at);
    for (long i = 0; i < n; i++) {
        found[i] -= moved[i];
        for (long j = 0; j < n; j++) found[i] += at->tangent[i * n + j] * moved[j];
    }
}

static void record(equations *own, double *found)
{
    shooting_point *at = (shooting_point *)own;
    know(at);
    memcpy(found, at->tangent, bytes(own->records));
}

shooting_point *new_shooting_point(const shooting_equations *given)
{
    const long pairs = given->pairs, intervals = given->max_intervals;
    const long n = 2L * given->modes + (given->friction ? pairs : 0);
    const long rows = given->friction ? 2 * pairs : pairs, loads = 2L * given->harmonics + 1;
    shooting_point *at = calloc(1, sizeof(shooting_point));
    if (!at) return NULL;
    at->of = *given;
    at->rows = (int)rows;
    at->loads = (int)loads;
    at->common.own = (equations){
        .unknowns = (int)n, .evaluate = evaluate, .residual = residual, .solve = solve_dense,
        .by_parameter = by_parameter, .sign = sign_of_dense,
        .records = (int)(n * n), .record = record};
    const int failed = make_dense(&at->common, (int)n, form_jacobian);
    const long load = given->force ? loads * (given->modes + rows) : 0;
    at->scale = malloc(bytes(5 * n + n * n + load + given->n_damping));
    at->moved.max_pieces = given->max_pieces;
    at->moved.max_intervals = given->max_intervals;
    at->moved.sets = malloc((size_t)(intervals * pairs + 1));
    at->moved.lengths = malloc(bytes(intervals));
    if (given->friction) {
        at->moved.causes = malloc((size_t)intervals * sizeof(int));
        at->moved.is_first = malloc((size_t)intervals);
        at->moved.ratios = malloc(bytes(intervals));
    }
    const int recorded = at->moved.causes && at->moved.is_first && at->moved.ratios;
    if (failed || !(at->scale && at->moved.sets && at->moved.lengths)
        || (given->friction && !recorded)) {
        free_shooting_point(at);
        return NULL;
    }
    memcpy(at->scale, given->scale, bytes(n));
    at->of.scale = at->scale;
    at->residual = at->scale + n;
    at->state = at->residual + n;
    at->rate = at->state + n;
    at->tangent = at->rate + n;
    at->start = at->tangent + n * n;
    at->damping = at->start + n;
    if (load) {
        at->force = at->damping + given->n_damping, at->gap = at->force + loads * given->modes;
        memcpy(at->force, given->force, bytes(loads * given->modes));
        memcpy(at->gap, given->gap, bytes(loads * rows));
    }
    return at;
}

void free_shooting_point(shooting_point *at)
{
    free_dense(&at->common);
    free(at->scale);
    free(at->moved.sets);
    free(at->moved.lengths);
    free(at->moved.causes);
    free(at->moved.is_first);
    free(at->moved.ratios);
    free(at);
}

equations *equations_of_shooting(shooting_point *at) { return &at->common.own; }

int count_events(const shooting_point *at) { return at->moved.n_events; }

int count_pieces(const shooting_point *at) { return at->moved.n_pieces; }

int get_monodromy(shooting_point *at, double *found)
{
    const long n = at->common.size;
    know(at);
    memcpy(found, at->tangent, bytes(n * n));
    return isnan(found[0]);
}
