#include "contact.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "coupled_forces.h"
#include "dense.h"
#include "krylov.h"
#include "lapack.h"
#include "rounding.h"
#include "switching.h"

struct contact_point {
    dense common;
    contact_pairs of;
    compliance *seen;
    coupled_forces *forces;                  /* of coupled pairs; else NULL, and */
    double *waves, *stiffness, *tangent;     /* of each pair 1 / D (p) and T (p, 2H+1, 2H+1) */
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

/* D(p), and what it grows by. */
static void set_compliance(contact_point *at, double parameter)
{
    const contact_pairs *of = &at->of;
    const size_t p = of->seen.pairs;
    const double factor = exp(-of->growth * parameter), left = 1.0 - parameter;
    memcpy(at->compliance, of->residual_compliance, p * p * sizeof(double));
    for (size_t i = 0; i < p; i++) {
        const double spring = factor * of->spring_compliances[i];
        at->compliance[i * (p + 1)] += spring + of->softness * fabs(left) * left * left;
        at->rate[i] = -of->growth * spring - 3.0 * of->softness * left * fabs(left);
        if (!of->has_coupled_pairs) at->stiffness[i] = 1.0 / at->compliance[i * (p + 1)];
    }
    at->parameter = parameter;
}

static int evaluate(equations *own, const double *gap, double parameter)
{
    contact_point *at = (contact_point *)own;
    const int harmonics = at->of.seen.harmonics, pairs = at->of.seen.pairs;
    at->common.factored = 0;
    if (set_parameter(at->seen, parameter)) return SINGULAR_STRUCTURE;
    if (parameter != at->parameter) set_compliance(at, parameter);
    memcpy(at->gap, gap, own->unknowns * sizeof(double));
    if (at->of.has_coupled_pairs) {
        const int outcome = find_forces(at->forces, at->compliance, at->gap, at->force);
        if (outcome != FOUND) return outcome;
    } else if (contact_integrals(harmonics, pairs, gap, at->stiffness, at->waves, at->means,
                                 at->force, at->tangent)) {
        return NO_MEMORY;
    }
    evaluate_response(at->seen, at->force, at->residual);
    for (int i = 0; i < own->unknowns; i++) at->residual[i] += gap[i];
    return FOUND;
}

double largest_dynamic_row_sum(contact_point *at, double parameter)
{
    at->common.factored = 0; /* what has been evaluated holds no longer */
    return largest_row_sum(at->seen, parameter);
}

static void residual_at(const equations *own, double *found)
{
    memcpy(found, ((const contact_point *)own)->residual, own->unknowns * sizeof(double));
}

/* change = T x. */
static void forces_by(contact_point *at, const double *x)
{
    const int pairs = at->of.seen.pairs, rows = 2 * at->of.seen.harmonics + 1;
    if (at->of.has_coupled_pairs) {
        forces_by_gap(at->forces, x, at->change);
        return;
    }
    double *column = at->means, *product = column + rows; /* means have served the tangent */
    for (int pair = 0; pair < pairs; pair++) {
        for (int i = 0; i < rows; i++) column[i] = x[i * pairs + pair];
        multiply(rows, rows, at->tangent + (size_t)pair * rows * rows, column, product);
        for (int i = 0; i < rows; i++) at->change[i * pairs + pair] = product[i];
    }
}

static void apply_jacobian(equations *own, const double *x, double *found)
{
    contact_point *at = (contact_point *)own;
    forces_by(at, x);
    respond_at_parameter(at->seen, at->change, found);
    for (int i = 0; i < own->unknowns; i++) found[i] += x[i];
}

static void by_parameter(equations *own, double *found)
{
    contact_point *at = (contact_point *)own;
    const int pairs = at->of.seen.pairs;
    differentiate_response(at->seen, found);
    if (at->of.growth == 0.0 && at->of.softness == 0.0) return;
    if (at->of.has_coupled_pairs)
        forces_by_compliance(at->forces, at->rate, at->change);
    else
        for (int i = 0; i < own->unknowns; i++)
            at->change[i] = -at->rate[i % pairs] * at->stiffness[i % pairs] * at->force[i];
    respond_at_parameter(at->seen, at->change, at->beside);
    for (int i = 0; i < own->unknowns; i++) found[i] += at->beside[i];
}

/* R'_k as a real matrix on (a, b) of a - i b, [[Re, Im], [-Im, Re]]; for k = 0 Re alone. */
static void set_block(contact_point *at, int k)
{
    const int p = at->of.seen.pairs, q = at->of.n_basis_gaps, size = k ? 2 * q : q;
    const double *basis = at->of.basis, *moving = get_compliance_matrices(at->seen) + 2 * (size_t)k * p * p;
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

/* I + R~ T, or of coupled pairs I + R' U^T T U, harmonic by harmonic; not a number without memory. */
static void form_jacobian(dense *common)
{
    contact_point *at = (contact_point *)common;
    const int harmonics = at->of.seen.harmonics, q = at->of.n_basis_gaps, n = common->size;
    double *rows = common->matrix;
    if (!at->of.has_coupled_pairs) {
        respond_to_columns(harmonics, q, 2 * harmonics + 1, get_compliance_matrices(at->seen), at->tangent,
                           rows);
    } else {
        if (means_of_stiffness(at->forces, at->of.basis, q, at->means)) at->means[0] = NAN;
        for (int k = 0; k <= harmonics; k++) {
            const int size = k ? 2 * q : q;
            set_block(at, k);
            tangent_of_harmonic(harmonics, q, k, at->means, at->strip);
            multiply_matrices(size, size, n, at->block, at->strip, 0.0, rows);
            rows += (size_t)size * n;
        }
    }
    for (int i = 0; i < n; i++) common->matrix[(size_t)i * (n + 1)] += 1.0;
}

/* x = J^-1 x by factors. What of x no gap U y is stays, w = x - U U^T x; the rest is U y with
 * (I + R' U^T T U) y = U^T (x - R~ T w). */
static void solve_by_factors(contact_point *at, double *x)
{
    equations *own = &at->common.own;
    const int p = at->of.seen.pairs, q = at->of.n_basis_gaps, n = own->unknowns;
    const int rows = 2 * at->of.seen.harmonics + 1;
    if (!at->of.basis) {
        solve_dense(own, x);
        return;
    }
    multiply_matrices(rows, p, q, x, at->of.basis, 0.0, at->within);
    multiply_matrices(rows, q, p, at->within, at->transposed, 0.0, at->beside);
    for (int i = 0; i < n; i++) at->beside[i] = x[i] - at->beside[i];
    forces_by(at, at->beside);
    respond_at_parameter(at->seen, at->change, at->moved);
    for (int i = 0; i < n; i++) at->moved[i] = x[i] - at->moved[i];
    multiply_matrices(rows, p, q, at->moved, at->of.basis, 0.0, at->within);
    solve_dense(own, at->within);
    multiply_matrices(rows, q, p, at->within, at->transposed, 0.0, x);
    for (int i = 0; i < n; i++) x[i] += at->beside[i];
}

static void solve(equations *own, double *x)
{
    contact_point *at = (contact_point *)own;
    if (at->inverse) solve_by_products(at->inverse, own, x, own->solve_tolerance);
    else solve_by_factors(at, x);
}

static double sign(equations *own)
{
    return ((contact_point *)own)->of.forms_jacobian ? sign_of_dense(own) : NAN;
}

/* Largest k R of pairs that nothing couples, at p = 0. */
static double largest_product(contact_point *at)
{
    double stiffest = 0.0;
    set_compliance(at, 0.0);
    for (int i = 0; i < at->of.seen.pairs; i++) stiffest = fmax(stiffest, at->stiffness[i]);
    return stiffest * largest_row_sum(at->seen, 0.0);
}

/* What pairs need whose forces are their own, or those of coupled ones: 0, or 1 without memory. */
static int make_forces(contact_point *at)
{
    const contact_pairs *of = &at->of;
    equations *own = &at->common.own;
    own->uses_products = !of->forms_jacobian || own->unknowns > MANY_UNKNOWNS;
    if (of->has_coupled_pairs) {
        at->forces = new_coupled_forces(of->seen.harmonics, of->seen.pairs);
    } else {
        switching_waves(of->seen.harmonics, at->waves);
        own->uses_products = own->uses_products && REGULAR_EIGENVALUE_RATIO * largest_product(at) < 1.0;
    }
    if (own->uses_products) at->inverse = new_krylov(own->unknowns);
    return (of->has_coupled_pairs && !at->forces) || (own->uses_products && !at->inverse);
}

contact_point *new_contact_point(const contact_pairs *given)
{
    contact_point *at = calloc(1, sizeof(contact_point));
    if (!at) return NULL;
    at->of = *given;
    const size_t H = given->seen.harmonics, p = given->seen.pairs, q = given->n_basis_gaps;
    const size_t rows = 2 * H + 1, n = rows * p, size = rows * q, alone = !given->has_coupled_pairs;
    const size_t formed = given->forms_jacobian ? size : 0; /* what only a J that is formed needs */
    const size_t waves = 2 * H * (switching_cells((int)H) / 4 + 1);
    at->common.own = (equations){
        .unknowns = (int)n, .means = (int)p, .evaluate = evaluate, .residual = residual_at,
        .solve = solve, .by_parameter = by_parameter, .sign = sign, .apply = apply_jacobian};
    at->seen = new_compliance(&given->seen);
    const struct {
        double **array;
        size_t size;
    } parts[] = {{&at->compliance, p * p},       {&at->rate, p},          {&at->gap, n},
                 {&at->force, n},                {&at->change, n},        {&at->residual, n},
                 {&at->transposed, q * p},       {&at->within, size},     {&at->beside, n},
                 {&at->means, 2 * (formed + rows) * q}, {&at->strip, 2 * q * formed},
                 {&at->moved, n},                {&at->block, 4 * q * q}, {&at->half, 2 * q * p},
                 {&at->counts, n},               {&at->waves, alone * waves},
                 {&at->stiffness, alone * p},    {&at->tangent, alone * n * rows}};
    const size_t count = sizeof parts / sizeof parts[0];
    size_t all = 0;
    for (size_t i = 0; i < count; i++) all += parts[i].size;
    at->room = malloc(all * sizeof(double));
    double *next = at->room;
    for (size_t i = 0; i < count && next; next += parts[i++].size) *parts[i].array = next;
    if (make_dense(&at->common, (int)formed, form_jacobian) || !at->seen || !at->room ||
        make_forces(at)) {
        free_contact_point(at);
        return NULL;
    }
    for (size_t i = 0; i < p && given->basis; i++)
        for (size_t j = 0; j < q; j++) at->transposed[j * p + i] = given->basis[i * q + j];
    for (size_t i = 0; i < n; i++) {
        const double k = fmax(1.0, (double)((i / p + 1) / 2));
        at->counts[i] = 1.0 / (k * k);
    }
    if (!given->forms_jacobian) at->common.own.angle_weights = at->counts;
    at->parameter = NAN;
    return at;
}

void free_contact_point(contact_point *at)
{
    free_dense(&at->common);
    free_compliance(at->seen);
    free_coupled_forces(at->forces);
    free_krylov(at->inverse);
    free(at->room);
    free(at);
}

equations *equations_of_contact(contact_point *at) { return &at->common.own; }
