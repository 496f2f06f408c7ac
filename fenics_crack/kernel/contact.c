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
    contact_pairs parameters;
    compliance *dynamic_compliance;
    coupled_forces *forces;                  /* of coupled pairs; NULL if uncoupled, then */
    double *waves, *stiffness, *tangent;     /* of each pair 1 / D (p) and T (p, 2H+1, 2H+1) */
    krylov *krylov_solver;                   /* if solutions take products with J; else NULL */
    double parameter;
    double *pair_compliance, *compliance_rate;     /* D (p, p), derivative of its diagonal */
    double *gap, *force, *force_change, *residual; /* (2H+1, p) */
    double *basis_transposed, *angle_weights;      /* U^T (q, p); (n) */
    double *basis_gaps, *gap_work, *gap_work2;     /* work space: (2H+1, q), and (2H+1, p) twice */
    double *means, *tangent_rows, *harmonic_block,
        *half_product; /* work space: (4H+1, q, q), (2 q, size), (2 q, 2 q), (q, p) complex */
    double *work;
};

void respond_to_columns(int harmonics, int pairs, int columns, const double *matrices,
                        const double *tangent, double *product)
{
    /* A force a - i b on harmonic k moves the gap by R_k (a - i b): by the real matrix
     * [[Re R_k, Im R_k], [-Im R_k, Re R_k]] on (a, b). */
    const size_t rows = 2 * harmonics + 1, n_columns = columns, n = n_columns * pairs;
    for (int k = 0; k <= harmonics; k++)
        for (int p = 0; p < pairs; p++)
            for (int q = 0; q < pairs; q++, matrices += 2) {
                const double re = matrices[0], im = matrices[1];
                const size_t row = k ? 2 * k - 1 : 0;
                const double *a = tangent + (q * rows + row) * n_columns, *b = a + n_columns;
                double *first = product + (row * pairs + p) * n + q, *second = first + pairs * n;
                if (!k)
                    for (size_t j = 0; j < n_columns; j++) first[j * pairs] = re * a[j];
                else
                    for (size_t j = 0; j < n_columns; j++) {
                        first[j * pairs] = re * a[j] + im * b[j];
                        second[j * pairs] = re * b[j] - im * a[j];
                    }
            }
}

/* Set D(p) and the derivative of its diagonal. */
static void set_compliance(contact_point *point, double parameter)
{
    const contact_pairs *parameters = &point->parameters;
    const size_t p = parameters->structure.pairs;
    const double factor = exp(-parameters->growth * parameter), distance_to_end = 1.0 - parameter;
    memcpy(point->pair_compliance, parameters->residual_compliance, p * p * sizeof(double));
    for (size_t i = 0; i < p; i++) {
        const double spring = factor * parameters->spring_compliances[i];
        point->pair_compliance[i * (p + 1)] += spring + parameters->softness *
                                                            fabs(distance_to_end) *
                                                            distance_to_end * distance_to_end;
        point->compliance_rate[i] = -parameters->growth * spring - 3.0 * parameters->softness *
                                                                       distance_to_end *
                                                                       fabs(distance_to_end);
        if (!parameters->has_coupled_pairs)
            point->stiffness[i] = 1.0 / point->pair_compliance[i * (p + 1)];
    }
    point->parameter = parameter;
}

static int evaluate(equations *system, const double *gap, double parameter)
{
    contact_point *point = (contact_point *)system;
    const int harmonics = point->parameters.structure.harmonics,
              pairs = point->parameters.structure.pairs;
    point->common.factored = 0;
    if (set_parameter(point->dynamic_compliance, parameter)) return SINGULAR_STRUCTURE;
    if (parameter != point->parameter) set_compliance(point, parameter);
    memcpy(point->gap, gap, system->unknowns * sizeof(double));
    if (point->parameters.has_coupled_pairs) {
        const int outcome =
            find_forces(point->forces, point->pair_compliance, point->gap, point->force);
        if (outcome != FOUND) return outcome;
    } else if (contact_integrals(harmonics, pairs, gap, point->stiffness, point->waves,
                                 point->means, point->force, point->tangent)) {
        return NO_MEMORY;
    }
    evaluate_response(point->dynamic_compliance, point->force, point->residual);
    for (int i = 0; i < system->unknowns; i++) point->residual[i] += gap[i];
    return FOUND;
}

