#include "krylov.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"

enum { MAX_KEPT_RATIO = 2, MAX_STAGES = MAX_KRYLOV_VECTORS / 2 }; /* of two vectors at least */

struct krylov {
    int n_unknowns, max_vectors, n_stages, n_kept; /* vectors of all stages together */
    int stage_starts[MAX_STAGES + 1];
    double
        *inverses[MAX_STAGES]; /* R^-1 Q^T - Q Q^T (size, size), size from stage_starts */
    double *vectors;                /* (2 max_vectors + 1, n) */
    double *columns, *triangle;     /* H and R, column by column: (max_vectors, max_vectors + 1) */
    double *cosines, *sines, *right_side;   /* of rotations; the right side: (max_vectors + 1) */
    double *projections, *products, *image; /* work space: (max_vectors + 1) twice, (n) */
    double *work;
};

krylov *new_krylov(int n)
{
    krylov *k = calloc(1, sizeof(krylov));
    if (!k) return NULL;
    const size_t size = n, max_vectors = n < MAX_KRYLOV_VECTORS ? n : MAX_KRYLOV_VECTORS;
    k->n_unknowns = n, k->max_vectors = (int)max_vectors;
    k->work = malloc(((2 * max_vectors + 2) * size + (2 * max_vectors + 5) * (max_vectors + 1)) *
                     sizeof(double));
    if (!k->work) {
        free(k);
        return NULL;
    }
    k->vectors = k->work, k->image = k->vectors + (2 * max_vectors + 1) * size;
    k->columns = k->image + size, k->triangle = k->columns + max_vectors * (max_vectors + 1);
    k->cosines = k->triangle + max_vectors * (max_vectors + 1),
    k->sines = k->cosines + max_vectors + 1;
    k->right_side = k->sines + max_vectors + 1, k->projections = k->right_side + max_vectors + 1;
    k->products = k->projections + max_vectors + 1;
    return k;
}

static void clear_stages(krylov *k)
{
    while (k->n_stages) free(k->inverses[--k->n_stages]);
    k->n_kept = 0;
}

void free_krylov(krylov *k)
{
    if (k) clear_stages(k), free(k->work);
    free(k);
}

/* Set x += V^T y with rows V (size, n). */
static void add_combination(int size, int n, const double *vectors, const double *y, double *x)
{
    multiply_matrices(1, size, n, y, vectors, 1.0, x);
}

/* Set x = B x. */
static void apply_kept_inverse(const krylov *k, double *x)
{
    for (int stage = k->n_stages - 1; stage >= 0; stage--) {
        const int start = k->stage_starts[stage], size = k->stage_starts[stage + 1] - start;
        const double *vectors = k->vectors + (size_t)start * k->n_unknowns;
        multiply(size, k->n_unknowns, vectors, x, k->projections);
        multiply(size, size, k->inverses[stage], k->projections, k->products);
        add_combination(size, k->n_unknowns, vectors, k->products, x);
    }
}

/* Remove the components of a vector along orthonormal vectors (count, n), in some passes of Gram
 * and Schmidt. Set the coefficients (count); return the length of the remainder. */
static double orthogonalise(krylov *k, int count, const double *vectors, int n_passes, double *x,
                            double *coefficients)
{
    memset(coefficients, 0, count * sizeof(double));
    while (n_passes--) {
        multiply(count, k->n_unknowns, vectors, x, k->projections);
        for (int i = 0; i < count; i++) {
            coefficients[i] += k->projections[i];
            k->projections[i] = -k->projections[i];
        }
        add_combination(count, k->n_unknowns, vectors, k->projections, x);
    }
    return sqrt(dot(k->n_unknowns, x, x));
}

/* Rotate column j of H into that of a triangle, and the right side as well. */
static void apply_rotation(krylov *k, int j, double *column)
{
    for (int i = 0; i < j; i++) {
        const double a = column[i], b = column[i + 1];
        column[i] = k->cosines[i] * a + k->sines[i] * b;
        column[i + 1] = k->cosines[i] * b - k->sines[i] * a;
    }
    const double length = hypot(column[j], column[j + 1]);
    k->cosines[j] = length > 0.0 ? column[j] / length : 1.0;
    k->sines[j] = length > 0.0 ? column[j + 1] / length : 0.0;
    column[j] = length;
    k->right_side[j + 1] = -k->sines[j] * k->right_side[j];
    k->right_side[j] *= k->cosines[j];
}

