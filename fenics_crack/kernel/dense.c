#include "dense.h"

#include <stdlib.h>

#include "lapack.h"

int make_dense(dense *at, int size, void (*form)(dense *at))
{
    const size_t n = size;
    at->size = size, at->form = form;
    at->matrix = malloc((n * n + 1) * sizeof(double));
    at->pivots = malloc((n + 1) * sizeof(int));
    return !(at->matrix && at->pivots);
}

void free_dense(dense *at)
{
    free(at->matrix);
    free(at->pivots);
}

void factor_dense(dense *at)
{
    if (at->factored) return;
    at->form(at);
    factor(at->size, at->matrix, at->pivots);
    at->factored = 1;
}

void solve_dense(equations *own, double *x)
{
    dense *at = (dense *)own;
    factor_dense(at);
    solve_factored(at->size, 1, at->matrix, at->pivots, x);
}

double sign_of_dense(equations *own)
{
    dense *at = (dense *)own;
    factor_dense(at);
    return sign_of_factored(at->size, at->matrix, at->pivots);
}
