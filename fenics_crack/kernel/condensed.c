#include "condensed.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "dense.h"
#include "lapack.h"
#include "switching.h"

struct point {
    dense common;
    condensed of;
    compliance *seen;
    double *waves, *stiffness, *means, *force, *tangent, *residual, *change;
    double *room;
};

void respond_to_columns(int harmonics, int pairs, int columns, const double *matrices,
                        const double *tangent, double *product)
{
    /* A force a - i b on harmonic k moves the gap by R_k (a - i b): by the real matrix
     * [[Re R_k, Im R_k], [-Im R_k, Re R_k]] on (a, b). */
    const size_t rows = 2 * harmonics + 1, across = columns, n = across * pairs;
    for (int k = 0; k <= harmonics; k++)
        for (int p = 0; p < pairs; p++)
            for (int q = 0; q < pairs; q++, matrices += 2) {
                const double re = matrices[0], im = matrices[1];
                const size_t row = k ? 2 * k - 1 : 0;
                const double *a = tangent + (q * rows + row) * across, *b = a + across;
                double *first = product + (row * pairs + p) * n + q, *second = first + pairs * n;
                if (!k)
                    for (size_t j = 0; j < across; j++) first[j * pairs] = re * a[j];
                else
                    for (size_t j = 0; j < across; j++) {
                        first[j * pairs] = re * a[j] + im * b[j];
                        second[j * pairs] = re * b[j] - im * a[j];
                    }
            }
}

static int evaluate(equations *own, const double *gap, double parameter)
{
    point *at = (point *)own;
    const int harmonics = at->of.seen.harmonics, pairs = at->of.seen.pairs;
    const double factor = exp(at->of.growth * parameter);
    at->common.factored = 0;
    if (set_parameter(at->seen, parameter)) return SINGULAR_STRUCTURE;
    for (int i = 0; i < pairs; i++) at->stiffness[i] = factor * at->of.stiffness[i];
    if (contact_integrals(harmonics, pairs, gap, at->stiffness, at->waves, at->means, at->force,
                          at->tangent))
        return NO_MEMORY;
    answer_to(at->seen, at->force, at->residual);
    for (int i = 0; i < own->unknowns; i++) at->residual[i] += gap[i];
    return FOUND;
}

double largest_compliance(point *at, double parameter)
{
    at->common.factored = 0; /* what has been evaluated holds no longer */
    return largest_row(at->seen, parameter);
}

static void residual_at(const equations *own, double *found)
{
    memcpy(found, ((const point *)own)->residual, own->unknowns * sizeof(double));
}

static void form_jacobian(dense *common)
{
    point *at = (point *)common;
    const int n = common->size, harmonics = at->of.seen.harmonics;
    respond_to_columns(harmonics, at->of.seen.pairs, 2 * harmonics + 1, matrices_of(at->seen),
                       at->tangent, common->matrix);
    for (int i = 0; i < n; i++) common->matrix[(size_t)i * (n + 1)] += 1.0;
}

static void apply_jacobian(equations *own, const double *x, double *found)
{
    point *at = (point *)own;
    const int pairs = at->of.seen.pairs, rows = 2 * at->of.seen.harmonics + 1;
    double *column = at->means, *product = column + rows; /* means have served the tangent */
    for (int pair = 0; pair < pairs; pair++) {
        for (int i = 0; i < rows; i++) column[i] = x[i * pairs + pair];
        multiply(rows, rows, at->tangent + (size_t)pair * rows * rows, column, product);
        for (int i = 0; i < rows; i++) at->change[i * pairs + pair] = product[i];
    }
    respond_at(at->seen, at->change, found);
    for (int i = 0; i < own->unknowns; i++) found[i] += x[i];
}

static void by_parameter(equations *own, double *found)
{
    point *at = (point *)own;
    rate_of_answer(at->seen, found);
    if (at->of.growth == 0.0) return;
    respond_at(at->seen, at->force, at->change); /* growth R b */
    for (int i = 0; i < own->unknowns; i++) found[i] += at->of.growth * at->change[i];
}

point *new_point(const condensed *given)
{
    point *at = calloc(1, sizeof(point));
    if (!at) return NULL;
    at->of = *given;
    const size_t H = given->seen.harmonics, p = given->seen.pairs, rows = 2 * H + 1, n = rows * p;
    const size_t waves = 2 * H * (switching_cells((int)H) / 4 + 1);
    at->common.own = (equations){
        .unknowns = (int)n, .evaluate = evaluate, .residual = residual_at, .solve = solve_dense,
        .by_parameter = by_parameter, .sign = sign_of_dense,
        .has_factors = has_dense_factors, .solve_nearly = solve_nearly_dense,
        .apply = apply_jacobian};
    at->seen = new_compliance(&given->seen);
    at->room = malloc((waves + p + 2 * p * rows + 3 * n + n * rows) * sizeof(double));
    if (make_dense(&at->common, (int)n, form_jacobian) || !at->seen || !at->room) {
        free_point(at);
        return NULL;
    }
    at->waves = at->room, at->stiffness = at->waves + waves, at->means = at->stiffness + p;
    at->force = at->means + 2 * p * rows, at->residual = at->force + n;
    at->change = at->residual + n, at->tangent = at->change + n;
    switching_waves((int)H, at->waves);
    return at;
}

void free_point(point *at)
{
    free_dense(&at->common);
    free_compliance(at->seen);
    free(at->room);
    free(at);
}

equations *equations_of(point *at) { return &at->common.own; }
