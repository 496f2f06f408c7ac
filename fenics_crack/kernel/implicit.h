/* Generalised-alpha steps of a small structure in its modal coordinates (time/implicit.py). */
#ifndef IMPLICIT_H
#define IMPLICIT_H

#include "march.h"

/* With s = 1 - am, w = 1 - af, D = s + w beta dt^2 w^2 and A = D + w gamma dt c, both by mode. Of
 * the penalty law `pull` is -A^-1 P, and the gap at a step's end falls by `compliance` times h; of
 * rigid contact `kick` is s D^-1 P, and `pull` A^-1 (c kick + w dt w^2 kick). */
typedef struct {
    vibration body;                  /* its own room is not needed */
    int instants;                    /* of a period */
    double dt, am, af, gamma, beta;
    const double *damping, *inverse; /* c and A^-1, by mode */
    const double *pull, *kick;       /* (p, n) columns; kick of rigid contact only */
    const double *compliance;        /* (p, p) of the penalty law; else NULL */
    sets *contact, *stops;           /* of the compliance, and of P^T kick; rigid only */
    int most;                        /* turns of Newton's method */
    double *shape, *velocity, *change; /* (n) q, q', q'' */
    double *held;                    /* (p) h, or the impulses of the last step */
    double lost;                     /* energy lost in c so far */
    signed char *closed;             /* (2 p) which pairs press, and room */
    double *room;                    /* (5 n + 7 p + p^2) */
    int *pivots;                     /* (p) room */
} generalised_alpha;

/* March `steps` steps from instant `first` of the period; gap, force (steps, p) and shape (steps,
 * n) are those at their starts, the force of rigid contact the mean of the step. Returns the steps
 * made: fewer if forces were not found. */
int march_implicit(generalised_alpha *s, int first, int steps, double *gap, double *force,
                   double *shape);

#endif
