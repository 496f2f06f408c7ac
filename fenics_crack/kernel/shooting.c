#include "shooting.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "dense.h"

struct shooting_point {
    dense common;
    shooting_equations parameters;
    flow_motion motion;
    int n_rows;        /* of contact, r */
    int n_loads;       /* rows of the load */
    int has_monodromy; /* whether M has been computed */
    double parameter;
    double *scale, *residual, *state, *state_rate, *monodromy;
    double *initial_force, *initial_gap; /* load_0 */
    double *start_state, *current_damping;
};

static size_t bytes(long count) { return (size_t)count * sizeof(double); }

/* Set the load at a parameter. */
static void set_load(const shooting_point *point, double p)
{
    const shooting_equations *parameters = &point->parameters;
    for (int i = 0; i < point->n_loads * parameters->modes; i++)
        parameters->force[i] = point->initial_force[i] + p * parameters->force_rate[i];
    for (int i = 0; i < point->n_loads * point->n_rows; i++)
        parameters->gap[i] = point->initial_gap[i] + p * parameters->gap_rate[i];
}

static int evaluate_period(equations *system, const double *x, double p)
{
    shooting_point *point = (shooting_point *)system;
    const int n = system->unknowns;
    flow_motion *m = &point->motion;
    point->has_monodromy = point->common.factored = 0;
    point->parameter = p;
    for (int i = 0; i < n; i++) {
        const double rest =
            point->parameters.rest_states
                ? point->parameters.rest_states[i] + p * point->parameters.rest_states[n + i]
                : 0.0;
        point->start_state[i] = point->state[i] = (x[i] + rest) / point->scale[i];
    }
    if (point->parameters.force) set_load(point, p);
    if (point->parameters.n_damping) {
        for (int i = 0; i < point->parameters.n_damping; i++)
            point->current_damping[i] =
                point->parameters.damping[i] + p * point->parameters.damping_rate[i];
        flow_set_damping(point->parameters.flow, point->current_damping);
    }
    m->omega = point->parameters.base + p * point->parameters.rate;
    m->time = 0.0;
    m->end = point->parameters.turns / m->omega;
    m->state = point->state;
    m->n_pieces = m->n_intervals = m->n_events = 0;
    const int outcome = m->omega > 0.0 ? flow_advance(point->parameters.flow, m) : FLOW_FAILED;
    if (outcome == FLOW_NO_MEMORY) return NO_MEMORY;
    if (outcome != FLOW_DONE) return NOT_FOUND;
    for (int i = 0; i < n; i++)
        point->residual[i] = point->scale[i] * (point->state[i] - point->start_state[i]);
    return FOUND;
}

static void copy_residual(const equations *system, double *residual_out)
{
    memcpy(residual_out, ((const shooting_point *)system)->residual, bytes(system->unknowns));
}

static flow_track track_of(const shooting_point *point)
{
    const flow_motion *m = &point->motion;
    return (flow_track){.omega = m->omega,
                        .n_intervals = m->n_intervals,
                        .sets = m->sets,
                        .lengths = m->lengths,
                        .causes = m->causes,
                        .is_first = m->is_first,
                        .ratios = m->ratios};
}

/* Compute M in the unknowns; NAN if it is not known. */
static void compute_monodromy(shooting_point *point)
{
    const int n = point->common.size;
    if (point->has_monodromy) return;
    const flow_track track = track_of(point);
    const int outcome = flow_tangent(point->parameters.flow, &track, point->monodromy);
    for (long i = 0; i < n; i++)
        for (long j = 0; j < n; j++)
            point->monodromy[i * n + j] *=
                outcome == FLOW_DONE ? point->scale[i] / point->scale[j] : NAN;
    point->has_monodromy = 1;
}

static void form_jacobian(dense *common)
{
    shooting_point *point = (shooting_point *)common;
    const long n = common->size;
    compute_monodromy(point);
    memcpy(common->matrix, point->monodromy, bytes(n * n));
    for (long i = 0; i < n; i++) common->matrix[i * (n + 1)] -= 1.0;
}

/* Set the derivative of the end state by omega, which changes the load and the period's end.
 * Returns 0, or 1 if it is not known. */
static int differentiate_by_omega(shooting_point *point, const flow_track *track,
                                  double *derivative_out)
{
    const flow_motion *m = &point->motion;
    if (flow_by_omega(point->parameters.flow, track, derivative_out)) return 1;
    const signed char *closed = m->sets + (long)(m->n_intervals - 1) * point->parameters.pairs;
    if (flow_rate(point->parameters.flow, m->omega, m->end, closed, m->state, point->state_rate))
        return 1;
    for (int i = 0; i < point->common.size; i++)
        derivative_out[i] =
            point->parameters.rate * (derivative_out[i] - m->end / m->omega * point->state_rate[i]);
    return 0;
}

