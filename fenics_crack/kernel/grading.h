/* Lengths of elements around the tips of a plane crack: fenics_crack/fem/blocks.py. */
#ifndef GRADING_H
#define GRADING_H

/* h = min_length + length_per_distance d, d from the nearest point (x_positions, y_position). */
typedef struct {
    int count;
    double y_position, min_length, length_per_distance;
    const double *x_positions;
} grading;

/* Return h at a point. */
double element_length_at(const grading *tips, double x, double y);

#endif
