/* BLAS and LAPACK, as SciPy holds them: bound once, when the kernel is loaded. */
#ifndef LAPACK_H
#define LAPACK_H

/* Names in the order in which bind_lapack takes their addresses. */
enum { DGEMV, DGEMM, DGETRF, DGETRS, DPOTRF, DPOTRI, DGEEV, LAPACK_FUNCTIONS };

void bind_lapack(void **functions);

/* Return x^T y, in four sums: additions need not wait for each other. */
double dot(int n, const double *x, const double *y);
/* Set y = A x with A (rows, columns) in C's order. */
void multiply(int rows, int columns, const double *a, const double *x, double *y);
/* Set y_i = A_i x_i for `count` matrices A_i (n, n). */
void multiply_each(int count, int n, const double *a, const double *x, double *y);
/* Set C = A B + c_factor C with A (rows, inner), B (inner, columns), all in C's order. */
void multiply_matrices(int rows, int inner, int columns, const double *a, const double *b,
                       double c_factor, double *c);
/* Set C = A B^T with A (rows, inner), B (columns, inner). */
void multiply_transposed(int rows, int inner, int columns, const double *a, const double *b,
                         double *c);
/* Factor a matrix (n, n) in C's order in place, into L U. Returns 0, or the number of a vanishing
 * pivot. */
int factor(int n, double *a, int *pivots);
/* Invert a symmetric matrix (n, n) in place. Returns 0, or 1 without a result if it is not positive
 * definite. */
int invert_positive(int n, double *a);
/* Set the eigenvalues (n) of a matrix (n, n) in Fortran's order, which is overwritten, and its
 * eigenvectors in rows: real and imaginary parts of a complex pair, the one with positive imaginary
 * part first. Returns 0, or else without a result. */
int eigenvectors(int n, double *a, double *real, double *imaginary, double *vectors);
/* Set x = A^-1 x from LU factors, for `count` right-hand sides (count, n). */
void solve_factored(int n, int count, const double *a, const int *pivots, double *x);
/* Return the sign of det A from LU factors. */
double sign_of_factored(int n, const double *a, const int *pivots);

#endif
