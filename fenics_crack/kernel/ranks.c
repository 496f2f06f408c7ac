#include "ranks.h"

#include <math.h>

#include "lapack.h"

/* C^T (r, n) of a symmetric matrix (n, n), whose diagonal becomes that of the rest; r. */
static int cholesky(int n, double *a, double tolerance, double *first, double *rows)
{
    int rank = 0;
    for (; rank < n; rank++, rows += n) {
        int at = 0;
        for (int i = 1; i < n; i++)
            if (a[i * (n + 1)] > a[at * (n + 1)]) at = i;
        const double pivot = a[at * (n + 1)], root = sqrt(pivot);
        if (!rank) *first = pivot;
        if (!(pivot > tolerance * *first)) break;
        for (int i = 0; i < n; i++) rows[i] = a[at * n + i];
        for (int s = 1; s <= rank; s++) {
            const double *before = rows - s * n, share = before[at];
            for (int i = 0; i < n; i++) rows[i] -= share * before[i];
        }
        rows[at] = pivot;
        for (int i = 0; i < n; i++) rows[i] /= root, a[i * (n + 1)] -= rows[i] * rows[i];
        a[at * (n + 1)] = 0.0;
    }
    return rank;
}

int tangent_rows(int harmonics, int pairs, const double *tangent, double tolerance, double lost,
                 int *ranks, double *rows, double *room)
{
    const int n = 2 * harmonics + 1;
    int all = 0;
    for (int pair = 0; pair < pairs; pair++, tangent += n * n) {
        double rest = 0.0, first = 0.0;
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) {
                const double weight = i && !j ? sqrt(0.5) : j && !i ? sqrt(2.0) : 1.0;
                room[i * n + j] = 0.5 * (weight * tangent[i * n + j] + tangent[j * n + i] / weight);
            }
        ranks[pair] = cholesky(n, room, tolerance, &first, rows + (long)all * n);
        all += ranks[pair];
        for (int i = 0; i < n; i++) rest += room[i * (n + 1)];
        if (!(fabs(rest) <= lost * fabs(first))) return -1;
    }
    return all;
}

void small_matrix(int harmonics, int pairs, const int *ranks, const double *rows,
                  const double *columns, const double *compliance, double *room, double *found)
{
    const int n = 2 * harmonics + 1;
    int all = 0, begun = 0;
    for (int pair = 0; pair < pairs; pair++) all += ranks[pair];
    for (int pair = 0; pair < pairs; begun += ranks[pair++]) {
        for (int k = 0; k <= harmonics; k++) { /* R C, for the gap of this pair */
            const double *a = columns + (k ? 2 * k - 1 : 0) * (long)all, *b = a + all;
            const double *r = compliance + 2 * ((long)k * pairs + pair) * pairs;
            double *c = room + (a - columns), *d = c + all;
            for (int q = 0, j = 0; q < pairs; q++, r += 2)
                for (int end = j + ranks[q]; j < end; j++) {
                    c[j] = k ? r[0] * a[j] + r[1] * b[j] : r[0] * a[j];
                    if (k) d[j] = r[0] * b[j] - r[1] * a[j];
                }
        }
        multiply_matrices(ranks[pair], n, all, rows + (long)begun * n, room, 0.0,
                          found + (long)begun * all);
    }
    for (int i = 0; i < all; i++) found[(long)i * (all + 1)] += 1.0;
}
