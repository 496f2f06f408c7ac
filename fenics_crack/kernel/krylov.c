#include "krylov.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lapack.h"

enum { MAX_KEPT_RATIO = 2, MAX_STAGES = MAX_KRYLOV_VECTORS / 2 }; /* of two vectors at least */

struct krylov {
    int n, most, stages, kept;      /* vectors of all stages together */
    int begins[MAX_STAGES + 1];
    double *inverses[MAX_STAGES];       /* R^-1 Q^T - Q Q^T (size, size), size = begins[i + 1] - begins[i] */
    double *vectors;                /* (2 most + 1, n) */
    double *columns, *turned;       /* H and R, column by column: (most, most + 1) */
    double *cosines, *sines, *left; /* of rotations; the right side: (most + 1) */
    double *weights, *other, *next; /* room: (most + 1) twice, (n) */
    double *room;
};

krylov *new_krylov(int n)
{
    krylov *k = calloc(1, sizeof(krylov));
    if (!k) return NULL;
    const size_t size = n, most = n < MAX_KRYLOV_VECTORS ? n : MAX_KRYLOV_VECTORS;
    k->n = n, k->most = (int)most;
    k->room = malloc(((2 * most + 2) * size + (2 * most + 5) * (most + 1)) * sizeof(double));
    if (!k->room) {
        free(k);
        return NULL;
    }
    k->vectors = k->room, k->next = k->vectors + (2 * most + 1) * size;
    k->columns = k->next + size, k->turned = k->columns + most * (most + 1);
    k->cosines = k->turned + most * (most + 1), k->sines = k->cosines + most + 1;
    k->left = k->sines + most + 1, k->weights = k->left + most + 1;
    k->other = k->weights + most + 1;
    return k;
}

static void begin_anew(krylov *k)
{
    while (k->stages) free(k->inverses[--k->stages]);
    k->kept = 0;
}

void free_krylov(krylov *k)
{
    if (k) begin_anew(k), free(k->room);
    free(k);
}

/* x += V^T y with rows V (size, n). */
static void combine(int size, int n, const double *vectors, const double *y, double *x)
{
    multiply_matrices(1, size, n, y, vectors, 1.0, x);
}

/* x = B x. */
static void solve_by_kept(const krylov *k, double *x)
{
    for (int stage = k->stages - 1; stage >= 0; stage--) {
        const int begin = k->begins[stage], size = k->begins[stage + 1] - begin;
        const double *vectors = k->vectors + (size_t)begin * k->n;
        multiply(size, k->n, vectors, x, k->weights);
        multiply(size, size, k->inverses[stage], k->weights, k->other);
        combine(size, k->n, vectors, k->other, x);
    }
}

/* What is left of a vector beside some orthonormal ones, whose shares it has (count): by Gram and
 * Schmidt, so many times. Its length. */
static double orthogonalise(krylov *k, int count, const double *vectors, int times, double *x,
                            double *shares)
{
    memset(shares, 0, count * sizeof(double));
    while (times--) {
        multiply(count, k->n, vectors, x, k->weights);
        for (int i = 0; i < count; i++) {
            shares[i] += k->weights[i];
            k->weights[i] = -k->weights[i];
        }
        combine(count, k->n, vectors, k->weights, x);
    }
    return sqrt(dot(k->n, x, x));
}

/* Turns column j of H into that of a triangle, and the right side with it. */
static void rotate(krylov *k, int j, double *column)
{
    for (int i = 0; i < j; i++) {
        const double a = column[i], b = column[i + 1];
        column[i] = k->cosines[i] * a + k->sines[i] * b;
        column[i + 1] = k->cosines[i] * b - k->sines[i] * a;
    }
    const double size = hypot(column[j], column[j + 1]);
    k->cosines[j] = size > 0.0 ? column[j] / size : 1.0;
    k->sines[j] = size > 0.0 ? column[j + 1] / size : 0.0;
    column[j] = size;
    k->left[j + 1] = -k->sines[j] * k->left[j];
    k->left[j] *= k->cosines[j];
}

/* Keeps the inverse on the last `size` + 1 vectors W, of which J V = W H, H = Q R (size + 1, size):
 * J (V R^-1) = W Q. Not if there is no room. */
static void keep(krylov *k, int size)
{
    const size_t row = k->most + 1, count = size + 1;
    if (k->kept + size + 1 > k->most) {
        begin_anew(k);
        return;
    }
    double *inverse = malloc(count * count * sizeof(double)), *last = k->weights;
    if (!inverse) return;
    memset(inverse, 0, count * count * sizeof(double)); /* Q^T */
    for (size_t i = 0; i < count; i++) inverse[i * (count + 1)] = 1.0;
    for (int i = 0; i < size; i++)
        for (size_t j = 0; j < count; j++) {
            double *here = inverse + i * count + j, *next = here + count;
            const double a = *here, b = *next;
            *here = k->cosines[i] * a + k->sines[i] * b;
            *next = k->cosines[i] * b - k->sines[i] * a;
        }
    memcpy(last, inverse + size * count, count * sizeof(double));
    memset(inverse + size * count, 0, count * sizeof(double));
    for (int i = size - 1; i >= 0; i--) { /* R^-1 Q^T */
        double *own = inverse + i * count;
        for (int l = i + 1; l < size; l++) {
            const double share = k->turned[l * row + i], *other = inverse + l * count;
            for (size_t j = 0; j < count; j++) own[j] -= share * other[j];
        }
        for (size_t j = 0; j < count; j++) own[j] /= k->turned[i * row + i];
    }
    for (size_t i = 0; i < count; i++) /* less Q Q^T = I - q q^T */
        for (size_t j = 0; j < count; j++)
            inverse[i * count + j] += last[i] * last[j] - (i == j);
    k->inverses[k->stages++] = inverse;
    k->begins[k->stages] = k->kept += size + 1;
}

void solve_by_products(krylov *k, equations *at, double *x, double tolerance)
{
    const size_t n = k->n, row = k->most + 1;
    if (k->stages && (k->kept > MAX_KEPT_RATIO * k->begins[1])) begin_anew(k);
    /* Vectors lose their right angles by rounding over the square of the residual. */
    const int times = tolerance > 1e-6 ? 1 : 2;
    double *vectors = k->vectors + k->kept * n;
    const double size = sqrt(dot(k->n, x, x));
    int count = 0;
    if (!(size > 0.0 && isfinite(size))) return;
    for (size_t i = 0; i < n; i++) vectors[i] = x[i] / size;
    k->left[0] = size;
    while (count < k->most && fabs(k->left[count]) > tolerance * size) {
        double *column = k->columns + count * row, *turned = k->turned + count * row;
        double *last = vectors + count * n, *next = last + n;
        memcpy(k->next, last, n * sizeof(double));
        solve_by_kept(k, k->next);
        at->apply(at, k->next, next);
        const double left = orthogonalise(k, count + 1, vectors, times, next, column);
        memcpy(turned, column, (count + 1) * sizeof(double));
        turned[count + 1] = left;
        rotate(k, count, turned);
        for (size_t i = 0; i < n && left > 0.0; i++) next[i] /= left;
        count++;
        if (!(left > 1e-14 * turned[count - 1])) break; /* all of what J can reach */
    }
    for (int i = count - 1; i >= 0; i--) {
        double sum = k->left[i];
        for (int j = i + 1; j < count; j++) sum -= k->turned[j * row + i] * k->left[j];
        k->left[i] = sum / k->turned[i * row + i];
    }
    memset(x, 0, n * sizeof(double));
    combine(count, k->n, vectors, k->left, x);
    solve_by_kept(k, x);
    if (count) keep(k, count);
}
