/* Exponentials of the motion within a set of closed pairs (flow.h). */
#ifndef EXPONENTIAL_H
#define EXPONENTIAL_H

#include "closed_sets.h"

typedef struct exponentials exponentials;

/* Make the exponentials of modes with squares (m) and damping (m), or (m, m) if it couples the
 * modes. unit: a frequency [rad/s] that no set exceeds. NULL without memory. */
exponentials *new_exponentials(int modes, int coupled, const double *squares,
                               const double *damping, double unit);
void free_exponentials(exponentials *e);
/* Set product = exp(length times the set's matrix) product, (2 m, 2 m). Its rows are displacements
 * times the unit, and velocities. are_modes_apart: whether nothing couples the modes in the product
 * given; returned: whether this still holds. */
int multiply_exponential(exponentials *e, const closed_set *a, double length, int are_modes_apart,
                         double *product);
/* Apply the kicks that wait to be applied together. */
void add_kicks(exponentials *e, double *product);

#endif
