#include "condensed.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"
#include "switching.h"

/* Undamped resonances: fenics_crack/model/modal.py, AllModes.receptance. */
#define NUDGE 1e-10
#define SINGULAR 1e-15

struct point {
    equations own;
    condensed of;
    int unknowns, factored, kept, formed;
    double parameter;
    double *waves, *stiffness;
    double *compliance; /* R at the parameter, where modes give it and it is `formed` */
    double *linear, *receptance;
    double *loads, *across;           /* l as coefficients (2H+1, modes), and P^T (pairs, modes) */
    double *drive;                    /* P b - l, (2H+1, modes) */
    double *answer, *other, *rates, *scaled; /* room: (2H+1, modes) twice, as h, as P complex */
    double *means, *force, *tangent, *residual, *change, *jacobian;
    int *pivots;
};

static double *room(size_t count)
{
    return malloc((count ? count : 1) * sizeof(double));
}

void free_point(point *at)
{
    free(at->waves), free(at->stiffness), free(at->compliance), free(at->linear);
    free(at->receptance), free(at->loads), free(at->across), free(at->drive), free(at->answer);
    free(at->other), free(at->rates), free(at->scaled), free(at->means), free(at->force);
    free(at->tangent), free(at->residual), free(at->change), free(at->jacobian), free(at->pivots);
    free(at);
}

/* h_kj at a parameter: 0, or 1 where the structure is singular. */
static int set_receptance(point *at, double parameter)
{
    const condensed *of = &at->of;
    const double omega = of->omega + parameter * of->omega_rate;
    const double damping = of->damping + parameter * of->damping_rate;
    double *h = at->receptance;
    const double *load = of->load;
    for (int k = 0; k <= of->harmonics; k++) {
        const double w = k * omega;
        for (int j = 0; j < of->modes; j++, h += 2, load += 2) {
            double re = of->squares[j] - w * w, im = w * damping * of->rates[j];
            const double scale = fabs(of->squares[j]) + w * w;
            double square = re * re + im * im;
            if (square <= NUDGE * NUDGE * scale * scale) {
                if (load[0] == 0.0 && load[1] == 0.0 && w != 0.0)
                    re = NUDGE * scale, im = 0.0, square = re * re;
                else if (square <= SINGULAR * SINGULAR * scale * scale)
                    return 1;
            }
            h[0] = re / square, h[1] = -im / square;
        }
    }
    return 0;
}

/* h, k, and the part of g_lin without modes, at a parameter. */
static int set_parameter(point *at, double parameter)
{
    const condensed *of = &at->of;
    const double factor = exp(of->growth * parameter);
    if (parameter == at->parameter) return 0;
    at->parameter = NAN, at->formed = 0;
    for (int i = 0; i < at->unknowns; i++)
        at->linear[i] = of->linear[i] + parameter * of->linear_rate[i];
    for (int i = 0; i < of->pairs; i++) at->stiffness[i] = factor * of->stiffness[i];
    if (of->modes && set_receptance(at, parameter)) return 1;
    at->parameter = parameter;
    return 0;
}

/* R at the parameter: R_k = P^T (h_k P). */
static const double *compliance_of(point *at)
{
    const int pairs = at->of.pairs, modes = at->of.modes;
    if (!modes) return at->of.compliance;
    for (int k = 0; k <= at->of.harmonics && !at->formed; k++) {
        const double *h = at->receptance + 2 * k * modes, *shape = at->of.shapes;
        double *block = at->compliance + 2 * (size_t)k * pairs * pairs, *scaled = at->scaled;
        if (pairs == 1) {
            block[0] = block[1] = 0.0;
            for (int j = 0; j < modes; j++, h += 2, shape++)
                block[0] += *shape * h[0] * *shape, block[1] += *shape * h[1] * *shape;
            continue;
        }
        for (int j = 0; j < modes; j++, h += 2)
            for (int q = 0; q < pairs; q++, shape++, scaled += 2)
                scaled[0] = h[0] * *shape, scaled[1] = h[1] * *shape;
        multiply_matrices(pairs, modes, 2 * pairs, at->across, at->scaled, 0.0, block);
    }
    at->formed = 1;
    return at->compliance;
}

/* x = f_k q_k of coefficients (2H+1, modes), a - i b for a - i b, with complex f_kj. */
static void scale(int harmonics, int modes, const double *factors, const double *q, double *x)
{
    for (int j = 0; j < modes; j++) x[j] = factors[2 * j] * q[j];
    for (int k = 1; k <= harmonics; k++) {
        const double *f = factors + 2 * k * modes, *a = q + (2 * k - 1) * modes, *b = a + modes;
        double *c = x + (2 * k - 1) * modes, *d = c + modes;
        for (int j = 0; j < modes; j++) {
            c[j] = f[2 * j] * a[j] + f[2 * j + 1] * b[j];
            d[j] = f[2 * j] * b[j] - f[2 * j + 1] * a[j];
        }
    }
}

