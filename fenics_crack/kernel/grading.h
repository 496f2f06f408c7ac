/* Lengths of elements around the tips of a plane crack: fenics_crack/fem/blocks.py. */
#ifndef GRADING_H
#define GRADING_H

/* h = shortest + growth d, d from the nearest of points on a line y = height: x (count). */
typedef struct {
    int count;
    double height, min_length, growth;
    const double *x_positions;
} grading;

/* Return h at a point. */
double element_length_at(const grading *tips, double x, double y);

#endif
