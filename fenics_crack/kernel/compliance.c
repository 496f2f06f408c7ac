#include "compliance.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"

const double SINGULARITY_TOLERANCE = DBL_EPSILON * 4.0; /* the roundings of s, w and k w */

struct compliance {
    structure_at_pairs of;
    int unknowns, formed; /* formed: whether `matrices` are those at the parameter */
    double parameter;
    double *matrices, *linear, *receptance;
    double *loads, *across;         /* l as coefficients (2H+1, modes), and P^T (pairs, modes) */
    double *drive, *other, *answer; /* (2H+1, modes): P b - l of the last answer, and room */
    double *rates, *scaled;         /* room: as h, as P complex */
    double *room;
};

/* h_kj at a parameter: 0, or 1 where the structure is singular. */
static int set_receptance(compliance *at, double parameter)
{
    const structure_at_pairs *of = &at->of;
    const double omega = of->omega + parameter * of->omega_rate;
    const double damping = of->damping + parameter * of->damping_rate;
    const double nudge = sqrt(DBL_EPSILON); /* as much as rounding of what it then answers */
    double *h = at->receptance;
    const double *load = of->load;
    for (int k = 0; k <= of->harmonics; k++) {
        const double w = k * omega;
        for (int j = 0; j < of->modes; j++, h += 2, load += 2) {
            double re = of->squares[j] - w * w, im = w * damping * of->modal_damping[j];
            const double scale = fabs(of->squares[j]) + w * w;
            double square = re * re + im * im;
            if (square <= nudge * nudge * scale * scale) {
                if (load[0] == 0.0 && load[1] == 0.0 && w != 0.0) {
                    re = nudge * scale, im = 0.0;
                    square = re * re;
                } else if (square <= SINGULARITY_TOLERANCE * SINGULARITY_TOLERANCE * scale * scale) {
                    return 1;
                }
            }
            h[0] = re / square;
            h[1] = -im / square;
        }
    }
    return 0;
}

int set_parameter(compliance *at, double parameter)
{
    const structure_at_pairs *of = &at->of;
    if (parameter == at->parameter) return 0;
    at->parameter = NAN;
    at->formed = 0;
    for (int i = 0; i < at->unknowns; i++)
        at->linear[i] = of->linear[i] + parameter * of->linear_rate[i];
    if (of->modes && set_receptance(at, parameter)) return 1;
    at->parameter = parameter;
    return 0;
}

/* P^T h_k P of one pair. */
static void seen_by_one(int modes, const double *h, const double *shape, double *found)
{
    found[0] = found[1] = 0.0;
    for (int j = 0; j < modes; j++, h += 2, shape++) {
        found[0] += *shape * h[0] * *shape;
        found[1] += *shape * h[1] * *shape;
    }
}

