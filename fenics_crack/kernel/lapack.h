/* BLAS and LAPACK, as SciPy holds them: bound once, when the kernel is loaded. */
#ifndef LAPACK_H
#define LAPACK_H

/* Names in the order in which bind_lapack takes their addresses. */
enum { DGEMV, DGEMM, DGETRF, DGETRS, DPOTRF, DPOTRI, DGEEV, LAPACK_FUNCTIONS };

void bind_lapack(void **functions);

/* x^T y, in four sums: additions need not wait for each other. */
double dot(int n, const double *x, const double *y);
/* y = A x with A (rows, columns) in C's order. */
void multiply(int rows, int columns, const double *a, const double *x, double *y);
/* y_i = A_i x_i with so many A_i (n, n). */
void multiply_each(int count, int n, const double *a, const double *x, double *y);
/* C = A B + keep C with A (rows, inner), B (inner, columns), all in C's order. */
void multiply_matrices(int rows, int inner, int columns, const double *a, const double *b,
                       double c_factor, double *c);
/* C = A B^T with A (rows, inner), B (columns, inner). */
void multiply_transposed(int rows, int inner, int columns, const double *a, const double *b,
                         double *c);
/* LU factors of a matrix (n, n) in C's order, in place: 0, or where its pivot vanishes. */
int factor(int n, double *a, int *pivots);
/* A^-1 of a symmetric matrix (n, n), in place: 0, or 1, with nothing of use, where it is not positive
 * definite. */
int invert_positive(int n, double *a);
/* Eigenvalues (n) of a matrix (n, n) in Fortran's order, which is lost, and eigenvectors in rows; of
 * complex pairs, the positive one first, their real and imaginary parts. 0, or else nothing of use. */
int eigenvectors(int n, double *a, double *real, double *imaginary, double *vectors);
/* x = A^-1 x from LU factors, for each of so many right-hand sides (count, n). */
void solve_factored(int n, int count, const double *a, const int *pivots, double *x);
/* Sign of det A from these. */
double sign_of_factored(int n, const double *a, const int *pivots);

#endif