double largest_dynamic_row_sum(contact_point *point, double parameter)
{
    point->common.factored = 0; /* the last evaluation is not valid any more */
    return largest_row_sum(point->dynamic_compliance, parameter);
}

static void copy_residual(const equations *system, double *residual_out)
{
    memcpy(residual_out, ((const contact_point *)system)->residual,
           system->unknowns * sizeof(double));
}

/* Set force_change = T x. */
static void differentiate_forces(contact_point *point, const double *x)
{
    const int pairs = point->parameters.structure.pairs,
              rows = 2 * point->parameters.structure.harmonics + 1;
    if (point->parameters.has_coupled_pairs) {
        forces_by_gap(point->forces, x, point->force_change);
        return;
    }
    double *column = point->means, *product = column + rows; /* means have served the tangent */
    for (int pair = 0; pair < pairs; pair++) {
        for (int i = 0; i < rows; i++) column[i] = x[i * pairs + pair];
        multiply(rows, rows, point->tangent + (size_t)pair * rows * rows, column, product);
        for (int i = 0; i < rows; i++) point->force_change[i * pairs + pair] = product[i];
    }
}

static void apply_jacobian(equations *system, const double *x, double *product_out)
{
    contact_point *point = (contact_point *)system;
    differentiate_forces(point, x);
    respond_at_parameter(point->dynamic_compliance, point->force_change, product_out);
    for (int i = 0; i < system->unknowns; i++) product_out[i] += x[i];
}

static void by_parameter(equations *system, double *derivative_out)
{
    contact_point *point = (contact_point *)system;
    const int pairs = point->parameters.structure.pairs;
    differentiate_response(point->dynamic_compliance, derivative_out);
    if (point->parameters.growth == 0.0 && point->parameters.softness == 0.0) return;
    if (point->parameters.has_coupled_pairs)
        forces_by_compliance(point->forces, point->compliance_rate, point->force_change);
    else
        for (int i = 0; i < system->unknowns; i++)
            point->force_change[i] =
                -point->compliance_rate[i % pairs] * point->stiffness[i % pairs] * point->force[i];
    respond_at_parameter(point->dynamic_compliance, point->force_change, point->gap_work);
    for (int i = 0; i < system->unknowns; i++) derivative_out[i] += point->gap_work[i];
}

/* Set R'_k as a real matrix on (a, b) of a - i b, [[Re, Im], [-Im, Re]]; for k = 0 Re alone. */
static void set_harmonic_block(contact_point *point, int k)
{
    const int p = point->parameters.structure.pairs, q = point->parameters.n_basis_gaps,
              size = k ? 2 * q : q;
    const double *basis = point->parameters.basis,
                 *matrix =
                     get_compliance_matrices(point->dynamic_compliance) + 2 * (size_t)k * p * p;
    if (basis)
        multiply_matrices(q, p, 2 * p, point->basis_transposed, matrix, 0.0, point->half_product);
    for (int a = 0; a < q; a++)
        for (int b = 0; b < q; b++) {
            double re = 0.0, im = 0.0;
            const double *row = (basis ? point->half_product : matrix) + (size_t)2 * a * p;
            if (!basis) re = row[2 * b], im = row[2 * b + 1];
            for (int j = 0; j < p && basis; j++) {
                re += row[2 * j] * basis[j * q + b];
                im += row[2 * j + 1] * basis[j * q + b];
            }
            point->harmonic_block[a * size + b] = re;
            if (!k) continue;
            point->harmonic_block[(q + a) * size + q + b] = re;
            point->harmonic_block[a * size + q + b] = im,
                                                 point->harmonic_block[(q + a) * size + b] = -im;
        }
}