const double *get_compliance_matrices(compliance *at)
{
    const int pairs = at->of.pairs, modes = at->of.modes;
    if (!modes) return at->of.compliance;
    for (int k = 0; k <= at->of.harmonics && !at->formed; k++) {
        const double *h = at->receptance + 2 * k * modes, *shape = at->of.shapes;
        double *block = at->matrices + 2 * (size_t)k * pairs * pairs, *scaled = at->scaled;
        if (pairs == 1) {
            seen_by_one(modes, h, shape, block);
        } else {
            for (int j = 0; j < modes; j++, h += 2)
                for (int q = 0; q < pairs; q++, shape++, scaled += 2)
                    scaled[0] = h[0] * *shape, scaled[1] = h[1] * *shape;
            multiply_matrices(pairs, modes, 2 * pairs, at->across, at->scaled, 0.0, block);
        }
        for (int i = 0; i < pairs * pairs && at->of.static_compliance; i++) block[2 * i] += at->of.static_compliance[i];
    }
    at->formed = 1;
    return at->matrices;
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

void respond(int harmonics, int pairs, const double *matrices, const double *force, double *gap)
{
    for (int k = 0; k <= harmonics; k++) {
        const double *a = force + (k ? 2 * k - 1 : 0) * pairs, *b = a + pairs;
        for (int p = 0; p < pairs; p++) {
            double re = 0.0, im = 0.0; /* of R_k (a - i b) */
            for (int q = 0; q < pairs; q++, matrices += 2) {
                re += matrices[0] * a[q];
                if (k) {
                    re += matrices[1] * b[q];
                    im += matrices[1] * a[q] - matrices[0] * b[q];
                }
            }
            gap[(k ? 2 * k - 1 : 0) * pairs + p] = re;
            if (k) gap[2 * k * pairs + p] = -im;
        }
    }
}

/* found = P^T h q + at_once b with q = P b - loads, (2H+1, modes), which is left there. */
static void respond_by_modes(compliance *at, const double *force, const double *loads, double *q,
                             double *found)
{
    const int rows = 2 * at->of.harmonics + 1, pairs = at->of.pairs, modes = at->of.modes;
    const double *at_once = at->of.static_compliance;
    multiply_matrices(rows, pairs, modes, force, at->across, 0.0, q);
    for (int i = 0; i < rows * modes && loads; i++) q[i] -= loads[i];
    scale(at->of.harmonics, modes, at->receptance, q, at->answer);
    multiply_matrices(rows, modes, pairs, at->answer, at->of.shapes, 0.0, found);
    if (at_once) multiply_matrices(rows, pairs, pairs, force, at_once, 1.0, found);
}

void respond_at_parameter(compliance *at, const double *force, double *gap)
{
    if (at->of.modes) respond_by_modes(at, force, NULL, at->other, gap);
    else respond(at->of.harmonics, at->of.pairs, get_compliance_matrices(at), force, gap);
}

void evaluate_response(compliance *at, const double *force, double *found)
{
    if (at->of.modes) respond_by_modes(at, force, at->loads, at->drive, found);
    else respond(at->of.harmonics, at->of.pairs, get_compliance_matrices(at), force, found);
    for (int i = 0; i < at->unknowns; i++) found[i] -= at->linear[i];
}

void differentiate_response(compliance *at, double *found)
{
    const structure_at_pairs *of = &at->of;
    const int pairs = of->pairs, modes = of->modes, rows = 2 * of->harmonics + 1;
    const double omega = of->omega + at->parameter * of->omega_rate;
    const double damping = of->damping + at->parameter * of->damping_rate;
    for (int i = 0; i < at->unknowns; i++) found[i] = -of->linear_rate[i];
    if (!modes || (of->omega_rate == 0.0 && of->damping_rate == 0.0)) return;
    /* - P^T h_k (dZ_k/dp) h_k (P b - l), with dZ_kj/dp = -2 k^2 w w' + i k (w' d + w d') c_j. */
    for (int k = 0; k <= of->harmonics; k++) {
        const double *h = at->receptance + 2 * k * modes;
        const double inert = -2.0 * k * k * omega * of->omega_rate;
        const double viscous = k * (of->omega_rate * damping + omega * of->damping_rate);
        double *rate = at->rates + 2 * k * modes;
        for (int j = 0; j < modes; j++) {
            const double drag = viscous * of->modal_damping[j];
            const double re = h[2 * j] * h[2 * j] - h[2 * j + 1] * h[2 * j + 1];
            const double im = 2.0 * h[2 * j] * h[2 * j + 1];
            rate[2 * j] = im * drag - re * inert;
            rate[2 * j + 1] = -re * drag - im * inert;
        }
    }
    scale(of->harmonics, modes, at->rates, at->drive, at->answer);
    multiply_matrices(rows, modes, pairs, at->answer, of->shapes, 1.0, found);
}

double largest_row_sum(compliance *at, double parameter)
{
    if (set_parameter(at, parameter)) return INFINITY;
    const int pairs = at->of.pairs, rows = (at->of.harmonics + 1) * pairs;
    const double *matrices = get_compliance_matrices(at);
    double largest = 0.0;
    for (int row = 0; row < rows; row++) {
        double sum = 0.0;
        for (int q = 0; q < pairs; q++, matrices += 2) sum += hypot(matrices[0], matrices[1]);
        if (sum > largest) largest = sum;
    }
    return largest;
}

compliance *new_compliance(const structure_at_pairs *given)
{
    compliance *at = calloc(1, sizeof(compliance));
    if (!at) return NULL;
    at->of = *given;
    const size_t H = given->harmonics, p = given->pairs, m = given->modes, rows = 2 * H + 1;
    const size_t square = m ? 2 * (H + 1) * p * p : 0;
    const struct {
        double **array;
        size_t size;
    } parts[] = {{&at->matrices, square},     {&at->linear, rows * p},
                 {&at->receptance, 2 * (H + 1) * m}, {&at->rates, 2 * (H + 1) * m},
                 {&at->loads, rows * m},      {&at->drive, rows * m},  {&at->other, rows * m},
                 {&at->answer, rows * m},     {&at->across, m * p},    {&at->scaled, 2 * m * p}};
    const size_t count = sizeof parts / sizeof parts[0];
    size_t size = 0;
    for (size_t i = 0; i < count; i++) size += parts[i].size;
    at->room = malloc(size * sizeof(double));
    if (!at->room) {
        free(at);
        return NULL;
    }
    double *next = at->room;
    for (size_t i = 0; i < count; next += parts[i++].size) *parts[i].array = next;
    at->unknowns = (int)(rows * p);
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

void free_compliance(compliance *at)
{
    if (at) free(at->room);
    free(at);
}