/* Keep the inverse on the last `size` + 1 vectors W, for which J V = W H, H = Q R (size + 1, size):
 * J (V R^-1) = W Q. Without space for it, all former inverses are discarded. */
static void keep_stage(krylov *k, int size)
{
    const size_t stride = k->max_vectors + 1, count = size + 1;
    if (k->n_kept + size + 1 > k->max_vectors) {
        clear_stages(k);
        return;
    }
    double *inverse = malloc(count * count * sizeof(double)), *left_out = k->projections;
    if (!inverse) return;
    memset(inverse, 0, count * count * sizeof(double)); /* Q^T */
    for (size_t i = 0; i < count; i++) inverse[i * (count + 1)] = 1.0;
    for (int i = 0; i < size; i++)
        for (size_t j = 0; j < count; j++) {
            double *upper = inverse + i * count + j, *lower = upper + count;
            const double a = *upper, b = *lower;
            *upper = k->cosines[i] * a + k->sines[i] * b;
            *lower = k->cosines[i] * b - k->sines[i] * a;
        }
    memcpy(left_out, inverse + size * count, count * sizeof(double));
    memset(inverse + size * count, 0, count * sizeof(double));
    for (int i = size - 1; i >= 0; i--) { /* R^-1 Q^T */
        double *row_values = inverse + i * count;
        for (int l = i + 1; l < size; l++) {
            const double weight = k->triangle[l * stride + i], *solved_row = inverse + l * count;
            for (size_t j = 0; j < count; j++) row_values[j] -= weight * solved_row[j];
        }
        for (size_t j = 0; j < count; j++) row_values[j] /= k->triangle[i * stride + i];
    }
    for (size_t i = 0; i < count; i++) /* less Q Q^T = I - q q^T */
        for (size_t j = 0; j < count; j++)
            inverse[i * count + j] += left_out[i] * left_out[j] - (i == j);
    k->inverses[k->n_stages++] = inverse;
    k->stage_starts[k->n_stages] = k->n_kept += size + 1;
}

void solve_by_products(krylov *k, equations *system, double *x, double tolerance)
{
    const size_t n = k->n_unknowns, stride = k->max_vectors + 1;
    if (k->n_stages && (k->n_kept > MAX_KEPT_RATIO * k->stage_starts[1])) clear_stages(k);
    /* Vectors lose their right angles by rounding over the square of the residual. */
    const int n_passes = tolerance > 1e-6 ? 1 : 2;
    double *vectors = k->vectors + k->n_kept * n;
    const double size = sqrt(dot(k->n_unknowns, x, x));
    int count = 0;
    if (!(size > 0.0 && isfinite(size))) return;
    for (size_t i = 0; i < n; i++) vectors[i] = x[i] / size;
    k->right_side[0] = size;
    while (count < k->max_vectors && fabs(k->right_side[count]) > tolerance * size) {
        double *column = k->columns + count * stride, *rotated = k->triangle + count * stride;
        double *newest = vectors + count * n, *next = newest + n;
        memcpy(k->image, newest, n * sizeof(double));
        apply_kept_inverse(k, k->image);
        system->apply(system, k->image, next);
        const double remainder = orthogonalise(k, count + 1, vectors, n_passes, next, column);
        memcpy(rotated, column, (count + 1) * sizeof(double));
        rotated[count + 1] = remainder;
        apply_rotation(k, count, rotated);
        for (size_t i = 0; i < n && remainder > 0.0; i++) next[i] /= remainder;
        count++;
        if (!(remainder > 1e-14 * rotated[count - 1])) break; /* all of what J can reach */
    }
    for (int i = count - 1; i >= 0; i--) {
        double sum = k->right_side[i];
        for (int j = i + 1; j < count; j++) sum -= k->triangle[j * stride + i] * k->right_side[j];
        k->right_side[i] = sum / k->triangle[i * stride + i];
    }
    memset(x, 0, n * sizeof(double));
    add_combination(count, k->n_unknowns, vectors, k->right_side, x);
    apply_kept_inverse(k, x);
    if (count) keep_stage(k, count);
}