/* Form I + R~ T, or of coupled pairs I + R' U^T T U, harmonic by harmonic; NAN without memory. */
static void form_jacobian(dense *common)
{
    contact_point *point = (contact_point *)common;
    const int harmonics = point->parameters.structure.harmonics, q = point->parameters.n_basis_gaps,
              n = common->size;
    double *rows = common->matrix;
    if (!point->parameters.has_coupled_pairs) {
        respond_to_columns(harmonics, q, 2 * harmonics + 1,
                           get_compliance_matrices(point->dynamic_compliance), point->tangent,
                           rows);
    } else {
        if (means_of_stiffness(point->forces, point->parameters.basis, q, point->means))
            point->means[0] = NAN;
        for (int k = 0; k <= harmonics; k++) {
            const int size = k ? 2 * q : q;
            set_harmonic_block(point, k);
            tangent_of_harmonic(harmonics, q, k, point->means, point->tangent_rows);
            multiply_matrices(size, size, n, point->harmonic_block, point->tangent_rows, 0.0, rows);
            rows += (size_t)size * n;
        }
    }
    for (int i = 0; i < n; i++) common->matrix[(size_t)i * (n + 1)] += 1.0;
}

/* Set x = J^-1 x by factors. The part w = x - U U^T x that is no gap U y stays. The rest is U y
 * with (I + R' U^T T U) y = U^T (x - R~ T w). */
static void solve_by_factors(contact_point *point, double *x)
{
    equations *system = &point->common.base;
    const int p = point->parameters.structure.pairs, q = point->parameters.n_basis_gaps,
              n = system->unknowns;
    const int rows = 2 * point->parameters.structure.harmonics + 1;
    if (!point->parameters.basis) {
        solve_dense(system, x);
        return;
    }
    multiply_matrices(rows, p, q, x, point->parameters.basis, 0.0, point->basis_gaps);
    multiply_matrices(rows, q, p, point->basis_gaps, point->basis_transposed, 0.0, point->gap_work);
    for (int i = 0; i < n; i++) point->gap_work[i] = x[i] - point->gap_work[i];
    differentiate_forces(point, point->gap_work);
    respond_at_parameter(point->dynamic_compliance, point->force_change, point->gap_work2);
    for (int i = 0; i < n; i++) point->gap_work2[i] = x[i] - point->gap_work2[i];
    multiply_matrices(rows, p, q, point->gap_work2, point->parameters.basis, 0.0,
                      point->basis_gaps);
    solve_dense(system, point->basis_gaps);
    multiply_matrices(rows, q, p, point->basis_gaps, point->basis_transposed, 0.0, x);
    for (int i = 0; i < n; i++) x[i] += point->gap_work[i];
}

static void solve(equations *system, double *x)
{
    contact_point *point = (contact_point *)system;
    if (point->krylov_solver)
        solve_by_products(point->krylov_solver, system, x, system->solve_tolerance);
    else solve_by_factors(point, x);
}

static double sign(equations *system)
{
    return ((contact_point *)system)->parameters.forms_jacobian ? sign_of_dense(system) : NAN;
}

/* Return the largest k R of uncoupled pairs, at p = 0. */
static double largest_product(contact_point *point)
{
    double max_stiffness = 0.0;
    set_compliance(point, 0.0);
    for (int i = 0; i < point->parameters.structure.pairs; i++)
        max_stiffness = fmax(max_stiffness, point->stiffness[i]);
    return max_stiffness * largest_row_sum(point->dynamic_compliance, 0.0);
}

