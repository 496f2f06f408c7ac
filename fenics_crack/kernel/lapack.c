#include "lapack.h"

#include <math.h>
#include <stdlib.h>

enum {
    MAX_LOOP_PRODUCTS =
        64,             /* number of products up to which loops are faster than a call of BLAS
                         * (measured) */
    MAX_SMALL_ROWS = 48 /* rows of a matrix up to which own factors are faster than LAPACK's */
};

static void *functions[LAPACK_FUNCTIONS];

typedef void gemv_t(const char *, const int *, const int *, const double *, const double *,
                    const int *, const double *, const int *, const double *, double *,
                    const int *);
typedef void gemm_t(const char *, const char *, const int *, const int *, const int *,
                    const double *, const double *, const int *, const double *, const int *,
                    const double *, double *, const int *);
typedef void getrf_t(const int *, const int *, double *, const int *, int *, int *);
typedef void getrs_t(const char *, const int *, const int *, const double *, const int *,
                     const int *, double *, const int *, int *);

typedef void potrf_t(const char *, const int *, double *, const int *, int *);
typedef void geev_t(const char *, const char *, const int *, double *, const int *, double *,
                    double *, double *, const int *, double *, const int *, double *, const int *,
                    int *);

void bind_lapack(void **addresses)
{
    for (int i = 0; i < LAPACK_FUNCTIONS; i++) functions[i] = addresses[i];
}

double dot(int n, const double *x, const double *y)
{
    double a = 0.0, b = 0.0, c = 0.0, d = 0.0;
    int j = 0;
    for (; j + 3 < n; j += 4) {
        a += x[j] * y[j];
        b += x[j + 1] * y[j + 1];
        c += x[j + 2] * y[j + 2];
        d += x[j + 3] * y[j + 3];
    }
    for (; j < n; j++) a += x[j] * y[j];
    return (a + b) + (c + d);
}

void multiply(int rows, int columns, const double *a, const double *x, double *y)
{
    const int one = 1;
    const double unit = 1.0, zero = 0.0;
    if ((long)rows * columns <= MAX_LOOP_PRODUCTS) {
        for (int i = 0; i < rows; i++) {
            double sum = 0.0;
            for (int j = 0; j < columns; j++) sum += a[i * columns + j] * x[j];
            y[i] = sum;
        }
        return;
    }
    ((gemv_t *)functions[DGEMV])("T", &columns, &rows, &unit, a, &columns, x, &one, &zero, y, &one);
}

void multiply_each(int count, int n, const double *a, const double *x, double *y)
{
    for (int i = 0; i < count; i++, x += n)
        for (int row = 0; row < n; row++, a += n) *y++ = dot(n, a, x);
}

void multiply_matrices(int rows, int inner, int columns, const double *a, const double *b,
                       double c_factor, double *c)
{
    const double unit = 1.0;
    if (!rows || !columns) return;
    if (!inner) {
        for (int i = 0; i < rows * columns; i++) c[i] = c_factor ? c_factor * c[i] : 0.0;
        return;
    }
    if ((long)rows * inner * columns <= MAX_LOOP_PRODUCTS) {
        for (int i = 0; i < rows; i++, a += inner)
            for (int j = 0; j < columns; j++, c++) {
                double sum = c_factor ? c_factor * *c : 0.0;
                for (int k = 0; k < inner; k++) sum += a[k] * b[k * columns + j];
                *c = sum;
            }
        return;
    }
    /* BLAS sees C^T = B^T A^T. */
    ((gemm_t *)functions[DGEMM])("N", "N", &columns, &rows, &inner, &unit, b, &columns, a, &inner,
                                 &c_factor, c, &columns);
}

