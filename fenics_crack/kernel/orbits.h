/* Periodic orbits of the exact flow as equations: z(T) = z(0). */
#ifndef ORBITS_H
#define ORBITS_H

#include "equations.h"
#include "events.h"

/*     F(x, p) = z(T; x, p) / |z_0| - x,     T = 2 pi m / w,     w = p w_0,     dF/dx = M - I,
 *
 * M the monodromy matrix; dF/dp by central differences. The flow is the point's own: its frequency
 * is set at every evaluation, which returns FOUND; NOT_FOUND where the motion takes more than
 * `most` events or `longest` steps of the search; NEW_SET where the set new_set_of meets is not yet
 * made; NO_MEMORY. */
typedef struct {
    exact_flow *flow;
    double omega, size, turns; /* w_0, |z_0|, 2 pi m */
    double longest;
    int most;
} orbit_equations;

typedef struct orbit_point orbit_point;

/* NULL without memory. */
orbit_point *new_orbit_point(const orbit_equations *given);
void free_orbit_point(orbit_point *at);
equations *equations_of_orbit(orbit_point *at);
int new_set_of(const orbit_point *at);
int events_of(const orbit_point *at);
/* M there: (n, n). */
void monodromy_of(orbit_point *at, double *found);

#endif
