#include "coupled.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "coupled_forces.h"
#include "dense.h"
#include "krylov.h"
#include "lapack.h"


enum { FEW = 100 }; /* unknowns up to which factors are quicker than products */

struct coupled_point {
    dense common;
    coupled of;
    compliance *seen;
    coupled_forces *forces;
    krylov *inverse;                         /* where solutions take products; else NULL */
    double parameter;
    double *compliance, *rate;               /* D (p, p), and the rate of its diagonal by p */
    double *gap, *force, *change, *residual; /* (2H+1, p) */
    double *transposed, *counts;             /* U^T (q, p); (n) */
    double *within, *beside, *moved;         /* room: (2H+1, q), and (2H+1, p) twice */
    double *means, *strip, *block, *half;    /* room: (4H+1, q, q), (2 q, size), (2 q, 2 q), and
                                                (q, p) complex */
    double *room;
};

/* D(p), and what it grows by. */
static void set_compliance(coupled_point *at, double parameter)
{
    const coupled *of = &at->of;
    const size_t p = of->seen.pairs;
    const double factor = exp(-of->growth * parameter), left = 1.0 - parameter;
    memcpy(at->compliance, of->residual, p * p * sizeof(double));
    for (size_t i = 0; i < p; i++) {
        const double spring = factor * of->springs[i];
        at->compliance[i * (p + 1)] += spring + of->softness * fabs(left) * left * left;
        at->rate[i] = -of->growth * spring - 3.0 * of->softness * left * fabs(left);
    }
    at->parameter = parameter;
}

static int evaluate(equations *own, const double *gap, double parameter)
{
    coupled_point *at = (coupled_point *)own;
    at->common.factored = 0;
    if (set_parameter(at->seen, parameter)) return SINGULAR_STRUCTURE;
    if (parameter != at->parameter) set_compliance(at, parameter);
    memcpy(at->gap, gap, own->unknowns * sizeof(double));
    const int outcome = find_forces(at->forces, at->compliance, at->gap, at->force);
    if (outcome != FOUND) return outcome;
    answer_to(at->seen, at->force, at->residual);
    for (int i = 0; i < own->unknowns; i++) at->residual[i] += gap[i];
    return FOUND;
}

double largest_moving(coupled_point *at, double parameter)
{
    at->common.factored = 0; /* what has been evaluated holds no longer */
    return largest_row(at->seen, parameter);
}

static void residual_at(const equations *own, double *found)
{
    memcpy(found, ((const coupled_point *)own)->residual, own->unknowns * sizeof(double));
}

static void apply_jacobian(equations *own, const double *x, double *found)
{
    coupled_point *at = (coupled_point *)own;
    forces_by_gap(at->forces, x, at->change);
    respond_at(at->seen, at->change, found);
    for (int i = 0; i < own->unknowns; i++) found[i] += x[i];
}

static void by_parameter(equations *own, double *found)
{
    coupled_point *at = (coupled_point *)own;
    rate_of_answer(at->seen, found);
    if (at->of.growth == 0.0 && at->of.softness == 0.0) return;
    forces_by_compliance(at->forces, at->rate, at->change);
    respond_at(at->seen, at->change, at->beside);
    for (int i = 0; i < own->unknowns; i++) found[i] += at->beside[i];
}

/* R'_k as a real matrix on (a, b) of a - i b, [[Re, Im], [-Im, Re]]; for k = 0 Re alone. */
static void set_block(coupled_point *at, int k)
{
    const int p = at->of.seen.pairs, q = at->of.seen_gaps, size = k ? 2 * q : q;
    const double *basis = at->of.basis, *moving = matrices_of(at->seen) + 2 * (size_t)k * p * p;
    if (basis) multiply_matrices(q, p, 2 * p, at->transposed, moving, 0.0, at->half);
    for (int a = 0; a < q; a++)
        for (int b = 0; b < q; b++) {
            double re = 0.0, im = 0.0;
            const double *row = (basis ? at->half : moving) + (size_t)2 * a * p;
            if (!basis) re = row[2 * b], im = row[2 * b + 1];
            for (int j = 0; j < p && basis; j++) {
                re += row[2 * j] * basis[j * q + b];
                im += row[2 * j + 1] * basis[j * q + b];
            }
            at->block[a * size + b] = re;
            if (!k) continue;
            at->block[(q + a) * size + q + b] = re;
            at->block[a * size + q + b] = im, at->block[(q + a) * size + b] = -im;
        }
}

