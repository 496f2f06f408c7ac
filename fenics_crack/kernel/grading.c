#include "grading.h"

#include <math.h>

double element_length_at(const grading *around, double x, double y)
{
    double least = INFINITY;
    const double up = around->height - y;
    for (int i = 0; i < around->count; i++) {
        const double aside = around->x_positions[i] - x;
        const double square = aside * aside + up * up;
        if (square < least) least = square;
    }
    return around->min_length + around->growth * sqrt(least);
}
