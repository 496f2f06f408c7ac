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
    int unknowns, factored;
    double parameter;
    double *waves, *stiffness;
    double *compliance; /* R at the parameter, where modes give it */
    double *linear, *receptance;
    double *means, *force, *tangent, *residual, *jacobian;
    int *pivots;
};

static double *room(size_t count)
{
    return malloc((count ? count : 1) * sizeof(double));
}

void free_point(point *at)
{
    free(at->waves), free(at->stiffness), free(at->compliance), free(at->linear);
    free(at->receptance), free(at->means), free(at->force), free(at->tangent);
    free(at->residual), free(at->jacobian), free(at->pivots);
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

/* R, g_lin and k at a parameter. */
static int set_parameter(point *at, double parameter)
{
    const condensed *of = &at->of;
    const int pairs = of->pairs, modes = of->modes;
    const double factor = exp(of->growth * parameter);
    if (parameter == at->parameter) return 0;
    at->parameter = NAN;
    for (int i = 0; i < at->unknowns; i++)
        at->linear[i] = of->linear[i] + parameter * of->linear_rate[i];
    for (int i = 0; i < pairs; i++) at->stiffness[i] = factor * of->stiffness[i];
    if (modes && set_receptance(at, parameter)) return 1;
    for (int k = 0; k <= of->harmonics && modes; k++) {
        double *block = at->compliance + 2 * (size_t)k * pairs * pairs;
        const double *h = at->receptance + 2 * k * modes, *load = of->load + 2 * k * modes;
        for (int i = 0; i < 2 * pairs * pairs; i++) block[i] = 0.0;
        for (int j = 0; j < modes; j++) {
            const double *shape = of->shapes + j * pairs;
            const double re = h[2 * j] * load[2 * j] - h[2 * j + 1] * load[2 * j + 1];
            const double im = h[2 * j] * load[2 * j + 1] + h[2 * j + 1] * load[2 * j];
            for (int p = 0; p < pairs; p++) {
                /* g_lin = Re (x_k e^{ik theta}): a = Re x_k, b = -Im x_k. */
                if (k) at->linear[(2 * k - 1) * pairs + p] += shape[p] * re;
                at->linear[2 * k * pairs + p] -= k ? shape[p] * im : -shape[p] * re;
                for (int q = 0; q < pairs; q++) {
                    block[2 * (p * pairs + q)] += shape[p] * h[2 * j] * shape[q];
                    block[2 * (p * pairs + q) + 1] += shape[p] * h[2 * j + 1] * shape[q];
                }
            }
        }
    }
    at->parameter = parameter;
    return 0;
}

static const double *compliance_of(const point *at)
{
    return at->of.modes ? at->compliance : at->of.compliance;
}

/* R lambda of coefficients (2H+1, pairs). */
static void respond(int harmonics, int pairs, const double *compliance, const double *force, double *gap)
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

static int evaluate(equations *own, const double *gap, double parameter)
{
    point *at = (point *)own;
    const condensed *of = &at->of;
    at->factored = 0;
    if (set_parameter(at, parameter)) return SINGULAR_STRUCTURE;
    if (contact_integrals(of->harmonics, of->pairs, gap, at->stiffness, at->waves, at->means,
                          at->force, at->tangent))
        return NO_MEMORY;
    respond(of->harmonics, of->pairs, compliance_of(at), at->force, at->residual);
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
    at->factored = 1;
}

static void solve(equations *own, double *x)
{
    point *at = (point *)own;
    factor_jacobian(at);
    solve_factored(at->unknowns, at->jacobian, at->pivots, x);
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
    const int pairs = of->pairs, modes = of->modes;
    const double omega = of->omega + at->parameter * of->omega_rate;
    const double damping = of->damping + at->parameter * of->damping_rate;
    /* - linear_rate + growth R b, */
    respond(of->harmonics, pairs, compliance_of(at), at->force, found);
    for (int i = 0; i < at->unknowns; i++)
        found[i] = of->growth * found[i] - of->linear_rate[i];
    if (!modes || (of->omega_rate == 0.0 && of->damping_rate == 0.0)) return;
    for (int k = 1; k <= of->harmonics; k++) {
        /* and - P^T h_k (dZ_k/dp) q, q = h_k (P b - l), with
         * dZ_kj/dp = -2 k^2 w w' + i k (w' d + w d') c_j. */
        const double *a = at->force + (2 * k - 1) * pairs, *b = a + pairs;
        const double *h = at->receptance + 2 * k * modes, *load = of->load + 2 * k * modes;
        const double inert = -2.0 * k * k * omega * of->omega_rate;
        const double viscous = k * (of->omega_rate * damping + omega * of->damping_rate);
        for (int j = 0; j < modes; j++) {
            const double *shape = of->shapes + j * pairs;
            const double hre = h[2 * j], him = h[2 * j + 1], drag = viscous * of->rates[j];
            double re = -load[2 * j], im = -load[2 * j + 1];
            for (int p = 0; p < pairs; p++) re += shape[p] * a[p], im -= shape[p] * b[p];
            /* h^2 dZ, then times P b - l. */
            const double hhre = hre * hre - him * him, hhim = 2.0 * hre * him;
            const double gre = hhre * inert - hhim * drag, gim = hhim * inert + hhre * drag;
            const double qre = gre * re - gim * im, qim = gre * im + gim * re;
            for (int p = 0; p < pairs; p++) {
                found[(2 * k - 1) * pairs + p] -= shape[p] * qre;
                found[2 * k * pairs + p] += shape[p] * qim;
            }
        }
    }
}

point *new_point(const condensed *given)
{
    point *at = calloc(1, sizeof(point));
    if (!at) return NULL;
    at->of = *given;
    const size_t H = given->harmonics, p = given->pairs, m = given->modes;
    const size_t rows = 2 * H + 1, n = rows * p, cells = switching_cells(given->harmonics);
    at->unknowns = (int)n;
    at->own = (equations){(int)n, evaluate, residual_at, solve, by_parameter, determinant_sign};
    at->waves = room(2 * H * (cells / 4 + 1)), at->stiffness = room(p);
    at->compliance = room(2 * (H + 1) * p * p), at->linear = room(n);
    at->receptance = room(2 * (H + 1) * m);
    at->means = room(2 * p * rows), at->force = room(n), at->tangent = room(p * rows * rows);
    at->residual = room(n), at->jacobian = room(n * n), at->pivots = malloc(n * sizeof(int));
    if (!(at->waves && at->stiffness && at->compliance && at->linear && at->receptance &&
          at->means && at->force && at->tangent && at->residual && at->jacobian &&
          at->pivots)) {
        free_point(at);
        return NULL;
    }
    switching_waves(given->harmonics, at->waves);
    at->parameter = NAN;
    return at;
}

equations *equations_of(point *at)
{
    return &at->own;
}