/* I + R' U^T T U, harmonic by harmonic; not a number without memory. */
static void form_jacobian(dense *common)
{
    coupled_point *at = (coupled_point *)common;
    const int harmonics = at->of.seen.harmonics, q = at->of.seen_gaps, n = common->size;
    double *rows = common->matrix;
    if (means_of_stiffness(at->forces, at->of.basis, q, at->means)) at->means[0] = NAN;
    for (int k = 0; k <= harmonics; k++) {
        const int size = k ? 2 * q : q;
        set_block(at, k);
        tangent_of_harmonic(harmonics, q, k, at->means, at->strip);
        multiply_matrices(size, size, n, at->block, at->strip, 0.0, rows);
        rows += (size_t)size * n;
    }
    for (int i = 0; i < n; i++) common->matrix[(size_t)i * (n + 1)] += 1.0;
}

/* x = J^-1 x by factors. What of x no gap U y is stays, w = x - U U^T x; the rest is U y with
 * (I + R' U^T T U) y = U^T (x - R~ T w). */
static void solve_by_factors(coupled_point *at, double *x)
{
    equations *own = &at->common.own;
    const int p = at->of.seen.pairs, q = at->of.seen_gaps, n = own->unknowns;
    const int rows = 2 * at->of.seen.harmonics + 1;
    if (!at->of.basis) {
        solve_dense(own, x);
        return;
    }
    multiply_matrices(rows, p, q, x, at->of.basis, 0.0, at->within);
    multiply_matrices(rows, q, p, at->within, at->transposed, 0.0, at->beside);
    for (int i = 0; i < n; i++) at->beside[i] = x[i] - at->beside[i];
    forces_by_gap(at->forces, at->beside, at->change);
    respond_at(at->seen, at->change, at->moved);
    for (int i = 0; i < n; i++) at->moved[i] = x[i] - at->moved[i];
    multiply_matrices(rows, p, q, at->moved, at->of.basis, 0.0, at->within);
    solve_dense(own, at->within);
    multiply_matrices(rows, q, p, at->within, at->transposed, 0.0, x);
    for (int i = 0; i < n; i++) x[i] += at->beside[i];
}

static void solve(equations *own, double *x)
{
    coupled_point *at = (coupled_point *)own;
    if (at->inverse) solve_by_products(at->inverse, own, x, own->sharp);
    else solve_by_factors(at, x);
}

static double sign(equations *own)
{
    return ((coupled_point *)own)->of.formed ? sign_of_dense(own) : NAN;
}

coupled_point *new_coupled_point(const coupled *given)
{
    coupled_point *at = calloc(1, sizeof(coupled_point));
    if (!at) return NULL;
    at->of = *given;
    const size_t H = given->seen.harmonics, p = given->seen.pairs, q = given->seen_gaps;
    const size_t rows = 2 * H + 1, n = rows * p, size = rows * q;
    const size_t formed = given->formed ? size : 0; /* what only a J that is formed needs */
    at->common.own = (equations){
        .unknowns = (int)n, .evaluate = evaluate, .residual = residual_at, .solve = solve,
        .by_parameter = by_parameter, .sign = sign, .apply = apply_jacobian};
    const int products = !given->formed || n > FEW;
    if (products) at->inverse = new_krylov((int)n);
    at->common.own.products = products;
    at->seen = new_compliance(&given->seen);
    at->forces = new_coupled_forces((int)H, (int)p);
    const struct {
        double **array;
        size_t size;
    } parts[] = {{&at->compliance, p * p},       {&at->rate, p},          {&at->gap, n},
                 {&at->force, n},                {&at->change, n},        {&at->residual, n},
                 {&at->transposed, q * p},       {&at->within, size},     {&at->beside, n},
                 {&at->means, 2 * formed * q}, {&at->strip, 2 * q * formed}, {&at->moved, n},
                 {&at->block, 4 * q * q},        {&at->half, 2 * q * p},  {&at->counts, n}};
    const size_t count = sizeof parts / sizeof parts[0];
    size_t all = 0;
    for (size_t i = 0; i < count; i++) all += parts[i].size;
    at->room = malloc(all * sizeof(double));
    if (make_dense(&at->common, (int)formed, form_jacobian) || !at->seen || !at->forces ||
        !at->room || (products && !at->inverse)) {
        free_coupled_point(at);
        return NULL;
    }
    double *next = at->room;
    for (size_t i = 0; i < count; next += parts[i++].size) *parts[i].array = next;
    for (size_t i = 0; i < p && given->basis; i++)
        for (size_t j = 0; j < q; j++) at->transposed[j * p + i] = given->basis[i * q + j];
    for (size_t i = 0; i < n; i++) {
        const double k = fmax(1.0, (double)((i / p + 1) / 2));
        at->counts[i] = 1.0 / (k * k);
    }
    if (!given->formed) at->common.own.counts = at->counts;
    at->parameter = NAN;
    return at;
}

void free_coupled_point(coupled_point *at)
{
    free_dense(&at->common);
    free_compliance(at->seen);
    free_coupled_forces(at->forces);
    free_krylov(at->inverse);
    free(at->room);
    free(at);
}

equations *equations_of_coupled(coupled_point *at) { return &at->common.own; }
