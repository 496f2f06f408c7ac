#include "grading.h"

#include <math.h>

double element_length_at(const grading *tips, double x, double y)
{
    double min_square = INFINITY;
    const double y_distance = tips->y_position - y;
    for (int i = 0; i < tips->count; i++) {
        const double x_distance = tips->x_positions[i] - x;
        const double distance_squared = x_distance * x_distance + y_distance * y_distance;
        if (distance_squared < min_square) min_square = distance_squared;
    }
    return tips->min_length + tips->length_per_distance * sqrt(min_square);
}
