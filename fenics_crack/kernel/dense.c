#include "dense.h"

#include <stdlib.h>

#include "lapack.h"

int make_dense(dense *point, int size, void (*form)(dense *point))
{
    const size_t n = size;
    point->size = size, point->form_matrix = form;
    point->matrix = malloc((n * n + 1) * sizeof(double));
    point->pivots = malloc((n + 1) * sizeof(int));
    return !(point->matrix && point->pivots);
}

void free_dense(dense *point)
{
    free(point->matrix);
    free(point->pivots);
}

void factor_dense(dense *point)
{
    if (point->factored) return;
    point->form_matrix(point);
    factor(point->size, point->matrix, point->pivots);
    point->factored = 1;
}

void solve_dense(equations *system, double *x)
{
    dense *point = (dense *)system;
    factor_dense(point);
    solve_factored(point->size, 1, point->matrix, point->pivots, x);
}

double sign_of_dense(equations *system)
{
    dense *point = (dense *)system;
    factor_dense(point);
    return sign_of_factored(point->size, point->matrix, point->pivots);
}
