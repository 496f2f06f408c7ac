#include "compliance.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"

const double SINGULARITY_TOLERANCE = DBL_EPSILON * 4.0; /* the roundings of s, w and k w */

struct compliance {
    structure_at_pairs parameters;
    int unknowns, is_formed; /* is_formed: `matrices` belong to the parameter */
    double parameter;
    double *matrices, *linear, *receptance;
    double *loads, *shapes_transposed; /* l as coefficients (2H+1, modes), and P^T (pairs, modes) */
    double *modal_drive, *modal_work,
        *modal_response;                  /* (2H+1, modes): P b - l of the last answer, and room */
    double *rate_factors, *scaled_shapes; /* work space: shapes of h, and of complex P */
    double *work;
};

/* Set h_kj at a parameter. Returns 0, or 1 if the structure is singular. */
static int set_receptance(compliance *self, double parameter)
{
    const structure_at_pairs *parameters = &self->parameters;
    const double omega = parameters->omega + parameter * parameters->omega_rate;
    const double damping = parameters->damping + parameter * parameters->damping_rate;
    const double relative_shift =
        sqrt(DBL_EPSILON); /* moves the response by as little as rounding does */
    double *h = self->receptance;
    const double *load = parameters->load;
    for (int k = 0; k <= parameters->harmonics; k++) {
        const double w = k * omega;
        for (int j = 0; j < parameters->modes; j++, h += 2, load += 2) {
            double re = parameters->squares[j] - w * w,
                   im = w * damping * parameters->modal_damping[j];
            const double scale = fabs(parameters->squares[j]) + w * w;
            double square = re * re + im * im;
            if (square <= relative_shift * relative_shift * scale * scale) {
                if (load[0] == 0.0 && load[1] == 0.0 && w != 0.0) {
                    re = relative_shift * scale, im = 0.0;
                    square = re * re;
                } else if (square <=
                           SINGULARITY_TOLERANCE * SINGULARITY_TOLERANCE * scale * scale) {
                    return 1;
                }
            }
            h[0] = re / square;
            h[1] = -im / square;
        }
    }
    return 0;
}

int set_parameter(compliance *self, double parameter)
{
    const structure_at_pairs *parameters = &self->parameters;
    if (parameter == self->parameter) return 0;
    self->parameter = NAN;
    self->is_formed = 0;
    for (int i = 0; i < self->unknowns; i++)
        self->linear[i] = parameters->linear[i] + parameter * parameters->linear_rate[i];
    if (parameters->modes && set_receptance(self, parameter)) return 1;
    self->parameter = parameter;
    return 0;
}

/* Set P^T h_k P of one pair. */
static void pair_compliance(int modes, const double *h, const double *shape, double *gap_out)
{
    gap_out[0] = gap_out[1] = 0.0;
    for (int j = 0; j < modes; j++, h += 2, shape++) {
        gap_out[0] += *shape * h[0] * *shape;
        gap_out[1] += *shape * h[1] * *shape;
    }
}

const double *get_compliance_matrices(compliance *self)
{
    const int pairs = self->parameters.pairs, modes = self->parameters.modes;
    if (!modes) return self->parameters.compliance;
    for (int k = 0; k <= self->parameters.harmonics && !self->is_formed; k++) {
        const double *h = self->receptance + 2 * k * modes, *shape = self->parameters.shapes;
        double *block = self->matrices + 2 * (size_t)k * pairs * pairs,
               *scaled = self->scaled_shapes;
        if (pairs == 1) {
            pair_compliance(modes, h, shape, block);
        } else {
            for (int j = 0; j < modes; j++, h += 2)
                for (int q = 0; q < pairs; q++, shape++, scaled += 2)
                    scaled[0] = h[0] * *shape, scaled[1] = h[1] * *shape;
            multiply_matrices(pairs, modes, 2 * pairs, self->shapes_transposed, self->scaled_shapes,
                              0.0, block);
        }
        for (int i = 0; i < pairs * pairs && self->parameters.static_compliance; i++)
            block[2 * i] += self->parameters.static_compliance[i];
    }
    self->is_formed = 1;
    return self->matrices;
}

/* Set x_k = f_k q_k of coefficients (2H+1, modes), as complex numbers a - i b, with factors f_kj.
 */
static void multiply_modes(int harmonics, int modes, const double *factors, const double *q,
                           double *x)
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

/* Set P^T h q + R_s b with q = P b - loads, (2H+1, modes), which stays in `q`. */
static void respond_by_modes(compliance *self, const double *force, const double *loads, double *q,
                             double *gap_out)
{
    const int rows = 2 * self->parameters.harmonics + 1, pairs = self->parameters.pairs,
              modes = self->parameters.modes;
    const double *at_once = self->parameters.static_compliance;
    multiply_matrices(rows, pairs, modes, force, self->shapes_transposed, 0.0, q);
    for (int i = 0; i < rows * modes && loads; i++) q[i] -= loads[i];
    multiply_modes(self->parameters.harmonics, modes, self->receptance, q, self->modal_response);
    multiply_matrices(rows, modes, pairs, self->modal_response, self->parameters.shapes, 0.0,
                      gap_out);
    if (at_once) multiply_matrices(rows, pairs, pairs, force, at_once, 1.0, gap_out);
}

