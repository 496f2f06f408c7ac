/* Periodic orbits of the exact flow (flow.h) as equations: z(T) = z(0). */
#ifndef SHOOTING_H
#define SHOOTING_H

#include "equations.h"
#include "flow.h"

/*     F(x, p) = scale (z(T; x, p) - z(0)),   scale z(0) = x + x_0 + p x_1,   T = turns / omega,
 *     omega = base + rate p,   load = load_0 + p load_1,   damping = C_0 + p C_1,
 *
 * dF/dx = scale M / scale - I, M the flow's derivative over the period; dF/dp is exact too. Paths
 * may keep M in the unknowns of each point. An evaluation returns FOUND; NOT_FOUND if the motion
 * takes more than `max_pieces` or `max_intervals`, or is not finite; NO_MEMORY. */
typedef struct {
    flow *flow;
    int modes, pairs;
    int harmonics;         /* K */
    int friction;          /* whether there is friction: n = 2 m + p and r = 2 p, else 2 m and p
                            * (flow.h) */
    double base, rate;     /* of omega */
    double turns;          /* 2 pi times the load's periods in one of the orbit */
    const double *scale;   /* (n) */
    const double *rest_states; /* x_0 and x_1, (2, n); NULL: 0 */
    int max_pieces, max_intervals;
    double *force, *gap;   /* the flow's own load, (2 K + 1, m) and (2 K + 1, r); NULL: it does
                            * not change */
    const double *force_rate, *gap_rate;  /* load_1 */
    int n_damping;                        /* length of the damping's arrays; 0: it does not change */
    const double *damping, *damping_rate; /* C_0 and C_1, as the flow's own */
} shooting_equations;

typedef struct shooting_point shooting_point;

/* All is copied but the flow, x_0, x_1, load_1, C_0 and C_1, which must stay. NULL without memory. */
shooting_point *new_shooting_point(const shooting_equations *parameters);
void free_shooting_point(shooting_point *point);
equations *equations_of_shooting(shooting_point *point);
/* Return the number of events in the period followed last. */
int count_events(const shooting_point *point);
/* Return the number of Taylor series in this period. */
int count_pieces(const shooting_point *point);
/* Set M of the last evaluation, (n, n), in the unknowns x. Returns 0, or 1 without M. */
int get_monodromy(shooting_point *point, double *monodromy_out);

#endif
