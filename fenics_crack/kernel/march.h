/* Marches of a small structure, step by step, in its modal coordinates
 *
 *     q'' + c q' + w^2 q + P lambda = f(t),     gap = P^T q - g0,      f = f_0 + sum_k f_ck cos + f_sk sin,
 *
 * with n modes and p pairs. "By mode" is an array (n) where the damping c leaves the modes
 * uncoupled, and a matrix (n, n) where it couples them.
 */
#ifndef MARCH_H
#define MARCH_H

#include "closed_sets.h"
#include "sets.h"

typedef struct {
    int n_modes, n_rows;               /* n, p */
    int has_coupled_modes;             /* whether the damping couples the modes */
    const double *squared_frequencies; /* (n) w^2 */
    const double *gap_rows;            /* (p, n) P^T */
    const double *clearance;           /* (p) g0 */
    const double *spring_stiffnesses;  /* (p) k of the penalty law; NULL: rigid contact */
    closed_sets *friction_solver; /* of springs alone; NULL: no friction, else the p rows are
                                   * normals, then tangents */
    double *sticking_places;      /* (p / 2) where pairs stick or are, here and at the end */
    signed char *pair_states;     /* (p / 2) their states */
    int n_load_rows; /* of the load: its mean, then a cosine and a sine of each order */
    const double *load_rows;  /* (n_load_rows, n) */
    const double *load_basis; /* (instants, n_load_rows) 1, cos, sin ... of a period */
    double *work;             /* (2 n + p) */
} vibration;

/* Central differences in increments d_m = q_m - q_{m-1}, with r = f - w^2 q - P lambda:
 *
 *     d_{m+1} = alpha d_m + beta r_m,
 *     alpha = (2 + dt c)^-1 (2 - dt c),  beta = 2 dt^2 (2 + dt c)^-1,
 *
 * with the penalty law lambda = k max(0, gap), or rigid: 0 <= lambda, gap_{m+1} <= 0,
 * complementary, where gap_{m+1} falls by P^T beta P lambda.
 */
typedef struct {
    vibration vibration;
    const double *increment_factor, *force_factor; /* alpha, beta by mode */
    const double *increment_per_force;             /* (p, n) columns of beta P */
    sets *contact_solver;                          /* of P^T beta P; rigid only */
    double *displacements, *increment;             /* (n) q, d */
    signed char *is_closed;                        /* (p) of the last step; rigid only */
} central_differences;

/* March `steps` steps from instant `first` of the period. gap, force (steps, p) and shape (steps,
 * n) are values at the starts of steps. Returns the number of steps made: fewer if forces were not
 * found. */
int march_central(const central_differences *s, int first, int steps, double *gap, double *force,
                  double *shape);

/* Exponential steps of z = (q, q') less the steady motion without contact:
 *
 *     z_{m+1} = E z_m - G (lambda_m + lambda_{m+1}),     s_{m+1} = [P^T 0] (E z_m - G lambda_m) + l,
 *     0 <= lambda_{m+1},  D lambda_{m+1} - s_{m+1} >= 0,  complementary.
 */
typedef struct {
    int n_modes, n_rows, n_instants; /* n, p, instants of a period */
    int has_coupled_modes;           /* whether the damping couples the modes */
    const double
        *transition; /* E: (4, n) its blocks' diagonals qq, qv, vq, vv, or whole (2 n, 2 n) */
    const double *gap_rows;       /* (p, n) P^T */
    const double *force_response; /* (p, 2 n) G^T */
    const double *gap_response;   /* (p, p) [P^T 0] G */
    const double *steady_gap;     /* (n_instants, p) l: the gap of the steady motion */
    const double *steady_states;  /* (n_instants, 2 n) */
    sets *contact_solver;         /* of D; NULL with friction */
    closed_sets *friction_solver; /* of D; NULL: none, else p rows are normals, then tangents */
    double *sticking_places;      /* (p / 2) where pairs stick or are, here and at the end */
    double *work;                 /* (4 n + 2 p) */
} exponential;

/* March from phase zero. states (steps + 1, 2 n), forces (steps + 1, p) and closed (steps + 1, p),
 * or with friction the pairs' states (steps + 1, p / 2); the first rows are given. Returns the
 * number of steps made: fewer if forces were not found. */
int march_exponential(const exponential *s, int steps, double *states, double *forces,
                      signed char *closed);

#endif