/* Allocate the forces of uncoupled or coupled pairs. Returns 0, or 1 without memory. */
static int make_forces(contact_point *point)
{
    const contact_pairs *parameters = &point->parameters;
    equations *system = &point->common.base;
    system->uses_products = !parameters->forms_jacobian || system->unknowns > MANY_UNKNOWNS;
    if (parameters->has_coupled_pairs) {
        point->forces =
            new_coupled_forces(parameters->structure.harmonics, parameters->structure.pairs);
    } else {
        switching_waves(parameters->structure.harmonics, point->waves);
        system->uses_products =
            system->uses_products && REGULAR_EIGENVALUE_RATIO * largest_product(point) < 1.0;
    }
    if (system->uses_products) point->krylov_solver = new_krylov(system->unknowns);
    return (parameters->has_coupled_pairs && !point->forces) ||
           (system->uses_products && !point->krylov_solver);
}

contact_point *new_contact_point(const contact_pairs *parameters)
{
    contact_point *point = calloc(1, sizeof(contact_point));
    if (!point) return NULL;
    point->parameters = *parameters;
    const size_t H = parameters->structure.harmonics, p = parameters->structure.pairs,
                 q = parameters->n_basis_gaps;
    const size_t rows = 2 * H + 1, n = rows * p, size = rows * q,
                 is_uncoupled = !parameters->has_coupled_pairs;
    const size_t matrix_size =
        parameters->forms_jacobian ? size : 0; /* for a Jacobian that is formed */
    const size_t waves = 2 * H * (switching_cells((int)H) / 4 + 1);
    point->common.base = (equations){.unknowns = (int)n,
                                     .means = (int)p,
                                     .evaluate = evaluate,
                                     .residual = copy_residual,
                                     .solve = solve,
                                     .by_parameter = by_parameter,
                                     .sign = sign,
                                     .apply = apply_jacobian};
    point->dynamic_compliance = new_compliance(&parameters->structure);
    const struct {
        double **array;
        size_t size;
    } arrays[] = {{&point->pair_compliance, p * p},
                  {&point->compliance_rate, p},
                  {&point->gap, n},
                  {&point->force, n},
                  {&point->force_change, n},
                  {&point->residual, n},
                  {&point->basis_transposed, q * p},
                  {&point->basis_gaps, size},
                  {&point->gap_work, n},
                  {&point->means, 2 * (matrix_size + rows) * q},
                  {&point->tangent_rows, 2 * q * matrix_size},
                  {&point->gap_work2, n},
                  {&point->harmonic_block, 4 * q * q},
                  {&point->half_product, 2 * q * p},
                  {&point->angle_weights, n},
                  {&point->waves, is_uncoupled * waves},
                  {&point->stiffness, is_uncoupled * p},
                  {&point->tangent, is_uncoupled * n * rows}};
    const size_t count = sizeof arrays / sizeof arrays[0];
    size_t total_size = 0;
    for (size_t i = 0; i < count; i++) total_size += arrays[i].size;
    point->work = malloc(total_size * sizeof(double));
    double *next = point->work;
    for (size_t i = 0; i < count && next; next += arrays[i++].size) *arrays[i].array = next;
    if (make_dense(&point->common, (int)matrix_size, form_jacobian) || !point->dynamic_compliance ||
        !point->work || make_forces(point)) {
        free_contact_point(point);
        return NULL;
    }
    for (size_t i = 0; i < p && parameters->basis; i++)
        for (size_t j = 0; j < q; j++)
            point->basis_transposed[j * p + i] = parameters->basis[i * q + j];
    for (size_t i = 0; i < n; i++) {
        const double k = fmax(1.0, (double)((i / p + 1) / 2));
        point->angle_weights[i] = 1.0 / (k * k);
    }
    if (!parameters->forms_jacobian) point->common.base.angle_weights = point->angle_weights;
    point->parameter = NAN;
    return point;
}

void free_contact_point(contact_point *point)
{
    free_dense(&point->common);
    free_compliance(point->dynamic_compliance);
    free_coupled_forces(point->forces);
    free_krylov(point->krylov_solver);
    free(point->work);
    free(point);
}

equations *equations_of_contact(contact_point *point) { return &point->common.base; }
