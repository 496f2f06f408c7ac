/* Floquet multipliers of neighbouring points of a path. */
#ifndef MULTIPLIERS_H
#define MULTIPLIERS_H

/* How far two multipliers part where they meet between neighbours, relative to the distance at which
 * one leaves the unit circle: (count - 1), of monodromy matrices (count, n, n) in C's order. What is
 * compared and why is said in fenics_crack/curves/orbit_events.py. Multipliers up to `known` are
 * rounding; infinite where they are not found. */
void collision_severities(int count, int n, const double *monodromy, double min_modulus,
                          double *severity_out);

#endif
