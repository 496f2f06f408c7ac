#include "multipliers.h"

#include <complex.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "lapack.h"

/* Eigenvalues of a matrix, and the next matrix in its eigenvectors. */
typedef struct {
    int n, *pivots;
    double *real, *imaginary; /* parts of the multipliers, (n) */
    double *vectors;          /* their eigenvectors V, or real and imaginary parts of pairs, in rows */
    double *matrix, *products;
    double complex *next_matrix; /* (n, n) */
} decomposition;

/* Set the eigenvalues and eigenvectors of a matrix. Returns 0, or 1 without them. */
static int decompose(decomposition *work, const double *matrix)
{
    const int n = work->n;
    for (int i = 0; i < n; i++) /* as LAPACK sees it */
        for (int j = 0; j < n; j++) work->matrix[j * n + i] = matrix[i * n + j];
    return eigenvectors(n, work->matrix, work->real, work->imaginary, work->vectors);
}

/* Set B = V^-1 M V. */
static void transform(decomposition *work, const double *matrix)
{
    const int n = work->n;
    double complex *next_matrix = work->next_matrix;
    multiply_transposed(n, n, n, work->vectors, matrix, work->products);
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) work->matrix[i * n + j] = work->vectors[j * n + i];
        work->matrix[i * n + i] += DBL_EPSILON; /* those of a double one may be the same */
    }
    factor(n, work->matrix, work->pivots);
    solve_factored(n, n, work->matrix, work->pivots, work->products);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) next_matrix[i * n + j] = work->products[j * n + i];
    for (int j = 0; j < n; j++) { /* v = re + i im, and its conjugate */
        if (!(work->imaginary[j] > 0.0)) continue;
        for (int i = 0; i < n; i++) {
            const double complex re = next_matrix[i * n + j], im = I * next_matrix[i * n + j + 1];
            next_matrix[i * n + j] = re + im, next_matrix[i * n + j + 1] = re - im;
        }
    }
    for (int i = 0; i < n; i++) {
        if (!(work->imaginary[i] > 0.0)) continue;
        for (int j = 0; j < n; j++) {
            const double complex re = next_matrix[i * n + j], im = I * next_matrix[(i + 1) * n + j];
            next_matrix[i * n + j] = 0.5 * (re - im),
                                next_matrix[(i + 1) * n + j] = 0.5 * (re + im);
        }
    }
}

/* Return the squared severity of the collision of multipliers j and k; not positive without a
 * collision. */
static double severity_squared(const decomposition *work, int j, int k, double min_modulus)
{
    const int n = work->n;
    const double complex *next_matrix = work->next_matrix;
    const double complex multiplier_j = work->real[j] + I * work->imaginary[j];
    const double complex multiplier_k = work->real[k] + I * work->imaginary[k];
    const double modulus_j = cabs(multiplier_j), modulus_k = cabs(multiplier_k);
    const double damping_product = fmax(-log(modulus_j), 0.0) * fmax(-log(modulus_k), 0.0);
    const double complex coupling_product = next_matrix[j * n + k] * next_matrix[k * n + j];
    const double coupling = cabs(coupling_product) / (modulus_j * modulus_k);
    if (!(modulus_j > min_modulus && modulus_k > min_modulus &&
          damping_product > 0.25 * min_modulus * min_modulus))
        return 0.0;
    /* Few are coupled by more than an eighth of what lets one leave the circle. */
    if (!(coupling > damping_product / 64.0)) return 0.0;
    /* Two that are real have parted already. */
    if (work->imaginary[j] == 0.0 && work->imaginary[k] == 0.0) return 0.0;
    const double complex next_difference = next_matrix[j * n + j] - next_matrix[k * n + k];
    if (!(creal(coupling_product * conj(next_difference) * conj(next_difference)) < 0.0))
        return 0.0;
    const double angle = carg(multiplier_j / multiplier_k);
    const double rotation =
        carg(next_matrix[j * n + j] / next_matrix[k * n + k] * multiplier_k / multiplier_j);
    if (!(angle * (angle + rotation) <= 0.0)) return 0.0; /* they do not meet */
    const double scale = sqrt(modulus_j * modulus_k), g = cabs(multiplier_j - multiplier_k) / scale,
                 b = cabs(next_difference) / scale;
    const double total = g + b, c_squared = 4.0 * coupling;
    const double fraction = c_squared < total * b ? total * g / (total * total - c_squared) : 1.0;
    const double distance = fraction * total - g;
    return (c_squared * fraction * fraction - distance * distance) / (4.0 * damping_product);
}

void collision_severities(int count, int n, const double *monodromy, double min_modulus,
                          double *severity_out)
{
    const size_t square = (size_t)n * n;
    decomposition work = {.n = n};
    double *arrays = malloc((2 * n + 3 * square) * sizeof(double));
    work.next_matrix = malloc(square * sizeof(double complex));
    work.pivots = malloc(n * sizeof(int));
    const int has_memory = arrays && work.next_matrix && work.pivots;
    work.real = arrays, work.imaginary = arrays + n, work.vectors = arrays + 2 * n;
    work.matrix = work.vectors + square, work.products = work.matrix + square;
    for (int i = 0; i + 1 < count; i++, monodromy += square) {
        double max_squared = has_memory && !decompose(&work, monodromy) ? 0.0 : INFINITY;
        if (max_squared == 0.0) transform(&work, monodromy + square);
        for (int j = 0; j < n && max_squared < INFINITY; j++)
            for (int k = j + 1; k < n; k++)
                max_squared = fmax(max_squared, severity_squared(&work, j, k, min_modulus));
        severity_out[i] = sqrt(max_squared);
    }
    free(arrays), free(work.next_matrix), free(work.pivots);
}
