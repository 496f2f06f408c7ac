#include "multipliers.h"

#include <complex.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "lapack.h"

/* Room of a pair of neighbours. */
typedef struct {
    int n, *pivots;
    double *real, *imaginary; /* parts of the multipliers, (n) */
    double *vectors;          /* their eigenvectors V, or real and imaginary parts of pairs, in rows */
    double *matrix, *products;
    double complex *after; /* (n, n) */
} neighbours;

/* The eigenvalues of a matrix, and its eigenvectors: 0, or 1 without them. */
static int decompose(neighbours *in, const double *matrix)
{
    const int n = in->n;
    for (int i = 0; i < n; i++) /* as LAPACK sees it */
        for (int j = 0; j < n; j++) in->matrix[j * n + i] = matrix[i * n + j];
    return eigenvectors(n, in->matrix, in->real, in->imaginary, in->vectors);
}

/* B = V^-1 M V. */
static void transform(neighbours *in, const double *matrix)
{
    const int n = in->n;
    double complex *after = in->after;
    multiply_transposed(n, n, n, in->vectors, matrix, in->products);
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) in->matrix[i * n + j] = in->vectors[j * n + i];
        in->matrix[i * n + i] += DBL_EPSILON; /* those of a double one may be the same */
    }
    factor(n, in->matrix, in->pivots);
    solve_factored(n, n, in->matrix, in->pivots, in->products);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) after[i * n + j] = in->products[j * n + i];
    for (int j = 0; j < n; j++) { /* v = re + i im, and its conjugate */
        if (!(in->imaginary[j] > 0.0)) continue;
        for (int i = 0; i < n; i++) {
            const double complex re = after[i * n + j], im = I * after[i * n + j + 1];
            after[i * n + j] = re + im, after[i * n + j + 1] = re - im;
        }
    }
    for (int i = 0; i < n; i++) {
        if (!(in->imaginary[i] > 0.0)) continue;
        for (int j = 0; j < n; j++) {
            const double complex re = after[i * n + j], im = I * after[(i + 1) * n + j];
            after[i * n + j] = 0.5 * (re - im), after[(i + 1) * n + j] = 0.5 * (re + im);
        }
    }
}

/* The square of how far the multipliers j and k part; not a positive number where they do not. */
static double parting_of(const neighbours *in, int j, int k, double known)
{
    const int n = in->n;
    const double complex *after = in->after;
    const double complex first = in->real[j] + I * in->imaginary[j];
    const double complex second = in->real[k] + I * in->imaginary[k];
    const double size = cabs(first), other = cabs(second);
    const double allowed = fmax(-log(size), 0.0) * fmax(-log(other), 0.0);
    const double complex both = after[j * n + k] * after[k * n + j];
    const double strength = cabs(both) / (size * other);
    if (!(size > known && other > known && allowed > 0.25 * known * known)) return 0.0;
    /* Few are coupled by more than an eighth of what lets one leave the circle. */
    if (!(strength > allowed / 64.0)) return 0.0;
    /* Two that are real have parted already. */
    if (in->imaginary[j] == 0.0 && in->imaginary[k] == 0.0) return 0.0;
    const double complex end = after[j * n + j] - after[k * n + k];
    if (!(creal(both * conj(end) * conj(end)) < 0.0)) return 0.0;
    const double angle = carg(first / second);
    const double turn = carg(after[j * n + j] / after[k * n + k] * second / first);
    if (!(angle * (angle + turn) <= 0.0)) return 0.0; /* they do not meet */
    const double unit = sqrt(size * other), gap = cabs(first - second) / unit, b = cabs(end) / unit;
    const double way = gap + b, coupled = 4.0 * strength;
    const double share = coupled < way * b ? way * gap / (way * way - coupled) : 1.0;
    const double apart = share * way - gap;
    return (coupled * share * share - apart * apart) / (4.0 * allowed);
}

void collision_severities(int count, int n, const double *monodromy, double known, double *parting)
{
    const size_t square = (size_t)n * n;
    neighbours in = {.n = n};
    double *room = malloc((2 * n + 3 * square) * sizeof(double));
    in.after = malloc(square * sizeof(double complex));
    in.pivots = malloc(n * sizeof(int));
    const int ready = room && in.after && in.pivots;
    in.real = room, in.imaginary = room + n, in.vectors = room + 2 * n;
    in.matrix = in.vectors + square, in.products = in.matrix + square;
    for (int i = 0; i + 1 < count; i++, monodromy += square) {
        double largest = ready && !decompose(&in, monodromy) ? 0.0 : INFINITY;
        if (largest == 0.0) transform(&in, monodromy + square);
        for (int j = 0; j < n && largest < INFINITY; j++)
            for (int k = j + 1; k < n; k++) largest = fmax(largest, parting_of(&in, j, k, known));
        parting[i] = sqrt(largest);
    }
    free(room), free(in.after), free(in.pivots);
}
