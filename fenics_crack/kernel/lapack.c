#include "lapack.h"

enum { FEW = 32 }; /* numbers of a matrix for which a call of BLAS takes longer than the product */

static void *bound[LAPACK_FUNCTIONS];

typedef void gemv_t(const char *, const int *, const int *, const double *, const double *,
                    const int *, const double *, const int *, const double *, double *,
                    const int *);
typedef void gemm_t(const char *, const char *, const int *, const int *, const int *,
                    const double *, const double *, const int *, const double *, const int *,
                    const double *, double *, const int *);
typedef void getrf_t(const int *, const int *, double *, const int *, int *, int *);
typedef void getrs_t(const char *, const int *, const int *, const double *, const int *,
                     const int *, double *, const int *, int *);

void bind_lapack(void **functions)
{
    for (int i = 0; i < LAPACK_FUNCTIONS; i++) bound[i] = functions[i];
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
    if (rows * columns <= FEW) {
        for (int i = 0; i < rows; i++) {
            double sum = 0.0;
            for (int j = 0; j < columns; j++) sum += a[i * columns + j] * x[j];
            y[i] = sum;
        }
        return;
    }
    ((gemv_t *)bound[DGEMV])("T", &columns, &rows, &unit, a, &columns, x, &one, &zero, y, &one);
}

void multiply_matrices(int rows, int inner, int columns, const double *a, const double *b,
                       double keep, double *c)
{
    const double unit = 1.0;
    if (!rows || !columns) return;
    if (!inner) {
        for (int i = 0; i < rows * columns; i++) c[i] = keep ? keep * c[i] : 0.0;
        return;
    }
    /* BLAS sees C^T = B^T A^T. */
    ((gemm_t *)bound[DGEMM])("N", "N", &columns, &rows, &inner, &unit, b, &columns, a, &inner,
                             &keep, c, &columns);
}

int factor(int n, double *a, int *pivots)
{
    int info = 0;
    /* LAPACK sees A^T, which is factored just as well. */
    if (n) ((getrf_t *)bound[DGETRF])(&n, &n, a, &n, pivots, &info);
    return info;
}

void solve_factored(int n, const double *a, const int *pivots, double *x)
{
    int info;
    const int one = 1;
    if (n) ((getrs_t *)bound[DGETRS])("T", &n, &one, a, &n, pivots, x, &n, &info);
}

double sign_of_factored(int n, const double *a, const int *pivots)
{
    int odd = 0;
    for (int i = 0; i < n; i++) odd ^= (pivots[i] != i + 1) ^ (a[i * (n + 1)] < 0.0);
    return odd ? -1.0 : 1.0;
}
