#include "orbits.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"

/* Of p, for dF/dp. Intervals between events that there is room for at first. */
#define DIFFERENCE 1e-6
enum { ROOM = 64 };

struct orbit_point {
    equations own;
    orbit_equations of;
    motion moved;
    int known, factored; /* whether M is known, and M - I is factored */
    double parameter;
    double *unknown, *residual, *state, *monodromy, *jacobian, *work;
    int *pivots;
};

/* The motion of a period from x: z(T) in at->state. */
static int move(orbit_point *at, const double *x, double p)
{
    const int n = at->own.unknowns;
    motion *m = &at->moved;
    exact_flow *f = at->of.flow;
    set_frequency(f, p * at->of.omega);
    for (int i = 0; i < n; i++) at->state[i] = at->of.size * x[i];
    m->now = 0.0, m->end = at->of.turns / f->omega, m->state = at->state;
    m->closed = closed_at(f, at->state), m->switched = -1, m->events = 0, m->passed = 0;
    while (1) {
        const int code = follow_exactly(f, m, at->of.longest);
        if (code == DONE) return FOUND;
        if (code == UNKNOWN) return NEW_SET;
        if (code == FAST || m->events > at->of.most) return NOT_FOUND;
        const size_t more = 4 * (size_t)m->most;
        int *sets = realloc(m->passed_sets, more * sizeof(int));
        if (sets) m->passed_sets = sets;
        double *lengths = realloc(m->lengths, more * sizeof(double));
        if (lengths) m->lengths = lengths;
        if (!sets || !lengths) return NO_MEMORY;
        m->most = (int)more;
    }
}

static int evaluate(equations *own, const double *x, double p)
{
    orbit_point *at = (orbit_point *)own;
    const int n = own->unknowns, outcome = move(at, x, p);
    at->known = at->factored = 0;
    if (outcome != FOUND) return outcome;
    at->parameter = p;
    memcpy(at->unknown, x, n * sizeof(double));
    for (int i = 0; i < n; i++) at->residual[i] = at->state[i] / at->of.size - x[i];
    return FOUND;
}

static void residual(const equations *own, double *found)
{
    memcpy(found, ((const orbit_point *)own)->residual, own->unknowns * sizeof(double));
}

/* M, before another motion takes the room of this one. */
static void know(orbit_point *at)
{
    const int n = at->own.unknowns;
    const motion *m = &at->moved;
    if (at->known) return;
    memset(at->monodromy, 0, (size_t)n * n * sizeof(double));
    for (int i = 0; i < n; i++) at->monodromy[(size_t)i * (n + 1)] = 1.0;
    derivative_of(at->of.flow, m->passed, m->passed_sets, m->lengths, at->monodromy, at->work);
    at->known = 1;
}

static void factor_jacobian(orbit_point *at)
{
    const int n = at->own.unknowns;
    if (at->factored) return;
    know(at);
    memcpy(at->jacobian, at->monodromy, (size_t)n * n * sizeof(double));
    for (int i = 0; i < n; i++) at->jacobian[(size_t)i * (n + 1)] -= 1.0;
    factor(n, at->jacobian, at->pivots);
    at->factored = 1;
}

static void solve(equations *own, double *x)
{
    orbit_point *at = (orbit_point *)own;
    factor_jacobian(at);
    solve_factored(own->unknowns, at->jacobian, at->pivots, x);
}

static double sign(equations *own)
{
    orbit_point *at = (orbit_point *)own;
    factor_jacobian(at);
    return sign_of_factored(own->unknowns, at->jacobian, at->pivots);
}

static void by_parameter(equations *own, double *found)
{
    orbit_point *at = (orbit_point *)own;
    const int n = own->unknowns;
    const double scale = 1.0 / (2.0 * DIFFERENCE * at->of.size);
    know(at);
    for (int i = 0; i < n; i++) found[i] = 0.0;
    for (int side = 1; side >= -1; side -= 2) {
        const int outcome = move(at, at->unknown, at->parameter + side * DIFFERENCE);
        for (int i = 0; i < n; i++)
            found[i] += outcome == FOUND ? side * scale * at->state[i] : NAN;
    }
}

orbit_point *new_orbit_point(const orbit_equations *given)
{
    orbit_point *at = calloc(1, sizeof(orbit_point));
    if (!at) return NULL;
    const size_t n = given->flow->size;
    at->of = *given;
    at->own = (equations){(int)n, evaluate, residual, solve, by_parameter, sign, NULL, NULL, NULL};
    at->unknown = malloc((3 * n + 2 * n * n + n * (n + 2)) * sizeof(double));
    at->pivots = malloc(n * sizeof(int));
    at->moved.most = ROOM;
    at->moved.passed_sets = malloc(ROOM * sizeof(int));
    at->moved.lengths = malloc(ROOM * sizeof(double));
    if (!(at->unknown && at->pivots && at->moved.passed_sets && at->moved.lengths)) {
        free_orbit_point(at);
        return NULL;
    }
    at->residual = at->unknown + n, at->state = at->residual + n;
    at->monodromy = at->state + n, at->jacobian = at->monodromy + n * n;
    at->work = at->jacobian + n * n;
    return at;
}

void free_orbit_point(orbit_point *at)
{
    free(at->unknown), free(at->pivots), free(at->moved.passed_sets), free(at->moved.lengths);
    free(at);
}

equations *equations_of_orbit(orbit_point *at)
{
    return &at->own;
}

int new_set_of(const orbit_point *at)
{
    return at->moved.closed;
}

int events_of(const orbit_point *at)
{
    return at->moved.events;
}

void monodromy_of(orbit_point *at, double *found)
{
    know(at);
    memcpy(found, at->monodromy, (size_t)at->own.unknowns * at->own.unknowns * sizeof(double));
}