void respond(int harmonics, int pairs, const double *compliance, const double *force, double *gap)
{
    for (int k = 0; k <= harmonics; k++) {
        const double *a = force + (k ? 2 * k - 1 : 0) * pairs, *b = a + pairs;
        for (int p = 0; p < pairs; p++) {
            double re = 0.0, im = 0.0; /* of R_k (a - i b) */
            for (int q = 0; q < pairs; q++, compliance += 2) {
                re += compliance[0] * a[q];
                if (k) re += compliance[1] * b[q], im += compliance[1] * a[q] - compliance[0] * b[q];
            }
            gap[(k ? 2 * k - 1 : 0) * pairs + p] = re;
            if (k) gap[2 * k * pairs + p] = -im;
        }
    }
}

void respond_to_columns(int harmonics, int pairs, int columns, const double *compliance,
                        const double *tangent, double *product)
{
    /* A force a - i b on harmonic k moves the gap by R_k (a - i b): by the real matrix
     * [[Re R_k, Im R_k], [-Im R_k, Re R_k]] on (a, b). */
    const size_t rows = 2 * harmonics + 1, across = columns, n = across * pairs;
    for (int k = 0; k <= harmonics; k++)
        for (int p = 0; p < pairs; p++)
            for (int q = 0; q < pairs; q++, compliance += 2) {
                const double re = compliance[0], im = compliance[1];
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

/* found = P^T h q with q = P b - loads, (2H+1, modes), which is left there. */
static void respond_by_modes(point *at, const double *force, const double *loads, double *q,
                             double *found)
{
    const int rows = 2 * at->of.harmonics + 1, pairs = at->of.pairs, modes = at->of.modes;
    multiply_matrices(rows, pairs, modes, force, at->across, 0.0, q);
    for (int i = 0; i < rows * modes && loads; i++) q[i] -= loads[i];
    scale(at->of.harmonics, modes, at->receptance, q, at->answer);
    multiply_matrices(rows, modes, pairs, at->answer, at->of.shapes, 0.0, found);
}

static int evaluate(equations *own, const double *gap, double parameter)
{
    point *at = (point *)own;
    const condensed *of = &at->of;
    at->factored = 0;
    if (set_parameter(at, parameter)) return SINGULAR_STRUCTURE;
    if (contact_integrals(of->harmonics, of->pairs, gap, at->stiffness, at->waves, at->means,
                          at->force, at->tangent))
        return NO_MEMORY;
    if (of->modes) respond_by_modes(at, at->force, at->loads, at->drive, at->residual);
    else respond(of->harmonics, of->pairs, compliance_of(at), at->force, at->residual);
    for (int i = 0; i < at->unknowns; i++) at->residual[i] += gap[i] - at->linear[i];
    return FOUND;
}

double largest_compliance(point *at, double parameter)
{
    const int pairs = at->of.pairs, rows = (at->of.harmonics + 1) * pairs;
    double largest = 0.0;
    at->factored = 0; /* what has been evaluated holds no longer */
    if (set_parameter(at, parameter)) return INFINITY;
    const double *compliance = compliance_of(at);
    for (int row = 0; row < rows; row++) {
        double sum = 0.0;
        for (int q = 0; q < pairs; q++, compliance += 2) sum += hypot(compliance[0], compliance[1]);
        if (sum > largest) largest = sum;
    }
    return largest;
}

static void residual_at(const equations *own, double *found)
{
    const point *at = (const point *)own;
    memcpy(found, at->residual, at->unknowns * sizeof(double));
}

static void factor_jacobian(point *at)
{
    const int n = at->unknowns;
    if (at->factored) return;
    respond_to_columns(at->of.harmonics, at->of.pairs, 2 * at->of.harmonics + 1, compliance_of(at),
                       at->tangent, at->jacobian);
    for (int i = 0; i < n; i++) at->jacobian[(size_t)i * (n + 1)] += 1.0;
    factor(n, at->jacobian, at->pivots);
    at->factored = at->kept = 1;
}

static void solve(equations *own, double *x)
{
    point *at = (point *)own;
    factor_jacobian(at);
    solve_factored(at->unknowns, at->jacobian, at->pivots, x);
}

static int has_factors(const equations *own)
{
    const point *at = (const point *)own;
    return at->kept;
}

static void solve_nearly(const equations *own, double *x)
{
    const point *at = (const point *)own;
    solve_factored(at->unknowns, at->jacobian, at->pivots, x);
}

static void apply_jacobian(equations *own, const double *x, double *found)
{
    point *at = (point *)own;
    const int pairs = at->of.pairs, rows = 2 * at->of.harmonics + 1;
    double *column = at->means, *product = column + rows; /* means have served the tangent */
    for (int pair = 0; pair < pairs; pair++) {
        for (int i = 0; i < rows; i++) column[i] = x[i * pairs + pair];
        multiply(rows, rows, at->tangent + (size_t)pair * rows * rows, column, product);
        for (int i = 0; i < rows; i++) at->change[i * pairs + pair] = product[i];
    }
    if (at->of.modes) respond_by_modes(at, at->change, NULL, at->other, found);
    else respond(at->of.harmonics, pairs, compliance_of(at), at->change, found);
    for (int i = 0; i < at->unknowns; i++) found[i] += x[i];
}

static double determinant_sign(equations *own)
{
    point *at = (point *)own;
    factor_jacobian(at);
    return sign_of_factored(at->unknowns, at->jacobian, at->pivots);
}

static void by_parameter(equations *own, double *found)
{
    point *at = (point *)own;
    const condensed *of = &at->of;
    const int pairs = of->pairs, modes = of->modes, rows = 2 * of->harmonics + 1;
    const double omega = of->omega + at->parameter * of->omega_rate;
    const double damping = of->damping + at->parameter * of->damping_rate;
    for (int i = 0; i < at->unknowns; i++) found[i] = -of->linear_rate[i];
    if (of->growth != 0.0) { /* growth R b */
        respond(of->harmonics, pairs, compliance_of(at), at->force, at->change);
        for (int i = 0; i < at->unknowns; i++) found[i] += of->growth * at->change[i];
    }
    if (!modes || (of->omega_rate == 0.0 && of->damping_rate == 0.0)) return;
    /* - P^T h_k (dZ_k/dp) h_k (P b - l), with dZ_kj/dp = -2 k^2 w w' + i k (w' d + w d') c_j. */
    for (int k = 0; k <= of->harmonics; k++) {
        const double *h = at->receptance + 2 * k * modes;
        const double inert = -2.0 * k * k * omega * of->omega_rate;
        const double viscous = k * (of->omega_rate * damping + omega * of->damping_rate);
        double *rate = at->rates + 2 * k * modes;
        for (int j = 0; j < modes; j++) {
            const double drag = viscous * of->rates[j];
            const double re = h[2 * j] * h[2 * j] - h[2 * j + 1] * h[2 * j + 1];
            const double im = 2.0 * h[2 * j] * h[2 * j + 1];
            rate[2 * j] = im * drag - re * inert, rate[2 * j + 1] = -re * drag - im * inert;
        }
    }
    scale(of->harmonics, modes, at->rates, at->drive, at->answer);
    multiply_matrices(rows, modes, pairs, at->answer, of->shapes, 1.0, found);
}

point *new_point(const condensed *given)
{
    point *at = calloc(1, sizeof(point));
    if (!at) return NULL;
    at->of = *given;
    const size_t H = given->harmonics, p = given->pairs, m = given->modes;
    const size_t rows = 2 * H + 1, n = rows * p, cells = switching_cells(given->harmonics);
    at->unknowns = (int)n;
    at->own = (equations){(int)n,        evaluate,    residual_at,  solve,          by_parameter,
                          determinant_sign, has_factors, solve_nearly, apply_jacobian};
    at->waves = room(2 * H * (cells / 4 + 1)), at->stiffness = room(p);
    at->compliance = room(m ? 2 * (H + 1) * p * p : 0), at->linear = room(n);
    at->receptance = room(2 * (H + 1) * m), at->loads = room(rows * m), at->across = room(m * p);
    at->drive = room(rows * m), at->answer = room(rows * m), at->other = room(rows * m);
    at->rates = room(2 * (H + 1) * m), at->scaled = room(2 * m * p), at->change = room(n);
    at->means = room(2 * p * rows), at->force = room(n), at->tangent = room(p * rows * rows);
    at->residual = room(n), at->jacobian = room(n * n), at->pivots = malloc(n * sizeof(int));
    if (!(at->waves && at->stiffness && at->compliance && at->linear && at->receptance &&
          at->loads && at->across && at->drive && at->answer && at->other && at->rates &&
          at->scaled && at->means && at->force && at->tangent && at->residual && at->change &&
          at->jacobian && at->pivots)) {
        free_point(at);
        return NULL;
    }
    switching_waves(given->harmonics, at->waves);
    for (size_t j = 0; j < m; j++) {
        for (size_t q = 0; q < p; q++) at->across[q * m + j] = given->shapes[j * p + q];
        for (size_t k = 0; k <= H; k++) { /* a - i b */
            const double *load = given->load + 2 * (k * m + j);
            if (k) at->loads[2 * k * m + j] = -load[1];
            at->loads[(k ? 2 * k - 1 : 0) * m + j] = load[0];
        }
    }
    at->parameter = NAN;
    return at;
}

equations *equations_of(point *at)
{
    return &at->own;
}
