/* Lengths of elements around the front of a crack: fenics_crack/fem/blocks.py. */
#ifndef GRADING_H
#define GRADING_H

/* h = shortest + growth d, d from the nearest of points in a plane y = height: x and z (count). */
typedef struct {
    int count;
    double height, shortest, growth;
    const double *along, *through;
} grading;

/* h at a place. */
double length_at(const grading *around, double x, double y, double z);

#endif
