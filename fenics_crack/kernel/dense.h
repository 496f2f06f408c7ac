/* Equations with a Jacobian that is formed, and factored on demand. */
#ifndef DENSE_H
#define DENSE_H

#include "equations.h"

/* First member of a point with such equations. The factored matrix may be smaller than J, with the
 * same determinant; then the point solves with it in its own way. */
typedef struct dense {
    equations base;
    int size, factored;
    double *matrix; /* (size, size) */
    int *pivots;
    void (*form_matrix)(struct dense *point);
} dense;

/* Allocate a matrix (size, size). Returns 0, or 1 without memory. */
int make_dense(dense *point, int size, void (*form)(dense *point));
void free_dense(dense *point);
/* Factor the matrix at the point evaluated last, unless this is done. */
void factor_dense(dense *point);
/* Functions for the table of equations. */
void solve_dense(equations *system, double *x);
double sign_of_dense(equations *system);

#endif