void multiply_transposed(int rows, int inner, int columns, const double *a, const double *b,
                         double *c)
{
    const double unit = 1.0, zero = 0.0;
    if (!rows || !columns) return;
    if ((long)rows * inner * columns <= MAX_LOOP_PRODUCTS) {
        for (int i = 0; i < rows; i++)
            for (int j = 0; j < columns; j++) *c++ = dot(inner, a + i * inner, b + j * inner);
        return;
    }
    ((gemm_t *)functions[DGEMM])("T", "N", &columns, &rows, &inner, &unit, b, &inner, a, &inner,
                                 &zero, c, &columns);
}

static void swap(double *x, double *y)
{
    const double copy = *x;
    *x = *y, *y = copy;
}

/* Factor a small matrix as LAPACK's dgetrf does, column by column. Two columns of L at once are
 * subtracted, u l + v m. */
static int factor_small(int n, double *a, int *pivots)
{
    int info = 0;
    for (int j = 0; j < n; j++) {
        double *restrict column = a + j * n;
        int k = 0, pivot_row = j;
        for (int i = 0; i < j; i++) swap(column + i, column + pivots[i] - 1);
        for (; k + 1 < j; k += 2) {
            const double *restrict l = a + k * n, *restrict m = l + n;
            const double u = column[k], v = column[k + 1] -= u * l[k + 1];
            for (int i = k + 2; i < n; i++) column[i] = column[i] - u * l[i] - v * m[i];
        }
        for (; k < j; k++)
            for (int i = k + 1; i < n; i++) column[i] -= column[k] * a[k * n + i];
        for (int i = j + 1; i < n; i++)
            if (fabs(column[i]) > fabs(column[pivot_row])) pivot_row = i;
        pivots[j] = pivot_row + 1;
        for (int i = 0; i <= j && pivot_row != j; i++) swap(a + i * n + j, a + i * n + pivot_row);
        if (column[j] == 0.0) {
            if (!info) info = j + 1;
            continue;
        }
        const double inverse = 1.0 / column[j];
        for (int i = j + 1; i < n; i++) column[i] *= inverse;
    }
    return info;
}

int factor(int n, double *a, int *pivots)
{
    int info = 0;
    if (n <= MAX_SMALL_ROWS) return factor_small(n, a, pivots);
    /* LAPACK sees A^T, which is factored just as well. */
    ((getrf_t *)functions[DGETRF])(&n, &n, a, &n, pivots, &info);
    return info;
}

int invert_positive(int n, double *a)
{
    int info = 0;
    if (!n) return 0;
    ((potrf_t *)functions[DPOTRF])("L", &n, a, &n, &info);
    if (!info) ((potrf_t *)functions[DPOTRI])("L", &n, a, &n, &info);
    for (long i = 0; i < n; i++) /* in C's order the upper triangle is known */
        for (long j = 0; j < i; j++) a[i * n + j] = a[j * n + i];
    return info != 0;
}

int eigenvectors(int n, double *a, double *real, double *imaginary, double *vectors)
{
    geev_t *geev = (geev_t *)functions[DGEEV];
    double optimal_size, *work;
    int work_size = -1, info; /* the first call says how much room it takes */
    geev("N", "V", &n, a, &n, real, imaginary, NULL, &n, vectors, &n, &optimal_size, &work_size,
         &info);
    work_size = (int)optimal_size, work = malloc(work_size * sizeof(double));
    if (!work) return 1;
    geev("N", "V", &n, a, &n, real, imaginary, NULL, &n, vectors, &n, work, &work_size, &info);
    free(work);
    return info;
}

void solve_factored(int n, int count, const double *a, const int *pivots, double *x)
{
    int info;
    if (n) ((getrs_t *)functions[DGETRS])("T", &n, &count, a, &n, pivots, x, &n, &info);
}

double sign_of_factored(int n, const double *a, const int *pivots)
{
    int odd = 0;
    for (int i = 0; i < n; i++) odd ^= (pivots[i] != i + 1) ^ (a[i * (n + 1)] < 0.0);
    return odd ? -1.0 : 1.0;
}
