/* Equations whose Jacobian is formed, and factored where it is asked for. */
#ifndef DENSE_H
#define DENSE_H

#include "equations.h"

/* The points of such kinds begin with it. The factored matrix may be smaller than J, of the same
 * determinant: then the kind solves with it in its own way. */
typedef struct dense {
    equations base;
    int size, factored;
    double *matrix; /* (size, size) */
    int *pivots;
    void (*form_matrix)(struct dense *point);
} dense;

/* 0, or 1 without memory: room for (size, size). */
int make_dense(dense *point, int size, void (*form)(dense *point));
void free_dense(dense *point);
/* The factors at the point that has been evaluated. */
void factor_dense(dense *point);
/* What vtables take. */
void solve_dense(equations *system, double *x);
double sign_of_dense(equations *system);

#endif