void respond_at_parameter(compliance *self, const double *force, double *gap)
{
    if (self->parameters.modes) respond_by_modes(self, force, NULL, self->modal_work, gap);
    else
        respond(self->parameters.harmonics, self->parameters.pairs, get_compliance_matrices(self),
                force, gap);
}

void evaluate_response(compliance *self, const double *force, double *gap_out)
{
    if (self->parameters.modes)
        respond_by_modes(self, force, self->loads, self->modal_drive, gap_out);
    else
        respond(self->parameters.harmonics, self->parameters.pairs, get_compliance_matrices(self),
                force, gap_out);
    for (int i = 0; i < self->unknowns; i++) gap_out[i] -= self->linear[i];
}

void differentiate_response(compliance *self, double *gap_out)
{
    const structure_at_pairs *parameters = &self->parameters;
    const int pairs = parameters->pairs, modes = parameters->modes,
              rows = 2 * parameters->harmonics + 1;
    const double omega = parameters->omega + self->parameter * parameters->omega_rate;
    const double damping = parameters->damping + self->parameter * parameters->damping_rate;
    for (int i = 0; i < self->unknowns; i++) gap_out[i] = -parameters->linear_rate[i];
    if (!modes || (parameters->omega_rate == 0.0 && parameters->damping_rate == 0.0)) return;
    /* - P^T h_k (dZ_k/dp) h_k (P b - l), with dZ_kj/dp = -2 k^2 w w' + i k (w' d + w d') c_j. */
    for (int k = 0; k <= parameters->harmonics; k++) {
        const double *h = self->receptance + 2 * k * modes;
        const double inert = -2.0 * k * k * omega * parameters->omega_rate;
        const double viscous =
            k * (parameters->omega_rate * damping + omega * parameters->damping_rate);
        double *rate = self->rate_factors + 2 * k * modes;
        for (int j = 0; j < modes; j++) {
            const double drag = viscous * parameters->modal_damping[j];
            const double re = h[2 * j] * h[2 * j] - h[2 * j + 1] * h[2 * j + 1];
            const double im = 2.0 * h[2 * j] * h[2 * j + 1];
            rate[2 * j] = im * drag - re * inert;
            rate[2 * j + 1] = -re * drag - im * inert;
        }
    }
    multiply_modes(parameters->harmonics, modes, self->rate_factors, self->modal_drive,
                   self->modal_response);
    multiply_matrices(rows, modes, pairs, self->modal_response, parameters->shapes, 1.0, gap_out);
}

double largest_row_sum(compliance *self, double parameter)
{
    if (set_parameter(self, parameter)) return INFINITY;
    const int pairs = self->parameters.pairs, rows = (self->parameters.harmonics + 1) * pairs;
    const double *matrices = get_compliance_matrices(self);
    double largest = 0.0;
    for (int row = 0; row < rows; row++) {
        double sum = 0.0;
        for (int q = 0; q < pairs; q++, matrices += 2) sum += hypot(matrices[0], matrices[1]);
        if (sum > largest) largest = sum;
    }
    return largest;
}

compliance *new_compliance(const structure_at_pairs *parameters)
{
    compliance *self = calloc(1, sizeof(compliance));
    if (!self) return NULL;
    self->parameters = *parameters;
    const size_t H = parameters->harmonics, p = parameters->pairs, m = parameters->modes,
                 rows = 2 * H + 1;
    const size_t square = m ? 2 * (H + 1) * p * p : 0;
    const struct {
        double **array;
        size_t size;
    } arrays[] = {{&self->matrices, square},
                  {&self->linear, rows * p},
                  {&self->receptance, 2 * (H + 1) * m},
                  {&self->rate_factors, 2 * (H + 1) * m},
                  {&self->loads, rows * m},
                  {&self->modal_drive, rows * m},
                  {&self->modal_work, rows * m},
                  {&self->modal_response, rows * m},
                  {&self->shapes_transposed, m * p},
                  {&self->scaled_shapes, 2 * m * p}};
    const size_t count = sizeof arrays / sizeof arrays[0];
    size_t size = 0;
    for (size_t i = 0; i < count; i++) size += arrays[i].size;
    self->work = malloc(size * sizeof(double));
    if (!self->work) {
        free(self);
        return NULL;
    }
    double *next = self->work;
    for (size_t i = 0; i < count; next += arrays[i++].size) *arrays[i].array = next;
    self->unknowns = (int)(rows * p);
    for (size_t j = 0; j < m; j++) {
        for (size_t q = 0; q < p; q++)
            self->shapes_transposed[q * m + j] = parameters->shapes[j * p + q];
        for (size_t k = 0; k <= H; k++) { /* a - i b */
            const double *load = parameters->load + 2 * (k * m + j);
            if (k) self->loads[2 * k * m + j] = -load[1];
            self->loads[(k ? 2 * k - 1 : 0) * m + j] = load[0];
        }
    }
    self->parameter = NAN;
    return self;
}

void free_compliance(compliance *self)
{
    if (self) free(self->work);
    free(self);
}
