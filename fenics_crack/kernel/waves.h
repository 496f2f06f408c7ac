/* Waves of H harmonics at equally spaced instants, and their coefficients from values there. */
#ifndef WAVES_H
#define WAVES_H

#define TWO_PI (acos(-1.0) * 2.0)

/* Coefficients (2H+1, columns) stand as in switching.h, rows a0, a1, b1, ...; values (instants,
 * columns) at theta = 2 pi i / instants. The quarters of a period share their cosines and sines:
 *
 *     x(theta), x(pi - theta), x(pi + theta), x(-theta) = ce +- co +- se +- so
 *
 * with the sums over even and odd k of a_k cos(k theta) and b_k sin(k theta).
 */
typedef struct waves waves;

/* instants: a multiple of 4; columns: the largest number at once. NULL without memory. */
waves *new_waves(int harmonics, int instants, int columns);
void free_waves(waves *self);
void waves_to_values(waves *self, int columns, const double *coefficients, double *values);
/* More than 2H instants are needed. */
void values_to_waves(waves *self, int columns, const double *values, double *coefficients);

#endif
