#include "instant.h"
#include "lapack.h"

int active_sets(int n, const double *d, const double *g, double allowed, int most,
                signed char *closed, double *force, double *matrix, int *pivots, double *reached)
{
    while (most--) {
        /* f_A = (D_AA)^-1 g_A, 0 elsewhere. */
        int size = 0;
        for (int i = 0; i < n; i++) {
            if (!closed[i]) continue;
            reached[size] = g[i];
            size++;
        }
        for (int i = 0, row = 0; i < n; i++) {
            if (!closed[i]) continue;
            for (int j = 0, column = 0; j < n; j++)
                if (closed[j]) matrix[row * size + column++] = d[i * n + j];
            row++;
        }
        if (factor(size, matrix, pivots)) return 1;
        solve_factored(size, matrix, pivots, reached);
        for (int i = 0, row = 0; i < n; i++) force[i] = closed[i] ? reached[row++] : 0.0;
        /* Who is pulled, and who penetrates. */
        multiply(n, n, d, force, reached);
        int changed = 0;
        for (int i = 0; i < n; i++) {
            const int now = closed[i] ? force[i] > 0.0 : reached[i] - g[i] < -allowed;
            changed |= now != closed[i];
            closed[i] = now;
        }
        if (!changed) return 0;
    }
    return 1;
}
