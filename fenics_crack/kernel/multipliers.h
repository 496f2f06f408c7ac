/* Floquet multipliers of neighbouring points of a path. */
#ifndef MULTIPLIERS_H
#define MULTIPLIERS_H

/* Set how far colliding multipliers separate between neighbouring points, relative to the distance
 * at which one leaves the unit circle: (count - 1), of monodromy matrices (count, n, n) in C's
 * order; infinite if multipliers are not found. Multipliers up to `min_modulus` are rounding.
 * Equations: fenics_crack/curves/orbit_events.py. */
void collision_severities(int count, int n, const double *monodromy, double min_modulus,
                          double *severity_out);

#endif
