#include "grading.h"

#include <math.h>

double length_at(const grading *around, double x, double y)
{
    double least = INFINITY;
    const double up = around->height - y;
    for (int i = 0; i < around->count; i++) {
        const double aside = around->along[i] - x;
        const double square = aside * aside + up * up;
        if (square < least) least = square;
    }
    return around->shortest + around->growth * sqrt(least);
}