static void differentiate_by_parameter(equations *system, double *derivative_out)
{
    shooting_point *point = (shooting_point *)system;
    const int n = system->unknowns;
    const flow_track track = track_of(point);
    const shooting_equations *parameters = &point->parameters;
    memset(derivative_out, 0, bytes(n));
    const int failed =
        parameters->force       ? flow_by_load(parameters->flow, &track, parameters->force_rate,
                                               parameters->gap_rate, 0, derivative_out)
        : parameters->n_damping ? flow_by_structure(parameters->flow, &track, point->start_state,
                                                    parameters->damping_rate, NULL, derivative_out)
                                : differentiate_by_omega(point, &track, derivative_out);
    for (int i = 0; i < n; i++)
        derivative_out[i] = failed ? NAN : point->scale[i] * derivative_out[i];
    if (!parameters->rest_states) return;
    const double *rest_rate = parameters->rest_states + n; /* (M - I) x_1 */
    compute_monodromy(point);
    for (long i = 0; i < n; i++) {
        derivative_out[i] -= rest_rate[i];
        for (long j = 0; j < n; j++)
            derivative_out[i] += point->monodromy[i * n + j] * rest_rate[j];
    }
}

static void copy_monodromy(equations *system, double *record_out)
{
    shooting_point *point = (shooting_point *)system;
    compute_monodromy(point);
    memcpy(record_out, point->monodromy, bytes(system->n_record_entries));
}

shooting_point *new_shooting_point(const shooting_equations *parameters)
{
    const long pairs = parameters->pairs, intervals = parameters->max_intervals;
    const long n = 2L * parameters->modes + (parameters->friction ? pairs : 0);
    const long n_rows = parameters->friction ? 2 * pairs : pairs,
               n_loads = 2L * parameters->harmonics + 1;
    shooting_point *point = calloc(1, sizeof(shooting_point));
    if (!point) return NULL;
    point->parameters = *parameters;
    point->n_rows = (int)n_rows;
    point->n_loads = (int)n_loads;
    point->common.base = (equations){.unknowns = (int)n,
                                     .evaluate = evaluate_period,
                                     .residual = copy_residual,
                                     .solve = solve_dense,
                                     .by_parameter = differentiate_by_parameter,
                                     .sign = sign_of_dense,
                                     .n_record_entries = (int)(n * n),
                                     .record = copy_monodromy};
    const int failed = make_dense(&point->common, (int)n, form_jacobian);
    const long load_size = parameters->force ? n_loads * (parameters->modes + n_rows) : 0;
    point->scale = malloc(bytes(5 * n + n * n + load_size + parameters->n_damping));
    point->motion.max_pieces = parameters->max_pieces;
    point->motion.max_intervals = parameters->max_intervals;
    point->motion.sets = malloc((size_t)(intervals * pairs + 1));
    point->motion.lengths = malloc(bytes(intervals));
    if (parameters->friction) {
        point->motion.causes = malloc((size_t)intervals * sizeof(int));
        point->motion.is_first = malloc((size_t)intervals);
        point->motion.ratios = malloc(bytes(intervals));
    }
    const int has_causes = point->motion.causes && point->motion.is_first && point->motion.ratios;
    if (failed || !(point->scale && point->motion.sets && point->motion.lengths) ||
        (parameters->friction && !has_causes)) {
        free_shooting_point(point);
        return NULL;
    }
    memcpy(point->scale, parameters->scale, bytes(n));
    point->parameters.scale = point->scale;
    point->residual = point->scale + n;
    point->state = point->residual + n;
    point->state_rate = point->state + n;
    point->monodromy = point->state_rate + n;
    point->start_state = point->monodromy + n * n;
    point->current_damping = point->start_state + n;
    if (load_size) {
        point->initial_force = point->current_damping + parameters->n_damping,
        point->initial_gap = point->initial_force + n_loads * parameters->modes;
        memcpy(point->initial_force, parameters->force, bytes(n_loads * parameters->modes));
        memcpy(point->initial_gap, parameters->gap, bytes(n_loads * n_rows));
    }
    return point;
}

void free_shooting_point(shooting_point *point)
{
    free_dense(&point->common);
    free(point->scale);
    free(point->motion.sets);
    free(point->motion.lengths);
    free(point->motion.causes);
    free(point->motion.is_first);
    free(point->motion.ratios);
    free(point);
}

equations *equations_of_shooting(shooting_point *point) { return &point->common.base; }

int count_events(const shooting_point *point) { return point->motion.n_events; }

int count_pieces(const shooting_point *point) { return point->motion.n_pieces; }

int get_monodromy(shooting_point *point, double *monodromy_out)
{
    const long n = point->common.size;
    compute_monodromy(point);
    memcpy(monodromy_out, point->monodromy, bytes(n * n));
    return isnan(monodromy_out[0]);
}
