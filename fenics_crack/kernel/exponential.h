/* Exponentials of the motion while a set of closed pairs stays (flow.h). */
#ifndef EXPONENTIAL_H
#define EXPONENTIAL_H

#include "closed_sets.h"

typedef struct exponentials exponentials;

/* Of modes with these squares (m) and damping (m), or where it couples them (m, m); unit: a
 * frequency [rad/s] that no set exceeds. NULL without memory. */
exponentials *new_exponentials(int modes, int coupled, const double *squares,
                               const double *damping, double unit);
void free_exponentials(exponentials *e);
/* product = exp(the set's matrix times a length) product, (2 m, 2 m), whose rows are displacements
 * times the unit, and velocities. `are_modes_apart`: whether nothing couples the modes in the product given;
 * returned: in that found. */
int multiply_exponential(exponentials *e, const closed_set *a, double length, int are_modes_apart,
                         double *product);
/* To the product what has been left to be added at once. */
void add_kicks(exponentials *e, double *product);

#endif
